"""Clocks that run fast, wander or jump, on tracks with white noise: no events, no simulator."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.clock import Clock
from ssac.config import Config, checked
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.fit.least_squares import Parameters, Problem
from ssac.methods import clocks
from ssac.methods.clocks import clock_model
from ssac.methods.joint import refine, sharp_pairs
from ssac.search.two_views import TwoViews
from ssac.track.motion import SharpTrack, Track
from tests.ssac.synthetic import make_scene, track_pair

CLEAN = Config(denoise=False)
SCENE = make_scene(seed=2, duration_s=40.0)
START = Estimate("joint", t_d_s=0.05, R=SCENE.R, t=SCENE.t / np.linalg.norm(SCENE.t))
SIGMA_PX = 0.2
MIDDLE_S = 20.0


class Motion:
    """Stands for an ObjectMotion: the true track, with noise, on a clock of its own."""

    def __init__(self, view, clock, seed, jump=(np.inf, 0.0)):
        self.view, self.clock, self.seed, self.jump = view, clock, seed, jump
        self.span_s = tuple(clock.cam2_from_cam1(np.array([0.0, SCENE.duration_s])).tolist())

    def _true(self, times_s):
        seen_s = self.clock.cam1_from_cam2(times_s)
        at_s, size_s = self.jump
        seen_s = np.where(seen_s >= at_s + size_s, seen_s - size_s, seen_s)
        return track_pair(SCENE, seen_s)[self.view]

    def at(self, times_s):
        noise = np.random.default_rng(self.seed).normal(0.0, SIGMA_PX, (*times_s.shape, 2))
        valid = np.ones(times_s.shape, dtype=bool)
        return Track(times_s, self._true(times_s) + noise, np.full(times_s.shape, 1000), valid)

    def velocities_at(self, times_s):
        return (self._true(times_s + 1e-4) - self._true(times_s - 1e-4)) / 2e-4

    def sharp_at(self, times_s):
        velocities = self.velocities_at(times_s)
        track = self.at(times_s)
        sizes = np.full(times_s.shape, 10.0)
        return SharpTrack(times_s, track.positions_px, track.counts, track.valid, velocities, sizes)


def views_of(shown, seed=0, jump=(np.inf, 0.0), known=False, **options):
    motions = Motion(0, Clock(), (seed, 0)), Motion(1, shown, (seed, 1), jump)
    return TwoViews(*motions, SCENE.rig, replace(CLEAN, **options), known)


@pytest.mark.parametrize("skew_ppm", [0.0, 50.0, -20.0])
@pytest.mark.parametrize("known", [False, True])
def test_a_skew_is_found_within_its_deviation(skew_ppm, known):
    clock = Clock(0.05, skew_ppm, MIDDLE_S)
    found = refine(START, views_of(clock, known=known))
    assert found.status == "ok"
    assert found.t_ref_s == pytest.approx(MIDDLE_S, abs=1e-2)  # the common time's, at 50 ppm
    assert 0.5 < found.skew_std_ppm < 40.0
    assert found.skew_ppm == pytest.approx(skew_ppm, abs=4.0 * found.skew_std_ppm)
    ends_s = np.array([0.0, MIDDLE_S, SCENE.duration_s])
    errors_s = found.clock.cam2_from_cam1(ends_s) - clock.cam2_from_cam1(ends_s)
    assert (np.abs(errors_s) < 4.0 * found.clock_std_s(ends_s)).all()
    assert found.clock_std_s(np.array([found.t_ref_s]))[0] == pytest.approx(found.t_d_std_s)


def test_a_prior_of_phones_finds_a_large_skew():
    clock = Clock(0.05, 1000.0, MIDDLE_S)  # 20 ms at both ends
    found = refine(START, views_of(clock, skew_prior_ppm=1000.0))
    assert found.skew_ppm == pytest.approx(1000.0, abs=4.0 * found.skew_std_ppm)
    assert found.skew_std_ppm < 20.0


def test_without_a_prior_both_clocks_run_alike():
    views = views_of(Clock(0.05), skew_prior_ppm=0.0)
    model = clock_model(views, START)
    assert len(model.deviations) == 0  # and so no column: the estimate of before, bit for bit
    found = refine(START, views)
    assert (found.skew_ppm, found.skew_std_ppm, found.clock_covariance) == (0.0, 0.0, None)
    assert found.clock.is_delay
    # The middle's offset hardly depends on the skew, nor does its deviation.
    skewed = refine(START, views_of(Clock(0.05)))
    assert abs(found.t_d_s - skewed.t_d_s) < found.t_d_std_s
    assert skewed.t_d_std_s == pytest.approx(found.t_d_std_s, rel=0.1)


def test_a_deviation_is_at_most_the_prior():
    found = refine(START, views_of(Clock(0.05, 40.0, MIDDLE_S), skew_prior_ppm=1.0))
    assert found.skew_std_ppm < 1.1
    assert abs(found.skew_ppm) < 10.0  # held back, though not to 1 ppm: the data tell it well


@pytest.mark.parametrize("size_s", [0.005, 0.020])
def test_a_jump_is_refused_with_its_time_and_size(size_s):
    found = refine(START, views_of(Clock(0.05), jump=(15.0, size_s)))
    assert found.status == "clock_jump"
    assert not found.has_offset
    assert found.R is None
    jump = found.jump
    assert jump.at_s == pytest.approx(15.0, abs=0.5)  # samples 0.1 s apart, with noise
    assert jump.size_s == pytest.approx(size_s, abs=4.0 * jump.size_std_s)
    assert jump.before_s == pytest.approx(0.05, abs=1e-3)
    assert jump.after_s == pytest.approx(0.05 + size_s, abs=1e-3)
    assert f"jumps by {1e3 * size_s:+.0f}"[:13] in found.reason
    assert found.delayed(0.1).jump.before_s == pytest.approx(jump.before_s + 0.1)


def test_a_clock_of_pieces_follows_one_that_wanders():
    knots_s = np.arange(0.0, SCENE.duration_s + 1.0, 5.0)
    wanders = Clock(0.05, 300.0, MIDDLE_S, knots_s, 0.001 * np.sin(knots_s / 6.0))
    options = {"skew_prior_ppm": 1000.0, "clock": "pieces"}
    found = refine(START, views_of(wanders, **options))
    assert found.status == "ok"
    assert len(found.knots_s) == 9  # 8 pieces of 5 s
    times_s = np.linspace(0.0, SCENE.duration_s, 50)
    errors_s = found.clock.cam2_from_cam1(times_s) - wanders.cam2_from_cam1(times_s)
    assert (np.abs(errors_s) < 4.0 * found.clock_std_s(times_s)).all()
    line = np.polynomial.Polynomial.fit(times_s, wanders.added_s(times_s), 1)
    assert np.std(errors_s) < 0.6 * np.std(wanders.added_s(times_s) - line(times_s))


def test_a_rougher_clock_follows_better_what_frames_of_a_varying_rate_show():
    knots_s = np.arange(0.0, SCENE.duration_s + 1.0, 5.0)
    # The skew changes by 1000 ppm twice, as where every 1000th frame is missed for 10 s.
    varies = Clock(0.05, 0.0, MIDDLE_S, knots_s, 0.005 * np.sign(knots_s - MIDDLE_S))
    options = {"skew_prior_ppm": 1000.0, "clock": "pieces"}
    times_s = np.linspace(0.0, SCENE.duration_s, 50)
    errors_s = {}
    for roughness_ppm in (200.0, 2000.0):
        found = refine(START, views_of(varies, **options, roughness_ppm=roughness_ppm))
        assert found.status == "ok"
        errors_s[roughness_ppm] = found.clock.cam2_from_cam1(times_s) - varies.cam2_from_cam1(
            times_s
        )
    assert (np.abs(errors_s[2000.0]) < 4.0 * found.clock_std_s(times_s)).all()
    assert np.std(errors_s[2000.0]) < 0.8 * np.std(errors_s[200.0])


def test_strays_have_no_offset_and_no_skew_of_their_own():
    model = clock_model(views_of(Clock(0.05), clock="pieces"), START)
    affine = np.column_stack([np.ones(len(model.knots_s)), model.knots_s])
    assert np.abs(affine.T @ model.modes).max() < 1e-9
    assert (np.diff(model.deviations[1:]) != 0.0).all()
    # A start of its own clock gives the same values.
    values = np.concatenate([[2e-5], np.arange(model.modes.shape[1]) * 1e-5])
    strays_s = model.modes @ values[1:]
    start = replace(START, skew_ppm=20.0, t_ref_s=20.0, knots_s=model.knots_s, strays_s=strays_s)
    np.testing.assert_allclose(model.start(start), values, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"skew_prior_ppm": -1.0}, "skew_prior_ppm must be 0 to 100000, got -1"),
        ({"skew_prior_ppm": np.nan}, "got nan"),
        ({"clock": "quartz"}, "clock must be auto or affine or pieces, got 'quartz'"),
        ({"roughness_ppm": 0.0}, "roughness_ppm must be above 0 and up to 100000, got 0"),
        ({"clock": "pieces", "skew_prior_ppm": 0.0}, "its prior must be above 0 ppm"),
        ({"half_window_s": np.inf}, "half_window_s must be positive and finite, got inf"),
        ({"seed": -1}, "seed must be a whole number of 0 to .*, got -1"),
        ({"border_px": -3}, "border_px must be a whole number of 0 to .*, got -3"),
        ({"min_swings": np.nan}, "min_swings must be 0 or more, and finite, got nan"),
        ({"max_border_fraction": 1.5}, "max_border_fraction must be 0 to 1, got 1.5"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(options, words):
    with pytest.raises(SsacError, match=words):
        checked(Config(**options))


@pytest.mark.parametrize(("known", "name"), [(False, "algorithm_2"), (True, "algorithm_1")])
def test_far_skews_are_searched_for_and_near_ones_are_not(known, name, monkeypatch):
    tried_ppm = []

    def search(views):
        tried_ppm.append(views.clock.skew_ppm)
        d_avg_px = abs(views.clock.skew_ppm - 2900.0)
        return (
            replace(START, d_avg_px=d_avg_px) if d_avg_px < 2000.0 else Estimate("ssac", "no_match")
        )

    monkeypatch.setattr(clocks, name, search)
    refused = Estimate("ssac", "no_match")
    for prior_ppm in (0.0, 50.0):  # 3 ms at the ends of 40 s, three deviations off
        views = views_of(Clock(0.05), known=known, skew_prior_ppm=prior_ppm)
        assert clocks.with_coarse_skew(refused, views) is refused
    assert not tried_ppm
    views = views_of(Clock(0.05), known=known, skew_prior_ppm=1000.0)
    found = clocks.with_coarse_skew(refused, views)
    assert max(tried_ppm) >= 3000.0
    assert 0.0 not in tried_ppm  # that was the start
    steps_ppm = np.diff(sorted([*tried_ppm, 0.0]))
    # 20 ms at the ends, half a step off; the common time is not known to be the whole 40 s.
    assert 0.5 * steps_ppm.max() * 1e-6 * 20.0 <= 0.020 * 1.05
    assert found.skew_ppm == min(tried_ppm, key=lambda ppm: abs(ppm - 2900.0))
    assert found.t_ref_s == pytest.approx(MIDDLE_S, abs=0.1)
    fits = replace(START, d_avg_px=1.0)  # better than any other
    assert clocks.with_coarse_skew(fits, views) is fits


def test_a_skew_that_is_searched_for_keeps_its_clock():
    """An offset holds at t_ref, which moves with the common time of what is found."""
    shown = []

    def search(views):
        found = replace(START, t_d_s=8.0, d_avg_px=abs(views.clock.skew_ppm - 1500.0))
        shown.append(replace(views.clock, t_d_s=8.0))
        return found

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(clocks, "algorithm_2", search)
        views = views_of(Clock(0.05), skew_prior_ppm=1000.0)
        found = clocks.with_coarse_skew(Estimate("ssac", "no_match"), views)
    (clock,) = [one for one in shown if one.skew_ppm == found.skew_ppm]
    assert abs(found.t_ref_s - clock.t_ref_s) > 3.0  # half of the 8 s by which less is common
    times_s = np.array([0.0, MIDDLE_S, SCENE.duration_s])
    expected_s = clock.cam2_from_cam1(times_s)
    np.testing.assert_allclose(found.clock.cam2_from_cam1(times_s), expected_s, atol=1e-12)


@pytest.mark.parametrize(("skew_ppm", "status"), [(50.0, "ok"), (200.0, "clock_jump")])
def test_a_skew_far_from_its_prior_speaks_for_a_jump(skew_ppm, status):
    """A step of few deviations is one only where the skew, 50 ppm beforehand, is bent by it."""
    views = views_of(Clock(0.05), jump=(18.0, 0.003))
    parameters = Parameters(START.t_d_s, START.R, START.t, np.zeros(1))
    model = clock_model(views, START)
    times_s = views.sample_times(np.array([START.t_d_s]))[0]
    pairs, _ = sharp_pairs(*views.sharp_at(times_s, START.t_d_s), START.t_d_s)
    problem = model.problem(
        pairs, parameters, Problem(pairs, views.rig, views.config.rules.fit), views
    )
    fit = problem, model.solve(problem, parameters).parameters
    jump = clocks.checked_clock(START, model, *fit).jump
    sigmas = jump.size_s / jump.size_std_s
    rules = replace(model.rules, jump_sigmas=1.1 * sigmas, fewer_sigmas=0.5 * sigmas)
    skewed = replace(START, skew_ppm=skew_ppm)
    assert clocks.checked_clock(skewed, replace(model, rules=rules), *fit).status == status
