"""The similarity between two sets of points: laws, least squares, and what it cannot know."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.errors import SsacError
from ssac.network.align import Similarity, similarity

RNG = np.random.default_rng(3)
POINTS = RNG.normal(size=(40, 3)) * (5.0, 2.0, 1.0)
TRUE = Similarity(2.5, Rotation.from_rotvec([0.4, -2.0, 1.0]).as_matrix(), np.array([3.0, -7.0, 1]))


def _same(a, b):
    assert a.scale == pytest.approx(b.scale, rel=1e-9)  # rounding
    np.testing.assert_allclose(a.R, b.R, atol=1e-9)
    np.testing.assert_allclose(a.t, b.t, atol=1e-8)


def test_exact_points_give_the_similarity_back():
    _same(similarity(POINTS, TRUE.apply(POINTS)), TRUE)


def test_points_in_a_plane_are_turned_and_not_mirrored():
    flat = POINTS * (1.0, 1.0, 0.0)
    found = similarity(flat, TRUE.apply(flat))
    _same(found, TRUE)
    mirrored = similarity(POINTS, POINTS * (1.0, 1.0, -1.0))
    assert np.linalg.det(mirrored.R) == pytest.approx(1.0)


def test_inverse_and_chain_are_those_of_a_group():
    _same(TRUE.after(TRUE.inverse()), Similarity(1.0, np.eye(3), np.zeros(3)))
    other = similarity(POINTS, POINTS @ TRUE.R)
    np.testing.assert_allclose(other.after(TRUE).apply(POINTS), other.apply(TRUE.apply(POINTS)))


def test_no_similarity_near_by_has_less_squares():
    target = TRUE.apply(POINTS) + RNG.normal(0.0, 0.3, POINTS.shape)

    def cost(fit):
        return np.sum((fit.apply(POINTS) - target) ** 2)

    found = similarity(POINTS, target)
    for _ in range(50):
        turn = Rotation.from_rotvec(RNG.normal(0.0, 0.01, 3)).as_matrix()
        scale, shift = found.scale * RNG.normal(1.0, 0.01), RNG.normal(0.0, 0.01, 3)
        assert cost(Similarity(scale, turn @ found.R, found.t + shift)) > cost(found)


def test_a_known_scale_stays_one():
    assert similarity(POINTS, TRUE.apply(POINTS), with_scale=False).scale == 1.0


@pytest.mark.parametrize("points", [POINTS * (1.0, 0.0, 0.0), POINTS * 0.0, POINTS[:2]])
def test_a_line_or_a_point_does_not_tell_a_turn(points):
    for pair in ((points, POINTS[: len(points)]), (POINTS[: len(points)], points)):
        with pytest.raises(SsacError, match="lie on a line"):
            similarity(*pair)
