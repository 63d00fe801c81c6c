"""How often the stated intervals hold the truth, on flights that nothing was tuned on.

An interval of t_d or of one angle is the estimate +- z deviations, z being the normal quantile; a
region of R or t is where the Mahalanobis distance of its three or two angles is below the root of
chi^2's quantile. The flights are those of configs/coverage.toml.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import beta, chi2

from experiments.lab.grid import named_config
from experiments.lab.markdown import listed, markdown_table
from experiments.lab.results import Results
from experiments.lab.scored import SCORED
from experiments.lab.study import Made, Runs, Study
from experiments.lab.verify import scored_checks
from experiments.paper.esim import method_order
from ssac.fit.covariance import NORMAL_95

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

GRID = named_config("coverage")
METHODS = ("joint", "tangency", "joint-known", "tangency-known")

MARK = 0.93
"""Intervals of 95 % shall hold the truth in at least this share of the flights."""

LEVELS = (0.50, 0.68, 0.90, 0.95, 0.99)
SAMPLING = 0.95
"""Of the interval around an observed share, for the number of runs."""


@dataclass(frozen=True)
class Quantity:
    """What is covered or not."""

    column: str  # of the runs: error over its deviation, or a Mahalanobis distance
    parameters: int
    label: str = ""  # of its panel in the figure; "": none


QUANTITIES = {
    "t_d": Quantity("t_d_normalised", 1, "$t_d$"),
    "R": Quantity("r_mahalanobis", 3, "R, three angles"),
    "t": Quantity("t_mahalanobis", 2, "t, two angles"),
    "R_x": Quantity("r_x_normalised", 1),
    "R_y": Quantity("r_y_normalised", 1),
    "R_z": Quantity("r_z_normalised", 1),
    "t_1": Quantity("t_1_normalised", 1),
    "t_2": Quantity("t_2_normalised", 1),
    "skew": Quantity("skew_normalised", 1),
}


def coverage_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Shares of the runs whose intervals hold the truth.

    Parameters
    ----------
    runs
        Rows of `schedule.run_cells`, of `coverage.toml`'s grid.

    Returns
    -------
    pd.DataFrame
        For each method, quantity and angle between the cameras, all angles ("all") first:
        `n_runs`, `refused` (status not "ok"; these do not count further), `rms_normalised` (1 if
        the deviations are right), and for each level in per cent `coverage_<level>` with the
        bounds `_low` and `_high` that the number of runs leaves (Clopper and Pearson, 95 %).
    """
    runs = _with_clocks(runs)
    angles = {"all": runs} | {
        f"{angle_deg:g}": part for angle_deg, part in runs.groupby("sim.angle_deg")
    }
    rows: list[dict[str, Any]] = []
    for method in method_order(runs["method"]):
        for name, quantity in QUANTITIES.items():
            for angle, part in angles.items():
                of_method = part[part["method"] == method]
                row = _coverage(of_method, quantity)
                if row:
                    rows.append({"method": method, "quantity": name, "angle_deg": angle, **row})
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


def confidence(normalised: FloatArray, parameters: int) -> FloatArray:
    """Level (n,) of the interval or region on whose border the truth lies: uniform if all is well.

    Parameters
    ----------
    normalised
        Errors over their deviations, or Mahalanobis distances, shape (n,).
    parameters
        Their number: chi^2's degrees of freedom.
    """
    return np.asarray(chi2.cdf(np.square(normalised), parameters))


def sampling_bounds(n_inside: int, n_runs: int) -> tuple[float, float]:
    """Bounds of a share, of which `n_inside` of `n_runs` were seen: Clopper and Pearson's."""
    tail = 0.5 * (1.0 - SAMPLING)
    low = beta.ppf(tail, n_inside, n_runs - n_inside + 1) if n_inside > 0 else 0.0
    high = beta.ppf(1.0 - tail, n_inside + 1, n_runs - n_inside) if n_inside < n_runs else 1.0
    return float(low), float(high)


def coverage_figure(runs: pd.DataFrame) -> "Figure":
    """Draw observed against nominal coverage: a panel for each of t_d, R and t.

    The band is where 95 % of the runs' shares would lie if the deviations were right.
    """
    from matplotlib.figure import Figure

    from experiments.drawing.style import WIDTH_IN, method_looks, quiet_axes

    runs = _with_clocks(runs)
    panels = {name: quantity for name, quantity in QUANTITIES.items() if quantity.label}
    methods = method_order(runs["method"])
    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    for axes, quantity in zip(figure.subplots(1, len(panels)), panels.values(), strict=True):
        _draw_panel(axes, runs, quantity, method_looks(methods))
        quiet_axes(axes)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure


def _draw_panel(
    axes: "Axes", runs: pd.DataFrame, quantity: Quantity, looks: Mapping[str, Any]
) -> None:
    nominal = np.linspace(0.0, 1.0, 101)
    most = 0
    for method, look in looks.items():
        values = _normalised(runs[runs["method"] == method], quantity)
        if len(values) == 0:
            continue
        levels = confidence(values, quantity.parameters)
        observed = np.mean(levels[:, None] <= nominal, axis=0)
        style = "--" if look.hollow else "-"
        axes.plot(100 * nominal, 100 * observed, style, color=look.color, lw=1.4, label=method)
        most = max(most, len(values))
    axes.plot([0, 100], [0, 100], color="0.6", lw=0.8)
    if most:
        half = NORMAL_95 * np.sqrt(nominal * (1.0 - nominal) / most)
        axes.fill_between(
            100 * nominal, 100 * (nominal - half), 100 * (nominal + half), color="0.9", lw=0,
            label=f"sampling error of {most} runs",
        )  # fmt: skip
    axes.set(xlim=(0, 100), ylim=(0, 100), aspect="equal", xlabel="nominal coverage [%]")
    axes.set_ylabel("observed coverage [%]")
    axes.set_title(quantity.label, fontsize=11)


def _coverage(runs: pd.DataFrame, quantity: Quantity) -> Mapping[str, Any]:
    """Row of the table for runs of one method; empty when it does not give the quantity."""
    values = _normalised(runs, quantity)
    if len(values) == 0:
        return {}
    levels = confidence(values, quantity.parameters)
    row: dict[str, Any] = {
        "n_runs": len(runs),
        "refused": int((runs["status"] != "ok").sum()),
        "rms_normalised": float(np.sqrt(np.mean(values**2) / quantity.parameters)),
    }
    for level in LEVELS:
        inside = int(np.sum(levels <= level))
        name = f"coverage_{100 * level:g}"
        row[name] = inside / len(levels)
        row[f"{name}_low"], row[f"{name}_high"] = sampling_bounds(inside, len(levels))
    return row


def _normalised(runs: pd.DataFrame, quantity: Quantity) -> FloatArray:
    """Values of a quantity over the runs that are "ok" and give it."""
    values = runs.loc[runs["status"] == "ok", quantity.column].dropna()
    return np.asarray(values, dtype=np.float64)


def _with_clocks(runs: pd.DataFrame) -> pd.DataFrame:
    """Add the errors of t_d, signed, and of the skew over their stated deviations."""
    errors_ms = runs["t_d_estimate_ms"] - 1e3 * runs["sim.t_d_s"]
    return runs.assign(
        t_d_normalised=errors_ms / runs["t_d_std_ms"],
        skew_normalised=runs["skew_error_ppm"] / runs["skew_std_ppm"],
    )


def page_table(results: Results) -> str:
    """Shares of the truths in the 95 % intervals, over all angles."""

    def share(method: str, quantity: str) -> str:
        of = {"method": method, "quantity": quantity, "angle_deg": "all"}
        return f"{100 * results.value('coverage', 'coverage_95', **of):.1f}"

    def row(method: str) -> list[str]:
        of = results.one("coverage", method=method, quantity="t_d", angle_deg="all")
        poses = ["", ""] if method.endswith("-known") else [share(method, q) for q in "Rt"]
        sampling = f"{100 * of['coverage_95_low']:.1f} to {100 * of['coverage_95_high']:.1f}"
        return [
            *(f"`{method}`", share(method, "t_d"), sampling, *poses),
            *(share(method, "skew"), f"{of['rms_normalised']:.2f}"),
        ]

    header = [
        *("method", "t_d [%]", "sampling [%]", "R [%]", "t [%]", "skew [%]"),
        "t_d: rms of error / deviation",
    ]
    return markdown_table(header, [row(method) for method in METHODS])


def flights(results: Results) -> str:
    """Count the flights."""
    of = {"method": "joint", "quantity": "t_d", "angle_deg": "all"}
    return f"{results.value('coverage', 'n_runs', **of):.0f}"


def below_the_mark(results: Results) -> str:
    """List the methods and quantities whose 95 % intervals hold the truth less often than MARK."""
    table = results.table("coverage")
    low = table[(table["angle_deg"] == "all") & (table["coverage_95"] < MARK)]
    found = [
        f"{100 * row['coverage_95']:.0f} % ({row['quantity']} of `{row['method']}`)"
        for row in low.to_dict("records")
    ]
    return listed(found) if found else "nowhere"


STUDIES = (
    Study(
        "coverage",
        GRID.title,
        GRID.cells,
        SCORED,
        Runs("coverage_runs.csv", (*GRID.varied, "flight", "method")),
        (
            Made("coverage.csv", lambda results: coverage_table(results.table("coverage_runs"))),
            Made("coverage.png", lambda results: coverage_figure(results.table("coverage_runs"))),
        ),
        numbers={
            "coverage.flights": flights,
            "coverage.below": below_the_mark,
            "table.coverage": page_table,
        },
        checks=scored_checks("coverage_runs"),
        config=GRID.content,
    ),
)
