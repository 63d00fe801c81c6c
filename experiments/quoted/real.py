"""Results in, what the pages say of imperfect recordings and of the public drone tracks out."""

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.markdown import markdown_table
from experiments.lab.results import FloatArray, Results
from experiments.real.data_sets import DATA_SETS, UNKNOWN_RATES, VARIABLE_RATES
from experiments.studies.coverage import sampling_bounds
from experiments.studies.imperfect import ALL, HELD, IMPERFECT
from ssac.clock import PPM
from ssac.estimate import Status

SHOWN = ("joint", "tangency")
"""Methods of the rows of single kinds; over all kinds all of them have one."""


PAIRS, TRIPLES, PATHS = "real_pairs", "real_triples", "real_paths"

MVUS = {1: (0.050, 608), 2: (0.126, 793), 4: (0.535, 1572)}
"""RMSE [m] of mvus (Li et al., IROS 2020) in its published configuration, and samples of RTK, run
once and not by a command of ours; of data set 4 on the authors' automatic detections."""

WITH_TRUTH, SHIFTED = 4, 1
"""The data set with published clocks, and its camera that these put elsewhere."""


def imperfect_table(results: Results) -> str:
    """Say of all kinds together how many were answered, and how many of the answers held."""
    table = results.table(IMPERFECT.name)
    rows = []
    for row in table[table["kind"] == ALL].to_dict("records"):
        shares = (_share(row, name, with_bounds=True) for name in HELD)
        rows.append(
            [f"`{row['method']}`", _answered(row), *shares, f"{row['confident_wrong']:.0f}"]
        )
    quantities = (f"{name} [%]" for name in HELD)
    return markdown_table(["method", "answered", *quantities, "confident wrong"], rows)


def kinds_table(results: Results) -> str:
    """Say of each kind how many were answered and why others were not, and how many held."""
    table = results.table(IMPERFECT.name)
    rows = []
    for row in table[(table["kind"] != ALL) & table["method"].isin(SHOWN)].to_dict("records"):
        refused = "" if pd.isna(row["refused"]) else str(row["refused"]).replace(":", " ")
        shares = (_share(row, name, with_bounds=False) for name in HELD)
        refused = refused.replace("_", " ")
        wrong = f"{row['confident_wrong']:.0f}"
        rows.append([row["kind"], f"`{row['method']}`", _answered(row), refused, *shares, wrong])
    return markdown_table(["kind", "method", "answered", "refused", *HELD, "wrong"], rows)


def _answered(row: Mapping[Hashable, Any]) -> str:
    return f"{row['answered']:.0f} of {row['runs']:.0f}"


def _share(row: Mapping[Hashable, Any], name: str, with_bounds: bool) -> str:
    """Share of the answers that held; with what the number of runs leaves open, where asked for."""
    n_given, share = int(row[f"{name}_given"]), float(row[f"{name}_held"])
    if not np.isfinite(share):
        return ""
    if not with_bounds:
        return f"{100 * share:.0f}"
    low, high = sampling_bounds(round(share * n_given), n_given)
    return f"{100 * share:.0f} ({100 * low:.0f} to {100 * high:.0f})"


def of_imperfect(results: Results, column: str, method: str) -> str:
    """Count the imperfect recordings, those answered, or those whose truth an interval holds."""
    of = {"kind": ALL, "method": method}
    value = results.value(IMPERFECT.name, column, **of)
    if column.endswith("_held"):
        value *= results.value(IMPERFECT.name, column.replace("_held", "_given"), **of)
    return f"{value:.0f}"


def kinds_not_answered(results: Results) -> str:
    """List the kinds of imperfect recordings that `tangency` does not answer throughout."""
    table = results.rows(IMPERFECT.name, method="tangency")
    rows = table[(table["kind"] != ALL) & (table["answered"] < table["runs"])]
    return "; ".join(
        f"{row['kind']}: {row['runs'] - row['answered']:.0f} of {row['runs']:.0f}"
        for row in rows.to_dict("records")
    )


def kinds_wrong(results: Results) -> str:
    """List the kinds of imperfect recordings of which `tangency` gives confident wrong answers."""
    table = results.rows(IMPERFECT.name, method="tangency")
    rows = table[(table["kind"] != ALL) & (table["confident_wrong"] > 0)]
    return "; ".join(
        f"{row['kind']}: {row['confident_wrong']:.0f} of {row['runs']:.0f}"
        for row in rows.to_dict("records")
    )


def answered(results: Results, number: int) -> str:
    """Say how many pairs of a data set are answered."""
    rows = results.rows(PAIRS, data_set=number)
    return f"{int(_has_offset(rows).sum())} of {len(rows)}"


def largest_closure(results: Results, number: int) -> str:
    """Say by how much the clocks of three cameras contradict each other at most."""
    closures_ms = _closures_ms(results, number)
    return f"{np.abs(closures_ms).max():.0f} ms" if len(closures_ms) else "none"


def largest_difference(results: Results, with_shifted: bool) -> str:
    """Say how far pairs of constant rate are off the published clocks, with that camera or not."""
    rows = _constant(results)
    if not with_shifted:
        rows = rows[(rows["camera_1"] != SHIFTED) & (rows["camera_2"] != SHIFTED)]
    return f"{np.abs(rows['from_truth_ms']).max():.0f} ms"


def apart(results: Results) -> str:
    """Say how far one camera's clock is off the published, where the others are so on average.

    By least squares each camera is off by an amount of its own, and a pair by their difference.
    """
    rows = _constant(results)
    cameras = sorted({*rows["camera_1"], *rows["camera_2"]})
    by = np.zeros((len(rows), len(cameras)))
    for n, (i, j) in enumerate(zip(rows["camera_1"], rows["camera_2"], strict=True)):
        by[n, cameras.index(i)], by[n, cameras.index(j)] = -1.0, 1.0
    off_ms = np.linalg.lstsq(by, rows["from_truth_ms"].to_numpy(), rcond=None)[0]
    at = cameras.index(SHIFTED)
    return f"{off_ms[at] - np.mean(np.delete(off_ms, at)):.0f} ms"


def readouts_of(results: Results, camera: int) -> str:
    """Range of the readouts that the pairs of a camera found, with the largest deviation."""
    rows = results.rows(PAIRS, data_set=WITH_TRUTH)
    found = [
        rows[rows[f"camera_{k}"] == camera][[f"readout_{k}_ms", f"readout_{k}_std_ms"]].to_numpy()
        for k in (1, 2)
    ]
    values_ms, stds_ms = np.vstack(found).T
    return f"{np.nanmin(values_ms):.0f} to {np.nanmax(values_ms):.0f} ms (1 sigma up to " + (
        f"{np.nanmax(stds_ms):.0f} ms)"
    )


def moved_by_readouts(results: Results) -> str:
    """Say how far readouts move an offset at most."""
    return f"{np.nanmax(np.abs(results.column(PAIRS, 'by_readouts_ms'))):.0f} ms"


def rate(results: Results, camera: int) -> str:
    """Rate of a camera's clock by that of camera 0, which counts frames at a constant rate."""
    of = {"data_set": WITH_TRUTH, "camera_1": 0, "camera_2": camera}
    return f"{1.0 + PPM * results.value(PAIRS, 'skew_ppm', **of):.4f}"


def strays(results: Results) -> str:
    """Range of how far clocks of cameras of varying rates stray, of all their pairs."""
    rows = results.rows(PAIRS, data_set=WITH_TRUTH)
    rows = rows[_varies(rows) & _has_offset(rows)]
    return f"{rows['most_stray_ms'].min():.0f} to {rows['most_stray_ms'].max():.0f} ms"


def pairs_table(results: Results) -> str:
    """Lay out, by data set, how many pairs are answered, how they agree, and how long it took."""
    body = []
    for number in DATA_SETS:
        rows = results.rows(PAIRS, data_set=number)
        tried = np.array([any((number, k) in UNKNOWN_RATES for k in pair) for pair in _pairs(rows)])
        seconds = rows["seconds"].to_numpy()
        n_triples = len(_closures_ms(results, number))
        body.append(
            [
                str(number),
                answered(results, number),
                f"{n_triples}, {largest_closure(results, number)}",
                f"{np.median(rows['t_d_std_ms']):.1f} ms",
                f"{seconds[~tried].max():.0f} s",
                f"{seconds[tried].max():.0f} s" if tried.any() else "",
            ]
        )
    header = ["data set", "pairs answered", "triples, most open"]
    header += ["median deviation", "longest pair", "with a search of rates"]
    return markdown_table(header, body)


def paths_table(results: Results) -> str:
    """Lay out how each path lies beside RTK, mvus' beside it."""
    body = []
    for row in results.table(PATHS).to_dict("records"):
        rmse_m, n_rtk = MVUS[int(row["data_set"])]
        off_ms = float(row["most_from_truth_ms"])
        body.append(
            [
                f"{row['data_set']:.0f}",
                f"{row['cameras']:.0f}",
                f"{row['rmse_m']:.3f} / {row['median_m']:.3f} / {row['max_m']:.2f} m",
                f"{row['n_rtk']:.0f}",
                f"{100 * row['coverage']:.0f} %",
                f"{off_ms:.0f} ms" if np.isfinite(off_ms) else "",
                f"{row['rms_px']:.2f} px",
                f"{row['pairs_s']:.0f} + {row['network_s']:.0f} s",
                f"{rmse_m:.3f} m, {n_rtk}",
            ]
        )
    header = ["set", "cameras", "RMSE / median / most", "RTK", "seen", "clocks off", "residual"]
    header += ["time", "mvus: RMSE, RTK"]
    return markdown_table(header, body)


def _closures_ms(results: Results, number: int) -> FloatArray:
    """Give the closures (k,) of a data set's triples, of which there may be none."""
    table = results.table(TRIPLES)
    return table["closure_ms"][table["data_set"] == number].to_numpy(np.float64)


def _constant(results: Results) -> pd.DataFrame:
    """Give the answered pairs with published clocks of which both cameras' rates are constant."""
    rows = results.rows(PAIRS, data_set=WITH_TRUTH)
    kept: pd.Series[bool] = ~_varies(rows) & _has_offset(rows) & rows["from_truth_ms"].notna()
    return rows[kept]


def _varies(rows: pd.DataFrame) -> "pd.Series[bool]":
    found = [any((WITH_TRUTH, k) in VARIABLE_RATES for k in pair) for pair in _pairs(rows)]
    return pd.Series(found, index=rows.index)


def _pairs(rows: pd.DataFrame) -> list[tuple[int, int]]:
    return list(zip(rows["camera_1"], rows["camera_2"], strict=True))


def _has_offset(rows: pd.DataFrame) -> "pd.Series[bool]":
    return rows["status"].isin([str(status) for status in Status if status.has_offset])


REAL_NUMBERS: Mapping[str, Callable[[Results], str]] = {
    "imperfect.runs": partial(of_imperfect, column="runs", method="tangency"),
    "imperfect.kinds_not_answered": kinds_not_answered,
    "imperfect.kinds_wrong": kinds_wrong,
    **{
        f"imperfect.{name}.{method}": partial(of_imperfect, column=column, method=method)
        for method in SHOWN
        for name, column in {
            "answered": "answered",
            "wrong": "confident_wrong",
            **{f"held.{quantity}": f"{quantity}_held" for quantity in HELD},
        }.items()
    },
    **{f"real.answered.{n}": partial(answered, number=n) for n in DATA_SETS},
    **{f"real.closure.{n}": partial(largest_closure, number=n) for n in DATA_SETS},
    "real.off": partial(largest_difference, with_shifted=True),
    "real.off.others": partial(largest_difference, with_shifted=False),
    "real.camera1.apart": apart,
    "real.camera1.readouts": partial(readouts_of, camera=SHIFTED),
    "real.camera1.rate": partial(rate, camera=SHIFTED),
    "real.camera3.rate": partial(rate, camera=3),
    "real.readouts": moved_by_readouts,
    "real.strays": strays,
}

REAL_TABLES: Mapping[str, Callable[[Results], str]] = {
    "table.imperfect": imperfect_table,
    "table.imperfect.kinds": kinds_table,
    "table.real.pairs": pairs_table,
    "table.real.paths": paths_table,
}
