"""The paper's physical set-up by its twin: its tables, what each fault costs, and unequal light.

The tables (`mini_10`, `mini_20`) have ten recordings of each angle and duration, and all of an
angle are of one set-up with one calibration, as in the paper: all cells of an angle share the
calibration's errors. In the `error_budget` each recording has its own set-up and calibration, so
that a mean is what one may expect of a bench; all kinds of a recording share its motion.

`light_latency`: a pixel in less light responds later. No geometry tells this from an offset of the
clock, but it differs between the polarities, and changes its sign when the lights are swapped.
"""

from collections.abc import Iterable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.drawing.errors import error_figure
from experiments.drawing.style import Figure, label_log_axis, legend_outside, method_looks, panels
from experiments.lab.command import command_of
from experiments.lab.grid import changed
from experiments.lab.results import Results
from experiments.lab.study import Made, Runs, Study
from experiments.lab.summary import (
    answered,
    by_group,
    digits,
    held,
    made_of,
    markdown_table,
    shown_table,
    statistics,
)
from experiments.lab.verify import no_row, scored_checks
from experiments.paper.comparison import PUBLISHED_ERRORS, comparison_table, load_published
from experiments.paper.esim import ERRORS, R_ERROR, T_D_ERROR, esim_table
from experiments.worlds import bench
from experiments.worlds.bench import ALL, ANGLES_DEG, IMPERFECTIONS, KINDS, NONE, all_but, only
from ssac.pipeline.registry import OURS

N_RECORDINGS = 10  # of each angle and duration, as in the paper
DURATIONS_S = (10.0, 20.0)
T_DS_MS = (5.0, 50.0, 500.0)
METHODS = ("ssac", "joint", "tangency")  # that pages show

PUBLISHED = Path(__file__).parents[1] / "worlds" / "published"
_ERRORS = tuple(one for one in PUBLISHED_ERRORS if one.method == "ssac")


def cells(duration_s: float, recordings: bench.Recordings = None) -> list[bench.PhysicalCell]:
    """List every method on every recording of a duration, with each offset."""
    methods = [method.name for method in OURS]
    benches = (
        bench.bench_of(ALL, angle_deg, duration_s, bench.setup_seed(angle_deg, 0))
        for angle_deg in ANGLES_DEG
    )
    every = product(benches, range(recordings or N_RECORDINGS))
    return [one for at, n in every for one in bench.cells_of(at, {}, n, T_DS_MS, methods)]


def published_tables() -> dict[float, pd.DataFrame]:
    """Read the paper's physical tables, by duration [s]."""
    return load_published(PUBLISHED, "mini", DURATIONS_S)


def comparison(results: Results) -> pd.DataFrame:
    """Compare both tables with the paper's, cell by cell."""
    tables = {duration_s: results.table(f"mini_{duration_s:g}") for duration_s in DURATIONS_S}
    return comparison_table(tables, published_tables(), reasons={}, errors=_ERRORS)


def page_table(results: Results) -> str:
    """Lay out the paper's means and ours by duration and angle, over the offsets."""
    rows = []
    compared = results.table("mini_comparison").groupby(["duration_s", "angle_deg"], sort=False)
    for (duration_s, angle_deg), of in compared:
        published = of.groupby("quantity")["published_mean"].mean()
        ours = results.rows(f"mini_{duration_s:g}", angle_deg=angle_deg).mean(numeric_only=True)
        rows.append({
            "s": f"{duration_s:g}",
            "deg": f"{angle_deg:g}",
            "the paper's SSAC": _slashed(published[f"ssac_{error}"] for error in ERRORS),
            **{f"`{of}`": _slashed(ours[f"{of}_{one}_mean"] for one in ERRORS) for of in METHODS},
        })  # fmt: skip
    return markdown_table(pd.DataFrame(rows))


def held_table(results: Results) -> str:
    """Count answers, and stated 95 % intervals of t_d that hold the truth, of all recordings."""
    rows = []
    for duration_s, method in product(DURATIONS_S, METHODS[1:]):
        mine = results.rows(f"mini_{duration_s:g}_runs", method=method, t_d_ms=T_DS_MS[0])
        ok = answered(mine)
        rows.append({
            "s": f"{duration_s:g}",
            "method": f"`{method}`",
            "answered": f"{len(ok)} of {len(mine)}",
            "held [%]": f"{100 * held(ok, 't_d', 'ms').mean():.0f}",
            "error of t_d [ms]": digits(ok["t_d_error_ms"].mean()),
            "stated 1 sigma [ms]": digits(ok["t_d_std_ms"].mean()),
        })  # fmt: skip
    return markdown_table(pd.DataFrame(rows))


def _slashed(values: Iterable[float]) -> str:
    return " / ".join(digits(float(value)) for value in values)


def _config(duration_s: float) -> dict[str, Any]:
    return {
        "n_recordings": N_RECORDINGS, "duration_s": duration_s, "angles_deg": ANGLES_DEG,
        "t_ds_ms": T_DS_MS, "imperfections": list(IMPERFECTIONS),
        "bench": cells(duration_s, 1)[0].bench,
    }  # fmt: skip


def _study(duration_s: float, *more: Made, **others: Any) -> Study:
    name = f"mini_{duration_s:g}"
    return Study(
        name,
        f"The paper's physical experiments of {duration_s:g} s, by their twin",
        partial(cells, duration_s),
        bench.PHYSICAL,
        Runs(f"{name}_runs.csv", ("angle_deg", "t_d_ms", "flight", "method")),
        (made_of(f"{name}.csv", partial(esim_table, duration_s=duration_s), f"{name}_runs"),
         made_of(f"{name}.png", lambda runs: error_figure(
             runs, published_tables(), "Small-scale experiment"), f"{name}_runs"),
         *more),
        checks=scored_checks(f"{name}_runs"),
        config=_config(duration_s),
        command=bench.COMMAND,
        **others,
    )  # fmt: skip


TABLES = (
    _study(10.0),
    _study(
        20.0,
        Made(
            "mini_comparison.csv",
            comparison,
            config={f"mini_{one:g}": _config(one) for one in DURATIONS_S},
        ),
        reads=("mini_10.csv",),
        numbers={"table.mini": page_table, "table.mini.held": held_table},
    ),
)


# --- What each fault costs ---


BUDGET_RECORDINGS = 1
"""Number of recordings of each angle; each has all kinds. 24 of the 34 kinds need a simulation of
their own: half an hour a recording at 10 s."""

BUDGET_FIRST = 20_000  # number of the first flight, which is in no table
BUDGET_S = 10.0
BUDGET_T_D_MS = 50.0
ON_THE_PAGE = ("ssac", "tangency")


def budget_cells(recordings: bench.Recordings = None) -> list[bench.PhysicalCell]:
    """List the three methods on every kind of each recording."""
    flights = range(BUDGET_FIRST, BUDGET_FIRST + (recordings or BUDGET_RECORDINGS))
    return [
        cell
        for angle_deg, flight, kind in product(ANGLES_DEG, flights, KINDS)
        for cell in bench.cells_of(
            bench.bench_of(kind, angle_deg, BUDGET_S, bench.setup_seed(angle_deg, flight)),
            {"kind": kind}, flight, (BUDGET_T_D_MS,), METHODS,
        )
    ]  # fmt: skip


@by_group("kind", "angle_deg", "method")
def budget_table(group: pd.DataFrame) -> dict[str, Any]:
    """Return mean errors of answered runs by kind, angle and method; `t_d_bias_ms` is signed."""
    ok = answered(group)
    stated = ok[np.isfinite(ok["t_d_std_ms"].astype(float))]
    return {
        **{"runs": len(group), "answered": len(ok)},
        **statistics(ok, [*ERRORS], "mean", "std"),
        "t_d_bias_ms": (ok["t_d_estimate_ms"] - ok["t_d_ms"]).mean(),
        "t_d_held": held(stated, "t_d", "ms").mean() if len(stated) else np.nan,
    }


def budget_figure(summary: pd.DataFrame) -> Figure:
    """Draw mean errors with one imperfection (dot), all but this one (cross), none and all."""
    places, looks = np.arange(len(IMPERFECTIONS)), method_looks([*METHODS])
    height_in = 1.5 + 0.22 * len(places) * len(METHODS)
    n_runs = summary.groupby(["kind", "method"])["runs"].sum().max()
    title = f"What each imperfection of a bench adds: mean errors of {n_runs} recordings"
    figure, grid = panels(title, height_in, len(METHODS), len(ERRORS), sharey=True)
    for row, method in zip(grid, METHODS, strict=True):
        dots: dict[str, Any] = {"ms": 5, "color": looks[method].color}
        for axes, (name, quantity) in zip(row, ERRORS.items(), strict=True):
            values = _budget_means(summary, name).xs(method, level="method")
            alone, without = (values[[*map(of, IMPERFECTIONS)]] for of in (only, all_but))
            axes.plot(alone, places, "o", **dots)
            axes.plot(without, places, "x", **dots)
            axes.axvline(values[NONE], color="0.3", lw=0.8, ls=":")
            axes.axvline(values[ALL], color="0.3", lw=0.8, ls="--")
            axes.set(xscale="log")
            label_log_axis(axes.xaxis)
            axes.set_xlabel(quantity.label, fontsize=9)
            if name == T_D_ERROR.column:
                axes.set_title(method, fontsize=10, loc="left")
        names = [{"truth": "measured truth"}.get(name, name) for name in IMPERFECTIONS]
        row[0].set_yticks(places, names, fontsize=8)
    grid[0, 0].invert_yaxis()
    marks = (
        ("ideal bench with this imperfection", {"marker": "o", "ls": "none", "ms": 5}),
        ("real bench without it", {"marker": "x", "ls": "none", "ms": 5}),
        ("ideal bench", {"ls": ":", "lw": 0.8}),
        ("real bench, with all", {"ls": "--", "lw": 0.8}),
    )
    legend_outside(figure, 4, marks)
    return figure


def budget_page(results: Results) -> str:
    """Lay out mean errors of t_d / R over the angles, with none, one and all imperfections."""
    table = results.table("error_budget")
    means = [_budget_means(table, error.column) for error in (T_D_ERROR, R_ERROR)]
    kinds = {NONE: NONE, **{name: only(name) for name in IMPERFECTIONS}, ALL: ALL}
    columns = {
        f"`{method}`": [_slashed(of[kind, method] for of in means) for kind in kinds.values()]
        for method in ON_THE_PAGE
    }
    return markdown_table(pd.DataFrame({"bench": [*kinds], **columns}))


def _budget_means(summary: pd.DataFrame, error: str) -> "pd.Series[float]":
    """Mean over the angles by kind and method."""
    by_kind = summary.groupby(["kind", "method"], sort=False)
    return by_kind[f"{error}_mean"].mean()


BUDGET = Study(
    "error_budget",
    "What each imperfection of a bench costs, alone and of all",
    budget_cells,
    bench.PHYSICAL,
    Runs("error_budget_runs.csv", ("kind", "angle_deg", "flight", "method")),
    (made_of("error_budget.csv", budget_table, "error_budget_runs"),
     made_of("error_budget.png", budget_figure, "error_budget")),
    numbers={"table.budget": budget_page},
    checks=(("shares are shares", no_row("error_budget", "t_d_held < 0 or t_d_held > 1")),
            *scored_checks("error_budget_runs")),
    config={"n_recordings": BUDGET_RECORDINGS, "first_flight": BUDGET_FIRST,
            "duration_s": BUDGET_S, "t_d_ms": BUDGET_T_D_MS, "angles_deg": ANGLES_DEG,
            "kinds": list(KINDS), "methods": METHODS,
            "bench": bench.bench_of(ALL, ANGLES_DEG[0], BUDGET_S, 0)},
    command=bench.COMMAND,
)  # fmt: skip


# --- Light that is not the same ---


LIGHT_RECORDINGS = 2  # each at all ratios, so that these differ in the light alone
LIGHT_FIRST = 30_000  # number of the first flight, which is in no table
LIGHT_S, LIGHT_ANGLE_DEG, LIGHT_T_D_MS = 6.0, 95.18, 50.0
LIGHT_METHOD = "tangency"

RATIOS = (0.03125, 0.125, 0.5, 1.0, 2.0, 8.0, 32.0)
"""Ratios of camera 2's light to camera 1's. The geometric mean of both is `ILLUMINANCE_LUX`, so
that a ratio and its inverse are the same cameras with their lights swapped."""

ILLUMINANCE_LUX = 100.0

POLARITIES = {"both": None, "on": 1, "off": 0}  # events that are used


def lit(ratio: float, polarity: int | None, setup: int) -> bench.SetUp:
    """Give a bench with real photoreceptors and unequal light, all else being ideal."""
    slow = bench.spoilt(bench.ideal(LIGHT_ANGLE_DEG, LIGHT_S, setup), ("low-pass", "latency"))
    lux = float(ILLUMINANCE_LUX / np.sqrt(ratio))
    lights = {"sim.effects.illuminance_lux": lux, "sim.effects.camera2_light": ratio}
    return changed(slow, {**lights, "polarity": polarity})


def light_cells(recordings: bench.Recordings = None) -> list[bench.PhysicalCell]:
    """List every ratio and polarity on each recording."""
    flights = range(LIGHT_FIRST, LIGHT_FIRST + (recordings or LIGHT_RECORDINGS))
    return [
        cell
        for flight, ratio, (name, polarity) in product(flights, RATIOS, POLARITIES.items())
        for cell in bench.cells_of(
            lit(ratio, polarity, bench.setup_seed(LIGHT_ANGLE_DEG, flight)),
            {"light_ratio": ratio, "polarity": name}, flight, (LIGHT_T_D_MS,), (LIGHT_METHOD,),
        )
    ]  # fmt: skip


@by_group("light_ratio", "polarity")
def _apparent(group: pd.DataFrame) -> dict[str, float]:
    ok = answered(group)
    apparent = statistics(ok, ["apparent_ms"], "mean", "std")
    std_ms = ok["t_d_std_ms"].mean()
    return {"runs": len(group), "answered": len(ok), **apparent, "t_d_std_ms": std_ms}


def latency_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return apparent offsets, estimate less truth; `swapped_ms`: mean with lights swapped."""
    table = _apparent(runs.assign(apparent_ms=runs["t_d_estimate_ms"] - runs["t_d_ms"]))
    means = table.set_index(["light_ratio", "polarity"])["apparent_ms_mean"]
    inverse = zip(1.0 / table["light_ratio"], table["polarity"], strict=True)
    swapped = means.reindex(list(inverse)).to_numpy()
    return table.assign(swapped_ms=0.5 * (means.to_numpy() + swapped))


def latency_figure(summary: pd.DataFrame) -> Figure:
    """Draw the apparent offset against the ratio of the lights, by polarity."""
    from ssac.pipeline.plots import BLUE, YELLOW

    figure, ((axes,),) = panels("What unequal light does to the offset", 3.9)
    by_polarity = dict(list(summary.groupby("polarity")))
    looks = (
        ("both", "black", "D", "both polarities"),
        ("on", YELLOW, "^", "brighter alone (ON)"),
        ("off", BLUE, "v", "darker alone (OFF)"),
    )
    for polarity, color, marker, label in looks:
        part = by_polarity[polarity]
        axes.errorbar(
            part["light_ratio"], part["apparent_ms_mean"], part["apparent_ms_std"], color=color,
            marker=marker, ms=5, lw=0.9, label=label,
        )  # fmt: skip
    both = by_polarity["both"]
    axes.plot(both["light_ratio"], both["swapped_ms"], color="0.5", ls=":", marker="x",
              label="mean with the lights swapped")  # fmt: skip
    axes.set(xscale="log")
    label_log_axis(axes.xaxis)
    axes.set_xticks(RATIOS)
    axes.set_xlabel("light of camera 2 over that of camera 1")
    axes.set_ylabel("apparent offset less the clocks' [ms]")
    axes.legend(fontsize=8, frameon=False, title_fontsize=8,
                title="bar: deviation over the recordings")  # fmt: skip
    return figure


def latency_page(results: Results) -> str:
    """Lay the apparent offsets out by the ratio of the lights and by polarity [ms]."""
    table = results.table("light_latency").sort_values("light_ratio", kind="stable")
    apparent = table.pivot(index="light_ratio", columns="polarity", values="apparent_ms_mean")
    both = table[table["polarity"] == "both"].merge(apparent, on="light_ratio")
    columns = {
        "light 2 / 1": "{light_ratio:g}",
        "apparent": "{both:.2f}",
        "ON alone": "{on:.2f}",
        "OFF alone": "{off:.2f}",
        "stated 1 sigma": "{sigma}",
        "half sum with its inverse": "{swapped_ms:.2f}",
        "answered": "{answered} of {runs}",
    }
    return shown_table(both.assign(sigma=both["t_d_std_ms"].map(digits)), columns)


LATENCY = Study(
    "light_latency",
    "Offsets that appear where two cameras are lit differently",
    light_cells,
    bench.PHYSICAL,
    Runs("light_latency_runs.csv", ("light_ratio", "polarity", "flight")),
    (made_of("light_latency.csv", latency_table, "light_latency_runs"),
     made_of("light_latency.png", latency_figure, "light_latency")),
    numbers={"table.latency": latency_page},
    checks=(("as many are answered as ran", no_row("light_latency", "answered > runs")),
            *scored_checks("light_latency_runs")),
    config={"n_recordings": LIGHT_RECORDINGS, "first_flight": LIGHT_FIRST,
            "duration_s": LIGHT_S, "angle_deg": LIGHT_ANGLE_DEG, "t_d_ms": LIGHT_T_D_MS,
            "ratios": RATIOS, "illuminance_lux": ILLUMINANCE_LUX, "method": LIGHT_METHOD,
            "bench": lit(1.0, None, 0)},
    command=bench.COMMAND,
)  # fmt: skip

STUDIES = (*TABLES, BUDGET, LATENCY)

command = command_of(
    {"tables": TABLES, "budget": (BUDGET,), "latency": (LATENCY,)},
    "Simulate the paper's small-scale physical set-up: its tables, and what each fault costs.\n\n"
    "What is finished is kept in the cache, so that an interrupted run goes on where it was.",
)
