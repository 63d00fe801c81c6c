"""How near methods come to the Cramer-Rao bound of the tables' flights.

The study computes the bound of each flight and method, the least errors of an unbiased estimate;
the errors beside it are those of results/runs.csv. The efficiency is the root mean square of the
bound over the flights, divided by that of the errors.

The bound assumes positions with independent Gaussian noise, of one standard deviation in all four
coordinates of a pair. The object's unknown positions are eliminated: a pair constrains offset and
pose only by its residual p2' F p1, in units of the gradient of that product, so the information is
the sum of J_i J_i' / noise_i^2, J_i being the derivative of the Sampson distance.

The positions are those of the true track of the drone's origin at the sample times that are valid
in the recording; for tangents the origin stands for the points of contact, whose bound is 1 to 6 %
lower. That of `tangency` is of its tangents alone: the body's point, a quarter of its samples, is
not counted, so that it may do better. Sigma is the robust standard deviation (1.4826 times the
median absolute value) of the weighted Sampson distances of the method's own samples under the true
offset and pose, and the noise of a sample is sigma over its weight, whose median is 1.

An efficiency below one has three causes: errors of neighbouring samples, mostly a bias that turns
with the object, correlate by 0.7 to 0.85, and the bound takes them as independent; errors far
beyond the median count little in a robust deviation; and a loss that tolerates them turns early.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from experiments.drawing.errors import efficiency_figure
from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure, RunRow
from experiments.lab.recorded import FlightTruth, load_pair, load_truth
from experiments.lab.study import Made, Runs, Study
from experiments.lab.summary import answered, by_group, made_of, quoted_of
from experiments.paper.esim import ERRORS, KEY, TABLES, in_order, table_cells
from ssac.arrays import Array
from ssac.camera import Rig, known_pose
from ssac.config import Config
from ssac.fit.least_squares import Parameters, WeighedPairs
from ssac.geometry.epipolar import (
    fundamental_from_pose,
    robust_deviation,
    sampson_derivative,
    sampson_distance,
)
from ssac.geometry.pose import pose_jacobian
from ssac.methods.joint import sharp_pairs
from ssac.methods.tangency import tangent_times, tangents_under
from ssac.pipeline.registry import METHODS
from ssac.search.two_views import TwoViews

Flown = tuple[TwoViews, FlightTruth]  # the views that methods are given, and the ground truth
FLIGHT = ("duration_s", "angle_deg", "flight", "method")  # columns that name a bound
CELL = ("duration_s", "angle_deg", "t_d_ms", "method")


@dataclass(frozen=True)
class BoundCell(FlightCell):
    """A method on a flight; the offset moves its samples and does not change the bound."""

    estimator: Config
    method: str  # of SAMPLES


@dataclass(frozen=True)
class BoundRow(RunRow):
    """The bound of a method on a flight; NaN for the pose where it is given."""

    sigma_px: float = np.nan  # measured noise of a sample of median weight
    n_samples: int = 0  # that the bound counts
    t_d_bound_ms: float = np.nan
    r_bound_deg: float = np.nan
    t_bound_deg: float = np.nan


def load_flown(cells: Sequence[BoundCell], cache: Cache) -> Flown:
    """Load a flight."""
    folder = cache.recording_folder(cells[0].sim, cells[0].seed)
    return load_pair(folder).chain(cells[0].estimator).views(), load_truth(folder)


def bound_cells() -> list[BoundCell]:
    """List every method that has a bound, on every flight of the tables, whatever its offset."""
    cells: dict[tuple[Any, ...], BoundCell] = {}
    for cell in table_cells():
        if cell.method in SAMPLES:
            found = BoundCell(cell.sim, cell.flight, cell.seed, cell.estimator, cell.method)
            cells.setdefault((cell.sim, cell.seed, cell.method), found)
    return list(cells.values())


def runs_beside_bounds(runs: pd.DataFrame, bounds: pd.DataFrame) -> pd.DataFrame:
    """Put the bound of each run that is "ok" beside its errors."""
    found = [f"{one.parameter}_bound_{one.unit}" for one in ERRORS.values()]
    good = answered(runs)[[*KEY, *ERRORS]]
    bounded = answered(bounds)[[*FLIGHT, "sigma_px", "n_samples", *found]]
    both = good.merge(bounded, on=list(FLIGHT), how="inner", validate="many_to_one")
    return in_order(both, KEY)


@by_group(*CELL)
def efficiency_table(part: pd.DataFrame) -> dict[str, Any]:
    """Sum up `runs_beside_bounds` by cell and method: root mean squares, and their ratios."""
    row: dict[str, Any] = {"n_runs": len(part)}
    row |= {name: part[name].mean() for name in ("sigma_px", "n_samples")}
    for error in ERRORS.values():
        name, unit = error.parameter, error.unit
        columns = [f"{name}_bound_{unit}", error.column]
        bound, rms = np.sqrt((part[columns] ** 2).mean(skipna=False))
        row |= {f"{name}_bound_{unit}": bound, f"{name}_rms_{unit}": rms}
        row[f"{name}_efficiency"] = bound / rms if rms > 0.0 else np.nan
    return row


# --- The bound ---

_MAX_CONDITION = 1e14  # of the information; beyond it a parameter is unobservable


def cramer_rao_bound(information: Array, pose_is_known: bool = False) -> tuple[float, float, float]:
    """Return the least root mean square errors of t_d [s], R and t [rad] for a Fisher information.

    They are infinite if the motion leaves a parameter unobservable. Those of the pose are of the
    angles of R_est' R_true and between the translation directions, and NaN where it is known.
    """
    if pose_is_known:
        with np.errstate(divide="ignore"):
            return float(1.0 / np.sqrt(information[0, 0])), np.nan, np.nan
    if not np.linalg.cond(information) < _MAX_CONDITION:
        return np.inf, np.inf, np.inf
    variances = np.diag(np.linalg.inv(information))
    R_rad, t_rad = np.sqrt(variances[1:4].sum()), np.sqrt(variances[4:].sum())
    return float(np.sqrt(variances[0])), float(R_rad), float(t_rad)


def fisher_information(
    p1_px: Array,
    p2_px: Array,
    v2_px_s: Array,
    R: Array,
    t: Array,
    rig: Rig,
    noise_px: float | Array,
) -> Array:
    """Return the Fisher information (6, 6) of n pairs on t_d [s] and five pose changes [rad].

    Pairs (n, 2) are true positions, undistorted, at the same instants, with the true image velocity
    of p2, and x2 = R x1 + t with |t| = 1; of the rig only the intrinsics count. The noise of each
    coordinate is one number for all pairs, or (n,).
    """
    K1, K2 = rig.cam1.K, rig.cam2.K
    F = fundamental_from_pose(K1, K2, R, t)
    by_t_d = sampson_derivative(F, p1_px, p2_px, v2_px_s)
    J = np.column_stack([by_t_d, pose_jacobian(R, t, K1, K2, p1_px, p2_px, F)])
    J = J / np.broadcast_to(noise_px, len(J))[:, None]
    return np.asarray(J.T @ J)


def seen(truth: FlightTruth, camera: int, K: Array, times_s: Array) -> tuple[Array, Array]:
    """Return undistorted positions [px], velocities [px/s] of the drone's origin, each (n, 2)."""
    T_C_W = truth.T_C_W[camera]
    to_image = K @ T_C_W[:3, :3]
    flight = CubicSpline(truth.times_s, truth.positions_m)
    points = flight(times_s) @ to_image.T + K @ T_C_W[:3, 3]
    rates = flight(times_s, 1) @ to_image.T
    p_px = points[:, :2] / points[:, 2:]
    return p_px, (rates[:, :2] - p_px * rates[:, 2:]) / points[:, 2:]


def bound_row(cell: BoundCell, flown: Flown, t_d_s: float = 0.0) -> BoundRow:
    """Find the bound of a method on views whose rig has the true extrinsics."""
    views, truth = flown
    rig, samples = views.rig, SAMPLES[cell.method](views, t_d_s)
    R, t = known_pose(rig)
    F = fundamental_from_pose(rig.cam1.K, rig.cam2.K, R, t)
    distances_px = sampson_distance(F, samples.p1_px, samples.p2_px)
    sigma_px = robust_deviation(samples.weights * distances_px)
    p1_px, _ = seen(truth, 0, rig.cam1.K, samples.times_s)
    p2_px, v2_px_s = seen(truth, 1, rig.cam2.K, samples.times_s)
    noise_px = sigma_px / samples.weights
    information = fisher_information(p1_px, p2_px, v2_px_s, R, t, rig, noise_px)
    bound_s, *pose_rad = cramer_rao_bound(information, METHODS[cell.method].needs_extrinsics)
    pose_deg = np.rad2deg(pose_rad).tolist()
    return BoundRow("ok", "", sigma_px, len(samples.times_s), 1e3 * bound_s, *pose_deg)


def mean_samples(views: TwoViews, t_d_s: float) -> WeighedPairs:
    """Sample as Algorithms 1 and 2 do, with weights of 1; the velocities are NaN."""
    pairs = views.pairs_at(t_d_s)
    unknown = np.full((len(pairs), 2), np.nan)
    return WeighedPairs(pairs.times_s, *pairs.points_px, unknown, np.ones(len(pairs)), t_d_s)


def sharp_samples(views: TwoViews, t_d_s: float) -> WeighedPairs:
    """Sample as the joint refinement does."""
    times_s = views.sample_times(np.array([t_d_s]))[0]
    return sharp_pairs(views, times_s, t_d_s)[0]


def tangent_samples(views: TwoViews, t_d_s: float) -> WeighedPairs:
    """Sample as `tangency` does before a body joins, under the true offset and pose."""
    parameters = Parameters(t_d_s, *known_pose(views.rig))
    return tangents_under(parameters, views, tangent_times(views, t_d_s))[0]


SAMPLES: Mapping[str, Callable[[TwoViews, float], WeighedPairs]] = {
    "ssac": mean_samples,
    "ssac-known": mean_samples,
    "joint": sharp_samples,
    "joint-known": sharp_samples,
    "tangency": tangent_samples,
    "tangency-known": tangent_samples,
}
"""Samples of the methods that have a bound. The others use no positions, or no F."""

# Range over the cells of the efficiency of t_d, for white noise.
_SHARE = partial(quoted_of, "efficiency", "t_d_efficiency", "{low:.0f} to {high:.0f} %", 100.0)

STUDIES = (
    Study(
        "efficiency",
        "Errors of the tables' runs beside the Cramer-Rao bound of their flights",
        bound_cells,
        Measure(load_flown, bound_row, BoundRow),
        Runs("efficiency_runs.csv", FLIGHT),
        (Made("efficiency.csv", lambda of: efficiency_table(
            runs_beside_bounds(of.table("runs"), of.table("efficiency_runs")))),
         made_of("efficiency.png", efficiency_figure, "efficiency")),
        numbers={f"bound.{m}": _SHARE(method=m) for m in ("ssac", "joint", "tangency")},
        config={"tables": TABLES, "methods": list(SAMPLES)},
        reads=("runs.csv",),
    ),
)  # fmt: skip
