"""The paper's algorithms and the compared methods, on signals of known offset."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import EVENT_DTYPE, PointTrack, albl, ssac, ssac_known
from ssac.geometry.fundamental import reweighted_fundamental
from ssac.methods import correlations
from ssac.track.observation import Observation, tracked
from tests.ssac.methods.flights import CLEAN, T_D_S, found, seen
from tests.ssac.synthetic import HEIGHT, make_scene, track_pair


@pytest.mark.parametrize(
    ("method", "low_s", "t_d_s", "tried"), [(ssac_known, -1.0, 0.77, 2001), (ssac, -0.2, 0.13, 401)]
)
def test_coarse_to_fine_finds_the_exhaustive_minimum(method, low_s, t_d_s, tried):
    scene = make_scene(1, angle_deg=150.0, duration_s=8.0)
    cameras, config = seen(scene, 1, t_d_s), replace(CLEAN, interval_s=(low_s, -low_s))
    fast = method(*cameras, scene.rig, config)
    slow = method(*cameras, scene.rig, replace(config, exhaustive=True))
    assert fast.t_d_s == pytest.approx(slow.t_d_s, abs=1e-9)  # the same cost on the same grid
    # The tolerance is five times the bound of 400 windows with 0.3 px of noise, 0.16 ms.
    assert fast.t_d_s == pytest.approx(t_d_s, abs=0.8e-3)
    assert len(slow.candidates_s) == tried


def test_pairs_that_no_model_fits_at_last_are_refused(monkeypatch):
    """Bug: where MAGSAC++ found no model of the final pairs, the decomposition of F crashed."""

    def fits_but_at_last(p1_px, p2_px, trials, seed):
        F = reweighted_fundamental(p1_px, p2_px)
        return F if trials == CLEAN.trials else np.full_like(F, np.nan)

    monkeypatch.setattr("ssac.methods.algorithms.lmeds_fundamental", fits_but_at_last)
    estimate = found("free", "ssac", interval_s=(-0.1, 0.2))
    assert estimate.status == "no_match"
    assert "no fundamental matrix fits" in estimate.reason
    assert np.isnan(estimate.t_d_s)


def test_views_that_share_no_points_are_refused_by_what_a_track_lacks():
    """Bug: the refusal asked tracks for 200 events in a window."""
    scene = make_scene(seed=0, duration_s=4.0)
    times_s = np.arange(0.0, 4.0, 0.01)
    parts = (times_s < 1.0) | (times_s > 3.985), (times_s > 3.0) | (times_s < 0.005)
    cam1, cam2 = (
        tracked(PointTrack(times_s[part], np.clip(p[part], 0.0, HEIGHT - 1)))
        for p, part in zip(track_pair(scene, times_s), parts, strict=True)
    )
    events = seen(scene, t_d_s=0.0)[1].events
    of_events = Observation(events[(events["t"] > 3_000_000) | (events["t"] < 1_000)])
    for other, has_events in ((cam2, False), (of_events, True)):
        estimate = ssac(cam1, other, scene.unknown_rig, replace(CLEAN, interval_s=(-0.1, 0.1)))
        assert estimate.status == "too_few_samples"
        assert "points just before and just after" in estimate.reason
        assert ("200 events" in estimate.reason) == has_events


# --- Compared methods ---


@pytest.fixture(scope="module")
def flickering():
    """A camera of 10 s: its event rate changes at random every 50 ms, and it has 50 frames/s."""
    rng = np.random.default_rng(0)
    rates = rng.uniform(1_000.0, 20_000.0, 200)
    times_s = [0.05 * (i + rng.random(rng.poisson(0.05 * r))) for i, r in enumerate(rates)]
    events = np.zeros(sum(map(len, times_s)), EVENT_DTYPE)
    events["t"] = np.sort(np.concatenate(times_s)) * 1e6
    steps = rng.normal(size=(500, 4, 5)) * rng.uniform(0.1, 2.0, (500, 1, 1))
    return Observation(events, np.cumsum(steps, axis=0), 0.02 * np.arange(500))


@pytest.mark.parametrize(
    ("method", "unit_s"),
    [
        (correlations.zncc_e_of_events, 0.010),
        (correlations.event_rate_of_events, 0.001),
        (correlations.zncc_f_of_frames, 0.020),
    ],
)
def test_delayed_signals_are_recovered(method, unit_s, flickering):
    brighter = replace(flickering, frames=3.0 * flickering.frames + 5.0)
    for t_d_s in (0.0, 0.14, -0.7):
        estimate = method(flickering, brighter.delayed(t_d_s), CLEAN)
        assert estimate.status == "ok"
        assert np.min(estimate.costs) == pytest.approx(-1.0)
        assert estimate.t_d_s == pytest.approx(t_d_s, abs=1e-9)  # a multiple of the unit
        assert np.allclose(np.diff(estimate.candidates_s), unit_s)
        assert np.argmin(estimate.costs) == np.argmin(np.abs(estimate.candidates_s - t_d_s))
        assert estimate.R is None
    between = method(flickering, flickering.delayed(0.0337), CLEAN)
    assert between.t_d_s == pytest.approx(0.0337, abs=unit_s)
    units = between.t_d_s / unit_s
    assert units == pytest.approx(round(units), abs=1e-7)  # rounding, divided by the unit


def test_albl_recovers_large_offsets_or_refuses():
    # The object reverses within most of these offsets, so that often no growing step leads there.
    n_right = 0
    for seed, t_d_s in ((0, -0.8), (0, 0.05), (1, 0.5), (1, -0.2), (2, -0.8), (2, 0.5)):
        scene = make_scene(seed, duration_s=6.0)
        cameras = seen(scene, seed, t_d_s)
        estimate = albl(*cameras, scene.unknown_rig, CLEAN)
        if estimate.status == "ok":
            n_right += 1
            assert estimate.t_d_s == pytest.approx(t_d_s, abs=0.002)
        else:
            assert estimate.status == "no_convergence"
            assert np.isnan(estimate.t_d_s)
            assert "local optimum" in estimate.reason
    assert n_right >= 4  # of 6; no growing step leads to the offsets that are refused


def test_signals_are_counts_or_means_of_bins():
    # A time on the border of two bins is in the later bin, and bins continue below zero.
    counts = correlations.counted(np.array([-10_001, -10_000, 0, 9_999, 10_000, 35_000]), 10_000)
    assert counts.first_bin == -2
    assert counts.values.tolist() == [1.0, 1.0, 2.0, 1.0, 0.0, 1.0]
    times_s = np.array([0.021, 0.025, 0.031, 0.055])
    means = correlations.binned(times_s, np.array([1.0, 3.0, 4.0, 8.0]), 0.01)
    assert means.values.tolist() == [2.0, 4.0, 6.0, 8.0]  # the empty bin is interpolated
    assert len(correlations.counted(np.empty(0, np.int64), 10_000).values) == 0
    assert len(correlations.binned(np.empty(0), np.empty(0), 0.01).values) == 0


def test_signals_that_are_constant_or_overlap_by_less_than_half_are_refused(flickering):
    events = np.zeros(4_000, EVENT_DTYPE)
    events["t"] = np.arange(4_000) * 1000 + 500
    far = replace(CLEAN, interval_s=(5.1, 6.0))  # of 10 s
    within_a_bin = replace(CLEAN, interval_s=(0.001, 0.009))
    apart, none = "overlap by half and vary", "no multiple of the bins' length lies in the interval"
    for one, config, said in (
        (Observation(events), CLEAN, apart),
        (flickering, far, apart),
        (flickering, within_a_bin, none),
    ):
        estimate = correlations.zncc_e_of_events(one, one, config)
        assert estimate.status == "no_common_signal"
        assert said in estimate.reason
        assert np.isnan(estimate.t_d_s)


def test_albl_says_that_no_pairs_agree():
    """Bug: if no shift stayed within the interval, the reason was "too few" valid pairs."""
    estimate = found("free", "albl", interval_s=(T_D_S, T_D_S + 1e-7))
    assert estimate.status == "no_convergence"
    assert "only 0 % of the pairs agree" in estimate.reason
