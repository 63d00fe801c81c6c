"""Images of one rigid body in several cameras in; where its one point is in each of them, out.

The centre of an image's area is that of no point of the body: parts hide others, and what is nearer
looks larger, each as the body turns. So its shape and its attitudes are told from all of the images
together: voxels that are drawn as these are, and the turns by which they are (the same body seen
from ever other sides, as of Cheung, Baker and Kanade, CVPR 2003). Drawings are then moved until
they are as the images, and by so much is the body's origin off where it was thought to be.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, Slerp

from ssac.track.body_kernels import Images, aligned, improved, registered, seen_shares

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WEIGHT = 4.0
"""How the area of a part of the image goes with its depth, as a power, and one more for its place:
3 for a ball and its like, 4 for a flat thing, as most drones are."""

LEAST_VIEWS = 3
"""Cameras that tell all second moments: two have one of theirs in common."""

_RIDGE = 1e-9  # of the normal matrix: views from nearly one direction leave depth open
_OUT_OF_SIGHT = 3.0  # deviations of the smoothing, from the next time that told the shape


@dataclass(frozen=True, eq=False)
class View:
    """One camera's, at n times."""

    R: Array  # (3, 3) x = R X + t
    focal_px: Array  # (2,)
    points: Array  # (n, 3) of the object, in the camera's frame
    spreads_px2: Array  # (n, 3) second moments xx, xy and yy of its image; NaN: not known

    def by_point(self) -> Array:
        """Give the derivatives (n, 2, 3) of the image by the object's place, X."""
        depths = self.points[:, 2]
        by_local = np.zeros((len(depths), 2, 3))
        for axis in (0, 1):
            by_local[:, axis, axis] = self.focal_px[axis] / depths
            by_local[:, axis, 2] = -self.focal_px[axis] * self.points[:, axis] / depths**2
        return np.asarray(by_local @ self.R)


def second_moments(views: list[View], smoothing: float) -> Array:
    """Find the object's second moments (n, 3, 3) in X at n even times, smoothed over some of them.

    NaN where too few views tell them.
    """
    n = len(views[0].points)
    normal, right = np.zeros((n, 6, 6)), np.zeros((n, 6))
    counts = np.zeros(n)
    for view in views:
        seen = np.isfinite(view.spreads_px2).all(axis=1) & (view.points[:, 2] > 0.0)
        counts += seen
        J = np.where(seen[:, None, None], view.by_point(), 0.0)
        spreads = np.where(seen[:, None], view.spreads_px2, 0.0)
        for spread, (i, j) in zip(spreads.T, ((0, 0), (0, 1), (1, 1)), strict=True):
            a, b = J[:, i], J[:, j]
            mixed = [a[:, p] * b[:, q] + a[:, q] * b[:, p] for p, q in ((0, 1), (0, 2), (1, 2))]
            row = np.column_stack([a * b, *mixed])
            normal += row[:, :, None] * row[:, None, :]
            right += row * spread[:, None]
    told = counts >= LEAST_VIEWS
    scales = np.trace(normal, axis1=1, axis2=2) + 1e-300
    normal += (_RIDGE * scales + np.where(told, 0.0, 1.0))[:, None, None] * np.eye(6)
    found = np.linalg.solve(normal, right[..., None])[..., 0] * told[:, None]
    weights = gaussian_filter1d(told.astype(np.float64), smoothing, truncate=_OUT_OF_SIGHT)
    smooth = gaussian_filter1d(found, smoothing, axis=0, truncate=_OUT_OF_SIGHT)
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = np.where(weights[:, None] > 1e-6, smooth / weights[:, None], np.nan)
    places = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]
    return np.asarray(smooth[:, places])


def perspective_shifts(view: View, moments: Array) -> Array:
    """Give the centre of the image's area less the image of the object's centre (n, 2) [px].

    Parameters
    ----------
    view
        Of n times.
    moments
        Shape (n, 3, 3), in X. Shifts are NaN where these are.
    """
    local = view.R @ moments @ view.R.T
    depths = view.points[:, 2:]
    towards = local[:, :2, 2] - view.points[:, :2] / depths * local[:, 2, 2][:, None]
    return np.asarray(-WEIGHT * view.focal_px * towards / depths**2)


Indices = NDArray[np.int64]
Drawn = tuple[Images, Array, Array, Array, Array]
"""Images, corners, points, turns or views, and focal lengths, as kernels take them."""

STEP_S = 0.1
"""Between the instants at which attitudes are told: in between they are interpolated."""

MOST_LEFT = 0.15
"""Share of the images, as squares, that a rigid body may leave: others are not followed so."""

_LEAST_INSTANTS = 30
_MOST_INSTANTS = 100  # of those that tell the shape
_REACH, _THICKNESS = 2.1, 0.5  # of the voxels, in largest deviations of the shape
_VOXELS_ACROSS = 30.0  # from the middle to the reach
_COVERED = 0.2  # of an image at a voxel
_SHARES = (0.7, 0.7, 0.85)  # of the images in which a voxel is covered, in rounds to begin with
_ROUNDS, _STEPS, _LAST_STEPS = 4, 6, 15
_LEAST_DEPTH = 0.02  # of a voxel: those below are nothing
_OUTLIER = 2.5  # of the median of what is left
_BETTER = 0.95  # of what is left with another attitude
_LONGEST_GAP_S = 0.35  # between instants of known attitudes
_ALIGNMENTS = 2


@dataclass(frozen=True, eq=False)
class Look:
    """What one camera saw of the body, at n times."""

    times_s: Array  # (n,) ascending, of all cameras' common clock
    R: Array  # (3, 3) x = R X + t
    focal_px: Array  # (2,)
    points: Array  # (n, 3) where the body is thought to be, in the camera's frame
    shares: NDArray[np.float32]  # (n, w, w) of pixels that are covered
    corners_px: Array  # (n, 2) of the first pixel of each, from the principal point; NaN: no image


@dataclass(frozen=True, eq=False)
class _Instants:
    """Images of c cameras at n instants; where one has none, it has all of nothing."""

    times_s: Array  # (n,)
    shares: NDArray[np.float32]  # (n, c, w, w)
    corners_px: Array  # (n, c, 2)
    points: Array  # (n, c, 3)
    seen: Mask  # (n, c)
    views: Array  # (c, 3, 3)
    focals_px: Array  # (c, 2)

    def at(self, i: int) -> Drawn:
        """Give what `registered` takes of one instant."""
        k = self.seen[i]
        found = self.shares[i, k], self.corners_px[i, k], self.points[i, k], self.views[k]
        return *found, self.focals_px[k]

    def flat(self, chosen: Indices, attitudes: Array) -> Drawn:
        """Give what `improved` takes of some instants."""
        i, k = np.nonzero(self.seen[chosen])
        i = chosen[i]
        turns = self.views[k] @ attitudes[i]
        found = self.shares[i, k], self.corners_px[i, k], self.points[i, k]
        return *found, turns, self.focals_px[k]


@dataclass(frozen=True, eq=False)
class _Body:
    """Voxels (m, 3) of a width, in the body's frame, and their optical depths (m,)."""

    voxels: Array
    densities: Array
    step: float


def body_moves(looks: list[Look], shape_s: Array, moments: Array) -> list[Array] | None:
    """Find the body's origin in images.

    Parameters
    ----------
    looks
        Of all cameras.
    shape_s, moments
        Shapes (m,) and (m, 3, 3): the body's second moments at even times, as of
        `ssac.track.body.second_moments`.

    Returns
    -------
    list of Array or None
        For each camera (n, 2) [px]: where the origin is less where it was thought to be; NaN where
        that is not known. None where the images are not those of a rigid body, or too few.
    """
    instants, attitudes, size = _instants(looks, shape_s, moments)
    if len(attitudes) < _LEAST_INSTANTS:
        return None
    body = _Body(np.empty((0, 3)), np.empty(0), size * _REACH / _VOXELS_ACROSS)
    chosen: Indices = np.arange(len(attitudes), dtype=np.int64)
    costs: Array = np.empty(0)
    for k in range(_ROUNDS):
        few = chosen[:: 1 + len(chosen) // _MOST_INSTANTS]
        flat = instants.flat(few, attitudes)
        if k < len(_SHARES):
            body = _carved(body.step, size, flat, _SHARES[k])
        for _ in range(_STEPS if k < _ROUNDS - 1 else _LAST_STEPS):
            densities = improved(body.voxels, body.densities, body.step, *flat)
            kept = densities > _LEAST_DEPTH
            body = replace(body, voxels=body.voxels[kept], densities=densities[kept])
        attitudes, costs = _registered(body, instants, attitudes)
        if k < len(_SHARES):
            attitudes, costs = _taken_over(body, instants, attitudes, costs)
        chosen = np.flatnonzero(costs <= _OUTLIER * np.median(costs)).astype(np.int64)
    if np.median(costs) > MOST_LEFT or len(chosen) < _LEAST_INSTANTS:
        return None
    return [_moves(body, look, instants.times_s[chosen], attitudes[chosen]) for look in looks]


def _instants(looks: list[Look], shape_s: Array, moments: Array) -> tuple[_Instants, Array, float]:
    """Gather what is seen at even instants; give attitudes to begin with, and the body's size.

    Its axes are those of the second moments: which of two is the longer, and which way each points,
    is told later, by its neighbours.
    """
    step = max(1, round(STEP_S / float(np.median(np.diff(shape_s)))))
    times_s, moments = shape_s[::step], moments[::step]
    width = max(look.shares.shape[1] for look in looks)
    n, c = len(times_s), len(looks)
    shares = np.zeros((n, c, width, width), np.float32)
    corners, points = np.zeros((n, c, 2)), np.ones((n, c, 3))
    seen = np.zeros((n, c), np.bool_)
    for k, look in enumerate(looks):
        after = np.clip(np.searchsorted(look.times_s, times_s), 1, len(look.times_s) - 1)
        later = look.times_s[after] - times_s < times_s - look.times_s[after - 1]
        at = np.where(later, after, after - 1)
        seen[:, k] = np.abs(look.times_s[at] - times_s) < 0.25 * STEP_S
        seen[:, k] &= np.isfinite(look.corners_px[at, 0]) & (look.points[at, 2] > 0.0)
        own = seen[:, k]
        w = look.shares.shape[1]
        shares[own, k, :w, :w] = look.shares[at[own]]
        corners[own, k], points[own, k] = look.corners_px[at[own]], look.points[at[own]]
    good = (seen.sum(axis=1) >= LEAST_VIEWS) & np.isfinite(moments[:, 0, 0])
    views = np.array([look.R for look in looks])
    focals = np.array([look.focal_px for look in looks])
    kept = shares[good], corners[good], points[good], seen[good]
    values, axes = np.linalg.eigh(moments[good])
    axes = axes[:, :, ::-1].copy()
    for i in range(len(axes)):
        if i:
            axes[i] *= np.where(np.sum(axes[i] * axes[i - 1], axis=0) < 0.0, -1.0, 1.0)
        axes[i, :, 1] = np.cross(axes[i, :, 2], axes[i, :, 0])
    size = float(np.sqrt(np.median(values[:, 2]))) if len(values) else 0.0
    return _Instants(times_s[good], *kept, views, focals), axes, size


def _carved(step: float, size: float, flat: Drawn, share: float) -> _Body:
    """Leave the voxels that so many of the images cover."""
    along = np.arange(-_REACH * size, _REACH * size + step, step)
    up = along[np.abs(along) <= _THICKNESS * size]
    grid = np.stack(np.meshgrid(along, along, up, indexing="ij"), axis=-1).reshape(-1, 3)
    voxels = grid[seen_shares(grid, _COVERED, *flat) >= share]
    return _Body(voxels, np.full(len(voxels), 0.5), step)


def _registered(body: _Body, instants: _Instants, attitudes: Array) -> tuple[Array, Array]:
    """Turn the body at each instant; give attitudes, and what is left of the images."""
    found, costs = attitudes.copy(), np.zeros(len(attitudes))
    for i, attitude in enumerate(attitudes):
        found[i], costs[i] = _turned(body, instants, i, attitude)
    return found, costs


def _taken_over(
    body: _Body, instants: _Instants, attitudes: Array, costs: Array
) -> tuple[Array, Array]:
    """Try at each instant what its neighbours are, which may be where it has not come to."""
    attitudes, costs = attitudes.copy(), costs.copy()
    n = len(attitudes)
    for order, off in ((range(1, n), -1), (range(n - 2, -1, -1), 1)):
        for i in order:
            if costs[i] > costs[i + off]:
                attitude, cost = _turned(body, instants, i, attitudes[i + off])
                if cost < _BETTER * costs[i]:
                    attitudes[i], costs[i] = attitude, cost
    return attitudes, costs


def _turned(body: _Body, instants: _Instants, i: int, attitude: Array) -> tuple[Array, float]:
    shares, corners, points, views, focals = instants.at(i)
    shape = body.voxels, body.densities, body.step
    attitude, _, cost = registered(
        *shape, shares, corners, points, views, focals, attitude, True, _ALIGNMENTS
    )
    return attitude, float(cost)


def _moves(body: _Body, look: Look, times_s: Array, attitudes: Array) -> Array:
    """Move the body's drawings at all times of a camera; give by how much (n, 2)."""
    inside = (look.times_s >= times_s[0]) & (look.times_s <= times_s[-1])
    inside &= np.isfinite(look.corners_px[:, 0]) & (look.points[:, 2] > 0.0)
    after = np.clip(np.searchsorted(times_s, look.times_s), 1, len(times_s) - 1)
    inside &= times_s[after] - times_s[after - 1] <= _LONGEST_GAP_S
    moves = np.full((len(look.times_s), 2), np.nan)
    own = np.flatnonzero(inside)
    if not len(own):
        return moves
    axes = Slerp(times_s, Rotation.from_matrix(attitudes))(look.times_s[own]).as_matrix()
    shape = body.voxels, body.densities, body.step
    focals = np.tile(look.focal_px, (len(own), 1))
    points, turns = look.points[own], np.ascontiguousarray(look.R @ axes)
    found, costs = aligned(
        *shape, look.shares[own], look.corners_px[own], points, turns, focals, _ALIGNMENTS
    )
    good = costs <= 2.0 * _OUTLIER * np.median(costs)
    moves[own[good]] = found[good]
    return moves
