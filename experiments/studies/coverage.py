"""Simulated runs in, how often the stated intervals hold the truth out.

An interval of t_d or of one angle is the estimate +- z deviations, z being the normal quantile; a
region of R or t is where the Mahalanobis distance of its three or two angles is below the root of
chi^2's quantile. All flights are ones that nothing was tuned on: configs/coverage.toml.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import beta, chi2

from experiments.drawing.style import WIDTH_IN, method_looks, quiet_axes
from experiments.lab.grid import named_config
from experiments.lab.study import Study
from experiments.paper.esim import method_order
from experiments.studies.grids import grid_study
from ssac.fit.covariance import NORMAL_95

FloatArray = NDArray[np.float64]

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


def coverage_figure(runs: pd.DataFrame) -> Figure:
    """Draw observed against nominal coverage: a panel for each of t_d, R and t.

    The band is where 95 % of the runs' shares would lie if the deviations were right.
    """
    runs = _with_clocks(runs)
    panels = {name: quantity for name, quantity in QUANTITIES.items() if quantity.label}
    methods = method_order(runs["method"])
    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    for axes, quantity in zip(figure.subplots(1, len(panels)), panels.values(), strict=True):
        _draw_panel(axes, runs, quantity, methods)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure


def _draw_panel(axes: Axes, runs: pd.DataFrame, quantity: Quantity, methods: list[str]) -> None:
    nominal = np.linspace(0.0, 1.0, 101)
    looks = method_looks(methods)
    most = 0
    for method in methods:
        values = _normalised(runs[runs["method"] == method], quantity)
        if len(values) == 0:
            continue
        levels = confidence(values, quantity.parameters)
        observed = np.mean(levels[:, None] <= nominal, axis=0)
        look = looks[method]
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
    quiet_axes(axes)
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


def coverage_study() -> Study:
    """Give the study of configs/coverage.toml."""
    return grid_study(
        named_config("coverage"), coverage_table, lambda _, runs: coverage_figure(runs)
    )
