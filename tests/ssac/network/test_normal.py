"""The arrowhead: its solution and its covariance are those of the dense matrix; derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.network.adjustment import repeats_in_blocks, repeats_of
from ssac.network.normal import Linear, Normal, solve
from ssac.network.state import DELAY, STRAYS, network_times, projected, start_state, with_strays
from tests.ssac.network.flights import make_flight

N_COEFFICIENTS, N_BORDER, N = 12, 5, 80


def problem() -> tuple[Normal, np.ndarray, np.ndarray, Linear]:
    rng = np.random.default_rng(0)
    first = rng.integers(0, N_COEFFICIENTS - 3, N)
    linear = Linear(
        first,
        rng.normal(size=(N, 4)),
        rng.normal(size=(N, 2, 3)),
        rng.normal(size=(N, 2, 2)),
        rng.integers(0, N_BORDER, (N, 1)) + np.array([[0, 0]]),
        rng.normal(size=(N, 2)),
    )
    linear.columns[:, 1] = (linear.columns[:, 0] + 1) % N_BORDER
    normal = Normal(N_COEFFICIENTS, N_BORDER)
    normal.add(linear)
    normal.add_rows(np.eye(N_BORDER), np.ones(N_BORDER))
    m = 3 * N_COEFFICIENTS
    dense = np.zeros((2 * N + N_BORDER, m + N_BORDER))
    for i in range(N):
        for z in range(2):
            for a in range(4):
                at = 3 * (first[i] + a)
                dense[2 * i + z, at : at + 3] += linear.weights[i, a] * linear.by_point[i, z]
            for c in range(2):
                dense[2 * i + z, m + linear.columns[i, c]] += linear.by_camera[i, z, c]
    dense[2 * N :, m:] = np.eye(N_BORDER)
    right = np.concatenate([linear.residuals.ravel(), np.ones(N_BORDER)])
    return normal, dense, right, linear


def test_the_solution_and_its_covariance_are_those_of_the_dense_matrix() -> None:
    normal, J, residuals, linear = problem()
    found = solve(normal, np.arange(N_BORDER))
    covariance = np.linalg.inv(J.T @ J)
    step = covariance @ (J.T @ residuals)
    m = 3 * N_COEFFICIENTS
    # Both to rounding, of a matrix that is far from singular.
    assert found.path.ravel() == pytest.approx(step[:m], rel=1e-6, abs=1e-9)
    assert found.border == pytest.approx(step[m:], rel=1e-6, abs=1e-9)
    assert found.border_covariance() == pytest.approx(covariance[m:, m:], rel=1e-6, abs=1e-9)
    of_points = found.path_covariances(linear.first[:5], linear.weights[:5])
    for i in range(5):
        at = 3 * linear.first[i]
        by = np.kron(linear.weights[i], np.eye(3))
        expected = by @ covariance[at : at + 12, at : at + 12] @ by.T
        assert of_points[i] == pytest.approx(expected, rel=1e-6, abs=1e-9)


def pieces(n: int) -> tuple[Normal, Linear]:
    """A path of n pieces of 30 coefficients, each with a parameter of its own."""
    rng = np.random.default_rng(1)
    per_piece = 30
    m = per_piece * n
    first = np.repeat(np.arange(m - 3), 2)
    count = len(first)
    weights = rng.uniform(0.5, 1.0, (count, 4)) * [1.0, 4.0, 4.0, 1.0] / 8.0
    by_point, by_camera = rng.normal(size=(count, 2, 3)), rng.normal(size=(count, 2, 1))
    columns = (first // per_piece)[:, None]
    linear = Linear(first, weights, by_point, by_camera, columns, rng.normal(size=(count, 2)))
    normal = Normal(m, n)
    normal.add(linear)
    normal.add_rows(np.eye(n), np.zeros(n))
    return normal, linear


def test_pieces_of_a_clock_are_solved_as_the_dense_matrix_is() -> None:
    normal, linear = pieces(12)
    normal.band[0] += 1e-3  # the ends of the path have but few sightings
    m, n = len(normal.right_path), 12
    J = np.zeros((2 * len(linear.first), m + n))
    for i, at in enumerate(linear.first):
        J[2 * i : 2 * i + 2, 3 * at : 3 * at + 12] = np.kron(linear.weights[i], linear.by_point[i])
        J[2 * i : 2 * i + 2, m + linear.columns[i, 0]] = linear.by_camera[i, :, 0]
    matrix = J.T @ J + np.diag(np.repeat([1e-3, 1.0], [m, n]))
    found, covariance = solve(normal, np.arange(n)), np.linalg.inv(matrix)
    step = covariance @ (J.T @ linear.residuals.ravel())
    # Both to rounding.
    assert found.path.ravel() == pytest.approx(step[:m], rel=1e-6, abs=1e-8)
    assert found.border == pytest.approx(step[m:], rel=1e-6, abs=1e-8)
    assert found.border_covariance() == pytest.approx(covariance[m:, m:], rel=1e-6, abs=1e-8)
    some = np.arange(0, len(linear.first), 17)  # in all blocks, and where two of them meet
    of_points = found.path_covariances(linear.first[some], linear.weights[some])
    for i, k in enumerate(some):
        at = 3 * linear.first[k]
        by = np.kron(linear.weights[k], np.eye(3))
        expected = by @ covariance[at : at + 12, at : at + 12] @ by.T
        assert of_points[i] == pytest.approx(expected, rel=1e-6, abs=1e-8)


def test_a_piece_of_a_clock_reaches_as_far_in_a_long_flight_as_in_a_short_one() -> None:
    reaches = []
    for n in (20, 40):
        normal, _ = pieces(n)
        normal.band[0] += 1e-1
        spans = solve(normal, np.arange(n)).spans
        reaches.append(np.median(spans[:, 1] - spans[:, 0]))
    assert reaches[0] < 3 * 30 * 10  # half of the shorter
    # Each fades by chance of its sightings; the medians of 20 and of 40 are 20 % alike.
    assert reaches[1] == pytest.approx(reaches[0], rel=0.2)


def test_derivatives_are_those_of_differences() -> None:
    flight = make_flight(2)
    seen = flight.seen[1]
    state = start_state(seen, flight.delays_s[1], 1e-4, *flight.poses[1])
    state = with_strays(state, seen, 4.0, 10)
    state = replace(state, focal=np.array([0.01, -0.01]), strays_s=np.linspace(0.0, 0.01, 5))

    def at(changed):
        times_s = network_times(changed, seen)
        points, velocities = flight.path(times_s), flight.path(times_s, nu=1)
        return projected(changed, seen, points, velocities)

    here = at(state)
    for place in range(state.size):
        step = np.zeros(state.size)
        step[place] = 1e-6
        difference = (at(state.moved(step)).points_px - at(state.moved(-step)).points_px) / 2e-6
        ours = np.sum(np.where(here.columns == place, 1.0, 0.0)[:, None] * here.by_camera, axis=2)
        scale = np.abs(difference).max() + 1.0
        assert ours == pytest.approx(difference, abs=1e-5 * scale)  # the differences' own error
    assert DELAY < STRAYS <= here.columns.max()


def test_clocks_there_and_back() -> None:
    seen = make_flight(2).seen[1]
    state = with_strays(start_state(seen, 3.0, 2e-3, np.eye(3), np.ones(3)), seen, 4.0, 10)
    state = replace(state, strays_s=np.array([0.0, 0.01, -0.01, 0.02, 0.0]))
    times_s = np.linspace(*seen.span_s, 50)
    back_s = state.own_from_network(state.network_from_own(times_s))
    # Three rounds, each of which takes what is left times the strays' slope, some 0.01.
    assert back_s == pytest.approx(times_s, abs=1e-6)


def test_what_lasts_counts_though_it_is_small_beside_what_does_not() -> None:
    rng = np.random.default_rng(3)
    times_s = 0.01 * np.arange(60_000)
    white = rng.normal(0.0, 1.0, (len(times_s), 2))
    # Means of 60,000 numbers in blocks of 100: 600 blocks of two axes are 4 % alike.
    assert repeats_in_blocks(times_s, white) == pytest.approx(1.0, abs=0.15)
    # A slow error of variance 0.04 that stays for 0.5 s: each of 50 sightings has it, and blocks of
    # a second hold two. Correlations of 0.04 are below those that are summed up.
    slow = np.repeat(rng.normal(0.0, 0.2, (len(times_s) // 50, 2)), 50, axis=0)
    assert repeats_in_blocks(times_s, white + slow) == pytest.approx(1.0 + 0.04 * 50.0, rel=0.15)
    assert repeats_of(times_s, white + slow) < 1.5
