"""Two event or track files and a rig in, offset and pose of the cameras out: `ssac sync`.

Script, notebook and command line share one function::

    result = sync("cam1.h5", "cam2.h5", "rig.yaml")
    print(report_text(result))  # of ssac.tool.report
    result.estimate.t_d_s, result.estimate.R, result.estimate.t
"""

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from ssac.camera import Rig, with_deviations
from ssac.config import Config, checked
from ssac.errors import SsacError
from ssac.estimate import Estimate, Status
from ssac.files.damage import STRICT, Reading
from ssac.files.track_files import is_track_file
from ssac.search.all_offsets import Guess
from ssac.search.one_object import ObjectsUsed, one_object
from ssac.tool.everywhere import SKEW_PRIOR_PPM, Start, find_start
from ssac.tool.load import (
    Paths,
    check_common_time,
    check_enough_events,
    check_shutters,
    describe,
    has_common_time,
    less_sure,
    load_pair,
    quantum_s,
    rounded,
    to_be_read_out,
)
from ssac.tool.registry import Input, Method, choose_method
from ssac.tool.summaries import DEFAULT, OF_TRACKS
from ssac.track.observation import Observation, denoised

Log = Callable[[str], None]

WANDERING = "pieces"
"""Clock of tracks that none of one skew fits: those of phones and camcorders change theirs."""

MAY_WANDER = (Status.CLOCK_JUMP, Status.POOR_FIT)
"""How a track's clock that wanders is refused: both were made for event cameras' clocks."""

_NEXT_LINE = "\n" + 19 * " "  # of one part's progress


@dataclass(frozen=True)
class SyncResult:
    """An estimate, what it was made from, and how long it took."""

    paths: Paths
    method: Method
    estimate: Estimate
    cam1: Observation  # events denoised if that was asked for, as the method saw them
    cam2: Observation
    rig: Rig
    config: Config  # as asked for; its interval is the one searched
    seconds: dict[str, float]  # by part, in the order they ran
    guess: Guess | None = None  # that the search over all offsets began with
    wanders: bool = False  # one skew did not fit a track, so its clock is of pieces unasked
    reading: Reading = STRICT  # of the event files
    objects: tuple[ObjectsUsed, ObjectsUsed] | None = None  # that the cameras saw, if looked for


def sync(
    cam1_path: Path | str,
    cam2_path: Path | str,
    rig_path: Path | str,
    method: str | None = None,
    known_extrinsics: bool = False,
    config: Config | None = None,
    log: Log | None = None,
    *,
    cameras: tuple[int, int] = (1, 2),
    search_all: bool | None = None,
    rate_range: tuple[float, float] | None = None,
    focal_std: float | None = None,
    centre_std_px: float | None = None,
    reading: Reading = STRICT,
    estimate_readout: bool = False,
) -> SyncResult:
    """Estimate the offset and the pose between two recorded cameras.

    Parameters
    ----------
    cam1_path, cam2_path
        Event files of any format that `ssac.files.event_files.load_events` reads, or track files as
        `ssac.files.track_files` has them.
    rig_path
        Kalibr or OpenCV YAML with the intrinsics, and the extrinsics where they are known.
    method
        Name from `ssac.tool.registry`; None for the best one that the files allow.
    known_extrinsics
        Use the extrinsics of the rig, and find the offset only.
    config
        Parameters of the method; None for the defaults.
    log
        Called with a line of progress after each part.
    cameras
        Numbers of the two in the rig, from 1 on.
    search_all
        Try every offset that leaves enough common time, not the config's interval. None: where a
        file is a track, and where the default interval leaves no common time.
    rate_range
        Least and largest rate of camera 2's clock, by camera 1's, where a frame rate is unknown;
        all offsets are then tried at each.
    focal_std, centre_std_px
        Deviations of both cameras' focal lengths, as a share of them, and of both coordinates of
        their principal points [px]: in place of those of the rig file, where not None.
    reading
        What may be made of event files that are damaged or unsorted.
    estimate_readout
        Find the readouts of rolling shutters that the rig does not state, of cameras with a track.

    Returns
    -------
    SyncResult
        Its estimate says with `status` and `reason` when it is not to be relied upon.

    Raises
    ------
    SsacError
        If a file cannot be used, or does not fit the others; the message names it.
    """
    paths = Path(cam1_path), Path(cam2_path), Path(rig_path)
    has_track = any(map(is_track_file, paths[:2]))
    chosen = choose_method(method or (OF_TRACKS if has_track else DEFAULT), known_extrinsics)
    default = Config(skew_prior_ppm=SKEW_PRIOR_PPM) if has_track else None
    config = checked(config or default)
    _check_search(chosen, search_all, rate_range)
    check_shutters(chosen, estimate_readout, has_track)
    clock = Clock(log or (lambda line: None))

    with clock.part("read") as say:
        cam1, cam2, rig = load_pair(paths, chosen, cameras, reading)
        rig = _restated(rig, focal_std, centre_std_px)
        rig = to_be_read_out(rig, cam1, cam2) if estimate_readout else rig
        say(describe(cam1, paths[0]))
        say(describe(cam2, paths[1]))
    quanta_s = quantum_s(cam1), quantum_s(cam2)
    for path, step_s in zip(paths[:2], quanta_s, strict=True):
        if step_s:
            warnings.warn(rounded(path, step_s), stacklevel=2)
    n_read = len(cam1.events), len(cam2.events)
    if chosen.input is not Input.FRAMES and config.denoise:
        with clock.part("denoise") as say:
            cam1, cam2 = denoised(cam1, cam2, rig, config)
            left = len(cam1.events), len(cam2.events)
            if sum(n_read):
                say(f"{left[0]} of {n_read[0]} and {left[1]} of {n_read[1]} events left")
    for path, camera, n in zip(paths[:2], (cam1, cam2), n_read, strict=True):
        check_enough_events(path, camera, n, chosen, config)
    everywhere = _searches_all(cam1, cam2, chosen, config, search_all, rate_range)
    if not everywhere:
        check_common_time(paths, cam1, cam2, chosen, config)
    objects: tuple[ObjectsUsed, ObjectsUsed] | None = None

    def result(
        estimate: Estimate, config: Config, guess: Guess | None = None, wanders: bool = False
    ) -> SyncResult:
        read = paths, chosen, estimate, cam1, cam2, rig
        return SyncResult(*read, config, clock.seconds, guess, wanders, reading, objects)

    if chosen.of_one_object and rate_range is None:
        with clock.part("objects") as say:
            one = one_object(cam1, cam2, rig, config, everywhere)
            cam1, cam2, objects = one.cam1, one.cam2, one.objects
            if sum(n_read):
                say(one.words)
        refusal = one.refused(chosen.name)
        if refusal is not None:
            return result(refusal, config)
    start: Start | None = None
    if everywhere:
        with clock.part("search") as say:
            progress = _progress(log) if log else None
            start = find_start(cam1, cam2, rig, config, chosen.name, rate_range, progress)
            say(start.words)
        if start.found.guesses:
            config = start.config(config)
    if start is not None and start.refusal is not None:
        return result(start.refusal, config)
    with clock.part("estimate") as say:
        run = partial(_estimate, chosen, cam1, cam2, rig, start=start)
        estimate, wanders = run(config=config), False
        if has_track and _may_wander(estimate, config):
            other = run(config=replace(config, clock=WANDERING))
            if other.has_offset:
                estimate, wanders = other, True
                config = replace(config, clock=WANDERING)
        say(f"{chosen.name}, with a clock that wanders" if wanders else chosen.name)
    guess = None if start is None else start.guess
    return result(less_sure(estimate, quanta_s), config, guess, wanders)


def _may_wander(estimate: Estimate, config: Config) -> bool:
    """Whether a clock of pieces may fit what one of a constant skew does not."""
    is_open = config.clock != WANDERING and config.skew_prior_ppm > 0.0
    return is_open and estimate.status in MAY_WANDER


def _estimate(
    method: Method,
    cam1: Observation,
    cam2: Observation,
    rig: Rig,
    config: Config,
    start: Start | None,
) -> Estimate:
    """Run a method where a search over all offsets, if there was one, says that it is to begin."""
    if start is None:
        return _on_one_core(method, cam1, cam2, rig, config)
    return start.as_recorded(_on_one_core(method, cam1, start.as_seen(cam2), rig, config))


def _on_one_core(
    method: Method, cam1: Observation, cam2: Observation, rig: Rig, config: Config
) -> Estimate:
    """Estimate without threads of BLAS: matrices are so small that they only wait."""
    with threadpool_limits(1):
        return method.estimate(cam1, cam2, rig, config)


def _check_search(
    method: Method, search_all: bool | None, rate_range: tuple[float, float] | None
) -> None:
    """Raise SsacError for a search that makes no sense."""
    if (search_all or rate_range) and method.input is not Input.TRACKS:
        raise SsacError(
            f"{method.name} compares {method.input.value}, and all offsets are searched with the "
            "object's path: give an interval (--search), or another method"
        )
    if rate_range is not None and not 0.0 < rate_range[0] < rate_range[1] < np.inf:
        raise SsacError(
            "the range of rates must be two positive numbers in ascending order, got "
            f"{rate_range[0]:g} {rate_range[1]:g}"
        )


def _searches_all(
    cam1: Observation,
    cam2: Observation,
    method: Method,
    config: Config,
    asked: bool | None,
    rate_range: tuple[float, float] | None,
) -> bool:
    """Whether all offsets are searched: where asked for, and by default where it is needed."""
    if rate_range is not None:
        return True
    if asked is not None or method.input is not Input.TRACKS:
        return bool(asked)
    if config.interval_s != Config.interval_s:
        return False
    is_track = cam1.track is not None or cam2.track is not None
    return is_track or not has_common_time(cam1, cam2, method, config)


def _progress(log: Log) -> Callable[[float], None]:
    """Log a line for each fifth of a search that takes long."""
    start_s, told = time.perf_counter(), [0.0]

    def report(share: float) -> None:
        if share >= told[0] + 0.2 and time.perf_counter() - start_s > 2.0:
            told[0] = share
            log(f"search   {100.0 * share:4.0f} %")

    return report


def _restated(rig: Rig, focal: float | None, centre_px: float | None) -> Rig:
    """Give the rig with other deviations of its intrinsics, where they are not None."""
    cameras = []
    for camera in (rig.cam1, rig.cam2):
        said = camera.intrinsics_std_px
        other = with_deviations(camera, focal or 0.0, centre_px or 0.0).intrinsics_std_px
        focals = said[:2] if focal is None else other[:2]
        centre = said[2:] if centre_px is None else other[2:]
        cameras.append(replace(camera, intrinsics_std_px=focals + centre))
    return replace(rig, cam1=cameras[0], cam2=cameras[1])


class Clock:
    """Measures the parts of a run and logs a line for each that has something to say."""

    def __init__(self, log: Log) -> None:
        self.seconds: dict[str, float] = {}
        self._log = log

    @contextmanager
    def part(self, name: str) -> Iterator[Log]:
        """Give a function that takes the part's line of progress."""
        lines: list[str] = []
        start = time.perf_counter()
        yield lines.append
        self.seconds[name] = time.perf_counter() - start
        if lines:
            self._log(f"{name:9}{self.seconds[name]:6.2f} s  {_NEXT_LINE.join(lines)}")
