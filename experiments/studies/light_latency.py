"""The offset that appears where two cameras are lit differently, and what its parts say of it.

A pixel in less light answers later: no geometry tells that from a clock that shows more. But it is
not the same for both polarities, and it changes its sign when the lights are swapped.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.lab.study import Made, Runs, Study
from experiments.lab.verify import ordered, scored_checks
from experiments.worlds.bench import (
    COMMAND,
    IMPERFECTIONS,
    PHYSICAL,
    PhysicalCell,
    Recordings,
    SetUp,
    cells_of,
    ideal,
    setup_seed,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def cells(recordings: Recordings = None) -> list[PhysicalCell]:
    """List every ratio and polarity on each recording."""
    return [
        cell
        for flight in range(FIRST_FLIGHT, FIRST_FLIGHT + (recordings or N_RECORDINGS))
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
    """Apparent offsets by ratio and polarity, in their order.

    Returns
    -------
    pd.DataFrame
        `runs`, `answered`, mean and deviation of the apparent offset, which is the estimated less
        the clocks' (`apparent_ms_*`), the mean stated deviation, and `swapped_ms`, the mean of the
        apparent offset of this ratio and its inverse, which swapping the lights leaves.
    """
    runs = runs.assign(apparent_ms=runs["t_d_estimate_ms"] - runs["t_d_ms"])
    rows, means = [], dict[Any, float]()
    for (ratio, polarity), group in runs.groupby(["light_ratio", "polarity"], sort=False):
        ok = group[group["status"] == "ok"]
        means[ratio, polarity] = ok["apparent_ms"].mean()
        rows.append(
            {
                "light_ratio": ratio,
                "polarity": polarity,
                "runs": len(group),
                "answered": len(ok),
                "apparent_ms_mean": means[ratio, polarity],
                "apparent_ms_std": ok["apparent_ms"].std(ddof=0),
                "t_d_std_ms": ok["t_d_std_ms"].mean(),
            }
        )
    swapped_ms = [
        0.5 * (mean + means.get((1.0 / ratio, polarity), np.nan))
        for (ratio, polarity), mean in means.items()
    ]
    return pd.DataFrame(rows).assign(swapped_ms=swapped_ms)


def latency_figure(summary: pd.DataFrame) -> "Figure":
    """Draw the apparent offset against the ratio of the lights, by polarity."""
    from matplotlib.figure import Figure

    from experiments.drawing.style import WIDTH_IN, quiet_axes

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


def page_table(results: Results) -> str:
    """Lay the apparent offsets out by the ratio of the lights and by polarity [ms]."""
    rows = []
    for ratio, of_ratio in results.table("light_latency").groupby("light_ratio", sort=True):
        by = of_ratio.set_index("polarity")
        rows.append(
            [
                f"{ratio:g}",
                *(f"{by['apparent_ms_mean'][name]:.2f}" for name in POLARITIES),
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


STUDIES = (
    Study(
        "light_latency",
        "Offsets that appear where two cameras are lit differently",
        cells,
        PHYSICAL,
        Runs("light_latency_runs.csv", ("light_ratio", "polarity", "flight")),
        (
            Made("light_latency.csv", lambda one: latency_table(one.table("light_latency_runs"))),
            Made("light_latency.png", lambda one: latency_figure(one.table("light_latency"))),
        ),
        numbers={"table.latency": page_table},
        checks=(
            ("as many are answered as ran", ordered("light_latency", "answered", "runs")),
            *scored_checks("light_latency_runs"),
        ),
        config={"n_recordings": N_RECORDINGS, "first_flight": FIRST_FLIGHT,
                "duration_s": DURATION_S, "angle_deg": ANGLE_DEG, "t_d_ms": T_D_MS,
                "ratios": RATIOS, "illuminance_lux": ILLUMINANCE_LUX, "method": METHOD,
                "bench": lit(1.0, None, 0)},
        command=COMMAND,
    ),
)  # fmt: skip
