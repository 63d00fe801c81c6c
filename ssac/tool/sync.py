"""Two event files and a rig in, the offset and pose between the cameras out: what `ssac sync` does.

Script, notebook and command line share one function::

    result = sync("cam1.h5", "cam2.h5", "rig.yaml")
    print(report_text(result))  # of ssac.tool.report
    result.estimate.t_d_s, result.estimate.R, result.estimate.t
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from ssac.camera import Rig, with_deviations
from ssac.config import Config, checked
from ssac.estimate import Estimate
from ssac.tool.load import Paths, check_common_time, check_enough_events, describe, load_pair
from ssac.tool.registry import Input, Method, choose_method
from ssac.track.observation import Observation, denoised

Log = Callable[[str], None]

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
    config: Config  # as asked for
    seconds: dict[str, float]  # by part, in the order they ran


def sync(
    cam1_path: Path | str,
    cam2_path: Path | str,
    rig_path: Path | str,
    method: str | None = None,
    known_extrinsics: bool = False,
    config: Config | None = None,
    log: Log | None = None,
    focal_std: float | None = None,
    centre_std_px: float | None = None,
) -> SyncResult:
    """Estimate the offset and the pose between two recorded cameras.

    Parameters
    ----------
    cam1_path, cam2_path
        Event files of any format that `ssac.files.event_files.load_events` reads.
    rig_path
        Kalibr or OpenCV YAML with the intrinsics, and the extrinsics where they are known.
    method
        Name from `ssac.tool.registry`; None for the best one.
    known_extrinsics
        Use the extrinsics of the rig, and find the offset only.
    config
        Parameters of the method; None for the defaults.
    log
        Called with a line of progress after each part.
    focal_std, centre_std_px
        Deviations of both cameras' focal lengths, as a share of them, and of both coordinates of
        their principal points [px]: in place of those of the rig file, where not None.

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
    chosen = choose_method(method, known_extrinsics)
    config = checked(config)
    clock = Clock(log or (lambda line: None))

    with clock.part("read") as say:
        cam1, cam2, rig = load_pair(paths, chosen)
        rig = _restated(rig, focal_std, centre_std_px)
        say(describe(cam1, paths[0]))
        say(describe(cam2, paths[1]))
    n_read = len(cam1.events), len(cam2.events)
    if chosen.input is not Input.FRAMES and config.denoise:
        with clock.part("denoise") as say:
            cam1, cam2 = denoised(cam1, cam2, rig, config)
            left = len(cam1.events), len(cam2.events)
            say(f"{left[0]} of {n_read[0]} and {left[1]} of {n_read[1]} events left")
    for path, camera, n in zip(paths[:2], (cam1, cam2), n_read, strict=True):
        check_enough_events(path, camera, n, chosen, config)
    check_common_time(paths, cam1, cam2, chosen, config)
    with clock.part("estimate") as say:
        estimate = chosen.estimate(cam1, cam2, rig, config)
        say(chosen.name)
    return SyncResult(paths, chosen, estimate, cam1, cam2, rig, config, clock.seconds)


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
    """Measures the parts of a run and logs a line for each."""

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
        self._log(f"{name:9}{self.seconds[name]:6.2f} s  {_NEXT_LINE.join(lines)}")
