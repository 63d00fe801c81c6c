"""Tables of the public drone tracks in; what in them makes no sense, out.

The data are not ours to ship, so no figure can be made again here.
"""

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.real.data_sets import DATA_SETS
from experiments.real.pairs import (
    PAIR_COLUMNS,
    PAIRS_FILE,
    STRAY_COLUMNS,
    STRAYS_FILE,
    TRIPLE_COLUMNS,
    TRIPLES_FILE,
)
from experiments.real.paths import COLUMNS as PATH_COLUMNS
from experiments.real.paths import PATHS_FILE
from ssac.config import CLOCKS
from ssac.estimate import Status

_LAST_DIGIT = 1e-5  # of a closure, as a share: both tables have eight digits

Key = tuple[int, int, int]  # data set and two cameras


def real_faults(results: Path) -> tuple[str, ...]:
    """Check the tables' shape, and that they say the same."""
    pairs = pd.read_csv(results / PAIRS_FILE, keep_default_na=False, na_values=[""])
    triples = pd.read_csv(results / TRIPLES_FILE, dtype={"cameras": str})
    strays = pd.read_csv(results / STRAYS_FILE)
    expected = (pairs, PAIR_COLUMNS), (triples, TRIPLE_COLUMNS), (strays, STRAY_COLUMNS)
    for table, columns in expected:
        there = [str(name) for name in table]
        if there != list(columns):
            return (f"columns are {', '.join(there)}; expected {', '.join(columns)}",)
    paths = pd.read_csv(results / PATHS_FILE)
    return (
        *_pair_faults(pairs),
        *_triple_faults(pairs, triples),
        *_stray_faults(pairs, strays),
        *_path_faults(paths),
    )


def _pair_faults(pairs: pd.DataFrame) -> Iterator[str]:
    rows: dict[Key, Any] = {_key(row): row for row in pairs.to_dict("records")}
    if len(rows) < len(pairs):
        yield "a pair is there twice"
    expected = [
        (number, i, j)
        for number in DATA_SETS
        for i, j in combinations(
            range(max((k[2] for k in rows if k[0] == number), default=1) + 1), 2
        )
    ]
    if list(rows) != expected:
        yield "its rows are not all pairs of cameras of each data set, in order"
    for (number, i, j), row in rows.items():
        name = f"data set {number}, cameras {i} {j}"
        if row["status"] not in list(map(str, Status)) or row["clock"] not in CLOCKS:
            yield f"{name}: {row['status']}, {row['clock']}"
        elif _has_offset(row):
            yield from (
                f"{name}: {column} is {row[column]}"
                for column in ("t_d_s", "t_ref_s", "residual_px")
                if not np.isfinite(row[column])
            )
        elif not isinstance(row["reason"], str):
            yield f"{name}: {row['status']}, and it does not say why"


def _path_faults(paths: pd.DataFrame) -> Iterator[str]:
    there = [str(name) for name in paths]
    if there != list(PATH_COLUMNS):
        yield f"columns of {PATHS_FILE} are {', '.join(there)}; expected {', '.join(PATH_COLUMNS)}"
    elif list(paths.data_set) != list(DATA_SETS):
        yield f"{PATHS_FILE} has not each data set once"
    else:
        for row in paths.to_dict("records"):
            if not row["mean_m"] <= row["rmse_m"] <= row["max_m"]:
                yield f"data set {row['data_set']}: its distances are no mean, RMSE and maximum"


def _triple_faults(pairs: pd.DataFrame, triples: pd.DataFrame) -> Iterator[str]:
    answered = {_key(row) for row in pairs.to_dict("records") if _has_offset(row)}
    closures_ms: dict[Key, float] = {}
    found: list[tuple[int, ...]] = []
    for row in triples.to_dict("records"):
        number, cameras = int(row["data_set"]), tuple(map(int, row["cameras"].split("-")))
        found.append((number, *cameras))
        for i, j in combinations(cameras, 2):
            most_ms = max(closures_ms.get((number, i, j), 0.0), abs(row["closure_ms"]))
            closures_ms[number, i, j] = most_ms
    n_cameras = 1 + max((j for _, _, j in answered), default=0)
    expected = [
        (number, *three)
        for number in DATA_SETS
        for three in combinations(range(n_cameras), 3)
        if all((number, *two) in answered for two in combinations(three, 2))
    ]
    if found != expected:
        yield f"{TRIPLES_FILE} has not each triple of which all pairs are answered, once"
    for row in pairs.to_dict("records"):
        told_ms, most_ms = row["closure_ms"], closures_ms.get(_key(row), np.nan)
        if not np.isclose(told_ms, most_ms, rtol=_LAST_DIGIT, atol=1e-6, equal_nan=True):
            yield f"{_key(row)}: its closure is {told_ms} ms, by the triples {most_ms} ms"


def _stray_faults(pairs: pd.DataFrame, strays: pd.DataFrame) -> Iterator[str]:
    most_ms: dict[Key, float] = {}
    for row in strays.to_dict("records"):
        most_ms[_key(row)] = max(most_ms.get(_key(row), 0.0), abs(row["stray_ms"]))
    for row in pairs.to_dict("records"):
        told_ms, stray_ms = row["most_stray_ms"], most_ms.pop(_key(row), 0.0)
        if not np.isclose(told_ms, stray_ms, rtol=_LAST_DIGIT):
            yield f"{_key(row)}: it strays by {told_ms} ms, by its knots {stray_ms} ms"
    if most_ms:
        yield f"{STRAYS_FILE} has pairs that are none: {', '.join(map(str, most_ms))}"


def _has_offset(row: dict[Any, Any]) -> bool:
    return row["status"] in [str(status) for status in Status if status.has_offset]


def _key(row: dict[Any, Any]) -> Key:
    return int(row["data_set"]), int(row["camera_1"]), int(row["camera_2"])
