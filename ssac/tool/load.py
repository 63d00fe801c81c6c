"""Paths of two event files and a rig in, two Observations that fit the rig and the method out."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssac.baselines.zncc_f import frame_means
from ssac.camera import READOUT_STD_S, Camera, Rig
from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.events import US_PER_S, check_events, time_quantum_s
from ssac.files.damage import STRICT, Reading
from ssac.files.event_files import load_events, load_frames
from ssac.files.rigs import check_resolution, load_rig
from ssac.files.track_files import is_track_file, load_track
from ssac.points import check_track
from ssac.tool.registry import Input, Method
from ssac.tool.summaries import DEFAULT, OF_TRACKS
from ssac.track.observation import Observation, tracked
from ssac.track.point_motion import check_readout

_LONG_STEP_S = 0.9  # between points of a track: times that count frames are 1 apart
_FEW = 1000  # events of which one is off a coarse grid, unless all are on it

Paths = tuple[Path, Path, Path]
"""Camera 1's events, camera 2's events, rig."""


def load_pair(
    paths: Paths, method: Method, cameras: tuple[int, int] = (1, 2), reading: Reading = STRICT
) -> tuple[Observation, Observation, Rig]:
    """Read what two cameras recorded.

    Parameters
    ----------
    paths
        Events of any format that `ssac.files.event_files.load_events` reads, or tracks as
        `ssac.files.track_files` has them; Kalibr or OpenCV YAML.
    method
        Frames are read only for a method that compares frames.
    cameras
        Numbers of the two in the rig, from 1 on.
    reading
        What may be made of event files that are damaged or unsorted.

    Raises
    ------
    SsacError
        If a file cannot be used, does not fit the rig, or lacks what the method needs. The message
        names the file.
    """
    if paths[0].exists() and paths[1].exists() and paths[0].samefile(paths[1]):
        raise SsacError(f"{paths[0]}: given for both cameras: give each camera's own file")
    if cameras[0] == cameras[1]:
        raise SsacError(f"camera {cameras[0]} of {paths[2]} is given for both: name two cameras")
    for path in paths[:2]:
        if method.without_tracks and is_track_file(path):
            raise SsacError(f"{path}: is a track of points; {method.without_tracks}")
    rig = load_rig(paths[2], cameras)
    if method.needs_extrinsics and rig.T_2_1 is None:
        raise SsacError(
            f"{paths[2]}: {method.name} needs the extrinsics (T_cn_cnm1 of cam1 in a Kalibr file, "
            "R and T in OpenCV's): add them, or leave --known-extrinsics out"
        )
    cam1 = _load_camera(paths[0], rig.cam1, f"camera {cameras[0]} of {paths[2]}", method, reading)
    cam2 = _load_camera(paths[1], rig.cam2, f"camera {cameras[1]} of {paths[2]}", method, reading)
    _check_two(cam1, cam2, paths)
    return cam1, cam2, rig


def describe(camera: Observation, path: Path) -> str:
    """Say in a line what a file holds."""
    start_s, end_s = camera.span_s
    if camera.track is not None:
        return f"{path}: {len(camera.track)} points from {start_s:.3f} to {end_s:.3f} s"
    return f"{path}: {len(camera.events)} events from {start_s:.3f} to {end_s:.3f} s"


def check_enough_events(
    path: Path, camera: Observation, n_read: int, method: Method, config: Config
) -> None:
    """Raise SsacError when the events of one file, `n_read` before denoising, cannot suffice."""
    if method.input is Input.FRAMES or camera.track is not None:
        return
    left = f"denoising left {len(camera.events)} of {n_read} events"
    if camera.clutter is not None and camera.clutter.masked_events:
        left += f", of which {camera.clutter.masked_events} were of lamps and hot pixels"
    if len(camera.events) == 0:
        raise SsacError(
            f"{path}: {left}: check that an object moves in this recording and that its times are "
            "in the unit of its format, or try --no-denoise"
        )
    if method.input is not Input.TRACKS:
        return
    t_us, n_min = camera.events["t"], camera.n_min(config)
    window_us = 2 * config.half_window_s * US_PER_S
    if len(t_us) < n_min or np.min(t_us[n_min - 1 :] - t_us[: len(t_us) - n_min + 1]) > window_us:
        raise SsacError(
            f"{path}: no window of {window_us / 1e3:g} ms holds {n_min} events"
            f"{f' ({left})' if config.denoise else ''}: record closer to the object, or give a "
            "smaller --n-min or a longer --half-window"
        )


def has_common_time(cam1: Observation, cam2: Observation, method: Method, config: Config) -> bool:
    """Whether the recordings have common time at any offset searched."""
    (start1, end1), (start2, end2) = _span_s(cam1, method), _span_s(cam2, method)
    low, high = config.interval_s
    return low < end2 - start1 and start2 - end1 < high


def check_common_time(
    paths: Paths, cam1: Observation, cam2: Observation, method: Method, config: Config
) -> None:
    """Raise SsacError when the recordings have no common time at any offset searched."""
    if has_common_time(cam1, cam2, method, config):
        return
    (start1, end1), (start2, end2) = _span_s(cam1, method), _span_s(cam2, method)
    low, high = config.interval_s
    shift_s = start2 - start1
    raise SsacError(
        f"{paths[0]} ({start1:.3f} to {end1:.3f} s) and {paths[1]} ({start2:.3f} to {end2:.3f} s) "
        f"have no common time at any offset between {low:g} and {high:g} s: search where they do, "
        f"for example --search {shift_s - 1.0:.1f} {shift_s + 1.0:.1f}"
    )


def check_shutters(method: Method, is_asked: bool, has_track: bool) -> None:
    """Raise SsacError where a readout is to be estimated that cannot be."""
    if is_asked and not has_track:
        raise SsacError(
            "--estimate-readout: expected a track of a frame camera, got events only, which no "
            "shutter reads out: leave it out"
        )
    if is_asked and not method.finds_readout:
        raise SsacError(
            f"--estimate-readout: {method.name} takes shutters as the rig says: use {OF_TRACKS}"
        )


def to_be_read_out(rig: Rig, *observations: Observation) -> Rig:
    """Give the rig with what is known of readouts of tracks that it does not state."""
    cameras = [
        replace(camera, readout_std_s=READOUT_STD_S)
        if seen.track is not None and camera.readout_s is None
        else camera
        for camera, seen in zip((rig.cam1, rig.cam2), observations, strict=True)
    ]
    return replace(rig, cam1=cameras[0], cam2=cameras[1])


def quantum_s(camera: Observation) -> float:
    """Step [s] to which a camera's times were rounded: 10 or 1 ms, or 0."""
    if camera.track is not None:
        return time_quantum_s(camera.track.times_s)
    some_us = camera.events["t"][:_FEW]
    if len(some_us) == 0 or np.any(some_us % 1000):
        return 0.0
    return time_quantum_s(camera.events["t"] / US_PER_S)


def rounded(path: Path, step_s: float) -> str:
    """Warn of times that were rounded to steps [s]."""
    return (
        f"{path}: all times are whole {1e3 * step_s:g} ms: whoever wrote it rounded them, and by so"
        " much the offset may be off; its deviation is widened"
    )


def less_sure(estimate: Estimate, quanta_s: tuple[float, float]) -> Estimate:
    """Widen the offset's deviation by what the rounding of times may shift it.

    Times cut off below a step of q are late by q / 2 on average, rounded ones are not: +-1.96
    deviations of an even distribution of width q hold both.
    """
    hidden = sum(step_s**2 for step_s in quanta_s) / 12.0
    if hidden == 0.0 or not np.isfinite(estimate.t_d_std_s):
        return estimate
    covariance = estimate.covariance
    if covariance is not None:
        covariance = covariance.copy()
        covariance[0, 0] += hidden
    of_clock = estimate.clock_covariance
    if of_clock is not None:
        of_clock = of_clock + np.diag([hidden, 0.0])
    return replace(
        estimate,
        t_d_std_s=float(np.hypot(estimate.t_d_std_s, hidden**0.5)),
        covariance=covariance,
        clock_covariance=of_clock,
        strays_std_s=np.hypot(estimate.strays_std_s, hidden**0.5),
    )


def _load_camera(
    path: Path, camera: Camera, camera_name: str, method: Method, reading: Reading
) -> Observation:
    """Read what one camera recorded, and check it against its calibration."""
    if is_track_file(path):
        track = load_track(path)
        check_track(track, camera.width, camera.height, f"{path} with {camera_name}")
        check_readout(track.times_s, camera.readout_s or 0.0, f"{path} with {camera_name}")
        _warn_of_long_steps(track.times_s, path)
        return tracked(track)
    file = load_events(path, reading)
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


def _warn_of_long_steps(times_s: NDArray[np.float64], path: Path) -> None:
    step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
    if step_s > _LONG_STEP_S:
        warnings.warn(
            f"{path}: its points are {step_s:.3g} s apart, which tells little of a motion: if t_s "
            "is in milliseconds or counts frames, give seconds",
            stacklevel=3,
        )


def _check_two(cam1: Observation, cam2: Observation, paths: Paths) -> None:
    """Raise SsacError when two files hold what one camera saw, be it at other times.

    There is no baseline then, and any translation fits.
    """
    if cam1.track is not None and cam2.track is not None:
        same = np.array_equal(cam1.track.points_px, cam2.track.points_px)
    else:
        events1, events2 = cam1.events, cam2.events
        same = 0 < len(events1) == len(events2) and all(
            np.array_equal(events1[field], events2[field]) for field in "xy"
        )
    if same:
        raise SsacError(
            f"{paths[0]} and {paths[1]} hold the same points: one is a copy of the other, and "
            "there is no baseline between a camera and itself: give each camera's own file"
        )


def _pixels_of_mean(frames: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Means of frames (n, height, width), as images of one pixel (n, 1, 1)."""
    return frame_means(frames)[:, None, None]


def _span_s(camera: Observation, method: Method) -> tuple[float, float]:
    """First and last time [s] of what the method looks at."""
    if method.input is Input.FRAMES and camera.frame_times_s is not None:
        return float(camera.frame_times_s[0]), float(camera.frame_times_s[-1])
    return camera.span_s
