"""A flat plate before cameras round it: perspective, drawn exactly, beside what is told of it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.track.body import View, perspective_shifts, second_moments

FOCAL_PX, DISTANCE_M = 200.0, 5.0
N = 25  # times


def plate() -> np.ndarray:
    """Points all over a plate of 0.5 x 0.3 m, whose middle is the origin."""
    u, v = np.meshgrid(np.linspace(-0.25, 0.25, 81), np.linspace(-0.15, 0.15, 49))
    return np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])


def seen_by(angle_deg: float, turns: Rotation, size: float) -> tuple[View, np.ndarray]:
    """A camera's view of the plate as it turns, and true centres less images of its middle."""
    R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    t = np.array([0.4, -0.3, DISTANCE_M])
    spreads, shifts = np.zeros((N, 3)), np.zeros((N, 2))
    for i, turn in enumerate(turns):
        local = turn.apply(size * plate()) @ R.T + t
        image = FOCAL_PX * local[:, :2] / local[:, 2:]
        weights = local[:, 2] ** -3.0  # of the area that a part of a plane has in an image
        centre = weights @ image / weights.sum()
        off = image - centre
        covariance = (off * weights[:, None]).T @ off / weights.sum()
        spreads[i] = covariance[0, 0], covariance[0, 1], covariance[1, 1]
        shifts[i] = centre - FOCAL_PX * t[:2] / t[2]
    points = np.tile(t, (N, 1))
    return View(R, np.full(2, FOCAL_PX), points, spreads), shifts


def slowly_turning() -> Rotation:
    """Turns of 3 deg in all, about a tilted attitude: smoothing leaves them as they are."""
    angles = np.linspace(-1.5, 1.5, N)
    return Rotation.from_euler("xyz", np.column_stack([20.0 + angles, 35.0 + angles, angles]), True)


def test_second_moments_are_those_of_the_object() -> None:
    turns = slowly_turning()
    views = [seen_by(angle, turns, 0.1)[0] for angle in (0.0, 60.0, 120.0, 180.0)]
    found = second_moments(views, 1.0)
    flat = 0.01 * np.cov(plate().T, bias=True)
    true = turns.as_matrix() @ flat @ turns.as_matrix().transpose(0, 2, 1)
    # Perspective's own share is the size over the distance, 1 %, and smoothing's at the ends.
    assert found[2:-2] == pytest.approx(true[2:-2], abs=0.03 * np.trace(flat))


@pytest.mark.parametrize("size", [1.0, 0.3])
def test_shifts_are_those_of_a_plate(size: float) -> None:
    turns = slowly_turning()
    told = [seen_by(angle, turns, size) for angle in (0.0, 60.0, 120.0, 180.0)]
    moments = second_moments([view for view, _ in told], 1.0)
    largest = max(np.abs(true).max() for _, true in told)
    for view, true in told:
        # The next order, of the size over the distance, is left: some 5 % of the largest shift.
        assert perspective_shifts(view, moments)[2:-2] == pytest.approx(
            true[2:-2], abs=0.1 * largest
        )


def test_two_views_tell_no_moments() -> None:
    turns = slowly_turning()
    views = [seen_by(angle, turns, 1.0)[0] for angle in (0.0, 60.0)]
    assert np.isnan(second_moments(views, 1.0)).all()
