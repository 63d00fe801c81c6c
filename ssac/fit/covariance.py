"""The covariance of a fit's parameters, from its residuals and their derivatives.

The residuals of a robust fit are not white noise: the object's outline, and still more the mean of
its events, drifts slowly with attitude. So n residuals tell less than n independent ones, and the
fit absorbs part of the slow error, so that they look less correlated than they are.

In each series, the loss's gradients are modelled as a stationary process with the autocovariance
sum_k a_k exp(-|lag| / T_k), a_k >= 0: white noise and components with correlation times T_k. All
series of one kind, such as tangents, share the a_k, for which the residuals' quadratic forms are
as large as expected *after* the fit (variance components by moments: Rao's MINQUE). A direction in
which the loss is hardly curved counts as if it were curved a little, and 1.96 deviations are
widened to Student's 95 % for the degrees of freedom of independent residuals.

Series, such as the upper and the lower tangents, may have errors in common. These count for the
parameters of the clock, t_d first, and are left out for the pose. Where the clock alone is
estimated, the sum of the gradients at an instant is itself the process. See `docs/uncertainty.md`.
"""

from itertools import pairwise

import numba
import numpy as np
from scipy.special import stdtrit

from ssac.arrays import Array, Indices, IntArray
from ssac.rules import FitRules

NORMAL_95 = 1.96

PRIOR = 1e3
"""Prior deviation [s, rad, ...] of parameters of which nothing is known beforehand."""


def correlated_covariance(
    times_s: Array,
    jacobian: Array,
    slopes_px: Array,
    curvatures: Array,
    rules: FitRules,
    prior_deviations: Array,
    prior_scales_px: Array,
    common: Indices,
    lessens: bool = True,
    cautious: bool = False,
    kinds: Indices | None = None,
) -> Array:
    """Covariance (p, p) of M-estimated parameters whose residuals (n,) are correlated in time.

    `times_s` has one series after another, each ascending and of one of the `kinds` (n,) of errors,
    from 0 on; None: all are of one. `jacobian` (n, p) has the residuals' derivatives [px per unit],
    `slopes_px` and `curvatures` (n,) are the first and second derivatives of the loss. Each
    parameter has a prior deviation (p,), PRIOR where nothing is known; in the fit one such
    deviation counts as `prior_scales_px` (p,), or where NaN as an independent residual. Errors that
    series have in common count for the parameters at the places `common` (c,); they may reduce the
    variance of the first of these only if `lessens`.

    A short recording shows few of the slowest errors, and by chance none. If `cautious`, it has at
    most as many degrees of freedom as longest fading times, and if few, no variance is reduced.
    """
    n, p = jacobian.shape
    curvature = mean_curvature(curvatures, rules)
    scale_px = max(float(np.sqrt(np.mean(slopes_px**2))), 1e-9)
    # QR gives parameters in which the Jacobian is orthonormal; the priors are p more residuals.
    is_said = np.isfinite(prior_scales_px)
    scales_px = np.where(is_said, prior_scales_px, scale_px / np.sqrt(curvature))
    prior = np.diag(scales_px / (np.sqrt(curvature) * prior_deviations))
    Q, triangle = np.linalg.qr(np.vstack([jacobian, prior]))
    Q, Q_prior = Q[:n], Q[n:]
    left_px = slopes_px - Q @ (Q.T @ slopes_px)
    meat, independent = _gradient_covariance(times_s, Q, left_px, rules, kinds)
    several = bool(np.any(np.diff(times_s) < 0.0))
    is_clock = len(common) == p  # nothing else is estimated: the pose is known
    if several and is_clock:  # the gradients' sum at an instant is the process
        found = [_sum_variance(times_s, column * left_px, rules) for column in Q.T]
        # The correlations are those of `meat`, which takes the series as independent.
        variances = [variance for variance, _ in found]
        ratios = np.sqrt(variances / np.maximum(np.diag(meat), 1e-300))
        meat = meat * np.outer(ratios, ratios) if p > 1 else np.array([variances])
        independent = min(independent for _, independent in found)
    meat = meat + curvature * Q_prior.T @ (scales_px[:, None] ** 2 * Q_prior)
    bread = Q.T @ (curvatures[:, None] * Q) + curvature * Q_prior.T @ Q_prior
    root = np.linalg.solve(triangle, bounded_inverse(bread, curvature, rules))
    fading_times = float(np.ptp(times_s)) / max(rules.fading_s) if cautious else np.inf
    lessens = lessens and fading_times >= rules.least_fading_times
    factors = np.ones(p)
    if several and not is_clock:
        for k in common:
            factor = _common_factor(times_s, Q @ root[k] * left_px, rules)
            # Errors common to all series make no rate of a clock surer: they drift as it does.
            may_lessen = lessens and k == common[0]
            factors[k] = np.sqrt(factor if may_lessen else max(factor, 1.0))
    # Effective number of parameters that the data determine, not the priors.
    told = p - float(np.sum(Q_prior[prior_deviations < PRIOR] ** 2))
    factors *= student_factor(min(independent - told, fading_times))
    return np.asarray(np.outer(factors, factors) * (root @ meat @ root.T))


def student_factor(freedom: float) -> float:
    """Factor that widens 1.96 deviations to Student's 95 %; freedom counts as 1 at least."""
    return float(stdtrit(max(freedom, 1.0), 0.975)) / NORMAL_95


def mean_curvature(curvatures: Array, rules: FitRules) -> float:
    """Mean of a loss's second derivatives (n,), or `least_mean_curvature` where that is more."""
    return max(float(np.mean(curvatures)), rules.least_mean_curvature)


def bounded_inverse(bread: Array, curvature: float, rules: FitRules) -> Array:
    """Inverse of a loss's Hessian (p, p) in orthonormal parameters, eigenvalues bounded below."""
    shares, axes = np.linalg.eigh(bread)
    return np.asarray(axes / np.maximum(shares, rules.least_curvature * curvature) @ axes.T)


def repeats(times_s: Array, jacobian: Array, slopes_px: Array, rules: FitRules) -> float:
    """How many of a fit's residuals together tell as much as one independent one; at least 1."""
    Q = np.linalg.qr(jacobian)[0]
    left_px = slopes_px - Q @ (Q.T @ slopes_px)
    independent = _gradient_covariance(times_s, Q, left_px, rules)[1]
    return max(len(times_s) / independent, 1.0) if independent > 0.0 else 1.0


def _gradient_covariance(
    times_s: Array, Q: Array, left_px: Array, rules: FitRules, kinds: Indices | None = None
) -> tuple[Array, float]:
    """Covariance of Q' g for gradients g (n,), and the equivalent number of independent ones."""
    # Q (n, p) has orthonormal columns, and left = (1 - Q Q') g is what the fit leaves of g.
    p, each = Q.shape[1], 1 + len(rules.fading_s)
    kinds = np.zeros(len(times_s), np.intp) if kinds is None else kinds
    n_kinds = int(np.max(kinds, initial=0)) + 1
    size = n_kinds * each
    forms = np.zeros(size)  # left' L_k left, with L_k the correlations of component k
    traces = np.zeros((size, size))  # of L_k L_l
    projected = np.zeros((size, p, p))  # Q' L_k Q
    products = np.zeros((size, size))  # traces of Q' L_k L_l Q
    pairs = np.zeros(size)  # sums of L_k
    for part, bins, step_s in _series(times_s):
        own = slice(kinds[part.start] * each, (kinds[part.start] + 1) * each)
        n_bins = int(bins[-1]) + 1
        size_fft = 1 << int(2 * n_bins - 1).bit_length()  # room for both signs of the lag
        lags_s = step_s * np.arange(n_bins, dtype=np.float64)
        white = np.where(lags_s > 0.0, 0.0, 1.0)
        fading = np.stack([white, *(np.exp(-lags_s / time_s) for time_s in rules.fading_s)])
        values = np.zeros((n_bins, p + 2))
        np.add.at(values, bins, np.column_stack([Q[part], left_px[part], np.ones(len(bins))]))
        spectra = np.fft.rfft(values, size_fft, axis=0)
        # Sums of products at each lag, of both signs: of the residuals, and of their counts.
        sums = np.fft.irfft(np.abs(spectra[:, p:]) ** 2, axis=0)[:n_bins]
        sums[1:] *= 2.0
        forms[own] += fading @ sums[:, 0]
        pairs[own] += fading @ sums[:, 1]
        traces[own, own] += fading * sums[:, 1] @ fading.T
        kernels = np.zeros((each, size_fft))  # even functions of the lag, which wraps around
        kernels[:, :n_bins] = fading
        kernels[:, size_fft - n_bins + 1 :] = fading[:, :0:-1]
        spread = np.fft.irfft(np.fft.rfft(kernels)[:, :, None] * spectra[:, :p], axis=1)
        spread = spread[:, :n_bins]
        projected[own] += values[:, :p].T @ spread
        there = values[:, p + 1, None] * spread
        products[own, own] += np.einsum("kti,lti->kl", there, spread)
    expected = traces - 2.0 * products + np.einsum("kij,lij->kl", projected, projected)
    diagonal = np.diag(expected)  # rows and columns are scaled to make these 1
    scales = np.sqrt(np.maximum(diagonal, 1e-12 * max(np.max(diagonal), 1e-300)))
    amounts = _best_positive(expected / np.outer(scales, scales), forms / scales) / scales
    independent = 0.0
    for kind in range(n_kinds):
        own = slice(kind * each, (kind + 1) * each)
        n = np.count_nonzero(kinds == kind)
        if np.sum(amounts[own]) > 0.0:
            independent += n**2 * float(np.sum(amounts[own])) / float(amounts[own] @ pairs[own])
    if independent == 0.0:
        return np.zeros((p, p)), 0.0
    return np.einsum("k,kij->ij", amounts, projected), independent


def _common_factor(times_s: Array, effects: Array, rules: FitRules) -> float:
    """Variance of a sum of effects (n,), relative to that with independent series."""
    apart = sum(
        _sum_variance(times_s[part], effects[part], rules)[0] for part, _, _ in _series(times_s)
    )
    if not apart > 0.0:
        return 1.0
    together = _sum_variance(times_s, effects, rules)[0]
    return max(float(together / apart), rules.least_common)


def _sum_variance(times_s: Array, effects: Array, rules: FitRules) -> tuple[float, float]:
    """Variance of the sum of a process (n,), and the equivalent number of independent values."""
    instants_s, places = np.unique(times_s, return_inverse=True)
    m = len(instants_s)
    sums = np.bincount(places, effects, m)
    ones = np.full((m, 1), m**-0.5)
    variance, independent = _gradient_covariance(instants_s, ones, sums - np.mean(sums), rules)
    return m * variance[0, 0], independent


def _series(times_s: Array) -> list[tuple[slice, IntArray, float]]:
    """Split into ascending series: each one's slice, its bins on an even grid, and the step [s]."""
    bounds = [0, *(np.flatnonzero(np.diff(times_s) < 0.0) + 1), len(times_s)]
    found = []
    for start, end in pairwise(bounds):
        since_s = times_s[start:end] - times_s[start]
        gaps_s = np.diff(since_s)
        step_s = max(float(np.min(gaps_s[gaps_s > 0.0], initial=1.0)), float(since_s[-1]) / 20_000)
        bins = np.rint(since_s / step_s).astype(np.int64)
        found.append((slice(start, end), bins, step_s))
    return found


@numba.njit(cache=True)
def _best_positive(scaled: Array, target: Array) -> Array:
    """Find the x >= 0 (n,) with the least |scaled x - target|, over all choices of non-zeros."""
    n = len(target)
    best, least = np.zeros(n), np.sum(target**2)
    for chosen in range(1, 1 << n):  # a bit for each unknown
        columns = np.array([k for k in range(n) if chosen >> k & 1])
        system = np.ascontiguousarray(scaled[:, columns])
        found = np.linalg.lstsq(system, target, float(np.finfo(np.float64).eps) * n)[0]
        error = np.sum((system @ found - target) ** 2)
        if np.all(found >= 0.0) and error < least:
            best, least = np.zeros(n), error
            best[columns] = found
    return best
