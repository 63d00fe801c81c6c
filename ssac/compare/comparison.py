"""An estimated path and a true one in, their difference out: at equal times, and as shapes."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssac.clock import Clock
from ssac.compare.icp import registered
from ssac.errors import SsacError
from ssac.network.align import RATE_STD_PPM, Similarity, best_shift, interpolated, similarity
from ssac.network.tum import Path

Array = NDArray[np.float64]

_LEAST_POINTS = 3  # that are not on a line
_DENSE = 20  # points from one of the truth's to the next, where it is a shape


@dataclass(frozen=True, eq=False)
class Difference:
    """Distances between two paths, one laid over the other."""

    similarity: Similarity  # from the estimate's frame to the truth's
    distances_m: Array  # (n,) of each sample

    @property
    def rmse_m(self) -> float:
        """Root of the mean square."""
        return float(np.sqrt(np.mean(self.distances_m**2)))

    def figures(self) -> dict[str, float | int]:
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
    coverage: float  # share of the truth's samples, from the estimate's first time to its last

    @property
    def explained(self) -> float:
        """Share of the truth's variance that the estimate has too; far from 1: another flight."""
        about_mean = np.sum((self.truth_m - self.truth_m.mean(axis=0)) ** 2)
        return float(1.0 - np.sum(self.distances_m**2) / about_mean)


@dataclass(frozen=True, eq=False)
class Comparison:
    """How far an estimate is from a truth."""

    in_time: InTime | None  # None: one of the two has no times
    as_shape: Difference  # by ICP; of the estimate's own points, at times that the truth has
    estimate_m: Array  # (m, 3) all of it in the truth's frame: in time where there are times
    truth_m: Array  # (k, 3) all of it, the lever arm taken away

    def figures(self) -> dict[str, Any]:
        """Give its numbers by name, as machines read them."""
        found: dict[str, Any] = {"in_time": None, "as_shape": self.as_shape.figures()}
        if self.in_time is not None:
            clock, frame = self.in_time.clock, self.in_time.similarity
            found["in_time"] = self.in_time.figures() | {
                "coverage": self.in_time.coverage,
                "explained": self.in_time.explained,
                "shift_s": clock.t_d_s,
                "rate_ppm": clock.skew_ppm,
                "t_ref_s": clock.t_ref_s,
                "R": frame.R.tolist(),
                "t": frame.t.tolist(),
            }
        return found


def compare(
    estimate: Path,
    truth: Path,
    with_scale: bool = True,
    max_shift_s: float | None = None,
    rate_std_ppm: float = RATE_STD_PPM,
    lever_arm_m: tuple[float, float, float] | None = None,
) -> Comparison:
    """Compare an estimated path with a true one.

    Parameters
    ----------
    estimate, truth
        In frames and on clocks of their own; where one has no times, they are compared as shapes.
    with_scale
        Whether the estimate's scale is unknown.
    max_shift_s, rate_std_ppm
        Of the truth's clock, as `ssac.network.align.best_shift` has them.
    lever_arm_m
        Where the truth's antenna is in the body (forward, left, up); needs the truth's attitude.

    Returns
    -------
    Comparison
        At equal times the similarity is that of least squares, as other tools have it.

    Raises
    ------
    SsacError
        If they share too little time or do not move enough, or the attitude is missing.
    """
    for name, path in (("estimate", estimate), ("truth", truth)):
        if len(path) < _LEAST_POINTS:
            raise SsacError(
                f"the {name} has {len(path)} points, and at least {_LEAST_POINTS} tell how it is "
                "turned: give more of it"
            )
    if lever_arm_m is not None:
        truth = without_lever_arm(truth, lever_arm_m)
    in_time, start, points = None, None, estimate.positions_m
    if estimate.has_times and truth.has_times:
        clock, _ = best_shift(estimate, truth, max_shift_s, rate_std_ppm, with_scale)
        in_time = at_equal_times(estimate, truth, clock, with_scale)
        start = in_time.similarity
        # Where the truth has a gap, or is over, the nearest of its points is another place's.
        points = points[interpolated(truth).covers(clock.cam2_from_cam1(estimate.times_s))]
    fit, distances_m = registered(points, _shape(truth), start, with_scale)
    frame = start or fit
    return Comparison(
        in_time,
        Difference(fit, distances_m),
        frame.apply(estimate.positions_m),
        truth.positions_m,
    )


def at_equal_times(estimate: Path, truth: Path, clock: Clock, with_scale: bool) -> InTime:
    """Give the difference at the truth's samples, the truth's clock being known."""
    path, times_s = interpolated(estimate), clock.cam1_from_cam2(truth.times_s)
    seen = path.covers(times_s)
    between = (times_s >= estimate.times_s[0]) & (times_s <= estimate.times_s[-1])
    if not seen.any():
        raise SsacError("the estimate and the truth share no time: check the shift")
    target, source = truth.positions_m[seen], path.at(times_s[seen])
    frame = similarity(source, target, with_scale)
    laid = frame.apply(source)
    distances_m = np.linalg.norm(laid - target, axis=1)
    coverage = float(seen.sum() / between.sum())
    return InTime(frame, distances_m, clock, truth.times_s[seen], target, laid, coverage)


def without_lever_arm(truth: Path, lever_arm_m: tuple[float, float, float]) -> Path:
    """Move the truth from its antenna to the body's origin."""
    if truth.quaternions is None:
        raise SsacError(
            "a lever arm turns with the body, and the truth has no attitude: give it as TUM with "
            "qx qy qz qw, or leave the lever arm out, whose constant part the alignment takes"
        )
    arms_m = Rotation.from_quat(truth.quaternions).apply(np.asarray(lever_arm_m))
    return replace(truth, positions_m=truth.positions_m - arms_m)


def _shape(truth: Path) -> Array:
    """Points of the truth and between them, but for its gaps."""
    n = len(truth)
    times_s = truth.times_s if truth.has_times else np.arange(n, dtype=np.float64)
    dense_s = np.interp(np.arange((n - 1) * _DENSE + 1) / _DENSE, np.arange(n), times_s)
    points = interpolated(replace(truth, times_s=times_s)).at(dense_s)
    return np.asarray(points[np.isfinite(points[:, 0])])
