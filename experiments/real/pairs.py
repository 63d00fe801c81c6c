"""Public drone-tracking data sets in; every pair of cameras, synchronised from nothing, out."""

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ssac.clock import Clock
from ssac.config import Config
from ssac.convert.drone_tracking import ImportedCamera, import_data_set
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.network.graph import closures_s
from ssac.search.all_offsets import AllOffsets
from ssac.tool.everywhere import SKEW_PRIOR_PPM, Start
from ssac.tool.sync import SyncResult, sync

Array = NDArray[np.float64]
Row = dict[str, Any]

DATA_SETS = (1, 2, 4)

UNKNOWN_RATES = {(4, 3): (0.6, 0.8)}
"""Cameras whose frames were counted at another rate than their calibration says, and the rates that
are tried: data set 4's camera 3 counts native frames, some 18 to 24 a second, and says 30."""

VARIABLE_RATES = {(4, 2), (4, 3)}
"""Phones whose frame rate varied by far, as the data set's README says: their clocks, which count
frames, wander by a tenth of a second."""

ROUGHNESSES_PPM = (2000.0, 6000.0)
"""How clocks of pairs with such a camera are followed: the smoothest that is not refused. A frame
more or less in 5 s, of 30 a second, is 6700 ppm."""

PAIRS_FILE, TRIPLES_FILE, STRAYS_FILE = "real_pairs.csv", "real_triples.csv", "real_strays.csv"
COMMAND = "make real DATA=..."

PAIR_COLUMNS = (
    "data_set", "camera_1", "camera_2", "models", "status", "clock", "t_d_s", "t_d_std_ms",
    "t_ref_s", "skew_ppm", "skew_std_ppm", "most_stray_ms", "readout_1_ms",
    "readout_1_std_ms", "readout_2_ms", "readout_2_std_ms", "by_readouts_ms", "global_std_ms",
    "residual_px", "n_samples", "reason", "from_truth_ms", "seconds", "closure_ms",
)  # fmt: skip
TRIPLE_COLUMNS = ("data_set", "cameras", "closure_ms")
STRAY_COLUMNS = ("data_set", "camera_1", "camera_2", "t_s", "stray_ms", "std_ms")

_NUMBERS = re.compile(r"^\|\s*\d+\s*\|(.*)\|\s*$")


@dataclass(frozen=True)
class Truth:
    """Published clocks: frame j = alpha frame i + beta."""

    alpha: Array  # (n, n)
    beta: Array  # (n, n) [frames]

    def t_d_s(self, i: int, j: int, fps: tuple[float, float], time_s: float) -> float:
        """Offset t_d [s] of camera j by camera i, at a time of camera i's.

        From the direction whose alpha is greater: four decimals of 2 tell twice as much as of 0.5,
        25 ppm in place of 100, which are 23 ms at mid-flight in data set 4.
        """
        frame = time_s * fps[0]
        if self.alpha[i, j] >= self.alpha[j, i]:
            other = self.alpha[i, j] * frame + self.beta[i, j]
        else:
            other = (frame - self.beta[j, i]) / self.alpha[j, i]
        return float(other / fps[1] - time_s)


def load_truth(folder: Path) -> Truth | None:
    """Read the two tables of a data set's README; None where there are none."""
    path = folder / "README.md"
    if not path.is_file():
        return None
    lines = path.read_text(encoding="utf-8").splitlines()
    rows = [
        [float(cell) for cell in found.group(1).split("|")]
        for found in map(_NUMBERS.match, lines)
        if found
    ]
    n = len(rows) // 2
    if n == 0 or any(len(row) != n for row in rows):
        return None
    return Truth(np.array(rows[:n]), np.array(rows[n:]))


def run_pairs(
    data: Path, work: Path, log: Callable[[str], None], data_sets: tuple[int, ...] = DATA_SETS
) -> dict[str, pd.DataFrame]:
    """Synchronise every pair of cameras of some data sets.

    Parameters
    ----------
    data
        Folder with `dataset1` and so on, and `calibration`.
    work
        Folder for the tracks and rigs.
    log
        Called with a line on each pair.
    data_sets
        Their numbers.

    Returns
    -------
    dict of pd.DataFrame
        By file: a row for each pair; one for each triple of which all pairs are answered; and one
        for each knot of a clock that wanders.
    """
    pairs, triples, strays = list[Row](), list[Row](), list[Row]()
    for number in data_sets:
        folder = data / f"dataset{number}"
        if not folder.is_dir():
            raise SsacError(f"{folder}: there is no such folder: give that of the data sets")
        cameras = import_data_set(folder, work / folder.name)
        truth, clocks = load_truth(folder), dict[tuple[int, int], Clock]()
        rows = []
        for row, estimate, clock in _of_data_set(number, cameras, work / folder.name, truth, log):
            rows.append(row)
            if clock is not None:
                clocks[row["camera_1"], row["camera_2"]] = clock
            strays += _strays(row, estimate)
        found = closures_s(clocks)
        for row in rows:
            both = {row["camera_1"], row["camera_2"]}
            mine = [1e3 * abs(value) for triple, value in found.items() if both <= set(triple)]
            row["closure_ms"] = max(mine, default=np.nan)
        pairs += rows
        triples += [
            {"data_set": number, "cameras": "-".join(map(str, triple)), "closure_ms": 1e3 * value}
            for triple, value in found.items()
        ]
    return {
        PAIRS_FILE: pd.DataFrame(pairs, columns=PAIR_COLUMNS),
        TRIPLES_FILE: pd.DataFrame(triples, columns=TRIPLE_COLUMNS),
        STRAYS_FILE: pd.DataFrame(strays, columns=STRAY_COLUMNS),
    }


def real_config() -> dict[str, Any]:
    """Give what all pairs are made with, for provenance."""
    rates = {f"data set {number}, camera {k}": rate for (number, k), rate in UNKNOWN_RATES.items()}
    variable = [f"data set {number}, camera {k}" for number, k in sorted(VARIABLE_RATES)]
    return {
        "data_sets": DATA_SETS,
        "rates": rates,
        "variable_rates": {"cameras": variable, "roughnesses_ppm": ROUGHNESSES_PPM},
    }


def _of_data_set(
    number: int,
    cameras: list[ImportedCamera],
    folder: Path,
    truth: Truth | None,
    log: Callable[[str], None],
) -> Iterator[tuple[Row, Estimate, Clock | None]]:
    for i, j in combinations(range(len(cameras)), 2):
        start = time.perf_counter()
        for config in _configs(number, i, j):
            result = sync(
                folder / f"{cameras[i].name}.csv",
                folder / f"{cameras[j].name}.csv",
                folder / "rig.yaml",
                config=config,
                cameras=(i + 1, j + 1),
                search_all=True,
                rate_range=rate_range(number, i, j),
                estimate_readout=True,
            )
            if result.estimate.has_offset:
                break
        seconds = time.perf_counter() - start
        estimate, guess = result.estimate, result.guess
        has_skew = bool(np.isfinite(estimate.skew_ppm))
        t_ref_s = estimate.t_ref_s if has_skew or guess is None else guess.t_ref_s
        fps = cameras[i].fps, cameras[j].fps
        off_ms = np.nan
        applies = not {(number, i), (number, j)} & UNKNOWN_RATES.keys()  # of a remapped video
        if truth is not None and applies and guess is not None and estimate.has_offset:
            true_s = truth.t_d_s(i, j, fps, t_ref_s)
            off_ms = 1e3 * (estimate.t_d_s - true_s)
        models = f"{cameras[i].model} {cameras[j].model}"
        row: Row = {"data_set": number, "camera_1": i, "camera_2": j, "models": models}
        row |= _figures(result, t_ref_s) | _effect_of_readouts(result)
        row |= {"from_truth_ms": off_ms, "seconds": round(seconds, 1)}
        log(
            f"{number}: {i} {j} {estimate.status}, {result.config.clock}, t_d {estimate.t_d_s:.4f}"
            f" s +- {1e3 * estimate.t_d_std_s:.1f} ms, {off_ms:+.1f} ms from the truth,"
            f" {seconds:.1f} s"
        )
        clock = None
        if guess is not None and estimate.has_offset:
            clock = replace(estimate.clock, t_ref_s=t_ref_s)  # of a mere delay too: when to close
        yield row, estimate, clock


def _effect_of_readouts(result: SyncResult) -> Row:
    """Say where the offset were with shutters taken for global ones, and how sure it would be."""
    if result.guess is None or not result.estimate.has_offset:
        return {"by_readouts_ms": np.nan, "global_std_ms": np.nan}
    cameras = [replace(one, readout_std_s=0.0) for one in (result.rig.cam1, result.rig.cam2)]
    start = Start(AllOffsets(np.empty(0), np.empty(0), [result.guess], 0.0))
    other = start.as_recorded(
        result.method.estimate(
            result.cam1,
            start.as_seen(result.cam2),
            replace(result.rig, cam1=cameras[0], cam2=cameras[1]),
            result.config,
        )
    )
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


def _figures(result: SyncResult, t_ref_s: float) -> Row:
    estimate = result.estimate
    strays_ms = 1e3 * np.abs(estimate.strays_s)
    return {
        "status": str(estimate.status),
        "clock": result.config.clock,
        "t_d_s": estimate.t_d_s,
        "t_d_std_ms": 1e3 * estimate.t_d_std_s,
        "t_ref_s": t_ref_s,
        "skew_ppm": estimate.skew_ppm,
        "skew_std_ppm": estimate.skew_std_ppm,
        "most_stray_ms": float(np.max(strays_ms, initial=0.0)),
        "readout_1_ms": 1e3 * estimate.readouts_s[0],
        "readout_1_std_ms": 1e3 * estimate.readouts_std_s[0],
        "readout_2_ms": 1e3 * estimate.readouts_s[1],
        "readout_2_std_ms": 1e3 * estimate.readouts_std_s[1],
        "residual_px": estimate.d_avg_px,
        "n_samples": estimate.n_samples,
        "reason": estimate.reason,
    }


def _configs(number: int, i: int, j: int) -> list[Config | None]:
    """Give what is tried in turn for a pair, until it is answered; None: what sync tries itself."""
    if not {(number, i), (number, j)} & VARIABLE_RATES:
        return [None]
    return [
        Config(skew_prior_ppm=SKEW_PRIOR_PPM, clock="pieces", roughness_ppm=roughness_ppm)
        for roughness_ppm in ROUGHNESSES_PPM
    ]


def rate_range(number: int, i: int, j: int) -> tuple[float, float] | None:
    """Rates that are tried of camera j's clock by camera i's; None where both are known."""
    low, high = UNKNOWN_RATES.get((number, j), (1.0, 1.0))
    slow, fast = UNKNOWN_RATES.get((number, i), (1.0, 1.0))
    return None if low == high and slow == fast else (low / fast, high / slow)
