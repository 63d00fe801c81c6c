"""How often the stated intervals hold the truth, on flights that nothing was tuned on.

An interval of t_d or of one angle is the estimate +- z deviations, z being the normal quantile; a
region of R or t is where the Mahalanobis distance of its three or two angles is below the root of
chi^2's quantile. The flights are those of configs/coverage.toml.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import betaincinv, chdtr

from experiments.drawing.style import Figure, legend_outside, method_looks, panels
from experiments.lab.grid import named_config
from experiments.lab.results import Results
from experiments.lab.scored import SCORED
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, listed, made_of, markdown_table, quoted
from experiments.lab.verify import scored_checks
from experiments.paper.esim import ERRORS, method_order
from ssac.arrays import Array
from ssac.fit.covariance import NORMAL_95

GRID = named_config("coverage")
METHODS = ("joint", "tangency", "joint-known", "tangency-known")

MARK = 0.93  # intervals of 95 % shall hold the truth in at least this share of the flights
LEVELS = (0.50, 0.68, 0.90, 0.95, 0.99)
SAMPLING = 0.95  # confidence of the interval of an observed share


@dataclass(frozen=True)
class Quantity:
    """An estimated quantity whose stated intervals are checked."""

    column: str  # of the runs: error over its deviation, or a Mahalanobis distance
    parameters: int
    label: str = ""  # of its panel in the figure; "": none

    def normalised(self, runs: pd.DataFrame) -> Array:
        """Return the column's values of the runs that are "ok" and have one."""
        return np.asarray(answered(runs)[self.column].dropna(), dtype=np.float64)

    def levels(self, runs: pd.DataFrame) -> Array:
        """Return `confidence` (n,) of all runs; NaN for those without a value."""
        return confidence(runs[self.column].to_numpy(np.float64), self.parameters)


QUANTITIES = {
    "t_d": Quantity("t_d_normalised", 1, "$t_d$"),
    "R": Quantity("r_mahalanobis", 3, "R, three angles"),
    "t": Quantity("t_mahalanobis", 2, "t, two angles"),
    **{name: Quantity(f"{name.lower()}_normalised", 1)
       for name in ("R_x", "R_y", "R_z", "t_1", "t_2", "skew")},
}  # fmt: skip


def coverage_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the shares of runs whose intervals hold the truth, by method, quantity and angle.

    All angles ("all") come first. Refused runs (not "ok") are counted, but enter no share. If the
    deviations are right, `rms_normalised` is 1. Shares have bounds (Clopper and Pearson, 95 %).
    """
    runs = _with_clocks(runs)
    angles = {"all": runs, **{f"{deg:g}": part for deg, part in runs.groupby("sim.angle_deg")}}
    rows = [
        {"method": method, "quantity": name, "angle_deg": angle, **row}
        for method in method_order(runs["method"])
        for name, quantity in QUANTITIES.items()
        for angle, part in angles.items()
        if (row := _coverage(part[part["method"] == method], quantity))
    ]
    return pd.DataFrame(rows)


def _coverage(runs: pd.DataFrame, quantity: Quantity) -> Mapping[str, Any]:
    """Row of the table for runs of one method; empty when it does not give the quantity."""
    values = quantity.normalised(runs)
    if len(values) == 0:
        return {}
    levels = confidence(values, quantity.parameters)
    row: dict[str, Any] = {"n_runs": len(runs), "refused": int((runs["status"] != "ok").sum())}
    row["rms_normalised"] = float(np.sqrt(np.mean(values**2) / quantity.parameters))
    for level in LEVELS:
        inside = int(np.sum(levels <= level))
        name = f"coverage_{100 * level:g}"
        row[name] = inside / len(levels)
        row[f"{name}_low"], row[f"{name}_high"] = sampling_bounds(inside, len(levels))
    return row


def confidence(normalised: Array, parameters: int) -> Array:
    """Return the level (n,) of the interval or region on whose border the truth lies.

    `normalised` (n,) are errors over deviations, or Mahalanobis distances of so many parameters;
    levels are uniform if the deviations are right.
    """
    return np.asarray(chdtr(parameters, np.square(normalised)))


@cache
def sampling_bounds(n_inside: float, n_runs: float) -> tuple[float, float]:
    """Return Clopper and Pearson's bounds of a share that is observed as `n_inside` of `n_runs`.

    Runs that are not independent count less than they are: `n_runs` is then an effective number.
    """
    n_outside, tail = n_runs - n_inside, 0.5 * (1.0 - SAMPLING)
    low = betaincinv(n_inside, n_outside + 1, tail) if n_inside else 0.0
    high = betaincinv(n_inside + 1, n_outside, 1.0 - tail) if n_outside else 1.0
    return float(low), float(high)


def _with_clocks(runs: pd.DataFrame) -> pd.DataFrame:
    """Add the signed error of t_d and the absolute one of the skew, over their deviations."""
    errors_ms = runs["t_d_estimate_ms"] - 1e3 * runs["sim.t_d_s"]
    return runs.assign(
        t_d_normalised=errors_ms / runs["t_d_std_ms"],
        skew_normalised=runs["skew_error_ppm"] / runs["skew_std_ppm"],
    )


def coverage_figure(runs: pd.DataFrame) -> Figure:
    """Draw observed against nominal coverage, with the sampling error if deviations were right."""
    runs, drawn = _with_clocks(runs), [one for one in QUANTITIES.values() if one.label]
    figure, grid = panels("How often the stated intervals hold the truth", 3.4, columns=len(drawn))
    nominal = np.linspace(0.0, 1.0, 101)
    looks = method_looks(method_order(runs["method"]))
    for axes, quantity in zip(grid[0], drawn, strict=True):
        most = 0
        for method, look in looks.items():
            values = quantity.normalised(runs[runs["method"] == method])
            if len(values) == 0:
                continue
            observed = np.mean(confidence(values, quantity.parameters)[:, None] <= nominal, axis=0)
            style = "--" if look.is_known else "-"
            axes.plot(100 * nominal, 100 * observed, style, color=look.color, lw=1.4, label=method)
            most = max(most, len(values))
        axes.plot([0, 100], [0, 100], color="0.6", lw=0.8)
        if most:
            half = NORMAL_95 * np.sqrt(nominal * (1.0 - nominal) / most)
            axes.fill_between(
                100 * nominal, 100 * (nominal - half), 100 * (nominal + half), color="0.9", lw=0,
                label=f"sampling error (95 %) of {most} runs",
            )  # fmt: skip
        axes.set(xlim=(0, 100), ylim=(0, 100), aspect="equal", xlabel="nominal coverage [%]")
        axes.set_ylabel("observed coverage [%]")
        axes.set_title(quantity.label, fontsize=11)
    legend_outside(figure, 5)
    return figure


def page_table(results: Results) -> str:
    """Lay out the shares of 95 % intervals that hold the truth, over all angles."""
    rows = []
    for method in METHODS:
        of = results.rows("coverage", method=method, angle_deg="all").set_index("quantity")
        shares = (100 * of["coverage_95"]).map("{:.1f}".format)
        t_d = of.loc["t_d"].filter(like="coverage")
        rows.append({
            "method": f"`{method}`",
            "t_d [%]": shares["t_d"],
            "sampling [%]": "{coverage_95_low:.1f} to {coverage_95_high:.1f}".format(**100 * t_d),
            **{f"{one} [%]": shares.get(one, "") for one in ("R", "t", "skew")},
            "t_d: rms of error / deviation": f"{of.loc['t_d', 'rms_normalised']:.2f}",
        })  # fmt: skip
    return markdown_table(pd.DataFrame(rows))


def below_the_mark(results: Results) -> str:
    """List the methods and quantities whose 95 % intervals hold the truth less often than MARK."""
    table = results.rows("coverage", angle_deg="all")
    found = [
        f"{100 * row['coverage_95']:.0f} % ({row['quantity']} of `{row['method']}`)"
        for row in table[table["coverage_95"] < MARK].to_dict("records")
    ]
    return listed(found) if found else "nowhere"


def cell_errors(results: Results, of: str) -> str:
    """Give the "max" or "mean" over durations and angles of the mean errors of `tangency`."""
    runs = answered(results.rows("coverage_runs", method="tangency"))
    errors = {error.column: error.unit for error in ERRORS.values()}
    found = runs.groupby([*GRID.varied])[[*errors]].mean().agg(of)
    return ", ".join(f"{found[column]:.3f} {unit}" for column, unit in errors.items())


STUDIES = (
    Study(
        "coverage", GRID.title, GRID.cells, SCORED,
        Runs("coverage_runs.csv", (*GRID.varied, "flight", "method")),
        (made_of("coverage.csv", coverage_table, "coverage_runs"),
         made_of("coverage.png", coverage_figure, "coverage_runs")),
        numbers={"coverage.flights": quoted("coverage", "{n_runs:.0f}", method="joint",
                                            quantity="t_d", angle_deg="all"),
                 "coverage.below": below_the_mark, "table.coverage": page_table,
                 "coverage.largest": partial(cell_errors, of="max"),
                 "coverage.mean": partial(cell_errors, of="mean")},
        checks=scored_checks("coverage_runs"), config=GRID.content,
    ),
)  # fmt: skip
