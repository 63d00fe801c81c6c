"""Two cameras lit differently in; the offset that appears, and what its parts say of it, out.

A pixel in less light answers later: no geometry tells that from a clock that shows more. But it is
not the same for both polarities, and it changes its sign when the lights are swapped.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.drawing.style import WIDTH_IN, quiet_axes
from experiments.lab.study import Study, summed_study
from experiments.physical.cells import cells_of, setup_seed
from experiments.physical.imperfections import IMPERFECTIONS, SetUp, ideal
from experiments.physical.measure import PHYSICAL, PhysicalCell
from experiments.physical.mini import COMMAND

N_RECORDINGS = 2
"""Each at all ratios, so that these differ in the light alone."""

FIRST_FLIGHT = 30_000  # of no table
DURATION_S, ANGLE_DEG, T_D_MS = 6.0, 95.18, 50.0
METHOD = "tangency"

RATIOS = (0.03125, 0.125, 0.5, 1.0, 2.0, 8.0, 32.0)
"""Of camera 2's light to camera 1's; together they have `ILLUMINANCE_LUX` in the geometric mean,
so that a ratio and its inverse are the same cameras with their lights swapped."""

ILLUMINANCE_LUX = 100.0

POLARITIES = {"both": None, "on": 1, "off": 0}
"""Events that are used."""


def lit(ratio: float, polarity: int | None, setup: int) -> SetUp:
    """Give a bench whose photoreceptors are real ones, all else ideal, and whose lights differ."""
    bench = ideal(ANGLE_DEG, DURATION_S, setup)
    for name in ("low-pass", "latency"):
        bench = IMPERFECTIONS[name](bench)
    effects = replace(
        bench.sim.effects,
        illuminance_lux=float(ILLUMINANCE_LUX / np.sqrt(ratio)),
        camera2_light=ratio,
    )
    return replace(bench, sim=replace(bench.sim, effects=effects), polarity=polarity)


def latency_cells(n_recordings: int = N_RECORDINGS) -> list[PhysicalCell]:
    """List every ratio and polarity on each recording."""
    return [
        cell
        for flight in range(FIRST_FLIGHT, FIRST_FLIGHT + n_recordings)
        for ratio in RATIOS
        for name, polarity in POLARITIES.items()
        for cell in cells_of(
            lit(ratio, polarity, setup_seed(ANGLE_DEG, flight)),
            {"light_ratio": ratio, "polarity": name},
            flight,
            (T_D_MS,),
            (METHOD,),
        )
    ]


def latency_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Apparent offsets by ratio and polarity.

    Parameters
    ----------
    runs
        One row per cell of `latency_cells`.

    Returns
    -------
    pd.DataFrame
        One row per ratio and polarity in their order: `runs`, `answered`, mean and deviation of
        the apparent offset, which is the estimated less the clocks' (`apparent_ms_*`), the mean
        stated deviation, and `swapped_ms`, the mean of the apparent offset of this ratio and its
        inverse, which swapping the lights leaves.
    """
    runs = runs.assign(apparent_ms=runs["t_d_estimate_ms"] - runs["t_d_ms"])
    rows = []
    for (ratio, polarity), group in runs.groupby(["light_ratio", "polarity"], sort=False):
        ok = group[group["status"] == "ok"]
        rows.append(
            {
                "light_ratio": ratio,
                "polarity": polarity,
                "runs": len(group),
                "answered": len(ok),
                "apparent_ms_mean": ok["apparent_ms"].mean(),
                "apparent_ms_std": ok["apparent_ms"].std(ddof=0),
                "t_d_std_ms": ok["t_d_std_ms"].mean(),
            }
        )
    table: pd.DataFrame = pd.DataFrame(rows)
    names = table[["light_ratio", "polarity"]].itertuples(index=False, name=None)
    means = dict(zip(names, table["apparent_ms_mean"].to_numpy(np.float64), strict=True))
    table["swapped_ms"] = [
        0.5 * (means[(ratio, polarity)] + means.get((1.0 / ratio, polarity), np.nan))
        for ratio, polarity in zip(table["light_ratio"], table["polarity"], strict=True)
    ]
    return table


def latency_figure(summary: pd.DataFrame, _: pd.DataFrame) -> Figure:
    """Draw the apparent offset against the ratio of the lights, by polarity."""
    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    axes = figure.subplots()
    quiet_axes(axes)
    looks = {"both": ("#000000", "D"), "on": ("#D55E00", "^"), "off": ("#0072B2", "v")}
    for polarity, (color, marker) in looks.items():
        part = summary[summary["polarity"] == polarity]
        axes.errorbar(
            part["light_ratio"], part["apparent_ms_mean"], part["apparent_ms_std"], color=color,
            marker=marker, ms=5, lw=0.9, label=f"{polarity} polarities"
            if polarity == "both" else f"{polarity.upper()} events alone",
        )  # fmt: skip
    both = summary[summary["polarity"] == "both"]
    axes.plot(both["light_ratio"], both["swapped_ms"], color="0.5", ls=":", marker="x",
              label="mean with the lights swapped")  # fmt: skip
    axes.set(xscale="log", xticks=RATIOS)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    axes.set_xlabel("light of camera 2 over that of camera 1")
    axes.set_ylabel("apparent offset less the clocks' [ms]")
    axes.legend(fontsize=8, frameon=False)
    return figure


def latency_study(n_recordings: int = N_RECORDINGS, command: str = COMMAND) -> Study:
    """Give the study of lights that differ."""
    return summed_study(
        "light_latency",
        "Offsets that appear where two cameras are lit differently",
        partial(latency_cells, n_recordings),
        PHYSICAL,
        latency_table,
        keys=("light_ratio", "polarity", "flight"),
        draw=latency_figure,
        config={"n_recordings": n_recordings, "first_flight": FIRST_FLIGHT,
                "duration_s": DURATION_S, "angle_deg": ANGLE_DEG, "t_d_ms": T_D_MS,
                "ratios": RATIOS, "illuminance_lux": ILLUMINANCE_LUX, "method": METHOD,
                "bench": lit(1.0, None, 0)},
        command=command,
    )  # fmt: skip
