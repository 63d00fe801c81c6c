"""The bench of the paper's small-scale experiment: a printed drone on a wire before two cameras.

The cameras are half a metre from the drone. What stays the same in all recordings of a set-up, such
as the cameras' attitudes and lenses and the walls behind, is drawn by the set-up's own seed; a
recording's seed draws the motion.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from sim.arrays import Float32Array, FloatArray
from sim.errors import SimError
from sim.recording import Scene, SimConfig, two_view_rig_of
from sim.scene.background import uniform_background
from sim.scene.drone import Drone, check_size, hull, join, moved, prism, solid
from sim.scene.rig import Camera, Rig
from sim.seeds import generator
from sim.sensor.frames import FrameConfig
from sim.twin.pendulum import Hanging, PendulumConfig, hanging

SIZE_M = 0.03  # of the paper's model, 3 x 3 x 1 cm
HEIGHT = 1.0 / 3.0  # share of the size, from the feet to the eye by which the model hangs
ALBEDO = 0.08  # of dark grey filament

# In units of the size; a disc stands for a rotor, as printed blades would break.
_DISC_RADIUS, _DISC_THICKNESS, _DISC_Z = 0.165, 0.035, 0.08
_CORNER = 0.5 - _DISC_RADIUS
_ARM_WIDTH, _ARM_HEIGHT = 0.07, 0.06
_FOOT_RADIUS, _EYE_RADIUS = 0.03, 0.05


def printed(size_m: float = SIZE_M) -> Drone:
    """Build the model: body, canopy, four arms with discs and feet, and the eye on top.

    It is one part. Its origin is the middle of its bounding box; its size [m] is length and width.
    """
    check_size(size_m)
    eye = prism(6, _EYE_RADIUS, 0.5 * HEIGHT - 0.09)
    pieces = [_body(), moved(eye, (0.0, 0.0, 0.5 * (0.5 * HEIGHT + 0.09)))]
    for x_sign, y_sign in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
        pieces += _arm(np.array([x_sign * _CORNER, y_sign * _CORNER, 0.0]))
    return Drone((join([solid(piece, ALBEDO) for piece in pieces], size_m),), size_m)


def _body() -> trimesh.Trimesh:
    """Return the hull of floor, belt and roof, each a rectangle: longer in front than behind."""
    rectangles = ((-0.16, 0.18, 0.1, -0.08), (-0.2, 0.24, 0.13, 0.0), (-0.12, 0.1, 0.07, 0.11))
    return hull(
        [
            (x, side * half_width, z)
            for back, front, half_width, z in rectangles
            for x in (back, front)
            for side in (-1, 1)
        ]
    )


def _arm(corner: FloatArray) -> list[trimesh.Trimesh]:
    """Return an arm out to a corner, its disc, and the foot below that."""
    length = float(np.linalg.norm(corner))
    box = trimesh.creation.box((length, _ARM_WIDTH, _ARM_HEIGHT))
    arm = moved(box, 0.5 * corner, yaw_rad=float(np.arctan2(corner[1], corner[0])))
    disc = prism(12, _DISC_RADIUS, _DISC_THICKNESS)
    foot = prism(4, _FOOT_RADIUS, _DISC_Z + 0.5 * HEIGHT)
    up, down = (np.array([0.0, 0.0, z]) for z in (_DISC_Z, 0.5 * (_DISC_Z - 0.5 * HEIGHT)))
    return [arm, moved(disc, corner + up), moved(foot, corner + down)]


MEAN_LUMINANCE = 0.4
SPOTS_PX = (6, 12, 24, 48)  # grain of the plaster, from fine to coarse
SPOTS_STD = 0.12  # of the plaster's log luminance
N_THINGS = 9  # posters, shelves, cables and sockets on the wall
THINGS_STD = 0.35  # of the logarithm of their luminance over the wall's
DEFOCUS_PX = 2.0  # deviation of the Gaussian that blurs what lies far behind the focus
_LOW, _HIGH = 0.05, 0.95


def wall(width: int, height: int, rng: np.random.Generator) -> Float32Array:
    """Draw the luminance (height, width) of a wall with plaster, uneven light, and things on it."""
    level = np.full((height, width), np.log(MEAN_LUMINANCE))
    level += SPOTS_STD * _spots(width, height, rng)
    for _ in range(N_THINGS):
        x, y = rng.uniform(0.0, width), rng.uniform(0.0, height)
        wide, high = np.exp(rng.uniform(np.log(4.0), np.log(0.5 * min(width, height)), 2))
        box = (slice(max(0, int(y - high / 2)), int(y + high / 2) + 1),
               slice(max(0, int(x - wide / 2)), int(x + wide / 2) + 1))  # fmt: skip
        level[box] += THINGS_STD * rng.standard_normal()
    slope = rng.normal(0.0, 0.3, 2)  # of the logarithm over the view: a lamp stands to one side
    rows, columns = np.indices((height, width), sparse=True)
    level += slope[0] * (columns / width - 0.5) + slope[1] * (rows / height - 0.5)
    light: FloatArray = np.exp(level)
    blurred = cv2.GaussianBlur(light, (0, 0), DEFOCUS_PX, borderType=cv2.BORDER_REFLECT)
    luminance: Float32Array = np.clip(blurred, _LOW, _HIGH).astype(np.float32)
    return luminance


def _spots(width: int, height: int, rng: np.random.Generator) -> FloatArray:
    """Sum smooth random images of several grains, to a deviation of 1."""
    total: FloatArray = np.zeros((height, width))
    for cell_px in SPOTS_PX:
        coarse = rng.standard_normal((height // cell_px + 3, width // cell_px + 3))
        fine = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        total = total + np.asarray(fine, np.float64)
    return np.asarray(total / total.std(), np.float64)


FOCAL_PX = 300.0  # a lens of 5.5 mm over pixels of 18.5 um
DISTORTION = (-0.35, 0.13, 5e-4, -3e-4)  # of such a lens: k1, k2, p1, p2
_FOCAL_STD, _CENTRE_STD_PX, _DISTORTION_STD = 0.01, 3.0, 0.01  # over the lenses of a series
_AIM_STD_DEG = 2.0  # of the roll of a camera that is put up by hand

# Branches of the seeds, beside those of `sim.recording` and `sim.disturb`.
_MOTION_STREAM, _CAMERA_STREAM, _WALL_STREAM = 30, 31, 32


@dataclass(frozen=True)
class TwinConfig(SimConfig):
    """A recording on the bench; of `spline`, only the duration counts."""

    frames: FrameConfig = field(default_factory=lambda: FrameConfig(25.0, 0.01))
    focal_px: float = FOCAL_PX
    distortion_model: str = "radtan"
    distortion_coeffs: tuple[float, ...] = DISTORTION
    distances_m: tuple[float, float] = (0.45, 0.5)  # of the cameras from the point they look at
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
        rig, rng = bench_rig(self), generator(self.setup_seed, _WALL_STREAM)
        if self.textured:
            walls = tuple(wall(camera.width, camera.height, rng) for camera in rig.cameras)
        else:
            walls = tuple(uniform_background(camera, MEAN_LUMINANCE) for camera in rig.cameras)
        trajectory = hanging_of(self, seed).trajectory
        if not self.turning:
            trajectory = replace(
                trajectory, attitude=lambda times_s: Rotation.identity(len(times_s))
            )
        drone = printed(SIZE_M if self.drone_size_m is None else self.drone_size_m)
        return Scene(rig, walls, drone, trajectory)


def hanging_of(config: TwinConfig, seed: int) -> Hanging:
    """Draw the motion of the model in the recording of a seed."""
    rng = generator(seed, _MOTION_STREAM)
    return hanging(config.pendulum, config.spline.duration_s, rng)


def bench_rig(config: TwinConfig) -> Rig:
    """Put up the cameras of a set-up, with random errors of roll and of the lenses.

    The lines of sight are exactly `angle_deg` apart, as that is what was measured: each camera
    looks at the origin, at its own distance of `distances_m`.
    """
    rng = generator(config.setup_seed, _CAMERA_STREAM)
    ideal = two_view_rig_of(config).cameras
    pairs = zip(ideal, config.distances_m, strict=True)
    return Rig(tuple(_put_up(camera, distance_m, rng) for camera, distance_m in pairs))


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
