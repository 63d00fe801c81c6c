"""Checks that committed results are complete, unchanged, and as they follow from their runs.

The expected files and rows follow from the studies and the code, never from the folder's content,
so that a missing file or row is noticed. Whatever is made from runs is made again from them.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from io import StringIO
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.cell import CRASHED, UNUSABLE, PlainCell
from experiments.lab.provenance import plain, processor, versions
from experiments.lab.results import (
    DIGITS,
    PROVENANCE,
    SUMS_FILE,
    Results,
    csv_text,
    read_checksums,
    read_table,
    sha256,
)
from experiments.lab.study import CELL, SHARD, Check, How, Made, Study, check_runs
from sim.errors import SimError
from ssac.errors import SsacError
from ssac.estimate import Status

_SHOWN = 5  # number of faults listed per finding
_CLEAN_COMMIT = re.compile(r"[0-9a-f]{7,40}")
_DRAWN_BY = ("matplotlib", "pillow", "numpy")  # packages that a figure's bytes depend on
_ROUNDING_MS = 1e-2  # to six digits: 5e-3 for an estimate above 1000 ms, less for its error
_ROUNDING_PPM = 1e-3  # likewise, above 100 ppm
_NO_REASON = ("ok", "spared")  # statuses of runs that lack nothing, or were not needed
_STATUSES = {*map(str, Status), *_NO_REASON, CRASHED, UNUSABLE, "skipped"}
_NOT_OF_CONFIG = ("study", SHARD, "options", "figure")
_OFFSETS = ("sim.t_d_s", "t_d_ms")  # columns on which a flight's recording does not depend

_UNLIKE = (
    OSError, SimError, SsacError, ValueError, LookupError, TypeError, AttributeError, NameError,
)  # fmt: skip
"""Errors of a check on a missing file, or on one with another structure than expected; of names, as
a query's without its column."""


@dataclass(frozen=True)
class Finding:
    """The result of one check."""

    what: str
    faults: tuple[str, ...] = ()  # empty: the check passed

    def lines(self) -> Iterator[str]:
        """Yield a line for the check, and one for each of the first faults."""
        yield f"{'differs' if self.faults else 'ok':8}{self.what}"
        yield from (f"        - {fault}" for fault in self.faults[:_SHOWN])
        if len(self.faults) > _SHOWN:
            yield f"        - and {len(self.faults) - _SHOWN} more"


def found(what: str, check: Callable[[], Iterable[str]]) -> Finding:
    """Run a check; a file that is missing or malformed is a fault."""
    try:
        return Finding(what, tuple(check()))
    except _UNLIKE as error:
        return Finding(what, (f"{type(error).__name__}: {' '.join(str(error).split())}",))


def file_findings(
    results: Path, studies: Iterable[Study], others: Mapping[str, str] | None = None
) -> Iterator[Finding]:
    """Check that exactly the expected files are there, unchanged; `others` belong to no study."""
    digests = dict(others or {})
    files = {*digests, SUMS_FILE}.union(*({*one.files, *one.provenances} for one in studies))
    there = {p.relative_to(results).as_posix() for p in results.rglob("*") if not p.is_dir()}
    yield Finding("every file that there must be is there", tuple(sorted(files - there)))
    yield Finding("no other file is there", tuple(sorted(there - files)))
    yield found(f"all files are as {SUMS_FILE} has them", lambda: _changed(results, files))
    for name, digest in digests.items():
        copied = partial(_copied_faults, results / name, digest)
        yield found(f"{name} is as it was copied", copied)


def study_findings(study: Study, results: Results) -> Iterator[Finding]:
    """Check a study's provenances, its rows, the files made from them, and its own conditions."""
    line = study.command_line(study.committed)
    for name, config in study.provenances.items():
        what = f"{name}: a clean commit, today's configuration, versions"
        yield found(what, partial(provenance_faults, results, name, line, config))
    if study.runs.file:
        what = f"{study.runs.file} has every run of {study.name} once, as it is written"
        yield found(what, partial(_runs_faults, study, results))
        runs = study.runs.file.removesuffix(".csv")
        what = f"{study.runs.file}: known statuses, reasons, estimates, no deviation below 0"
        yield found(what, partial(_senseless_rows, runs, results))
    for made in study.makes:
        if made.follows:
            what = f"{made.file} is as it follows from the results"
            yield found(what, partial(_made_faults, study, made, results))
    for what, check in study.checks:
        yield found(f"{study.name}: {what}", partial(check, results))


def shared_findings(studies: Iterable[Study], results: Results) -> Iterator[Finding]:
    """Check that runs that several studies share have the same values in all their files."""
    seen: dict[Any, tuple[str, Mapping[str, str]]] = {}
    for study in studies:
        if study.runs.file and study.how is How.SHARED:
            what = f"{study.runs.file} has the rows of other files where the runs are the same"
            yield found(what, partial(_unlike_others, study, results, seen))


def provenance_faults(
    results: Results, name: str, command: str, config: Mapping[str, Any]
) -> Iterator[str]:
    """Yield what is wrong with a file's provenance."""
    for one in results.provenances(name.removesuffix(PROVENANCE)):
        commit, line = str(one.get("commit")), str(one.get("command"))
        if not _CLEAN_COMMIT.fullmatch(commit):
            yield f"its commit is {commit}: commit the code, then make it again"
        if line.partition(f" --{SHARD}")[0] != command:
            yield f"it was made by `{line}`, expected `{command}`"
        there, expected = (
            {k: v for k, v in content.items() if k not in _NOT_OF_CONFIG}
            for content in (one["config"], plain(config))
        )
        if there != expected:
            both = {*there, *expected}
            wrong = sorted(key for key in both if there.get(key) != expected.get(key))
            yield f"its configuration is not today's: {', '.join(wrong)}"
        absent = set(versions()) - set(one["versions"])
        if absent:
            yield f"it lacks the versions of {', '.join(sorted(absent))}"
        if one["gl"] is not None and not {"backend", "renderer", "version"} <= set(one["gl"]):
            yield "it does not say which OpenGL drew"
        if not 0.0 <= one["wall_time_s"] < np.inf:
            yield f"it took {one['wall_time_s']} s"


def text_difference(committed: str, made: str) -> tuple[str, ...]:
    """Describe the first difference of two texts; empty if there is none."""
    pairs = zip_longest(committed.splitlines(), made.splitlines(), fillvalue="nothing")
    for number, (old, new) in enumerate(pairs, start=1):
        if old != new:
            return (f"line {number} is {_short(old)}", f"line {number} should be {_short(new)}")
    return () if committed == made else ("the ends of lines are not the same",)


def near(mine: float, other: float, digits: int) -> bool:
    """Whether two numbers differ by at most one unit of the last of `digits` significant digits."""
    if not np.isfinite(other):
        return False
    unit = 10.0 ** (np.floor(np.log10(abs(other))) + 1 - digits) if other else 0.0
    return bool(abs(mine - other) <= 1.001 * unit)  # 1.001: decimal units are not exact in binary


def no_row(name: str, wrong: str) -> Callable[[Results], list[str]]:
    """Make a check that no row of a table is wrong by an expression, as `DataFrame.query` takes it.

    No comparison is true of an empty cell, except that it is unlike all.
    """

    def check(results: Results) -> list[str]:
        rows = results.table(name).query(wrong).index
        return [f"{name}.csv, row {row}: {wrong}" for row in rows]

    return check


def _senseless_rows(name: str, results: Results) -> Iterator[str]:
    """Yield what no run may be, whatever its study measured, as far as the columns are there."""
    runs = results.table(name)
    wrong = {f"{one} is negative": runs[one] < 0.0 for one in runs if "_std" in str(one)}
    if "status" in runs:
        wrong["its status is unknown"] = ~runs["status"].isin(_STATUSES)
        if "reason" in runs:
            wrong["no reason"] = runs["reason"].isna() & ~runs["status"].isin(_NO_REASON)
        if "t_d_estimate_ms" in runs:
            has_none = runs["t_d_estimate_ms"].isna()
            wrong["ok without an estimate"] = has_none & (runs["status"] == "ok")
    for what, is_so in wrong.items():
        yield from (f"{name}.csv, row {row}: {what}" for row in runs.index[is_so])


def scored_checks(name: str) -> tuple[Check, ...]:
    """Make the checks of a file of scored runs (`lab.scored`) that hold for all methods."""

    def off(results: Results) -> list[str]:
        runs = results.table(name)
        t_d_ms = runs["t_d_ms"] if "t_d_ms" in runs else 1e3 * runs["sim.t_d_s"]
        off_ms = (runs["t_d_estimate_ms"] - t_d_ms).abs() - runs["t_d_error_ms"]
        wrong = ~(off_ms.abs() <= _ROUNDING_MS)
        if "skew_ppm" in runs:
            wrong |= _unlike_skews(runs)
        at = runs.index[wrong & runs["t_d_estimate_ms"].notna()]  # the others have no estimate
        return [f"{name}.csv, row {row}: its errors are not those of its estimate" for row in at]

    def recordings(results: Results) -> list[str]:
        runs = results.table(name)
        at = list(runs.columns[: runs.columns.get_loc("flight")])
        of = [one for one in at if not one.startswith("ssac.") and one not in (CELL, *_OFFSETS)]
        seen = runs[runs["status"] != CRASHED].groupby([*of, "flight"], dropna=False)
        counts = seen[["seed", "n_events_cam1", "n_events_cam2"]].nunique()
        several = counts.index[(counts > 1).any(axis=1)]
        return [f"{name}.csv, {key}: several numbers of events" for key in several]

    return (
        ("errors are those of the estimates", off),
        ("all runs on a flight saw the same events", recordings),
        *(("angles are angles", no_row(name, f"{one} < 0 or {one} > 180"))
          for one in ("r_error_deg", "t_error_deg")),
    )  # fmt: skip


def _unlike_skews(runs: pd.DataFrame) -> "pd.Series[bool]":
    """Return a mask (n,) of the runs whose skew errors do not follow from their estimates."""
    off_ppm = (runs["skew_ppm"] - runs.get("sim.skew_ppm", 0.0)).abs() - runs["skew_error_ppm"]
    wrong = off_ppm.abs() > _ROUNDING_PPM + 1e-5 * runs["skew_error_ppm"].abs()
    return wrong | off_ppm.isna() & (runs["skew_ppm"].notna() | runs["skew_error_ppm"].notna())


def _copied_faults(path: Path, digest: str) -> tuple[str, ...]:
    return () if sha256(path) == digest else ("it was changed",)


def _changed(results: Path, files: Iterable[str]) -> list[str]:
    sums = read_checksums(results)
    listed = {*files} - {SUMS_FILE}
    faults = [f"{name} is not listed" for name in sorted(listed - set(sums))]
    for name, digest in sums.items():
        path = results / name
        if not path.is_file():
            faults.append(f"{name} is listed, and is not there")
        elif sha256(path) != digest:
            faults.append(f"{name} was changed after it was written")
    return faults


def _runs_faults(study: Study, results: Results) -> tuple[str, ...]:
    kept, text = study.runs, results.text(study.runs.file)
    runs = read_table(text)
    if study.how is not How.GIVEN and kept.table is None:
        check_runs(study, runs, cells_of(study))
    if runs.duplicated(list(kept.keys)).any():
        raise SsacError(f"{kept.file}: {', '.join(kept.keys)} do not tell all runs apart")
    return text_difference(text, csv_text(runs, kept.digits))


@cache
def cells_of(study: Study) -> Sequence[PlainCell]:
    """Return a study's cells, which are listed only once."""
    return study.cells(**study.committed)


def _made_faults(study: Study, made: Made, results: Results) -> tuple[str, ...]:
    own = f"{made.file.partition('.')[0]}{PROVENANCE}"
    beside = own if own in study.provenances else next(iter(study.provenances))
    made_with = results.provenances(beside.removesuffix(PROVENANCE))
    here = versions()
    if made.file.endswith(".png"):
        if any(one["versions"].get(key) != here[key] for one in made_with for key in _DRAWN_BY):
            return ()  # drawn by other versions: its checksum must suffice
        same = (results.folder / made.file).read_bytes() == made.bytes_of(results)
        return () if same else ("it is another picture",)
    text, again = results.text(made.file), (made.bytes_of(results) or b"").decode()
    elsewhere = any(one.get("processor") != processor() for one in made_with)
    if made.file.endswith(".csv") and elsewhere:
        again = _with_last_digits_of(text, again)
    return text_difference(text, again)


def table_of_texts(text: str) -> pd.DataFrame:
    """Read a table with all cells as texts, exactly as in its file."""
    return pd.read_csv(StringIO(text), dtype=str, keep_default_na=False)


def _with_last_digits_of(text: str, again: str) -> str:
    """Return `again` with the numbers of `text` that differ by a unit of the last digit at most."""
    theirs, mine = table_of_texts(text), table_of_texts(again)
    if theirs.shape != mine.shape or list(theirs) != list(mine):
        return again
    for name in mine:
        a, b = (pd.to_numeric(one[name], errors="coerce") for one in (mine, theirs))
        is_near = [near(*pair, DIGITS) for pair in zip(a, b, strict=True)]
        mine[name] = mine[name].where(~np.array(is_near, dtype=bool), theirs[name])
    return csv_text(mine)


def _unlike_others(
    study: Study, results: Results, seen: dict[Any, tuple[str, Mapping[str, str]]]
) -> Iterator[str]:
    cells, file = cells_of(study), study.runs.file
    table = table_of_texts(results.text(file))
    if len(table) != len(cells):
        cells = [cell for cell in cells if getattr(cell, "method", "") in set(table["method"])]
    own = {CELL, *study.runs.took, *cells[0].columns}
    measured = table[[name for name in table if name not in own]]
    rows: list[dict[str, str]] = measured.to_dict("records")  # type: ignore[assignment]
    for number, (cell, row) in enumerate(zip(cells, rows, strict=True)):
        key = study.measure.row, cell.recordings, cell.inputs
        where, other = seen.setdefault(key, (f"{file}, row {number}", row))
        for name in row:
            if name in other and other[name] != row[name]:
                yield f"row {number}: {name} is {row[name]}, there {other[name]} ({where})"
                break


def _short(line: str) -> str:
    return line if len(line) <= 160 else f"{line[:157]}..."
