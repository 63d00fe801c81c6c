"""Covariances against dense matrices, against simulated noise, and where the data say nothing."""

import itertools

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.stats import t as student

from ssac.fit.covariance import PRIOR, correlated_covariance, student_factor
from ssac.rules import FitRules

RULES = FitRules()
INSTANTS_S = 0.02 * np.arange(500)
TWICE_S = np.tile(INSTANTS_S, 2)  # two series


def waves(times_s, p, rng):
    """Jacobian (n, p) of derivatives that change within seconds, as an object's course does."""
    rates_hz, phases = rng.uniform(0.1, 1.0, p), rng.uniform(0.0, 6.0, p)
    return 1.0 + np.sin(2.0 * np.pi * rates_hz * times_s[:, None] + phases)


def left_of(jacobian, noise):
    """Return the residuals of a fit to noise alone, and the parameters that it finds."""
    found = np.linalg.lstsq(jacobian, noise)[0]
    return noise - jacobian @ found, found


def covariance_of(times_s, jacobian, slopes, curvature=1.0, known=None, common=(0,), **options):
    curvatures, p = np.broadcast_to(curvature, len(slopes)), jacobian.shape[1]
    priors = np.full(p, PRIOR) if known is None else known, np.full(p, np.nan)
    seen = times_s, jacobian, slopes, curvatures
    return correlated_covariance(*seen, RULES, *priors, np.array(common), **options)


def deviations_of(*seen, **options):
    return np.sqrt(np.diag(covariance_of(*seen, **options)))


def correlation(times_s, series, time_s):
    """Correlations (n, n) of residuals, which fade in `time_s`, and are 0 between series."""
    lags_s = np.abs(times_s[:, None] - times_s)
    fading = np.exp(-lags_s / time_s) if time_s else (lags_s == 0.0).astype(float)
    return fading * (series[:, None] == series)


@pytest.mark.parametrize("are_alike", [True, False])
def test_it_is_the_dense_estimator(are_alike):
    rng = np.random.default_rng(0)
    # Two series on one grid of 20 ms, a fifth of each being absent.
    series, places = np.nonzero(rng.uniform(size=(2, 150)) > 0.2)
    times_s = 3.0 + 0.02 * places
    n, p = len(times_s), 4
    kinds = np.zeros(n, np.int64) if are_alike else series
    jacobian, curvatures = waves(times_s, p, rng), rng.uniform(0.5, 1.0, n)
    kernels = [
        correlation(times_s, series, time_s) * (kinds == kind)
        for kind in range(1 + kinds.max())
        for time_s in (0.0, *RULES.fading_s)
    ]
    noise = np.linalg.cholesky(kernels[0] + 2.0 * kernels[2] + kernels[-1]) @ rng.normal(size=n)
    M = np.eye(n) - jacobian @ np.linalg.pinv(jacobian)
    slopes = M @ noise
    seen = [M @ k @ M for k in kernels]
    A = np.array([[np.sum(k * m) for m in seen] for k in kernels])  # traces of the products
    scales = np.sqrt(np.diag(A))
    forms = np.array([slopes @ k @ slopes for k in kernels])
    amounts = nnls(A / np.outer(scales, scales), forms / scales)[0] / scales
    gamma = sum(a * k for a, k in zip(amounts, kernels, strict=True))
    bread = np.linalg.inv(jacobian.T @ (curvatures[:, None] * jacobian))
    independent = sum(
        np.sum(own) ** 2 * np.sum(amounts.reshape(-1, 4)[kind]) / np.sum(gamma[own][:, own])
        for kind, own in ((kind, kinds == kind) for kind in range(1 + kinds.max()))
    )
    widening = student.ppf(0.975, independent - p) / 1.96
    expected = widening**2 * bread @ jacobian.T @ gamma @ jacobian @ bread
    found = covariance_of(times_s, jacobian, slopes, curvatures, kinds=kinds)
    found, expected = found[1:, 1:], expected[1:, 1:]  # parameter 0 counts common noise, too
    # The prior of 1e3 per parameter, and rounding.
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("fades_in_s", [(0.0,), (0.0, 0.1, 0.4)])
def test_intervals_and_regions_hold_the_truth(fades_in_s):
    rng = np.random.default_rng(1)
    series = np.repeat([0, 1], 500)
    gamma = sum(correlation(TWICE_S, series, time_s) for time_s in fades_in_s)
    root, errors, distances = np.linalg.cholesky(gamma), [], []
    for _ in range(150):
        jacobian = waves(TWICE_S, 6, rng)
        left, found = left_of(jacobian, root @ rng.normal(size=1000))
        covariance = covariance_of(TWICE_S, jacobian, left)
        errors.append(np.abs(found) / np.sqrt(np.diag(covariance)))
        distances.append(found[1:] @ np.linalg.solve(covariance[1:, 1:], found[1:]))
    # 150 runs of 6 parameters, of which perhaps 3 are independent: 95 +- 1 %; three deviations.
    assert np.mean(np.array(errors) < 1.96) == pytest.approx(0.95, abs=0.03)
    # The fit takes 6 of 50 degrees of freedom: parameter 0's series seem less alike than they are.
    assert np.mean(np.array(errors)[:, 0] < 1.96) > 0.88
    # chi^2 of 5 parameters: the mean of 150 runs is known to 5 %, and the regions are a little
    # too small, as the covariance comes from as few degrees of freedom.
    assert np.mean(distances) == pytest.approx(5.0, rel=0.25)


@pytest.mark.parametrize(("duration_s", "fewest"), [(4.0, True), (400.0, False)])
def test_caution_counts_fading_times(duration_s, fewest):
    rng, times_s = np.random.default_rng(2), np.linspace(0.0, duration_s, 400)
    jacobian = waves(times_s, 2, rng)
    left = left_of(jacobian, rng.normal(size=400))[0]
    plain, cautious = (
        deviations_of(times_s, jacobian, left, cautious=one) for one in (False, True)
    )
    freedom = duration_s / max(RULES.fading_s) if fewest else np.inf
    # White noise has some 400 degrees of freedom: 1.97 deviations.
    expected = student.ppf(0.975, freedom) / 1.96
    assert cautious / plain == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("sign", [1.0, 0.0, -0.3])
def test_one_parameter_may_have_series_with_common_noise(sign):
    rng, errors = np.random.default_rng(8), []
    root = np.linalg.cholesky(correlation(INSTANTS_S, np.zeros(500), 0.1))
    for _ in range(400):
        first, second = (root @ rng.normal(size=500) for _ in range(2))
        jacobian = np.tile(waves(INSTANTS_S, 1, rng), (2, 1))
        noise = np.concatenate([first, sign * first + (1.0 - abs(sign)) * second])
        left, found = left_of(jacobian, noise)
        errors.append(found[0] / deviations_of(TWICE_S, jacobian, left)[0])
    # 400 runs give the root mean square to 3.5 %. It should be a little below 1, by Student's
    # factor and by slow components that are found by chance.
    assert 0.85 < np.sqrt(np.mean(np.square(errors))) < 1.07


@pytest.mark.parametrize("share", [0.0, 1e-12])
def test_what_the_data_do_not_tell_is_unknown(share):
    rng = np.random.default_rng(4)
    jacobian = waves(INSTANTS_S, 3, rng)
    jacobian[:, 2] = jacobian[:, 1] + share * jacobian[:, 2]  # only their sum is seen
    covariance = covariance_of(INSTANTS_S, jacobian, left_of(jacobian, rng.normal(size=500))[0])
    deviations = np.sqrt(np.diag(covariance))
    assert deviations[0] < 1.0
    assert np.all(deviations[1:] > 0.5 * PRIOR)
    together = np.array([0.0, 1.0, 1.0])
    assert together @ covariance @ together < 1e-3 * PRIOR**2  # their sum is known


@pytest.mark.parametrize(
    ("n_instants", "p", "moves"), [(500, 6, False), (500, 1, False), (3, 6, True)]
)
def test_an_object_at_rest_and_three_pairs_tell_nothing(n_instants, p, moves):
    rng = np.random.default_rng(9)
    times_s = np.tile(0.02 * np.arange(n_instants), 1 if moves else 2)
    jacobian, slopes = rng.normal(size=(len(times_s), p)) * moves, rng.normal(size=len(times_s))
    assert np.all(deviations_of(times_s, jacobian, slopes) > 0.9 * PRIOR)


def test_a_loss_that_is_not_curved_makes_no_small_deviation():
    rng = np.random.default_rng(5)
    seen = INSTANTS_S, waves(INSTANTS_S, 3, rng), rng.normal(size=500)
    found = [deviations_of(*seen, curvature) for curvature in (1.0, 0.2, 1e-9, -1.0)]
    for one, other in itertools.pairwise(found):
        assert np.all(other >= 0.995 * one)  # the prior, once more


@pytest.mark.parametrize("are_opposite", [True, False])
def test_what_series_have_in_common_counts_for_the_clock_alone(are_opposite):
    rng = np.random.default_rng(10)
    jacobian = np.tile(waves(INSTANTS_S, 3, rng), (2, 1))
    first = rng.normal(size=500)
    second = 0.3 * rng.normal(size=500) - first if are_opposite else first
    left, _ = left_of(jacobian, np.concatenate([first, second]))
    apart, one, both = (
        deviations_of(TWICE_S, jacobian, left, common=places) for places in ([2], [0], [0, 1])
    )
    assert both[0] == one[0]
    if are_opposite:
        # Opposite errors cancel in the offset, the first of the clock's parameters. Common errors
        # make a rate drift, so that they never lessen its deviation.
        assert one[0] < 0.8 * apart[0]
        kept = deviations_of(TWICE_S, jacobian, left, lessens=False)  # cancelling is ignored
        assert kept[0] == apart[0]
        for time in (0.1, 1.0):  # 1 s is too short to show this, 10 s are not
            seen = time * TWICE_S, jacobian, left
            cautious, bold = (deviations_of(*seen, cautious=on)[0] for on in (True, False))
            widened = student_factor(time * np.ptp(TWICE_S) / max(RULES.fading_s))
            assert (cautious > 1.2 * widened * bold) == (time < 1.0)
        assert both[1] == one[1] == apart[1]
    else:
        assert both[1] > 1.2 * one[1]  # equal series: twice the variance
        assert both[2] == one[2]


def test_what_was_known_beforehand_takes_no_degree_of_freedom():
    rng = np.random.default_rng(12)
    times_s, jacobian = 0.02 * np.arange(12), rng.normal(size=(12, 8))
    left, _ = left_of(jacobian[:, :2], rng.normal(size=12))
    known = np.append([PRIOR, PRIOR], np.full(6, 1e-9))
    alone = covariance_of(times_s, jacobian[:, :2], left)
    held = covariance_of(times_s, jacobian, left, known=known)
    # Six parameters that are known to 1e-9 take none: of 12 residuals, 2 are used up, not 8. The
    # correlations of so few are hardly known: 4 degrees of freedom would double a deviation.
    np.testing.assert_allclose(held[:2, :2], alone, rtol=1e-3)
    # What the data do not tell has the deviation that was known.
    np.testing.assert_allclose(np.sqrt(np.diag(held)[2:]), 1e-9, rtol=0.3)
