"""The files that `ssac sync` writes, and the options that set the scale and the frame.

`given` holds all options of the command by the names of its table.
"""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.files.damage import Reading, check_is_file
from ssac.files.event_files import WRITTEN, check_written, load_events, write_synced
from ssac.files.rigs import RIG_SUFFIXES
from ssac.files.ros_bags import file_of
from ssac.files.track_files import TRACK_SUFFIX, is_track_file, load_track, save_track
from ssac.files.whole_file import FIGURE_SUFFIXES, check_figures, check_targets, numbered_file
from ssac.pipeline.answer import Log, Stopwatch
from ssac.pipeline.api import Result
from ssac.pipeline.opened import Known
from ssac.pipeline.report import save_json
from ssac.screen import columns, folded

if TYPE_CHECKING:
    from ssac.pipeline.many import NetworkResult

PAGE_SUFFIXES = (".html", ".htm")


def check_outputs(cameras: Sequence[Path], rig: Path, given: SimpleNamespace) -> None:
    """Raise SsacError for outputs, numbered ones too, that cannot be written or are inputs."""
    n, synced, plot = len(cameras), given.write_synced, given.plot
    if synced is not None:
        if file_of(cameras[1]) == cameras[1]:  # a bag's topic is looked for later
            check_is_file(cameras[1])
        check_written(synced, (TRACK_SUFFIX,) if is_track_file(cameras[1]) else WRITTEN)
    if given.write_rig is not None:
        check_written(given.write_rig, RIG_SUFFIXES)
    if given.report is not None:
        check_written(given.report, PAGE_SUFFIXES)
    files = [given.json_file, synced, given.trajectory, given.write_rig, given.report]
    if given.trajectory is not None:  # a path for each group of cameras
        files += [numbered_file(given.trajectory, k) for k in range(2, n // 2 + 1)]
    if plot is not None and plot.suffix.lower() in FIGURE_SUFFIXES:
        pairs = [f"{a}-{b}" for a, b in combinations(range(1, n + 1), 2)]
        files += [plot] if n == 2 else [numbered_file(plot, pair) for pair in pairs]
    elif plot is not None:
        check_figures(plot)
        if any(file is not None and file.resolve() == plot.resolve() for file in files):
            raise SsacError(f"--plot: {plot} is named for a file too: name another folder")
    inputs = *cameras, rig, *filter(None, (given.positions, given.rtk))
    check_targets(files, [file_of(path) for path in inputs])


def write_outputs(
    result: "Result | NetworkResult",
    given: SimpleNamespace,
    cam2: Path,
    reading: Reading,
    known: Known,
    log: Log,
) -> None:
    """Write the outputs asked for, path and rig last, and log each of them."""
    clock = Stopwatch(log)

    def tell(line: str) -> None:
        log("\n".join(folded(line, columns(sys.stderr), len("wrote "))))

    if given.json_file is not None:
        save_json(given.json_file, result.to_dict())
        tell(f"wrote {given.json_file}")
    synced, trajectory, rig = given.write_synced, given.trajectory, given.write_rig
    if synced is not None and isinstance(result, Result):  # with more cameras the option is refused
        if result.estimate.has_offset:
            with clock.part("write") as say:
                say(_write_synced(synced, result.estimate, cam2, reading))
        else:
            tell(f"not written: {synced}, since there is no reliable offset")
    if given.plot is not None:
        with clock.part("draw") as say:
            drawn = result.plotted(given.plot)
            say(", ".join(map(str, drawn)) or "nothing: the method left no curve and no track")
    if given.report is not None:
        with clock.part("report") as say:
            say(str(result.report(given.report, shlex.join(["ssac", *sys.argv[1:]]))))
    if trajectory is not None or rig is not None:  # last, as RTK may contradict the path
        from ssac.pipeline.many import write_many, write_two

        if isinstance(result, Result):
            write_two(result.answer, known, trajectory, rig, tell)
        else:
            write_many(result, trajectory, rig, tell)


def _write_synced(file: Path, estimate: Estimate, cam2: Path, reading: Reading) -> str:
    """Reread camera 2's file, as events in memory are denoised; write it on camera 1's clock."""
    if is_track_file(cam2):
        track = load_track(cam2)
        times_s = estimate.clock.cam1_from_cam2(track.times_s)
        save_track(file, replace(track, times_s=times_s))
    else:
        write_synced(file, load_events(cam2, reading), estimate.clock)
    is_sure = np.isfinite(estimate.t_d_std_s)
    return str(file) if is_sure else f"{file}, by an offset of unknown accuracy"


def known_of(given: SimpleNamespace) -> Known:
    """Collect the options that set scale and frame; check their files before hours of work."""
    positions, rtk, lever_arm_m = given.positions, given.rtk, given.lever_arm
    scales = {"--distance": given.distance, "--positions": positions, "--rtk": rtk}
    names = [name for name, value in scales.items() if value is not None]
    if len(names) > 1:
        raise SsacError(
            f"{names[0]}: not with {names[1]}, as each sets the scale: give the better one alone"
        )
    if lever_arm_m is not None and rtk is None:
        raise SsacError("--lever-arm: is of RTK's antenna: give --rtk too, or leave it out")
    if positions is not None:
        from ssac.network.ground import check_positions  # a slow import: all that compares paths

        check_positions(positions, Config().rules.ground)
    if rtk is not None:
        from ssac.network.ground import check_rtk

        check_rtk(rtk, lever_arm_m)
    return Known(given.distance, positions, rtk, lever_arm_m)
