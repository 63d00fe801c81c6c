"""The files of a folder of results, which are CSVs, PNGs and pages: their writing and reading.

The checksum of each file stands in `SHA256SUMS`, in the form that `sha256sum --check` takes. Every
command that writes results updates it, so a file that was changed by hand, or by a command that was
stopped, does not agree with its checksum.
"""

import fcntl
import hashlib
import io
import json
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ssac.arrays import Array
from ssac.errors import SsacError
from ssac.files.whole_file import whole_file

if TYPE_CHECKING:  # slow to import, and `ssac simulate` needs neither
    import pandas as pd
    from matplotlib.figure import Figure

PROVENANCE = ".provenance.json"
MERGED = "ssac merge"  # command in the provenance of joined shards, which holds those of the shards
SUMS_FILE = "SHA256SUMS"
DIGITS = 6  # significant digits of a table's numbers
DPI = 220
File = tuple[str, bytes | None]  # name and content; None: there is to be no such file
_PALETTE_SIZE = 96  # colours of a PNG: a third of the bytes, and no difference to be seen


@dataclass(frozen=True, eq=False)
class Results:
    """The CSVs, provenances and pages of one folder, each read once; SsacError if one is missing.

    Rows are selected by the values of columns; SsacError if no row has the given values.
    """

    folder: Path
    _texts: dict[str, str] = field(default_factory=dict, repr=False)
    _tables: "dict[str, pd.DataFrame]" = field(default_factory=dict, repr=False)

    def text(self, file: str) -> str:
        """Read a file; SsacError when it cannot be read."""
        if file not in self._texts:
            path = self.folder / file
            try:
                self._texts[file] = path.read_bytes().decode("utf-8")
            except FileNotFoundError as error:
                raise SsacError(f"{path}: no such file: make it first") from error
            except (OSError, UnicodeDecodeError) as error:
                raise SsacError(f"{path} cannot be read: {error}") from error
        return self._texts[file]

    def table(self, name: str) -> "pd.DataFrame":
        """Read `<name>.csv`; an empty cell is NaN."""
        if name not in self._tables:
            self._tables[name] = read_table(self.text(f"{name}.csv"))
        return self._tables[name]

    def rows(self, name: str, /, **where: Any) -> "pd.DataFrame":
        """Return the rows of a table whose columns have the values of `where`."""
        rows = self.table(name)
        for column, value in where.items():
            rows = rows[self._column(rows, name, column) == value]
        if rows.empty:
            wanted = ", ".join(f"{column} = {value}" for column, value in where.items())
            raise SsacError(f"{self.folder / name}.csv: no row with {wanted}")
        return rows

    def one(self, name: str, /, **where: Any) -> "pd.Series[Any]":
        """Return the only row with these values; SsacError if there are several."""
        rows = self.rows(name, **where)
        if len(rows) != 1:
            raise SsacError(f"{self.folder / name}.csv: {len(rows)} rows with {where}, not one")
        return rows.iloc[0]

    def value(self, name: str, column: str, /, **where: Any) -> float:
        """Return the number in a column of the only row with these values."""
        return float(self._column(self.one(name, **where), name, column))

    def column(self, name: str, column: str, /, **where: Any) -> Array:
        """Return a column's numbers (n,) in the rows with these values; an empty cell is NaN."""
        values: Array = self._column(self.rows(name, **where), name, column).to_numpy(float)
        return values

    def provenances(self, name: str) -> list[dict[str, Any]]:
        """Read the provenance of `<name>`: one, or one of each shard that was merged."""
        file = f"{name}{PROVENANCE}"
        try:
            content = json.loads(self.text(file))
            return content["shards"] if content.get("command") == MERGED else [content]
        except (ValueError, AttributeError, KeyError) as error:
            raise SsacError(f"{self.folder / file} holds no provenance: {error}") from error

    def minutes(self, name: str) -> float:
        """Return the wall time [min] of the commands that wrote `<name>.csv`, by its provenance."""
        return sum(float(one["wall_time_s"]) for one in self.provenances(name)) / 60.0

    def _column(self, rows: Any, name: str, column: str) -> Any:
        if column not in rows:
            raise SsacError(f"{self.folder / name}.csv: no column {column}")
        return rows[column]


def csv_text(table: "pd.DataFrame", digits: int = DIGITS) -> str:
    """Format a table as the project's CSV: an unknown value is an empty cell, a list is JSON."""
    lists = {
        name: table[name].map(json.dumps)
        for name in table.columns
        if table[name].dtype == object
        and table[name].map(lambda value: isinstance(value, (list, tuple))).any()
    }
    written = table.assign(**lists)
    return written.to_csv(index=False, float_format=f"%.{digits}g", lineterminator="\n")


def read_table(text: str) -> "pd.DataFrame":
    """Read a table that `csv_text` wrote; an empty cell is NaN."""
    import pandas as pd

    return pd.read_csv(
        io.StringIO(text), keep_default_na=False, na_values=[""], float_precision="round_trip"
    )


def save_text(path: Path, text: str) -> None:
    """Write a text file, which appears under its name only when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def png_bytes(figure: "Figure") -> bytes:
    """Draw a figure as a PNG with a palette, without the time and the program's version."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure.set_dpi(DPI)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()  # once; savefig draws twice, to know a box that is not asked for
    image = Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba())
    small = io.BytesIO()
    # No dithering: its specks look like data.
    reduced = image.convert("RGB").quantize(_PALETTE_SIZE, dither=Image.Dither.NONE)
    reduced.save(small, format="PNG", optimize=True)
    return small.getvalue()


def save_files(out: Path, files: Iterable[File], has_sums: bool = True) -> list[Path]:
    """Write files as they come, so that one may follow from those before, then their checksums.

    Return the paths of all that were written, provenances aside.
    """
    out.mkdir(parents=True, exist_ok=True)
    written = []
    for name, content in files:
        path = out / name
        if content is None:
            path.unlink(missing_ok=True)
            continue
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
        written.append(path)
    if has_sums:
        record_checksums(out, written)
    return [path for path in written if not path.name.endswith(PROVENANCE)]


def record_checksums(folder: Path, paths: Iterable[Path]) -> None:
    """Update the checksums of some files; those of other files stay."""
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)  # until the file is closed, against other commands
        sums = read_checksums(folder) if (folder / SUMS_FILE).exists() else {}
        sums |= {path.relative_to(folder).as_posix(): sha256(path) for path in paths}
        kept = {name: digest for name, digest in sums.items() if (folder / name).exists()}
        lines = [f"{digest}  {name}\n" for name, digest in sorted(kept.items())]
        save_text(folder / SUMS_FILE, "".join(lines))
    finally:
        os.close(lock)


def read_checksums(folder: Path) -> dict[str, str]:
    """Read the checksums of a folder, name -> digest; SsacError where they cannot be read."""
    path = folder / SUMS_FILE
    try:
        lines = path.read_bytes().decode("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SsacError(f"{path} cannot be read: {error}") from error
    sums = {}
    for number, line in enumerate(lines, start=1):
        noted = re.fullmatch(r"([0-9a-f]{64})  (.+)", line)
        if noted is None:
            raise SsacError(f"{path}: line {number} is no digest and name: {line[:100]!r}")
        sums[noted[2]] = noted[1]
    return sums


def sha256(path: Path) -> str:
    """Return the SHA-256 digest of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
