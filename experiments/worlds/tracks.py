"""Public drone-tracking data sets: what is published, and what is estimated from their tracks.

Every pair of cameras is synchronised without a prior offset or pose; then all cameras of a data set
are solved jointly, and the path is compared with RTK. The data are not ours to ship.
"""

import re
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ssac.arrays import Array
from ssac.config import SKEW_PRIOR_PPM, Config
from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.files.drone_tracking import ImportedCamera, import_data_set
from ssac.network import tum
from ssac.network.comparison import Comparison, compare
from ssac.network.graph import Pair, closures_s
from ssac.network.solve import NetworkAnswer
from ssac.pipeline.answer import Answer
from ssac.pipeline.api import sync
from ssac.pipeline.chain import Chain
from ssac.pipeline.many import solve_pairs

Row = dict[str, Any]

DATA_SETS = (1, 2, 4)

UNKNOWN_RATES = {(4, 3): (0.6, 0.8)}
"""Range in which the clock rate of a camera is searched, where its frame rate is not that of the
calibration: data set 4's camera 3 counts native frames, some 18 to 24 a second, and says 30."""

VARIABLE_RATES = {(4, 2), (4, 3)}
"""Phones whose frame rate varied widely, as the data set's README says: their clocks, which count
frames, wander by a tenth of a second."""

ROUGHNESSES_PPM = (2000.0, 6000.0)
"""Roughnesses of the clock of a pair with such a camera, tried in turn until there is an offset.
One frame more or less in 5 s, at 30 a second, is 6700 ppm."""

RTK_S = 0.2  # time between two samples of RTK; data set 4 numbers them, and some are missing

KEY = ["data_set", "camera_1", "camera_2"]  # columns that name a pair
TRIPLE_COLUMNS = ("data_set", "cameras", "closure_ms")
STRAY_COLUMNS = (*KEY, "t_s", "stray_ms", "std_ms")

_NUMBERS = re.compile(r"^\|\s*\d+\s*\|(.*)\|\s*$")


@dataclass(frozen=True)
class PublishedClocks:
    """Published clocks of all pairs: frame_j = alpha[i, j] frame_i + beta[i, j]."""

    alpha: Array  # (n, n)
    beta: Array  # (n, n) [frames]

    def t_d_s(self, i: int, j: int, fps: tuple[float, float], time_s: float) -> float:
        """Return the offset t_d [s] of camera j's clock from camera i's, at a time of camera i's.

        The greater of alpha[i, j] and alpha[j, i] is used: four decimals of 2 are exact to 25 ppm,
        those of 0.5 only to 100 ppm, which are 23 ms at mid-flight in data set 4.
        """
        frame = time_s * fps[0]
        if self.alpha[i, j] >= self.alpha[j, i]:
            other = self.alpha[i, j] * frame + self.beta[i, j]
        else:
            other = (frame - self.beta[j, i]) / self.alpha[j, i]
        return float(other / fps[1] - time_s)


@dataclass(frozen=True, eq=False)
class DataSet:
    """One data set: its cameras, their published clocks, and the answers of its pairs."""

    number: int
    folder: Path  # of the published files
    cameras: list[ImportedCamera]
    tracks: list[Path]  # of the cameras, in their order
    rig: Path
    clocks: PublishedClocks | None
    pairs: dict[Pair, Answer]
    seconds: dict[Pair, float]  # CPU time of each pair

    def off_truth_ms(self, pair: Pair, t_d_s: float, time_s: float) -> float:
        """Return an offset less the published one [ms], at a time of the first camera's clock.

        NaN where none is published, and for UNKNOWN_RATES: theirs are of remapped videos.
        """
        if self.clocks is None or any((self.number, k) in UNKNOWN_RATES for k in pair):
            return np.nan
        fps = self.cameras[pair[0]].fps, self.cameras[pair[1]].fps
        return 1e3 * (t_d_s - self.clocks.t_d_s(*pair, fps, time_s))


def data_sets(
    data: Path, work: Path, log: Callable[[str], None], numbers: tuple[int, ...] = DATA_SETS
) -> Iterator[DataSet]:
    """Read data sets, and synchronise every pair of cameras of each.

    `data` has the folders `dataset1` and so on, and `calibration`; tracks and rigs go to `work`.
    SsacError if a folder or file is missing or malformed.
    """
    for number in numbers:
        folder, own = data / f"dataset{number}", work / f"dataset{number}"
        if not folder.is_dir():
            raise SsacError(f"{folder}: there is no such folder: give that of the data sets")
        cameras = import_data_set(folder, own)
        tracks = [own / f"{camera.name}.csv" for camera in cameras]
        rig = own / "rig.yaml"
        found = DataSet(number, folder, cameras, tracks, rig, load_clocks(folder), {}, {})
        for i, j in combinations(range(len(cameras)), 2):
            start_s = time.process_time()
            result = _synchronised(number, (i, j), tracks, rig)
            found.pairs[i, j], found.seconds[i, j] = result, time.process_time() - start_s
            estimate = result.estimate
            log(
                f"{number}: {i} {j} {estimate.status}, {result.config.clock}, "
                f"t_d {estimate.t_d_s:.4f} s +- {1e3 * estimate.t_d_std_s:.1f} ms, "
                f"{found.seconds[i, j]:.1f} s"
            )
        yield found


def load_clocks(folder: Path) -> PublishedClocks | None:
    """Read the published clocks from the two tables of a data set's README; None without them."""
    path = folder / "README.md"
    if not path.is_file():
        return None
    lines = path.read_text(encoding="utf-8").splitlines()
    matched = filter(None, map(_NUMBERS.match, lines))
    rows = [[float(cell) for cell in found.group(1).split("|")] for found in matched]
    n = len(rows) // 2
    if n == 0 or any(len(row) != n for row in rows):
        return None
    return PublishedClocks(np.array(rows[:n]), np.array(rows[n:]))


def load_rtk(folder: Path) -> tum.Path:
    """Read RTK's positions of the antenna [m], at times [s] from the first sample on."""
    path = folder / "trajectory" / "rtk.txt"
    expected = f"{path}: expected lines `[index] x y z`"
    try:
        table = np.loadtxt(path, dtype=np.float64, ndmin=2)
    except (OSError, ValueError) as error:
        raise SsacError(f"{expected} ({error}): get it again") from error
    if table.shape[1] not in (3, 4):
        raise SsacError(f"{expected}, got {table.shape[1]} columns: get it again")
    index = table[:, 0] if table.shape[1] == 4 else np.arange(len(table), dtype=np.float64)
    return tum.Path(RTK_S * index, table[:, -3:])


def _synchronised(number: int, pair: Pair, tracks: list[Path], rig: Path) -> Answer:
    """Synchronise a pair with one config after the other, until there is an offset."""
    i, j = pair
    (slow, fast), (low, high) = (UNKNOWN_RATES.get((number, k), (1.0, 1.0)) for k in pair)
    rates = None if low == high and slow == fast else (low / fast, high / slow)  # j's by i's
    config = Config(search="all", rates=rates)
    configs = [config]  # what sync tries itself
    if {(number, i), (number, j)} & VARIABLE_RATES:
        configs = [replace(config, clock="pieces", roughness_ppm=ppm) for ppm in ROUGHNESSES_PPM]
    for config in configs:
        answer = sync(
            tracks[i], tracks[j], rig, config=config, cameras=(i + 1, j + 1), estimate_readout=True
        ).answer
        if answer.estimate.has_offset:
            break
    return answer


# --- Tables of pairs, triples and clocks that wander ---


def pair_tables(sets: Iterable[DataSet]) -> dict[str, pd.DataFrame]:
    """Make the tables of pairs, triples and strays of data sets, by name."""
    pairs, triples, strays = list[Row](), list[Row](), list[tuple[float, ...]]()
    for one in sets:
        clocks = {
            pair: replace(of.estimate.clock, t_ref_s=_t_ref_s(of))  # even of a mere offset
            for pair, of in one.pairs.items()
            if of.guess is not None and of.estimate.has_offset
        }
        found = closures_s(clocks)
        for pair, result in one.pairs.items():
            mine = [1e3 * abs(s) for triple, s in found.items() if set(pair) <= set(triple)]
            pairs.append(_pair_row(one, pair) | {"closure_ms": max(mine, default=np.nan)})
            estimate = result.estimate
            strays_ms = 1e3 * estimate.strays_s, 1e3 * estimate.strays_std_s
            knots = zip(estimate.knots_s, *strays_ms, strict=True)
            strays += [(one.number, *pair, *knot) for knot in knots]
        triples += [
            {"data_set": one.number, "cameras": "-".join(map(str, triple)), "closure_ms": 1e3 * s}
            for triple, s in found.items()
        ]
    return {
        "real_pairs": pd.DataFrame(pairs),
        "real_triples": pd.DataFrame(triples, columns=TRIPLE_COLUMNS),
        "real_strays": pd.DataFrame(strays, columns=STRAY_COLUMNS),
    }


def _t_ref_s(result: Answer) -> float:
    estimate, guess = result.estimate, result.guess
    has_skew = bool(np.isfinite(estimate.skew_ppm))
    return estimate.t_ref_s if has_skew or guess is None else guess.t_ref_s


def _pair_row(one: DataSet, pair: Pair) -> Row:
    result, (i, j) = one.pairs[pair], pair
    estimate, t_ref_s = result.estimate, _t_ref_s(result)
    from_truth_ms = one.off_truth_ms(pair, estimate.t_d_s, t_ref_s)
    return {
        **dict(zip(KEY, (one.number, i, j), strict=True)),
        "models": f"{one.cameras[i].model} {one.cameras[j].model}",
        "status": str(estimate.status),
        "clock": result.config.clock,
        "t_d_s": estimate.t_d_s,
        "t_d_std_ms": 1e3 * estimate.t_d_std_s,
        "t_ref_s": t_ref_s,
        "skew_ppm": estimate.skew_ppm,
        "skew_std_ppm": estimate.skew_std_ppm,
        "most_stray_ms": float(np.max(1e3 * np.abs(estimate.strays_s), initial=0.0)),
        **{
            f"readout_{k}_{what}ms": 1e3 * seconds[k - 1]
            for k in (1, 2)
            for what, seconds in (("", estimate.readouts_s), ("std_", estimate.readouts_std_s))
        },
        **_effect_of_readouts(result),
        "residual_px": estimate.d_avg_px,
        "n_samples": estimate.n_samples,
        "reason": estimate.reason,
        "from_truth_ms": from_truth_ms if estimate.has_offset else np.nan,
        "seconds": round(one.seconds[pair], 1),
    }


def _effect_of_readouts(result: Answer) -> Row:
    """Return how far readouts move the offset, and its deviation under global shutters [ms]."""
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


# --- The path of all cameras ---


def path_of(one: DataSet) -> tuple[Row, Comparison]:
    """Solve all cameras of a data set jointly from its pairs' answers, and compare with RTK."""
    start_s = time.process_time()
    answer = solve_pairs(Chain(one.tracks, one.rig), one.pairs)
    network_s = time.process_time() - start_s
    if not answer.paths:
        raise SsacError(f"{one.folder}: no cameras see a path together: {answer.reason}")
    found = compare(answer.paths[0].path, load_rtk(one.folder), rate_std_ppm=SKEW_PRIOR_PPM)
    in_time = found.in_time
    if in_time is None:
        raise SsacError(f"data set {one.number}: the path and RTK have times, but share none")
    placed = [camera for camera in answer.cameras if camera.status == Status.OK]
    figures = in_time.figures()
    row = {
        "data_set": one.number,
        "cameras": len(placed),
        "left_out": " ".join(answer.left_out),
        "rmse_m": figures["rmse_m"],
        "mean_m": float(np.mean(in_time.distances_m)),
        **{name: figures[name] for name in ("median_m", "max_m")},
        "n_rtk": figures["n_samples"],
        **{name: figures[name] for name in ("coverage", "shift_s", "rate_ppm")},
        "scale_m": figures["scale"],
        "most_from_truth_ms": _most_off_ms(one, answer),
        "rms_px": float(np.median([camera.rms_px for camera in placed])),
        **{"pairs_s": round(sum(one.seconds.values()), 1), "network_s": round(network_s, 1)},
    }
    return row, found


def _most_off_ms(one: DataSet, answer: NetworkAnswer) -> float:
    """Return the largest error [ms] of a clock of constant rate by the published ones, or NaN."""
    first, *others = answer.cameras
    off_ms = [
        abs(one.off_truth_ms((0, k), camera.t_d_s, camera.t_ref_s))
        for k, camera in enumerate(others, 1)
        if (one.number, k) not in VARIABLE_RATES and camera.status == Status.OK
    ]
    return max(off_ms, default=np.nan) if first.status == Status.OK else np.nan
