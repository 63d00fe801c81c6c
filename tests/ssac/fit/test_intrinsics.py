"""Uncertain intrinsics: what they move, that stated deviations grow by them, and what is told."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ssac.camera import Camera, Rig, distort_points, undistort_points, with_deviations
from ssac.fit import intrinsics, least_squares
from ssac.geometry.epipolar import fundamental_from_pose, sampson_distance
from ssac.methods.clocks import ClockModel, _modes
from ssac.rules import ClockRules, FitRules
from ssac.search.two_views import Shutters
from tests.ssac import synthetic

SCENE = synthetic.make_scene(seed=3)
N = 400
TIMES_S = (np.arange(N) + 0.5) * SCENE.duration_s / N
T = SCENE.t / np.linalg.norm(SCENE.t)
TRUTH = least_squares.Parameters(0.0, SCENE.R, T)
LENSES = {
    "none": (),
    "radtan": (-0.3, 0.1, 0.001, -0.0005),
    "equidistant": (-0.02, 0.01, 0.0, 0.0),
}
NAMES = ("fu", "fv", "pu", "pv")


def changed(camera, place, share):
    """A camera, one of whose four intrinsics is larger by a share of the focal length."""
    K_changed = camera.K.copy()
    axis = place % 2
    K_changed[axis, axis if place < 2 else 2] += share * camera.K[axis, axis]
    return replace(camera, K=K_changed)


def problem_of(rig, noise_px=0.0, seed=0, **options):
    """Pairs of a flight with the true intrinsics, to be fitted with those of a rig."""
    p1, p2 = synthetic.track_pair(SCENE, TIMES_S)
    late, early = (synthetic.track_pair(SCENE, TIMES_S + step)[1] for step in (1e-4, -1e-4))
    v2 = (late - early) / 2e-4
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (2, N, 2)) * noise_px
    pairs = least_squares.WeighedPairs(TIMES_S, p1 + noise[0], p2 + noise[1], v2, np.ones(N), 0.0)
    return least_squares.Problem(pairs, rig, FitRules(), **options)


def fitted(problem):
    """The problem with all that is to be allowed for, and its solution."""
    allowance = intrinsics.Allowance(problem.rig)
    first = least_squares.solve(problem, TRUTH).parameters
    allowance.learn(problem, first)
    allowed = allowance.added(problem)
    return allowed, least_squares.solve(allowed, first).parameters


def rig_of(focal, centre_px, **wrong):
    """Both cameras with stated deviations, and camera 1's intrinsics wrong by shares."""
    camera = Camera(synthetic.K, synthetic.WIDTH, synthetic.HEIGHT)
    first = camera
    for name, share in wrong.items():
        first = changed(first, NAMES.index(name), share)
    return Rig(*(with_deviations(one, focal, centre_px) for one in (first, camera)))


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("place", range(4), ids=NAMES)
def test_moves_are_those_of_rays_undistorted_with_other_intrinsics(lens, place):
    camera = Camera(synthetic.K, synthetic.WIDTH, synthetic.HEIGHT, lens, LENSES[lens])
    pixels = np.random.default_rng(0).uniform(
        (20, 20), (synthetic.WIDTH - 20, synthetic.HEIGHT - 20), (50, 2)
    )
    step = 1e-4

    def ideal(other):  # in the image of the first camera's K
        rays = (undistort_points(other, pixels) - other.K[:2, 2]) / np.diag(other.K)[:2]
        return rays * np.diag(synthetic.K)[:2] + synthetic.K[:2, 2]

    moved = (ideal(changed(camera, place, step)) - ideal(changed(camera, place, -step))) / 2 / step
    found = intrinsics.moves_of(camera, undistort_points(camera, pixels))[place]
    # Lengths are up to 200 px; the lens's derivative is by differences of half a pixel.
    np.testing.assert_allclose(found, moved, atol=0.02)
    np.testing.assert_allclose(distort_points(camera, undistort_points(camera, pixels)), pixels)


@pytest.mark.parametrize("number", range(8))
def test_derivatives_of_the_distances_by_the_intrinsics(number):
    problem = problem_of(rig_of(0.01, 1.0))
    columns = intrinsics.columns_of(problem)
    problem = replace(problem, columns=columns)
    found = least_squares.linearise(problem, replace(TRUTH, columns=np.zeros(8))).jacobian
    one, step = intrinsics.uncertain_ones(problem.rig)[number], 1e-6
    points = [problem.pairs.p1_px, problem.pairs.p2_px]
    F = fundamental_from_pose(synthetic.K, synthetic.K, SCENE.R, T)

    def distances(share):
        """Of the rays that the points are of, in the image of the rig's intrinsics."""
        camera = changed(problem.rig.cam1, one.place, share)
        rays = (points[one.camera] - camera.K[:2, 2]) / np.diag(camera.K)[:2]
        seen = list(points)
        seen[one.camera] = rays * np.diag(synthetic.K)[:2] + synthetic.K[:2, 2]
        return sampson_distance(F, *seen)

    difference = (distances(step) - distances(-step)) / (2.0 * step)
    # The error of a central difference is the round-off of lengths of 300 px over the step.
    np.testing.assert_allclose(found[:, least_squares.FIRST_COLUMN + number], difference, atol=1e-5)


def test_exact_intrinsics_add_nothing():
    problem = problem_of(rig_of(0.0, 0.0), noise_px=0.3)
    allowance = intrinsics.Allowance(problem.rig)
    assert allowance.is_made
    assert allowance.added(problem) is problem
    parameters = least_squares.solve(problem, TRUTH).parameters
    assert intrinsics.evidence(least_squares.linearise(problem, parameters)) == (0.0, 0.0)
    np.testing.assert_array_equal(
        intrinsics.fundamental_of(problem, parameters),
        fundamental_from_pose(synthetic.K, synthetic.K, parameters.R, parameters.t),
    )


@pytest.mark.parametrize("pose_is_known", [False, True])
def test_larger_deviations_state_larger_ones(pose_is_known):
    deviations = []
    for factor in (0.0, 0.1, 0.3, 1.0, 3.0, 10.0):
        rig = rig_of(0.001 * factor, 0.3 * factor)
        problem, found = fitted(problem_of(rig, 0.3, pose_is_known=pose_is_known))
        covariance = least_squares.linearise(problem, found).covariance()
        deviations.append(np.sqrt(np.diag(covariance)[: 1 if pose_is_known else 6]))
    # The intrinsics take a part of the noise, and what is left is less by up to 2 %.
    assert np.all(np.diff(deviations, axis=0) > -0.02 * np.array(deviations)[:-1])
    if not pose_is_known:
        # Ten times a good calibration's deviations are more than this noise is worth.
        assert np.all(np.array(deviations)[-1, 1:] > 3.0 * np.array(deviations)[0, 1:])


@pytest.mark.parametrize("seed", range(4))
def test_drawn_errors_are_within_the_stated_deviations(seed):
    rng = np.random.default_rng(seed)
    shares = dict(zip(NAMES, rng.normal(0.0, (0.01, 0.01, 0.015, 0.015)), strict=True))
    problem, found = fitted(problem_of(rig_of(0.01, 3.0, **shares), 0.3, seed))
    covariance = least_squares.linearise(problem, found).covariance()
    error = synthetic.rotation_angle_deg(found.R, SCENE.R)
    # 3.5 deviations of the one angle that strays most.
    assert np.radians(error) < 3.5 * np.sqrt(np.linalg.eigvalsh(covariance[1:4, 1:4])[-1])
    assert abs(found.t_d_s) < 3.5 * np.sqrt(covariance[0, 0])
    # The priors are weaker than this noise for the ratio fu / fv alone, so that the pose of exact
    # intrinsics is nowhere nearer; F is of the points, whatever it is made of.
    F = intrinsics.fundamental_of(problem, found)
    p1, p2 = synthetic.track_pair(SCENE, TIMES_S)
    assert np.median(np.abs(sampson_distance(F, p1, p2))) < 0.1  # of 0.3 px noise at 400 pairs


@pytest.mark.parametrize("gap", [0.0, 0.4])
def test_what_a_clock_strays_unseen_makes_no_prior_heavy(gap):
    """Within a gap the data leave strays open; modes go all along, so each has a part in it."""
    problem, noise_px = problem_of(rig_of(0.0, 0.0), 0.3), 0.3
    kept = np.abs(TIMES_S - np.mean(TIMES_S)) >= 0.5 * gap * np.ptp(TIMES_S)
    columns = {field.name: getattr(problem.pairs, field.name) for field in fields(problem.pairs)}
    arrays = {name: values[kept] for name, values in columns.items() if np.ndim(values)}
    pairs = replace(problem.pairs, **arrays)
    knots_s = np.linspace(TIMES_S[0], TIMES_S[-1], 41)
    modes, deviations_s = _modes(knots_s, 2000.0)
    middle_s, half_s = float(np.mean(TIMES_S)), 0.5 * float(np.ptp(TIMES_S))
    shutters = Shutters((), *np.empty((3, 0)))
    deviations = np.append(1e-3, deviations_s)
    model = ClockModel(middle_s, half_s, deviations, ClockRules(), shutters, knots_s, modes)
    start = replace(TRUTH, columns=np.zeros(len(model.deviations)))
    problem = model.problem(replace(problem, pairs=pairs), start, views=None)
    first = least_squares.solve(problem, start, max_steps=50).parameters
    allowance = intrinsics.Allowance(problem.rig, has_priors=True)
    allowance.learn(problem, first)
    scales_px = np.array([prior.scale_px for prior in allowance.added(problem).priors])
    # White noise: each residual is independent, so that a prior counts as one. The fit takes up a
    # tenth of the noise, and the correlations of what is left are known to some 10 %.
    assert scales_px == pytest.approx(np.full(len(scales_px), noise_px), rel=0.3)


def test_evidence_against_the_intrinsics():
    # fu and fv differ by 3 % where 0.1 % is stated: no pose makes that good.
    problem, found = fitted(problem_of(rig_of(0.001, 0.3, fu=0.03), 0.1))
    residuals = least_squares.linearise(problem, found)
    assert intrinsics.evidence(residuals)[0] > 3.5
    assert "camera 1's focal length wants to be" in intrinsics.wanted(residuals)
    for seed in range(4):
        problem, found = fitted(problem_of(rig_of(0.001, 0.3), 0.1, seed))
        assert intrinsics.evidence(least_squares.linearise(problem, found))[0] < 3.5
