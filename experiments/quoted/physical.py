"""Results of the bench's twin in, the tables that its page shows out, each under a name.

Where a study was not run its tables are empty.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import partial

import pandas as pd

from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.paper.comparison import VERDICTS
from experiments.paper.quantities import ERRORS
from experiments.physical.budget import METHOD_NAMES
from experiments.physical.imperfections import ALL, NONE, all_but, only
from experiments.physical.mini import DURATIONS_S
from ssac.fit.covariance import NORMAL_95

_SYMBOLS = {quantity.symbol: name for name, quantity in ERRORS.items()}
_ONLY = only("")  # begins the names of these kinds


def mini_table(results: Results) -> str:
    """Lay out the paper's means and ours by duration and angle, over the offsets, as t_d / R / t.

    The offsets of a recording leave the same errors here, and other recordings in the paper.
    """
    if not results.has("mini_comparison"):
        return ""
    comparison, rows = results.table("mini_comparison"), []
    for duration_s in DURATIONS_S:
        of_duration = comparison[comparison["duration_s"] == duration_s]
        table = results.table(f"mini_{duration_s:g}")
        for angle_deg, cells in of_duration.groupby("angle_deg", sort=False):
            published = cells.groupby("quantity")["published_mean"].mean()
            ours = table[table["angle_deg"] == angle_deg].mean(numeric_only=True)
            rows.append(
                [
                    f"{duration_s:g}",
                    f"{angle_deg:g}",
                    _slashed(published[f"ssac_{error}"] for error in ERRORS),
                    *(_slashed(ours[f"{name}_{error}_mean"] for error in ERRORS)
                      for name in METHOD_NAMES),
                ]
            )  # fmt: skip
    return markdown_table(["s", "deg", "the paper's SSAC", *(f"`{m}`" for m in METHOD_NAMES)], rows)


def mini_verdicts(results: Results) -> str:
    """Count the cells of `ssac` by verdict, and in how many `tangency` errs by half or less."""
    if not results.has("mini_comparison"):
        return ""
    comparison, rows = results.table("mini_comparison"), []
    for symbol, error in _SYMBOLS.items():
        for duration_s in DURATIONS_S:
            cells = comparison[
                (comparison["quantity"] == f"ssac_{error}")
                & (comparison["duration_s"] == duration_s)
            ]
            table = results.table(f"mini_{duration_s:g}")
            halved = 2.0 * table[f"tangency_{error}_mean"] <= table[f"ssac_{error}_mean"]
            rows.append(
                [
                    symbol,
                    f"{duration_s:g}",
                    f"{len(cells)}",
                    *(f"{(cells['verdict'] == word).sum()}" for word in VERDICTS),
                    f"{(cells['paper_size_or_better'] == 'yes').sum()}",
                    f"{halved.sum()}",
                ]
            )  # fmt: skip
    header = ["", "s", "cells", "agree", "better", "differ", "size or better", "`tangency` half"]
    return markdown_table(header, rows)


def mini_held(results: Results) -> str:
    """Count answers, and stated 95 % intervals of t_d that hold the truth, of all recordings."""
    if not results.has("mini_10_runs"):
        return ""
    rows = []
    for duration_s in DURATIONS_S:
        runs = results.table(f"mini_{duration_s:g}_runs")
        one_offset = runs[runs["t_d_ms"] == runs["t_d_ms"].min()]
        for method in METHOD_NAMES[1:]:
            mine = one_offset[one_offset["method"] == method]
            ok = mine[mine["status"] == "ok"]
            held = ok["t_d_error_ms"] <= NORMAL_95 * ok["t_d_std_ms"]
            rows.append(
                [
                    f"{duration_s:g}",
                    f"`{method}`",
                    f"{len(ok)} of {len(mine)}",
                    f"{100.0 * held.mean():.0f}",
                    digits(float(ok["t_d_error_ms"].mean())),
                    digits(float(ok["t_d_std_ms"].mean())),
                ]
            )
    header = ["s", "method", "answered", "held [%]", "error of t_d [ms]", "stated 1 sigma [ms]"]
    return markdown_table(header, rows)


def budget_table(results: Results, symbol: str) -> str:
    """Lay one error of the budget out: each imperfection alone, and all but it, over the angles."""
    if not results.has("error_budget"):
        return ""
    means = _budget_means(results.table("error_budget"), f"{_SYMBOLS[symbol]}_mean")
    kinds = list(means.index.get_level_values("kind").unique())
    names = [kind.removeprefix(_ONLY) for kind in kinds if kind.startswith(_ONLY)]
    # The bench without, and with all of them: at the place of what each row changes.
    ends = (["nothing", NONE, ALL], *([name, only(name), all_but(name)] for name in names))
    rows = [
        [
            name,
            *(
                digits(float(means[(kind, method)]))
                for method in METHOD_NAMES
                for kind in (alone, without)
            ),
        ]
        for name, alone, without in ends
    ]
    header = [text for method in METHOD_NAMES for text in (f"`{method}`: alone", "all but")]
    return markdown_table(["imperfection", *header], rows)


def budget_summary(results: Results) -> str:
    """Lay t_d / R of the budget out, each imperfection alone, over the angles."""
    if not results.has("error_budget"):
        return ""
    table = results.table("error_budget")
    means = [_budget_means(table, f"{_SYMBOLS[symbol]}_mean") for symbol in ("t_d", "R")]
    kinds = [str(kind) for kind in means[0].index.get_level_values("kind").unique()]
    rows = [
        [
            kind.removeprefix(_ONLY),
            *(_slashed(float(of[(kind, method)]) for of in means) for method in METHOD_NAMES),
        ]
        for kind in kinds
        if kind.startswith(_ONLY) or kind in (NONE, ALL)
    ]
    return markdown_table(["bench", *(f"`{method}`" for method in METHOD_NAMES)], rows)


def budget_by_angle(results: Results) -> str:
    """Lay the ideal and the real bench out by angle, as t_d / R / t."""
    if not results.has("error_budget"):
        return ""
    table, rows = results.table("error_budget"), []
    for angle_deg in table["angle_deg"].unique():
        for kind in (NONE, ALL):
            row = [f"{angle_deg:g}", kind]
            for method in METHOD_NAMES:
                of = {"angle_deg": angle_deg, "kind": kind, "method": method}
                row.append(
                    _slashed(
                        results.value("error_budget", f"{error}_mean", **of) for error in ERRORS
                    )
                )
            rows.append(row)
    return markdown_table(["deg", "bench", *(f"`{method}`" for method in METHOD_NAMES)], rows)


def latency_table(results: Results) -> str:
    """Lay the apparent offsets out by the ratio of the lights and by polarity [ms]."""
    if not results.has("light_latency"):
        return ""
    rows = []
    for ratio, of_ratio in results.table("light_latency").groupby("light_ratio", sort=True):
        by = of_ratio.set_index("polarity")
        rows.append(
            [
                f"{ratio:g}",
                *(f"{by['apparent_ms_mean'][name]:.2f}" for name in ("both", "on", "off")),
                digits(float(by["t_d_std_ms"]["both"])),
                f"{by['swapped_ms']['both']:.2f}",
                f"{int(by['answered']['both'])} of {int(by['runs']['both'])}",
            ]
        )
    header = [
        *("light 2 / 1", "apparent", "ON alone", "OFF alone", "stated 1 sigma"),
        *("half sum with its inverse", "answered"),
    ]
    return markdown_table(header, rows)


def _slashed(values: Iterable[float]) -> str:
    return " / ".join(digits(float(value)) for value in values)


def _budget_means(table: pd.DataFrame, column: str) -> "pd.Series[float]":
    """Mean over the angles by kind and method."""
    means: pd.Series[float] = table.groupby(["kind", "method"], sort=False)[column].mean()
    return means


PHYSICAL_TABLES: Mapping[str, Callable[[Results], str]] = {
    "table.mini": mini_table,
    "table.mini.verdicts": mini_verdicts,
    "table.mini.held": mini_held,
    "table.budget": budget_summary,
    "table.budget.angles": budget_by_angle,
    **{f"table.budget.{symbol}": partial(budget_table, symbol=symbol) for symbol in _SYMBOLS},
    "table.latency": latency_table,
}
