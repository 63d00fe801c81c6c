"""Two cameras that have nothing in common: focal length, centre, lens and size of the image."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ssac import albl, joint, joint_known, ssac, ssac_known
from ssac.camera import Camera, Rig, distort_points
from ssac.config import Config
from ssac.estimate import Estimate
from ssac.events import EVENT_DTYPE
from ssac.track.observation import Observation
from tests.ssac.synthetic import EXACT_PX, Scene, angle_deg, make_scene, rotation_angle_deg

CLEAN = Config(denoise=False)
T_D_S = -0.12
SCENE = make_scene(seed=4, duration_s=12.0)
K1 = np.array([[200.0, 0.0, 173.0], [0.0, 190.0, 130.0], [0.0, 0.0, 1.0]])
K2 = np.array([[330.0, 0.0, 300.0], [0.0, 345.0, 190.0], [0.0, 0.0, 1.0]])
CAMERAS = (
    Camera(K1, 346, 260, intrinsics_std_px=EXACT_PX),
    Camera(K2, 560, 410, "radtan", (-0.12, 0.03, 1e-3, -2e-3), EXACT_PX),
)


def seen_by(scene: Scene, cameras: tuple[Camera, Camera], t_d_s: float) -> list[Observation]:
    """What the cameras record of a cloud of points as large as a drone."""
    rng = np.random.default_rng(9)
    cloud = rng.uniform(-0.2, 0.2, (60, 3))
    cloud -= cloud.mean(axis=0)
    found = []
    poses = ((np.eye(3), np.zeros(3), 0.0), (scene.R, scene.t, t_d_s))
    for camera, (R, t, offset_s) in zip(cameras, poses, strict=True):
        times_s = np.sort(rng.uniform(0.0, scene.duration_s, int(25_000 * scene.duration_s)))
        points = (scene.path(times_s) + cloud[rng.integers(60, size=len(times_s))]) @ R.T + t
        ideal = points @ camera.K.T
        pixels = np.rint(distort_points(camera, ideal[:, :2] / ideal[:, 2:]))
        size = np.array([camera.width, camera.height])
        rays = np.hypot(*points[:, :2].T) / points[:, 2]
        seen = (points[:, 2] > 0.1) & (rays < 1.2) & np.all((pixels >= 0) & (pixels < size), axis=1)
        events = np.zeros(int(seen.sum()), EVENT_DTYPE)
        events["t"] = np.rint(1e6 * (times_s[seen] + offset_s))
        events["x"], events["y"] = pixels[seen].T
        events["p"] = rng.integers(2, size=len(events))
        found.append(Observation(events))
    return found


@pytest.fixture(scope="module")
def seen() -> list[Observation]:
    return seen_by(SCENE, CAMERAS, T_D_S)


def rig(known: bool = False, swapped: bool = False) -> Rig:
    T_2_1 = np.eye(4)
    T_2_1[:3, :3], T_2_1[:3, 3] = SCENE.R, SCENE.t
    one = Rig(*CAMERAS, T_2_1 if known else None)
    return replace(one, cam1=one.cam2, cam2=one.cam1) if swapped else one


def mean_distance_px(found: Estimate) -> float:
    """Mean distance of true pairs, where a lens without distortion shows them, by the F found."""
    points = SCENE.path(np.linspace(1.0, 11.0, 300))
    p1 = points @ K1.T
    p2 = (points @ SCENE.R.T + SCENE.t) @ K2.T
    lines: NDArray[np.float64] = (p2 / p2[:, 2:]) @ found.F
    return float(
        np.mean(np.abs(np.sum(lines * (p1 / p1[:, 2:]), axis=1)) / np.hypot(*lines[:, :2].T))
    )


@pytest.mark.parametrize(
    ("method", "offset_ms", "pose_deg"),
    [(ssac, 2.0, 1.0), (albl, 4.0, 2.0), (joint, 1.0, 0.5), (ssac_known, 2.0, 0.0),
     (joint_known, 1.0, 0.0)],
)  # fmt: skip
def test_each_camera_has_its_own_intrinsics(seen, method, offset_ms, pose_deg) -> None:
    """Marks several times the errors of such a flight: wrong intrinsics are tens of pixels off."""
    found = method(*seen, rig(known=pose_deg == 0.0), CLEAN)
    assert found.status == "ok"
    assert 1e3 * found.t_d_s == pytest.approx(1e3 * T_D_S, abs=offset_ms)
    assert rotation_angle_deg(found.R, SCENE.R) <= pose_deg + 1e-5  # a cosine's rounding
    assert angle_deg(found.t, SCENE.t) <= pose_deg + 1e-5
    # Clouds of points have their mean off by a part of a pixel; what is told of the fit agrees.
    assert mean_distance_px(found) < 2.0
    assert found.d_avg_px < 2.0


def test_swapping_unequal_cameras_swaps_offset_and_pose_and_leaves_deviations(seen) -> None:
    there = joint(*seen, rig(), CLEAN)
    back = joint(*seen[::-1], rig(swapped=True), CLEAN)
    assert back.t_d_s == pytest.approx(-there.t_d_s, abs=there.t_d_std_s)
    assert rotation_angle_deg(back.R, there.R.T) < there.r_std_deg
    # The samples are others, and so are the residuals that deviations are read off.
    # The direction of t, seen from the other camera, has errors of R beside its own.
    assert back.t_d_std_s == pytest.approx(there.t_d_std_s, rel=0.1)
    assert back.r_std_deg == pytest.approx(there.r_std_deg, rel=0.1)
