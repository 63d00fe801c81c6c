"""A simulated outdoor flight in, what is found of it beside its truth out.

Each kind takes one thing from the truth, so that one sees what it costs not to know it.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from experiments.lab.score import score
from experiments.outdoor.flights import LEVER_ARM_M, Truth, calibrated, clouds_of, rtk_of
from sim.disturb import merged
from sim.recording import SimConfig
from sim.scene.rig import kalibr_yaml, two_view_rig
from ssac.clock import Clock
from ssac.config import Config
from ssac.events import EventFile
from ssac.files.event_files import load_events, write_synced
from ssac.files.track_files import save_track
from ssac.geometry.pose import depths
from ssac.network.align import smoothed
from ssac.network.comparison import Comparison, compare
from ssac.network.tum import Path as SpacePath
from ssac.pipeline.answer import Answer
from ssac.pipeline.api import sync
from ssac.points import PointTrack
from ssac.track.faint import faint_object_events

Array = NDArray[np.float64]

KINDS = ("as_recorded", "true_tracks", "true_pose", "true_intrinsics", "all_true")
"""Of two cameras."""

COLUMNS = (
    "flight", "kind", "status", "t_d_error_ms", "t_d_std_ms", "skew_error_ppm", "skew_std_ppm",
    "r_error_deg", "r_std_deg", "t_error_deg", "t_std_deg", "rmse_m", "median_m", "max_m",
    "icp_rmse_m", "scale_error_percent", "rtk_samples", "coverage", "reason",
)  # fmt: skip

CONFIG = Config(
    denoise=False, n_min=8, half_window_s=0.05, n_samples=1200, skew_prior_ppm=50.0, search="all"
)  # of a small drone, and event cameras' clocks
_PATH_HZ = 50.0
_BETWEEN_S = 0.00031  # after the truth's samples: times of whole milliseconds look rounded
_MOST_MISSED = 9.0  # times the median: 6 deviations
_OF_TRUTH = 4  # truth's samples, at 200 Hz, from one of a true track to the next


def twin_row(
    folder: Path, config: SimConfig, truth: Truth, flight: int, kind: str
) -> dict[str, Any]:
    """Estimate clocks, pose and path of one flight and compare them with the truth.

    Parameters
    ----------
    folder
        Of the recording, both clocks equal but for the skew.
    config
        It was simulated with.
    truth
        Its truth, with the offset that camera 2's clock is given here.
    flight
        Number of the flight.
    kind
        One of `KINDS`.
    """
    found, path = estimated(folder, config, truth, flight, kind)
    estimate = found.estimate
    row: dict[str, Any] = {"flight": flight, "kind": kind, "status": str(estimate.status)}
    row |= {"reason": estimate.reason}
    if not estimate.has_offset or path is None:
        return {name: row.get(name, np.nan) for name in COLUMNS}
    errors = score(estimate, estimate.t_d_s, truth.R, truth.t)
    error_s = estimate.clock.cam2_from_cam1(estimate.t_ref_s) - truth.clock.cam2_from_cam1(
        estimate.t_ref_s
    )
    row |= {
        "t_d_error_ms": 1e3 * abs(float(error_s)),
        "t_d_std_ms": 1e3 * estimate.t_d_std_s,
        "skew_error_ppm": abs(estimate.skew_ppm - truth.clock.skew_ppm),
        "skew_std_ppm": estimate.skew_std_ppm,
        "r_error_deg": errors.r_error_deg,
        "r_std_deg": estimate.r_std_deg,
        "t_error_deg": errors.t_error_deg,
        "t_std_deg": estimate.t_std_deg,
    }
    row |= path_figures(compared(path, truth, flight), truth)
    return {name: row[name] for name in COLUMNS}


def estimated(
    folder: Path, config: SimConfig, truth: Truth, flight: int, kind: str
) -> tuple[Answer, SpacePath | None]:
    """Find clocks, pose and path [baselines, camera 1's frame] of a flight."""
    exact = kind in ("true_intrinsics", "all_true")
    with TemporaryDirectory() as name:
        work = Path(name)
        write_rig(work / "rig.yaml", (config,) * 2 if exact else calibrated(config, flight)[:2])
        if kind in ("true_tracks", "all_true"):
            names = _write_tracks(work, config, truth)
        else:
            names = write_events(work, folder, truth, flight)
        cam1, cam2 = work / names[0], work / names[1]
        found = sync(cam1, cam2, work / "rig.yaml", config=CONFIG).answer
    if not found.estimate.has_offset:
        return found, None
    pose = found.estimate.R, found.estimate.t
    if kind in ("true_pose", "all_true"):
        pose = truth.R, truth.t
    if pose[0] is None or pose[1] is None:
        return found, None
    return found, triangulated(found, pose[0], pose[1])


def triangulated(found: Answer, R: Array, t: Array) -> SpacePath | None:
    """Triangulate both tracks, smoothed in time; None of too few points in front of both cameras.

    The mean of the two points where the rays pass closest, in camera 1's frame, on its clock. Rays
    that miss each other by far more than others do, at their depth, are of no one point.
    """
    estimate, rig = found.estimate, found.rig
    views = found.views.under(estimate.clock)
    start_s, end_s = views.overlap_s(np.array([estimate.t_d_s]))
    n_samples = int(_PATH_HZ * (end_s[0] - start_s[0]))
    pairs = views.pairs_at(estimate.t_d_s, n_samples)
    rays1, rays2 = pairs.rays(rig)
    depths1, depths2 = depths(R, t, rays1, rays2)
    before = (depths1 > 0.0) & (depths2 > 0.0) & np.isfinite(depths1 * depths2)
    if before.sum() < 100:
        return None
    first = depths1[:, None] * rays1
    second = (depths2[:, None] * rays2 - t) @ R
    missed = np.linalg.norm(first - second, axis=1) / np.abs(depths1)
    before &= missed < _MOST_MISSED * np.median(missed[before])
    rough = SpacePath(pairs.times_s[before], (0.5 * (first + second))[before])
    return replace(rough, positions_m=smoothed(rough).at(rough.times_s))


def compared(path: SpacePath, truth: Truth, flight: int) -> Comparison:
    """Compare a path with the flight's RTK, whose lever arm is known."""
    return compare(path, rtk_of(truth, flight), lever_arm_m=LEVER_ARM_M)


def path_figures(found: Comparison, truth: Truth) -> dict[str, Any]:
    """Give the columns of a row that tell of the path."""
    assert found.in_time is not None  # both paths have times
    figures = found.in_time.figures()
    return {
        "rmse_m": figures["rmse_m"],
        "median_m": figures["median_m"],
        "max_m": figures["max_m"],
        "icp_rmse_m": found.as_shape.rmse_m,
        "scale_error_percent": 100.0 * abs(figures["scale"] / truth.baseline_m - 1.0),
        "rtk_samples": figures["n_samples"],
        "coverage": found.in_time.coverage,
    }


def write_rig(path: Path, cameras: Sequence[SimConfig]) -> None:
    """Write a rig as the estimator is given it; intrinsics that differ are a calibration's."""
    exact = all(camera == cameras[0] for camera in cameras)
    chain: dict[str, Any] = {}
    for n, camera in enumerate(cameras):
        rig = two_view_rig(
            camera.angle_deg,
            focal_px=camera.focal_px,
            resolution=camera.resolution,
            principal_point=camera.principal_point,
        )
        entry = yaml.safe_load(kalibr_yaml(rig, with_extrinsics=False))["cam0"]
        if not exact:
            del entry["intrinsics_std"]  # a good calibration's are the default
        chain[f"cam{n}"] = entry
    path.write_text(yaml.safe_dump(chain), encoding="utf-8")


def write_events(
    work: Path, folder: Path, truth: Truth, flight: int, second: int = 1
) -> tuple[str, str]:
    """Write both cameras' events of the drone, with clouds behind, and camera 2's with its offset.

    Parameters
    ----------
    work
        Folder to write to.
    folder, truth, flight
        Of the recording.
    second
        Which camera of the flight, from 0 on, is the recording's second.
    """
    skew_ppm, t_ref_s = truth.clock.skew_ppm, truth.clock.t_ref_s  # the recording has the skew
    offset = Clock(-truth.clock.t_d_s)
    duration_s = float(truth.times_s[-1])
    for name, camera, ppm, clock in (
        ("cam1.h5", 0, 0.0, Clock()),
        ("cam2.h5", second, skew_ppm, offset),
    ):
        found = drone_events(folder / name, flight, camera, ppm, t_ref_s, duration_s)
        write_synced(work / name, found, clock)
    return "cam1.h5", "cam2.h5"


@lru_cache(maxsize=4)  # of one flight, whose kinds are estimated one after the other
def drone_events(
    file: Path, flight: int, camera: int, skew_ppm: float, t_ref_s: float, duration_s: float
) -> EventFile:
    """Give what a camera, from 0 on, saw of the drone before clouds, as its clock runs."""
    recorded = load_events(file)
    width, height = recorded.width, recorded.height
    assert width is not None  # our own files have both
    assert height is not None
    sky = clouds_of(flight, camera, (width, height), duration_s).copy()
    runs = Clock(0.0, skew_ppm, t_ref_s)
    sky["t"] = np.rint(1e6 * runs.cam2_from_cam1(1e-6 * sky["t"]))
    events = merged(recorded.events, sky)
    return EventFile(faint_object_events(events, width, height), width, height)


def true_track(
    times_s: Array, centres_px: Array, clock: Clock, resolution: tuple[int, int], every: int
) -> PointTrack:
    """Give the images (n, 2) of the drone's origin at times (n,) as a camera's track.

    Parameters
    ----------
    times_s, centres_px
        Of the truth, on camera 1's clock.
    clock
        The camera's.
    resolution
        Of its image: what is outside is left out.
    every
        Samples of the truth from one point to the next.
    """
    centres_px = centres_px + _BETWEEN_S * np.gradient(centres_px, times_s, axis=0)
    inside = np.all((centres_px >= 0.0) & (centres_px <= np.array(resolution) - 1.0), axis=1)
    kept = np.flatnonzero(inside)[::every]
    return PointTrack(clock.cam2_from_cam1(times_s[kept] + _BETWEEN_S), centres_px[kept])


def _write_tracks(work: Path, config: SimConfig, truth: Truth) -> tuple[str, str]:
    """Write the images of the drone's origin as both cameras' tracks."""
    names = "cam1.csv", "cam2.csv"
    for name, clock, px in zip(names, (Clock(), truth.clock), truth.centres_px, strict=True):
        save_track(work / name, true_track(truth.times_s, px, clock, config.resolution, _OF_TRUTH))
    return names
