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

from ssac.arrays import Array, IntArray, Mask
from ssac.rules import BodyRules
from ssac.track.moments import LEAST_VIEWS, nearest

Images = NDArray[np.float32]
Voxels = tuple[Array, Array, float]
"""Voxels (m, 3) in the body's frame, their optical depths (m,) and their width."""

Drawn = tuple[Images, Array, Array, Array, Array]
"""Data of n images: the covered share of each pixel (n, w, w), the first pixels' positions from the
principal points (n, 2) [px], the body's origin in the cameras' frames (n, 3), rotations from the
body's frame to the cameras' (n, 3, 3), and focal lengths (n, 2) [px]."""


class Seen(NamedTuple):
    """Images of c cameras at n instants; where `is_seen` is false, the other values are unused."""

    shares: Images  # (n, c, w, w) covered share of each pixel
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

FINE = 2
"""Pixels of a drawing across one pixel of the image."""

_N_SLOPES = 5  # derivatives of a drawing: by three turns and two moves
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
    shares: NDArray[np.float32]  # (n, w, w) covered share of each pixel
    corners_px: Array  # (n, 2) of the first pixel of each, from the principal point; NaN: no image

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
    px_per_length = [float(np.median(look.focal_px[0] / look.points[:, 2])) for look in looks]
    factor = max(1, *(round(size * scale / rules.full_px) for scale in px_per_length))
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
    body: Voxels = np.empty((0, 3)), np.empty(0), step
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
            body = body[0][kept], densities[kept], step
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
    grid = np.stack(np.meshgrid(along, along, up, indexing="ij"), axis=-1).reshape(-1, 3)
    voxels = grid[seen_shares(grid, rules.covered_share, flat) >= share]
    return voxels, np.full(len(voxels), 0.5), step


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
def seen_shares(voxels: Array, least: float, drawn: Drawn) -> Array:
    """Return the share (m,) of the images that are covered by `least` or more at each voxel."""
    images, corners, points, turns, focals = drawn
    hits = np.zeros(len(voxels))
    width = images.shape[1]
    for i in range(len(images)):
        view = turns[i], points[i], focals[i], corners[i]
        for j in range(len(voxels)):
            b, a, q, p, _ = _placed(voxels[j], view, 1, width)
            if b < 0:
                continue
            above = images[i, b, a] * (1.0 - p) + images[i, b, a + 1] * p
            below = images[i, b + 1, a] * (1.0 - p) + images[i, b + 1, a + 1] * p
            hits[j] += above * (1.0 - q) + below * q >= least
    return hits / max(len(images), 1)


@numba.njit(cache=True)
def improved(body: Voxels, drawn: Drawn) -> Array:
    """Fit the voxels' densities (m,) to images by one multiplicative step of least squares."""
    voxels, densities, _ = body
    images, corners, points, turns, focals = drawn
    m, width = len(voxels), images.shape[1]
    fine = FINE * width
    depths, by_image, by_drawn = np.zeros((3, fine, fine))
    no_slopes = np.zeros((0, 0, _N_SLOPES))
    seen, shown = np.full(m, _NONE), np.full(m, _NONE)
    for i in range(len(images)):
        view = turns[i], points[i], focals[i], corners[i]
        top, bottom, left, right = _draw(depths, no_slopes, body, view, _N_SLOPES)
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
            b, a, q, p, _ = _placed(voxels[j], view, FINE, fine)
            if b < 0:
                continue
            for row, col, weight in (
                (b, a, (1.0 - p) * (1.0 - q)),
                (b, a + 1, p * (1.0 - q)),
                (b + 1, a, (1.0 - p) * q),
                (b + 1, a + 1, p * q),
            ):
                seen[j] += weight * by_image[row, col]
                shown[j] += weight * by_drawn[row, col]
    return _rounded(densities * seen / shown)


@numba.njit(cache=True)
def registered(
    body: Voxels, seen: Seen, places: IntArray, attitudes: Array, rounds: int
) -> tuple[Array, Array]:
    """Turn the body at m instants, and move each of its drawings, to fit their images.

    Rounds of least squares start from attitudes (m, 3, 3) at `places` (m,) in the instants. Returns
    attitudes, and squared residuals as a share of squared images (m,), before the last step.
    """
    images, corners, points, is_seen, views, focals = seen
    m, c, fine = len(places), images.shape[1], FINE * images.shape[2]
    found, costs = attitudes.copy(), np.zeros(m)
    work = np.zeros((fine, fine)), np.zeros((fine, fine, _N_SLOPES))
    for i in range(m):
        at = places[i]
        moves = np.zeros((c, 2))
        for _ in range(rounds):
            cost, whole = 0.0, _NONE
            normal, right = np.eye(3), np.zeros(3)  # a prior: 1 rad costs 1 px^2 of an image
            own, mixed, left = np.zeros((c, 2, 2)), np.zeros((c, 2, 3)), np.zeros((c, 2))
            for k in range(c):
                if not is_seen[at, k]:
                    continue
                corner = corners[at, k] - moves[k]
                view = views[k] @ found[i], points[at, k], focals[k], corner
                J, r, squares, all_squares = _normal(work, body, view, images[at, k], 0)
                cost, whole = cost + squares, whole + all_squares
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
    fine = FINE * images.shape[1]
    work = np.zeros((fine, fine)), np.zeros((fine, fine, _N_SLOPES))
    for i in range(n):
        for _ in range(rounds):
            view = turns[i], points[i], focals[i], corners[i] - moves[i]
            J, r, squares, all_squares = _normal(work, body, view, images[i], 3)
            step = np.linalg.solve(J[3:, 3:] + _LEAST_CURVATURE * np.eye(2), r[3:])
            moves[i] += _within(step, _MOST_MOVE_PX)
            costs[i] = squares / (all_squares + _NONE)
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
def _normal(
    work: tuple[Array, Array], body: Voxels, view: View, image: NDArray[np.float32], first: int
) -> tuple[Array, Array, float, float]:
    """Return normal equations (5, 5), (5,) of turns and moves; squares of residuals and image."""
    # Only entries from `first` on are set. The work arrays are all zero again at the end.
    depths, slopes = work
    top, bottom, left, right = _draw(depths, slopes, body, view, first)
    by, J, r = np.zeros(5), np.zeros((5, 5)), np.zeros(5)
    whole = 0.0
    for y in range(len(image)):
        for x in range(len(image)):
            whole += image[y, x] ** 2
    cost = whole
    for y in range(top, bottom):
        for x in range(left, right):
            share = 0.0
            by[:] = 0.0
            for row in range(FINE * y, FINE * y + FINE):
                for col in range(FINE * x, FINE * x + FINE):
                    if depths[row, col] > 0.0:
                        through = np.exp(-depths[row, col])
                        share += (1.0 - through) / FINE**2
                        for a in range(first, 5):
                            by[a] += through * slopes[row, col, a] / FINE**2
                        depths[row, col] = 0.0
                        slopes[row, col] = 0.0
            off = image[y, x] - share
            cost += off**2 - image[y, x] ** 2
            if share == 0.0:
                continue
            for a in range(first, 5):
                r[a] += by[a] * off
                for b in range(first, a + 1):
                    J[a, b] += by[a] * by[b]
    for a in range(first, 5):
        for b in range(first, a):
            J[b, a] = J[a, b]
    return J, r, cost, whole


@numba.njit(cache=True)
def _placed(
    voxel: Array, view: View, scale: int, width: int
) -> tuple[int, int, float, float, float]:
    """Return the pixel up and left of a voxel's image (row -1: outside), offsets from it, depth."""
    turn, point, focal, corner = view
    x = turn[0, 0] * voxel[0] + turn[0, 1] * voxel[1] + turn[0, 2] * voxel[2] + point[0]
    y = turn[1, 0] * voxel[0] + turn[1, 1] * voxel[1] + turn[1, 2] * voxel[2] + point[1]
    z = turn[2, 0] * voxel[0] + turn[2, 1] * voxel[1] + turn[2, 2] * voxel[2] + point[2]
    z = max(z, _NONE)
    u = scale * (focal[0] * x / z - corner[0]) + 0.5 * (scale - 1)
    v = scale * (focal[1] * y / z - corner[1]) + 0.5 * (scale - 1)
    column, row = int(np.floor(u)), int(np.floor(v))
    is_in = 0 <= column < width - 1 and 0 <= row < width - 1
    return row if is_in else -1, column, v - row, u - column, z


@numba.njit(cache=True)
def _draw(
    depths: Array, slopes: Array, body: Voxels, view: View, first: int
) -> tuple[int, int, int, int]:
    """Add optical depths (FINE w, FINE w) and their slopes from `first` on, in place."""
    # Slopes (FINE w, FINE w, 5) are by turns [rad] about the body's axes and by moves [px].
    # Returned are the first row of image pixels and the one past the last; then so for columns.
    voxels, densities, step = body
    turn, _, focal, corner = view
    area = (FINE * step) ** 2 * focal[0] * focal[1]
    top, bottom, left, right = len(depths), 0, len(depths), 0
    by_u, by_v = np.zeros(_N_SLOPES), np.zeros(_N_SLOPES)
    by_u[3], by_v[4] = FINE, FINE
    for j in range(len(voxels)):
        b, a, q, p, z = _placed(voxels[j], view, FINE, len(depths))
        if b < 0:
            continue
        top, bottom = min(top, b), max(bottom, b + 2)
        left, right = min(left, a), max(right, a + 2)
        depth = densities[j] * area / z**2
        depths[b, a] += depth * (1.0 - p) * (1.0 - q)
        depths[b, a + 1] += depth * p * (1.0 - q)
        depths[b + 1, a] += depth * (1.0 - p) * q
        depths[b + 1, a + 1] += depth * p * q
        if first == 0:
            x, y, h = voxels[j]
            # Normalised image coordinates of the voxel.
            u = ((a + p - 0.5 * (FINE - 1)) / FINE + corner[0]) / focal[0]
            v = ((b + q - 0.5 * (FINE - 1)) / FINE + corner[1]) / focal[1]
            # The voxel moves by axis x voxel.
            for k, (d0, d1, d2) in enumerate(((0.0, -h, y), (h, 0.0, -x), (-y, x, 0.0))):
                dx = turn[0, 0] * d0 + turn[0, 1] * d1 + turn[0, 2] * d2
                dy = turn[1, 0] * d0 + turn[1, 1] * d1 + turn[1, 2] * d2
                dz = turn[2, 0] * d0 + turn[2, 1] * d1 + turn[2, 2] * d2
                by_u[k] = FINE * focal[0] * (dx - u * dz) / z
                by_v[k] = FINE * focal[1] * (dy - v * dz) / z
        for k in range(first, _N_SLOPES):
            du, dv = depth * by_u[k], depth * by_v[k]
            slopes[b, a, k] -= du * (1.0 - q) + dv * (1.0 - p)
            slopes[b, a + 1, k] += du * (1.0 - q) - dv * p
            slopes[b + 1, a, k] += dv * (1.0 - p) - du * q
            slopes[b + 1, a + 1, k] += du * q + dv * p
    return top // FINE, -(-bottom // FINE), left // FINE, -(-right // FINE)


@numba.njit(cache=True)
def _turned(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector."""
    angle = np.sqrt(np.sum(vector**2))
    x, y, z = vector / max(angle, _NONE)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))
