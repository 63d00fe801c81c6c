"""A flight's number in; its simulated recording, its truth and its RTK out.

Two DAVIS346 with 8 mm lenses 20 m apart, and a third 20 m further on; a drone of 0.5 m some 15 to
60 m away. The third is the second camera of another recording of the same flight. Clouds drift
behind; what they make each camera see is added to what it recorded before an even sky.
"""

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sim.disturb import View, clouds
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig
from sim.seeds import generator
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.clock import Clock
from ssac.network.tum import Path as SpacePath

Array = NDArray[np.float64]

N_FLIGHTS = 10
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


@dataclass(frozen=True, eq=False)
class Truth:
    """What is true of a flight."""

    times_s: Array  # (n,) camera 1's clock
    positions_m: Array  # (n, 3) of the drone's origin, in the world's frame
    quaternions: Array  # (n, 4) body to world
    centres_px: tuple[Array, Array]  # (n, 2) images of the origin, NaN behind the camera
    R: Array  # (3, 3) x2 = R x1 + t
    t: Array  # (3,) of length 1
    baseline_m: float
    clock: Clock  # camera 2's


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


def load_truth(folder: Path, t_d_s: float = T_D_S) -> Truth:
    """Read a recording's truth, with another offset of camera 2's clock."""
    content = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    cam1, cam2 = (
        np.array(content["cameras"][name]["drone_px"], np.float64) for name in ("cam1", "cam2")
    )
    return Truth(
        np.array(content["times_s"]),
        np.array(content["drone_position_W_m"]),
        np.array(content["drone_quaternion_W_B_xyzw"]),
        (cam1, cam2),
        np.array(content["R"]),
        np.array(content["t"]),
        float(content["baseline_m"]),
        Clock(t_d_s, content["skew_ppm"], content["t_ref_s"]),
    )


def rtk_of(truth: Truth, flight: int) -> SpacePath:
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


@lru_cache(maxsize=3)  # of one flight, whose kinds are estimated one after the other
def clouds_of(
    flight: int, camera: int, size_px: tuple[int, int], duration_s: float
) -> NDArray[Any]:
    """Give the events of the clouds that a camera, from 0 on, sees; times of the scene."""
    view = View(*size_px, duration_s)
    return clouds(view, CLOUDS_PX_S, generator(seed_of(flight), _STREAM, 2, camera))


def calibrated(config: SimConfig, flight: int) -> tuple[SimConfig, ...]:
    """Give the three cameras' intrinsics as a calibration would: with its errors."""
    rng = np.random.default_rng([_STREAM, seed_of(flight), 1])
    cameras = []
    for _ in range(3):
        focal = 1.0 + rng.normal(0.0, FOCAL_STD)
        du_px, dv_px = rng.normal(0.0, CENTRE_STD_PX, 2)
        u_px, v_px = config.principal_point
        centre = (float(u_px + du_px), float(v_px + dv_px))
        cameras.append(
            replace(config, focal_px=float(config.focal_px * focal), principal_point=centre)
        )
    return tuple(cameras)
