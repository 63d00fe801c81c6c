"""Tables and figures of the public drone tracks, made up, as `ssac real` leaves them."""

from itertools import combinations
from pathlib import Path

import pandas as pd

from experiments.lab.files import save_csv
from experiments.real.data_sets import DATA_SETS
from experiments.real.drawing import OFFSETS_FIGURE
from experiments.real.pairs import (
    PAIR_COLUMNS,
    PAIRS_FILE,
    STRAY_COLUMNS,
    STRAYS_FILE,
    TRIPLE_COLUMNS,
    TRIPLES_FILE,
)
from experiments.real.paths import COLUMNS as PATH_COLUMNS
from experiments.real.paths import PATH_FIGURE, PATHS_FILE


def write_made_up_flights(folder: Path) -> None:
    """Write three cameras in each data set; of the last a pair is refused."""
    refused = (DATA_SETS[-1], 1, 2)
    rows = []
    for number in DATA_SETS:
        for i, j in combinations(range(3), 2):
            row = dict.fromkeys(PAIR_COLUMNS, 1.0)
            row |= {"data_set": number, "camera_1": i, "camera_2": j, "models": "a b"}
            row |= {"status": "ok", "clock": "affine", "reason": "", "closure_ms": 2.5}
            row["most_stray_ms"] = 1.5 if i else 0.0
            if number == DATA_SETS[-1]:
                row["closure_ms"] = float("nan")
            if (number, i, j) == refused:
                row |= {"status": "clock_jump", "reason": "it jumps", "t_d_s": float("nan")}
            rows.append(row)
    triples = [(number, "0-1-2", -2.5) for number in DATA_SETS[:-1]]
    strays = [(number, 1, 2, t_s, -0.5 * t_s, 0.1) for number in DATA_SETS for t_s in (2.0, 3.0)]
    paths = [dict.fromkeys(PATH_COLUMNS, 0.5) | {"data_set": number} for number in DATA_SETS]
    save_csv(folder / PAIRS_FILE, pd.DataFrame(rows, columns=PAIR_COLUMNS))
    save_csv(folder / TRIPLES_FILE, pd.DataFrame(triples, columns=TRIPLE_COLUMNS))
    save_csv(folder / STRAYS_FILE, pd.DataFrame(strays, columns=STRAY_COLUMNS))
    save_csv(folder / PATHS_FILE, pd.DataFrame(paths, columns=PATH_COLUMNS))
    for name in (OFFSETS_FIGURE, *map(PATH_FIGURE.format, DATA_SETS)):
        (folder / name).write_bytes(b"drawn")
