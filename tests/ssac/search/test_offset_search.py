"""The search for an offset: pairs of two views, analytic cost curves, and all offsets."""

import numpy as np
import pytest

from ssac import EVENT_DTYPE, Config, PointTrack, TwoViews
from ssac.methods.verdict import offset_estimate
from ssac.rules import AllOffsetsRules, PointRules, SearchRules
from ssac.search import offset_search
from ssac.search.all_offsets import search_all_offsets
from ssac.search.start import large_jump
from ssac.search.view import seen_by_both, seen_of
from ssac.track.motion import object_motion, point_motion
from tests.ssac.synthetic import CAMERA, make_events, make_scene
from tests.ssac.tracks import frame_track, frame_tracks

T_D_S = 0.25
SCENE = make_scene(seed=0, duration_s=4.0)
RULES, OF_ALL = SearchRules(), AllOffsetsRules()
OFFSETS_S = np.arange(-1000, 1001) * 1e-3


@pytest.fixture(scope="module")
def views():
    streams = make_events(SCENE, seed=0, t_d_s=T_D_S)
    return TwoViews(*(object_motion(one, CAMERA) for one in streams), SCENE.rig, Config())


@pytest.mark.parametrize(
    ("t_d_s", "start_s", "end_s"), [(0.25, 0.0, 4.0), (1.25, 0.0, 3.0), (-0.75, 1.0, 4.0)]
)
def test_sample_times_cover_the_overlap(t_d_s, start_s, end_s, views):
    # Camera 1 records 0 to 4 s, camera 2 0.25 to 4.25 s on its own clock.
    times_s = views.sample_times(np.array([t_d_s]), 300)[0]
    assert times_s[0] == pytest.approx(start_s, abs=0.01)  # half a sampling step
    assert times_s[-1] == pytest.approx(end_s, abs=0.01)
    np.testing.assert_allclose(np.diff(times_s), times_s[1] - times_s[0])
    assert len(views.sample_times(np.array([t_d_s]))[0]) == Config.n_samples


def searched(cost, offsets_s=OFFSETS_S, coarsest=20, returns_s=None):
    return offset_search.coarse_to_fine_search(cost, cost, offsets_s, coarsest, RULES, returns_s)


def rounded_v(centre_s, widest_px=13.0):
    """A V of 1.3 px per 10 ms within 100 ms of the centre, then a plateau: the paper's Fig. 5."""

    def cost(t_d_s):
        distance_s = np.abs(t_d_s - centre_s)
        return np.minimum(np.sqrt(0.3**2 + (130.0 * distance_s) ** 2), widest_px)

    return cost


@pytest.mark.parametrize(
    ("cost", "least_s"),
    [
        *((rounded_v(centre_s), centre_s) for centre_s in (-0.4321, 0.0, 0.00037, 0.777)),
        # One side of the V ends 10 ms off: a parabola over 20 ms, not 6, is drawn to the flat side.
        (lambda t_d_s: np.where(t_d_s > 0.21, 1.4, rounded_v(0.2)(t_d_s)), 0.2),
        (lambda t_d_s: np.where(t_d_s < 0.0, np.nan, rounded_v(0.2)(t_d_s)), 0.2),
    ],
)
def test_the_minimum_is_found_between_candidates_of_which_a_tenth_are_tried(cost, least_s):
    every, some = offset_search.exhaustive_search(cost, OFFSETS_S), searched(cost)
    for search in (every, some):
        # A parabola through 12 points of another curve errs by 3 us; the resolution is 10 us.
        assert search.t_d_s == pytest.approx(least_s, abs=5e-6)
        assert not search.at_bound
        assert np.array_equal(search.d_avg_px, cost(search.candidates_s), equal_nan=True)
    assert len(some.candidates_s) < len(OFFSETS_S) / 10
    assert np.all(np.diff(some.candidates_s) > 0.0)


def test_a_minimum_outside_the_interval_is_at_its_bound_and_none_is_nowhere(views):
    for centre_s in (-1.5, 1.2):
        cost = rounded_v(centre_s, widest_px=np.inf)
        # The bound is the interval's, or that of what recordings have in common.
        for offsets_s, advice in ((OFFSETS_S, "widen"), (OFFSETS_S[800:-800], "record longer")):
            search = searched(cost, offsets_s)
            found = offset_estimate("ssac", search, views)
            assert search.at_bound
            assert found.status == "search_bound"
            assert advice in found.reason
    assert np.isnan(searched(lambda t: t * np.nan).t_d_s)
    assert np.isnan(searched(rounded_v(0.0), np.empty(0)).t_d_s)


@pytest.mark.parametrize("n", [1, 2, 3, 8])
@pytest.mark.parametrize("coarsest", [5, 7, 13, 20])
def test_an_interval_shorter_than_a_step_is_searched(n, coarsest):
    """Bug: no step from the coarse minimum reached another candidate, and the search crashed."""
    offsets_s = 0.2 + 0.001 * np.arange(n)
    search = searched(rounded_v(0.2), offsets_s, coarsest)
    assert search.t_d_s == offset_search.exhaustive_search(rounded_v(0.2), offsets_s).t_d_s
    assert search.at_bound


def test_a_return_of_the_path_where_no_cost_is_known_is_no_rival():
    """Bug: the search crashed if too few samples are valid one lag of a repeating path away."""
    valley = rounded_v(0.2)
    found = searched(lambda t: np.where(t > 0.45, np.nan, valley(t)), returns_s=np.array([0.4]))
    assert found.t_d_s == pytest.approx(0.2, abs=5e-6)
    assert len(offset_search.valleys(found.candidates_s, found.d_avg_px, found.t_d_s, RULES)) == 1


# --- All offsets ---


def of_points(track):
    return point_motion(track, CAMERA, PointRules())


@pytest.mark.parametrize("offset_s", [0.0, 1234.567, -86400.0])
def test_any_offset_is_found_among_all_and_no_other_comes_near(offset_s):
    shares, motions = [], map(of_points, frame_tracks(make_scene(1), offset_s))
    found = search_all_offsets(*motions, OF_ALL, progress=shares.append)
    best = found.guesses[0]
    assert best.t_d_s == pytest.approx(offset_s, abs=0.02)  # half a frame
    assert best.cost < OF_ALL.max_cost
    assert all(one.cost > OF_ALL.rival * best.cost for one in found.guesses[1:])
    np.testing.assert_allclose(np.diff(found.candidates_s), found.step_s, rtol=1e-6)
    tried_s = found.candidates_s[np.isfinite(found.costs)]
    # Offsets are tried until half of the flight overlaps.
    assert tried_s[0] < offset_s - 10.0 < offset_s + 10.0 < tried_s[-1]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def views_with_jump(at_s, size_s, last_s=(np.inf, np.inf), other=1):
    """Return views of two 20 s tracks; camera 2's clock jumps at `at_s` of camera 1's clock."""
    views = []
    for k, (seed, end_s) in enumerate(zip((1, other), last_s, strict=True)):
        track = frame_tracks(make_scene(seed), T_D_S)[k]
        times_s = track.times_s + k * size_s * (track.times_s >= at_s + T_D_S)
        kept = times_s < end_s
        views.append(of_points(PointTrack(times_s[kept], track.points_px[kept])))
    return TwoViews(*views, SCENE.rig, Config())


@pytest.mark.parametrize(
    ("at_s", "last_s", "size_s"),
    [(12.0, (20.0, 30.0), 0.06), (7.0, (20.0, 16.0), 0.3), (5.0, (12.0, 30.0), 0.06)],
)
def test_a_large_jump_is_found_with_its_time_and_size(at_s, last_s, size_s):
    jump = large_jump(views_with_jump(at_s, size_s, last_s))
    assert jump.at_s == pytest.approx(at_s, abs=0.2)  # four samples
    assert jump.before_s == pytest.approx(T_D_S, abs=0.003)  # steps of 1 ms, and noise
    assert jump.after_s == pytest.approx(T_D_S + size_s, abs=0.003)
    assert jump.size_s == pytest.approx(jump.after_s - jump.before_s)


def test_no_jump_is_found_of_one_offset_nor_of_different_objects():
    assert large_jump(views_with_jump(10.0, 0.0)) is None
    assert large_jump(views_with_jump(19.5, 0.2)) is None  # too late to tell
    assert all(large_jump(views_with_jump(10.0, 0.2, other=other)) is None for other in (2, 3))


def test_a_camera_without_a_path_tells_nothing():
    """Bug: a camera without any event gave an infinite number of steps."""
    one = of_points(frame_track(make_scene(1), 1, 30.0))
    at_rest = of_points(PointTrack(np.arange(0.0, 20.0, 0.04), np.full((500, 2), 100.0)))
    for nothing in (at_rest, *(object_motion(np.zeros(n, EVENT_DTYPE), CAMERA) for n in (0, 1))):
        assert not search_all_offsets(one, nothing, OF_ALL).guesses
        assert not search_all_offsets(nothing, one, OF_ALL).guesses


def test_samples_are_drawn_where_both_see_the_object():
    """Three flights of 8 s are seen in a recording of twenty minutes."""
    motions = []
    for camera in (1, 2):
        track = frame_track(make_scene(1, duration_s=28.0), camera, 30.0, seed=camera)
        kept = track.times_s % 10.0 < 8.0
        times_s = track.times_s[kept] + 600.0 * (track.times_s[kept] // 10.0)
        motions.append(of_points(PointTrack(times_s, track.points_px[kept])))
    one, other = motions
    views = TwoViews(one, other, None, Config())
    assert seen_of(one).share < 0.1
    pairs = views.pairs_at(0.0)
    assert len(pairs) > 200  # half of the samples
    times_s = seen_of(one).spread(50)
    assert np.all(np.diff(times_s) > 0.0)
    assert np.mean(one.at(times_s).valid) > 0.9
    assert seen_by_both(seen_of(one), seen_of(other), 1e6, 50, 0.5) is None
