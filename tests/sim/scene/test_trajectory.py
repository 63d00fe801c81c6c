from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from sim.scene import trajectory
from sim.scene.trajectory import SplineConfig, random_spline, trajectory_from_csv
from tests.sim.scenes import rng

SHORT = SplineConfig(duration_s=6.0, max_radius_m=np.inf)


def spline(seed, config=SHORT):
    return random_spline(config, rng(seed))


def flights(n, config):
    times_s = np.linspace(0, config.duration_s, 1000)
    return np.concatenate([spline(seed, config).poses(times_s) for seed in range(n)])


def radius_m(path):
    return float(np.hypot(path[:, 0], path[:, 1]).max())


def test_third_derivative_is_continuous_and_fourth_is_not():
    # A B-spline of degree 4 is such that only its fourth derivative jumps, at knots that differ.
    position = spline(4).position
    assert position.k == 4
    assert np.diff(position.t[position.k : -position.k]).min() > 0.0


def test_fit_minimises_its_functional():
    draws = rng(0)
    times_s, values = np.linspace(0, 4, 21), draws.uniform(-1, 1, (21, 1))
    fit = trajectory._fit_smoothing_spline(times_s, values, order=5, n_segments=20, smoothing=0.05)
    dense_s = np.linspace(0, 4, 20001)

    def cost(coefficients):
        curve = BSpline(fit.t, coefficients, fit.k)
        bending = np.trapezoid(curve.derivative(2)(dense_s)[:, 0] ** 2, dense_s)
        return float(((curve(times_s) - values) ** 2).sum() + 0.05 * bending)

    best = cost(fit.c)
    for _ in range(20):
        step = 1e-3 * draws.standard_normal(fit.c.shape)
        # At a minimum both directions cost more; a wrong penalty would show a slope.
        assert cost(fit.c + step) > best
        assert cost(fit.c - step) > best


def test_no_trajectory_leaves_its_circle_and_the_default_stays_upright():
    T_W_B = flights(10, SplineConfig())
    # Between the instants at which the radius is checked (50 ms) the path bulges by millimetres.
    assert radius_m(T_W_B[:, :3, 3]) < 4.01
    # This circle is narrower than usual, so that some of the first draws leave it.
    assert radius_m(flights(8, replace(SHORT, max_radius_m=3.0))[:, :3, 3]) < 3.01
    tilt_deg = np.rad2deg(np.arccos(T_W_B[:, 2, 2]))
    assert tilt_deg.max() < 40
    assert np.percentile(tilt_deg, 95) < 25


@pytest.mark.parametrize("order", [3, 4, 5, 6])
def test_a_long_spline_is_fitted_as_a_short_one_is(monkeypatch, order):
    times_s = np.linspace(0, 41.7, 209)
    values = np.random.default_rng(0).uniform(-1, 1, (209, 6))
    short = trajectory._fit_smoothing_spline(times_s, values, order, 209, 0.0036)
    monkeypatch.setattr(trajectory, "LONG_SEGMENTS", 0)
    long = trajectory._fit_smoothing_spline(times_s, values, order, 209, 0.0036)
    np.testing.assert_array_equal(long.t, short.t)
    # Round-off of the linear solve, whose condition number is about 1e3.
    np.testing.assert_allclose(long.c, short.c, atol=1e-11)


def test_an_hour_is_flown_within_the_circle():
    """Dense matrices would exhaust memory, and every draw of the whole would leave the circle."""
    path = spline(0, SplineConfig(duration_s=3600.0)).position(np.linspace(0, 3600, 360_000))
    # As above: the bulge between two instants of the check.
    assert radius_m(path) < 4.01
    # The hour's path is as spread out as short flights are.
    short = spline(0, SplineConfig()).position(np.linspace(0, 20, 2000))
    np.testing.assert_allclose(path.std(axis=0), short.std(axis=0), rtol=0.3)


def test_csv_round_trip(tmp_path):
    original = spline(5)
    path = tmp_path / "path.csv"
    trajectory.trajectory_to_csv(original, path, rate_hz=100.0)
    copy = trajectory_from_csv(path)
    assert copy.duration_s == original.duration_s
    rows_s, between_s = np.linspace(0, 6, 601), np.linspace(0, 6, 997)
    # At the rows, round-off of quaternions; between them, a cubic's error h^4 / 384 times the
    # fourth derivative (some 1e3 m/s^4).
    np.testing.assert_allclose(copy.poses(rows_s), original.poses(rows_s), atol=1e-12)
    np.testing.assert_allclose(copy.poses(between_s), original.poses(between_s), atol=1e-4)


def test_csv_header_order_comments_and_start_time(tmp_path):
    plain = "".join(f"{t},{t**2},0,1,0,0,0,1\n" for t in (10.0, 10.5, 11.0, 12.0))
    rows = (f"0,0,0,2,{t**2},0,1,{t}  # row\n\n" for t in (10.0, 10.5, 11.0, 12.0))
    named = "# made by hand\nqx,qy,qz,qw,x,y,z,t\n" + "".join(rows)
    found, path = [], tmp_path / "path.csv"
    for text in (plain, f"\ufeff{named}"):  # as spreadsheets begin
        path.write_text(text)
        found.append(trajectory_from_csv(path))
    from_plain, from_named = found
    assert from_plain.duration_s == from_named.duration_s == 2.0
    times_s = np.linspace(0, 2, 9)
    np.testing.assert_array_equal(from_plain.poses(times_s), from_named.poses(times_s))
    # A parabola is a cubic: not-a-knot reproduces it to round-off.
    np.testing.assert_allclose(from_plain.poses(times_s)[:, 0, 3], (times_s + 10) ** 2, atol=1e-11)
