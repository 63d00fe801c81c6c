"""A comparison cell by cell in, each quantity's verdicts and ratio over a table's cells out.

The ratio of ours to the paper's, of the geometric means over the cells, is known to a factor: its
95 % interval is the ratio divided and multiplied by it. The factor is that of a normal logarithm
whose variance is the sum of those of the cells' means, over their squares; the offsets of an angle
share its flights, so their errors are taken to be the same. Angles are independent of each other.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import norm

from experiments.paper.published import PUBLISHED_ERRORS, PUBLISHED_RUNS

FloatArray = NDArray[np.float64]

VERDICTS = ("agrees", "better", "differs")

_NORMAL = float(norm.ppf(0.975))  # half of a 95 % interval, in deviations


def summary_table(comparison: pd.DataFrame) -> pd.DataFrame:
    """Sum up each quantity over the cells of a duration.

    Returns
    -------
    pd.DataFrame
        By quantity and duration: the number of cells and of each verdict; the geometric mean of the
        ratios of our mean to the published one, the factor to which it is known, and the least and
        the largest ratio; the median of the intervals' half-widths over the published mean
        (`visible`: a difference that a cell would just tell); then by our first flights alone, as
        many as the paper's, the verdicts, ratio and factor (`first_*`), how many cells have another
        verdict by all (`changed`), and the factor that the paper's flights alone leave
        (`factor_paper`), to which that of ours tends with ever more flights.
    """
    rows = []
    place = {quantity.name: number for number, quantity in enumerate(PUBLISHED_ERRORS)}
    ordered = comparison.sort_values(
        ["quantity", "duration_s"],
        key=lambda column: column.map(place) if column.name == "quantity" else column,
    )
    for (name, duration_s), part in ordered.groupby(["quantity", "duration_s"], sort=False):
        published = part["published_mean"].to_numpy()
        ratios, first_ratios = (
            part[f"{whose}_mean"].to_numpy() / published for whose in ("ours", "first")
        )
        half_widths = (part["difference_high"] - part["difference_low"]) / 2
        rows.append(
            {
                "quantity": name,
                "duration_s": duration_s,
                "cells": len(part),
                **_counts(part["verdict"]),
                "ratio": geometric_mean(ratios),
                "factor": ratio_factor(part),
                "ratio_min": ratios.min(),
                "ratio_max": ratios.max(),
                "visible": (half_widths / published).median(),
                **{f"first_{word}": n for word, n in _counts(part["first_verdict"]).items()},
                "first_ratio": geometric_mean(first_ratios),
                "first_factor": ratio_factor(part, ("published", "first")),
                "changed": int((part["verdict"] != part["first_verdict"]).sum()),
                "factor_paper": ratio_factor(part, ("published",)),
            }
        )
    table: pd.DataFrame = pd.DataFrame(rows)
    return table


def ratio_factor(part: pd.DataFrame, sides: Sequence[str] = ("published", "ours")) -> float:
    """Find the factor to which the ratio over some cells is known.

    Parameters
    ----------
    part
        Rows of a comparison: one quantity in the cells of one duration.
    sides
        Whose scatter counts: "published", "ours" of all flights, "first" of our first ones.

    Returns
    -------
    float
        At least 1; NaN where a cell has fewer than two runs or a mean of 0.
    """
    published: pd.Series = pd.Series(PUBLISHED_RUNS, part.index)
    runs = {"published": published, "ours": part["n_ours"], "first": part["first_n"]}
    angles_deg = part["angle_deg"].to_numpy()
    variance = 0.0
    for side in sides:
        errors = _relative_errors(part[f"{side}_mean"], part[f"{side}_std"], runs[side])
        variance += sum(
            float(errors[angles_deg == angle].sum()) ** 2 for angle in np.unique(angles_deg)
        )
    return float(np.exp(_NORMAL * np.sqrt(variance) / len(part)))


def geometric_mean(values: FloatArray) -> float:
    """Geometric mean; 0 where a value is 0, NaN where one is unknown."""
    with np.errstate(divide="ignore"):
        return float(np.exp(np.mean(np.log(values))))


def _relative_errors(means: pd.Series, stds: pd.Series, n: pd.Series) -> FloatArray:
    """Give standard errors of means over the means; NaN of a mean of 0 or of one run."""
    known = (means > 0.0) & (n > 1)
    errors: pd.Series = stds / (means * np.sqrt((n - 1).where(known)))  # stds are over n
    return np.asarray(errors, np.float64)


def _counts(verdicts: pd.Series) -> dict[str, int]:
    counts = verdicts.value_counts()
    return {word: int(counts.get(word, 0)) for word in VERDICTS}
