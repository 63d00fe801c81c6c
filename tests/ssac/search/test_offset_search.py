"""The search on cost curves known in closed form, and its candidates."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.config import Config
from ssac.rules import SearchRules
from ssac.search import offset_search
from ssac.search.two_views import TwoViews
from ssac.track.motion import object_motion
from tests.ssac.synthetic import make_events, make_scene

RULES = SearchRules()
OFFSETS_S = np.arange(-1000, 1001) * 1e-3


def searched(cost, offsets_s=OFFSETS_S, coarsest=20, returns_s=None):
    return offset_search.coarse_to_fine_search(cost, cost, offsets_s, coarsest, RULES, returns_s)


def rounded_v(centre_s):
    """1.3 px per 10 ms out to 100 ms around the centre, then a plateau: the paper's Fig. 5."""

    def cost(t_d_s):
        distance_s = np.abs(t_d_s - centre_s)
        return np.minimum(np.sqrt(0.3**2 + (130.0 * distance_s) ** 2), 13.0)

    return cost


@pytest.fixture(scope="module")
def views():
    scene = make_scene(seed=0, duration_s=4.0)
    events1, events2 = make_events(scene, seed=0, t_d_s=0.25)
    motions = object_motion(events1, scene.rig.cam1), object_motion(events2, scene.rig.cam2)
    return TwoViews(*motions, scene.rig, Config())


@pytest.mark.parametrize("centre_s", [-0.4321, 0.0, 0.00037, 0.777])
def test_the_minimum_is_found_between_candidates(centre_s):
    for search in (
        offset_search.exhaustive_search(rounded_v(centre_s), OFFSETS_S),
        searched(rounded_v(centre_s)),
    ):
        # A parabola through 12 points of another curve: 3 us; 10 us is the resolution promised.
        assert search.t_d_s == pytest.approx(centre_s, abs=5e-6)
        assert not search.at_bound


def test_what_lies_far_from_the_minimum_does_not_move_it():
    def cost(t_d_s):  # one side of the valley ends 10 ms from its bottom
        return np.where(t_d_s > 0.21, 1.4, rounded_v(0.2)(t_d_s))

    # The parabola reaches 6 ms to each side; to 20 ms and more it is drawn to the flat side by far
    # more than 10 us, the resolution promised.
    assert searched(cost).t_d_s == pytest.approx(0.2, abs=1e-5)


def test_coarse_to_fine_tries_a_tenth_of_the_candidates():
    search = searched(rounded_v(0.1))
    assert len(search.candidates_s) < len(OFFSETS_S) / 10
    assert np.all(np.diff(search.candidates_s) > 0.0)
    assert np.array_equal(search.d_avg_px, rounded_v(0.1)(search.candidates_s))


@pytest.mark.parametrize("centre_s", [-1.5, 1.2])
def test_a_minimum_outside_the_interval_is_reported_at_its_bound(centre_s):
    def cost(t_d_s):
        return np.abs(t_d_s - centre_s)

    assert searched(cost).at_bound


def test_costs_without_a_number_are_passed_over():
    def cost(t_d_s):
        return np.where(t_d_s < 0.0, np.nan, rounded_v(0.2)(t_d_s))

    assert searched(cost).t_d_s == pytest.approx(0.2, abs=5e-6)
    nothing = searched(lambda t: t * np.nan)
    assert np.isnan(nothing.t_d_s)
    assert np.isnan(searched(cost, np.empty(0)).t_d_s)


@pytest.mark.parametrize("n", [1, 2, 3, 8])
@pytest.mark.parametrize("coarsest", [5, 7, 13, 20])
def test_an_interval_shorter_than_a_step_is_searched(n, coarsest):
    """Bug: no step from the coarse minimum reached another candidate, and the search fell over."""
    offsets_s = 0.2 + 0.001 * np.arange(n)
    search = searched(rounded_v(0.2), offsets_s, coarsest)
    assert search.t_d_s == offset_search.exhaustive_search(rounded_v(0.2), offsets_s).t_d_s
    assert search.at_bound


def test_a_return_of_the_path_where_no_cost_is_known_is_no_rival():
    """Bug: it fell over where a path repeats itself, and too few samples are valid a lag away."""

    def cost(t_d_s):
        return np.where(t_d_s > 0.45, np.nan, rounded_v(0.2)(t_d_s))

    search = searched(cost, returns_s=np.array([0.4]))
    assert search.t_d_s == pytest.approx(0.2, abs=5e-6)
    assert (
        len(offset_search.valleys(search.candidates_s, search.d_avg_px, search.t_d_s, RULES)) == 1
    )


def test_candidates_keep_half_of_the_longest_overlap(views):
    near, far = (
        offset_search.candidate_offsets(replace(views, config=Config(interval_s=interval_s)))
        for interval_s in ((-10.0, 10.0), (20.0, 30.0))
    )
    # The overlap is 4 s at 0.25 s and falls to 2 s at 2 s on either side.
    assert near[[0, -1]] == pytest.approx([-1.75, 2.25], abs=0.002)
    assert len(far) == 0


def test_too_few_pairs_have_no_distance(views):
    pairs = views.pairs(np.array([0.25]), n_samples=40)
    n_valid = int(pairs.valid.sum())
    F = np.diag([1.0, -1.0, 0.0])
    assert np.isfinite(offset_search.mean_epipolar_distance(F, pairs, min_pairs=n_valid)).all()
    assert np.isnan(offset_search.mean_epipolar_distance(F, pairs, min_pairs=n_valid + 1)).all()
