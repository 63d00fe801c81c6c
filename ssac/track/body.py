"""Follow one point of a rigid body in the images of several cameras, in place of image centres.

The centre of an image's area is not the image of a fixed point of the body: parts hide others, and
nearer parts look larger, as the body turns (`ssac.track.moments` corrects for perspective alone).
All images together determine the body's shape, as voxels whose drawings fit the images, and its
attitudes (the same body seen from ever other sides, as in Cheung, Baker and Kanade, CVPR 2003).
Each drawing is then moved to fit its image, and the move is the error of the assumed position of
the body's origin. A voxel darkens the pixels that it covers: optical depths are summed on pixels of
half the size, and covered shares are means over these.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from ssac.arrays import Array, Float32Array, Int32Array, IntArray, Mask
from ssac.rules import BodyRules
from ssac.track.moments import LEAST_VIEWS, nearest

Voxels = tuple[Array, Array, float]
"""Voxels (3, m) in the body's frame, their optical depths (m,) and their width."""

Drawn = tuple[Float32Array, Array, Array, Array, Array]
"""Data of n images: the covered share of each pixel (n, w, w), the first pixels' positions from the
principal points (n, 2) [px], the body's origin in the cameras' frames (n, 3), rotations from the
body's frame to the cameras' (n, 3, 3), and focal lengths (n, 2) [px]."""


class Seen(NamedTuple):
    """Images of c cameras at n instants; where `is_seen` is false, the other values are unused."""

    shares: Float32Array  # (n, c, w, w) covered share of each pixel
    corners_px: Array  # (n, c, 2) of the first pixels, from the principal points
    points: Array  # (n, c, 3) the body's origin in the cameras' frames
    is_seen: Mask  # (n, c)
    views: Array  # (c, 3, 3) rotations from X to the cameras' frames
    focals_px: Array  # (c, 2)

    def of(self, chosen: IntArray) -> "Seen":
        """Return only the chosen instants."""
        return self._replace(
            shares=self.shares[chosen],
            corners_px=self.corners_px[chosen],
            points=self.points[chosen],
            is_seen=self.is_seen[chosen],
        )

    def drawn(self, chosen: IntArray, attitudes: Array) -> Drawn:
        """Return all images of the chosen instants, for a body with attitudes (n, 3, 3)."""
        i, k = np.nonzero(self.is_seen[chosen])
        i = chosen[i]
        turns = self.views[k] @ attitudes[i]
        found = self.shares[i, k], self.corners_px[i, k], self.points[i, k]
        return *found, turns, self.focals_px[k]


View = tuple[Array, Array, Array, Array]
"""One image's rotation, body's origin, focal lengths and first pixel, each as in `Drawn`."""

Work = tuple[Array, Array, Int32Array, Array, Array]
"""A drawing's optical depths (FINE w, FINE w), and their slopes (FINE w, FINE w, 5) by turns [rad]
about the body's axes and by moves [px], both zero between drawings; and of each voxel what `_place`
fills in, (2, m) and (6, m), and `_turn`, (3, 2, m), or (0, 2, m) where only moves are wanted."""

FINE = 2
"""Pixels of a drawing across one pixel of the image."""

_N_SLOPES = 5
_NONE = 1e-9
_LEAST_CURVATURE = 1e-6
_MOST_TURN_RAD, _MOST_MOVE_PX = 0.15, 1.0  # of one round


@dataclass(frozen=True, eq=False)
class Look:
    """What one camera saw of the body, at n times."""

    times_s: Array  # (n,) ascending, of all cameras' common clock
    R: Array  # (3, 3) x = R X + t
    focal_px: Array  # (2,)
    points: Array  # (n, 3) where the body is thought to be, in the camera's frame
    shares: Float32Array  # (n, w, w) covered share of each pixel
    corners_px: Array  # (n, 2) of the first pixel of each, from the principal point; NaN: no image

    def px_per_length(self) -> float:
        """Return the median scale of the images there are; 0 if there is none."""
        depths = self.points[np.isfinite(self.corners_px[:, 0]), 2]
        return float(np.median(self.focal_px[0] / depths)) if len(depths) else 0.0

    def coarser(self, factor: int) -> "Look":
        """Return the same view with pixels `factor` times as wide."""
        beyond = -self.shares.shape[1] % factor
        shares = np.pad(self.shares, ((0, 0), (0, beyond), (0, beyond)))
        n, width = len(shares), shares.shape[1] // factor
        shares = shares.reshape(n, width, factor, width, factor).mean(axis=(2, 4))
        corners = (self.corners_px + 0.5 * (factor - 1)) / factor
        return replace(self, focal_px=self.focal_px / factor, shares=shares, corners_px=corners)


def body_moves(
    looks: list[Look], shape_s: Array, moments: Array, rules: BodyRules
) -> list[Array] | None:
    """Find the body's origin in the images of all cameras.

    The body's second moments (m, 3, 3), at even times (m,), are as from `second_moments`. Returns
    for each camera the moves (n, 2) [px] from the assumed to the found images of the origin; NaN
    where these are not known. None where the images are not those of a rigid body, or too few.
    """
    is_told = np.isfinite(moments[:, 0, 0])
    if not is_told.any():
        return None
    size = float(np.sqrt(np.median(np.linalg.eigvalsh(moments[is_told])[:, 2])))
    factor = max(1, *(round(size * look.px_per_length() / rules.full_px) for look in looks))
    looks = [look.coarser(factor) for look in looks]
    times_s, seen, attitudes = _instants(looks, shape_s, moments, rules.step_s)
    if len(attitudes) < rules.least_instants:
        return None
    some = _learnt(len(attitudes), rules)
    body, good, found = _learned(seen.of(some), attitudes[some], size, rules)
    known_s = times_s[some[good]]
    between = Slerp(known_s, Rotation.from_matrix(found))
    attitudes = between(np.clip(times_s, known_s[0], known_s[-1])).as_matrix()
    every = np.arange(len(attitudes))
    attitudes, costs = registered(body, seen, every, attitudes, rules.last_alignments)
    _take_over(body, seen, attitudes, costs, rules)
    good = np.flatnonzero(costs <= rules.outlier * np.median(costs))
    if np.median(costs) > rules.max_left or len(good) < rules.least_instants:
        return None
    return [factor * _moves(body, look, times_s[good], attitudes[good], rules) for look in looks]


def _learnt(n: int, rules: BodyRules) -> IntArray:
    """Choose the instants to learn the shape from: of many fewer, of even more the middle ones."""
    step = rules.learnt_steps * (1 + (n > rules.learnt_steps * rules.most_learnt))
    chosen = np.arange(0, n, step)
    beyond = max(len(chosen) - rules.most_learnt, 0) // 2
    return np.asarray(chosen[beyond : len(chosen) - beyond], np.int64)


def _learned(
    seen: Seen, attitudes: Array, size: float, rules: BodyRules
) -> tuple[Voxels, IntArray, Array]:
    """Learn a body's shape; return it, the instants (k,) that it fits, and its attitudes there."""
    step = size * rules.reach_sizes / rules.voxels_across
    body: Voxels = np.empty((3, 0)), np.empty(0), step
    every: IntArray = np.arange(len(attitudes), dtype=np.int64)
    good = every
    left, is_last = np.inf, False
    for number in range(rules.max_rounds):
        is_last |= number == rules.max_rounds - 1
        flat = seen.drawn(good[:: 1 + len(good) // rules.most_fitted], attitudes)
        if number < len(rules.carved_shares) and not is_last:
            body = _carved(step, size, flat, rules.carved_shares[number], rules)
        for _ in range(rules.last_fit_steps if is_last else rules.fit_steps):
            densities = improved(body, flat)
            kept = densities > rules.least_depth
            body = body[0].compress(kept, axis=1), densities[kept], step
        attitudes, costs = registered(body, seen, every, attitudes, rules.alignments)
        if not is_last:
            ill = costs > (rules.ill * np.median(costs) if number else -np.inf)
            if number < rules.yaw_rounds:
                _yawed(body, seen, attitudes, costs, ill, rules)
            _take_over(body, seen, attitudes, costs, rules)
        before, left = left, float(np.median(costs))
        good = np.flatnonzero(costs <= rules.outlier * left).astype(np.int64)
        if is_last:
            break
        is_good = left < rules.good and np.mean(costs < 2.0 * left) > rules.good_share
        is_done = left < rules.fair and left > rules.settled * before
        is_last = number >= rules.least_rounds and bool(is_good or is_done)
    return body, good, attitudes[good]


def _instants(
    looks: list[Look], shape_s: Array, moments: Array, step_s: float
) -> tuple[Array, Seen, Array]:
    """Gather the images at even instants; the second moments' axes are the first attitudes."""
    step = max(1, round(step_s / float(np.median(np.diff(shape_s)))))
    times_s, moments = shape_s[::step], moments[::step]
    width = max(look.shares.shape[1] for look in looks)
    n, c = len(times_s), len(looks)
    shares = np.zeros((n, c, width, width), np.float32)
    corners, points = np.zeros((n, c, 2)), np.ones((n, c, 3))
    seen = np.zeros((n, c), np.bool_)
    for k, look in enumerate(looks):
        at, apart_s = nearest(look.times_s, times_s)
        seen[:, k] = (
            (apart_s < 0.25 * step_s)
            & np.isfinite(look.corners_px[at, 0])
            & (look.points[at, 2] > 0.0)
        )
        own, w = seen[:, k], look.shares.shape[1]
        shares[own, k, :w, :w] = look.shares[at[own]]
        corners[own, k], points[own, k] = look.corners_px[at[own]], look.points[at[own]]
    good = (seen.sum(axis=1) >= min(LEAST_VIEWS, c)) & np.isfinite(moments[:, 0, 0])
    views = np.array([look.R for look in looks])
    focals = np.array([look.focal_px for look in looks])
    axes = np.linalg.eigh(moments[good])[1][:, :, ::-1].copy()
    for i in range(len(axes)):
        if i:
            axes[i] *= np.where(np.sum(axes[i] * axes[i - 1], axis=0) < 0.0, -1.0, 1.0)
        axes[i, :, 1] = np.cross(axes[i, :, 2], axes[i, :, 0])
    all_seen = Seen(shares, corners, points, seen, views, focals)
    return times_s[good], all_seen.of(np.flatnonzero(good)), axes


def _carved(step: float, size: float, flat: Drawn, share: float, rules: BodyRules) -> Voxels:
    """Keep the voxels of a grid that at least this share of the images covers."""
    along = step * np.arange(-rules.voxels_across, rules.voxels_across + 1)
    up = along[np.abs(along) <= rules.thickness_sizes * size]
    grid = np.stack(np.meshgrid(along, along, up, indexing="ij")).reshape(3, -1)
    body = grid, np.full(grid.shape[1], 0.5), step
    kept = seen_shares(body, rules.covered_share, flat) >= share
    return grid.compress(kept, axis=1), body[1][kept], step


def _yawed(
    body: Voxels, seen: Seen, attitudes: Array, costs: Array, ill: Mask, rules: BodyRules
) -> None:
    """Try turns about the axis of least variance: second moments tell these least well."""
    places = np.flatnonzero(ill)
    yaws = Rotation.from_rotvec(np.outer(np.deg2rad(rules.yaws_deg), [0.0, 0.0, 1.0])).as_matrix()
    start = attitudes[places]
    for yaw in yaws:
        _try(body, seen, attitudes, costs, places, start @ yaw, rules)


def _take_over(body: Voxels, seen: Seen, attitudes: Array, costs: Array, rules: BodyRules) -> None:
    """Try at each instant the attitude of each neighbour that fits its images better, in place."""
    n = len(attitudes)
    for order, off in ((range(1, n), -1), (range(n - 2, -1, -1), 1)):
        for i in order:
            if costs[i] > costs[i + off]:
                start = attitudes[i + off : i + off + 1]
                _try(body, seen, attitudes, costs, np.array([i]), start, rules)


def _try(
    body: Voxels,
    seen: Seen,
    attitudes: Array,
    costs: Array,
    places: IntArray,
    start: Array,
    rules: BodyRules,
) -> None:
    """Register from other attitudes at some instants; keep, in place, those that fit better."""
    found, left = registered(body, seen, places, start, rules.alignments)
    better = left < rules.better * costs[places]
    attitudes[places[better]], costs[places[better]] = found[better], left[better]


def _moves(body: Voxels, look: Look, times_s: Array, attitudes: Array, rules: BodyRules) -> Array:
    """Fit the body's drawings to a camera's images at all times; return the moves (n, 2) [px]."""
    inside = (look.times_s >= times_s[0]) & (look.times_s <= times_s[-1])
    inside &= np.isfinite(look.corners_px[:, 0]) & (look.points[:, 2] > 0.0)
    after = np.clip(np.searchsorted(times_s, look.times_s), 1, len(times_s) - 1)
    inside &= times_s[after] - times_s[after - 1] <= rules.max_gap_s
    moves = np.full((len(look.times_s), 2), np.nan)
    own = np.flatnonzero(inside)
    if not len(own):
        return moves
    axes = Slerp(times_s, Rotation.from_matrix(attitudes))(look.times_s[own]).as_matrix()
    turns = np.ascontiguousarray(look.R @ axes)
    focals = np.tile(look.focal_px, (len(own), 1))
    drawn = look.shares[own], look.corners_px[own], look.points[own], turns, focals
    found, costs = aligned(body, drawn, rules.alignments)
    good = costs <= 2.0 * rules.outlier * np.median(costs)
    moves[own[good]] = found[good]
    return moves


@numba.njit(cache=True)
def seen_shares(body: Voxels, least: float, drawn: Drawn) -> Array:
    """Return the share (m,) of the images that are covered by `least` or more at each voxel."""
    images, corners, points, turns, focals = drawn
    n, width, m = len(images), images.shape[1], len(body[1])
    hits, (_, _, cells, places, _) = np.zeros(m), _work_for(0, m, 0)
    for i in range(n):
        _place(body, (turns[i], points[i], focals[i], corners[i]), 1, width, cells, places)
        for j in range(m):
            b, a, p, q = cells[0, j], cells[1, j], places[0, j], places[1, j]
            if b < 0:
                continue
            above = images[i, b, a] * (1.0 - p) + images[i, b, a + 1] * p
            below = images[i, b + 1, a] * (1.0 - p) + images[i, b + 1, a + 1] * p
            hits[j] += above * (1.0 - q) + below * q >= least
    return hits / max(n, 1)


@numba.njit(cache=True)
def improved(body: Voxels, drawn: Drawn) -> Array:
    """Fit the voxels' densities (m,) to images by one multiplicative step of least squares."""
    images, corners, points, turns, focals = drawn
    m, fine = len(body[1]), FINE * images.shape[1]
    by_image, by_drawn = np.zeros((2, fine, fine))
    depths, _, cells, places, _ = _work_for(fine, m, 0)
    seen, shown = np.full(m, _NONE), np.full(m, _NONE)
    for i in range(len(images)):
        _place(body, (turns[i], points[i], focals[i], corners[i]), FINE, fine, cells, places)
        top, bottom, left, right = _draw(depths, cells, places)
        for y in range(top, bottom):
            for x in range(left, right):
                share = 0.0
                for row in range(FINE * y, FINE * y + FINE):
                    for col in range(FINE * x, FINE * x + FINE):
                        through = 1.0
                        if depths[row, col] > 0.0:
                            through = np.exp(-depths[row, col])
                        depths[row, col] = through
                        share += 1.0 - through
                share /= FINE**2
                for row in range(FINE * y, FINE * y + FINE):
                    for col in range(FINE * x, FINE * x + FINE):
                        by_image[row, col] = depths[row, col] * images[i, y, x]
                        by_drawn[row, col] = depths[row, col] * share
                        depths[row, col] = 0.0
        for j in range(m):
            b, a, p, q = np.int64(cells[0, j]), np.int64(cells[1, j]), places[0, j], places[1, j]
            if b < 0:
                continue
            for below, beside, weight in (
                (b, a, (1.0 - p) * (1.0 - q)),
                (b, a + 1, p * (1.0 - q)),
                (b + 1, a, (1.0 - p) * q),
                (b + 1, a + 1, p * q),
            ):
                seen[j] += weight * by_image[below, beside]
                shown[j] += weight * by_drawn[below, beside]
    return _rounded(body[1] * seen / shown)


@numba.njit(cache=True)
def registered(
    body: Voxels, seen: Seen, places: IntArray, attitudes: Array, rounds: int
) -> tuple[Array, Array]:
    """Turn the body at m instants, and move each of its drawings, to fit their images.

    Rounds of least squares start from attitudes (m, 3, 3) at `places` (m,) in the instants. Returns
    attitudes, and squared residuals as a share of squared images (m,), before the last step.
    """
    images, corners, points, is_seen, views, focals = seen
    m, c = len(places), images.shape[1]
    found, costs = attitudes.copy(), np.zeros(m)
    work, squares = _work_for(FINE * images.shape[2], len(body[1]), 3), np.zeros(c)
    for i in range(m):
        at = places[i]
        moves = np.zeros((c, 2))
        for k in range(c):
            squares[k] = _squares(images[at, k])
        for _ in range(rounds):
            cost, whole = 0.0, _NONE
            normal, right = np.eye(3), np.zeros(3)  # a prior: 1 rad costs 1 px^2 of an image
            own, mixed, left = np.zeros((c, 2, 2)), np.zeros((c, 2, 3)), np.zeros((c, 2))
            for k in range(c):
                if not is_seen[at, k]:
                    continue
                corner = corners[at, k] - moves[k]
                view = views[k] @ found[i], points[at, k], focals[k], corner
                J, r, left_over = _normal(work, body, view, images[at, k], squares[k])
                cost, whole = cost + left_over, whole + squares[k]
                own[k] = np.linalg.inv(J[3:, 3:] + _LEAST_CURVATURE * np.eye(2))
                mixed[k] = J[3:, :3]
                left[k] = r[3:]
                normal += J[:3, :3] - mixed[k].T @ own[k] @ mixed[k]
                right += r[:3] - mixed[k].T @ own[k] @ left[k]
            turn = _within(np.linalg.solve(normal, right), _MOST_TURN_RAD)
            for k in range(c):
                moves[k] += _within(own[k] @ (left[k] - mixed[k] @ turn), _MOST_MOVE_PX)
            found[i] = found[i] @ _turned(turn)
            costs[i] = cost / whole
    return _rounded(found), _rounded(costs)


@numba.njit(cache=True)
def aligned(body: Voxels, drawn: Drawn, rounds: int) -> tuple[Array, Array]:
    """Move n drawings to fit their images: moves (n, 2) [px], shares of the squares left (n,)."""
    images, corners, points, turns, focals = drawn
    n = len(images)
    moves, costs = np.zeros((n, 2)), np.zeros(n)
    work = _work_for(FINE * images.shape[1], len(body[1]), 0)
    for i in range(n):
        squares = _squares(images[i])
        for _ in range(rounds):
            view = turns[i], points[i], focals[i], corners[i] - moves[i]
            J, r, cost = _normal(work, body, view, images[i], squares)
            step = np.linalg.solve(J[3:, 3:] + _LEAST_CURVATURE * np.eye(2), r[3:])
            moves[i] += _within(step, _MOST_MOVE_PX)
            costs[i] = cost / (squares + _NONE)
    return moves, _rounded(costs)


@numba.njit(cache=True)
def _rounded(values: NDArray[Any]) -> NDArray[Any]:
    """Round by less than images resolve, so that no processor's own last digit decides."""
    return np.round(values, 6)


@numba.njit(cache=True)
def _within(step: NDArray[Any], most: float) -> Array:
    """Shorten a step that is too long."""
    return np.asarray(step * min(1.0, most / (np.sqrt(np.sum(step**2)) + _NONE)))


@numba.njit(cache=True)
def _squares(image: Float32Array) -> float:
    """Sum the squares of an image's pixels."""
    total = 0.0
    for y in range(len(image)):
        for x in range(len(image)):
            total += image[y, x] ** 2
    return total


@numba.njit(cache=True)
def _normal(
    work: Work, body: Voxels, view: View, image: Float32Array, squares: float
) -> tuple[Array, Array, float]:
    """Return normal equations (5, 5), (5,) of turns and moves, and the residuals' squares."""
    depths, slopes, cells, places, turns = work
    _place(body, view, FINE, len(depths), cells, places)
    _turn(body[0], view, places, turns)
    top, bottom, left, right = _draw(depths, cells, places)
    _draw_slopes(slopes, cells, places, turns)
    by, J, r, cost = np.zeros(_N_SLOPES), np.zeros((_N_SLOPES, _N_SLOPES)), np.zeros(5), squares
    for y in range(top, bottom):
        for x in range(left, right):
            share = 0.0
            by[:] = 0.0
            for row in range(FINE * y, FINE * y + FINE):
                for col in range(FINE * x, FINE * x + FINE):
                    if depths[row, col] > 0.0:
                        through = np.exp(-depths[row, col])
                        share += (1.0 - through) / FINE**2
                        for a in range(_N_SLOPES):
                            by[a] += through * slopes[row, col, a] / FINE**2
                        depths[row, col] = 0.0
                        slopes[row, col] = 0.0
            off = image[y, x] - share
            cost += off**2 - image[y, x] ** 2
            if share == 0.0:
                continue
            for a in range(_N_SLOPES):
                r[a] += by[a] * off
                for b in range(a + 1):
                    J[a, b] += by[a] * by[b]
    for a in range(_N_SLOPES):
        for b in range(a):
            J[b, a] = J[a, b]
    return J, r, cost


@numba.njit(cache=True)
def _work_for(fine: int, m: int, n_turns: int) -> Work:
    """Return the arrays for drawings of `fine` pixels across, of m voxels."""
    depths, slopes = np.zeros((fine, fine)), np.zeros((fine, fine, _N_SLOPES))
    return depths, slopes, np.empty((2, m), np.int32), np.empty((6, m)), np.empty((n_turns, 2, m))


# To become vectors, the next two functions' loops read no view from memory, do not check for
# division by zero, and add up nothing: the drawing of what they find has loops of its own.


@numba.njit(cache=True, error_model="numpy")
def _place(
    body: Voxels, view: View, scale: int, width: int, cells: Int32Array, places: Array
) -> None:
    """Find rows, -1: outside, and columns (2, m) of the pixels up and left of the voxels' images.

    The places (6, m) are the images' offsets right and down from there, their normalised
    coordinates, the voxels' distances along the axis, and their optical depths in a drawing.
    """
    voxels, densities, step = body
    turn, point, focal, corner = view
    xx, xy, xz, x0 = turn[0, 0], turn[0, 1], turn[0, 2], point[0]
    yx, yy, yz, y0 = turn[1, 0], turn[1, 1], turn[1, 2], point[1]
    zx, zy, zz, z0 = turn[2, 0], turn[2, 1], turn[2, 2], point[2]
    focal_u, focal_v, left, top = focal[0], focal[1], corner[0], corner[1]
    area = (FINE * step) ** 2 * focal_u * focal_v
    for j in range(len(densities)):
        X, Y, Z = voxels[0, j], voxels[1, j], voxels[2, j]
        x, y = xx * X + xy * Y + xz * Z + x0, yx * X + yy * Y + yz * Z + y0
        z = max(zx * X + zy * Y + zz * Z + z0, _NONE)
        u = scale * (focal_u * x / z - left) + 0.5 * (scale - 1)
        v = scale * (focal_v * y / z - top) + 0.5 * (scale - 1)
        column, row = np.floor(u), np.floor(v)
        is_in = (column >= 0.0) & (column < width - 1) & (row >= 0.0) & (row < width - 1)
        cells[0, j], cells[1, j] = np.int32(row if is_in else -1.0), np.int32(column)
        places[0, j], places[1, j], places[2, j], places[3, j] = u - column, v - row, x / z, y / z
        places[4, j], places[5, j] = z, densities[j] * area / z**2


@numba.njit(cache=True, error_model="numpy")
def _turn(voxels: Array, view: View, places: Array, turns: Array) -> None:
    """Find the images' moves (3, 2, m) by turns about the body's axes, times optical depth."""
    turn, _, focal, _ = view
    focal_u, focal_v = FINE * focal[0], FINE * focal[1]
    for k in range(len(turns)):  # the voxel moves by axis k x voxel
        one, two = (k + 1) % 3, (k + 2) % 3
        x1, y1, z1 = turn[0, one], turn[1, one], turn[2, one]
        x2, y2, z2 = turn[0, two], turn[1, two], turn[2, two]
        for j in range(voxels.shape[1]):
            X1, X2 = voxels[one, j], voxels[two, j]
            u, v, z, depth = places[2, j], places[3, j], places[4, j], places[5, j]
            dz = z2 * X1 - z1 * X2
            turns[k, 0, j] = depth * (focal_u * (x2 * X1 - x1 * X2 - u * dz) / z)
            turns[k, 1, j] = depth * (focal_v * (y2 * X1 - y1 * X2 - v * dz) / z)


@numba.njit(cache=True)
def _draw(depths: Array, cells: Int32Array, places: Array) -> tuple[int, int, int, int]:
    """Add optical depths; return the first image row and the one past the last, then columns."""
    top, bottom, left, right = len(depths), 0, len(depths), 0
    for j in range(cells.shape[1]):
        b, a = np.int64(cells[0, j]), np.int64(cells[1, j])
        if b < 0:
            continue
        p, q, depth = places[0, j], places[1, j], places[5, j]
        top, bottom = min(top, int(b)), max(bottom, int(b) + 2)
        left, right = min(left, int(a)), max(right, int(a) + 2)
        depths[b, a] += depth * (1.0 - p) * (1.0 - q)
        depths[b, a + 1] += depth * p * (1.0 - q)
        depths[b + 1, a] += depth * (1.0 - p) * q
        depths[b + 1, a + 1] += depth * p * q
    return top // FINE, -(-bottom // FINE), left // FINE, -(-right // FINE)


@numba.njit(cache=True)
def _draw_slopes(slopes: Array, cells: Int32Array, places: Array, turns: Array) -> None:
    """Add the slopes of optical depths, in place."""
    for j in range(cells.shape[1]):
        b, a = np.int64(cells[0, j]), np.int64(cells[1, j])
        if b < 0:
            continue
        p, q, move = places[0, j], places[1, j], FINE * places[5, j]
        here, beside = slopes[b, a], slopes[b, a + 1]
        below, beyond = slopes[b + 1, a], slopes[b + 1, a + 1]
        if len(turns):
            for k in range(3):
                du, dv = turns[k, 0, j], turns[k, 1, j]
                here[k] -= du * (1.0 - q) + dv * (1.0 - p)
                beside[k] += du * (1.0 - q) - dv * p
                below[k] += dv * (1.0 - p) - du * q
                beyond[k] += du * q + dv * p
        here[3] -= move * (1.0 - q)
        beside[3] += move * (1.0 - q)
        below[3] -= move * q
        beyond[3] += move * q
        here[4] -= move * (1.0 - p)
        beside[4] -= move * p
        below[4] += move * (1.0 - p)
        beyond[4] += move * p


@numba.njit(cache=True)
def _turned(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector."""
    angle = np.sqrt(np.sum(vector**2))
    x, y, z = vector / max(angle, _NONE)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))
