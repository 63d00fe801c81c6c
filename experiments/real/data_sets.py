"""Folders of public data sets in; what is published of each, and its pairs from nothing, out."""

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssac.config import Config
from ssac.errors import SsacError
from ssac.files.drone_tracking import ImportedCamera, import_data_set
from ssac.network import tum
from ssac.network.graph import Pair
from ssac.pipeline.answer import Answer
from ssac.pipeline.api import sync

Array = NDArray[np.float64]
Log = Callable[[str], None]

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

RTK_S = 0.2
"""Time between two samples of RTK; data set 4 counts them, and leaves some out."""

COMMAND = "make real DATA=..."

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


@dataclass(frozen=True, eq=False)
class DataSet:
    """One flight: its cameras, what is published of it, and what its pairs gave."""

    number: int
    folder: Path  # as it was published
    cameras: list[ImportedCamera]
    tracks: list[Path]  # theirs
    rig: Path
    truth: Truth | None
    pairs: dict[Pair, Answer]
    seconds: dict[Pair, float]  # of one core, each pair

    def off_truth_ms(self, pair: Pair, t_d_s: float, time_s: float) -> float:
        """Give how far an offset, at a time of the first camera's clock, is off the published one.

        NaN where none is published, or none that applies: that of a remapped video does not.
        """
        if self.truth is None or any((self.number, k) in UNKNOWN_RATES for k in pair):
            return np.nan
        fps = self.cameras[pair[0]].fps, self.cameras[pair[1]].fps
        return 1e3 * (t_d_s - self.truth.t_d_s(*pair, fps, time_s))


def data_sets(
    data: Path, work: Path, log: Log, numbers: tuple[int, ...] = DATA_SETS
) -> Iterator[DataSet]:
    """Read data sets, and synchronise every pair of cameras of each.

    Parameters
    ----------
    data
        Folder with `dataset1` and so on, and `calibration`.
    work
        Folder for the tracks and rigs.
    log
        Called with a line on each pair.
    numbers
        Of the data sets.

    Raises
    ------
    SsacError
        If a folder or file is missing, or not of their form.
    """
    for number in numbers:
        folder, own = data / f"dataset{number}", work / f"dataset{number}"
        if not folder.is_dir():
            raise SsacError(f"{folder}: there is no such folder: give that of the data sets")
        cameras = import_data_set(folder, own)
        tracks = [own / f"{camera.name}.csv" for camera in cameras]
        rig = own / "rig.yaml"
        found = DataSet(number, folder, cameras, tracks, rig, load_truth(folder), {}, {})
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


def real_config() -> dict[str, Any]:
    """Give what all pairs are made with, for provenance."""
    rates = {f"data set {number}, camera {k}": rate for (number, k), rate in UNKNOWN_RATES.items()}
    variable = [f"data set {number}, camera {k}" for number, k in sorted(VARIABLE_RATES)]
    return {
        "data_sets": DATA_SETS,
        "rates": rates,
        "variable_rates": {"cameras": variable, "roughnesses_ppm": ROUGHNESSES_PPM},
    }


def rate_range(number: int, i: int, j: int) -> tuple[float, float] | None:
    """Rates that are tried of camera j's clock by camera i's; None where both are known."""
    low, high = UNKNOWN_RATES.get((number, j), (1.0, 1.0))
    slow, fast = UNKNOWN_RATES.get((number, i), (1.0, 1.0))
    return None if low == high and slow == fast else (low / fast, high / slow)


def _synchronised(number: int, pair: Pair, tracks: list[Path], rig: Path) -> Answer:
    """Synchronise a pair with what is tried in turn for it, until it is answered."""
    i, j = pair
    config = Config(search="all", rates=rate_range(number, i, j))
    configs = [config]  # what sync tries itself
    if {(number, i), (number, j)} & VARIABLE_RATES:
        configs = [
            replace(config, clock="pieces", roughness_ppm=roughness_ppm)
            for roughness_ppm in ROUGHNESSES_PPM
        ]
    for config in configs:
        answer = sync(
            tracks[i],
            tracks[j],
            rig,
            config=config,
            cameras=(i + 1, j + 1),
            estimate_readout=True,
        ).answer
        if answer.estimate.has_offset:
            break
    return answer
