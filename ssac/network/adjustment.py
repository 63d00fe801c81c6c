"""Cameras and a path that nearly fit in; both adjusted together by robust least squares, out.

The path is a cubic spline whose jerk is white noise of a strength that the data tell, so that its
knots may be as dense as the sightings. Each camera's deviation is that of its own residuals.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ssac.geometry.robust import CAUCHY
from ssac.network.linear import (
    Mask,
    Network,
    border_offsets,
    deviation_px,
    known,
    linearised,
)
from ssac.network.normal import Linear, Normal, Solved, solve
from ssac.network.sightings import Sightings
from ssac.network.spline import jerks
from ssac.network.state import (
    BEHIND,
    CENTRE,
    DELAY,
    FOCAL,
    LEAST_DEPTH,
    RATE,
    READOUT,
    ROTATION,
    STRAYS,
    TRANSLATION,
    Priors,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_LEAST_SHARE = 0.3  # of the cameras' median deviation: no camera's is less
_LEAST_PX = 0.01
_MOST_LAGS, _NO_CORRELATION = 500, 0.05
_BLOCK_S = 1.0  # in which an object turns: what lasts longer than that is little
_LONGEST_STEP_S = 0.5  # between knots; there is a gap where it is longer
_ROUNDS, _STEPS = 12, 6
_SETTLED = 3e-4  # share by which the cost changes in a round of a solution that has settled
_DAMPING = 1e-4


def adjust(
    network: Network,
    cameras: list[Sightings],
    priors: list[Priors],
    enabled: list[Mask],
    rounds: int = _ROUNDS,
    with_intrinsics: bool = True,
) -> tuple[Network, Solved]:
    """Adjust cameras and path together.

    Parameters
    ----------
    network
        To begin with.
    cameras, priors
        What each saw, and the priors of its parameters.
    enabled
        Of each camera (n,): which sightings count.
    rounds
        Of new deviations and a new smoothness, at most.
    with_intrinsics
        Whether readouts, focal lengths and centres are adjusted too.

    Returns
    -------
    tuple
        The network, and the last solution, for its covariance.
    """
    offsets, free = _layout(network, with_intrinsics, priors, cameras)
    cost, last = np.inf, np.inf
    for _ in range(rounds):
        network, cost, solved = _minimised(network, cameras, priors, enabled, offsets, free)
        network = _weighed(network, cameras, enabled, solved, offsets)
        if abs(last - cost) < _SETTLED * abs(cost):
            break
        last = cost
    normal, _ = _normal(network, cameras, priors, enabled, offsets)
    return network, solve(normal, free)


def _layout(
    network: Network, with_intrinsics: bool, priors: list[Priors], cameras: list[Sightings]
) -> tuple[Indices, Indices]:
    """Where each camera's parameters begin, and which of all are free."""
    offsets, free = border_offsets(network), list[int]()
    for k, (prior, seen) in enumerate(zip(priors, cameras, strict=True)):
        places = list(range(STRAYS, network.states[k].size))
        if with_intrinsics:
            places += [READOUT] if seen.has_frames and prior.readout_s > 0.0 else []
            places += [] if seen.has_frames else [BEHIND]
            places += [FOCAL.start + i for i in range(2) if prior.focal[i] > 0.0]
            places += [CENTRE.start + i for i in range(2) if prior.centre_px[i] > 0.0]
        if k:
            places += [DELAY, *range(ROTATION.start, TRANSLATION.stop)]
            places += [RATE] if prior.rate > 0.0 else []
        free += [int(offsets[k]) + place for place in places]
    return offsets, np.array(sorted(free), dtype=np.int64)


def _minimised(
    network: Network,
    cameras: list[Sightings],
    priors: list[Priors],
    enabled: list[Mask],
    offsets: Indices,
    free: Indices,
) -> tuple[Network, float, Solved]:
    """Take steps as long as they lower the cost, at given deviations and smoothness."""
    normal, cost = _normal(network, cameras, priors, enabled, offsets)
    damping = 0.0
    for _ in range(_STEPS):
        for _ in range(6):
            solved = solve(normal, free, damping)
            tried = _moved(network, solved, offsets)
            other, tried_cost = _normal(tried, cameras, priors, enabled, offsets)
            if tried_cost <= cost * (1.0 + 1e-9):
                break
            damping = max(10.0 * damping, _DAMPING)
        else:
            return network, cost, solved
        gained = cost - tried_cost
        network, normal, cost = tried, other, tried_cost
        damping *= 0.1 if damping > _DAMPING else 0.0
        if gained < 0.1 * _SETTLED * cost:
            break
    return network, cost, solved


def _moved(network: Network, solved: Solved, offsets: Indices) -> Network:
    states = [
        state.moved(solved.border[offsets[k] : offsets[k + 1]])
        for k, state in enumerate(network.states)
    ]
    path = replace(network.path, coefficients=network.path.coefficients + solved.path)
    return replace(network, states=states, path=path)


def _normal(
    network: Network,
    cameras: list[Sightings],
    priors: list[Priors],
    enabled: list[Mask],
    offsets: Indices,
) -> tuple[Normal, float]:
    """Give the normal equations, and the cost: Cauchy's loss, and the priors' squares."""
    coefficients = network.path.coefficients
    normal, cost = Normal(len(coefficients), int(offsets[-1])), 0.0
    for k, seen in enumerate(cameras):
        linear, fit = linearised(network, k, seen, enabled[k])
        share = seen.sigmas_px / np.median(seen.sigmas_px) * network.sigmas_px[k]
        over = fit.residuals_px / share[:, None]
        squares = np.sum(over**2, axis=1) / CAUCHY**2
        lost = np.where(fit.used, 0.5 * CAUCHY**2 * np.log1p(squares), 0.0)
        # A point that is not in front of the camera costs as one far off its place.
        behind = enabled[k] & (fit.depths <= LEAST_DEPTH)
        cost += float(np.sum(lost) + 40.0 * np.count_nonzero(behind))
        rows = np.flatnonzero(fit.used)
        scale = 1.0 / (share[rows] * np.sqrt(1.0 + squares[rows]))
        normal.add(
            Linear(
                linear.first[rows],
                linear.weights[rows],
                linear.by_point[rows] * scale[:, None, None],
                linear.by_camera[rows] * scale[:, None, None],
                linear.columns[rows] + offsets[k],
                linear.residuals[rows] * scale[:, None],
            )
        )
    first, weights = jerks(network.path.knots_s)
    weights = weights / network.jerk
    normal.add_smoothness(first, weights, coefficients)
    values = np.einsum("na,nax->nx", weights, coefficients[first[:, None] + np.arange(4)])
    cost += 0.5 * float(np.sum(values**2))
    told, residuals = known(network, cameras, priors, offsets)
    normal.add_rows(told, residuals)
    return normal, cost + 0.5 * float(np.sum(residuals**2))


def _weighed(
    network: Network,
    cameras: list[Sightings],
    enabled: list[Mask],
    solved: Solved,
    offsets: Indices,
) -> Network:
    """Estimate each camera's deviation, and the path's smoothness, from what is left.

    What the path takes up of the residuals, its leverage, is made up for.
    """
    sigmas, repeats = network.sigmas_px.copy(), list[float]()
    for k, seen in enumerate(cameras):
        linear, fit = linearised(network, k, seen, enabled[k])
        rows = np.flatnonzero(fit.used)
        if len(rows) < 10:
            continue
        share = seen.sigmas_px[rows] / np.median(seen.sigmas_px)
        over = fit.residuals_px[rows] / share[:, None]
        count = repeats_of if seen.spreads_px2 is None else repeats_in_blocks
        repeats.append(count(seen.times_s[rows], over))
        covariances = solved.path_covariances(linear.first[rows], linear.weights[rows], False)
        by_point = linear.by_point[rows]
        lever = np.einsum("nix,nxy,niy->n", by_point, covariances, by_point)
        lever = lever / (share * network.sigmas_px[k]) ** 2
        left = max(0.1, 1.0 - 0.5 * float(np.median(lever)))
        sigmas[k] = deviation_px(over) / np.sqrt(left)
    sigmas = _alike(sigmas, cameras)
    least = max(_LEAST_SHARE * float(np.median(sigmas)), _LEAST_PX)
    first, weights = jerks(network.path.knots_s)
    coefficients = network.path.coefficients
    values = np.einsum("na,nax->nx", weights, coefficients[first[:, None] + np.arange(4)])
    unsure = solved.path_covariances(first, weights, False)
    trace = np.trace(unsure, axis1=1, axis2=2)
    told = 3.0 * len(first) - float(np.sum(trace)) / network.jerk**2
    jerk = float(np.sqrt(np.sum(values**2) / max(told, 1.0)))
    mean = float(np.mean(repeats)) if repeats else 1.0
    return replace(
        network,
        sigmas_px=np.maximum(sigmas, least),
        jerk=max(jerk, 1e-12),
        repeats=mean,
        lasting=1.0 + (mean - 1.0) * _taken_up(network, cameras, enabled),
    )


def _alike(sigmas_px: Array, cameras: list[Sightings]) -> Array:
    """Give event cameras the deviations that they have of themselves, times one common factor.

    The mean of the events strays by a share of the image's size in all of them. Each for itself,
    the two whose errors the path takes up best would soon seem to be without any.
    """
    of_events = np.flatnonzero([not seen.has_frames for seen in cameras])
    if not len(of_events):
        return sigmas_px
    own_px = np.array([float(np.median(seen.sigmas_px)) for seen in cameras])
    factors = sigmas_px[of_events] / own_px[of_events]
    found = sigmas_px.copy()
    found[of_events] = np.sqrt(np.mean(factors**2)) * own_px[of_events]
    return found


def _taken_up(network: Network, cameras: list[Sightings], enabled: list[Mask]) -> float:
    """Give how much larger slow errors are, as variances, than the residuals show them.

    The path follows them in three of the directions in which they are: two for each camera that
    sees the object. Those of silhouettes are along the object's width, mostly, and that of what
    flies is level: in one direction for each camera, of which the path follows two.
    """
    steps_s = np.diff(network.path.knots_s)
    covered_s = float(np.sum(steps_s[steps_s <= _LONGEST_STEP_S]))
    seen_s = sum(
        seen.interval_s * float(np.count_nonzero(mask))
        for seen, mask in zip(cameras, enabled, strict=True)
    )
    views = seen_s / max(covered_s, seen_s / len(cameras))
    if all(seen.spreads_px2 is not None for seen in cameras):
        views = max(views, 2.5)
        return views / (views - 2.0)
    directions = max(2.0 * views, 4.0)
    return directions / (directions - 3.0)


def repeats_of(times_s: Array, residuals: Array) -> float:
    """Count the sightings that tell as much as an independent one: 1 + 2 sum of correlations.

    Parameters
    ----------
    times_s, residuals
        Shapes (n,) and (n, 2). Correlations are summed until they vanish, within each stretch
        without gaps.
    """
    limit = 3.0 * deviation_px(residuals) + 1e-12
    clipped = np.clip(residuals, -limit, limit)
    variance = float(np.mean(clipped**2))
    interval_s = float(np.median(np.diff(times_s)))
    total = 1.0
    for lag in range(1, min(_MOST_LAGS, len(times_s) // 4)):
        together = times_s[lag:] - times_s[:-lag] < 1.5 * lag * interval_s
        if np.count_nonzero(together) < len(times_s) // 4:
            break
        products = np.mean(clipped[lag:] * clipped[:-lag], axis=1)[together]
        correlation = float(np.mean(products)) / variance
        if correlation < _NO_CORRELATION:
            break
        total += 2.0 * correlation
    return total


def repeats_in_blocks(times_s: Array, residuals: Array) -> float:
    """Count as `repeats_of` does, by what the sums of blocks of a second are.

    Of silhouettes, what lasts is small beside what does not: correlations are near nothing long
    before they vanish, and go on. Parameters are as there.
    """
    deviation = deviation_px(residuals) + 1e-12
    clipped = np.clip(residuals / deviation, -3.0, 3.0)
    blocks = np.floor((times_s - times_s[0]) / _BLOCK_S).astype(np.int64)
    sums = np.stack([np.bincount(blocks, axis) for axis in clipped.T])
    return max(float(np.sum(sums**2)) / clipped.size, 1.0)
