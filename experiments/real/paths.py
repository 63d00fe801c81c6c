"""Public data sets in; all cameras solved at once, and their paths beside RTK, out."""

import time
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.real.pairs import DATA_SETS, VARIABLE_RATES, Truth, load_truth, rate_range
from ssac.compare.comparison import Comparison, compare
from ssac.convert.drone_tracking import ImportedCamera, import_data_set
from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.network.graph import Pair
from ssac.network.solve import NetworkAnswer
from ssac.path import tum
from ssac.tool.everywhere import SKEW_PRIOR_PPM
from ssac.tool.many import solve_pairs
from ssac.tool.sync import SyncResult, sync

PATHS_FILE = "real_paths.csv"

PATH_FIGURE = "real_path_{}.png"

RTK_S = 0.2
"""Time between two samples of RTK; data set 4 counts them, and leaves some out."""

COLUMNS = (
    "data_set", "cameras", "left_out", "rmse_m", "mean_m", "median_m", "max_m", "n_rtk", "coverage",
    "shift_s", "rate_ppm", "scale_m", "most_from_truth_ms", "rms_px", "pairs_s", "network_s",
)  # fmt: skip

Row = dict[str, Any]


def run_paths(
    data: Path, work: Path, log: Callable[[str], None], data_sets: tuple[int, ...] = DATA_SETS
) -> tuple[pd.DataFrame, dict[int, Comparison]]:
    """Solve all cameras of some data sets at once, from nothing, and compare with RTK.

    Parameters
    ----------
    data
        Folder with `dataset1` and so on, and `calibration`.
    work
        Folder for the tracks and rigs.
    log
        Called with a line on each data set.
    data_sets
        Their numbers.

    Returns
    -------
    tuple
        A row for each data set, and how each path lies beside its RTK.
    """
    rows, comparisons = list[Row](), dict[int, Comparison]()
    for number in data_sets:
        folder, own = data / f"dataset{number}", work / f"dataset{number}"
        cameras = import_data_set(folder, own)
        start = time.process_time()
        pairs = _pairs(number, cameras, own)
        between = time.process_time()
        answer = solve_pairs([own / f"{camera.name}.csv" for camera in cameras], pairs)
        seconds = between - start, time.process_time() - between
        if not answer.paths:
            raise SsacError(f"{folder}: no cameras see a path together: {answer.reason}")
        found = compare(answer.paths[0].path, load_rtk(folder), rate_std_ppm=SKEW_PRIOR_PPM)
        comparisons[number] = found
        rows.append(_row(number, answer, found, _most_off_ms(number, cameras, answer, folder)))
        rows[-1] |= {"pairs_s": round(seconds[0], 1), "network_s": round(seconds[1], 1)}
        log(
            f"{number}: {rows[-1]['cameras']} cameras, RMSE {rows[-1]['rmse_m']:.3f} m at "
            f"{rows[-1]['n_rtk']} samples of RTK, {sum(seconds):.0f} s"
        )
    return pd.DataFrame(rows, columns=COLUMNS), comparisons


def load_rtk(folder: Path) -> tum.Path:
    """Read the antenna's positions [m] of a data set, with times from its first sample on [s]."""
    path = folder / "trajectory" / "rtk.txt"
    try:
        table = np.loadtxt(path, dtype=np.float64, ndmin=2)
    except (OSError, ValueError) as error:
        raise SsacError(
            f"{path}: expected lines `[index] x y z` ({error}): get it again"
        ) from error
    if table.shape[1] not in (3, 4):
        raise SsacError(
            f"{path}: expected lines `[index] x y z`, got {table.shape[1]} columns: get it again"
        )
    index = table[:, 0] if table.shape[1] == 4 else np.arange(len(table), dtype=np.float64)
    return tum.Path(RTK_S * index, table[:, -3:])


def _pairs(number: int, cameras: list[ImportedCamera], own: Path) -> dict[Pair, SyncResult]:
    """Synchronise every pair from nothing."""
    found = {}
    for a, b in combinations(range(len(cameras)), 2):
        found[a, b] = sync(
            own / f"{cameras[a].name}.csv",
            own / f"{cameras[b].name}.csv",
            own / "rig.yaml",
            cameras=(a + 1, b + 1),
            search_all=True,
            rate_range=rate_range(number, a, b),
        )
    return found


def _row(number: int, answer: NetworkAnswer, found: Comparison, off_ms: float) -> Row:
    in_time = found.in_time
    if in_time is None:
        raise SsacError(f"data set {number}: the path and RTK have times, but share none")
    placed = [camera for camera in answer.cameras if camera.status == Status.OK]
    return {
        "data_set": number,
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
        "most_from_truth_ms": off_ms,
        "rms_px": float(np.median([camera.rms_px for camera in placed])),
    }


def _most_off_ms(
    number: int, cameras: list[ImportedCamera], answer: NetworkAnswer, folder: Path
) -> float:
    """Give the most that a clock of constant rate is off the published one [ms]; NaN of none."""
    truth: Truth | None = load_truth(folder)
    first = answer.cameras[0]
    if truth is None or first.status != Status.OK:
        return np.nan
    most_ms = 0.0
    for k, camera in enumerate(answer.cameras[1:], 1):
        if (number, k) in VARIABLE_RATES or camera.status != Status.OK:
            continue
        fps = cameras[0].fps, cameras[k].fps
        true_s = truth.t_d_s(0, k, fps, camera.t_ref_s)
        most_ms = max(most_ms, 1e3 * abs(camera.t_d_s - true_s))
    return most_ms
