"""Two synthetic cameras' tracks or events of known geometry, independent of the simulator.

A cloud of points flies along a random spline in front of two cameras. Each point of the cloud emits
events at random instants at the pixel onto which it projects.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from ssac import EVENT_DTYPE
from ssac.camera import Camera, Rig, distort_points
from ssac.track.clean import Clean

WIDTH, HEIGHT, FOCAL_PX = 346, 260, 200.0
DISTANCE_M = 5.0  # from each camera to the point both look at
K = np.array([[FOCAL_PX, 0.0, 173.0], [0.0, FOCAL_PX, 130.0], [0.0, 0.0, 1.0]])
EXACT_PX = (0.0, 0.0, 0.0, 0.0)  # standard deviations of exact intrinsics
CAMERA = Camera(K, WIDTH, HEIGHT, intrinsics_std_px=EXACT_PX)
K2 = np.array([[250.0, 0.0, 165.0], [0.0, 235.0, 148.0], [0.0, 0.0, 1.0]])
OTHER = Camera(K2, 340, 290, "radtan", (-0.12, 0.03, 0.001, -0.0015), EXACT_PX)
"""A camera unlike CAMERA in focal lengths, centre, lens and size."""


@dataclass(frozen=True)
class Scene:
    """One flight before two cameras; all times are camera 1's."""

    R: np.ndarray  # (3, 3), x2 = R x1 + t
    t: np.ndarray  # (3,) [m]
    path: BSpline  # time [s] -> position of the object in camera 1's frame [m]
    duration_s: float
    cam2: Camera = CAMERA

    @property
    def rig(self):
        T_2_1 = np.eye(4)
        T_2_1[:3, :3], T_2_1[:3, 3] = self.R, self.t
        return Rig(CAMERA, self.cam2, T_2_1)

    @property
    def unknown_rig(self):
        return Rig(CAMERA, self.cam2)


def make_scene(seed, angle_deg=90.0, duration_s=20.0):
    """A scene with camera 2 turned about the vertical axis by `angle_deg`."""
    rng = np.random.default_rng(seed)
    angle = np.deg2rad(angle_deg)
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    target = np.array([0.0, 0.0, DISTANCE_M])
    t = target - R @ target  # both cameras see the target at (0, 0, DISTANCE_M)
    # Knots 0.4 s apart and a multiplier of 4.5 m: about 180 px/s, in both views 94 % of the time.
    knots = 0.4 * np.arange(-5.0, duration_s / 0.4 + 6.0)
    control = target + rng.uniform(-4.5, 4.5, (len(knots) - 6, 3)) * [1.0, 0.7, 0.8]
    return Scene(R, t, BSpline(knots, control, 5), duration_s)


def project(points_m, K=K):
    """Ideal pixel coordinates of points (..., 3) in a camera's own frame [m]."""
    homogeneous = points_m @ K.T
    return homogeneous[..., :2] / homogeneous[..., 2:]


def track_pair(scene, times_s):
    """The object's true image positions (N, 2) [px] in both views at the same instants."""
    points_1 = scene.path(times_s)
    return project(points_1), project(points_1 @ scene.R.T + scene.t, scene.cam2.K)


def make_events(scene, seed, t_d_s=0.0, rate_hz=25_000.0, size_m=0.8):
    """Events of both cameras; camera 2's clock reads `t_d_s` more than camera 1's."""
    rng = np.random.default_rng((seed, 1))
    cloud = rng.uniform(-size_m / 2, size_m / 2, (60, 3))
    cloud -= cloud.mean(axis=0)
    streams = []
    poses = (np.eye(3), np.zeros(3), 0.0), (scene.R, scene.t, t_d_s)
    for (R, t, offset_s), camera in zip(poses, (CAMERA, scene.cam2), strict=True):
        n = rng.poisson(rate_hz * scene.duration_s)
        times_s = np.sort(rng.uniform(0.0, scene.duration_s, n))
        points = (scene.path(times_s) + cloud[rng.integers(len(cloud), size=n)]) @ R.T + t
        in_front = points[:, 2] > 0.1
        points_px = distort_points(camera, project(points[in_front], camera.K))
        size = camera.width, camera.height
        events = events_at(times_s[in_front] + offset_s, points_px, size)
        events["p"] = rng.integers(2, size=len(events))
        streams.append(events)
    return streams[0], streams[1]


def events_at(times_s, points_px, size=(WIDTH, HEIGHT)):
    """OFF events at the pixels of those points (n, 2) that are in view."""
    pixels = np.rint(points_px)
    seen = np.all((pixels >= 0) & (pixels < size), axis=1)
    events = np.zeros(int(seen.sum()), EVENT_DTYPE)
    events["t"] = np.rint(times_s[seen] * 1e6)
    events["x"], events["y"] = pixels[seen].T
    return events


def clocked(events, clock):
    """Events of a clock that shows clock(t) [us] in place of t."""
    moved = events.copy()
    moved["t"] = np.rint(clock(events["t"].astype(np.float64)))
    return moved


def denoised(events):
    """Wrap events without noise as if they had been denoised."""
    return Clean(events, camera=CAMERA, denoised=True, n_recorded=len(events))


def angle_deg(a, b):
    cosine = a @ b / np.linalg.norm(a) / np.linalg.norm(b)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def rotation_angle_deg(R, S):
    """Angle of the rotation R' S."""
    return float(np.degrees(np.arccos(np.clip((np.trace(R.T @ S) - 1.0) / 2.0, -1.0, 1.0))))
