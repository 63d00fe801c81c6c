"""Estimate an object's second moments from those of its images in several cameras.

The centre of an image's area is not the image of a fixed point: nearer parts look larger.
Perspective alone shifts it by several millimetres for a body of half a metre at 5 m. To first order
the body's second moments give the shift, and those of its images give the body's.
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy.ndimage import gaussian_filter1d

from ssac.arrays import Array, IntArray
from ssac.rules import BodyRules

LEAST_VIEWS = 3
"""Fewest cameras that determine all six second moments: two measure one in common."""


@dataclass(frozen=True, eq=False)
class View:
    """One camera's view of the object at n times."""

    R: Array  # (3, 3) x = R X + t
    focal_px: Array  # (2,)
    points: Array  # (n, 3) of the object, in the camera's frame
    spreads_px2: Array  # (n, 3) second moments xx, xy and yy of its image; NaN: not known


def image_by_place(R: Array, focal_px: Array, points: Array) -> Array:
    """Return the Jacobian (n, 2, 3) of image points by positions X; the inputs are as in `View`."""
    depths = points[:, 2]
    by_local = np.zeros((len(depths), 2, 3))
    for axis in (0, 1):
        by_local[:, axis, axis] = focal_px[axis] / depths
        by_local[:, axis, 2] = -focal_px[axis] * points[:, axis] / depths**2
    return np.asarray(by_local @ R)


def nearest(at_s: Array, times_s: Array) -> tuple[IntArray, Array]:
    """Find those of n > 1 ascending times nearest to times (m,): indices and distances [s]."""
    after = np.clip(np.searchsorted(at_s, times_s), 1, len(at_s) - 1)
    places = np.where(at_s[after] - times_s < times_s - at_s[after - 1], after, after - 1)
    return places, np.abs(at_s[places] - times_s)


def spreads_near(spreads_px2: Array, at_s: Array, times_s: Array, reach_s: float) -> Array:
    """Pick from second moments (n, 3) those nearest to times (m,); NaN where none is in reach."""
    places, apart_s = nearest(at_s, times_s)
    return np.where((apart_s < reach_s)[:, None], spreads_px2[places], np.nan)


def second_moments(views: list[View], smoothing: float, least_views: int = LEAST_VIEWS) -> Array:
    """Estimate the object's second moments (n, 3, 3) in X at n even times, smoothed over time.

    NaN where too few views see it. The one combination that two views leave open is arbitrary.
    """
    n = len(views[0].points)
    normal, right = np.zeros((n, 6, 6)), np.zeros((n, 6))
    counts = np.zeros(n)
    for view in views:
        seen = np.isfinite(view.spreads_px2).all(axis=1) & (view.points[:, 2] > 0.0)
        counts += seen
        by_place = image_by_place(view.R, view.focal_px, view.points)
        J = np.where(seen[:, None, None], by_place, 0.0)
        spreads = np.where(seen[:, None], view.spreads_px2, 0.0)
        for spread, (i, j) in zip(spreads.T, ((0, 0), (0, 1), (1, 1)), strict=True):
            a, b = J[:, i], J[:, j]
            mixed = [a[:, p] * b[:, q] + a[:, q] * b[:, p] for p, q in ((0, 1), (0, 2), (1, 2))]
            row = np.column_stack([a * b, *mixed])
            normal += row[:, :, None] * row[:, None, :]
            right += row * spread[:, None]
    enough = counts >= least_views
    scales = np.trace(normal, axis1=1, axis2=2) + 1e-300
    # The ridge is for views from nearly one direction, which leave depth open. Two views always
    # leave one combination open, which rounding errors would otherwise make large.
    ridge = 1e-9 if least_views >= LEAST_VIEWS else 1e-6
    normal += (ridge * scales + np.where(enough, 0.0, 1.0))[:, None, None] * np.eye(6)
    found = np.linalg.solve(normal, right[..., None])[..., 0] * enough[:, None]
    weights = gaussian_filter1d(enough.astype(np.float64), smoothing, truncate=3.0)
    smooth = gaussian_filter1d(found, smoothing, axis=0, truncate=3.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = np.where(weights[:, None] > 1e-6, smooth / weights[:, None], np.nan)
    places = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]
    return np.asarray(smooth[:, places])


def perspective_shifts(view: View, moments: Array, depth_power: float) -> Array:
    """Return the centre of the image's area minus the image of the object's centre (n, 2) [px].

    The moments (n, 3, 3) are in X; a shift is NaN where its moments are.
    """
    local = view.R @ moments @ view.R.T
    depths = view.points[:, 2:]
    towards = local[:, :2, 2] - view.points[:, :2] / depths * local[:, 2, 2][:, None]
    return np.asarray(-depth_power * view.focal_px * towards / depths**2)


def moments_of_two(views: list[View], smoothing: float, step: int, rules: BodyRules) -> Array:
    """Find the second moments (n, 3, 3) of a rigid body in X from two views, as `second_moments`.

    Two views leave the multiple of r1 r2' + r2 r1' open, with unit rays r1, r2. It is chosen at
    every `step`-th time such that the body's three deviations stay the same and it turns smoothly.
    """
    told = second_moments(views, smoothing, least_views=2)
    seen = [np.isfinite(view.spreads_px2).all(axis=1) for view in views]
    places = np.flatnonzero(seen[0] & seen[1])[::step]
    if len(places) < rules.least_instants:
        return np.full_like(told, np.nan)
    first, second = (
        view.points / np.linalg.norm(view.points, axis=1)[:, None] @ view.R for view in views
    )
    both = first[:, :, None] * second[:, None, :]
    both += both.transpose(0, 2, 1)
    basis = np.linalg.inv(np.stack([first, second, np.cross(first, second)], axis=2)[places])
    # In units of the size, and rounded: else the last digits, other ones on each processor, decide.
    size = float(np.sqrt(np.median(np.trace(told[places], axis1=1, axis2=2))))
    told = np.round(told / size**2, 4)
    within = basis @ told[places] @ basis.transpose(0, 2, 1)
    # Bounds where the least variance is zero, by the Schur complement of the normal's variance c.
    a, b, c = (np.maximum(within[:, k, k], rules.open_least**2) for k in range(3))
    p, q = (np.clip(within[:, k, 2], -np.sqrt(d * c), np.sqrt(d * c)) for k, d in ((0, a), (1, b)))
    half = np.sqrt(np.maximum(a - p**2 / c, 0.0) * np.maximum(b - q**2 / c, 0.0))
    lanes = np.linspace(-1.0, 1.0, rules.open_values)
    amounts = np.round((p * q / c - within[:, 0, 1])[:, None] + half[:, None] * lanes, 4)
    tried = np.round(told[places, None] + amounts[..., None, None] * both[places, None], 6)
    deviations = np.round(np.sqrt(np.maximum(np.linalg.eigvalsh(tried), 0.0)), 6)
    flat = tried.reshape(*amounts.shape, 9)[..., [0, 1, 2, 4, 5, 8]]
    least = np.inf
    chosen: IntArray = np.zeros(len(places), np.int64)
    for start in rules.open_starts:
        shape = np.array(start)
        for _ in range(rules.open_rounds):
            found, cost = _smoothest(flat, deviations, shape, rules.open_change)
            before = shape
            shape = np.median(deviations[np.arange(len(places)), found], axis=0)
            if np.max(np.abs(shape - before)) < rules.open_settled:
                break
        if cost < least:
            least, chosen = cost, found
    amount = np.interp(np.arange(len(told)), places, amounts[np.arange(len(places)), chosen])
    amount = gaussian_filter1d(amount, 0.5 * step)
    return np.asarray(size**2 * (told + amount[:, None, None] * both))


@numba.njit(cache=True)
def _smoothest(
    tensors: Array, deviations: Array, shape: Array, weight: float
) -> tuple[IntArray, float]:
    """Choose one of k tensors (m, k, 6) at each of m times by dynamic programming; mean cost."""
    # Squared differences count: of deviations (m, k, 3) from the shape (3,), of tensors in time.
    m, k = deviations.shape[:2]
    back = np.zeros((m, k), np.int64)
    costs, before = np.zeros(k), np.zeros(k)
    for i in range(m):
        before[:] = costs
        for b in range(k):
            best = 0.0
            if i:
                best = np.inf
                for a in range(k):
                    total = before[a]
                    for j, times in enumerate((1.0, 2.0, 2.0, 1.0, 2.0, 1.0)):
                        total += weight * times * (tensors[i, b, j] - tensors[i - 1, a, j]) ** 2
                    if total < best:
                        best, back[i, b] = total, a
            for j in range(3):
                best += (deviations[i, b, j] - shape[j]) ** 2
            costs[b] = best
    chosen = np.zeros(m, np.int64)
    chosen[m - 1] = np.argmin(costs)
    for i in range(m - 1, 0, -1):
        chosen[i - 1] = back[i, chosen[i]]
    return chosen, float(np.min(costs)) / m
