"""Clocks that run fast, wander or jump, on tracks with white noise: no events, no simulator."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.clock import Clock
from ssac.config import Config, checked
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.fit.least_squares import Parameters, Problem, linearise
from ssac.methods import clocks
from ssac.methods.clocks import clock_model
from ssac.methods.joint import refine, sharp_pairs
from tests.ssac.methods.white import DELAYED, T_D_S, truth_of, white_views
from tests.ssac.synthetic import make_scene

SCENE = make_scene(seed=2, duration_s=40.0)
START = truth_of(SCENE)
MIDDLE_S = 20.0
TIMES_S = np.linspace(0.0, SCENE.duration_s, 50)
KNOTS_S = np.arange(0.0, SCENE.duration_s + 1.0, 5.0)
PIECES = {"skew_prior_ppm": 1000.0, "clock": "pieces"}


def views_of(shown=DELAYED, **options):
    return white_views(SCENE, 0.2, shown=shown, **options)


def errors_of(found, shown, times_s=TIMES_S):
    """What a clock that was found shows otherwise; all within four of its deviations."""
    errors_s = found.clock.cam2_from_cam1(times_s) - shown.cam2_from_cam1(times_s)
    assert found.status == "ok"
    assert (np.abs(errors_s) < 4.0 * found.clock_std_s(times_s)).all()
    return errors_s


@pytest.mark.parametrize("skew_ppm", [0.0, 50.0, -20.0])
@pytest.mark.parametrize("known", [False, True])
def test_a_skew_is_found_within_its_deviation(skew_ppm, known):
    clock = Clock(T_D_S, skew_ppm, MIDDLE_S)
    found = refine(START, views_of(clock, known=known))
    errors_of(found, clock, np.array([0.0, MIDDLE_S, SCENE.duration_s]))
    assert found.t_ref_s == pytest.approx(MIDDLE_S, abs=1e-2)  # the common time's, at 50 ppm
    assert 0.5 < found.skew_std_ppm < 40.0
    assert found.skew_ppm == pytest.approx(skew_ppm, abs=4.0 * found.skew_std_ppm)
    assert found.clock_std_s(np.array([found.t_ref_s]))[0] == pytest.approx(found.t_d_std_s)


def test_the_prior_says_how_far_a_skew_may_be():
    large = Clock(T_D_S, 1000.0, MIDDLE_S)  # 20 ms at both ends
    found = refine(START, views_of(large, skew_prior_ppm=1000.0))
    assert found.skew_ppm == pytest.approx(1000.0, abs=4.0 * found.skew_std_ppm)
    assert found.skew_std_ppm < 20.0
    held = refine(START, views_of(Clock(T_D_S, 40.0, MIDDLE_S), skew_prior_ppm=1.0))
    assert held.skew_std_ppm < 1.1
    assert abs(held.skew_ppm) < 10.0  # held back, though not to 1 ppm: the data tell it well


def test_without_a_prior_both_clocks_run_alike():
    views = views_of(skew_prior_ppm=0.0)
    assert len(clock_model(views, START).deviations) == 0  # and so no column
    found = refine(START, views)
    assert (found.skew_ppm, found.skew_std_ppm, found.clock_covariance) == (0.0, 0.0, None)
    assert found.clock.is_delay
    # The middle's offset hardly depends on the skew, nor does its deviation.
    skewed = refine(START, views_of())
    assert abs(found.t_d_s - skewed.t_d_s) < found.t_d_std_s
    assert skewed.t_d_std_s == pytest.approx(found.t_d_std_s, rel=0.1)


@pytest.mark.parametrize("size_s", [0.005, 0.020])
def test_a_jump_is_refused_with_its_time_and_size(size_s):
    found = refine(START, views_of(jump=(15.0, size_s)))
    assert (found.status, found.has_offset, found.R) == ("clock_jump", False, None)
    jump = found.jump
    assert jump.at_s == pytest.approx(15.0, abs=0.5)  # samples 0.1 s apart, with noise
    assert jump.size_s == pytest.approx(size_s, abs=4.0 * jump.size_std_s)
    assert jump.before_s == pytest.approx(T_D_S, abs=1e-3)
    assert jump.after_s == pytest.approx(T_D_S + size_s, abs=1e-3)
    assert f"jumps by {1e3 * size_s:+.0f}"[:13] in found.reason
    assert found.delayed(0.1).jump.before_s == pytest.approx(jump.before_s + 0.1)


def test_a_clock_of_pieces_follows_one_that_wanders():
    wanders = Clock(T_D_S, 300.0, MIDDLE_S, KNOTS_S, 0.001 * np.sin(KNOTS_S / 6.0))
    found = refine(START, views_of(wanders, **PIECES))
    assert len(found.knots_s) == 9  # 8 pieces of 5 s
    line = np.polynomial.Polynomial.fit(TIMES_S, wanders.added_s(TIMES_S), 1)
    strays_s = wanders.added_s(TIMES_S) - line(TIMES_S)
    assert np.std(errors_of(found, wanders)) < 0.6 * np.std(strays_s)


def test_a_rougher_clock_follows_better_what_frames_of_a_varying_rate_show():
    # The skew changes by 1000 ppm twice, as where every 1000th frame is missed for 10 s.
    varies = Clock(T_D_S, 0.0, MIDDLE_S, KNOTS_S, 0.005 * np.sign(KNOTS_S - MIDDLE_S))
    smooth, rough = (
        refine(START, views_of(varies, **PIECES, roughness_ppm=ppm)) for ppm in (200.0, 2000.0)
    )
    assert smooth.status == "ok"
    off_s = smooth.clock.cam2_from_cam1(TIMES_S) - varies.cam2_from_cam1(TIMES_S)
    assert np.std(errors_of(rough, varies)) < 0.8 * np.std(off_s)


def test_strays_have_no_offset_and_no_skew_of_their_own():
    model = clock_model(views_of(clock="pieces"), START)
    affine = np.column_stack([np.ones(len(model.knots_s)), model.knots_s])
    assert np.abs(affine.T @ model.modes).max() < 1e-9  # rounding
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
        ({"roughness_ppm": 0.0}, "roughness_ppm must be above 0 and up to 100000, got 0"),
        ({"clock": "pieces", "skew_prior_ppm": 0.0}, "its prior must be above 0 ppm"),
        ({"border_px": -3}, "border_px must be a whole number of 0 to .*, got -3"),
        ({"max_border_fraction": 1.5}, "max_border_fraction must be 0 to 1, got 1.5"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(options, words):
    with pytest.raises(SsacError, match=words):
        checked(Config(**options))


@pytest.mark.parametrize(("known", "name"), [(False, "algorithm_2"), (True, "algorithm_1")])
def test_far_skews_are_searched_for_and_near_ones_are_not(known, name, monkeypatch):
    tried_ppm, refused = [], Estimate("ssac", "no_match")

    def search(views):
        tried_ppm.append(views.clock.skew_ppm)
        d_avg_px = abs(views.clock.skew_ppm - 2900.0)
        return replace(START, d_avg_px=d_avg_px) if d_avg_px < 2000.0 else refused

    monkeypatch.setattr(clocks, name, search)
    for prior_ppm in (0.0, 50.0):  # 3 ms at the ends of 40 s, three deviations off
        views = views_of(known=known, skew_prior_ppm=prior_ppm)
        assert clocks.with_coarse_skew(refused, views) is refused
    assert not tried_ppm
    views = views_of(known=known, skew_prior_ppm=1000.0)
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


def test_a_skew_that_is_searched_for_keeps_its_clock(monkeypatch):
    """An offset holds at t_ref, which moves with the common time of what is found."""
    shown = []

    def search(views):
        shown.append(replace(views.clock, t_d_s=8.0))
        return replace(START, t_d_s=8.0, d_avg_px=abs(views.clock.skew_ppm - 1500.0))

    monkeypatch.setattr(clocks, "algorithm_2", search)
    views = views_of(skew_prior_ppm=1000.0)
    found = clocks.with_coarse_skew(Estimate("ssac", "no_match"), views)
    (clock,) = [one for one in shown if one.skew_ppm == found.skew_ppm]
    assert abs(found.t_ref_s - clock.t_ref_s) > 3.0  # half of the 8 s by which less is common
    expected_s = clock.cam2_from_cam1(TIMES_S)
    # Rounding.
    np.testing.assert_allclose(found.clock.cam2_from_cam1(TIMES_S), expected_s, atol=1e-12)


@pytest.mark.parametrize(("skew_ppm", "status"), [(50.0, "ok"), (200.0, "clock_jump")])
def test_a_skew_far_from_its_prior_speaks_for_a_jump(skew_ppm, status):
    """A step of few deviations is one only where the skew, 50 ppm beforehand, is bent by it."""
    views = views_of(jump=(18.0, 0.003))
    parameters = Parameters(START.t_d_s, START.R, START.t, np.zeros(1))
    model = clock_model(views, START)
    times_s = views.sample_times(np.array([START.t_d_s]))[0]
    pairs, _ = sharp_pairs(*views.sharp_at(times_s, START.t_d_s), START.t_d_s)
    plain = Problem(pairs, views.rig, views.rules.fit)
    problem = model.problem(plain, parameters, views)
    last = linearise(problem, model.solve(problem, parameters).parameters)
    jump = clocks.checked_clock(START, model, last).jump
    sigmas = jump.size_s / jump.size_std_s
    rules = replace(model.rules, jump_sigmas=1.1 * sigmas, fewer_sigmas=0.5 * sigmas)
    skewed = replace(START, skew_ppm=skew_ppm)
    assert clocks.checked_clock(skewed, replace(model, rules=rules), last).status == status
