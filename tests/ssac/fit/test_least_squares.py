"""The one solver: columns, priors, uncertain intrinsics, and deviations that grow by them."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.signal import lfilter

from ssac.camera import Camera, Rig, distort_points, undistort_points, with_deviations
from ssac.fit import intrinsics
from ssac.fit.least_squares import (
    FIRST_COLUMN,
    T_D,
    Column,
    Parameters,
    Prior,
    Problem,
    WeighedPairs,
    linearise,
    moved,
    solve,
)
from ssac.geometry.epipolar import CAUCHY, fundamental_from_pose, sampson_distance
from ssac.methods.clocks import ClockModel, _modes
from ssac.rules import ClockRules, FitRules
from ssac.search.two_views import Shutters
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_scene, rotation_angle_deg, track_pair

SCENE = make_scene(seed=2)
N = 400
TIMES_S = (np.arange(N) + 0.5) * SCENE.duration_s / N
SINCE_S = TIMES_S - np.mean(TIMES_S)
T = SCENE.t / np.linalg.norm(SCENE.t)
TRUTH = Parameters(0.0, SCENE.R, T)
T_D_S, RATE = 0.004, 60e-6  # of camera 2's clock: 0.6 ms at both ends
NOISE_PX = 0.1
TURNS = {"joint": CAUCHY, "tangency": 0.5}  # where the two methods' losses turn


def pairs_of(seen_s, noise_px, seed, fades_in=0.0, scene=SCENE):
    """Pairs at TIMES_S, of which camera 2's are as the object was at times of their own.

    Their noise has the deviation `noise_px`, and fades in so many samples.
    """
    p1, _ = track_pair(scene, TIMES_S)
    p2, late, early = (track_pair(scene, seen_s + step)[1] for step in (0.0, 1e-4, -1e-4))
    noise = np.random.default_rng(seed).normal(0.0, noise_px, (2, N, 2))
    if fades_in:
        kept = np.exp(-1.0 / fades_in)
        noise[:, 1:] *= np.sqrt(1.0 - kept**2)
        noise = lfilter([1.0], [1.0, -kept], noise, axis=1)
    v2 = (late - early) / 2e-4
    return WeighedPairs(TIMES_S, p1 + noise[0], p2 + noise[1], v2, np.ones(N), 0.0)


def rate_problem(seed=0, noise_px=NOISE_PX, fades_in=0.0, **options):
    """Pairs sampled as if both clocks were one; camera 2's has an offset and a rate."""
    seen_s = TIMES_S - (T_D_S + RATE * SINCE_S)  # camera 2's clock shows TIMES_S then
    pairs = pairs_of(seen_s, noise_px, seed, fades_in)
    column = Column(np.zeros_like(pairs.p1_px), SINCE_S[:, None] * pairs.v2_px_s)
    return Problem(pairs, SCENE.rig, FitRules(), columns=(column,), **options)


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
@pytest.mark.parametrize("pose_is_known", [False, True])
def test_a_clock_rate_is_one_more_column(turn, pose_is_known):
    problem = rate_problem(turn=turn, pose_is_known=pose_is_known)
    # The loss of `tangency` turns within the noise, and its steps shrink slowly.
    found = solve(problem, TRUTH, max_steps=100)
    assert found.converged
    covariance = linearise(problem, found.parameters).covariance()
    deviations = np.sqrt(np.diag(covariance))
    assert len(deviations) == (2 if pose_is_known else 7)
    assert found.parameters.t_d_s == pytest.approx(T_D_S, abs=4 * deviations[0])
    assert found.parameters.columns == pytest.approx([RATE], abs=4 * deviations[-1])
    assert 1e-6 < deviations[-1] < 0.4 * RATE  # so that it is told from none
    without = solve(replace(problem, columns=()), TRUTH, max_steps=100).parameters
    assert len(without.columns) == 0


def test_without_noise_the_rate_is_exact():
    found = solve(rate_problem(noise_px=0.0), TRUTH)
    # Points are moved along straight lines: 1 px/s^2 times (4 ms)^2 / 2 is far below that.
    assert found.parameters.columns == pytest.approx([RATE], abs=2e-6)
    assert found.parameters.t_d_s == pytest.approx(T_D_S, abs=2e-5)
    assert rotation_angle_deg(found.parameters.R, SCENE.R) < 0.02


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
def test_a_prior_weighs_as_much_as_its_deviation_says(turn):
    free = rate_problem(turn=turn)
    without = solve(free, TRUTH, max_steps=100).parameters.columns[0]
    at = solve(free, TRUTH).parameters
    std = np.sqrt(linearise(free, at).covariance()[-1, -1])
    shares, stds = [], []
    for ratio in (1e-3, 1.0, 1e3):
        prior = Prior(FIRST_COLUMN, 0.0, ratio * std)
        problem = rate_problem(turn=turn, priors=(prior,))
        found = solve(problem, TRUTH, max_steps=100).parameters
        shares.append(found.columns[0] / without)
        covariance = linearise(problem, found).covariance()
        stds.append(np.sqrt(covariance[-1, -1]) / std)
    assert shares[0] == pytest.approx(0.0, abs=1e-3)
    assert 0.2 < shares[1] < 0.8  # one half, but for Student's factor and the loss's efficiency
    assert shares[2] == pytest.approx(1.0, abs=1e-3)
    assert stds[0] == pytest.approx(1e-3, rel=0.1)
    assert 0.5 < stds[1] < 0.9  # 0.71
    assert stds[2] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
@pytest.mark.parametrize("fades_in", [0.0, 20.0], ids=["white", "slow"])
def test_a_fair_prior_and_the_data_share_by_their_variances(fades_in, turn):
    shares, unfair = [], []
    for seed in range(6):
        free = rate_problem(seed, turn=turn, fades_in=fades_in)
        found = solve(free, TRUTH, max_steps=100).parameters
        residuals = linearise(free, found)
        std = np.sqrt(residuals.covariance()[-1, -1])
        assert 0.05 * RATE < std < RATE  # neither tells all
        for scale_px, given in ((residuals.fair_scales()[-1], shares), (np.nan, unfair)):
            prior = Prior(FIRST_COLUMN, 0.0, std, scale_px)
            held = solve(replace(free, priors=(prior,)), TRUTH, max_steps=100).parameters
            given.append(held.columns[0] / found.columns[0])
    # One half each. A loss that turns within slow noise has several minima, and a prior may leave
    # one for another: hence the median.
    assert np.median(shares) == pytest.approx(0.5, abs=0.1)
    if fades_in and turn == CAUCHY:  # what an independent residual counts, slow errors outvote
        assert unfair[0] > 0.8


def test_a_prior_of_the_offset_holds_it():
    prior = Prior(T_D, 0.001, 1e-9)
    found = solve(rate_problem(priors=(prior,)), TRUTH)
    assert found.parameters.t_d_s == pytest.approx(0.001, abs=1e-7)


def test_derivatives_are_those_of_differences_though_a_column_moves_both_views():
    """A focal length: all columns of a Jacobian by central differences."""
    problem = rate_problem()
    weights = np.random.default_rng(1).uniform(0.5, 2.0, N)
    problem = replace(problem, pairs=replace(problem.pairs, weights=weights))
    centre = K[:2, 2]
    focal = Column(problem.pairs.p1_px - centre, 0.5 * (problem.pairs.p2_px - centre))
    problem = replace(problem, columns=(*problem.columns, focal))
    at = Parameters(T_D_S, SCENE.R, T, np.array([RATE, 0.01]))
    analytic = linearise(problem, at).jacobian
    for place, step in enumerate(1e-6 * np.eye(problem.size)):
        upper, lower = (linearise(problem, moved(at, s)).distances_px for s in (step, -step))
        numeric = (upper - lower) / 2e-6
        # Rounding of 1e-10 px over a step of 1e-6.
        assert np.allclose(analytic[:, place], numeric, atol=1e-4 * np.abs(numeric).max())


def test_steps_that_run_out_are_said():
    found = solve(rate_problem(), TRUTH, max_steps=1)
    assert not found.converged
    assert solve(rate_problem(), TRUTH, max_steps=5, last_step=0.0).converged  # all asked for


def test_residuals_are_weighed_sampson_distances():
    problem = rate_problem()
    problem = replace(problem, pairs=replace(problem.pairs, weights=np.linspace(0.5, 2.0, N)))
    residuals = linearise(problem, replace(TRUTH, columns=np.zeros(1)))
    F = fundamental_from_pose(K, K, SCENE.R, T)
    expected = sampson_distance(F, problem.pairs.p1_px, problem.pairs.p2_px)
    np.testing.assert_allclose(residuals.distances_px, np.linspace(0.5, 2.0, N) * expected)


# --- Uncertain intrinsics ---

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
    return Problem(pairs_of(TIMES_S, noise_px, seed), rig, FitRules(), **options)


def fitted(problem):
    """The problem with all that is to be allowed for, and its solution."""
    allowance = intrinsics.Allowance(problem.rig)
    first = solve(problem, TRUTH).parameters
    allowance.learn(problem, first)
    allowed = allowance.added(problem)
    return allowed, solve(allowed, first).parameters


def rig_of(focal, centre_px, **wrong):
    """Both cameras with stated deviations, and camera 1's intrinsics wrong by shares."""
    camera = Camera(K, WIDTH, HEIGHT)
    first = camera
    for name, share in wrong.items():
        first = changed(first, NAMES.index(name), share)
    return Rig(*(with_deviations(one, focal, centre_px) for one in (first, camera)))


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("place", range(4), ids=NAMES)
def test_moves_are_those_of_rays_undistorted_with_other_intrinsics(lens, place):
    camera = Camera(K, WIDTH, HEIGHT, lens, LENSES[lens])
    pixels = np.random.default_rng(0).uniform((20, 20), (WIDTH - 20, HEIGHT - 20), (50, 2))
    step = 1e-4

    def ideal(other):  # in the image of the first camera's K
        rays = (undistort_points(other, pixels) - other.K[:2, 2]) / np.diag(other.K)[:2]
        return rays * np.diag(K)[:2] + K[:2, 2]

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
    found = linearise(problem, replace(TRUTH, columns=np.zeros(8))).jacobian
    one, step = intrinsics.uncertain_ones(problem.rig)[number], 1e-6
    points = [problem.pairs.p1_px, problem.pairs.p2_px]
    F = fundamental_from_pose(K, K, SCENE.R, T)

    def distances(share):
        """Of the rays that the points are of, in the image of the rig's intrinsics."""
        camera = changed(problem.rig.cam1, one.place, share)
        rays = (points[one.camera] - camera.K[:2, 2]) / np.diag(camera.K)[:2]
        seen = list(points)
        seen[one.camera] = rays * np.diag(K)[:2] + K[:2, 2]
        return sampson_distance(F, *seen)

    difference = (distances(step) - distances(-step)) / (2.0 * step)
    # The error of a central difference is the round-off of lengths of 300 px over the step.
    np.testing.assert_allclose(found[:, FIRST_COLUMN + number], difference, atol=1e-5)


def test_exact_intrinsics_add_nothing():
    problem = problem_of(rig_of(0.0, 0.0), noise_px=0.3)
    allowance = intrinsics.Allowance(problem.rig)
    assert allowance.is_made
    assert allowance.added(problem) is problem
    parameters = solve(problem, TRUTH).parameters
    assert intrinsics.evidence(linearise(problem, parameters)) == 0.0
    np.testing.assert_array_equal(
        intrinsics.fundamental_of(problem, parameters),
        fundamental_from_pose(K, K, parameters.R, parameters.t),
    )


@pytest.mark.parametrize("pose_is_known", [False, True])
def test_larger_deviations_state_larger_ones(pose_is_known):
    deviations = []
    for factor in (0.0, 0.1, 0.3, 1.0, 3.0, 10.0):
        rig = rig_of(0.001 * factor, 0.3 * factor)
        problem, found = fitted(problem_of(rig, 0.3, pose_is_known=pose_is_known))
        covariance = linearise(problem, found).covariance()
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
    covariance = linearise(problem, found).covariance()
    error = rotation_angle_deg(found.R, SCENE.R)
    # 3.5 deviations of the one angle that strays most.
    assert np.radians(error) < 3.5 * np.sqrt(np.linalg.eigvalsh(covariance[1:4, 1:4])[-1])
    assert abs(found.t_d_s) < 3.5 * np.sqrt(covariance[0, 0])
    # The priors are weaker than this noise for the ratio fu / fv alone, so that the pose of exact
    # intrinsics is nowhere nearer; F is of the points, whatever it is made of.
    F = intrinsics.fundamental_of(problem, found)
    p1, p2 = track_pair(SCENE, TIMES_S)
    assert np.median(np.abs(sampson_distance(F, p1, p2))) < 0.1  # of 0.3 px noise at 400 pairs


def test_evidence_against_the_intrinsics():
    # fu and fv differ by 3 % where 0.1 % is stated: no pose makes that good.
    problem, found = fitted(problem_of(rig_of(0.001, 0.3, fu=0.03), 0.1))
    residuals = linearise(problem, found)
    assert intrinsics.evidence(residuals) > 3.5
    assert "camera 1's focal length wants to be" in intrinsics.wanted(residuals)
    for seed in range(4):
        problem, found = fitted(problem_of(rig_of(0.001, 0.3), 0.1, seed))
        assert intrinsics.evidence(linearise(problem, found)) < 3.5


@pytest.mark.parametrize("gap", [0.0, 0.4])
def test_what_a_clock_strays_unseen_makes_no_prior_heavy(gap):
    """Within a gap the data leave strays open; modes go all along, so each has a part in it."""
    scene, noise_px = make_scene(seed=3), 0.3
    pairs = pairs_of(TIMES_S, noise_px, 0, scene=scene)
    kept = np.abs(SINCE_S) >= 0.5 * gap * np.ptp(TIMES_S)
    columns = {field.name: getattr(pairs, field.name) for field in fields(pairs)}
    arrays = {name: values[kept] for name, values in columns.items() if np.ndim(values)}
    problem = Problem(replace(pairs, **arrays), rig_of(0.0, 0.0), FitRules())
    knots_s = np.linspace(TIMES_S[0], TIMES_S[-1], 41)
    modes, deviations_s = _modes(knots_s, 2000.0)
    middle_s, half_s = float(np.mean(TIMES_S)), 0.5 * float(np.ptp(TIMES_S))
    shutters = Shutters((), *np.empty((3, 0)))
    deviations = np.append(1e-3, deviations_s)
    model = ClockModel(middle_s, half_s, deviations, ClockRules(), shutters, knots_s, modes)
    truth = Parameters(0.0, scene.R, scene.t / np.linalg.norm(scene.t))
    start = replace(truth, columns=np.zeros(len(model.deviations)))
    problem = model.problem(problem, start, views=None)
    first = solve(problem, start, max_steps=50).parameters
    allowance = intrinsics.Allowance(problem.rig, has_priors=True)
    allowance.learn(problem, first)
    scales_px = np.array([prior.scale_px for prior in allowance.added(problem).priors])
    # White noise: each residual is independent, so that a prior counts as one. The fit takes up a
    # tenth of the noise, and the correlations of what is left are known to some 10 %.
    assert scales_px == pytest.approx(np.full(len(scales_px), noise_px), rel=0.3)
