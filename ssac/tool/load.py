"""Paths of two event files and a rig in, two Observations that fit the rig and the method out."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssac.baselines.zncc_f import frame_means
from ssac.camera import Camera, Rig
from ssac.config import Config
from ssac.errors import SsacError
from ssac.events import US_PER_S, check_events
from ssac.files.event_files import load_events, load_frames
from ssac.files.rigs import check_resolution, load_rig
from ssac.tool.registry import Input, Method
from ssac.tool.summaries import DEFAULT
from ssac.track.observation import Observation

Paths = tuple[Path, Path, Path]
"""Camera 1's events, camera 2's events, rig."""


def load_pair(paths: Paths, method: Method) -> tuple[Observation, Observation, Rig]:
    """Read what two cameras recorded.

    Parameters
    ----------
    paths
        Events of any format that `ssac.files.event_files.load_events` reads; Kalibr or OpenCV YAML.
    method
        Frames are read only for a method that compares frames.

    Raises
    ------
    SsacError
        If a file cannot be used, does not fit the rig, or lacks what the method needs. The message
        names the file.
    """
    if paths[0].exists() and paths[1].exists() and paths[0].samefile(paths[1]):
        raise SsacError(f"{paths[0]}: given for both cameras: give each camera's own file")
    rig = load_rig(paths[2])
    if method.needs_extrinsics and rig.T_2_1 is None:
        raise SsacError(
            f"{paths[2]}: {method.name} needs the extrinsics (T_cn_cnm1 of cam1 in a Kalibr file, "
            "R and T in OpenCV's): add them, or leave --known-extrinsics out"
        )
    cam1 = _load_camera(paths[0], rig.cam1, f"camera 1 of {paths[2]}", method)
    cam2 = _load_camera(paths[1], rig.cam2, f"camera 2 of {paths[2]}", method)
    return cam1, cam2, rig


def describe(camera: Observation, path: Path) -> str:
    """Say in a line what a file holds."""
    start_s, end_s = camera.events["t"][[0, -1]] / US_PER_S
    return f"{path}: {len(camera.events)} events from {start_s:.3f} to {end_s:.3f} s"


def check_enough_events(
    path: Path, camera: Observation, n_read: int, method: Method, config: Config
) -> None:
    """Raise SsacError when the events of one file, `n_read` before denoising, cannot suffice."""
    if method.input is Input.FRAMES:
        return
    left = f"denoising left {len(camera.events)} of {n_read} events"
    if len(camera.events) == 0:
        raise SsacError(
            f"{path}: {left}: check that an object moves in this recording, or try --no-denoise"
        )
    if method.input is not Input.TRACKS:
        return
    t_us, n_min = camera.events["t"], config.n_min
    window_us = 2 * config.half_window_s * US_PER_S
    if len(t_us) < n_min or np.min(t_us[n_min - 1 :] - t_us[: len(t_us) - n_min + 1]) > window_us:
        raise SsacError(
            f"{path}: no window of {window_us / 1e3:g} ms holds {n_min} events"
            f"{f' ({left})' if config.denoise else ''}: record closer to the object, or give a "
            "smaller --n-min or a longer --half-window"
        )


def check_common_time(
    paths: Paths, cam1: Observation, cam2: Observation, method: Method, config: Config
) -> None:
    """Raise SsacError when the recordings have no common time at any offset searched."""
    (start1, end1), (start2, end2) = _span_s(cam1, method), _span_s(cam2, method)
    low, high = config.interval_s
    if low < end2 - start1 and start2 - end1 < high:
        return
    shift_s = start2 - start1
    raise SsacError(
        f"{paths[0]} ({start1:.3f} to {end1:.3f} s) and {paths[1]} ({start2:.3f} to {end2:.3f} s) "
        f"have no common time at any offset between {low:g} and {high:g} s: search where they do, "
        f"for example --search {shift_s - 1.0:.1f} {shift_s + 1.0:.1f}"
    )


def _load_camera(path: Path, camera: Camera, camera_name: str, method: Method) -> Observation:
    """Read what one camera recorded, and check it against its calibration."""
    file = load_events(path)
    check_resolution(camera, file.width, file.height, camera_name, str(path))
    if file.width is None or file.height is None:
        check_events(file.events, camera.width, camera.height, f"{path} with {camera_name}")
    if method.input is not Input.FRAMES:
        return Observation(file.events)
    frames = load_frames(path, _pixels_of_mean if method.takes_means else None)
    if frames is None or len(frames[0]) == 0:
        raise SsacError(
            f"{path}: {method.name} compares intensity frames, and the file has none: use a "
            f"method for events, such as {DEFAULT}"
        )
    times_us, images = frames
    return Observation(file.events, images, times_us / US_PER_S)


def _pixels_of_mean(frames: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Means of frames (n, height, width), as images of one pixel (n, 1, 1)."""
    return frame_means(frames)[:, None, None]


def _span_s(camera: Observation, method: Method) -> tuple[float, float]:
    """First and last time [s] of what the method looks at."""
    if method.input is Input.FRAMES and camera.frame_times_s is not None:
        return float(camera.frame_times_s[0]), float(camera.frame_times_s[-1])
    start, end = camera.events["t"][[0, -1]]
    return float(start) / US_PER_S, float(end) / US_PER_S
