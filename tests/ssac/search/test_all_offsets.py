"""The search over all offsets: found wherever it is, refused where nothing tells it."""

import numpy as np
import pytest

from ssac.camera import Camera
from ssac.config import Config
from ssac.events import EVENT_DTYPE
from ssac.points import PointTrack
from ssac.rules import AllOffsetsRules, PointRules
from ssac.search.all_offsets import search_all_offsets
from ssac.search.two_views import TwoViews
from ssac.search.view import seen_by_both, seen_of
from ssac.track.motion import object_motion, point_motion
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_scene
from tests.ssac.tracks import FPS, frame_track

CAMERA = Camera(K, WIDTH, HEIGHT)
SCENE = make_scene(1)
RULES = AllOffsetsRules()


def motions(offset_s, rate=1.0):
    one = point_motion(frame_track(SCENE, 1, FPS[0], seed=1), CAMERA, PointRules())
    other = point_motion(
        frame_track(SCENE, 2, FPS[1], offset_s, rate, seed=2), CAMERA, PointRules()
    )
    return one, other


@pytest.mark.parametrize("offset_s", [0.0, 1234.567, -86400.0])
def test_any_offset_is_found_and_no_other_comes_near(offset_s):
    found = search_all_offsets(*motions(offset_s), RULES)
    best = found.guesses[0]
    assert best.t_d_s == pytest.approx(offset_s, abs=0.02)  # half a frame
    assert best.cost < RULES.max_cost
    assert all(one.cost > RULES.rival * best.cost for one in found.guesses[1:])


def test_candidates_ascend_and_cover_all_offsets_with_enough_common_path():
    found = search_all_offsets(*motions(50.0), RULES)
    steps_s = np.diff(found.candidates_s)
    np.testing.assert_allclose(steps_s, found.step_s, rtol=1e-6)
    tried_s = found.candidates_s[np.isfinite(found.costs)]
    assert tried_s[0] < 50.0 - 10.0  # half of the flight is left
    assert tried_s[-1] > 50.0 + 10.0


def test_progress_is_told_up_to_the_end():
    shares = []
    search_all_offsets(*motions(0.0), RULES, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_camera_without_a_path_tells_nothing():
    """Bug: no event left of a camera gave an infinite number of steps."""
    one, _ = motions(0.0)
    at_rest = PointTrack(np.arange(0.0, 20.0, 0.04), np.full((500, 2), 100.0))
    without = [object_motion(np.zeros(n, EVENT_DTYPE), CAMERA) for n in (0, 1)]
    for nothing in (point_motion(at_rest, CAMERA, PointRules()), *without):
        assert not search_all_offsets(one, nothing, RULES).guesses
        assert not search_all_offsets(nothing, one, RULES).guesses


def gappy(scene, camera, fps, pieces):
    """Short pieces of flight in a long recording."""
    track = frame_track(scene, camera, fps, seed=camera)
    kept = np.any([(track.times_s > a) & (track.times_s < b) for a, b in pieces], axis=0)
    # Between pieces the clock goes on for ten minutes.
    late_s = 600.0 * np.sum([track.times_s > b for _, b in pieces], axis=0)
    return point_motion(
        PointTrack(track.times_s[kept] + late_s[kept], track.points_px[kept]), CAMERA, PointRules()
    )


def test_samples_are_drawn_where_both_see_the_object():
    scene = make_scene(1, duration_s=30.0)
    pieces = [(0.0, 8.0), (10.0, 18.0), (20.0, 28.0)]
    one, other = (gappy(scene, camera, 30.0, pieces) for camera in (1, 2))
    views = TwoViews(one, other, None, Config())
    assert seen_of(one).share < 0.1
    pairs = views.pairs_at(0.0)
    assert len(pairs) > 200  # half of the samples
    times_s = seen_of(one).spread(50)
    assert np.all(np.diff(times_s) > 0.0)
    assert np.mean(one.at(times_s).valid) > 0.9


def test_samples_stay_even_where_the_object_is_seen_most_of_the_time():
    views = TwoViews(*motions(3.0), None, Config())
    (times_s,) = views.sample_times(np.array([3.0]), 100)
    np.testing.assert_allclose(np.diff(times_s), times_s[1] - times_s[0])
    one, other = seen_of(views.motion1), seen_of(views.motion2)
    assert seen_by_both(one, other, 3.0, 100, 0.5) is None
    assert seen_by_both(one, other, 1e6, 100, 0.5) is None
