"""A CSV file to a drone's trajectory, and back.

Frames as in `sim.scene.trajectory`.
"""

import math
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from sim.errors import SimError
from sim.scene.trajectory import Attitude, Trajectory

FloatArray = NDArray[np.float64]

CSV_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")  # [s], [m], unit quaternion T_W_B
MIN_CSV_ROWS = 4  # a cubic spline needs four points
MAX_CSV_DURATION_S = 1e6  # longer than this, the times are not seconds (ESIM writes nanoseconds)


def trajectory_from_csv(path: Path) -> Trajectory:
    """Read a trajectory from a CSV file and interpolate it smoothly.

    Position is a cubic spline through the rows, attitude scipy's `RotationSpline`: velocity and
    acceleration, linear and angular, are continuous. The first row's time becomes 0.

    Parameters
    ----------
    path
        Columns t [s], x, y, z [m], qx, qy, qz, qw (attitude T_W_B, scalar last, of any norm), in
        this order, or in any order under a header that names them. `#` starts a comment. Note that
        ESIM's own files have the same columns but times in nanoseconds.

    Returns
    -------
    Trajectory

    Raises
    ------
    SimError
        When the file cannot be read, a column or a value is missing or is not a number, times do
        not increase, a quaternion is zero, or there are fewer than 4 rows.
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
    """Write a trajectory in the format that `trajectory_from_csv` reads.

    Parameters
    ----------
    trajectory
    path
        Overwritten when it exists.
    rate_hz
        Rows per second, at least; both ends of the trajectory are rows.

    Raises
    ------
    SimError
        When `rate_hz` is not positive.
    """
    if not rate_hz > 0:
        raise SimError(f"rate_hz must be positive, got {rate_hz}")
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
        text = Path(path).read_text(encoding="utf-8-sig")  # spreadsheets begin with a mark
    except (OSError, UnicodeDecodeError) as error:
        raise SimError(f"cannot read the trajectory {path}: {error}") from error
    lines = [line.split("#")[0] for line in text.splitlines()]
    rows = {
        number: [field.strip() for field in line.split(",")]
        for number, line in enumerate(lines, start=1)
        if line.strip()
    }
    header = list(CSV_COLUMNS)
    first = next(iter(rows), 0)
    if rows and rows[first][0].isidentifier():  # a name, not a number
        header = rows.pop(first)
    wanted = ", ".join(CSV_COLUMNS)
    missing = [name for name in CSV_COLUMNS if name not in header]
    if missing:
        raise SimError(
            f"{path}, line {first}: the header lacks {', '.join(missing)}: expected {wanted}"
        )
    for number, fields in rows.items():
        if len(fields) != len(header) or not all(map(_is_finite_number, fields)):
            raise SimError(
                f"{path}, line {number}: expected {len(header)} finite numbers with commas between "
                f"({', '.join(header)}), got {', '.join(fields)}: correct or delete this row"
            )
    if len(rows) < MIN_CSV_ROWS:
        raise SimError(f"{path}: expected {MIN_CSV_ROWS} rows or more of {wanted}, got {len(rows)}")
    table = np.array(list(rows.values()), dtype=np.float64)
    return list(rows), table[:, [header.index(name) for name in CSV_COLUMNS]]


def _is_finite_number(field: str) -> bool:
    try:
        return math.isfinite(float(field))
    except ValueError:
        return False
