"""Track files: comma-separated `t_s,x_px,y_px`, and optionally `sigma_px`.

Times [s] are on the camera's own clock, points [px] in the distorted image. Rows follow one object
in time order, with none while it is unseen. A ROS bag's topic of points serves too (`ros_bags`).
"""

import csv
from pathlib import Path

import numpy as np

from ssac.errors import SsacError
from ssac.files.damage import check_is_file, check_text, readable
from ssac.files.ros_bags import bag_of, load_track_bag, topic_of
from ssac.files.whole_file import whole_file
from ssac.points import PointTrack

TRACK_COLUMNS = ("t_s", "x_px", "y_px")
TRACK_SUFFIX = ".csv"
_SIGMA = "sigma_px"


def is_track_file(path: Path) -> bool:
    """Whether a file's extension and first line are a track's, or a bag's topic holds points."""
    if bag_of(path) is not None:
        return topic_of(path).is_track
    if path.suffix.lower() != TRACK_SUFFIX or not path.is_file():
        return False
    with path.open("rb") as file:
        first = file.readline(256).decode("utf-8", "replace")
    return not set(_names(first)).isdisjoint(TRACK_COLUMNS)


def load_track(path: Path | str) -> PointTrack:
    """Read a track file or a bag's topic of points; `ssac.points.check_track` checks its values."""
    import pandas as pd  # here, as it takes long: recordings of events do without it

    path = Path(path)
    if bag_of(path) is not None:
        return load_track_bag(path)
    check_is_file(path)
    check_text(path)
    with readable(path, "a track file, every row of which must be numbers"):
        with path.open(encoding="utf-8") as file:
            names = _names(file.readline(4096))
        if not set(TRACK_COLUMNS) <= set(names):
            raise SsacError(
                f"{path}: the first line of a track must name the columns "
                f"{','.join(TRACK_COLUMNS)}, got {','.join(names)[:60]!r}: add that line, "
                "with commas"
            )
        _check_fields(path, len(names))
        wanted = [*TRACK_COLUMNS, *([_SIGMA] if _SIGMA in names else [])]
        table = pd.read_csv(
            path,
            names=names,
            usecols=wanted,
            skiprows=1,
            skipinitialspace=True,
            quoting=csv.QUOTE_NONE,
            index_col=False,
        )
        columns = {name: table[name].to_numpy(dtype=np.float64) for name in wanted}
    points = np.column_stack([columns["x_px"], columns["y_px"]])
    return PointTrack(columns["t_s"], points, columns.get(_SIGMA))


def save_track(path: Path | str, track: PointTrack) -> None:
    """Write a track file, times to 0.1 us and points to 1e-4 px; it appears when complete."""
    names, columns = [*TRACK_COLUMNS], [track.times_s, *track.points_px.T]
    formats = ["%.7f", "%.4f", "%.4f"]
    if track.sigmas_px is not None:
        names, columns = [*names, _SIGMA], [*columns, track.sigmas_px]
        # Small deviations keep their digits, as 0 would be refused.
        formats.append("%.4g" if (track.sigmas_px < 1e-3).any() else "%.4f")
    header = ",".join(names)
    with whole_file(Path(path)) as temporary:
        np.savetxt(temporary, np.column_stack(columns), formats, ",", header=header, comments="")


def _check_fields(path: Path, n_columns: int) -> None:
    """Raise SsacError if a row has more fields than columns, as pandas drops the last ones."""
    with path.open(encoding="utf-8") as file:
        for k, line in enumerate(file):
            n_fields = line.rstrip(", \t\r\n").count(",") + 1
            if n_fields > n_columns:
                raise SsacError(
                    f"{path}: a row must have {n_columns} values, but point {k - 1} has "
                    f"{n_fields}, {line.strip()[:60]!r}: write decimals with a point"
                )


def _names(line: str) -> list[str]:
    return [word.strip().lower().lstrip("\ufeff").strip('"') for word in line.split(",")]
