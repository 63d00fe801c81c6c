"""Statistical comparison of our tables with the paper's, by cell and quantity.

The rule of a cell (`RULE`) is Welch's: the 95 % interval of the difference of the two means. Errors
are skewed, but on both sides: where both draw from one distribution, the rule is wrong in at most
5 % of the cells (tested). A comparison of logarithms is wrong in about 20 % where a few runs are
gross errors, as with the correlation methods.

The 95 % interval of the ratio of our geometric mean over a table's cells to the paper's is from
the ratio divided by a factor to the ratio times the factor. The logarithm of the ratio is taken as
normal, with the relative variances of the cells' means. Offsets of an angle share its flights, so
their errors are taken to be the same; angles are independent.

Where we have more flights than the paper, each verdict is also given by as many of our first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri, stdtrit

from experiments.paper.esim import DURATIONS_S, R_ERROR, T_D_ERROR, T_ERROR
from ssac.arrays import Array
from ssac.errors import SsacError

PUBLISHED_SHA256 = {
    "published/esim_10.csv": "e4fc65f27fe6e67e162c81d89ccf66debf49f560e766675ead3288fc09b21cd7",
    "published/esim_20.csv": "e1f7cc80787b7a1d7baaae7ac3e6586780f6fdcef967e381a0861c41c390cdb7",
}
"""SHA-256 digests of the paper's tables as they were copied."""

PUBLISHED = Path(__file__).resolve().parents[2] / "results" / "published"

PUBLISHED_RUNS = 10
"""Number of runs in each cell of the paper. All 30 published means of ZNCC_E are tenths of sums of
multiples of its unit of 10 ms, and so are the deviations if taken over 10 runs, not over 10 - 1."""

PLACE = ["angle_deg", "t_d_ms"]  # columns that identify the cell of a table


@dataclass(frozen=True)
class PublishedError:
    """One mean error that the paper gives."""

    method: str
    error: str
    published: str  # prefix of its columns in the published table
    resolution: float  # unit of the last printed digit

    @property
    def name(self) -> str:
        """Prefix of its columns in our table."""
        return f"{self.method}_{self.error}"


PUBLISHED_ERRORS = (
    PublishedError("ssac", T_D_ERROR.column, "ssac_error_ms", 0.01),
    PublishedError("zncc_e", T_D_ERROR.column, "zncc_e_error_ms", 0.1),
    PublishedError("zncc_f", T_D_ERROR.column, "zncc_f_error_ms", 0.1),
    PublishedError("ssac", R_ERROR.column, "r_error_deg", 0.01),
    PublishedError("ssac", T_ERROR.column, "t_error_deg", 0.01),
)

RULE = (
    "Agrees: the 95 % interval of the difference of the means (Welch's t, from both means, "
    "deviations and numbers of runs), widened by half a unit of the last printed digit of the "
    "published mean, contains 0. Better: it lies below 0, so ours is smaller. Differs: it lies "
    "above 0, so ours is larger, or fewer than two of our runs gave an estimate"
)
VERDICTS = ("agrees", "better", "differs")

REASONS: Mapping[str, Mapping[str, Sequence[Any]]] = {
    "the paper's mean of ten flights says little more than how many are gross errors "
    "(docs/methods.md)": {
        "quantity": ("zncc_e_t_d_error_ms", "zncc_f_t_d_error_ms"),
        "angle_deg": (60.0, 90.0, 120.0),
    },
    "a lag is a multiple of 10 ms, so this offset adds up to half a bin: compare 50 and 500 ms": {
        "quantity": ("zncc_e_t_d_error_ms",),
        "angle_deg": (30.0,),
        "t_d_ms": (5.0,),
    },
    "opposed views: near the truth the rates correlate negatively, and any other lag may win; "
    "the paper's own three offsets differ as much (docs/methods.md)": {
        "quantity": ("zncc_e_t_d_error_ms", "zncc_f_t_d_error_ms"),
        "angle_deg": (150.0,),
    },
    "the paper's means at 5 and 500 ms lie around ours, which is one for all offsets as they "
    "share their flights; of 90 cells of ssac some differ by chance": {
        "quantity": ("ssac_t_d_error_ms",),
        "duration_s": (10.0,),
        "angle_deg": (90.0,),
        "t_d_ms": (50.0,),
    },
}
"""Reasons why cells do not agree, found by inspection of the runs, and the cells that each may
explain, by values of columns. A reason is noted beside those of its cells that do not agree."""


class Sample(NamedTuple):
    """Statistics of the errors in each cell."""

    mean: ArrayLike
    std: ArrayLike  # over n, not n - 1
    n: ArrayLike


def difference_interval(
    ours: Sample, published: Sample, resolution: float, confidence: float
) -> tuple[Array, Array]:
    """Return Welch's confidence interval of the difference of two means, ours minus the published.

    Half a unit of the last printed digit, `resolution`, is added on both sides. Both ends are NaN
    where ours or the published mean has fewer than two runs.
    """
    (mean1, std1, n1), (mean2, std2, n2) = (
        np.array(side, np.float64) for side in (ours, published)
    )
    known = np.minimum(n1, n2) >= 2
    with np.errstate(divide="ignore", invalid="ignore"):
        variance1, variance2 = std1**2 / (n1 - 1), std2**2 / (n2 - 1)  # of the means
        total = variance1 + variance2
        freedom = 1.0 / ((variance1 / total) ** 2 / (n1 - 1) + (variance2 / total) ** 2 / (n2 - 1))
        half_width = stdtrit(freedom, 0.5 + confidence / 2) * np.sqrt(total)
    half_width = np.where(total > 0.0, half_width, 0.0)
    half_width += resolution / 2
    difference = np.where(known, mean1 - mean2, np.nan)
    return difference - half_width, difference + half_width


def verdicts_of(low: ArrayLike, high: ArrayLike) -> NDArray[np.str_]:
    """Return the verdict "agrees", "better" or "differs" of each 95 % interval of a difference."""
    is_better, is_above = np.less(high, 0.0), ~np.less_equal(low, 0.0)  # or NaN
    return np.where(is_better, "better", np.where(is_above, "differs", "agrees"))


def load_published(
    folder: Path = PUBLISHED,
    name: str = "esim",
    durations_s: Sequence[float] = DURATIONS_S,
) -> dict[float, pd.DataFrame]:
    """Read the paper's tables `<name>_<duration>.csv`, by duration [s]."""
    paths = {duration_s: folder / f"{name}_{duration_s:g}.csv" for duration_s in durations_s}
    try:
        return {duration_s: pd.read_csv(path) for duration_s, path in paths.items()}
    except (OSError, ValueError) as error:
        raise SsacError(f"the paper's tables cannot be read: {error}") from error


def comparison_table(
    tables: Mapping[float, pd.DataFrame],
    published: Mapping[float, pd.DataFrame],
    reasons: Mapping[str, Mapping[str, Sequence[Any]]] = REASONS,
    first: Mapping[float, pd.DataFrame] | None = None,
    errors: tuple[PublishedError, ...] = PUBLISHED_ERRORS,
) -> pd.DataFrame:
    """Compare our tables, by duration [s], with the published ones cell by cell.

    `first` are our tables of the first PUBLISHED_RUNS flights alone, if we have more. Each row
    is a number in both tables, in the paper's order: means, deviations, the number of our "ok"
    runs (`n_ours`), the 95 % interval of the difference, the verdicts, the same for the first
    flights (`first_*`), and a note. The verdicts are RULE's, whether ours is of the paper's size or
    better (a one-sided test at 5 % does not find our mean larger: the lower end of the 90 %
    interval, widened likewise, is at most 0), and whether our mean is at most the published one.
    """
    parts = []
    for duration_s, theirs in published.items():
        if duration_s not in tables:
            continue
        both, early = (theirs.merge(of[duration_s], on=PLACE) for of in (tables, first or tables))
        compared = [_compared(both, early, q) for q in errors if f"{q.name}_mean" in both]
        part = pd.concat(compared).sort_index(kind="stable")  # by cell, then by quantity
        part.insert(0, "duration_s", duration_s)
        parts.append(part)
    table = pd.concat(parts, ignore_index=True)
    notes: list[list[str]] = [[] for _ in range(len(table))]
    for text, where in reasons.items():
        is_one = table[list(where)].isin(dict(where)).all(axis=1)
        for row in np.flatnonzero(is_one & (table["verdict"] != "agrees")):
            notes[row].append(text)
    table["note"] = ["; ".join(texts) for texts in notes]
    return table


def _compared(both: pd.DataFrame, early: pd.DataFrame, quantity: PublishedError) -> pd.DataFrame:
    """Compare a quantity in all rows with the published one, by all our flights and the first."""
    ours, first = _ours(both, quantity), _ours(early, quantity)
    mean, std = (both[f"{quantity.published}_{part}"] for part in ("mean", "std"))
    published = Sample(mean, std, np.full(len(both), PUBLISHED_RUNS))
    low, high = difference_interval(ours, published, quantity.resolution, 0.95)
    low_one_sided, _ = difference_interval(ours, published, quantity.resolution, 0.90)
    first_low, first_high = difference_interval(first, published, quantity.resolution, 0.95)
    columns = {
        **both[PLACE].astype(np.float64),
        "quantity": quantity.name,
        "ours_mean": ours.mean,
        "ours_std": ours.std,
        "n_ours": ours.n,
        "published_mean": mean,
        "published_std": std,
        "difference_low": low,
        "difference_high": high,
        "verdict": verdicts_of(low, high),
        "paper_size_or_better": np.where(low_one_sided <= 0.0, "yes", "no"),
        "mean_at_most_published": np.where(np.less_equal(ours.mean, mean), "yes", "no"),
        "first_mean": first.mean,
        "first_std": first.std,
        "first_n": first.n,
        "first_low": first_low,
        "first_high": first_high,
        "first_verdict": verdicts_of(first_low, first_high),
    }
    return pd.DataFrame(columns, both.index)


def _ours(table: pd.DataFrame, quantity: PublishedError) -> Sample:
    """Return our statistics of a quantity, NaN where a method gives it in no flight."""
    unknown = np.full(len(table), np.nan)
    mean, std = (table.get(f"{quantity.name}_{part}", unknown) for part in ("mean", "std"))
    return Sample(mean, std, (table["n_runs"] - table[f"{quantity.method}_failed"]).astype(int))


def summary_table(comparison: pd.DataFrame) -> pd.DataFrame:
    """Summarise each quantity over the cells of a duration.

    `ratio` is the geometric mean of the ratios of our mean to the published one, and `factor` its
    uncertainty (`ratio_factor`); `visible` is the smallest difference detected in the median cell,
    over the published mean. `first_*` are by our first flights alone; `changed` counts the cells
    whose verdict differs between these and all. `factor_paper` is by the paper's scatter alone.
    """
    rows = []
    order = [quantity.name for quantity in PUBLISHED_ERRORS]
    groups = comparison.groupby(["quantity", "duration_s"])
    for (name, duration_s), part in sorted(groups, key=lambda group: order.index(str(group[0][0]))):
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
                **{word: int((part["verdict"] == word).sum()) for word in VERDICTS},
                "ratio": np.exp(np.log(ratios).mean()),
                "factor": ratio_factor(part),
                "ratio_min": ratios.min(),
                "ratio_max": ratios.max(),
                "visible": (half_widths / published).median(),
                **{f"first_{w}": int((part["first_verdict"] == w).sum()) for w in VERDICTS},
                "first_ratio": np.exp(np.log(first_ratios).mean()),
                "first_factor": ratio_factor(part, ("published", "first")),
                "changed": int((part["verdict"] != part["first_verdict"]).sum()),
                "factor_paper": ratio_factor(part, ("published",)),
            }
        )
    return pd.DataFrame(rows)


def ratio_factor(part: pd.DataFrame, sides: Sequence[str] = ("published", "ours")) -> float:
    """Return the factor, at least 1, of the 95 % interval of the ratio over cells of one duration.

    `sides` says whose scatter counts: "published", "ours" of all flights, "first" of our first
    flights. NaN where a cell has fewer than two runs or a mean of 0.
    """
    published: pd.Series = pd.Series(PUBLISHED_RUNS, part.index)
    runs = {"published": published, "ours": part["n_ours"], "first": part["first_n"]}
    variance = 0.0
    for side in sides:
        means, stds, n = part[f"{side}_mean"], part[f"{side}_std"], runs[side]
        known = (means > 0.0) & (n > 1)
        # Relative standard errors; the deviations are over n.
        errors = stds / (means * np.sqrt((n - 1).where(known)))
        variance += sum(
            float(of_angle.to_numpy(np.float64).sum()) ** 2
            for _, of_angle in errors.groupby(part["angle_deg"])
        )
    return float(np.exp(ndtri(0.975) * np.sqrt(variance) / len(part)))
