"""The files that `ssac sync` writes, and the options that set the scale and the frame."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.files.damage import Reading
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


@dataclass(frozen=True)
class Outputs:
    """Paths to write to, named like the command's options; None: not asked for."""

    json_file: Path | None
    plot: Path | None  # a folder, or one file for all figures
    write_synced: Path | None  # camera 2's events or track on camera 1's clock
    trajectory: Path | None  # the object's path
    write_rig: Path | None  # the rig with the pose found
    report: Path | None  # an HTML page


def check_outputs(cameras: Sequence[Path], others: Sequence[Path], outputs: Outputs) -> None:
    """Raise SsacError for outputs, numbered ones too, that cannot be written or are inputs."""
    n = len(cameras)
    synced, plot, rig = outputs.write_synced, outputs.plot, outputs.write_rig
    if synced is not None:
        check_written(synced, (TRACK_SUFFIX,) if is_track_file(cameras[1]) else WRITTEN)
    if rig is not None:
        check_written(rig, RIG_SUFFIXES)
    if outputs.report is not None:
        check_written(outputs.report, PAGE_SUFFIXES)
    files = [outputs.json_file, synced, outputs.trajectory, rig, outputs.report]
    if outputs.trajectory is not None:  # a path for each group of cameras
        files += [numbered_file(outputs.trajectory, k) for k in range(2, n // 2 + 1)]
    if plot is not None and plot.suffix.lower() in FIGURE_SUFFIXES:
        pairs = [f"{a}-{b}" for a, b in combinations(range(1, n + 1), 2)]
        files += [plot] if n == 2 else [numbered_file(plot, pair) for pair in pairs]
    elif plot is not None:
        check_figures(plot)
    check_targets(files, [file_of(path) for path in (*cameras, *others)])


def write_outputs(
    result: "Result | NetworkResult",
    outputs: Outputs,
    cam2: Path,
    reading: Reading,
    known: Known,
    log: Log,
) -> None:
    """Write the outputs asked for, path and rig last, and log each of them."""
    clock = Stopwatch(log)

    def tell(line: str) -> None:
        log("\n".join(folded(line, columns(sys.stderr), len("wrote "))))

    if outputs.json_file is not None:
        save_json(outputs.json_file, result.to_dict())
        tell(f"wrote {outputs.json_file}")
    synced, trajectory, rig = outputs.write_synced, outputs.trajectory, outputs.write_rig
    if synced is not None and isinstance(result, Result):  # with more cameras the option is refused
        if result.estimate.has_offset:
            with clock.part("write") as say:
                say(_write_synced(synced, result.estimate, cam2, reading))
        else:
            tell(f"not written: {synced}, since there is no reliable offset")
    if outputs.plot is not None:
        with clock.part("draw") as say:
            drawn = result.plotted(outputs.plot)
            say(", ".join(map(str, drawn)) or "nothing: the method left no curve and no track")
    if outputs.report is not None:
        with clock.part("report") as say:
            say(str(result.report(outputs.report, shlex.join(["ssac", *sys.argv[1:]]))))
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


def known_of(
    distance_m: float | None,
    positions: Path | None,
    rtk: Path | None,
    lever_arm_m: tuple[float, float, float] | None,
) -> Known:
    """Collect the options that set scale and frame; check their files before hours of work."""
    given = {"--distance": distance_m, "--positions": positions, "--rtk": rtk}
    names = [name for name, value in given.items() if value is not None]
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
    return Known(distance_m, positions, rtk, lever_arm_m)
