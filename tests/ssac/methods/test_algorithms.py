"""Algorithms 1 and 2 on synthetic events of known offset and pose, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import ssac, ssac_known
from ssac.config import Config
from ssac.geometry.fundamental import reweighted_fundamental
from ssac.points import PointTrack
from ssac.track.observation import Observation, tracked
from tests.ssac.synthetic import HEIGHT, make_events, make_scene, rotation_angle_deg, track_pair

CLEAN = Config(denoise=False)  # the synthetic events have no noise to remove


def observe(scene, seed, t_d_s=0.0, **kwargs):
    return [Observation(events) for events in make_events(scene, seed, t_d_s, **kwargs)]


@pytest.fixture(scope="module")
def flight():
    scene = make_scene(seed=0, duration_s=12.0)
    return scene, observe(scene, seed=0, t_d_s=0.05)


@pytest.mark.parametrize("t_d_s", [0.0, 0.5])
def test_both_algorithms_find_offsets_near_and_far(t_d_s):
    scene = make_scene(seed=3, angle_deg=30.0)
    cameras = observe(scene, 3, t_d_s)
    for method, rig in ((ssac_known, scene.rig), (ssac, scene.unknown_rig)):
        estimate = method(*cameras, rig, CLEAN)
        assert estimate.status == "ok"
        # The bound of 400 windows with 0.3 px of noise is 0.16 ms. Four times that.
        assert estimate.t_d_s == pytest.approx(t_d_s, abs=0.0006)
        assert estimate.n_samples > 300


@pytest.mark.parametrize(
    ("method", "low_s", "t_d_s", "tried"), [(ssac_known, -1.0, 0.77, 2001), (ssac, -0.2, 0.13, 401)]
)
def test_coarse_to_fine_finds_the_exhaustive_minimum(method, low_s, t_d_s, tried):
    scene = make_scene(1, angle_deg=150.0, duration_s=8.0)
    cameras, config = observe(scene, 1, t_d_s), replace(CLEAN, interval_s=(low_s, -low_s))
    fast = method(*cameras, scene.rig, config)
    slow = method(*cameras, scene.rig, replace(config, exhaustive=True))
    assert fast.t_d_s == pytest.approx(slow.t_d_s, abs=1e-9)  # the same cost on the same grid
    assert len(slow.candidates_s) == tried


def test_magsac_is_an_alternative_to_lmeds(flight):
    scene, cameras = flight
    estimate = ssac(*cameras, scene.unknown_rig, replace(CLEAN, robust="magsac"))
    # As the bound, of MAGSAC's best minimal sample alone.
    assert estimate.t_d_s == pytest.approx(0.05, abs=0.001)
    assert rotation_angle_deg(estimate.R, scene.R) < 1.5


def test_pairs_that_no_model_fits_at_last_are_refused(flight, monkeypatch):
    """Bug: MAGSAC++ may find no model of the final pairs, and the decomposition of F fell over."""
    scene, cameras = flight

    def fits_but_at_last(p1_px, p2_px, trials, seed):
        F = reweighted_fundamental(p1_px, p2_px)
        return F if trials == CLEAN.trials else np.full_like(F, np.nan)

    monkeypatch.setattr("ssac.methods.algorithms.lmeds_fundamental", fits_but_at_last)
    estimate = ssac(*cameras, scene.unknown_rig, CLEAN)
    assert estimate.status == "no_match"
    assert "no fundamental matrix fits" in estimate.reason
    assert np.isnan(estimate.t_d_s)


def test_views_that_share_no_points_are_refused_by_what_a_track_lacks():
    """Bug: tracks were said to need 200 events in a window."""
    scene = make_scene(seed=0, duration_s=4.0)
    times_s = np.arange(0.0, 4.0, 0.01)
    parts = (times_s < 1.0) | (times_s > 3.985), (times_s > 3.0) | (times_s < 0.005)
    cam1, cam2 = (
        tracked(PointTrack(times_s[part], np.clip(p[part], 0.0, HEIGHT - 1)))
        for p, part in zip(track_pair(scene, times_s), parts, strict=True)
    )
    events = make_events(scene, seed=0)[1]
    of_events = Observation(events[(events["t"] > 3_000_000) | (events["t"] < 1_000)])
    for other, has_events in ((cam2, False), (of_events, True)):
        estimate = ssac(cam1, other, scene.unknown_rig, replace(CLEAN, interval_s=(-0.1, 0.1)))
        assert estimate.status == "too_few_samples"
        assert "points just before and just after" in estimate.reason
        assert ("200 events" in estimate.reason) == has_events


def test_an_offset_outside_the_interval_is_refused():
    scene = make_scene(seed=0)
    cameras = observe(scene, seed=0, t_d_s=0.15)  # d_avg falls towards it from 100 ms away
    config = replace(CLEAN, interval_s=(0.0, 0.1))
    assert ssac_known(*cameras, scene.rig, config).status == "search_bound"
