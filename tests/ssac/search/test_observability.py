"""What is observable: swings, valleys of the cost, straight paths, and a determined F."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.config import MIN_SWINGS, Config
from ssac.geometry.fundamental import lmeds_fundamental, reweighted_fundamental, second_best
from ssac.rules import Rules
from ssac.search import offset_search
from ssac.search.two_views import TwoViews, views_of
from ssac.search.view import returns_s, view_of
from ssac.track.denoise import Clutter
from ssac.track.motion import ObjectMotion, object_motion
from tests.ssac.synthetic import denoised, make_scene, track_pair
from tests.ssac.track.test_denoise import blob

RULES = Rules()
SEARCH = RULES.search
SCENE = make_scene(0)
CAMERA = SCENE.rig.cam1
CLUTTER = Clutter(1, 7, 0.1, 3.0, 1, 200)
OFFSETS_S = np.arange(-1.0, 1.0, 0.001)


def events_along(x_px, y_px, size_px: float = 6.0):
    """Return 8 s of events of a blob of this size along a path, at 25 000 events a second."""
    size = CAMERA.width, CAMERA.height
    return blob(lambda t_s: (x_px(t_s), y_px(t_s)), 200_000, size_px, 8_000_000, size)


def motion_along(*path, **how) -> ObjectMotion:
    return object_motion(events_along(*path, **how), CAMERA)


def wave(hz: float, phase: float = 0.0, reach_px: float = 60.0, drift_px_s: float = 0.0):
    return lambda times_s: (
        130.0 + reach_px * np.sin(2 * np.pi * hz * times_s + phase) + drift_px_s * (times_s - 4.0)
    )


@pytest.mark.parametrize(
    ("hz", "t_d_s", "hidden_s", "rel"),
    [(0.25, 0.0, 0.0, 0.05), (1.0, 0.0, 0.0, 0.05), (1.0, 6.0, 0.0, 0.1), (1.0, 0.0, 4.0, 0.1)],
)
def test_a_sine_swings_twice_a_period_while_both_cameras_see_it(hz, t_d_s, hidden_s, rel):
    events = events_along(wave(hz), wave(hz, 1.0))
    motion = object_motion(events[abs(1e-6 * events["t"] - 4.0) >= 0.5 * hidden_s], CAMERA)
    views = TwoViews(motion, motion, SCENE.rig, Config())
    # Rice's formula is exact for a sine over whole half periods; the window of 40 ms blurs it. Half
    # a second out of view is taken for seen.
    expected = 2 * hz * (8.0 - t_d_s - max(hidden_s - 0.5, 0.0))
    assert views.swings(views.pairs_at(t_d_s)) == pytest.approx(expected, rel=rel)
    if hz < 1.0:  # samples as far apart as those of long recordings are no gaps
        assert views.swings(views.pairs_at(t_d_s, 8)) == pytest.approx(2 * hz * 7.0, rel=0.2)
    refusal = offset_search.too_little_motion(3.49, MIN_SWINGS)
    assert refusal is not None
    assert "to and fro 3.4 times" in refusal.reason
    assert f"and {MIN_SWINGS} are needed" in refusal.reason
    assert offset_search.too_little_motion(3.6, MIN_SWINGS) is None


def test_rest_is_measured_in_sizes_of_the_object():
    for size_px in (2.0, 10.0):
        for reach, rests in ((0.5, True), (2.0, False)):  # rms of x and y together is the reach
            both = (wave(0.7, phase, reach_px=reach * size_px) for phase in (0.0, 1.5))
            view = view_of(motion_along(*both, size_px=size_px), RULES.view)
            # The object's rms size is over both axes: 2**0.5 times the deviation of one.
            assert (offset_search.at_rest((view, view), SEARCH) is not None) == rests


MOVES = denoised(events_along(wave(0.7), wave(1.1)))
RESTS, THIN = denoised(events_along(wave(0.0), wave(0.0))), denoised(MOVES.events[::100])
UNFILTERED = replace(THIN, denoised=False)
EMPTY = replace(MOVES, events=MOVES.events[:0], n_recorded=500, clutter=CLUTTER)
FAR, NO_WINDOW = 100.0, "no window of 40 ms holds 200 events"
UNSEARCHABLE = [  # in the order of the stages
    (RESTS, RESTS.delayed(FAR), "no_motion", "it is at rest, or lost in noise"),
    (THIN, RESTS.delayed(FAR), "no_motion", "in camera 2 the object moves by"),
    (THIN, THIN.delayed(FAR), "no_common_time", "between -1 and 1 s: leave out --search"),
    (MOVES, MOVES.delayed(FAR), "no_common_time", "8.000 s) and camera 2 (100.000 to 108.000 s)"),
    (MOVES, THIN, "too_few_samples", f"camera 2: {NO_WINDOW} (denoising left 2000 of"),
    (THIN, MOVES, "too_few_samples", "give a smaller --n-min or a longer --half-window"),
    (MOVES, UNFILTERED, "too_few_samples", f"camera 2: {NO_WINDOW}: record closer"),
    (EMPTY, MOVES, "too_few_samples", "of which 7 were of lamps and hot pixels: check"),
    (EMPTY, MOVES, "too_few_samples", "camera 1: denoising left 0 of 500 events"),
]


@pytest.mark.parametrize(("one", "other", "status", "said"), UNSEARCHABLE)
def test_what_cannot_be_searched_is_refused_with_advice(one, other, status, said):
    refusal, swapped = (
        offset_search.unusable(views_of(*cleans, SCENE.rig, Config()), cleans, (-1.0, 1.0))
        for cleans in ((one, other), (other, one))
    )
    assert (refusal.status, swapped.status) == (status, status)
    assert said in refusal.reason


def test_valleys_are_where_the_cost_is_low():
    costs = np.full(len(OFFSETS_S), 10.0)
    for offset_s, least in ((0.05, 1.0), (-0.7, 2.7), (0.6, 3.3)):
        costs = np.minimum(costs, least + 200.0 * np.abs(OFFSETS_S - offset_s))
    found = offset_search.valleys(OFFSETS_S, costs, 0.05, SEARCH)
    assert [valley.least_s for valley in found] == pytest.approx([0.05, -0.7], abs=1e-3)
    assert "-0.700 s" in offset_search.ambiguous_offset(found, Config.max_valley_s).reason
    assert offset_search.ambiguous_offset(found[:1], Config.max_valley_s) is None
    plateau = np.where(np.abs(OFFSETS_S) < 0.6 * Config.max_valley_s, 1.0, 10.0)
    wide = offset_search.valleys(OFFSETS_S, plateau, 0.0, SEARCH)
    refusal = offset_search.ambiguous_offset(wide, Config.max_valley_s)
    assert refusal.status == "ambiguous_offset"
    # Residuals are measured in sizes of the object.
    assert offset_search.no_match(1.0, 10.0, SEARCH) is None
    assert offset_search.no_match(5.0, 10.0, SEARCH).status == "no_match"


@pytest.mark.parametrize("rival_s", [-0.613, 0.477])
def test_the_search_finds_rivals_between_its_coarse_steps(rival_s):
    def cost(offsets_s):
        main, rival = np.abs(offsets_s - 0.053), np.abs(offsets_s - rival_s)
        return np.minimum(np.minimum(0.5 + 130.0 * main, 0.6 + 130.0 * rival), 12.0)

    search = offset_search.coarse_to_fine_search(cost, cost, OFFSETS_S, 20, SEARCH)
    assert search.t_d_s == pytest.approx(0.053, abs=2e-3)
    found = offset_search.valleys(search.candidates_s, search.d_avg_px, search.t_d_s, SEARCH)
    assert len(found) == 2
    assert found[1].least_s == pytest.approx(rival_s, abs=1.5e-3)


def returning(*path, longest_s=2.0):
    """Return the lags [s] after which a path repeats itself."""
    motion = motion_along(*path)
    return returns_s(motion, view_of(motion, RULES.view), longest_s, RULES.view)


def test_a_path_that_repeats_itself_returns_after_whole_periods():
    def path(times_s):  # of period 0.8 s, with its second harmonic
        return 130 + 40 * np.sin(2 * np.pi * times_s / 0.8) + 30 * np.cos(5 * np.pi * times_s)

    # The tolerance is two steps of 2 ms, as the windows hold other events a period later.
    np.testing.assert_allclose(returning(path, wave(1.25, 0.4)), [0.8, 1.6], atol=0.004)
    assert len(returning(path, wave(1.25, 0.4), longest_s=0.5)) == 0
    assert len(returning(wave(0.31), wave(0.19, 1.0))) == 0  # their common period is 100 s
    for drift_px_s, returns in ((7.0, True), (21.0, False)):
        drifting = wave(1.25, drift_px_s=drift_px_s)
        # In 0.8 s the path drifts by 6 or 17 px, and its extent is 62 to 78 px. So it misses itself
        # by a tenth or by over a fifth, the limit.
        assert bool(len(returning(drifting, wave(1.25, 0.4), longest_s=1.0))) == returns


def test_straight_is_narrow_beside_its_length_and_beside_the_object():
    assert not view_of(motion_along(wave(0.7), wave(1.1)), RULES.view).is_straight
    motion = motion_along(wave(0.7), wave(0.7))
    view = view_of(motion, RULES.view)
    assert view.is_straight
    assert np.abs(view.direction) == pytest.approx([0.5**0.5, 0.5**0.5], abs=0.02)
    for name, beside_px in (("max_width", view.size_px), ("max_slenderness", view.length_px)):
        share = view.width_px / beside_px
        for factor, is_straight in ((1.1, True), (0.9, False)):
            rules = replace(RULES.view, **{name: factor * share})
            assert view_of(motion, rules).is_straight == is_straight


@pytest.mark.parametrize(("seed", "noise_px"), [(0, 0.3), *((seed, 0.0) for seed in range(6))])
def test_a_planar_path_leaves_the_fundamental_matrix_open_with_noise_and_without(seed, noise_px):
    """Bug: a least eigenvalue of zero, which rounding may make negative, was taken as no F."""
    scene, times_s, rng = make_scene(seed), np.linspace(0.2, 19.0, 300), np.random.default_rng(1)
    into_plane = np.array([[1.0, 0.0, 0.4], [0.0, 1.0, 0.3], [0.0, 0.0, 0.0]])
    flat = replace(scene, path=lambda t: scene.path(t) @ into_plane + [0.0, 0.0, 5.0])
    free, planar = (
        [p + rng.normal(0.0, noise_px, p.shape) for p in track_pair(one, times_s)]
        for one in (scene, flat)
    )
    assert second_best(*free) > 14.0
    # All of a two-parameter family of F fit alike; only noise makes one fit better than another.
    assert second_best(*planar) < 7.0
    assert offset_search.open_fundamental(*free, SEARCH) is None
    assert offset_search.open_fundamental(*planar, SEARCH).status == "degenerate_pose"


@pytest.mark.parametrize(
    ("n", "at_px"),
    [
        (40, ([100.0, 100.0], [100.0, 100.0])),  # here the fit divided by zero
        (15, ([181.75, 111.0], [161.7, 146.4])),  # rounding of the mean made weights infinite
    ],
)
def test_points_at_rest_allow_no_fundamental_matrix(n, at_px):
    """Bug: the eigenvalue solver raised an error."""
    pair = [np.tile(point, (n, 1)) for point in at_px]
    assert np.isnan(lmeds_fundamental(*pair, trials=50)).all()
    assert np.isnan(reweighted_fundamental(*pair)).all()
    assert second_best(*pair) == 1.0
