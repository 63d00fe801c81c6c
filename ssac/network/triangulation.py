"""Cameras with clocks and poses in; where they see the object together, and a first path, out."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ssac.network.normal import Linear, Normal, solve
from ssac.network.sightings import Sightings
from ssac.network.spline import Spline, basis, jerks
from ssac.network.state import CameraState

Array = NDArray[np.float64]

LEAST_ANGLE_DEG = 4.0
"""Between two rays, where they tell a depth."""

MAX_OFF = 0.03
"""Distance from a ray, as a share of the depth, of a point that its camera sees."""

_FIRST_JERK = 3.0  # of a first path, in extents / s^2.5
_ROBUST_ROUNDS = 5


def triangulate(states: list[CameraState], cameras: list[Sightings], times_s: Array) -> Array:
    """Give the points (n, 3) that at least two cameras see at the network's times (n,); else NaN.

    The point nearest to all rays; it must be in front of two cameras at least, near their rays,
    and these apart. A ray that is far off is left out once.
    """
    rays = np.stack(
        [
            seen.rays_at(state.own_from_network(times_s)) @ state.R
            for state, seen in zip(states, cameras, strict=True)
        ]
    )
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    centres = np.stack([state.centre for state in states])[:, None, :]
    seen_by = np.asarray(np.isfinite(rays).all(axis=2))
    filled = np.where(seen_by[:, :, None], rays, 0.0)
    across = np.eye(3) - filled[..., :, None] * filled[..., None, :]
    points = np.full((len(times_s), 3), np.nan)
    for _ in range(2):
        is_enough = (np.count_nonzero(seen_by, axis=0) >= 2) & _are_apart(filled, seen_by)
        matrices = np.sum(np.where(seen_by[..., None, None], across, 0.0), axis=0)
        rights = np.einsum("cnxy,cny->nx", np.where(seen_by[..., None, None], across, 0.0),
                           np.broadcast_to(centres, rays.shape))  # fmt: skip
        points = np.full((len(times_s), 3), np.nan)
        if is_enough.any():
            solved = np.linalg.solve(matrices[is_enough], rights[is_enough][:, :, None])
            points[is_enough] = solved[:, :, 0]
        to_points = points - centres
        depths = np.sum(to_points * filled, axis=2)
        off = np.linalg.norm(np.cross(to_points, filled), axis=2)
        with np.errstate(invalid="ignore"):
            fits = seen_by & (depths > 0.0) & (off < MAX_OFF * depths)
        bad = is_enough & (np.count_nonzero(fits, axis=0) < 2)
        points[bad] = np.nan
        if (fits == seen_by).all():
            break
        seen_by = fits
    return points


def _are_apart(rays: Array, seen_by: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether any two of the rays (c, n, 3) at each time are apart (n,)."""
    found = np.zeros(rays.shape[1], dtype=bool)
    least = np.sin(np.deg2rad(LEAST_ANGLE_DEG))
    for i in range(len(rays)):
        for j in range(i):
            sines = np.linalg.norm(np.cross(rays[i], rays[j]), axis=1)
            found |= seen_by[i] & seen_by[j] & (sines > least)
    return found


def first_path(knots_s: Array, times_s: Array, points: Array) -> tuple[Spline, float]:
    """Lay a smooth path through points (n, 3) at times (n,), robustly.

    Returns
    -------
    tuple
        The path, and its jerk to begin with.
    """
    middle = np.median(points, axis=0)
    extent = float(np.median(np.linalg.norm(points - middle, axis=1))) + 1e-12
    first, weights = basis(knots_s, times_s)
    span_first, span_weights = jerks(knots_s)
    span_weights = span_weights / (_FIRST_JERK * extent)
    path = Spline(knots_s, np.tile(middle, (len(knots_s) - 4, 1)))
    sigma = np.full(len(points), 0.01 * extent)
    n = len(points)
    for _ in range(_ROBUST_ROUNDS):
        residuals = points - path.at(times_s)
        normal = Normal(len(path.coefficients), 0)
        for axis in range(3):
            by_point = np.zeros((n, 2, 3))
            by_point[:, 0, axis] = 1.0 / sigma
            over = np.zeros((n, 2))
            over[:, 0] = residuals[:, axis] / sigma
            normal.add(_of_points(first, weights, by_point, over))
        normal.add_smoothness(span_first, span_weights, path.coefficients)
        normal.band[0] += 1e-9 * normal.band[0].max()
        step = solve(normal, np.empty(0, np.int64)).path
        path = replace(path, coefficients=path.coefficients + step)
        off = np.linalg.norm(points - path.at(times_s), axis=1)
        typical = float(np.median(off)) + 1e-4 * extent
        sigma = typical * np.sqrt(1.0 + (off / (2.0 * typical)) ** 2)
    return path, extent


def _of_points(first: NDArray[np.int64], weights: Array, by_point: Array, over: Array) -> Linear:
    """Rows of a path alone."""
    none = np.zeros((len(first), 2, 0))
    return Linear(first, weights, by_point, none, np.zeros((len(first), 0), np.int64), over)
