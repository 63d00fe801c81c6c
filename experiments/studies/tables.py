"""The paper's simulation tables: every method on every recording, beside what the paper gives."""

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Annotated, Any

import numpy as np
import pandas as pd

from experiments.drawing.errors import beyond_figure, error_figure, success_figure
from experiments.lab.cell import CRASHED
from experiments.lab.command import command_of
from experiments.lab.grid import Cell, changed
from experiments.lab.results import Results
from experiments.lab.scored import SCORED
from experiments.lab.study import Made, Runs, Study
from experiments.lab.summary import answered, digits, listed, markdown_table
from experiments.lab.verify import no_row, scored_checks
from experiments.paper import comparison as compared
from experiments.paper import esim
from experiments.paper.comparison import PUBLISHED_ERRORS, load_published
from experiments.paper.esim import DURATIONS_S, ERRORS, TABLES, Quantity, table_cells
from experiments.paper.page import results_page
from experiments.scenes.options import OPTIONS
from ssac.errors import SsacError

METHODS = ("ssac", "ssac-known", "joint", "joint-known", "tangency", "tangency-known")

PUBLISHED = {f"{one.method}.{ERRORS[one.error].symbol}": one.name for one in PUBLISHED_ERRORS}
"""Quantities of comparison.csv, by their names in those of quoted numbers."""

_SEARCH_MS = 1000.0 + 20.0  # searched on each side of the truth, and a unit of the coarsest method


def cells(
    renderer: Annotated[str, OPTIONS["renderer"].info] = "native",
    check: Annotated[bool, OPTIONS["check"].info] = True,
) -> list[Cell]:
    """List every run of the tables, with the columns that tell the runs apart there."""
    drawn_by = {"sim.render.renderer": renderer, "sim.render.check": check}
    return [
        changed(cell, {**drawn_by, "parameters": {
            "duration_s": cell.sim.spline.duration_s, "angle_deg": cell.sim.angle_deg,
            "t_d_ms": round(1e3 * cell.t_d_s, 6),
        }})
        for cell in table_cells()
    ]  # fmt: skip


# --- What is made of the runs ---


@lru_cache(maxsize=1)
def runs_of(results: Results) -> pd.DataFrame:
    """Read the runs."""
    runs = results.table("runs")
    absent = [column for column in esim.RUN_COLUMNS if column not in runs]
    if absent:
        raise SsacError(f"runs.csv: lacks the columns {listed(absent)}: run make tables again")
    return esim.ordered_runs(runs)


@lru_cache(maxsize=1)
def comparison(results: Results) -> pd.DataFrame:
    """Compare the paper's tables with ours of all flights, and of the first as many as it has."""
    runs = runs_of(results)
    first = esim.esim_tables(runs[runs["flight"] < compared.PUBLISHED_RUNS])
    published = load_published()
    return compared.comparison_table(esim.esim_tables(runs), published, first=first)


def page(results: Results) -> str:
    """Write `results/README.md`."""
    runs = runs_of(results)
    first, *_ = shards = results.provenances("runs")
    made_with = first | {
        "command": first["command"].partition(" --shard")[0],
        "wall_time_s": 60.0 * results.minutes("runs"),
        "recordings_simulated": sum(one["recordings_simulated"] for one in shards),
    }
    return results_page(runs, esim.esim_tables(runs), comparison(results), made_with)


def made_of_runs(file: str, make: Callable[[pd.DataFrame], Any]) -> Made:
    """Declare a file that is made of the runs alone."""
    return Made(file, lambda results: make(runs_of(results)))


# --- What must hold of any runs, whatever the methods find ---


_IMPOSSIBLE = f"not 0 <= t_d_error_ms <= {_SEARCH_MS} or t_d_estimate_ms != t_d_estimate_ms"


def _poses_at_times(results: Results) -> list[str]:
    ok = answered(results.table("runs"))
    poses = ok[list(esim.POSE_ERRORS)].notna().groupby(ok["method"]).mean()
    return list(poses.index[((poses > 0.0) & (poses < 1.0)).any(axis=1)])


CHECKS = (
    ("no run crashed", no_row("runs", f"status == '{CRASHED}'")),
    ("errors are possible ones", no_row("runs", f"status == 'ok' and ({_IMPOSSIBLE})")),
    ("a method gives a pose always or never", _poses_at_times),
    *scored_checks("runs"),
)


# --- What pages quote ---


_MANY = {"agrees": "agree", "better": "are better", "differs": "differ"}
_ONE = _MANY | {"agrees": "agrees", "better": "is better", "differs": "differs"}


def verdicts(results: Results, quantity: str) -> str:
    """Say how many cells of a published quantity agree, are better, and differ."""
    rows = results.rows("comparison", quantity=quantity)
    counts = {word: int((rows["verdict"] == word).sum()) for word in compared.VERDICTS}
    words = (f"{n} {(_ONE if n == 1 else _MANY)[word]}" for word, n in counts.items() if n)
    return f"of {len(rows)} cells {listed(words)}"


def ratio(results: Results, form: str, quantity: str, duration_s: float) -> str:
    """Give the ratio of our geometric mean over a table's cells to the paper's, or its interval."""
    row = results.one("comparison_summary", quantity=quantity, duration_s=duration_s)
    return form.format(**row, low=row["ratio"] / row["factor"], high=row["ratio"] * row["factor"])


def cell_means(results: Results, method: str, error: str) -> list[float]:
    """Return a method's mean errors in all cells of both tables."""
    return [v for name in TABLES for v in results.column(name, f"{method}_{error}_mean")]


def of_tangency(results: Results, error: Quantity, form: str) -> str:
    """Say how the mean errors of `tangency` compare with their mark and with the paper's SSAC."""
    papers = results.column("comparison", "published_mean", quantity=f"ssac_{error.column}")
    ours = np.array(cell_means(results, "tangency", error.column))  # in the same order
    return form.format(
        met=np.sum(ours <= error.mark), cells=len(ours), largest=ours.max(), unit=error.unit,
        share=ours.mean() / papers.mean(), most=(ours / papers).max(),
    )  # fmt: skip


def methods_table(results: Results) -> str:
    """Lay out the range of each method's mean errors over the cells of both tables."""
    rows = []
    for method in (*METHODS, "albl", "zncc_e", "zncc_f", "event_rate"):
        row = {"method": f"`{method}`"}
        for error, quantity in ERRORS.items():
            row[quantity.heading] = ""
            if f"{method}_{error}_mean" in results.table(TABLES[0]):  # the method gives it
                means = cell_means(results, method, error)
                row[quantity.heading] = f"{digits(np.nanmin(means))} to {digits(np.nanmax(means))}"
        rows.append(row)
    return markdown_table(pd.DataFrame(rows))


NUMBERS: Mapping[str, Callable[[Results], str]] = {
    "paper.size": lambda of: "{} of {} cells".format(
        (rows := of.rows("comparison", quantity=PUBLISHED["ssac.t_d"]))["paper_size_or_better"]
        .eq("yes")
        .sum(),
        len(rows),
    ),
    **{f"paper.{q}": partial(verdicts, quantity=quantity) for q, quantity in PUBLISHED.items()},
    **{
        f"paper.{what}.{q}.{d:g}": partial(ratio, form=form, quantity=PUBLISHED[q], duration_s=d)
        for what, form in (("ratio", "{ratio:.2f}"), ("interval", "{low:.2f} to {high:.2f}"))
        for q in ("ssac.t_d", "ssac.R", "ssac.t")
        for d in DURATIONS_S
    },
    "tables.runs": lambda of: f"{len(answered(of.table('runs')))} of {len(of.table('runs'))} runs",
    **{
        f"{name}.{error.symbol}": partial(of_tangency, error=error, form=form)
        for name, form in (
            ("tables.mark", "{met} of {cells} cells"),
            ("tables.largest", "{largest:.3f} {unit}"),
            ("paper.share", "{share:.2f} (at most {most:.2f})"),
        )
        for error in ERRORS.values()
    },
    "table.methods": methods_table,
}


STUDIES = (
    Study(
        "tables",
        "The paper's simulation tables, all methods",
        cells,
        SCORED,
        Runs("runs.csv", tuple(esim.KEY), columns=esim.RUN_COLUMNS, numbered=False),
        (
            *(
                made_of_runs(f"{name}.csv", partial(esim.esim_table, duration_s=duration_s))
                for name, duration_s in zip(TABLES, DURATIONS_S, strict=True)
            ),
            Made("comparison.csv", comparison),
            Made("comparison_summary.csv", lambda of: compared.summary_table(comparison(of))),
            Made("README.md", page),
            made_of_runs("error_vs_angle.png", lambda runs: error_figure(runs, load_published())),
            made_of_runs("beyond_paper.png", lambda runs: beyond_figure(runs, load_published())),
            made_of_runs("success.png", success_figure),
        ),
        numbers=NUMBERS,
        checks=CHECKS,
        config={grid.name: grid.content for grid in esim.table_grids()},
        command="ssac tables",
        shows="comparison_summary",
    ),
)

command = command_of(
    {"tables": STUDIES},
    "Regenerate the paper's simulation tables: every method on every recording.",
)
