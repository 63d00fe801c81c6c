"""Results in, the tables that the pages show out as Markdown, each under a name."""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from experiments.lab.markdown import markdown_table
from experiments.lab.results import FloatArray, Results
from experiments.measures.fidelity import METHOD_NAMES as COMPARED_METHODS
from experiments.paper.quantities import POSE_ERRORS, T_D_ERROR
from experiments.quoted.campaigns import CAMPAIGN_TABLES
from experiments.quoted.cells import SYMBOLS
from experiments.quoted.marks import MARK_TABLES
from experiments.quoted.real import REAL_TABLES
from experiments.quoted.zncc import ZNCC_TABLES
from experiments.studies.fidelity import DIFFERENCES, MARKS_MS
from experiments.studies.refusal import METHOD_NAMES as REFUSING_METHODS

Rows = list[list[str]]

_BESIDE = {
    # of bench.csv: row, unit, decimals and the words for it
    "render, native, 257 samples per pixel: crops": ("poses/s", 0, "rendering, native"),
    "render, native, 257 samples per pixel: ratio to OpenGL's crops": ("x", 1, "... over OpenGL"),
    "render, native, 257 samples per pixel: ratio": ("x", 0, "... over pyrender alike"),
    "render, native, 64 samples per pixel: ratio to it": (
        "x",
        0,
        "64 samples, over pyrender untouched",
    ),
    "render, osmesa, 257 samples per pixel: crops": ("poses/s", 0, "rendering, OSMesa"),
    "render, osmesa, 257 samples per pixel: ratio": ("x", 0, "the same, over pyrender alike"),
    "render, egl, 257 samples per pixel: crops": ("poses/s", 0, "rendering, EGL"),
    "render, egl, 257 samples per pixel: ratio": ("x", 0, "the same, over pyrender alike"),
    "sensor, 346 x 260 float frames": ("frames/s", 0, "sensor model, full frames"),
    "sensor over eventify-dvs": ("x", 1, "... over eventify-dvs' NumPy"),
    "sensor over ESIM's core, quoted": ("x", 2, "... over ESIM's C++, as quoted"),
    "simulate a 20 s pair, frames included": ("s", 1, "a pair of 20 s simulated"),
    "simulate a 20 s pair: peak memory": ("MB", 0, "its memory"),
    "sync, ssac: all but reading": ("s", 2, "`ssac` on a pair of 20 s"),
    "sync, joint: all but reading": ("s", 2, "`joint` on it"),
    "sync, tangency: all but reading": ("s", 2, "`tangency` on it"),
    "sync, stage: reading": ("s", 2, "of this, first: reading"),
    "sync, stage: checks and denoising": ("s", 2, "checks and denoising"),
    "sync, stage: tracks": ("s", 2, "tracks"),
    "sync, stage: search over +-1 s": ("s", 2, "search over 2 s"),
    "sync, stage: joint refinement": ("s", 2, "`joint`'s refinement"),
    "sync, stage: tangency refinement": ("s", 2, "`tangency`'s refinement"),
    "read 10 M events, .h5: ratio": ("x", 2, "reading HDF5, over h5py"),
    "read 10 M events, .aedat4: ratio": ("x", 2, "reading AEDAT4, over faery"),
    "read 10 M events, .raw: ratio": ("x", 2, "reading RAW, over faery"),
    "tables: recordings": ("", 0, "recordings of the tables"),
    "tables, from nothing: all, 2 workers": ("s", 0, "the tables from nothing"),
    "tables, recordings cached: all, 2 workers": ("s", 0, "... recordings cached"),
    "tables, from nothing: 1 -> 2 workers": ("x", 2, "two workers over one"),
    "tables: peak memory of a worker": ("MB", 0, "memory of a worker"),
    "growth, largest pair: events per camera": ("events", 0, "the largest pair: events a camera"),
    "growth, largest pair: simulate": ("s", 0, "simulated"),
    "growth, largest pair: simulate, peak memory": ("MB", 0, "... memory"),
    "growth, largest pair: synchronise": ("s", 1, "synchronised"),
    "growth, largest pair: synchronise, peak memory": ("MB", 0, "... memory"),
    "growth, 1280 x 720: simulate, time over events": ("exponent", 2, "growth: simulating, time"),
    "growth, 1280 x 720: synchronise, time over events": ("exponent", 2, "... synchronising, time"),
    "growth, 1280 x 720: synchronise, memory over events": ("exponent", 2, "... and memory"),
}


_OPTIONAL = ("sensor over eventify-dvs", "sensor over ESIM's core, quoted")
"""Of these rows: with the peer's package alone."""


def refusal_table(results: Results) -> str:
    """How many offsets were given, and how many confident wrong ones, for each kind and method."""
    table = results.table("refusal")
    rows: Rows = []
    for kind in dict.fromkeys(table["kind"]):
        cells = [kind, str(int(results.rows("refusal", kind=kind, method="joint")["runs"].iloc[0]))]
        for method in REFUSING_METHODS:
            of = {"kind": kind, "method": method}
            given = results.value("refusal", "offset_given", **of)
            wrong = results.value("refusal", "confident_wrong", **of)
            cells.append(f"{given:.0f}" + (f" ({wrong:.0f} wrong)" if wrong else ""))
        rows.append(cells)
    return markdown_table(["kind", "n", *(f"`{m}`" for m in REFUSING_METHODS)], rows)


def tangency_table(results: Results) -> str:
    """Lay out the errors of the variants of `tangency`."""
    table = results.table("tangency")
    rows: Rows = []
    for variant in table["variant"]:

        def of(column: str, variant: str = variant) -> float:
            return results.value("tangency", column, variant=variant)

        rows.append(
            [
                f"**{variant}**" if variant == "as it is" else variant,
                *(f"{of(c):.3f}" for c in (T_D_ERROR.column, f"{T_D_ERROR.column}_worst")),
                *(f"{of(c):.3f}" for c in POSE_ERRORS),
                f"{of('t_d_bias_ms'):+.3f}",
                f"{of('normalised_rms'):.2f}",
            ]
        )
    t_d, *pose = (error.heading for error in SYMBOLS.values())
    header = ["variant", t_d, "worst angle", *pose, "bias [ms]", "error / deviation"]
    return markdown_table(header, rows)


def fidelity_table(results: Results, study: str = "fidelity") -> str:
    """How far events and offsets are from those of a reference, by duration [s]."""
    runs = f"{study}_runs"
    durations_s = sorted(set(results.column(runs, "duration_s")))

    def row(words: str, column: str, scale: float = 1.0, places: int = 0) -> list[str]:
        means = (scale * ok(duration_s, column).mean() for duration_s in durations_s)
        return [words, *(f"{mean:.{places}f}" for mean in means)]

    def ok(duration_s: float, column: str) -> FloatArray:
        return results.column(runs, column, duration_s=duration_s, status="ok")

    # The two renderers differ by far less than the dense reference from either.
    dense = study == "fidelity"
    decimals = 3 if dense else 5
    rows: Rows = [
        ["flights", *(str(len(ok(duration_s, "median_us"))) for duration_s in durations_s)],
        row("event times, median [us]", "median_us"),
        row("event times, 95th percentile [us]", "p95_us"),
        row("spurious events [%]", "spurious", 100, 1),
        row("missing events [%]", "missing", 100, 1),
    ]
    for method, column in zip(COMPARED_METHODS, DIFFERENCES, strict=True):
        mark = f", mark {MARKS_MS[method]:g}" if dense and method in MARKS_MS else ""
        cells = [f"t_d by `{method}`: mean difference (largest){mark} [ms]"]
        for duration_s in durations_s:
            sizes = np.abs(ok(duration_s, column))
            mean = f"{sizes.mean():.{decimals}f}"
            if len(sizes) > 1:
                mean += f" ± {sizes.std(ddof=1) / len(sizes) ** 0.5:.{decimals}f}"
            cells.append(f"{mean} ({sizes.max():.{decimals}f})")
        rows.append(cells)
    return markdown_table(["quantity", *(f"{d:g} s" for d in durations_s)], rows)


def bench_table(results: Results) -> str:
    """Lay out the main figures of the benchmark beside their marks.

    What only some machines can measure is left out where it was not.
    """
    rows: Rows = []
    measured = set(results.table("bench")["name"])
    for name, (unit, decimals, words) in _BESIDE.items():
        if name in _OPTIONAL and name not in measured:
            continue
        row = results.rows("bench", name=name).iloc[0]
        value, mark = float(row["value"]), float(row["mark"])
        bound = ">=" if str(row["higher_is_better"]) == "True" else "<="
        rows.append(
            [
                words,
                f"{value:.{decimals}f} {unit}".strip(),
                f"{bound} {mark:g} {unit}" if np.isfinite(mark) else "",
                str(row["verdict"]) if np.isfinite(mark) else "",
            ]
        )
    return markdown_table(["what", "measured", "mark", "verdict"], rows)


TABLES: Mapping[str, Callable[[Results], str]] = {
    "table.refusal": refusal_table,
    "table.tangency": tangency_table,
    "table.fidelity": fidelity_table,
    "table.renderers": partial(fidelity_table, study="renderers"),
    "table.bench": bench_table,
    **CAMPAIGN_TABLES,
    **ZNCC_TABLES,
    **REAL_TABLES,
    **MARK_TABLES,
}
