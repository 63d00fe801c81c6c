"""The pairing of two motions by a clock, and what is summed up of both views once."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import two_views
from ssac.config import Config
from ssac.errors import SsacError
from ssac.points import PointTrack
from ssac.search.two_views import TwoViews
from ssac.track.motion import object_motion
from ssac.track.observation import tracked
from tests.ssac.synthetic import K, make_events, make_scene

T_D_S = 0.25
SCENE = make_scene(seed=0, duration_s=4.0)


@pytest.fixture(scope="module")
def events():
    return make_events(SCENE, seed=0, t_d_s=T_D_S)


@pytest.fixture(scope="module")
def views(events):
    motions = (object_motion(stream, SCENE.rig.cam1) for stream in events)
    return TwoViews(*motions, SCENE.rig, Config())


def test_pairs_obey_the_sign_convention(views):
    offsets_s = np.array([-0.1, T_D_S])
    pairs = views.pairs(offsets_s, n_samples=50)
    for m, t_d_s in enumerate(offsets_s):
        times_s = pairs.times_s[m]
        assert np.array_equal(pairs.p1_px[m], views.motion1.at(times_s).positions_px, True)
        assert np.array_equal(pairs.p2_px[m], views.motion2.at(times_s + t_d_s).positions_px, True)


def test_pairs_at_one_offset_are_the_valid_ones_of_that_offset(views):
    views = replace(views, config=Config(n_min=300))  # of which some windows hold fewer
    views = replace(views, motion1=replace(views.motion1, n_min=900))
    pairs, one = views.pairs(np.array([0.1, T_D_S])), views.pairs_at(T_D_S)
    valid = pairs.valid[1]
    assert 0 < np.count_nonzero(valid) < len(valid)
    assert len(one) == np.count_nonzero(valid)
    assert np.array_equal(one.times_s, pairs.times_s[1, valid])
    for ours, theirs in zip(one.points_px, pairs.valid_positions(1), strict=True):
        assert np.array_equal(ours, theirs)
    rays1, _ = one.rays(SCENE.rig)
    np.testing.assert_allclose((rays1 @ K.T)[:, :2], one.p1_px, rtol=1e-12)


@pytest.mark.parametrize(
    ("t_d_s", "start_s", "end_s"), [(0.25, 0.0, 4.0), (1.25, 0.0, 3.0), (-0.75, 1.0, 4.0)]
)
def test_sample_times_cover_the_overlap(t_d_s, start_s, end_s, views):
    # Camera 1 records 0 to 4 s, camera 2 0.25 to 4.25 s on its own clock.
    times_s = views.sample_times(np.array([t_d_s]), 300)[0]
    assert times_s[0] == pytest.approx(start_s, abs=0.01)  # half a sampling step
    assert times_s[-1] == pytest.approx(end_s, abs=0.01)
    assert len(views.sample_times(np.array([t_d_s]))[0]) == Config.n_samples


@pytest.mark.parametrize(("points", "sigmas"), [((9, 2), None), ((10, 3), None), ((10, 2), (9,))])
def test_a_track_of_unequal_lengths_is_refused(points, sigmas):
    """Bug: it reached NumPy, which could not broadcast it."""
    times_s = 0.1 * np.arange(10)
    track = PointTrack(times_s, np.ones(points), None if sigmas is None else np.ones(sigmas))
    with pytest.raises(SsacError, match=r"camera 1: a track of 10 times must have points of shape"):
        two_views(tracked(track), tracked(track), SCENE.rig)
