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

    @property
    def all(self) -> Seen:
        """Give what `registered` takes."""
        images = self.shares, self.corners_px, self.points, self.seen
        return *images, self.views, self.focals_px

    def of(self, chosen: IntArray) -> "_Instants":
        """Give some of them."""
        images = self.shares[chosen], self.corners_px[chosen], self.points[chosen]
        return _Instants(
            self.times_s[chosen], *images, self.seen[chosen], self.views, self.focals_px
        )

    def flat(self, chosen: IntArray, attitudes: Array) -> Drawn:
        """Give what `improved` takes of some instants."""
        i, k = np.nonzero(self.seen[chosen])
        i = chosen[i]
        turns = self.views[k] @ attitudes[i]
        found = self.shares[i, k], self.corners_px[i, k], self.points[i, k]
        return *found, turns, self.focals_px[k]


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
    instants, attitudes = _instants(looks, shape_s, moments, rules.step_s)
    if len(attitudes) < rules.least_instants:
        return None
    some = _learnt(len(attitudes), rules)
    body, good, found = _learned(instants.of(some), attitudes[some], size, rules)
    known_s, times_s = instants.times_s[some[good]], instants.times_s
    between = Slerp(known_s, Rotation.from_matrix(found))
    attitudes = between(np.clip(times_s, known_s[0], known_s[-1])).as_matrix()
    every = np.arange(len(attitudes))
    attitudes, costs = registered(body, instants.all, every, attitudes, rules.last_alignments)
    attitudes, costs = _taken_over(body, instants, attitudes, costs, rules)
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
    instants: _Instants, attitudes: Array, size: float, rules: BodyRules
) -> tuple[Voxels, IntArray, Array]:
    """Find a body's shape; at which of the instants (k,) it is as seen; its attitudes then."""
    step = size * rules.reach_sizes / rules.voxels_across
    body: Voxels = np.empty((0, 3)), np.empty(0), step
    every: IntArray = np.arange(len(attitudes), dtype=np.int64)
    good = every
    left, is_last = np.inf, False
    for number in range(rules.max_rounds):
        is_last |= number == rules.max_rounds - 1
        flat = instants.flat(good[:: 1 + len(good) // rules.most_fitted], attitudes)
        if number < len(rules.carved_shares) and not is_last:
            body = _carved(step, size, flat, rules.carved_shares[number], rules)
        for _ in range(rules.last_fit_steps if is_last else rules.fit_steps):
            densities = improved(body, flat)
            kept = densities > rules.least_depth
            body = body[0][kept], densities[kept], step
        attitudes, costs = registered(body, instants.all, every, attitudes, rules.alignments)
        if not is_last:
            ill = costs > (rules.ill * np.median(costs) if number else -np.inf)
            if number < rules.yaw_rounds:
                attitudes, costs = _yawed(body, instants, attitudes, costs, ill, rules)
            attitudes, costs = _taken_over(body, instants, attitudes, costs, rules)
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
) -> tuple[_Instants, Array]:
    """Gather what is seen at even instants; give attitudes to begin with.

    Its axes are those of the second moments: which of two is the longer, and which way each points,
    is told later, by its neighbours.
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
        own = seen[:, k]
        w = look.shares.shape[1]
        shares[own, k, :w, :w] = look.shares[at[own]]
        corners[own, k], points[own, k] = look.corners_px[at[own]], look.points[at[own]]
    good = (seen.sum(axis=1) >= min(LEAST_VIEWS, c)) & np.isfinite(moments[:, 0, 0])
    views = np.array([look.R for look in looks])
    focals = np.array([look.focal_px for look in looks])
    kept = shares[good], corners[good], points[good], seen[good]
    axes = np.linalg.eigh(moments[good])[1][:, :, ::-1].copy()
    for i in range(len(axes)):
        if i:
            axes[i] *= np.where(np.sum(axes[i] * axes[i - 1], axis=0) < 0.0, -1.0, 1.0)
        axes[i, :, 1] = np.cross(axes[i, :, 2], axes[i, :, 0])
    return _Instants(times_s[good], *kept, views, focals), axes


def _carved(step: float, size: float, flat: Drawn, share: float, rules: BodyRules) -> Voxels:
    """Leave the voxels that so many of the images cover."""
    reach = rules.reach_sizes * size
    along = np.arange(-reach, reach + step, step)
    up = along[np.abs(along) <= rules.thickness_sizes * size]
    grid = np.stack(np.meshgrid(along, along, up, indexing="ij"), axis=-1).reshape(-1, 3)
    voxels = grid[seen_shares(grid, rules.covered_share, flat) >= share]
    return voxels, np.full(len(voxels), 0.5), step


def _yawed(
    body: Voxels, instants: _Instants, attitudes: Array, costs: Array, ill: Mask, rules: BodyRules
) -> tuple[Array, Array]:
    """Try turns about the least axis, which second moments tell less well than the axis itself."""
    attitudes, costs, places = attitudes.copy(), costs.copy(), np.flatnonzero(ill)
    yaws = Rotation.from_rotvec(np.outer(np.deg2rad(rules.yaws_deg), [0.0, 0.0, 1.0])).as_matrix()
    start = attitudes[places]
    for yaw in yaws:
        found, left = registered(body, instants.all, places, start @ yaw, rules.alignments)
        better = left < rules.better * costs[places]
        attitudes[places[better]], costs[places[better]] = found[better], left[better]
    return attitudes, costs


def _taken_over(
    body: Voxels, instants: _Instants, attitudes: Array, costs: Array, rules: BodyRules
) -> tuple[Array, Array]:
    """Try at each instant what its neighbours are, which may be where it has not come to."""
    attitudes, costs = attitudes.copy(), costs.copy()
    n = len(attitudes)
    for order, off in ((range(1, n), -1), (range(n - 2, -1, -1), 1)):
        for i in order:
            if costs[i] > costs[i + off]:
                start, place = attitudes[i + off : i + off + 1], np.array([i])
                found, left = registered(body, instants.all, place, start, rules.alignments)
                if left[0] < rules.better * costs[i]:
                    attitudes[i], costs[i] = found[0], left[0]
    return attitudes, costs


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
