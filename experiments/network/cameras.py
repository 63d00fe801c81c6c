"""A seed in; a flight before four event cameras on a half circle, 60 deg apart, and its truth, out.

The sensors are ideal. Recordings are simulated with equal clocks; each camera's offset is added
where its events are written for the estimator.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.recording import Scene, SimConfig
from sim.scene.rig import look_at_rig
from sim.sensor.frames import FrameConfig

Array = NDArray[np.float64]

T_D_S = (0.0, 0.05, -0.23, 0.41)
"""By how much each clock shows more than the first."""

ANGLE_DEG = 60.0
"""From each camera to the next."""

N_CAMERAS = len(T_D_S)


@dataclass(frozen=True)
class FourCameras(SimConfig):
    """The default flight and drone, before four cameras."""

    angle_deg: float = ANGLE_DEG
    frames: FrameConfig = field(default_factory=lambda: FrameConfig(rate_hz=0.0))

    def scene(self, seed: int) -> Scene:
        """Build the default scene, with more cameras: all equal, as are their backgrounds."""
        two = super().scene(seed)
        rig = look_at_rig(
            [self.angle_deg * k for k in range(N_CAMERAS)],
            distance_m=self.distance_m,
            focal_px=self.focal_px,
            resolution=self.resolution,
            principal_point=self.principal_point,
        )
        return Scene(rig, two.backgrounds[:1] * N_CAMERAS, two.drone, two.trajectory)


@dataclass(frozen=True, eq=False)
class Truth:
    """What is true of a flight."""

    times_s: Array  # (n,) camera 1's clock
    positions_m: Array  # (n, 3) of the drone's origin, in the world's frame
    quaternions: Array  # (n, 4) body to world
    centres_px: list[Array]  # of each camera (n, 2): images of the origin
    poses: list[Array]  # of each camera (4, 4): T_k_1, from the first camera's frame


def load_truth(folder: Path) -> Truth:
    """Read a recording's truth."""
    content = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    cameras = [content["cameras"][f"cam{k + 1}"] for k in range(N_CAMERAS)]
    T_1_W = np.array(cameras[0]["T_C_W"])
    return Truth(
        np.array(content["times_s"]),
        np.array(content["drone_position_W_m"]),
        np.array(content["drone_quaternion_W_B_xyzw"]),
        [np.array(camera["drone_px"], np.float64) for camera in cameras],
        [np.array(camera["T_C_W"]) @ np.linalg.inv(T_1_W) for camera in cameras],
    )
