"""The joint refinement, and the clock of camera 2, on tracks with white noise, not on events."""

from dataclasses import astuple, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from ssac import Clock, Config, Estimate, TwoViews
from ssac.fit.intrinsics import Allowance
from ssac.fit.least_squares import Parameters, Problem, solve
from ssac.geometry.epipolar import fundamental_from_pose, sampson_distance
from ssac.methods import clocks
from ssac.methods.clocks import clock_model
from ssac.methods.joint import refine, sharp_pairs
from ssac.methods.refinement import smooth_errors
from ssac.rules import ClockRules, FitRules, JointRules
from ssac.track.motion import SharpTrack, Track
from tests.experiments.studies.test_efficiency import bound_of, fly
from tests.ssac.box import errors, off_the_truth
from tests.ssac.methods.flights import T_D_S
from tests.ssac.synthetic import OTHER, make_scene, track_pair

SIZE_PX = 10.0  # of each image
DELAYED = Clock(T_D_S)


class WhiteMotion:
    """Stands for an ObjectMotion: the true track, and noise that depends on the index alone."""

    def __init__(self, scene, view, clock, noise):
        self.scene, self.view, self.clock, self.noise = scene, view, clock, noise
        self.span_s = tuple(clock.cam2_from_cam1(np.array([0.0, scene.duration_s])).tolist())

    def _true(self, times_s):
        return track_pair(self.scene, self.clock.cam1_from_cam2(times_s))[self.view]

    def at(self, times_s):
        counts, valid = np.full(times_s.shape, 1000), np.ones(times_s.shape, dtype=bool)
        return Track(times_s, self._true(times_s) + self.noise(times_s.shape), counts, valid)

    def velocities_at(self, times_s):
        return (self._true(times_s + 1e-4) - self._true(times_s - 1e-4)) / 2e-4

    def sharp_at(self, times_s):
        sizes_px = np.full(times_s.shape, SIZE_PX)
        return SharpTrack(*astuple(self.at(times_s)), self.velocities_at(times_s), sizes_px)


def white_views(scene, sigma_px, seed=0, shown=DELAYED, known=False, **options):
    """Views of a flight; camera 2's clock is `shown`."""

    def noise(view, shape):
        return np.random.default_rng((seed, view)).normal(0.0, sigma_px, (*shape, 2))

    motions = [WhiteMotion(scene, k, (Clock(), shown)[k], partial(noise, k)) for k in (0, 1)]
    return TwoViews(*motions, scene.rig, Config(denoise=False, **options), known)


def truth_of(scene, t_d_s=T_D_S):
    """The true pose, and the true offset or another one, as an estimate."""
    return Estimate("joint", t_d_s=t_d_s, R=scene.R, t=scene.t / np.linalg.norm(scene.t))


SCENE = make_scene(seed=0)
VIEWS = white_views(SCENE, 0.3)


def test_zero_noise_and_a_wrong_start_give_the_truth():
    scene = make_scene(seed=1)
    found = refine(off_the_truth(scene), white_views(scene, 0.0))
    assert np.all(errors(found, scene) < [1e-2, 1e-3, 1e-3])  # where the rounds stop


@pytest.mark.parametrize(("sigma_px", "duration_s"), [(0.9, 20.0), (0.2, 10.0)])
def test_errors_follow_the_cramer_rao_bound(sigma_px, duration_s):
    n = int(20 * duration_s)  # the same sampling rate: longer recordings have more samples
    ratios, normalised = [], []
    for seed in range(40):
        scene = make_scene(seed % 8, duration_s=duration_s)
        estimate = refine(truth_of(scene), white_views(scene, sigma_px, seed, n_samples=n))
        t_d_s, *pose_rad = bound_of(fly(scene, n), noise_px=sigma_px)
        ratios.append(errors(estimate, scene) / [1e3 * t_d_s, *np.degrees(pose_rad)])
        normalised.append((estimate.t_d_s - T_D_S) / estimate.t_d_std_s)
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    # Cauchy's loss adds 2.5 % to deviations. The rms of 40 runs is known to 11 %: three times that.
    assert np.all((rms > 0.65) & (rms < 1.4))
    # The estimated deviation of t_d is the true one; 40 correlation times make it a little small.
    assert np.sqrt(np.mean(np.square(normalised))) == pytest.approx(1.0, abs=0.4)


@pytest.mark.parametrize("view", [0, 1])
@pytest.mark.parametrize("part", range(3))
def test_hidden_errors_are_what_a_bias_of_a_view_does(view, part):
    """A bias is constant, or proportional to x / z or y / z of the view's own camera."""
    scene = replace(SCENE, cam2=OTHER)
    points = np.array(track_pair(scene, np.linspace(0.5, 19.5, 50)))
    K1, K2 = scene.rig.cam1.K, scene.rig.cam2.K
    F = fundamental_from_pose(K1, K2, scene.R, scene.t)
    size_px, bias, step = 8.0, (0.04, 0.04, 0.01), 1e-5
    seen = SimpleNamespace(F=F, p1_px=points[0], p2_px=points[1], problem=scene)
    found = smooth_errors(seen, size_px, bias[2], bias[0])
    rays = np.column_stack([points[view], np.ones(50)]) @ np.linalg.inv((K1, K2)[view]).T
    for axis in range(2):
        shift = np.zeros_like(points)
        shift[view, :, axis] = step * size_px * bias[part] * rays[:, part]
        upper, lower = (sampson_distance(F, *(points + by)) for by in (shift, -shift))
        column = found[:, 6 * view + 3 * axis + part]
        # The tolerance is rounding, divided by the step.
        np.testing.assert_allclose(column, (upper - lower) / (2.0 * step), atol=1e-6)


def test_going_where_the_views_share_nothing_is_refused(monkeypatch):
    """Bug: a refinement of a circling drone reached an offset without pairs, and crashed."""
    start = truth_of(SCENE, t_d_s=0.06)
    seen = VIEWS.motion2.sharp_at

    def unseen_at_the_truth(times_s):
        track = seen(times_s)
        first_s = VIEWS.sample_times(np.array([start.t_d_s]))[0] + start.t_d_s
        return replace(track, valid=track.valid & np.isin(times_s, first_s))

    monkeypatch.setattr(VIEWS.motion2, "sharp_at", unseen_at_the_truth)
    estimate = refine(start, VIEWS)
    assert estimate.status == "no_convergence"
    assert "only 0 sample times are valid in both views" in estimate.reason


def test_steps_that_run_out_are_refused(monkeypatch):
    """Bug: where the steps ran out, the last one's result was "ok"."""
    # The skew has no prior here, as with a prior there are two rounds at least.
    views, start = white_views(SCENE, 0.3, skew_prior_ppm=0.0), truth_of(SCENE, t_d_s=0.06)
    monkeypatch.setattr(clocks, "solve", partial(solve, max_steps=1, last_step=1e-12))
    estimate = refine(start, views.by(joint=JointRules(last_shift_s=1.0)))
    assert estimate.status == "no_convergence"
    assert "still moved" in estimate.reason


# --- Clocks that run fast, wander or jump ---

LONG = make_scene(seed=2, duration_s=40.0)
START = truth_of(LONG)
MIDDLE_S = 20.0
TIMES_S = np.linspace(0.0, LONG.duration_s, 50)
KNOTS_S = np.arange(0.0, LONG.duration_s + 1.0, 5.0)
PIECES = {"skew_prior_ppm": 1000.0, "clock": "pieces"}


def views_of(shown=DELAYED, **options):
    return white_views(LONG, 0.2, shown=shown, **options)


def clock_errors_of(found, shown, times_s=TIMES_S):
    """Return the errors [s] of a clock that was found, each within four of its deviations."""
    errors_s = found.clock.cam2_from_cam1(times_s) - shown.cam2_from_cam1(times_s)
    assert found.status == "ok"
    assert (np.abs(errors_s) < 4.0 * found.clock_std_s(times_s)).all()
    return errors_s


@pytest.mark.parametrize("skew_ppm", [0.0, 50.0, -20.0])
@pytest.mark.parametrize("known", [False, True])
def test_a_skew_is_found_within_its_deviation(skew_ppm, known):
    clock = Clock(T_D_S, skew_ppm, MIDDLE_S)
    found = refine(START, views_of(clock, known=known))
    clock_errors_of(found, clock, np.array([0.0, MIDDLE_S, LONG.duration_s]))
    assert found.t_ref_s == pytest.approx(MIDDLE_S, abs=1e-2)  # a skew of 50 ppm moves the middle
    assert 0.5 < found.skew_std_ppm < 40.0
    assert found.skew_ppm == pytest.approx(skew_ppm, abs=4.0 * found.skew_std_ppm)
    assert found.clock_std_s(np.array([found.t_ref_s]))[0] == pytest.approx(found.t_d_std_s)


@pytest.mark.parametrize(
    ("skew_ppm", "options", "is_far"),
    [
        (20.0, {}, False),
        (300.0, {}, True),
        (300.0, {"skew_prior_ppm": 1000.0}, False),
        (300.0, {"skew_prior_ppm": 0.0}, True),  # though no skew is estimated
        (20.0, {"skew_prior_ppm": 0.0}, False),
        (300.0, {"clock": "pieces"}, False),  # pieces follow any skew
    ],
)
@pytest.mark.parametrize("known", [False, True])
def test_what_is_seen_speaks_against_a_prior_of_the_skew_that_is_too_narrow(
    skew_ppm, options, is_far, known
):
    views = views_of(Clock(T_D_S, skew_ppm, MIDDLE_S), known=known, **options)
    assert (refine(START, views).against_skew > views.rules.retry.far_skew) is is_far


def test_without_a_prior_both_clocks_run_alike():
    views = views_of(skew_prior_ppm=0.0)
    assert len(clock_model(views, START).deviations) == 0  # so the problem has no column
    found = refine(START, views)
    assert (found.skew_ppm, found.skew_std_ppm, found.clock_covariance) == (0.0, 0.0, None)
    assert found.clock.is_delay
    # The offset at the middle, and its deviation, hardly depend on the skew.
    skewed = refine(START, views_of())
    assert abs(found.t_d_s - skewed.t_d_s) < found.t_d_std_s
    assert skewed.t_d_std_s == pytest.approx(found.t_d_std_s, rel=0.1)


def jumping(at_s, size_s):
    """A clock that jumps at this time of camera 1's."""
    return Clock(T_D_S, 0.0, MIDDLE_S, at_s + np.array([0.0, 1e-6]), np.array([0.0, size_s]))


@pytest.mark.parametrize("size_s", [0.005, 0.020])
def test_a_jump_is_refused_with_its_time_and_size(size_s):
    found = refine(START, views_of(jumping(15.0, size_s)))
    assert (found.status, found.has_offset, found.R) == ("clock_jump", False, None)
    jump = found.jump
    assert jump.at_s == pytest.approx(15.0, abs=0.5)  # samples are 0.1 s apart, and noisy
    assert jump.size_s == pytest.approx(size_s, abs=4.0 * jump.size_std_s)
    assert jump.before_s == pytest.approx(T_D_S, abs=1e-3)
    assert jump.after_s == pytest.approx(T_D_S + size_s, abs=1e-3)
    assert f"jumps by {1e3 * size_s:+.0f}"[:13] in found.reason
    assert found.delayed(0.1).jump.before_s == pytest.approx(jump.before_s + 0.1)


@pytest.mark.parametrize("skew_ppm", [1000.0, -1000.0])
def test_a_clock_that_runs_fast_is_not_said_to_jump_and_found_where_it_may_be(skew_ppm):
    clock = Clock(T_D_S, skew_ppm, MIDDLE_S)  # 20 ms at both ends
    allowed = refine(START, views_of(clock, skew_prior_ppm=1000.0))
    assert allowed.skew_ppm == pytest.approx(skew_ppm, abs=4.0 * allowed.skew_std_ppm)
    assert allowed.skew_std_ppm < 20.0
    for prior_ppm in (50.0, 0.0):  # bug: with 0 a jump of 20 ms was made up
        found = refine(START, views_of(clock, skew_prior_ppm=prior_ppm))
        assert (found.status, found.has_offset) == ("poor_fit", False)
        assert f"far beyond the prior deviation of {prior_ppm:g} ppm" in found.reason
        said_ppm = float(found.reason.partition("a skew of ")[2].partition(" ppm")[0])
        assert said_ppm == pytest.approx(skew_ppm, rel=0.05)  # the estimate is of first order


def test_a_clock_of_pieces_follows_one_that_wanders():
    wanders = Clock(T_D_S, 300.0, MIDDLE_S, KNOTS_S, 0.001 * np.sin(KNOTS_S / 6.0))
    views = views_of(wanders, **PIECES)
    model, found = clock_model(views, START), refine(START, views)
    affine = np.column_stack([np.ones(len(model.knots_s)), model.knots_s])
    assert np.abs(affine.T @ model.modes).max() < 1e-9  # strays have no offset, no skew: rounding
    assert len(found.knots_s) == 9  # 8 pieces of 5 s
    line = np.polynomial.Polynomial.fit(TIMES_S, wanders.added_s(TIMES_S), 1)
    strays_s = wanders.added_s(TIMES_S) - line(TIMES_S)
    assert np.std(clock_errors_of(found, wanders)) < 0.6 * np.std(strays_s)


def test_what_a_clock_strays_unseen_makes_no_prior_heavy():
    """The data leave strays within a gap open; each mode spans all times, also those of the gap."""
    views = views_of(**PIECES, roughness_ppm=2000.0).by(clock=ClockRules(piece_s=1.0))
    model, times_s = clock_model(views, START), np.linspace(0.1, 39.9, 400)
    pairs, _ = sharp_pairs(views, times_s[np.abs(times_s - MIDDLE_S) >= 8.0], T_D_S)
    start = Parameters(T_D_S, START.R, START.t, np.zeros(len(model.deviations)))
    problem = model.problem(Problem(pairs, views.rig, FitRules()), start, views)
    allowance = Allowance(problem.rig, has_priors=True)
    allowance.learn(problem, solve(problem, start, max_steps=50).parameters)
    scales_px = np.array([prior.scale_px for prior in allowance.added(problem).priors])
    # White noise: each residual is independent, so that a prior counts as one. The fit absorbs a
    # tenth of the noise, and the correlations of the residuals are known to some 10 %.
    assert len(scales_px) >= len(model.deviations) > 10
    assert scales_px == pytest.approx(np.full(len(scales_px), 0.2), rel=0.3)


def test_a_rougher_clock_follows_better_what_frames_of_a_varying_rate_show():
    # The skew changes by 1000 ppm twice, as where every 1000th frame is missed for 10 s.
    varies = Clock(T_D_S, 0.0, MIDDLE_S, KNOTS_S, 0.005 * np.sign(KNOTS_S - MIDDLE_S))
    smooth, rough = (
        refine(START, views_of(varies, **PIECES, roughness_ppm=ppm)) for ppm in (200.0, 2000.0)
    )
    assert smooth.status == "ok"
    off_s = smooth.clock.cam2_from_cam1(TIMES_S) - varies.cam2_from_cam1(TIMES_S)
    assert np.std(clock_errors_of(rough, varies)) < 0.8 * np.std(off_s)


@pytest.mark.parametrize(("known", "name"), [(False, "algorithm_2"), (True, "algorithm_1")])
def test_far_skews_are_searched_for_with_their_clocks_and_near_ones_are_not(
    known, name, monkeypatch
):
    """An offset holds at t_ref, which moves with the common time at the offset found."""
    tried, refused = [], Estimate("ssac", "no_match")

    def search(views):
        tried.append(replace(views.clock, t_d_s=8.0))
        d_avg_px = abs(views.clock.skew_ppm - 2900.0)
        return replace(START, t_d_s=8.0, d_avg_px=d_avg_px) if d_avg_px < 2000.0 else refused

    monkeypatch.setattr(clocks, name, search)
    for prior_ppm in (0.0, 50.0):  # three deviations of 50 ppm are 3 ms at the ends of 40 s
        views = views_of(known=known, skew_prior_ppm=prior_ppm)
        assert clocks.with_coarse_skew(refused, views) is refused
    assert not tried
    views = views_of(known=known, skew_prior_ppm=1000.0)
    found = clocks.with_coarse_skew(refused, views)
    skews_ppm = sorted([0.0, *(clock.skew_ppm for clock in tried)])
    assert skews_ppm[-1] >= 3000.0
    assert skews_ppm.count(0.0) == 1  # a skew of 0 is the start's
    # Half a step is 20 ms at the ends; 5 % are for a common time that is estimated, not exact.
    assert 0.5 * np.diff(skews_ppm).max() * 1e-6 * 20.0 <= 0.020 * 1.05
    best = min(tried, key=lambda clock: abs(clock.skew_ppm - 2900.0))
    assert best.t_ref_s == pytest.approx(MIDDLE_S, abs=0.1)
    assert (found.skew_ppm, found.t_ref_s) == (best.skew_ppm, pytest.approx(16.0, abs=0.1))
    expected_s = best.cam2_from_cam1(TIMES_S)
    # The tolerance is rounding.
    np.testing.assert_allclose(found.clock.cam2_from_cam1(TIMES_S), expected_s, atol=1e-12)
    fits = replace(START, d_avg_px=1.0)  # better than with any other skew
    assert clocks.with_coarse_skew(fits, views) is fits


@pytest.mark.parametrize(("prior_ppm", "status"), [(100.0, "ok"), (25.0, "clock_jump")])
def test_a_skew_far_from_its_prior_speaks_for_a_jump(prior_ppm, status):
    views = views_of(jumping(18.0, 0.003), skew_prior_ppm=prior_ppm)  # which bends it by 140 ppm
    jump = refine(START, views.by(clock=ClockRules(jump_sigmas=1.0, fewer_sigmas=1.0))).jump
    sigmas = jump.size_s / jump.size_std_s
    rules = ClockRules(jump_sigmas=1.1 * sigmas, fewer_sigmas=0.5 * sigmas)
    assert refine(START, views.by(clock=rules)).status == status
