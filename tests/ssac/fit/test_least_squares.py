"""The least-squares solver: columns, priors, and uncertain intrinsics that widen deviations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from ssac.camera import Camera, Rig, undistort_points, with_deviations
from ssac.fit import intrinsics, least_squares
from ssac.fit.least_squares import Column, Parameters, Problem, WeighedPairs, linearise, solve
from ssac.geometry.epipolar import CAUCHY, fundamental_from_pose, sampson_distance
from ssac.geometry.pose import rays_of
from ssac.rules import FitRules
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_scene, rotation_angle_deg, track_pair

SCENE = make_scene(seed=2)
N = 400
TIMES_S = (np.arange(N) + 0.5) * SCENE.duration_s / N
SINCE_S = TIMES_S - np.mean(TIMES_S)
T = SCENE.t / np.linalg.norm(SCENE.t)
TRUTH = Parameters(0.0, SCENE.R, T)
T_D_S, RATE = 0.004, 60e-6  # of camera 2's clock: 0.6 ms at both ends
TURNS = {"joint": CAUCHY, "tangency": 0.5}  # where the two methods' losses turn


def pairs_of(seen_s, noise_px, seed, fades_in=0.0):
    """Pairs at TIMES_S, of which camera 2 shows `seen_s`; noise fades in `fades_in` samples."""
    p1, _ = track_pair(SCENE, TIMES_S)
    p2, late, early = (track_pair(SCENE, seen_s + step)[1] for step in (0.0, 1e-4, -1e-4))
    noise = np.random.default_rng(seed).normal(0.0, noise_px, (2, N, 2))
    if fades_in:
        kept = np.exp(-1.0 / fades_in)
        noise[:, 1:] *= np.sqrt(1.0 - kept**2)
        noise = lfilter([1.0], [1.0, -kept], noise, axis=1)
    v2 = (late - early) / 2e-4
    return WeighedPairs(TIMES_S, p1 + noise[0], p2 + noise[1], v2, np.ones(N), 0.0)


def rate_problem(seed=0, fades_in=0.0, **options):
    """Pairs sampled as if both clocks were one; camera 2's has an offset and a rate."""
    seen_s = TIMES_S - (T_D_S + RATE * SINCE_S)  # camera 2's clock shows TIMES_S then
    pairs = pairs_of(seen_s, 0.1, seed, fades_in)
    column = Column(np.zeros_like(pairs.p1_px), SINCE_S[:, None] * pairs.v2_px_s)
    return Problem(pairs, SCENE.rig, FitRules(), columns=(column,), **options)


def prior_of_rate(std, scale_px=np.nan):
    return least_squares.Prior(least_squares.FIRST_COLUMN, 0.0, std, scale_px)


def left_by_fit(problem):
    """Residuals at a solution, found slowly, as the loss of `tangency` turns within the noise."""
    return linearise(problem, solve(problem, TRUTH, max_steps=100).parameters)


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
def test_a_prior_weighs_as_much_as_its_deviation_says(turn):
    without = left_by_fit(rate_problem(turn=turn))
    std = np.sqrt(without.covariance()[-1, -1])
    shares, stds = [], []
    for ratio in (1e-3, 1.0, 1e3):
        held = left_by_fit(rate_problem(turn=turn, priors=(prior_of_rate(ratio * std),)))
        shares.append(held.parameters.columns[0] / without.parameters.columns[0])
        stds.append(np.sqrt(held.covariance()[-1, -1]) / std)
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
        found = left_by_fit(free)
        std = np.sqrt(found.covariance()[-1, -1])
        assert 0.05 * RATE < std < RATE  # data and prior both count
        for scale_px, given in ((found.fair_scales()[-1], shares), (np.nan, unfair)):
            held = left_by_fit(replace(free, priors=(prior_of_rate(std, scale_px),)))
            given.append(held.parameters.columns[0] / found.parameters.columns[0])
    # One half each. A loss that turns within slow noise has several minima, and a prior may move
    # the solution from one to another: hence the median.
    assert np.median(shares) == pytest.approx(0.5, abs=0.1)
    if fades_in and turn == CAUCHY:  # slow errors outvote a prior that counts as one residual
        assert unfair[0] > 0.8


def test_residuals_are_weighed_sampson_distances_with_the_derivatives_of_differences():
    """All columns are tried; one moves both views, another is the focal lengths of camera 2."""
    problem = rate_problem()
    weights = np.random.default_rng(1).uniform(0.5, 2.0, N)
    problem = replace(problem, pairs=replace(problem.pairs, weights=weights))
    centre = K[:2, 2]
    focal = Column(problem.pairs.p1_px - centre, 0.5 * (problem.pairs.p2_px - centre))
    of_2 = np.array([0.0, 0.0, 1.0, 1.0])
    own = Column(np.zeros((N, 2)), centre - problem.pairs.p2_px, shrinks=of_2)
    problem = replace(problem, columns=(*problem.columns, focal, own))
    at = Parameters(T_D_S, SCENE.R, T, np.array([RATE, 0.01, 0.2]))
    analytic = linearise(problem, at).jacobian
    for place, step in enumerate(1e-6 * np.eye(problem.size)):
        ends = (least_squares.moved(at, by) for by in (step, -step))
        upper, lower = (linearise(problem, end).distances_px for end in ends)
        numeric = (upper - lower) / 2e-6
        # Rounding of 1e-10 px over a step of 1e-6.
        assert np.allclose(analytic[:, place], numeric, atol=1e-4 * np.abs(numeric).max())
    pairs = problem.pairs
    expected = sampson_distance(fundamental_from_pose(K, K, SCENE.R, T), pairs.p1_px, pairs.p2_px)
    unmoved = linearise(problem, replace(TRUTH, columns=np.zeros(3)))
    np.testing.assert_allclose(unmoved.distances_px, weights * expected)
    # Distances stay those of pixels as measured where a focal length a fifth short is put right.
    short = changed(changed(SCENE.rig.cam2, 0, -0.2), 1, -0.2)
    mended = Problem(pairs, replace(SCENE.rig, cam2=short), FitRules(), columns=(own,))
    found = linearise(mended, replace(TRUTH, columns=np.array([0.2])))
    np.testing.assert_allclose(found.distances_px, weights * expected)


# --- Uncertain intrinsics ---

LENSES = [("none", ()), ("radtan", (-0.3, 0.1, 1e-3, -5e-4)), ("equidistant", (-0.02, 0.01, 0, 0))]
NAMES = ("fu", "fv", "pu", "pv")
UNHIDDEN = np.zeros((N, 0))  # no errors but those that residuals show


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
    """Residuals at the solution of a problem that allows for errors of the intrinsics."""
    allowance = intrinsics.Allowance(problem.rig)
    first = solve(problem, TRUTH).parameters
    allowance.learn(problem, first)
    allowed = allowance.added(problem)
    return linearise(allowed, solve(allowed, first).parameters)


def rig_of(focal, centre_px, **wrong):
    """Both cameras with stated deviations, and camera 1's intrinsics wrong by shares."""
    first = camera = Camera(K, WIDTH, HEIGHT)
    for name, share in wrong.items():
        first = changed(first, NAMES.index(name), share)
    return Rig(*(with_deviations(one, focal, centre_px) for one in (first, camera)))


@pytest.mark.parametrize("lens", LENSES)
def test_columns_move_points_as_rays_undistorted_with_other_intrinsics(lens):
    camera = with_deviations(Camera(K, WIDTH, HEIGHT, *lens), 0.01, 1.0)
    pixels = np.random.default_rng(0).uniform((20, 20), (WIDTH - 20, HEIGHT - 20), (50, 2))
    points, nothing, step = undistort_points(camera, pixels), np.zeros((50, 2)), 1e-4
    pairs = WeighedPairs(np.arange(50.0), points, points, nothing, np.ones(50), 0.0)
    columns = intrinsics.with_intrinsics(Problem(pairs, Rig(camera, camera), FitRules())).columns

    def ideal(other):  # in the image of the first camera's K
        rays = (undistort_points(other, pixels) - other.K[:2, 2]) / np.diag(other.K)[:2]
        return rays * np.diag(K)[:2] + K[:2, 2]

    for place, (first, second) in enumerate(zip(columns[:4], columns[4:], strict=True)):
        upper, lower = (ideal(changed(camera, place, share)) for share in (step, -step))
        # Lengths are up to 200 px; the lens's derivative is by differences of half a pixel.
        np.testing.assert_allclose(first.dp1_px, (upper - lower) / 2.0 / step, atol=0.02)
        np.testing.assert_array_equal(second.dp2_px, first.dp1_px)
        assert not first.dp2_px.any()
        assert not second.dp1_px.any()


@pytest.mark.parametrize("pose_is_known", [False, True])
def test_larger_deviations_state_larger_ones(pose_is_known):
    deviations = []
    for factor in (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0):
        rig = rig_of(0.001 * factor, 0.3 * factor)
        covariance = fitted(problem_of(rig, 0.3, pose_is_known=pose_is_known)).covariance()
        deviations.append(np.sqrt(np.diag(covariance)[: 1 if pose_is_known else 6]))
    # The intrinsics absorb a part of the noise, which lessens the residuals by up to 2 %; no focal
    # length becomes longer than it is, though nothing but the residuals would hold it.
    assert np.all(np.diff(deviations, axis=0) > -0.02 * np.array(deviations)[:-1])
    if not pose_is_known:
        # Ten times a good calibration's deviations outweigh this noise.
        assert np.all(np.array(deviations)[-1, 1:] > 3.0 * np.array(deviations)[0, 1:])


@pytest.mark.parametrize("seed", range(4))
def test_drawn_errors_are_within_the_stated_deviations(seed):
    rng = np.random.default_rng(seed)
    shares = dict(zip(NAMES, rng.normal(0.0, (0.01, 0.01, 0.015, 0.015)), strict=True))
    residuals = fitted(problem_of(rig_of(0.01, 3.0, **shares), 0.3, seed))
    covariance, found = residuals.covariance(), residuals.parameters
    error = rotation_angle_deg(found.R, SCENE.R)
    # 3.5 deviations of the least certain angle.
    assert np.radians(error) < 3.5 * np.sqrt(np.linalg.eigvalsh(covariance[1:4, 1:4])[-1])
    assert abs(found.t_d_s) < 3.5 * np.sqrt(covariance[0, 0])
    # Only for the ratio fu / fv are the priors weaker than this noise, so that the pose comes no
    # nearer to that of exact intrinsics; F fits the points, whatever the intrinsics.
    F = fundamental_from_pose(*intrinsics.intrinsics_of(residuals.problem, found), found.R, found.t)
    p1, p2 = track_pair(SCENE, TIMES_S)
    assert np.median(np.abs(sampson_distance(F, p1, p2))) < 0.1  # of 0.3 px noise at 400 pairs


def test_intrinsics_found_are_those_whose_rays_the_columns_move_to():
    problem = intrinsics.with_intrinsics(problem_of(rig_of(0.01, 3.0)))
    shares = np.array([0.1, -0.2, 0.05, 0.03])
    columns = np.concatenate([shares, np.zeros(4)])
    found = intrinsics.intrinsics_of(problem, replace(TRUTH, columns=columns))[0]
    points_px = problem.pairs.p1_px
    moves = intrinsics.moves_of(problem.rig.cam1, points_px)
    moved = points_px + np.einsum("k,knj->nj", shares, moves)
    expected = rays_of(problem.rig.cam1.K, moved)
    np.testing.assert_allclose(rays_of(found, points_px), expected, atol=1e-12)


def test_wrong_intrinsics_show_also_exact_ones_unless_the_cameras_face_each_other():
    # fu and fv differ by 3 % where 0.1 % is stated, or nothing: no pose makes that good.
    stated = fitted(problem_of(rig_of(0.001, 0.3, fu=0.03), 0.1))
    problem = problem_of(rig_of(0.0, 0.0, fu=0.03), 0.1)
    exact = linearise(problem, solve(problem, TRUTH).parameters)
    for wrong in (stated, intrinsics.questioned(exact)):
        assert intrinsics.evidence(wrong, UNHIDDEN) > 3.5
        assert "camera 1's focal length wants to be" in intrinsics.wanted(wrong)
    # Each explains as much as the other. 8 px are 0.04 focal lengths.
    for wrong in ({"fu": -0.05, "fv": -0.05}, {"pu": 0.04}):
        said = intrinsics.wanted(fitted(problem_of(rig_of(0.001, 0.3, **wrong), 0.05)))
        assert ("camera 1's focal length wants to be 5.3 % longer" in said) == ("fu" in wrong)
        assert ("camera 1's principal point wants to be 7.9 px further" in said) == ("pu" in wrong)
    for seed in range(4):
        good = fitted(problem_of(rig_of(0.001, 0.3), 0.1, seed))
        assert intrinsics.evidence(good, UNHIDDEN) < 3.5
        assert intrinsics.questioned(good) is good
    # Move the epipole, where F' vanishes, into the middle of the positions.
    middle = np.append(np.mean(exact.p1_px, axis=0), 1.0)
    across = np.eye(3) - np.outer(middle, middle) / (middle @ middle)
    facing = replace(exact, F=exact.F @ across)
    assert intrinsics.questioned(facing) is facing
