import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.lab.score import Truth, angle_between_deg, pose_score, rotation_angle_deg, scored
from ssac.estimate import Estimate
from ssac.geometry.pose import moved_pose, pose_step


def turn(angle_deg, axis=(0.0, 0.6, 0.8)):
    return Rotation.from_rotvec(np.deg2rad(angle_deg) * np.array(axis)).as_matrix()


@pytest.mark.parametrize("angle_deg", [0.0, 1e-7, 0.3, 90.0, 179.9999])
def test_rotation_angle(angle_deg):
    # Round-off; an arc cosine would lose angles below 1e-6 deg and near 180 deg.
    assert rotation_angle_deg(turn(angle_deg)) == pytest.approx(angle_deg, abs=1e-10, rel=1e-9)


def test_angle_between_vectors_minds_the_sign_and_not_the_length():
    a = np.array([1.0, 2.0, -0.5])
    assert angle_between_deg(a, 3.0 * a) == pytest.approx(0.0, abs=1e-10)
    assert angle_between_deg(a, -a) == pytest.approx(180.0)
    assert angle_between_deg(a, turn(1e-6, (0.0, 0.0, 1.0)) @ a) == pytest.approx(9.76e-7, rel=1e-2)


def test_errors_have_their_units_and_directions_and_what_is_not_given_is_nan():
    R, t = turn(90.0), np.array([1.0, 0.0, 0.0])
    estimate = Estimate("m", t_d_s=0.0498, R=R @ turn(0.5), t=-t)
    without = Estimate("m", t_d_s=0.06)
    for one, errors in ((estimate, (0.2, 0.5, 180.0)), (without, (10.0, np.nan, np.nan))):
        found = scored(one, Truth(0.05, R, t))
        of = [found[name] for name in ("t_d_error_ms", "r_error_deg", "t_error_deg")]
        assert of == pytest.approx(errors, nan_ok=True)


def test_a_pose_is_scored_against_its_covariance():
    step = np.array([0.002, -0.003, 0.001, 0.004, -0.002])
    R, t = turn(70.0), np.array([0.6, 0.0, 0.8])
    R_true, t_true = moved_pose(R, t, step)
    sigmas = np.array([1e-4, 1e-3, 1e-3, 2e-3, 1e-3, 4e-3])
    estimate = Estimate("m", t_d_s=0.05, R=R, t=t, covariance=np.diag(sigmas**2))
    pose = pose_score(estimate, R_true, t_true)
    expected = -step / sigmas[1:]
    found = [pose[f"{name}_normalised"] for name in ("r_x", "r_y", "r_z", "t_1", "t_2")]
    # t moves along its tangent and is then normalised: an error of the third power of 0.005.
    assert found == pytest.approx(list(expected), abs=1e-3)
    for name, of in (("r", slice(3)), ("t", slice(3, None))):
        assert pose[f"{name}_mahalanobis"] == pytest.approx(np.linalg.norm(expected[of]), abs=1e-3)
        std_deg = np.rad2deg(np.linalg.norm(sigmas[1:][of]))
        assert pose[f"{name}_std_deg"] == pytest.approx(std_deg)
    assert np.linalg.norm(pose_step(R, t, R, -t)[3:]) == pytest.approx(np.pi)  # opposite directions
    without = pose_score(Estimate("m", t_d_s=0.05, R=R, t=t), R_true, t_true)
    assert np.isnan(list(without.values())).all()
