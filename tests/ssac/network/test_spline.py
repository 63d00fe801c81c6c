"""The path's splines: scipy's, knots where the data are, and what is known of smoothness."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from ssac.network.normal import ORDER, Spline, basis, jerks, knots_for


def data() -> tuple[np.ndarray, np.ndarray, Spline]:
    rng = np.random.default_rng(0)
    times_s = np.concatenate([rng.uniform(0.0, 5.0, 200), rng.uniform(20.0, 25.0, 100)])
    knots_s = knots_for(times_s, 0.3, 1.0)
    return times_s, knots_s, Spline(knots_s, rng.normal(size=(len(knots_s) - ORDER, 3)))


@pytest.mark.parametrize("derivative", range(4))
def test_curves_and_derivatives_are_those_of_scipy(derivative: int) -> None:
    _, knots_s, spline = data()
    times_s = np.linspace(knots_s[0], knots_s[-1] - 1e-9, 300)
    expected = BSpline(knots_s, spline.coefficients, 3)(times_s, nu=derivative)
    scale = np.abs(expected).max()
    assert spline.at(times_s, derivative) == pytest.approx(expected, abs=1e-12 * scale)  # rounding


def test_knots_lie_where_data_are_alone() -> None:
    times_s, knots_s, _ = data()
    inner = np.unique(knots_s)
    assert not np.any((inner > 5.1) & (inner < 19.9))
    assert inner[0] == times_s.min()
    assert inner[-1] == times_s.max()
    gap_s = times_s[times_s > 10.0].min() - times_s[times_s < 10.0].max()
    assert np.sort(np.diff(inner))[-2:] == pytest.approx([0.3, gap_s], abs=0.02)


def test_jerks_sum_to_the_integral() -> None:
    _, knots_s, spline = data()
    first, weights = jerks(knots_s)
    around = spline.coefficients[first[:, None] + np.arange(ORDER)]
    total = np.sum(np.einsum("na,nax->nx", weights, around) ** 2)
    times_s = np.linspace(knots_s[0], knots_s[-1], 200_001)
    dense = np.sum(spline.at(times_s, 3) ** 2, axis=1)
    # The jerk is constant from knot to knot, and the sum misses its steps by a sample each.
    assert total == pytest.approx(np.mean(dense) * np.ptp(times_s), rel=5e-3)


def test_the_splines_sum_to_one() -> None:
    times_s, knots_s, _ = data()
    assert basis(knots_s, times_s)[1].sum(axis=1) == pytest.approx(1.0, abs=1e-12)
