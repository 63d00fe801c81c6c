"""The files of a folder of results: CSVs, PNGs and pages, how they are written and read again.

A checksum of each stands in `SHA256SUMS`, in the form that `sha256sum --check` takes. Every command
that writes results notes them there, so a file that was changed by hand, or by a command that was
stopped, does not agree.
"""

import fcntl
import hashlib
import io
import json
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ssac.arrays import Array
from ssac.errors import SsacError
from ssac.files.whole_file import whole_file

if TYPE_CHECKING:  # heavy, and `ssac simulate` needs none of them
    import pandas as pd
    from matplotlib.figure import Figure

PROVENANCE = ".provenance.json"

MERGED = "ssac merge"
"""Command of what was joined from shards: it has the provenance of each."""

SUMS_FILE = "SHA256SUMS"

DIGITS = 6
"""That the numbers of a table have."""

DPI = 220

_PALETTE_SIZE = 96  # colours of a PNG: a third of the bytes, and no difference to be seen


@dataclass(frozen=True)
class Results:
    """The CSVs, provenances and pages of one folder, each read once; what is missing is one error.

    Its rows are those whose columns have the given values, of which there is one at least.
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
        """Return rows of a table."""
        rows = self.table(name)
        for column, value in where.items():
            rows = rows[self._column(rows, name, column) == value]
        if rows.empty:
            wanted = ", ".join(f"{column} = {value}" for column, value in where.items())
            raise SsacError(f"{self.folder / name}.csv: no row with {wanted}")
        return rows

    def one(self, name: str, /, **where: Any) -> "pd.Series[Any]":
        """Return the one row that these values single out."""
        rows = self.rows(name, **where)
        if len(rows) != 1:
            raise SsacError(f"{self.folder / name}.csv: {len(rows)} rows with {where}, not one")
        return rows.iloc[0]

    def value(self, name: str, column: str, /, **where: Any) -> float:
        """Return the number of the one row that these values single out."""
        return float(self._column(self.one(name, **where), name, column))

    def column(self, name: str, column: str, /, **where: Any) -> Array:
        """Return a column's numbers in these rows, NaN where a cell is empty."""
        values: Array = self._column(self.rows(name, **where), name, column).to_numpy(float)
        return values

    def provenances(self, name: str) -> list[dict[str, Any]]:
        """Read what `<name>` was made with: once, or once for each shard that was merged."""
        file = f"{name}{PROVENANCE}"
        try:
            content = json.loads(self.text(file))
            return content["shards"] if content.get("command") == MERGED else [content]
        except (ValueError, AttributeError, KeyError) as error:
            raise SsacError(f"{self.folder / file} holds no provenance: {error}") from error

    def minutes(self, name: str) -> float:
        """Return the wall time of the command that wrote `<name>.csv`, by its provenance."""
        return float(self.provenances(name)[0]["wall_time_s"]) / 60.0

    def _column(self, rows: Any, name: str, column: str) -> Any:
        if column not in rows:
            raise SsacError(f"{self.folder / name}.csv: no column {column}")
        return rows[column]


def csv_text(table: "pd.DataFrame", digits: int = DIGITS) -> str:
    """Write a table as the project's CSV: an empty cell where unknown, lists as JSON."""
    lists = {
        name: table[name].map(json.dumps)
        for name in table.columns
        if table[name].dtype == object
        and table[name].map(lambda value: isinstance(value, (list, tuple))).any()
    }
    written = table.assign(**lists)
    return written.to_csv(index=False, float_format=f"%.{digits}g", lineterminator="\n")


def read_table(text: str) -> "pd.DataFrame":
    """Read a table as `csv_text` wrote it; an empty cell is unknown."""
    import pandas as pd

    return pd.read_csv(
        io.StringIO(text), keep_default_na=False, na_values=[""], float_precision="round_trip"
    )


def save_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def png_bytes(figure: "Figure") -> bytes:
    """Draw a figure as a PNG with a palette, without the time and the program's version."""
    from PIL import Image

    whole, small = io.BytesIO(), io.BytesIO()
    figure.savefig(whole, format="png", dpi=DPI, metadata={"Software": None})
    whole.seek(0)
    with Image.open(whole) as image:
        # Without dithering, whose specks look like data.
        reduced = image.convert("RGB").quantize(_PALETTE_SIZE, dither=Image.Dither.NONE)
        reduced.save(small, format="PNG", optimize=True)
    return small.getvalue()


def record_checksums(folder: Path, paths: Iterable[Path]) -> None:
    """Note what files of results are now, each with its provenance; notes on others stay."""
    with _alone(folder):
        sums = read_checksums(folder) if (folder / SUMS_FILE).exists() else {}
        for path in paths:
            beside = path.with_suffix(PROVENANCE)
            for one in {path, beside} if beside.exists() else {path}:
                sums[one.relative_to(folder).as_posix()] = sha256(one)
        kept = {name: digest for name, digest in sums.items() if (folder / name).exists()}
        lines = [f"{digest}  {name}\n" for name, digest in sorted(kept.items())]
        save_text(folder / SUMS_FILE, "".join(lines))


def read_checksums(folder: Path) -> dict[str, str]:
    """Read the notes of a folder, name -> digest; SsacError where there are none to be read."""
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
    """Digest of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other commands from changing the notes meanwhile."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
