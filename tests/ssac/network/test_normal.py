"""Splines, the arrowhead matrix of the normal equations, and derivatives of projections."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from ssac.camera import distort_points, undistort_points
from ssac.network.adjustment import repeats_in_blocks, repeats_of
from ssac.network.normal import ORDER, Linear, Normal, Spline, jerks, knots_for, products, solve
from ssac.network.state import CameraState, network_times, projected, with_strays
from tests.ssac.network.flights import RULES, make_flight
from tests.ssac.synthetic import project

RNG = np.random.default_rng(0)
ANYWHERE, PIECES = RNG.integers(0, 9, 80), np.repeat(np.arange(357), 2)
OWN = RNG.integers(0, 5, 80)


@pytest.mark.parametrize(
    ("first", "columns", "least"),
    [
        (ANYWHERE, np.column_stack([OWN, (OWN + 1) % 5]), 0.0),  # sightings without any order
        (PIECES, PIECES[:, None] // 30, 1e-3),  # a path of 12 pieces, each with its own parameter
    ],
    ids=["anything", "pieces"],
)
def test_solution_and_covariance_are_those_of_the_dense_matrix(first, columns, least) -> None:
    rng, n, m, b = np.random.default_rng(1), len(first), 3 * (first.max() + 4), columns.max() + 1
    weights, by_point, by_camera, residuals = (
        rng.normal(size=(n, *size)) for size in ((4,), (2, 3), (2, columns.shape[1]), (2,))
    )
    linear = Linear(first, weights, by_point, by_camera, columns, residuals)
    normal = Normal(m // 3, b)
    normal.add(linear)
    normal.add_rows(np.eye(b), np.ones(b))  # a prior on each camera's parameters
    normal.band[0] += least  # of a path whose ends few saw
    found, J = solve(normal, np.arange(b)), np.zeros((2 * n, m + b))  # J: the same, but dense
    for i, at in enumerate(first):
        rows = slice(2 * i, 2 * i + 2)
        J[rows, 3 * at : 3 * at + 12] = np.kron(linear.weights[i], linear.by_point[i])
        for c, place in enumerate(columns[i]):
            J[rows, m + place] += linear.by_camera[i, :, c]
    covariance = np.linalg.inv(J.T @ J + np.diag(np.repeat([least, 1.0], [m, b])))
    step = covariance @ (J.T @ linear.residuals.ravel() + np.repeat([0.0, 1.0], [m, b]))
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


def test_derivatives_are_those_of_differences() -> None:
    flight = make_flight(2)
    seen = flight.seen[1]
    state = CameraState(flight.clocks[1].t_d_s, 1e-4, seen.middle_s, 0.0, *flight.poses[1])
    state = with_strays(state, seen, 4.0, 10)
    state = replace(state, focal=np.array([0.01, -0.01]), strays_s=np.linspace(0.0, 0.01, 5))

    def at(changed):
        times_s = network_times(changed, seen)
        points, velocities = flight.path(times_s), flight.path(times_s, nu=1)
        return projected(changed, seen, points, velocities)

    _, _, _, by_camera, columns = at(state)
    for place, step in enumerate(1e-6 * np.eye(state.size)):
        difference = (at(state.moved(step))[0] - at(state.moved(-step))[0]) / 2e-6
        ours = np.sum(np.where(columns == place, 1.0, 0.0)[:, None] * by_camera, axis=2)
        scale = np.abs(difference).max() + 1.0
        assert ours == pytest.approx(difference, abs=1e-5 * scale)  # the differences' own error


def test_other_intrinsics_show_a_ray_through_the_lens_where_the_rig_undistorts_it() -> None:
    flight = make_flight(2)
    lens = {"distortion_model": "equidistant", "distortion_coeffs": (0.01, 0.0, 0.0, 0.0)}
    rig_s = replace(flight.seen[1].camera, **lens)
    state = CameraState(0.0, 0.0, 0.0, 0.0, *flight.poses[1])
    state = replace(state, focal=np.array([0.01, -0.02]), centre_px=np.array([3.0, -5.0]))
    K = rig_s.K.copy()
    K[[0, 1], [0, 1]] *= 1.0 + state.focal
    K[:2, 2] += state.centre_px
    points = flight.path(np.linspace(1.0, 15.0, len(flight.seen[1])))
    seen_px = distort_points(replace(rig_s, K=K), project(points @ state.R.T + state.t, K))
    seen = replace(flight.seen[1], camera=rig_s, points_px=undistort_points(rig_s, seen_px))
    found_px, _, _, by_camera, _ = projected(state, seen, points, np.ones_like(points))
    assert found_px == pytest.approx(seen.points_px, abs=1e-6)  # of undistorting
    for place in range(9, 13):
        step = 1e-6 * np.eye(state.size)[place]
        more, less = (
            projected(state.moved(one), seen, points, np.ones_like(points))[0]
            for one in (step, -step)
        )
        slope = (more - less) / 2e-6
        # The derivative is that of the rig's intrinsics, from which these are up to 2 % off.
        assert by_camera[:, :, place] == pytest.approx(slope, abs=0.03 * np.abs(slope).max())


def test_what_lasts_counts_though_it_is_small_beside_what_does_not() -> None:
    rng = np.random.default_rng(3)
    times_s = 0.01 * np.arange(60_000)
    white = rng.normal(0.0, 1.0, (len(times_s), 2))
    # 60,000 numbers in blocks of 100: the means of 600 blocks on two axes give a variance to 4 %.
    assert repeats_in_blocks(times_s, white, RULES.network) == pytest.approx(1.0, abs=0.15)
    # A slow error of variance 0.04 stays for 0.5 s: 50 sightings share each value, and blocks of a
    # second hold two values. `repeats_of` does not sum up correlations as small as 0.04.
    slow = np.repeat(rng.normal(0.0, 0.2, (len(times_s) // 50, 2)), 50, axis=0)
    found = repeats_in_blocks(times_s, white + slow, RULES.network)
    assert found == pytest.approx(1.0 + 0.04 * 50.0, rel=0.15)
    assert repeats_of(times_s, white + slow, RULES.network) < 1.5


def test_curves_derivatives_and_jerks_are_those_of_scipy_with_knots_where_data_are() -> None:
    rng = np.random.default_rng(0)
    seen_s = np.concatenate([rng.uniform(0.0, 5.0, 200), rng.uniform(20.0, 25.0, 100)])
    knots_s = knots_for(seen_s, 0.3, 1.0)
    spline = Spline(knots_s, rng.normal(size=(len(knots_s) - ORDER, 3)))
    curve = BSpline(knots_s, spline.coefficients, 3)
    times_s = np.linspace(knots_s[0], knots_s[-1] - 1e-9, 300)
    for derivative in range(4):
        expected = curve(times_s, nu=derivative)
        scale = np.abs(expected).max()  # of rounding
        assert spline.at(times_s, derivative) == pytest.approx(expected, abs=1e-12 * scale)
    inner_s = np.unique(knots_s)
    total = np.diff(inner_s) @ np.sum(curve(inner_s[:-1], nu=3) ** 2, axis=1)  # steps of the jerk
    squares = products(*jerks(knots_s), spline.coefficients) ** 2
    assert np.sum(squares) == pytest.approx(total, rel=1e-9)  # rounding
    assert not np.any((inner_s > 5.1) & (inner_s < 19.9))
    assert (inner_s[0], inner_s[-1]) == (seen_s.min(), seen_s.max())
    gap_s = seen_s[seen_s > 10.0].min() - seen_s[seen_s < 10.0].max()
    assert np.sort(np.diff(inner_s))[-2:] == pytest.approx([0.3, gap_s], abs=0.02)
