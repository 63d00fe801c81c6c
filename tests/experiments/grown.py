"""A growth of the benchmark that was never measured."""

import numpy as np
import pandas as pd

from experiments.bench.growth import COLUMNS, POINTS, Point


def made_up_growth(points: tuple[Point, ...] = POINTS) -> pd.DataFrame:
    """Return some points, linear in its events: 26 B of one to simulate it, 45 to synchronise."""
    rows = []
    for point in points:
        n = point.events_per_s * point.duration_s
        of_point = (point.sensor, point.duration_s)
        s1, s2 = 0.1 + 7e-6 * n, 0.1 + 6e-7 * n
        mb1, mb2 = 400.0 + 26.0 * n / 2**20, 300.0 + 90.0 * n / 2**20
        rows += [
            (*of_point, "simulate", n, s1, s1, mb1, "ok", np.nan),
            (*of_point, "synchronise", n, s2, s2, mb2, "ok", 0.01),
        ]
    return pd.DataFrame(rows, columns=list(COLUMNS))
