"""The paper's outdoor experiment as a twin: its flights, and what an estimator is given of them.

Two DAVIS346 with 8 mm lenses 20 m apart, and a third 20 m further on; a drone of 0.5 m some 15 to
60 m away, whose path RTK tells. The third camera is the second of another recording of the same
flight. Clouds drift behind; what they make each camera see is added to what it recorded before an
even sky.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from experiments.lab.recorded import FlightTruth
from sim.disturb import View, clouds, merged
from sim.recording import SimConfig
from sim.scene.rig import kalibr_yaml, two_view_rig
from sim.scene.trajectory import SplineConfig
from sim.seeds import generator
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.arrays import Array
from ssac.clock import Clock
from ssac.events import EventFile
from ssac.files.event_files import load_events, write_synced
from ssac.files.track_files import save_track
from ssac.network.tum import Path as SpacePath
from ssac.points import PointTrack
from ssac.track.faint import faint_object_events

DURATION_S = 120.0
T_D_S = 3.217
SKEW_PPM = 30.0
THIRD_T_D_S, THIRD_SKEW_PPM = -7.3, -20.0
BASELINE_M = 20.0
DISTANCE_M = 35.0
FOCAL_PX = 432.0  # 8 mm over pixels of 18.5 um
CLOUDS_PX_S = 6.0  # 8 m/s at a height of 600 m

FOCAL_STD, CENTRE_STD_PX = 0.001, 0.3
"""Errors of the calibration: those of a good one, as estimators assume where a rig says none."""

LEVER_ARM_M = (0.05, 0.0, 0.12)  # RTK's antenna in the body: forward, left, up
_RTK_HZ = 5.0
_RTK_STD_M = (0.01, 0.01, 0.02)
_RTK_CLOCK = Clock(18.4, 5.0)  # as camera 1 sees it
FIRST_SEED = 76_000  # nothing was chosen on these; those from 71,000 on were looked at
_STREAM = 97  # of what is drawn beside the recording
_BETWEEN_S = 0.00031  # after the truth's samples: times of whole milliseconds look rounded
_OF_TRUTH = 4  # truth's samples, at 200 Hz, from one of a true track to the next


def outdoor_config(duration_s: float = DURATION_S) -> SimConfig:
    """Give the simulated set-up."""
    spline = SplineConfig(
        duration_s=duration_s,
        sampling_hz=1.0,
        segments_per_s=1.0,
        smoothing=2.0,  # s^3: turns within some seconds, at 5 m/s or so
        multiplier_xyz_m=(14.0, 36.0, 10.0),
        multiplier_rot_rad=(0.5, 0.5, 2.0),
        max_radius_m=24.0,
    )
    return SimConfig(
        angle_deg=float(np.rad2deg(2.0 * np.arcsin(BASELINE_M / (2.0 * DISTANCE_M)))),
        t_d_s=T_D_S,
        skew_ppm=SKEW_PPM,
        spline=spline,
        drone_size_m=0.5,
        distance_m=DISTANCE_M,
        focal_px=FOCAL_PX,
        sensor=PRESETS["davis346"],
        frames=FrameConfig(rate_hz=0.0),
    )


def third_config(config: SimConfig) -> SimConfig:
    """Give the set-up of the first camera and the third, which is as far from the second as it."""
    return replace(
        config, angle_deg=2.0 * config.angle_deg, t_d_s=THIRD_T_D_S, skew_ppm=THIRD_SKEW_PPM
    )


def seed_of(flight: int) -> int:
    """Seed of a flight, from 0 on."""
    return FIRST_SEED + flight


def rtk_of(truth: FlightTruth, flight: int) -> SpacePath:
    """Give what RTK says: noise of a centimetre or two, a clock and an antenna of its own."""
    rng = np.random.default_rng([_STREAM, seed_of(flight), 0])
    first_s, last_s = _RTK_CLOCK.cam2_from_cam1(truth.times_s[[0, -1]])
    even_s: Array = np.arange(first_s, last_s, 1.0 / _RTK_HZ)
    nearest = np.searchsorted(truth.times_s, _RTK_CLOCK.cam1_from_cam2(even_s))
    nearest = np.minimum(nearest, len(truth.times_s) - 1)
    shown_s = _RTK_CLOCK.cam2_from_cam1(truth.times_s[nearest])  # even but for the truth's 5 ms
    turns = Rotation.from_quat(truth.quaternions[nearest])
    antenna_m = truth.positions_m[nearest] + turns.apply(LEVER_ARM_M)
    noise_m = rng.normal(0.0, _RTK_STD_M, antenna_m.shape)
    return SpacePath(shown_s, antenna_m + noise_m, quaternions=truth.quaternions[nearest])


def calibrated(config: SimConfig, flight: int) -> tuple[SimConfig, ...]:
    """Give the three cameras' intrinsics as a calibration would: with its errors."""
    rng = np.random.default_rng([_STREAM, seed_of(flight), 1])
    cameras = []
    for _ in range(3):
        focal_px = float(config.focal_px * (1.0 + rng.normal(0.0, FOCAL_STD)))
        off_px, (u_px, v_px) = rng.normal(0.0, CENTRE_STD_PX, 2), config.principal_point
        centre = (float(u_px + off_px[0]), float(v_px + off_px[1]))
        cameras.append(replace(config, focal_px=focal_px, principal_point=centre))
    return tuple(cameras)


def write_rig(path: Path, cameras: Sequence[SimConfig]) -> None:
    """Write a rig as the estimator is given it; intrinsics that differ are a calibration's."""
    exact = all(camera == cameras[0] for camera in cameras)
    names = ("focal_px", "resolution", "principal_point")
    chain: dict[str, Any] = {}
    for n, camera in enumerate(cameras):
        rig = two_view_rig(camera.angle_deg, **{name: getattr(camera, name) for name in names})
        entry = yaml.safe_load(kalibr_yaml(rig, with_extrinsics=False))["cam0"]
        if not exact:
            del entry["intrinsics_std"]  # a good calibration's are the default
        chain[f"cam{n}"] = entry
    path.write_text(yaml.safe_dump(chain), encoding="utf-8")


def write_events(
    work: Path, folder: Path, truth: FlightTruth, flight: int, second: int = 1
) -> tuple[Path, Path]:
    """Write both cameras' events of the drone, with clouds behind, and camera 2's with its offset.

    `second` is which camera of the flight, from 0 on, is the recording's second.
    """
    clock = truth.clock  # of which the recording has the skew
    duration_s = float(truth.times_s[-1])
    for file, camera, ppm, shown in (
        ("cam1.h5", 0, 0.0, Clock()),
        ("cam2.h5", second, clock.skew_ppm, Clock(-clock.t_d_s)),
    ):
        found = drone_events(folder / file, flight, camera, ppm, clock.t_ref_s, duration_s)
        write_synced(work / file, found, shown)
    return work / "cam1.h5", work / "cam2.h5"


@lru_cache(maxsize=4)  # of one flight, whose kinds are estimated one after the other
def drone_events(
    file: Path, flight: int, camera: int, skew_ppm: float, t_ref_s: float, duration_s: float
) -> EventFile:
    """Give what a camera, from 0 on, saw of the drone before clouds, as its clock runs."""
    recorded = load_events(file)
    width, height = recorded.width, recorded.height
    assert width is not None  # our own files have both
    assert height is not None
    drawn_by = generator(seed_of(flight), _STREAM, 2, camera)
    sky = clouds(View(width, height, duration_s), CLOUDS_PX_S, drawn_by)
    runs = Clock(0.0, skew_ppm, t_ref_s)
    sky["t"] = np.rint(1e6 * runs.cam2_from_cam1(1e-6 * sky["t"]))
    events = merged(recorded.events, sky)
    return EventFile(faint_object_events(events, width, height), width, height)


def write_tracks(work: Path, config: SimConfig, truth: FlightTruth) -> tuple[Path, Path]:
    """Write the images of the drone's origin as both cameras' tracks."""
    files = work / "cam1.csv", work / "cam2.csv"
    for file, clock, px in zip(files, (Clock(), truth.clock), truth.centres_px, strict=True):
        save_track(file, true_track(truth.times_s, px, clock, config.resolution, _OF_TRUTH))
    return files


def true_track(
    times_s: Array, centres_px: Array, clock: Clock, resolution: tuple[int, int], every: int
) -> PointTrack:
    """Give the images (n, 2) of the drone's origin at times (n,) as a camera's track.

    The truth's times are camera 1's; `clock` is the camera's own. What is outside its image is left
    out, and all but one in `every` samples.
    """
    centres_px = centres_px + _BETWEEN_S * np.gradient(centres_px, times_s, axis=0)
    inside = np.all((centres_px >= 0.0) & (centres_px <= np.array(resolution) - 1.0), axis=1)
    kept = np.flatnonzero(inside)[::every]
    return PointTrack(clock.cam2_from_cam1(times_s[kept] + _BETWEEN_S), centres_px[kept])
