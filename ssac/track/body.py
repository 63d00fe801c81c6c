"""One point of a rigid body in the images of several cameras, in place of its images' centres.

The centre of an image's area is that of no point of the body: parts hide others, and what is nearer
looks larger, each as the body turns (`ssac.track.moments` takes away what perspective alone does).
The body's shape and its attitudes are told from all of the images together: voxels that are drawn
as these are, and the turns by which they are (the same body seen from ever other sides, as of
Cheung, Baker and Kanade, CVPR 2003). Drawings are then moved until they are as the images, and by
so much is the body's origin off where it was thought to be.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from ssac.arrays import Array, IntArray, Mask
from ssac.rules import BodyRules
from ssac.track.body_kernels import (
    Drawn,
    Seen,
    Voxels,
    aligned,
    improved,
    registered,
    seen_shares,
)
from ssac.track.moments import LEAST_VIEWS, nearest


@dataclass(frozen=True, eq=False)
class Look:
    """What one camera saw of the body, at n times."""

    times_s: Array  # (n,) ascending, of all cameras' common clock
    R: Array  # (3, 3) x = R X + t
    focal_px: Array  # (2,)
    points: Array  # (n, 3) where the body is thought to be, in the camera's frame
    shares: NDArray[np.float32]  # (n, w, w) of pixels that are covered
    corners_px: Array  # (n, 2) of the first pixel of each, from the principal point; NaN: no image

    @property
    def px_per_length(self) -> float:
        """How many pixels a unit of length has in the image, in the median."""
        return float(np.median(self.focal_px[0] / self.points[:, 2]))

    def coarser(self, factor: int) -> "Look":
        """Give the same with pixels of so many times the width."""
        if factor == 1:
            return self
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

    The body's second moments (m, 3, 3), at even times (m,), are those of `second_moments`. Gives
    for each camera (n, 2) [px]: where the origin is less where it was thought to be; NaN where that
    is not known. None where the images are not those of a rigid body, or too few.
    """
    is_told = np.isfinite(moments[:, 0, 0])
    if not is_told.any():
        return None
    size = float(np.sqrt(np.median(np.linalg.eigvalsh(moments[is_told])[:, 2])))
    factor = max(1, *(round(size * look.px_per_length / rules.full_px) for look in looks))
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
    """Choose of n instants those that tell the shape: of many every other, of more the middle."""
    chosen = np.arange(
        0, n, rules.learnt_steps * (1 + (n > rules.learnt_steps * rules.most_learnt))
    )
    beyond = max(len(chosen) - rules.most_learnt, 0) // 2
    return np.asarray(chosen[beyond : len(chosen) - beyond], np.int64)


def _learned(
    seen: Seen, attitudes: Array, size: float, rules: BodyRules
) -> tuple[Voxels, IntArray, Array]:
    """Find a body's shape; at which of the instants (k,) it is as seen; its attitudes then."""
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
    """Gather what is seen at even instants; give attitudes to begin with.

    Their axes are those of the second moments: which of two is the longer, and which way each
    points, is told later, by neighbours.
    """
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
    """Leave the voxels that so many of the images cover."""
    reach = rules.reach_sizes * size
    along = np.arange(-reach, reach + step, step)
    up = along[np.abs(along) <= rules.thickness_sizes * size]
    grid = np.stack(np.meshgrid(along, along, up, indexing="ij"), axis=-1).reshape(-1, 3)
    voxels = grid[seen_shares(grid, rules.covered_share, flat) >= share]
    return voxels, np.full(len(voxels), 0.5), step


def _yawed(
    body: Voxels, seen: Seen, attitudes: Array, costs: Array, ill: Mask, rules: BodyRules
) -> None:
    """Try turns about the least axis, which second moments tell less well than the axis itself."""
    places = np.flatnonzero(ill)
    yaws = Rotation.from_rotvec(np.outer(np.deg2rad(rules.yaws_deg), [0.0, 0.0, 1.0])).as_matrix()
    start = attitudes[places]
    for yaw in yaws:
        _try(body, seen, attitudes, costs, places, start @ yaw, rules)


def _take_over(body: Voxels, seen: Seen, attitudes: Array, costs: Array, rules: BodyRules) -> None:
    """Try at each instant what its neighbours are, which may be where it has not come to."""
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
    """Take other attitudes to start from at some instants, in place, where they end up better."""
    found, left = registered(body, seen, places, start, rules.alignments)
    better = left < rules.better * costs[places]
    attitudes[places[better]], costs[places[better]] = found[better], left[better]


def _moves(body: Voxels, look: Look, times_s: Array, attitudes: Array, rules: BodyRules) -> Array:
    """Move the body's drawings at all times of a camera; give by how much (n, 2)."""
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
