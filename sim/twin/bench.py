"""A configuration and a seed in; the scene on the bench, and where the wire is held, out.

Two cameras half a metre from a printed drone that hangs on a wire. What stays the same in all
recordings of a set-up, as the cameras' places and lenses and the walls behind, is drawn by the
set-up's own seed; a recording's seed draws the motion.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sim.errors import SimError
from sim.recording import Scene, SimConfig, two_view_rig_of
from sim.scene.background import uniform_background
from sim.scene.camera import Camera
from sim.scene.rig import Rig
from sim.seeds import generator
from sim.sensor.frames import FrameConfig
from sim.twin.pendulum import Hanging, PendulumConfig, hanging
from sim.twin.printed import SIZE_M, printed
from sim.twin.wall import MEAN_LUMINANCE, wall

FloatArray = NDArray[np.float64]

FOCAL_PX = 300.0  # a lens of 5.5 mm over pixels of 18.5 um
DISTORTION = (-0.35, 0.13, 5e-4, -3e-4)  # of such a lens: k1, k2, p1, p2
_FOCAL_STD, _CENTRE_STD_PX, _DISTORTION_STD = 0.01, 3.0, 0.01  # of the lenses of a series
_AIM_STD_DEG = 2.0  # of a camera's attitude about each axis, put up by hand

# Branches of the seeds, beside those of `sim.recording` and `sim.disturb`.
_MOTION_STREAM, _CAMERA_STREAM, _WALL_STREAM = 30, 31, 32


@dataclass(frozen=True)
class TwinConfig(SimConfig):
    """A recording on the bench; `spline` gives its duration alone."""

    frames: FrameConfig = field(default_factory=lambda: FrameConfig(25.0, 0.01))
    focal_px: float = FOCAL_PX
    distortion_model: str = "radtan"
    distortion_coeffs: tuple[float, ...] = DISTORTION
    distances_m: tuple[float, float] = (0.45, 0.5)  # of the cameras from what they look at
    setup_seed: int = 0
    pendulum: PendulumConfig = field(default_factory=PendulumConfig)
    textured: bool = True  # walls behind; else an even grey
    turning: bool = True  # the drone turns and rocks; else it hangs level and looks ahead

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(np.isfinite(one) and one > 0.0 for one in self.distances_m):
            raise SimError(f"distances_m must be two positive numbers, got {self.distances_m}")
        if self.distortion_model == "equidistant":
            raise SimError("the bench has lenses of the model radtan or none, got equidistant")

    def scene(self, seed: int) -> Scene:
        """Build what is filmed with a seed."""
        rig = bench_rig(self)
        trajectory = hanging_of(self, seed).trajectory
        if not self.turning:
            trajectory = replace(trajectory, attitude=_level)
        drone = printed(SIZE_M if self.drone_size_m is None else self.drone_size_m)
        return Scene(rig, bench_walls(self, rig), drone, trajectory)


def hanging_of(config: TwinConfig, seed: int) -> Hanging:
    """Draw the motion of a recording."""
    rng = generator(seed, _MOTION_STREAM)
    return hanging(config.pendulum, config.spline.duration_s, rng)


def bench_rig(config: TwinConfig) -> Rig:
    """Put up the cameras of a set-up: none is quite where it should be, and no lens like another.

    The lines of sight are `angle_deg` apart all the same, as that is what was measured: a camera
    is turned about the point that it looks at, not about itself, but for its roll.
    """
    ideal = two_view_rig_of(config).cameras
    rng = generator(config.setup_seed, _CAMERA_STREAM)
    cameras = [
        _put_up(camera, distance_m, rng)
        for camera, distance_m in zip(ideal, config.distances_m, strict=True)
    ]
    return Rig(tuple(cameras))


def bench_walls(config: TwinConfig, rig: Rig) -> tuple[NDArray[np.float32], ...]:
    """Draw what stands behind in the view of each camera."""
    if not config.textured:
        return tuple(uniform_background(camera, MEAN_LUMINANCE) for camera in rig.cameras)
    rng = generator(config.setup_seed, _WALL_STREAM)
    return tuple(wall(camera.width, camera.height, rng) for camera in rig.cameras)


def _put_up(camera: Camera, distance_m: float, rng: np.random.Generator) -> Camera:
    focal = camera.K[0, 0] * (1.0 + _FOCAL_STD * rng.standard_normal())
    K = np.diag([focal, focal, 1.0])
    K[:2, 2] = camera.K[:2, 2] + _CENTRE_STD_PX * rng.standard_normal(2)
    spread = 1.0 + _DISTORTION_STD * rng.standard_normal()
    coeffs = tuple(float(spread * value) for value in camera.distortion_coeffs)
    T_C_W = camera.T_C_W.copy()
    roll_rad = np.deg2rad(_AIM_STD_DEG) * rng.standard_normal()
    T_C_W[:3, :3] = Rotation.from_rotvec([0.0, 0.0, roll_rad]).as_matrix() @ T_C_W[:3, :3]
    T_C_W[:3, 3] = (0.0, 0.0, distance_m)
    return replace(camera, K=K, distortion_coeffs=coeffs, T_C_W=T_C_W)


def _level(times_s: FloatArray) -> Rotation:
    """Give the attitude of what neither turns nor rocks, at each time (n,) [s]."""
    return Rotation.from_matrix(np.broadcast_to(np.eye(3), (len(times_s), 3, 3)))
