"""Results of the marks of real recordings in, the tables that the pages show of them out."""

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.markdown import markdown_table
from experiments.lab.results import Results
from experiments.marks.kinds import CLOCKS, CLUTTER, INTRINSICS, KINDS, UNSTATED, Mark
from experiments.marks.table import FLIGHTS

MARKS = "marks"

Row = Mapping[Hashable, Any]

_SHORTER = {"noise 10 Hz/px": "10 Hz/px", "clocks alike": "alike", "none looked for": "no skew",
            "no skew looked for": "no skew", ", skew ": ", ", "5 px drone": "5 px"}  # fmt: skip
"""Of words of kinds: a page is narrow."""


def clutter_table(results: Results) -> str:
    """Lay out what becomes of clutter: refusals, errors beside marks, intervals, time."""
    body = [
        [
            _shorter(str(row["kind"])),
            _answered(row),
            _reached(row),
            _most(row, "t_d_error_ms", 3),
            _told(row["t_d_std_ms"], 3),
            _most(row, "r_error_deg", 2),
            _held(row, ("t_d", "r", "t")),
            f"{row['cpu_s_most']:.1f}",
        ]
        for row in _rows(results, CLUTTER)
    ]
    header = ["kind", "answered", "mark", "t_d [ms]", "stated", "R [deg]", "held", "s"]
    return markdown_table(header, body)


def clocks_table(results: Results) -> str:
    """Lay out offsets and skews in the middle and at the ends, and what is said of jumps."""
    body = [
        [
            _shorter(str(row["kind"])),
            _answered(row),
            _reached(row),
            _most(row, "t_d_error_ms", 3),
            _told(row["t_d_std_ms"], 3),
            _most(row, "skew_error_ppm", 1),
            _told(row["skew_std_ppm"], 1),
            _most(row, "ends_error_ms", 2),
            _held(row, ("t_d", "skew", "ends")),
        ]
        for row in _rows(results, CLOCKS)
    ]
    header = ["kind", "answered", "mark", "t_d [ms]", "stated", "ppm", "stated", "ends", "held"]
    return markdown_table(header, body)


def intrinsics_table(results: Results) -> str:
    """Lay out which intervals hold where the rig's intrinsics are off, stated or not."""
    body = [
        [
            str(row["kind"]),
            _answered(row),
            *(_share(row, name) for name in ("t_d", "r", "t")),
            _most(row, "t_d_error_ms", 3),
            _most(row, "r_error_deg", 2),
            _most(row, "t_error_deg", 2),
        ]
        for row in _rows(results, INTRINSICS)
        if row["kind"] not in UNSTATED
    ]
    header = ["intrinsics", "answered", "t_d held", "R held", "t held"]
    header += ["t_d [ms]", "R [deg]", "t [deg]"]
    return markdown_table(header, body)


def sensitivity_table(results: Results) -> str:
    """Lay out how far unstated errors of the intrinsics move the estimate."""
    body = [
        [
            str(row["kind"]),
            *(
                f"{row[f'{name}_median']:.2f}, {row[f'{name}_most']:.2f}"
                for name in ("t_d_moved_ms", "r_moved_deg", "t_moved_deg")
            ),
        ]
        for row in _rows(results, INTRINSICS)
        if row["kind"] in UNSTATED
    ]
    return markdown_table(["error of the intrinsics", "t_d [ms]", "R [deg]", "t [deg]"], body)


def seconds(results: Results, kind: str) -> str:
    """Say how long the processor was busy with a recording of a kind, at most."""
    return f"{results.value(MARKS, 'cpu_s_most', kind=kind):.1f} s"


def reached(results: Results, kind: str) -> str:
    """Say how many runs of a kind meet its mark."""
    row = results.rows(MARKS, kind=kind).to_dict("records")[0]
    return f"{row['reached']:.0f} of {row['runs']:.0f}"


def rms(results: Results, kind: str) -> str:
    """Say the rms error of t_d on recordings of a kind."""
    return f"{results.value(MARKS, 't_d_error_ms_rms', kind=kind):.3f} ms"


def jumps(results: Results, kind: str) -> str:
    """Say how large the jumps are said to be, and when."""
    ends = [
        results.value(MARKS, f"jump_{what}_{end}", kind=kind)
        for what in ("ms", "at_s")
        for end in ("least", "most")
    ]
    return f"{ends[0]:.1f} to {ends[1]:.1f} ms, at {ends[2]:.1f} to {ends[3]:.1f} s"


def flights(_: Results, scene: str) -> str:
    """Say on how many flights a scene was filmed."""
    return f"{FLIGHTS[scene]}"


def _rows(results: Results, group: str) -> list[dict[Hashable, Any]]:
    return results.rows(MARKS, group=group).to_dict("records")


def _answered(row: Row) -> str:
    """Say how many were answered, and why others were not."""
    if pd.isna(row["refused"]) or not row["refused"]:
        return f"{row['answered']:.0f} of {row['runs']:.0f}"
    refused = str(row["refused"]).replace(":", " ").replace("_", " ")
    return f"{row['answered']:.0f}, {refused}" if row["answered"] else refused


def _shorter(kind: str) -> str:
    for words, fewer in _SHORTER.items():
        kind = kind.replace(words, fewer)
    return kind


def _reached(row: Row) -> str:
    """Say what a kind's mark is, and how many meet it."""
    mark = KINDS[str(row["kind"])].mark
    return "" if mark is None else f"{_words(mark)}: {row['reached']:.0f}"


def _words(mark: Mark) -> str:
    if mark.must_refuse:
        return "refused"
    limits = ((mark.t_d_ms, "ms"), (mark.r_deg, "deg"), (mark.skew_ppm, "ppm"))
    return ", ".join(f"{limit:g} {unit}" for limit, unit in limits if limit < np.inf)


def _most(row: Row, name: str, places: int) -> str:
    return _told(row[f"{name}_most"], places)


def _told(value: float, places: int) -> str:
    """Write a number; nothing where it is not known."""
    return f"{value:.{places}f}" if np.isfinite(value) else ""


def _held(row: Row, names: tuple[str, ...]) -> str:
    return ", ".join(f"{row[f'{name}_held']:.0f}" for name in names) if row["answered"] else ""


def _share(row: Row, name: str) -> str:
    n_given = int(row[f"{name}_given"])
    return f"{row[f'{name}_held']:.0f} of {n_given}" if n_given else "none"


MARK_TABLES: Mapping[str, Callable[[Results], str]] = {
    "table.marks.clutter": clutter_table,
    "table.marks.clocks": clocks_table,
    "table.marks.intrinsics": intrinsics_table,
    "table.marks.sensitivity": sensitivity_table,
}


def _name(words: str) -> str:
    """Make one word of some."""
    return words.replace(",", "").replace(" ", "_")


MARK_NUMBERS: Mapping[str, Callable[[Results], str]] = {
    **{
        f"marks.reached.{_name(kind)}": partial(reached, kind=kind)
        for kind in KINDS
        if KINDS[kind].mark
    },
    **{f"marks.seconds.{_name(kind)}": partial(seconds, kind=kind) for kind in KINDS},
    **{f"marks.rms.{_name(kind)}": partial(rms, kind=kind) for kind in KINDS},
    **{
        f"marks.jumps.{_name(kind)}": partial(jumps, kind=kind)
        for kind in KINDS
        if KINDS[kind].jump
    },
    **{f"marks.flights.{_name(scene)}": partial(flights, scene=scene) for scene in FLIGHTS},
}
