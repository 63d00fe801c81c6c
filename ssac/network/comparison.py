"""How far an estimated path is from a true one: at equal times, and as shapes.

As shapes, paths are registered by iterative closest points, as the paper registers its outdoor path
to RTK: each point of the estimate goes with the nearest of the truth. What is left is a distance
between shapes: an error along the path, as of a wrong clock, does not show in it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ssac.arrays import Array
from ssac.clock import Clock
from ssac.errors import SsacError
from ssac.network.align import RATE_STD_PPM, Similarity, best_shift, interpolated, similarity
from ssac.network.tum import Path


@dataclass(frozen=True, eq=False)
class Difference:
    """Distances between two paths after the alignment of one with the other."""

    similarity: Similarity  # from the estimate's frame to the truth's
    distances_m: Array  # (n,) one for each sample

    @property
    def rmse_m(self) -> float:
        """Root of the mean square."""
        return float(np.sqrt(np.mean(self.distances_m**2)))

    def figures(self) -> dict[str, Any]:
        """Give its numbers by name, as machines read them."""
        return {
            "rmse_m": self.rmse_m,
            "median_m": float(np.median(self.distances_m)),
            "max_m": float(self.distances_m.max()),
            "scale": self.similarity.scale,
            "n_samples": len(self.distances_m),
        }


@dataclass(frozen=True, eq=False)
class InTime(Difference):
    """The difference at equal times, at the truth's samples that the estimate covers."""

    clock: Clock  # the truth's, as the estimate's times see it
    times_s: Array  # (n,) on the truth's clock
    truth_m: Array  # (n, 3)
    estimate_m: Array  # (n, 3) in the truth's frame
    coverage: float  # share of the truth's samples in the estimate's time span that it covers

    @property
    def explained(self) -> float:
        """Share of the truth's variance that the estimate explains; far from 1: another flight."""
        about_mean = np.sum((self.truth_m - self.truth_m.mean(axis=0)) ** 2)
        return float(1.0 - np.sum(self.distances_m**2) / about_mean)

    def figures(self) -> dict[str, Any]:
        """Give its numbers by name, as machines read them."""
        clock, frame = self.clock, self.similarity
        return super().figures() | {
            "coverage": self.coverage,
            "explained": self.explained,
            "shift_s": clock.t_d_s,
            "rate_ppm": clock.skew_ppm,
            "t_ref_s": clock.t_ref_s,
            "R": frame.R.tolist(),
            "t": frame.t.tolist(),
        }


@dataclass(frozen=True, eq=False)
class Comparison:
    """How far an estimate is from a truth."""

    in_time: InTime | None  # None: one of the two has no times
    as_shape: Difference  # by ICP, of the estimate's points at times that the truth covers
    estimate_m: Array  # (m, 3) all of it in the truth's frame: in time where there are times
    truth_m: Array  # (k, 3) all of it, without the lever arm

    def figures(self) -> dict[str, Any]:
        """Give its numbers by name, as machines read them."""
        in_time = None if self.in_time is None else self.in_time.figures()
        return {"in_time": in_time, "as_shape": self.as_shape.figures()}


def compare(
    estimate: Path,
    truth: Path,
    with_scale: bool = True,
    max_shift_s: float | None = None,
    rate_std_ppm: float = RATE_STD_PPM,
    lever_arm_m: tuple[float, float, float] | None = None,
) -> Comparison:
    """Compare an estimated path with a true one, each in a frame and on a clock of its own.

    If either has no times, they are compared as shapes only. Scale, shift and rate are as of
    `ssac.network.align.best_shift`; the lever arm is the position of the truth's antenna in the
    body (forward, left, up), and needs the truth's attitude. SsacError if that is missing, or if
    the paths have too few points, stand still, share too little time or do not move enough.
    """
    check_moves("the estimate", estimate, 3)
    check_moves("the truth", truth, 3)
    if lever_arm_m is not None:
        truth = without_lever_arm(truth, lever_arm_m)
    in_time, start, points = None, None, estimate.positions_m
    if estimate.has_times and truth.has_times:
        clock, _ = best_shift(estimate, truth, max_shift_s, rate_std_ppm, with_scale)
        in_time = at_equal_times(estimate, truth, clock, with_scale)
        start = in_time.similarity
        # In the truth's gaps and beyond its ends, its nearest point belongs to another time.
        inside = interpolated(truth).covers(clock.cam2_from_cam1(estimate.times_s))
        if np.count_nonzero(inside) < 3:
            raise SsacError(
                "the truth has gaps at nearly all of the estimate's times: give more points of both"
            )
        points = points[inside]
    fit, distances_m = registered(points, _shape(truth), start, with_scale)
    frame = start or fit
    return Comparison(
        in_time, Difference(fit, distances_m), frame.apply(estimate.positions_m), truth.positions_m
    )


def check_moves(name: str, path: Path, least: int) -> None:
    """Raise SsacError unless a path has so many points, and moves."""
    if len(path) < least:
        raise SsacError(
            f"{name} has {len(path)} points, and at least {least} are needed: give more of it"
        )
    if not np.ptp(path.positions_m, axis=0).any():
        raise SsacError(f"{name} stands still: give a path that moves")


def at_equal_times(estimate: Path, truth: Path, clock: Clock, with_scale: bool) -> InTime:
    """Return the difference at the truth's samples, given the truth's clock."""
    path, times_s = interpolated(estimate), clock.cam1_from_cam2(truth.times_s)
    seen = path.covers(times_s)
    between = (times_s >= estimate.times_s[0]) & (times_s <= estimate.times_s[-1])
    target, source = truth.positions_m[seen], path.at(times_s[seen])
    frame = similarity(source, target, with_scale)
    laid = frame.apply(source)
    distances_m = np.linalg.norm(laid - target, axis=1)
    coverage = float(seen.sum() / between.sum())
    return InTime(frame, distances_m, clock, truth.times_s[seen], target, laid, coverage)


def without_lever_arm(truth: Path, lever_arm_m: tuple[float, float, float]) -> Path:
    """Move the truth from its antenna to the body's origin; SsacError if it has no attitude."""
    if truth.quaternions is None:
        raise SsacError(
            "a lever arm turns with the body, and the truth has no attitude: give it as TUM with "
            "qx qy qz qw, or leave the lever arm out, whose constant part the alignment takes"
        )
    arms_m = Rotation.from_quat(truth.quaternions).apply(np.asarray(lever_arm_m))
    return replace(truth, positions_m=truth.positions_m - arms_m)


def _shape(truth: Path) -> Array:
    """Points (k, 3) of the truth, interpolated densely except in gaps."""
    n = len(truth)
    times_s = truth.times_s if truth.has_times else np.arange(n, dtype=np.float64)
    dense = 20  # points from one to the next
    dense_s = np.interp(np.arange((n - 1) * dense + 1) / dense, np.arange(n), times_s)
    points = interpolated(replace(truth, times_s=times_s)).at(dense_s)
    return np.asarray(points[np.isfinite(points[:, 0])])


def registered(
    source: Array, target: Array, start: Similarity | None, with_scale: bool
) -> tuple[Similarity, Array]:
    """Register points (n, 3) [m] with dense ones by ICP; return each point's distance (n,) [m] too.

    Without a start, the first similarities align centroids, sizes and principal axes.
    """
    tree = KDTree(target)
    thin = source[:: max(1, len(source) // 2000)]  # enough for the iterations
    starts = [start] if start is not None else [*_by_main_axes(source, target, with_scale)]
    found = [_closest(thin, target, tree, each, with_scale) for each in starts]
    # Relative to the scale: a path that shrinks is near to everything.
    best, _ = min(found, key=lambda fit: fit[1] / fit[0].scale)
    return best, np.asarray(tree.query(best.apply(source))[0])


def _closest(
    source: Array, target: Array, tree: KDTree, start: Similarity, with_scale: bool
) -> tuple[Similarity, float]:
    """Iterate until the distances settle; return the similarity and their RMS [m]."""
    fit, before = start, np.inf
    most_growth = 2.0  # of the scale: the nearest points of a small path are one point
    for _ in range(200):
        distances, nearest = tree.query(fit.apply(source))
        rms = float(np.sqrt(np.mean(distances**2)))
        if before - rms <= 1e-7 * rms:
            break
        before = rms
        try:
            moved = similarity(source, target[nearest], with_scale)
        except SsacError:
            break  # all nearest to one stretch of the truth
        if not 1.0 / most_growth < moved.scale / start.scale < most_growth:
            break
        fit = moved
    return fit, before


def _by_main_axes(source: Array, target: Array, with_scale: bool) -> Iterator[Similarity]:
    """Yield the four similarities that align the principal axes."""
    (middle, axes, size), (middle_target, axes_target, size_target) = map(_main, (source, target))
    scale = size_target / size if with_scale else 1.0
    for one, two in product((1.0, -1.0), repeat=2):
        signs = np.array([one, two, one * two])
        R = (axes_target * signs) @ axes.T
        yield Similarity(scale, R, middle_target - scale * R @ middle)


def _main(points: Array) -> tuple[Array, Array, float]:
    """Return points' centroid (3,), principal axes (3, 3), right-handed columns, and RMS size."""
    middle = points.mean(axis=0)
    _, values, axes = np.linalg.svd(points - middle, full_matrices=False)
    if len(points) < 3 or values[1] <= 0.0:
        raise SsacError("a path of points on a line does not tell how it is turned")
    axes = axes.T * np.array([1.0, 1.0, np.linalg.det(axes)])
    return middle, axes, float(np.sqrt(np.sum(values**2) / len(points)))
