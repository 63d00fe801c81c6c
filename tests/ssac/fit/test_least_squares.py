"""The one solver: further parameters are further columns, and priors count as they should."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from ssac.fit.least_squares import (
    FIRST_COLUMN,
    T_D,
    Column,
    Parameters,
    Prior,
    Problem,
    WeighedPairs,
    _least_squares,
    linearise,
    moved,
    solve,
)
from ssac.geometry.epipolar import CAUCHY, fundamental_from_pose, sampson_distance
from ssac.rules import FitRules
from tests.ssac.synthetic import K, make_scene, rotation_angle_deg, track_pair

SCENE = make_scene(seed=2)
N = 400
TIMES_S = (np.arange(N) + 0.5) * SCENE.duration_s / N
SINCE_S = TIMES_S - np.mean(TIMES_S)
T = SCENE.t / np.linalg.norm(SCENE.t)
T_D_S, RATE = 0.004, 60e-6  # of camera 2's clock: 0.6 ms at both ends
NOISE_PX = 0.1
TURNS = {"joint": CAUCHY, "tangency": 0.5}  # where the two methods' losses turn


def rate_problem(
    seed: int = 0, rate: float = RATE, noise_px: float = NOISE_PX, fades_in: float = 0.0, **options
):
    """Pairs sampled as if both clocks were one; camera 2's has an offset and a rate.

    Their noise has the deviation `noise_px`, and fades in so many samples.
    """
    p1, _ = track_pair(SCENE, TIMES_S)
    seen_at = TIMES_S - (T_D_S + rate * SINCE_S)  # camera 2's clock shows TIMES_S then
    p2, late, early = (track_pair(SCENE, seen_at + step)[1] for step in (0.0, 1e-4, -1e-4))
    v2 = (late - early) / 2e-4
    noise = np.random.default_rng(seed).normal(0.0, noise_px, (2, N, 2))
    if fades_in:
        kept = np.exp(-1.0 / fades_in)
        noise[:, 1:] *= np.sqrt(1.0 - kept**2)
        noise = lfilter([1.0], [1.0, -kept], noise, axis=1)
    pairs = WeighedPairs(TIMES_S, p1 + noise[0], p2 + noise[1], v2, np.ones(N), 0.0)
    column = Column(np.zeros_like(p1), SINCE_S[:, None] * v2)
    return Problem(pairs, SCENE.rig, FitRules(), columns=(column,), **options)


def truth() -> Parameters:
    return Parameters(0.0, SCENE.R, T)


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
@pytest.mark.parametrize("pose_is_known", [False, True])
def test_a_clock_rate_is_one_more_column(turn, pose_is_known):
    problem = rate_problem(turn=turn, pose_is_known=pose_is_known)
    # The loss of `tangency` turns within the noise, and its steps shrink slowly.
    found = solve(problem, truth(), max_steps=100)
    assert found.converged
    covariance = linearise(problem, found.parameters).covariance()
    deviations = np.sqrt(np.diag(covariance))
    assert len(deviations) == (2 if pose_is_known else 7)
    assert found.parameters.t_d_s == pytest.approx(T_D_S, abs=4 * deviations[0])
    assert found.parameters.columns == pytest.approx([RATE], abs=4 * deviations[-1])
    assert 1e-6 < deviations[-1] < 0.4 * RATE  # so that it is told from none
    without = solve(replace(problem, columns=()), truth(), max_steps=100).parameters
    assert len(without.columns) == 0


def test_without_noise_the_rate_is_exact():
    found = solve(rate_problem(noise_px=0.0), truth())
    # Points are moved along straight lines: 1 px/s^2 times (4 ms)^2 / 2 is far below that.
    assert found.parameters.columns == pytest.approx([RATE], abs=2e-6)
    assert found.parameters.t_d_s == pytest.approx(T_D_S, abs=2e-5)
    assert rotation_angle_deg(found.parameters.R, SCENE.R) < 0.02


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
def test_a_prior_weighs_as_much_as_its_deviation_says(turn):
    free = rate_problem(turn=turn)
    without = solve(free, truth(), max_steps=100).parameters.columns[0]
    at = solve(free, truth()).parameters
    std = np.sqrt(linearise(free, at).covariance()[-1, -1])
    shares, stds = [], []
    for ratio in (1e-3, 1.0, 1e3):
        prior = Prior(FIRST_COLUMN, 0.0, ratio * std)
        problem = rate_problem(turn=turn, priors=(prior,))
        found = solve(problem, truth(), max_steps=100).parameters
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
        found = solve(free, truth(), max_steps=100).parameters
        residuals = linearise(free, found)
        std = np.sqrt(residuals.covariance()[-1, -1])
        assert 0.05 * RATE < std < RATE  # neither tells all
        for scale_px, given in ((residuals.fair_scales()[-1], shares), (np.nan, unfair)):
            prior = Prior(FIRST_COLUMN, 0.0, std, scale_px)
            held = solve(replace(free, priors=(prior,)), truth(), max_steps=100).parameters
            given.append(held.columns[0] / found.columns[0])
    # One half each. A loss that turns within slow noise has several minima, and a prior may leave
    # one for another: hence the median.
    assert np.median(shares) == pytest.approx(0.5, abs=0.1)
    if fades_in and turn == CAUCHY:  # what an independent residual counts, slow errors outvote
        assert unfair[0] > 0.8


def test_a_prior_of_the_offset_holds_it():
    prior = Prior(T_D, 0.001, 1e-9)
    found = solve(rate_problem(priors=(prior,)), truth())
    assert found.parameters.t_d_s == pytest.approx(0.001, abs=1e-7)


def test_a_column_may_move_both_views():
    """Focal lengths: both columns of a Jacobian by central differences."""
    problem = rate_problem()
    centre = K[:2, 2]
    focal = Column(problem.pairs.p1_px - centre, 0.5 * (problem.pairs.p2_px - centre))
    problem = replace(problem, columns=(*problem.columns, focal))
    at = Parameters(T_D_S, SCENE.R, T, np.array([RATE, 0.01]))
    analytic = linearise(problem, at).jacobian
    for place, h in ((FIRST_COLUMN, 1e-6), (FIRST_COLUMN + 1, 1e-6), (T_D, 1e-6)):
        step = h * np.eye(problem.size)[place]
        upper, lower = (linearise(problem, moved(at, s)).distances_px for s in (step, -step))
        numeric = (upper - lower) / (2.0 * h)
        # Rounding of 1e-10 px over a step of 1e-6.
        assert np.allclose(analytic[:, place], numeric, atol=1e-4 * np.abs(numeric).max())


def test_steps_that_run_out_are_said():
    found = solve(rate_problem(), truth(), max_steps=1)
    assert not found.converged
    assert solve(rate_problem(), truth(), max_steps=5, last_step=0.0).converged  # all asked for


def test_residuals_are_weighed_sampson_distances():
    problem = rate_problem()
    problem = replace(problem, pairs=replace(problem.pairs, weights=np.linspace(0.5, 2.0, N)))
    residuals = linearise(problem, replace(truth(), columns=np.zeros(1)))
    F = fundamental_from_pose(K, K, SCENE.R, T)
    expected = sampson_distance(F, problem.pairs.p1_px, problem.pairs.p2_px)
    np.testing.assert_allclose(residuals.distances_px, np.linspace(0.5, 2.0, N) * expected)


@pytest.mark.parametrize("n", [2000, 15, 7, 6])
@pytest.mark.parametrize("rank", [6, 5])
def test_steps_are_those_of_the_system_itself(n, rank):
    rng = np.random.default_rng(n)
    system = rng.normal(size=(n, rank)) @ rng.normal(size=(rank, 6)) * 10.0 ** np.arange(6)
    target = rng.normal(size=n)
    expected = np.linalg.lstsq(system, target)[0]  # the shortest, where several fit
    # Rounding, magnified by the spread of the columns.
    np.testing.assert_allclose(_least_squares(system, target), expected, rtol=1e-6, atol=1e-12)
