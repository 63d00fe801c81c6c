"""Files of paths in space: TUM, `t x y z qx qy qz qw`, and comma-separated values.

The csv form has a first line that names its columns: `t_s,x_m,y_m,z_m`, and optionally the
deviations `sigma_x_m,sigma_y_m,sigma_z_m`; each is taken without its `_m` too, and for times, in
seconds, `t`, `time`, `time_s` and `timestamp`. A TUM file has no place for deviations; where the
attitude is unknown it says `0 0 0 1` in each row. Where the scale is unknown, the unit is not a
metre but the distance between cameras 1 and 2, and names are written without `_m`.
"""

import csv
import pathlib
from dataclasses import dataclass

import numpy as np

from ssac.arrays import Array
from ssac.errors import SsacError
from ssac.files.damage import check_is_file, is_number, readable
from ssac.files.whole_file import whole_file
from ssac.points import disorder_of

PATH_COLUMNS = ("t_s", "x_m", "y_m", "z_m")
DEVIATION_COLUMNS = ("sigma_x_m", "sigma_y_m", "sigma_z_m")
ATTITUDE_COLUMNS = ("qx", "qy", "qz", "qw")
CSV_SUFFIX = ".csv"

_OTHER_NAMES = {
    **dict.fromkeys(("t", "time", "time_s", "timestamp"), PATH_COLUMNS[0]),
    **{name.removesuffix("_m"): name for name in (*PATH_COLUMNS[1:], *DEVIATION_COLUMNS)},
}
_GLOBE = ("lat", "lon", "lng")
_WANTED = (*PATH_COLUMNS, *DEVIATION_COLUMNS, *ATTITUDE_COLUMNS)
_TUM_COLUMNS = (*PATH_COLUMNS, *ATTITUDE_COLUMNS)
_NO_ATTITUDE = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Path:
    """The object's path: positions and what is known of their times and of the attitude."""

    times_s: Array  # (n,) ascending; all NaN: not known
    positions_m: Array  # (n, 3)
    deviations_m: Array | None = None  # (n, 3) along x, y and z; None: not known
    quaternions: Array | None = None  # (n, 4) qx, qy, qz, qw: body to frame; None: not known

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def has_times(self) -> bool:
        """Whether the times are known."""
        return bool(np.isfinite(self.times_s).all())


def read_path(file: pathlib.Path | str, needs_times: bool = True) -> Path:
    """Read a path, TUM or comma-separated.

    Rows are `t x y z qx qy qz qw`, `t x y z` or, where no times are needed, `x y z`; or the first
    line names the columns. SsacError, which names the file, if it is missing, is not of numbers,
    is not in time order, or has degrees of latitude and longitude.
    """
    file = pathlib.Path(file)
    check_is_file(file)
    columns = _columns(file)
    finite = np.isfinite(np.column_stack([*columns.values()])).all(axis=1)
    times_s = columns.get(PATH_COLUMNS[0])
    said = ""
    if not finite.all():
        k = int(np.argmin(finite))
        said = f"point {k} has a value that is no finite number: leave the row out"
    elif times_s is None and needs_times:
        said = "a path needs times: put t_s (seconds) before x y z, as its first column"
    elif times_s is not None:
        said = disorder_of(times_s) or _fault_of_steps(np.diff(times_s))
    positions = np.column_stack([columns[name] for name in PATH_COLUMNS[1:]])
    said = said or _fault_of_metres(positions)
    quaternions = _stacked(columns, ATTITUDE_COLUMNS)
    if quaternions is not None and np.all(quaternions == _NO_ATTITUDE):
        quaternions = None
    if quaternions is not None and not np.linalg.norm(quaternions, axis=1).all():
        said = said or "a quaternion is zero: for no attitude write 0 0 0 1 in each row"
    if said:
        raise SsacError(f"{file}: {said}")
    times_s = np.full(len(positions), np.nan) if times_s is None else times_s
    return Path(times_s, positions, _stacked(columns, DEVIATION_COLUMNS), quaternions)


def _stacked(columns: dict[str, Array], names: tuple[str, ...]) -> Array | None:
    """Columns side by side (n, k); None unless all are there."""
    there = set(names) <= set(columns)
    return np.column_stack([columns[name] for name in names]) if there else None


def write_path(file: pathlib.Path | str, path: Path, in_metres: bool = True) -> None:
    """Write a path, as csv if the name ends in .csv, else as TUM; the file appears complete.

    `in_metres` is False where the scale is unknown, and the columns of a csv name no unit.
    """
    file = pathlib.Path(file)
    columns = [path.times_s, *path.positions_m.T]
    if file.suffix.lower() == CSV_SUFFIX:
        names = [*PATH_COLUMNS]
        if path.deviations_m is not None:
            names += DEVIATION_COLUMNS
            columns += [*path.deviations_m.T]
        names = names if in_metres else [name.removesuffix("_m") for name in names]
        header, separator, form = ",".join(names), ",", ["%.7f"] + ["%.9g"] * (len(columns) - 1)
    else:
        none = np.tile(_NO_ATTITUDE, (len(path), 1))
        columns += [*(none if path.quaternions is None else path.quaternions).T]
        header, separator, form = "", " ", ["%.7f"] + ["%.9g"] * 7
    with whole_file(file) as temporary:
        rows = np.column_stack(columns)
        np.savetxt(temporary, rows, fmt=form, delimiter=separator, header=header, comments="")


def _columns(file: pathlib.Path) -> dict[str, Array]:
    """Read the known columns (n,), n > 0, of a file by their standard names."""
    rows = rows_of(file, "a text file of a path")
    has_header = bool(rows) and not all(map(is_number, rows[0]))
    if len(rows) <= has_header:
        raise SsacError(f"{file}: there are no points: give a path of some")
    names = _names(rows[0], has_header, file)
    kept = {name: names.index(name) for name in _WANTED if name in names}
    numbers = np.empty((len(rows) - has_header, len(kept)))
    for k, row in enumerate(rows[has_header:]):
        if len(row) != len(names) or not all(is_number(row[column]) for column in kept.values()):
            raise SsacError(
                f"{file}: every row of a path must be {len(names)} numbers, but point {k} is "
                f"{' '.join(row)[:60]!r}: correct or remove the row"
            )
        numbers[k] = [float(row[column]) for column in kept.values()]
    return dict(zip(kept, numbers.T, strict=True))


def rows_of(file: pathlib.Path, kind: str) -> list[list[str]]:
    """Return the cells of all lines but comments, which commas or else blanks part."""
    with readable(file, kind, "give one"):
        lines = [line.strip() for line in file.read_text(encoding="utf-8-sig").splitlines()]
        return [
            [cell.strip() for cell in next(csv.reader([line]))] if "," in line else line.split()
            for line in lines
            if line and not line.startswith("#")
        ]


def _names(row: list[str], is_header: bool, file: pathlib.Path) -> list[str]:
    """Return the columns' standard names, from the first line or from their number."""
    if not is_header:
        by_count = {len(one): [*one] for one in (PATH_COLUMNS[1:], PATH_COLUMNS, _TUM_COLUMNS)}
        if len(row) in by_count:
            return by_count[len(row)]
        raise SsacError(
            f"{file}: a row of a path is `t x y z qx qy qz qw`, `t x y z` or `x y z`, got"
            f" {len(row)} numbers: convert the file"
        )
    words, said = [word.lower() for word in row], ",".join(row)
    others = {word: name for word, name in _OTHER_NAMES.items() if name not in words}
    names = [others.get(word, word) for word in words]
    if any(name.startswith(_GLOBE) for name in names):
        raise SsacError(
            f"{file}: positions must be metres in a local frame, got {said[:60]!r}: "
            "turn latitude and longitude into east and north"
        )
    if not set(PATH_COLUMNS[1:]) <= set(names):
        raise SsacError(
            f"{file}: the first line of a path must name the columns {','.join(PATH_COLUMNS)}, got "
            f"{said[:60]!r}: add that line"
        )
    unknown = ", ".join(name for name in names if name not in _WANTED)
    if unknown and PATH_COLUMNS[0] not in names:
        raise SsacError(
            f"{file}: expected times in a column {PATH_COLUMNS[0]}, got the unknown columns "
            f"{unknown[:60]}: name the times, in seconds, {PATH_COLUMNS[0]}, or leave these out"
        )
    return names


def _fault_of_steps(steps_s: Array) -> str:
    if len(steps_s) and np.median(steps_s) > 1000.0:
        apart = f"points are {np.median(steps_s):g} s apart"
        return f"{apart}, as if times were of microseconds or the like: give seconds"
    return ""


def _fault_of_metres(positions: Array) -> str:
    """Describe positions that look like degrees beside metres of height; empty for others."""
    spans = np.ptp(positions, axis=0)
    level = np.abs(positions[:, :2]).max(axis=0)
    is_globe = level.max() <= 180.0 and level.min() > 0.0 and 0.0 < spans[:2].max() < 0.05
    if not (is_globe and spans[2] > 100.0 * spans[:2].max()):
        return ""
    return (
        f"x and y stay within {spans[:2].max():.2g} while z moves by {spans[2]:.2g}, "
        "as of degrees and metres: turn latitude and longitude into east and north in metres"
    )
