"""Data sets with every pair synchronised in; all cameras solved at once, beside RTK, out."""

import time
from typing import Any

import numpy as np
import pandas as pd

from experiments.real.data_sets import VARIABLE_RATES, DataSet, load_rtk
from ssac.config import SKEW_PRIOR_PPM
from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.network.comparison import Comparison, compare
from ssac.network.solve import NetworkAnswer
from ssac.pipeline.api import chain_of
from ssac.pipeline.many import solve_pairs

PATHS_FILE = "real_paths.csv"

PATH_FIGURE = "real_path_{}.png"

COLUMNS = (
    "data_set", "cameras", "left_out", "rmse_m", "mean_m", "median_m", "max_m", "n_rtk", "coverage",
    "shift_s", "rate_ppm", "scale_m", "most_from_truth_ms", "rms_px", "pairs_s", "network_s",
)  # fmt: skip

Row = dict[str, Any]


def path_of(one: DataSet) -> tuple[Row, Comparison]:
    """Solve all cameras of a data set at once, from what its pairs gave, and compare with RTK.

    Returns
    -------
    tuple
        The row of the table, and how the path lies beside RTK.

    Raises
    ------
    SsacError
        If no cameras see a path together, or RTK cannot be read.
    """
    start_s = time.process_time()
    answer = solve_pairs(chain_of(one.tracks, one.rig), one.pairs)
    network_s = time.process_time() - start_s
    if not answer.paths:
        raise SsacError(f"{one.folder}: no cameras see a path together: {answer.reason}")
    found = compare(answer.paths[0].path, load_rtk(one.folder), rate_std_ppm=SKEW_PRIOR_PPM)
    row = _row(one, answer, found)
    pairs_s = sum(one.seconds.values())
    return row | {"pairs_s": round(pairs_s, 1), "network_s": round(network_s, 1)}, found


def path_table(rows: list[Row]) -> pd.DataFrame:
    """Lay out a row for each data set."""
    return pd.DataFrame(rows, columns=COLUMNS)


def _row(one: DataSet, answer: NetworkAnswer, found: Comparison) -> Row:
    in_time = found.in_time
    if in_time is None:
        raise SsacError(f"data set {one.number}: the path and RTK have times, but share none")
    placed = [camera for camera in answer.cameras if camera.status == Status.OK]
    return {
        "data_set": one.number,
        "cameras": len(placed),
        "left_out": " ".join(answer.left_out),
        "rmse_m": in_time.rmse_m,
        "mean_m": float(np.mean(in_time.distances_m)),
        "median_m": float(np.median(in_time.distances_m)),
        "max_m": float(np.max(in_time.distances_m)),
        "n_rtk": len(in_time.distances_m),
        "coverage": in_time.coverage,
        "shift_s": in_time.clock.t_d_s,
        "rate_ppm": in_time.clock.skew_ppm,
        "scale_m": in_time.similarity.scale,
        "most_from_truth_ms": _most_off_ms(one, answer),
        "rms_px": float(np.median([camera.rms_px for camera in placed])),
    }


def _most_off_ms(one: DataSet, answer: NetworkAnswer) -> float:
    """Give the most that a clock of constant rate is off the published one [ms]; NaN of none."""
    first, *others = answer.cameras
    off_ms = [
        abs(one.off_truth_ms((0, k), camera.t_d_s, camera.t_ref_s))
        for k, camera in enumerate(others, 1)
        if (one.number, k) not in VARIABLE_RATES and camera.status == Status.OK
    ]
    return max(off_ms, default=np.nan) if first.status == Status.OK else np.nan
