"""Data sets with every pair synchronised in; tables of pairs, triples and wandering clocks, out."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from experiments.real.data_sets import DataSet
from ssac.clock import Clock
from ssac.estimate import Estimate
from ssac.network.graph import Pair, closures_s
from ssac.pipeline.answer import Answer
from ssac.pipeline.chain import Chain

Row = dict[str, Any]

PAIRS_FILE, TRIPLES_FILE, STRAYS_FILE = "real_pairs.csv", "real_triples.csv", "real_strays.csv"

PAIR_COLUMNS = (
    "data_set", "camera_1", "camera_2", "models", "status", "clock", "t_d_s", "t_d_std_ms",
    "t_ref_s", "skew_ppm", "skew_std_ppm", "most_stray_ms", "readout_1_ms",
    "readout_1_std_ms", "readout_2_ms", "readout_2_std_ms", "by_readouts_ms", "global_std_ms",
    "residual_px", "n_samples", "reason", "from_truth_ms", "seconds", "closure_ms",
)  # fmt: skip
TRIPLE_COLUMNS = ("data_set", "cameras", "closure_ms")
STRAY_COLUMNS = ("data_set", "camera_1", "camera_2", "t_s", "stray_ms", "std_ms")


def pair_tables(sets: Iterable[DataSet]) -> dict[str, pd.DataFrame]:
    """Lay out what the pairs of data sets gave.

    Returns
    -------
    dict of pd.DataFrame
        By file: a row for each pair; one for each triple of which all pairs are answered; and one
        for each knot of a clock that wanders.
    """
    pairs, triples, strays = list[Row](), list[Row](), list[Row]()
    for one in sets:
        clocks = {pair: _clock(one.pairs[pair]) for pair in one.pairs}
        found = closures_s({pair: clock for pair, clock in clocks.items() if clock is not None})
        for pair, result in one.pairs.items():
            mine = [1e3 * abs(s) for triple, s in found.items() if set(pair) <= set(triple)]
            row = _row(one, pair) | {"closure_ms": max(mine, default=np.nan)}
            pairs.append(row)
            strays += _strays(row, result.estimate)
        triples += [
            {"data_set": one.number, "cameras": "-".join(map(str, triple)), "closure_ms": 1e3 * s}
            for triple, s in found.items()
        ]
    return {
        PAIRS_FILE: pd.DataFrame(pairs, columns=PAIR_COLUMNS),
        TRIPLES_FILE: pd.DataFrame(triples, columns=TRIPLE_COLUMNS),
        STRAYS_FILE: pd.DataFrame(strays, columns=STRAY_COLUMNS),
    }


def _clock(result: Answer) -> Clock | None:
    """Give the clock that a pair found; of a mere delay, too, with a time at which to close."""
    if result.guess is None or not result.estimate.has_offset:
        return None
    return replace(result.estimate.clock, t_ref_s=_t_ref_s(result))


def _t_ref_s(result: Answer) -> float:
    estimate, guess = result.estimate, result.guess
    has_skew = bool(np.isfinite(estimate.skew_ppm))
    return estimate.t_ref_s if has_skew or guess is None else guess.t_ref_s


def _row(one: DataSet, pair: Pair) -> Row:
    result, (i, j) = one.pairs[pair], pair
    estimate, t_ref_s = result.estimate, _t_ref_s(result)
    off_ms = np.nan
    if estimate.has_offset:
        off_ms = one.off_truth_ms(pair, estimate.t_d_s, t_ref_s)
    return {
        "data_set": one.number,
        "camera_1": i,
        "camera_2": j,
        "models": f"{one.cameras[i].model} {one.cameras[j].model}",
        "status": str(estimate.status),
        "clock": result.config.clock,
        "t_d_s": estimate.t_d_s,
        "t_d_std_ms": 1e3 * estimate.t_d_std_s,
        "t_ref_s": t_ref_s,
        "skew_ppm": estimate.skew_ppm,
        "skew_std_ppm": estimate.skew_std_ppm,
        "most_stray_ms": float(np.max(1e3 * np.abs(estimate.strays_s), initial=0.0)),
        "readout_1_ms": 1e3 * estimate.readouts_s[0],
        "readout_1_std_ms": 1e3 * estimate.readouts_std_s[0],
        "readout_2_ms": 1e3 * estimate.readouts_s[1],
        "readout_2_std_ms": 1e3 * estimate.readouts_std_s[1],
        "residual_px": estimate.d_avg_px,
        "n_samples": estimate.n_samples,
        "reason": estimate.reason,
        "from_truth_ms": off_ms,
        "seconds": round(one.seconds[pair], 1),
        **_effect_of_readouts(result),
    }


def _effect_of_readouts(result: Answer) -> Row:
    """Say where the offset were with shutters taken for global ones, and how sure it would be."""
    start = result.start
    if start is None or not result.estimate.has_offset:
        return {"by_readouts_ms": np.nan, "global_std_ms": np.nan}
    cameras = [replace(one, readout_std_s=0.0) for one in (result.rig.cam1, result.rig.cam2)]
    rig = replace(result.rig, cam1=cameras[0], cam2=cameras[1])
    seen = result.cleans[0], start.as_seen(result.cleans[1])
    other = start.as_recorded(Chain(seen, rig, result.config).estimate(result.method))
    return {
        "by_readouts_ms": 1e3 * (result.estimate.t_d_s - other.t_d_s),
        "global_std_ms": 1e3 * other.t_d_std_s,
    }


def _strays(row: Row, estimate: Estimate) -> list[Row]:
    pair = {name: row[name] for name in STRAY_COLUMNS[:3]}
    columns = estimate.knots_s, 1e3 * estimate.strays_s, 1e3 * estimate.strays_std_s
    return [
        pair | dict(zip(STRAY_COLUMNS[3:], knot, strict=True))
        for knot in zip(*columns, strict=True)
    ]
