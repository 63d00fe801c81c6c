"""A growth of the benchmark that was never measured."""

import numpy as np
import pandas as pd

from experiments.bench.growth import COLUMNS, POINTS


def made_up_growth() -> pd.DataFrame:
    """Return every point, linear in its events: 26 B of one to simulate it, 45 to synchronise."""
    rows = []
    for point in POINTS:
        n = point.events_per_s * point.duration_s
        of_point = (point.sensor, point.duration_s)
        rows += [
            (*of_point, "simulate", n, 0.1 + 7e-6 * n, 1.0, 400.0 + 26.0 * n / 2**20, "ok", np.nan),
            (
                *of_point,
                "synchronise",
                n,
                0.1 + 6e-7 * n,
                1.0,
                300.0 + 90.0 * n / 2**20,
                "ok",
                0.01,
            ),
        ]
    return pd.DataFrame(rows, columns=list(COLUMNS))
