"""What pairs of event cameras tell: its derivatives, its weight, and that a wrong pair is none."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.clock import Clock
from ssac.estimate import Estimate
from ssac.network.adjustment import border_offsets, known
from ssac.network.graph import Link, factor_of, shared_by
from ssac.network.state import CameraState
from tests.ssac.network.flights import make_flight

DEVIATIONS = np.array([1e-6, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-6])
"""Far below what the flight's sightings tell: 1 us, 0.6 mdeg and 1 ppm."""


def true_pair(flight, a, b, off_s=0.0, turn_rad=0.0):
    """What a pair without errors tells, or with those given."""
    link = flight.link(a, b)
    R = Rotation.from_rotvec([0.0, turn_rad, 0.0]).as_matrix() @ link.R
    skew_ppm = flight.skews_ppm[b] - flight.skews_ppm[a]
    at_s = 8.0 + flight.delays_s[a]  # in the middle of the flight, on a's clock
    clock = Clock(flight.delays_s[b] - flight.delays_s[a] + off_s, skew_ppm, at_s)
    return Link(clock, True, link.cost, R, link.t, np.diag(DEVIATIONS))


@pytest.fixture(scope="module")
def sure():
    """A flight, and the answer where all pairs tell what one without errors would."""
    flight = make_flight(3)
    return flight, flight.solved({pair: true_pair(flight, *pair) for pair in flight.links()})


def test_derivatives_are_those_of_differences() -> None:
    flight = make_flight(3)
    a, b = (
        CameraState(flight.delays_s[k], 1e-5 * k, flight.seen[k].middle_s, 0.0, *flight.poses[k])
        for k in (1, 2)
    )
    pair = replace(true_pair(flight, 1, 2, 1e-3, 1e-2), factor=np.eye(7))
    by_a, by_b, off = pair.rows(a, b)
    rng = np.random.default_rng(0)
    step_a, step_b = (1e-5 * rng.normal(size=state.size) for state in (a, b))
    step_a[1], step_b[1] = 1e-7, -2e-7  # rates
    linear = off - by_a @ step_a - by_b @ step_b
    # Second order in steps of 1e-5, of which some are multiplied by the baseline's inverse.
    assert pair.off(a.moved(step_a), b.moved(step_b)) == pytest.approx(linear, abs=1e-8)


def test_sure_pairs_carry_clocks_and_poses(sure) -> None:
    flight, found = sure
    for k, camera in enumerate(found.cameras[1:], 1):
        # What pairs tell is true and sure: some deviations are left of it.
        assert abs(camera.t_d_s - flight.shown_s(k, camera.t_ref_s)) < 1e-5
        turn = Rotation.from_matrix(camera.R @ flight.poses[k][0].T).magnitude()
        assert turn < 1e-4
        assert camera.t_d_std_s < 1e-5


def test_pairs_count_by_errors_that_last_and_by_the_views_that_they_share(sure) -> None:
    network = replace(sure[1].built[0].network, lasting=8.0)
    offsets, (rows, residuals) = border_offsets(network), known(network)
    for k, ((a, b), pair) in enumerate(network.constraints.items()):
        # Errors last for 8 sightings, and each camera is in two of the three pairs.
        own = slice(7 * k - 22, 7 * k - 15)  # before the last row, which holds the scale
        by_a, by_b, off = pair.rows(network.states[a], network.states[b])
        np.testing.assert_array_equal(rows[own, offsets[a] : offsets[a + 1]], 2.0 * by_a)
        np.testing.assert_array_equal(rows[own, offsets[b] : offsets[b + 1]], 2.0 * by_b)
        np.testing.assert_array_equal(residuals[own], 2.0 * off)


def test_a_pair_that_the_sightings_contradict_is_left_out() -> None:
    flight = make_flight(3)
    links, without = flight.links(), flight.solved()
    links[1, 2] = true_pair(flight, 1, 2, turn_rad=0.2)
    found = flight.solved(links)
    assert not found.built[0].network.constraints
    for mine, other in zip(found.cameras, without.cameras, strict=True):
        assert pytest.approx(other.R) == mine.R


def test_an_estimate_without_its_covariance_tells_nothing_more() -> None:
    whole = Estimate(
        "tangency", t_d_s=1.0, R=np.eye(3), t=np.array([1.0, 0.0, 0.0]), t_ref_s=2.0,
        skew_ppm=3.0, skew_std_ppm=4.0, covariance=np.diag(DEVIATIONS[:6] ** 2),
    )  # fmt: skip
    assert np.diag(factor_of(whole)) == pytest.approx([*DEVIATIONS[:6], 4e-6])
    for missing in ({"covariance": None}, {"skew_std_ppm": 0.0}, {"status": "poor_fit"}):
        assert factor_of(replace(whole, **missing)) is None


def test_pairs_that_share_views_tell_less_than_pairs_that_share_none():
    flight = make_flight()
    pairs = {(a, b): true_pair(flight, a, b) for a, b in combinations(range(4), 2)}
    # Each camera's outline is in three pairs, of six.
    assert shared_by(pairs) == dict.fromkeys(pairs, 3.0)
    assert shared_by({(0, 1): pairs[0, 1], (2, 3): pairs[2, 3]}) == {(0, 1): 1.0, (2, 3): 1.0}
    assert shared_by({(0, 1): pairs[0, 1], (1, 2): pairs[1, 2]}) == {(0, 1): 1.5, (1, 2): 1.5}
    assert shared_by({}) == {}
