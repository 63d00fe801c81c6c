"""The drone's pose T_W_B as a smooth function of time: a random spline, or a CSV file.

World frame W: origin at the point the cameras look at, x right, y forward, z up, metres.
Body frame B: x forward, y left, z up.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, CubicSpline
from scipy.sparse import diags_array
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation, RotationSpline

from sim.arrays import FloatArray, IntArray
from sim.errors import SimError, check_numbers

Vector3 = tuple[float, float, float]
Attitude = Callable[[FloatArray], Rotation]

MAX_DRAWS = 100  # of a random trajectory, before its configuration is refused
# Segments of a spline, 400 s by default, beyond which dense matrices take gigabytes: longer ones
# use sparse matrices, and are drawn anew only where they leave the circle.
LONG_SEGMENTS = 2000
_REDRAWN_S = 1.0  # time redrawn on each side of where a long trajectory leaves the circle


@dataclass(frozen=True)
class SplineConfig:
    """A random trajectory in the manner of ESIM: random poses at regular times, then smoothed.

    Sampling rate and order are ESIM's. Multipliers and `smoothing` (ESIM: 0.1) are tuned so that
    at 90 deg, 5 m and f = 200 px the recording resembles the authors' sample in speed, visibility
    and size of the drone (`ssac scene` prints the figures).
    """

    duration_s: float = 20.0
    sampling_hz: float = 5.0  # random poses per second
    order: int = 5  # of the B-spline; its degree is one less
    segments_per_s: float = 5.0  # polynomial pieces per second: ESIM's 100 in 20 s
    smoothing: float = 0.0036  # [s^3], weight of the integrated squared second derivative
    multiplier_xyz_m: Vector3 = (3.2, 3.2, 3.6)
    multiplier_rot_rad: Vector3 = (0.5, 0.5, 2.0)
    offset_xyz_m: Vector3 = (0.0, 0.0, 0.0)
    offset_rot_rad: Vector3 = (0.0, 0.0, 0.0)
    max_radius_m: float = 4.0  # horizontally from the origin: keeps clear of cameras 5 m away

    def __post_init__(self) -> None:
        check_numbers(self, "", ("duration_s", "sampling_hz", "segments_per_s", "smoothing"))
        for name in ("multiplier_xyz_m", "multiplier_rot_rad", "offset_xyz_m", "offset_rot_rad"):
            if not np.isfinite(getattr(self, name)).all():
                raise SimError(f"{name} must be three finite numbers, got {getattr(self, name)}")
        if self.order < 3:
            raise SimError(f"the spline's order must be at least 3, got {self.order}")
        if self.duration_s * self.sampling_hz < 2:
            raise SimError(
                f"{self.duration_s} s at {self.sampling_hz} random poses per second is fewer than "
                "2 poses: raise duration_s or sampling_hz"
            )


@dataclass(frozen=True)
class Trajectory:
    """A drone's pose over time, from 0 to `duration_s`."""

    duration_s: float
    position: Callable[[FloatArray], FloatArray]  # (n,) [s] -> (n, 3) [m], frame W
    attitude: Attitude  # (n,) [s] -> n rotations, frame B to frame W

    def poses(self, times_s: FloatArray) -> FloatArray:
        """Return T_W_B (n, 4, 4), body to world [m], at times (n,) [s] in any order.

        SimError when a time lies outside [0, `duration_s`] or is NaN: nothing is extrapolated.
        """
        times_s = np.asarray(times_s, dtype=np.float64)
        outside = ~((times_s >= 0.0) & (times_s <= self.duration_s))
        if outside.any():
            raise SimError(
                f"the trajectory is defined from 0 to {self.duration_s:g} s, "
                f"asked for its pose at {times_s[outside][0]:g} s"
            )
        T_W_B = np.zeros((len(times_s), 4, 4))
        T_W_B[:, :3, :3] = self.attitude(times_s).as_matrix()
        T_W_B[:, :3, 3] = self.position(times_s)
        T_W_B[:, 3, 3] = 1.0
        return T_W_B


@dataclass(frozen=True)
class PosesAt:
    """Poses at many times, indexed like an array (n, 4, 4) but computed on demand."""

    trajectory: Trajectory
    times_s: FloatArray  # (n,) [s]

    def __getitem__(self, which: slice | IntArray) -> FloatArray:
        """Return T_W_B (m, 4, 4) at the m chosen times."""
        return self.trajectory.poses(self.times_s[which])


def random_spline(config: SplineConfig, rng: np.random.Generator) -> Trajectory:
    """Draw a random smooth trajectory.

    As ESIM does (Rebecq et al., ESIM: an Open Event Camera Simulator, CoRL 2018; its trajectory
    factory): each of the six degrees of freedom (position, rotation vector) is drawn uniformly from
    [-1, 1] at regular times, times its multiplier, plus its offset, and smoothed by a B-spline.

    Deviation: a trajectory that leaves the circle of `max_radius_m` about the origin is drawn again
    (one in 40 by default); if it has more than `LONG_SEGMENTS` segments, only near where it
    leaves. SimError when none of MAX_DRAWS trajectories stays within the circle.
    """
    n_poses = round(config.duration_s * config.sampling_hz)
    times_s: FloatArray = np.linspace(0.0, config.duration_s, n_poses, dtype=np.float64)
    n_segments = max(1, round(config.duration_s * config.segments_per_s))
    multiplier = np.concatenate([config.multiplier_xyz_m, config.multiplier_rot_rad])
    offset = np.concatenate([config.offset_xyz_m, config.offset_rot_rad])
    values: FloatArray = np.empty((n_poses, 6))
    is_drawn: NDArray[np.bool_] = np.ones(n_poses, np.bool_)
    for _ in range(MAX_DRAWS):
        drawn = offset + multiplier * rng.uniform(-1.0, 1.0, (n_poses, 6))
        values = np.where(is_drawn[:, None], drawn, values)
        spline = _fit_smoothing_spline(times_s, values, config.order, n_segments, config.smoothing)
        position, turn = (BSpline(spline.t, c, spline.k) for c in np.split(spline.c, 2, axis=1))
        check_s = np.linspace(0.0, config.duration_s, 10 * n_segments)
        is_inside = np.hypot(*position(check_s)[:, :2].T) <= config.max_radius_m
        if is_inside.all():
            return Trajectory(config.duration_s, position, _attitude(turn))
        if n_segments > LONG_SEGMENTS:
            is_drawn = _near(check_s[~is_inside], times_s)
    raise SimError(
        f"{MAX_DRAWS} random trajectories all went more than {config.max_radius_m:g} m away from "
        "the origin: lower multiplier_xyz_m, raise smoothing or max_radius_m"
    )


def _attitude(rotation_vector: BSpline) -> Attitude:
    return lambda times_s: Rotation.from_rotvec(rotation_vector(times_s))


def _near(some_s: FloatArray, times_s: FloatArray) -> NDArray[np.bool_]:
    """Mark the regular times (n,), from 0 on, that lie within _REDRAWN_S of any of `some_s`."""
    step_s = times_s[1]
    reach = int(np.ceil(_REDRAWN_S / step_s))
    nearest = np.rint(some_s / step_s).astype(np.int64)
    is_near = np.zeros(len(times_s), np.bool_)
    is_near[np.clip(nearest[:, None] + np.arange(-reach, reach + 1), 0, len(times_s) - 1)] = True
    return is_near


def _fit_smoothing_spline(
    times_s: FloatArray, values: FloatArray, order: int, n_segments: int, smoothing: float
) -> BSpline:
    """Fit a B-spline on uniform knots to noisy values, penalising its second derivative."""
    # It minimises sum_i |s(t_i) - v_i|^2 + smoothing [s^3] * integral of |s''(t)|^2 dt: the
    # functional that ESIM's lambda weighs (`initSpline3` of its B-splines).
    degree = order - 1
    segment_s = times_s[-1] / n_segments
    knots = segment_s * np.arange(-degree, n_segments + degree + 1)

    # The product of two second derivatives is of degree 2 (degree - 2) on each segment, for which
    # Gauss-Legendre quadrature with degree - 1 nodes is exact.
    nodes, weights = np.polynomial.legendre.leggauss(degree - 1)
    nodes_s = (np.arange(n_segments)[:, None] + 0.5 * (nodes + 1.0)).ravel() * segment_s
    weights_s = np.tile(0.5 * weights * segment_s, n_segments)
    if n_segments > LONG_SEGMENTS:
        about = (knots, degree, nodes_s, smoothing * weights_s)
        return BSpline(knots, _solved_sparse(times_s, values, *about), degree)
    basis = BSpline(knots, np.eye(n_segments + degree), degree)
    curvature = basis.derivative(2)(nodes_s)
    penalty = curvature.T @ (weights_s[:, None] * curvature)
    design = basis(times_s)
    coefficients = np.linalg.solve(design.T @ design + smoothing * penalty, design.T @ values)
    return BSpline(knots, coefficients, degree)


def _solved_sparse(
    times_s: FloatArray,
    values: FloatArray,
    knots: FloatArray,
    degree: int,
    nodes_s: FloatArray,
    weights: FloatArray,
) -> FloatArray:
    """Solve for the coefficients by sparse matrices: time and memory linear in the duration."""
    n = len(knots) - degree - 1  # coefficients
    design: Any = BSpline.design_matrix(times_s, knots, degree, extrapolate=True)
    # The second derivative is a spline of degree - 2, whose coefficients are second differences.
    differences: Any = diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(n - 2, n))
    bent: Any = BSpline.design_matrix(nodes_s, knots[2:-2], degree - 2)
    curvature = bent @ differences / (knots[1] - knots[0]) ** 2
    penalty = curvature.T @ curvature.multiply(weights[:, None])
    coefficients: FloatArray = spsolve((design.T @ design + penalty).tocsc(), design.T @ values)
    return coefficients


CSV_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")  # [s], [m], unit quaternion T_W_B
MIN_CSV_ROWS = 4  # a cubic spline needs four points
MAX_CSV_DURATION_S = 1e6  # longer than this, the times are not seconds (ESIM writes nanoseconds)


def trajectory_from_csv(path: Path) -> Trajectory:
    """Read a trajectory from a CSV file and interpolate it smoothly.

    Columns are t [s], x, y, z [m], qx, qy, qz, qw (attitude T_W_B, scalar last, of any norm), in
    this order, or in any order under a header that names them. `#` starts a comment. Position is a
    cubic spline through the rows, attitude scipy's `RotationSpline`. The first row's time becomes
    0. SimError, with the line, for a file that is no such table of 4 rows or more.
    """
    line_numbers, table = _read_table(path)
    times_s, quaternions = table[:, 0], table[:, 4:]
    for i in np.flatnonzero(np.diff(times_s) <= 0)[:1]:
        raise SimError(
            f"{path}, line {line_numbers[i + 1]}: times must increase from row to row, but "
            f"{times_s[i + 1]:.9g} s follows {times_s[i]:.9g} s: sort the rows and drop repeats"
        )
    for i in np.flatnonzero(np.linalg.norm(quaternions, axis=1) < 1e-9)[:1]:
        raise SimError(
            f"{path}, line {line_numbers[i]}: the quaternion (qx, qy, qz, qw) is zero: "
            "for no rotation write 0, 0, 0, 1"
        )
    times_s = times_s - times_s[0]
    if times_s[-1] > MAX_CSV_DURATION_S:
        raise SimError(
            f"{path}: times must be in seconds, but the rows span {times_s[-1]:.3g} s: "
            "divide by 1e9 if they are ESIM's nanoseconds"
        )
    return Trajectory(
        duration_s=float(times_s[-1]),
        position=CubicSpline(times_s, table[:, 1:4]),
        attitude=cast(Attitude, RotationSpline(times_s, Rotation.from_quat(quaternions))),
    )


def trajectory_to_csv(trajectory: Trajectory, path: Path, rate_hz: float) -> None:
    """Write a trajectory in the format that `trajectory_from_csv` reads, over any existing file.

    There are at least `rate_hz` rows per second; both ends of the trajectory are rows.
    """
    n_rows = max(MIN_CSV_ROWS, int(np.ceil(trajectory.duration_s * rate_hz)) + 1)
    times_s: FloatArray = np.linspace(0.0, trajectory.duration_s, n_rows, dtype=np.float64)
    T_W_B = trajectory.poses(times_s)
    quaternions = Rotation.from_matrix(T_W_B[:, :3, :3]).as_quat()
    table = np.column_stack([times_s, T_W_B[:, :3, 3], quaternions])
    # 17 digits give back every float64 exactly.
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header=",".join(CSV_COLUMNS), comments="")


def _read_table(path: Path) -> tuple[list[int], FloatArray]:
    """Return the line number of each data row and the (n, 8) table in the order of CSV_COLUMNS."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")  # spreadsheets write a byte-order mark
    except (OSError, UnicodeDecodeError) as error:
        raise SimError(f"cannot read the trajectory {path}: {error}") from error
    lines = enumerate((line.split("#")[0] for line in text.splitlines()), start=1)
    rows = {n: [field.strip() for field in line.split(",")] for n, line in lines if line.strip()}
    header, first = list(CSV_COLUMNS), next(iter(rows), 0)
    if rows and rows[first][0].isidentifier():  # a name, not a number
        header = rows.pop(first)
    wanted = ", ".join(CSV_COLUMNS)
    missing = [name for name in CSV_COLUMNS if name not in header]
    if missing:
        raise SimError(
            f"{path}, line {first}: the header lacks {', '.join(missing)}: expected {wanted}"
        )
    table = []
    for number, fields in rows.items():
        try:
            table.append([float(field) for field in fields])
        except ValueError:
            table.append([math.nan])
        if len(table[-1]) != len(header) or not np.isfinite(table[-1]).all():
            raise SimError(
                f"{path}, line {number}: expected {len(header)} finite numbers with commas between "
                f"({', '.join(header)}), got {', '.join(fields)}: correct or delete this row"
            )
    if len(rows) < MIN_CSV_ROWS:
        raise SimError(f"{path}: expected {MIN_CSV_ROWS} rows or more of {wanted}, got {len(rows)}")
    return list(rows), np.array(table)[:, [header.index(name) for name in CSV_COLUMNS]]
