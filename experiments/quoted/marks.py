"""Results of the marks of real recordings in, the tables that the pages show of them out."""

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.marks.kinds import CLOCKS, CLUTTER, INTRINSICS, KINDS, UNSTATED, Mark
from experiments.marks.table import FLIGHTS
from experiments.paper.markdown import markdown_table
from experiments.quoted.committed import Committed

MARKS = "marks"

Row = Mapping[Hashable, Any]


def clutter_table(results: Committed) -> str:
    """Lay out what becomes of clutter: refusals, errors beside marks, intervals, time."""
    body = [
        [
            str(row["kind"]),
            _answered(row),
            _reached(row),
            _most(row, "t_d_error_ms", 3),
            f"{row['t_d_std_ms']:.3f}" if np.isfinite(row["t_d_std_ms"]) else "",
            _most(row, "r_error_deg", 2),
            _held(row, ("t_d", "r", "t")),
            f"{row['confident_wrong']:.0f}",
            f"{row['cpu_s_most']:.1f}",
        ]
        for row in _rows(results, CLUTTER)
    ]
    header = ["kind", "answered", "mark", "t_d, most [ms]", "stated", "R, most [deg]"]
    header += ["held: t_d, R, t", "wrong", "processor, most [s]"]
    return markdown_table(header, body)


def clocks_table(results: Committed) -> str:
    """Lay out offsets and skews in the middle and at the ends, and what is said of jumps."""
    body = [
        [
            str(row["kind"]),
            _answered(row),
            _reached(row),
            _most(row, "t_d_error_ms", 3),
            f"{row['t_d_std_ms']:.3f}" if np.isfinite(row["t_d_std_ms"]) else "",
            _most(row, "skew_error_ppm", 1),
            f"{row['skew_std_ppm']:.1f}" if np.isfinite(row["skew_std_ppm"]) else "",
            _most(row, "ends_error_ms", 2),
            _held(row, ("t_d", "skew", "ends")),
        ]
        for row in _rows(results, CLOCKS)
    ]
    header = ["kind", "answered", "mark", "t_d, most [ms]", "stated", "skew, most [ppm]", "stated"]
    header += ["t_d at an end, most [ms]", "held: t_d, skew, ends"]
    return markdown_table(header, body)


def intrinsics_table(results: Committed) -> str:
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
    header += ["t_d, most [ms]", "R, most [deg]", "t, most [deg]"]
    return markdown_table(header, body)


def sensitivity_table(results: Committed) -> str:
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


def seconds(results: Committed, kind: str) -> str:
    """Say how long the processor was busy with a recording of a kind, at most."""
    return f"{results.value(MARKS, 'cpu_s_most', kind=kind):.1f} s"


def reached(results: Committed, kind: str) -> str:
    """Say how many runs of a kind meet its mark."""
    row = results.rows(MARKS, kind=kind).to_dict("records")[0]
    return f"{row['reached']:.0f} of {row['runs']:.0f}"


def rms(results: Committed, kind: str) -> str:
    """Say the rms error of t_d on recordings of a kind."""
    return f"{results.value(MARKS, 't_d_error_ms_rms', kind=kind):.3f} ms"


def jumps(results: Committed, kind: str) -> str:
    """Say how large the jumps are said to be, and when."""
    ends = [
        results.value(MARKS, f"jump_{what}_{end}", kind=kind)
        for what in ("ms", "at_s")
        for end in ("least", "most")
    ]
    return f"{ends[0]:.1f} to {ends[1]:.1f} ms, at {ends[2]:.1f} to {ends[3]:.1f} s"


def flights(_: Committed, scene: str) -> str:
    """Say on how many flights a scene was filmed."""
    return f"{FLIGHTS[scene]}"


def _rows(results: Committed, group: str) -> list[dict[Hashable, Any]]:
    return results.rows(MARKS, group=group).to_dict("records")


def _answered(row: Row) -> str:
    """Say how many were answered, and why others were not."""
    text = f"{row['answered']:.0f} of {row['runs']:.0f}"
    if pd.isna(row["refused"]) or not row["refused"]:
        return text
    return f"{text} ({str(row['refused']).replace(':', ' ').replace('_', ' ')})"


def _reached(row: Row) -> str:
    """Say what a kind's mark is, and how many meet it."""
    mark = KINDS[str(row["kind"])].mark
    return "" if mark is None else f"{_words(mark)}: {row['reached']:.0f}"


def _words(mark: Mark) -> str:
    if mark.must_refuse:
        return "refused"
    limits = ((mark.t_d_ms, "ms"), (mark.r_deg, "deg"), (mark.skew_ppm, "ppm"))
    words = ", ".join(f"{limit:g} {unit}" for limit, unit in limits if limit < np.inf)
    return f"{words}, or refused" if mark.may_refuse else words


def _most(row: Row, name: str, places: int) -> str:
    value = float(row[f"{name}_most"])
    return f"{value:.{places}f}" if np.isfinite(value) else ""


def _held(row: Row, names: tuple[str, ...]) -> str:
    return ", ".join(_share(row, name) for name in names) if row["answered"] else ""


def _share(row: Row, name: str) -> str:
    n_given = int(row[f"{name}_given"])
    return f"{row[f'{name}_held']:.0f} of {n_given}" if n_given else "none"


MARK_TABLES: Mapping[str, Callable[[Committed], str]] = {
    "table.marks.clutter": clutter_table,
    "table.marks.clocks": clocks_table,
    "table.marks.intrinsics": intrinsics_table,
    "table.marks.sensitivity": sensitivity_table,
}

MARK_NUMBERS: Mapping[str, Callable[[Committed], str]] = {
    **{f"marks.reached.{kind}": partial(reached, kind=kind) for kind in KINDS if KINDS[kind].mark},
    **{f"marks.seconds.{kind}": partial(seconds, kind=kind) for kind in KINDS},
    **{f"marks.rms.{kind}": partial(rms, kind=kind) for kind in KINDS},
    **{f"marks.jumps.{kind}": partial(jumps, kind=kind) for kind in KINDS if KINDS[kind].jump},
    **{f"marks.flights.{scene}": partial(flights, scene=scene) for scene in FLIGHTS},
}
