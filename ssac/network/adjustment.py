"""Adjust cameras and path of a network together, by robust least squares.

The path is a cubic spline whose jerk is white noise of a strength estimated from the data, so its
knots may be as dense as the sightings. Deviations of cameras are estimated from residuals.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ssac.arrays import Array, IntArray, Mask
from ssac.geometry.epipolar import CAUCHY, robust_deviation
from ssac.network import state as layout
from ssac.network.graph import Link, Pair, shared_by
from ssac.network.normal import Linear, Normal, Solved, Spline, basis, jerks, products, solve
from ssac.network.state import CameraState, Priors, Sightings, network_times, projected
from ssac.rules import NetworkRules


@dataclass(frozen=True, eq=False)
class Network:
    """Cameras, in one order, and the path, in the frame of the first camera."""

    cameras: list[Sightings]
    priors: list[Priors]
    enabled: list[Mask]  # (n,) sightings that count
    states: list[CameraState]
    path: Spline
    sigmas_px: Array  # (c,) of each camera's residuals
    jerk: float  # root of its spectral density: unit / s^2.5
    distance: float
    rules: NetworkRules
    repeats: float = 1.0  # sightings worth one independent one, as errors are correlated
    lasting: float = 1.0  # the same, with the part of such errors that the path absorbs
    constraints: Mapping[Pair, Link] = field(default_factory=dict)  # by places of states
    freedom: float = 0.0  # degrees of it that the jerk was estimated from; 0: not yet
    square: float = 1.0  # of the path's size, at that time


@dataclass(frozen=True, eq=False)
class Fit:
    """How the network fits the sightings of one camera."""

    linear: Linear  # not yet divided by deviations: its residuals are seen less projected [px]
    in_front: Mask  # (n,) of the camera
    used: Mask  # (n,) within the path, in front, and not switched off

    @property
    def rms_px(self) -> float:
        """Robust deviation of a coordinate; NaN where nothing is used."""
        used = self.linear.residuals[self.used]
        return robust_deviation(used) if len(used) else np.nan


def border_offsets(network: Network) -> IntArray:
    """Give where each camera's parameters begin in the border (c + 1,)."""
    return np.concatenate([[0], np.cumsum([state.size for state in network.states])]).astype(int)


def fit_of(network: Network, k: int) -> Fit:
    """Compare camera k's sightings with the projections of the path."""
    state, seen, knots_s = network.states[k], network.cameras[k], network.path.knots_s
    times_s = network_times(state, seen)
    inside = (times_s >= knots_s[0]) & (times_s <= knots_s[-1]) & network.enabled[k]
    clipped_s = np.clip(times_s, knots_s[0], knots_s[-1])
    first, weights = basis(knots_s, clipped_s)
    slopes = basis(knots_s, clipped_s, 1)[1]
    points = products(first, weights, network.path.coefficients)
    velocities = products(first, slopes, network.path.coefficients)
    points_px, in_front, by_point, by_camera, columns = projected(state, seen, points, velocities)
    off_px = seen.points_px - points_px
    linear = Linear(first, weights, by_point, by_camera, columns, off_px)
    return Fit(linear, in_front, inside & in_front)


def known(network: Network) -> tuple[Array, Array]:
    """Return rows (k, b) and residuals (k,) of cameras' priors and of pairs' constraints."""
    rows, residuals = list[Array](), list[float]()
    cameras, rules, offsets = network.cameras, network.rules, border_offsets(network)

    def add(places: IntArray | list[int], values: Array | list[float], residual: float) -> None:
        row = np.zeros(int(offsets[-1]))
        row[places] = values
        rows.append(row)
        residuals.append(residual)

    # The distance sets the scale, which the data leave open, and strays have no offset or slope by
    # definition: these constraints are as firm as rounding allows.
    scale_std, held_stray_s = 1e-6, 1e-6
    # The sightings count in full, though errors are correlated: priors are sharpened instead.
    sharper = 1.0 / np.sqrt(network.repeats)
    for k, (state, prior) in enumerate(zip(network.states, network.priors, strict=True)):
        at = int(offsets[k])
        values = [(layout.RATE, prior.rate, state.rate - prior.expected_rate)] if k else []
        values += [(layout.READOUT, prior.readout_s, state.readout_s)]
        both_err = min(prior.focal) > 0.0
        for i in range(2):
            if not (i and both_err):
                values += [(layout.FOCAL.start + i, prior.focal[i], float(state.focal[i]))]
            values += [(layout.CENTRE.start + i, prior.centre_px[i], float(state.centre_px[i]))]
        for place, deviation, value in values:
            if deviation > 0.0:
                deviation *= sharper
                add([at + place], [1.0 / deviation], -value / deviation)
        if both_err:  # fv, given fu
            correlation = 1.0 - 0.5 * rules.aspect_share**2
            beside = np.array([-correlation, 1.0]) / np.sqrt(1.0 - correlation**2)
            beside /= sharper * np.array(prior.focal)
            places = at + np.arange(layout.FOCAL.start, layout.FOCAL.stop)
            add(places, beside, -float(beside @ state.focal))
        n = len(state.strays_s)
        if n:
            places = at + layout.STRAYS + np.arange(n)
            step_s = float(state.knots_s[1] - state.knots_s[0])
            bend_s = sharper * prior.roughness * step_s
            bends = np.array([1.0, -2.0, 1.0])
            for i in range(n - 2):
                bend = float(bends @ state.strays_s[i : i + 3])
                add(places[i : i + 3], bends / bend_s, -bend / bend_s)
            slope = np.linspace(-1.0, 1.0, n, dtype=np.float64)
            for mode in (np.full(n, 1.0 / n), slope / np.sum(slope**2)):
                value = float(mode @ state.strays_s)
                add(places, mode / held_stray_s, -value / held_stray_s)
    of_events = [k for k, seen in enumerate(cameras) if not seen.has_frames]
    values_px = np.array([network.states[k].behind_px for k in of_events])
    by_mean = np.array([cameras[k].spreads_px2 is None for k in of_events], np.bool_)
    common_px = np.where(by_mean, rules.behind_std_px, rules.level_std_px)
    own_px = np.where(by_mean, rules.behind_own_px, rules.level_own_px)
    # One error is common to all of them, beside each one's own.
    covariance = np.outer(common_px, common_px) + np.diag(own_px**2)
    weights = np.linalg.inv(np.linalg.cholesky(covariance)) / sharper
    off_px = np.where(by_mean, rules.behind_px, 0.0) - values_px
    for values, residual in zip(weights, weights @ off_px, strict=True):
        add(offsets[of_events] + layout.BEHIND, values, float(residual))
    alike = shared_by(network.constraints)
    for (a, b), pair in network.constraints.items():
        by_a, by_b, off_by = pair.rows(network.states[a], network.states[b])
        counts = np.sqrt(network.lasting / alike[a, b])
        places = np.r_[offsets[a] : offsets[a + 1], offsets[b] : offsets[b + 1]]
        for by, residual in zip(np.hstack([by_a, by_b]), off_by, strict=True):
            add(places, counts * by, float(counts * residual))
    t = network.states[1].t
    length = float(np.linalg.norm(t))
    off = np.log(network.distance / length) / scale_std
    places = offsets[1] + np.arange(layout.TRANSLATION.start, layout.TRANSLATION.stop)
    add(places, t / length**2 / scale_std, off)
    return np.array(rows), np.array(residuals)


def adjust(network: Network, rounds: int, with_intrinsics: bool = True) -> tuple[Network, Solved]:
    """Adjust cameras and path, with new deviations in each round; return the solution too."""
    free, last = _free(network, with_intrinsics), np.inf
    for _ in range(rounds):
        network, cost, solved = _minimised(network, free)
        network = _weighed(network, solved)
        if abs(last - cost[0]) < network.rules.settled * cost[0]:
            break
        last = cost[0]
    return network, solve(_normal(network)[0], free)


def _free(network: Network, with_intrinsics: bool) -> IntArray:
    free = list[int]()
    for k, (prior, seen) in enumerate(zip(network.priors, network.cameras, strict=True)):
        places = list(range(layout.STRAYS, network.states[k].size))
        if with_intrinsics:
            places += [layout.READOUT] if prior.readout_s > 0.0 else []
            places += [] if seen.has_frames else [layout.BEHIND]
            places += [layout.FOCAL.start + i for i in range(2) if prior.focal[i] > 0.0]
            places += [layout.CENTRE.start + i for i in range(2) if prior.centre_px[i] > 0.0]
        if k:
            places += [layout.DELAY]
            places += [layout.RATE] if prior.rate > 0.0 else []
            pose = range(layout.ROTATION.start, layout.TRANSLATION.stop)
            places += [] if prior.pose_is_known else pose
        free += [int(border_offsets(network)[k]) + place for place in places]
    return np.array(sorted(free), dtype=np.int64)


def _rescaled(network: Network) -> Network:
    """Scale cameras and path to the known distance, off which long straight steps lead.

    Cameras turn far where focal lengths turn out to be others. Without such, steps of a bad start
    are safer for being damped by that distance.
    """
    scale = network.distance / float(np.linalg.norm(network.states[1].t))
    states = [replace(state, t=scale * state.t) for state in network.states]
    path = replace(network.path, coefficients=scale * network.path.coefficients)
    return replace(network, states=states, path=path)


def _minimised(network: Network, free: IntArray) -> tuple[Network, Array, Solved]:
    """Take damped steps while they lower the cost, at given deviations and smoothness."""
    normal, cost = _normal(network)
    damping, least_damping = 0.0, 1e-4
    are_free = any(np.isin(offset + layout.FOCAL.start, free) for offset in border_offsets(network))
    for _ in range(network.rules.steps):
        for _ in range(6):
            solved = solve(normal, free, damping)
            steps = np.split(solved.border, border_offsets(network)[1:-1])
            moved = [state.moved(step) for state, step in zip(network.states, steps, strict=True)]
            path = replace(network.path, coefficients=network.path.coefficients + solved.path)
            tried = replace(network, states=moved, path=path)
            tried = _rescaled(tried) if are_free else tried
            other, tried_cost = _normal(tried)
            if np.any(tried_cost <= cost + 1e-9 * cost[0]):
                break
            damping = max(10.0 * damping, least_damping)
        else:
            return network, cost, solved
        gained = np.max(cost - tried_cost)
        network, normal, cost = tried, other, tried_cost
        damping *= 0.1 if damping > least_damping else 0.0
        if gained < 0.1 * network.rules.settled * cost[0]:
            break
    return network, cost, solved


def cost_of(network: Network) -> float:
    """Return the cost of a network's sightings, priors and smoothness."""
    return float(_normal(network)[1][0])


def _normal(network: Network) -> tuple[Normal, Array]:
    """Give the normal equations, and the cost without and with the pull of the path's volume.

    It is Cauchy's loss, and the priors' squares.
    """
    coefficients, offsets = network.path.coefficients, border_offsets(network)
    normal, cost = Normal(len(coefficients), int(offsets[-1])), 0.0
    for k, seen in enumerate(network.cameras):
        fit, share = fit_of(network, k), seen.shares * network.sigmas_px[k]
        over = fit.linear.residuals / share[:, None]
        squares = np.sum(over**2, axis=1) / CAUCHY**2
        lost = np.where(fit.used, 0.5 * CAUCHY**2 * np.log1p(squares), 0.0)
        # A point that is not in front of the camera costs as one far off its place.
        behind = network.enabled[k] & ~fit.in_front
        cost += float(np.sum(lost) + 40.0 * np.count_nonzero(behind))
        rows = np.flatnonzero(fit.used)
        scale = 1.0 / (share[rows] * np.sqrt(1.0 + squares[rows]))
        normal.add(fit.linear.weighed(rows, scale, int(offsets[k])))
    first, weights = jerks(network.path.knots_s)
    values = normal.add_smoothness(first, weights / network.jerk, coefficients)
    cost += 0.5 * float(np.sum(values**2))
    prior_rows, residuals = known(network)
    normal.add_rows(prior_rows, residuals)
    cost += 0.5 * float(np.sum(residuals**2))
    # A jerk that is estimated from the path pulls the path's size to 0, by its degrees of freedom.
    # With the path integrated out, its volume would pull the cameras the other way, to first order.
    centred, square = _about_its_mean(coefficients)
    normal.pull += network.freedom / square * centred.ravel()
    pulled = 0.5 * network.freedom * float(np.log(square / network.square))
    return normal, np.array([cost, cost - pulled])


def _about_its_mean(coefficients: Array) -> tuple[Array, float]:
    centred = coefficients - coefficients.mean(axis=0)
    return centred, float(np.sum(centred**2))


def _weighed(network: Network, solved: Solved) -> Network:
    """Estimate deviations and smoothness from residuals, corrected for the path's leverage."""
    sigmas, repeats, rules = network.sigmas_px.copy(), list[float](), network.rules
    for k, seen in enumerate(network.cameras):
        fit = fit_of(network, k)
        linear, rows = fit.linear, np.flatnonzero(fit.used)
        if len(rows) < 10:
            continue
        share = seen.shares[rows]
        over = linear.residuals[rows] / share[:, None]
        count = repeats_of if seen.spreads_px2 is None else repeats_in_blocks
        repeats.append(count(seen.times_s[rows], over, rules))
        covariances = solved.path_covariances(linear.first[rows], linear.weights[rows], False)
        by_point = linear.by_point[rows]
        lever = np.einsum("nix,nxy,niy->n", by_point, covariances, by_point)
        lever = lever / (share * network.sigmas_px[k]) ** 2
        left = max(0.1, 1.0 - 0.5 * float(np.median(lever)))
        sigmas[k] = robust_deviation(over) / np.sqrt(left)
    sigmas = _alike(sigmas, network.cameras)
    least = max(rules.least_sigma_share * float(np.median(sigmas)), rules.least_sigma_px)
    first, weights = jerks(network.path.knots_s)
    values = products(first, weights, network.path.coefficients)
    unsure = solved.path_covariances(first, weights, False)
    trace = np.trace(unsure, axis1=1, axis2=2)
    freedom = max(3.0 * len(first) - float(np.sum(trace)) / network.jerk**2, 1.0)
    jerk = float(np.sqrt(np.sum(values**2) / freedom))
    mean = float(np.mean(repeats)) if repeats else 1.0
    return replace(
        network,
        sigmas_px=np.maximum(sigmas, least),
        jerk=max(jerk, 1e-12),
        repeats=mean,
        lasting=1.0 + (mean - 1.0) * _taken_up(network),
        freedom=freedom,
        square=_about_its_mean(network.path.coefficients)[1],
    )


def _alike(sigmas_px: Array, cameras: list[Sightings]) -> Array:
    """Give event cameras the deviations of their own tracks, times one common factor."""
    # With one each, the two cameras whose errors the path absorbs best would seem to have none.
    of_events = np.flatnonzero([not seen.has_frames for seen in cameras])
    if not len(of_events):
        return sigmas_px
    own_px = np.array([float(np.median(seen.sigmas_px)) for seen in cameras])
    factors = sigmas_px[of_events] / own_px[of_events]
    found = sigmas_px.copy()
    found[of_events] = np.sqrt(np.mean(factors**2)) * own_px[of_events]
    return found


def _taken_up(network: Network) -> float:
    """Return the variance of slow errors relative to that which the residuals show."""
    # Each camera that sees the object adds two directions of errors: the path absorbs three in all.
    # Errors of silhouettes are horizontal, one direction for each camera: the path absorbs two.
    cameras, steps_s = network.cameras, np.diff(network.path.knots_s)
    covered_s = float(np.sum(steps_s[steps_s <= network.rules.max_knot_gap_s]))
    seen_s = sum(
        seen.interval_s * float(np.count_nonzero(mask))
        for seen, mask in zip(cameras, network.enabled, strict=True)
    )
    views = seen_s / max(covered_s, seen_s / len(cameras))
    if all(seen.spreads_px2 is not None for seen in cameras):
        views = max(views, 2.5)
        return views / (views - 2.0)
    directions = max(2.0 * views, 4.0)
    return directions / (directions - 3.0)


def repeats_of(times_s: Array, residuals: Array, rules: NetworkRules) -> float:
    """Count the sightings (n, 2) worth one independent one: 1 + 2 sum of autocorrelations."""
    limit = 3.0 * robust_deviation(residuals) + 1e-12
    clipped = np.clip(residuals, -limit, limit)
    variance = float(np.mean(clipped**2)) or 1.0  # of residuals that are all 0
    interval_s = float(np.median(np.diff(times_s)))
    total = 1.0
    for lag in range(1, min(rules.most_lags, len(times_s) // 4)):
        together = times_s[lag:] - times_s[:-lag] < 1.5 * lag * interval_s
        if np.count_nonzero(together) < len(times_s) // 4:
            break
        products = np.mean(clipped[lag:] * clipped[:-lag], axis=1)[together]
        correlation = float(np.mean(products)) / variance
        if correlation < rules.least_correlation:
            break
        total += 2.0 * correlation
    return total


def repeats_in_blocks(times_s: Array, residuals: Array, rules: NetworkRules) -> float:
    """Return `repeats_of` by sums of blocks, as silhouettes' lasting errors are small."""
    deviation = robust_deviation(residuals) + 1e-12
    clipped = np.clip(residuals / deviation, -3.0, 3.0)
    blocks = np.floor((times_s - times_s[0]) / rules.block_s).astype(np.int64)
    sums = np.stack([np.bincount(blocks, axis) for axis in clipped.T])
    return max(float(np.sum(sums**2)) / clipped.size, 1.0)
