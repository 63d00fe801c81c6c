"""The offset that appears where two cameras are lit differently, and what its parts say of it.

A pixel in less light answers later: no geometry tells that from a clock that shows more. But it is
not the same for both polarities, and it changes its sign when the lights are swapped.
"""

from dataclasses import replace

import numpy as np
import pandas as pd

from experiments.drawing.panels import Figure, panels
from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, by_group, made_of, statistics
from experiments.lab.verify import ordered, scored_checks
from experiments.worlds import bench

N_RECORDINGS = 2  # each at all ratios, so that these differ in the light alone
FIRST_FLIGHT = 30_000  # of no table
DURATION_S, ANGLE_DEG, T_D_MS = 6.0, 95.18, 50.0
METHOD = "tangency"

RATIOS = (0.03125, 0.125, 0.5, 1.0, 2.0, 8.0, 32.0)
"""Of camera 2's light to camera 1's; together they have `ILLUMINANCE_LUX` in the geometric mean,
so that a ratio and its inverse are the same cameras with their lights swapped."""

ILLUMINANCE_LUX = 100.0

POLARITIES = {"both": None, "on": 1, "off": 0}  # events that are used

_LOOKS = {
    "both": ("#000000", "D", "both polarities"),
    "on": ("#D55E00", "^", "ON events alone"),
    "off": ("#0072B2", "v", "OFF events alone"),
}


def lit(ratio: float, polarity: int | None, setup: int) -> bench.SetUp:
    """Give a bench whose photoreceptors are real ones, all else ideal, and whose lights differ."""
    found = bench.ideal(ANGLE_DEG, DURATION_S, setup)
    for name in ("low-pass", "latency"):
        found = bench.IMPERFECTIONS[name](found)
    illuminance_lux = float(ILLUMINANCE_LUX / np.sqrt(ratio))
    effects = replace(found.sim.effects, illuminance_lux=illuminance_lux, camera2_light=ratio)
    return replace(found, sim=replace(found.sim, effects=effects), polarity=polarity)


def cells(recordings: bench.Recordings = None) -> list[bench.PhysicalCell]:
    """List every ratio and polarity on each recording."""
    found: list[bench.PhysicalCell] = []
    for flight in range(FIRST_FLIGHT, FIRST_FLIGHT + (recordings or N_RECORDINGS)):
        setup = bench.setup_seed(ANGLE_DEG, flight)
        for ratio in RATIOS:
            for name, polarity in POLARITIES.items():
                of, named = lit(ratio, polarity, setup), {"light_ratio": ratio, "polarity": name}
                found += bench.cells_of(of, named, flight, (T_D_MS,), (METHOD,))
    return found


def latency_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Apparent offsets, which are the estimated less the clocks', by ratio and polarity.

    `swapped_ms` is the mean of that of a ratio and its inverse, which swapping the lights leaves.
    """
    runs = runs.assign(apparent_ms=runs["t_d_estimate_ms"] - runs["t_d_ms"])

    def row(group: pd.DataFrame) -> dict[str, float]:
        ok = answered(group)
        counts = {"runs": len(group), "answered": len(ok)}
        apparent = statistics(ok, ["apparent_ms"], "mean", "std")
        return {**counts, **apparent, "t_d_std_ms": ok["t_d_std_ms"].mean()}

    table = by_group(runs, ("light_ratio", "polarity"), row)
    means = table["apparent_ms_mean"]
    inverse = table.set_index(["light_ratio", "polarity"])["apparent_ms_mean"]
    swapped = list(zip(1.0 / table["light_ratio"], table["polarity"], strict=True))
    return table.assign(swapped_ms=0.5 * (means + inverse.reindex(swapped).to_numpy()))


def latency_figure(summary: pd.DataFrame) -> Figure:
    """Draw the apparent offset against the ratio of the lights, by polarity."""
    figure, ((axes,),) = panels(3.6)
    by_polarity = dict(list(summary.groupby("polarity")))
    for polarity, (color, marker, label) in _LOOKS.items():
        part = by_polarity[polarity]
        axes.errorbar(
            part["light_ratio"], part["apparent_ms_mean"], part["apparent_ms_std"], color=color,
            marker=marker, ms=5, lw=0.9, label=label,
        )  # fmt: skip
    both = by_polarity["both"]
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
        both, apparent = by.loc["both"], by["apparent_ms_mean"]
        rows.append(
            [
                *(f"{ratio:g}", *(f"{apparent[name]:.2f}" for name in POLARITIES)),
                *(digits(float(both["t_d_std_ms"])), f"{both['swapped_ms']:.2f}"),
                f"{int(both['answered'])} of {int(both['runs'])}",
            ]
        )
    header = ["light 2 / 1", "apparent", "ON alone", "OFF alone", "stated 1 sigma"]
    return markdown_table([*header, "half sum with its inverse", "answered"], rows)


STUDIES = (
    Study(
        "light_latency",
        "Offsets that appear where two cameras are lit differently",
        cells,
        bench.PHYSICAL,
        Runs("light_latency_runs.csv", ("light_ratio", "polarity", "flight")),
        (made_of("light_latency.csv", latency_table, "light_latency_runs"),
         made_of("light_latency.png", latency_figure, "light_latency")),
        numbers={"table.latency": page_table},
        checks=(("as many are answered as ran", ordered("light_latency", "answered", "runs")),
                *scored_checks("light_latency_runs")),
        config={"n_recordings": N_RECORDINGS, "first_flight": FIRST_FLIGHT,
                "duration_s": DURATION_S, "angle_deg": ANGLE_DEG, "t_d_ms": T_D_MS,
                "ratios": RATIOS, "illuminance_lux": ILLUMINANCE_LUX, "method": METHOD,
                "bench": lit(1.0, None, 0)},
        command=bench.COMMAND,
    ),
)  # fmt: skip
