"""Our tables beside the paper's, cell by cell and quantity by quantity.

The rule of a cell (`RULE`) is Welch's: the 95 % interval of the difference of the two means. Errors
are not negative, and skewed; but they are so on both sides, and the difference of two means loses
most of it: where both sides draw from one distribution, however skewed, the rule is wrong in at
most 5 % of the cells (tested). To compare logarithms would seem more natural, yet where a few runs
are gross errors, as with the correlation methods, it is wrong in about 20 %.

The ratio of ours to the paper's, of the geometric means over the cells of a table, is known to a
factor: its 95 % interval is the ratio divided and multiplied by it. The factor is that of a normal
logarithm whose variance is the sum of those of the cells' means, over their squares; the offsets of
an angle share its flights, so their errors are taken to be the same. Angles are independent of each
other.

Our flights may be more than the paper's; each verdict is also given by our first as many alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from experiments.paper.grids import table_axes
from experiments.paper.quantities import R_ERROR, T_D_ERROR, T_ERROR
from ssac.errors import SsacError

FloatArray = NDArray[np.float64]

PUBLISHED_SHA256 = {
    "published/esim_10.csv": "e4fc65f27fe6e67e162c81d89ccf66debf49f560e766675ead3288fc09b21cd7",
    "published/esim_20.csv": "e1f7cc80787b7a1d7baaae7ac3e6586780f6fdcef967e381a0861c41c390cdb7",
}
"""Digests of the paper's tables as they were copied."""

PUBLISHED = Path(__file__).resolve().parents[2] / "results" / "published"

PUBLISHED_RUNS = 10
"""Of each cell. All 30 published means of ZNCC_E are whole tenths of sums of multiples of its unit
of 10 ms, and so are the deviations if they are taken over 10 runs, not over 10 - 1."""


@dataclass(frozen=True)
class PublishedError:
    """One mean error that the paper gives."""

    method: str
    error: str
    published: str  # start of its columns in the published table
    resolution: float  # unit of the last printed digit

    @property
    def name(self) -> str:
        """Start of its columns in our table."""
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
SIZE_RULE = (
    "Of the paper's size or better: a one-sided test at 5 % does not find our mean larger (the "
    "lower end of the 90 % interval, widened likewise, is not above 0)"
)

VERDICTS = ("agrees", "better", "differs")

_NORMAL = float(norm.ppf(0.975))  # half of a 95 % interval, in deviations


@dataclass(frozen=True)
class Reason:
    """Why cells do not agree; it is noted beside those of the cells that do not."""

    text: str
    quantities: tuple[str, ...]
    durations_s: tuple[float, ...] = ()  # empty: all
    angles_deg: tuple[float, ...] = ()
    t_ds_ms: tuple[float, ...] = ()

    def covers(self, quantity: str, duration_s: float, angle_deg: float, t_d_ms: float) -> bool:
        """Return whether the reason is meant for a cell."""
        return quantity in self.quantities and all(
            not values or value in values
            for value, values in (
                (duration_s, self.durations_s),
                (angle_deg, self.angles_deg),
                (t_d_ms, self.t_ds_ms),
            )
        )


REASONS = (
    Reason(
        "the paper's mean of ten flights says little more than how many are gross errors "
        "(docs/zncc.md)",
        ("zncc_e_t_d_error_ms", "zncc_f_t_d_error_ms"),
        angles_deg=(60.0, 90.0, 120.0),
    ),
    Reason(
        "a lag is a multiple of 10 ms, so this offset adds up to half a bin: compare 50 and 500 ms",
        ("zncc_e_t_d_error_ms",),
        angles_deg=(30.0,),
        t_ds_ms=(5.0,),
    ),
    Reason(
        "opposed views: near the truth the rates correlate negatively, and any other lag may win; "
        "the paper's own three offsets differ as much (docs/zncc.md)",
        ("zncc_e_t_d_error_ms", "zncc_f_t_d_error_ms"),
        angles_deg=(150.0,),
    ),
    Reason(
        "the paper's means at 5 and 500 ms lie around ours, which is one for all offsets as they "
        "share their flights; of 90 cells of ssac some differ by chance",
        ("ssac_t_d_error_ms",),
        durations_s=(10.0,),
        angles_deg=(90.0,),
        t_ds_ms=(50.0,),
    ),
)
"""Found by looking into the runs; none is here that was not."""


@dataclass(frozen=True)
class Sample:
    """What is known of the errors in a cell."""

    mean: float
    std: float  # over n, not n - 1
    n: int


def difference_interval(
    ours: Sample, published: Sample, resolution: float, confidence: float
) -> tuple[float, float]:
    """Welch's confidence interval of the difference of two means, ours less the published one.

    Half a unit of the last printed digit, `resolution`, is added on both sides. Both ends are NaN
    when a side has fewer than two runs.
    """
    if min(ours.n, published.n) < 2:
        return np.nan, np.nan
    variances = [side.std**2 / (side.n - 1) for side in (ours, published)]  # of the means
    total = sum(variances)
    half_width = 0.0
    if total > 0.0:
        freedom = 1.0 / sum(
            (variance / total) ** 2 / (side.n - 1)
            for variance, side in zip(variances, (ours, published), strict=True)
        )
        half_width = float(student.ppf(0.5 + confidence / 2, freedom)) * np.sqrt(total)
    difference = ours.mean - published.mean
    half_width += resolution / 2
    return difference - half_width, difference + half_width


def verdict_of(interval: tuple[float, float]) -> str:
    """Say "agrees", "better" or "differs" of the 95 % interval of a difference."""
    low, high = interval
    if high < 0.0:
        return "better"
    return "agrees" if low <= 0.0 <= high else "differs"


def load_published(
    folder: Path = PUBLISHED,
    name: str = "esim",
    durations_s: Sequence[float] | None = None,
    errors: tuple[PublishedError, ...] = PUBLISHED_ERRORS,
) -> dict[float, pd.DataFrame]:
    """Read the paper's tables `<name>_<duration>.csv`, by duration [s].

    By default those of the simulations. SsacError if one cannot be read, or lacks one of `errors`.
    """
    tables = {}
    for duration_s in table_axes().durations_s if durations_s is None else durations_s:
        path = folder / f"{name}_{duration_s:g}.csv"
        try:
            table = pd.read_csv(path)
        except (OSError, ValueError) as error:
            raise SsacError(f"{path}: the published table cannot be read: {error}") from error
        needed = ["angle_deg", "t_d_ms"]
        needed += [f"{q.published}_{part}" for q in errors for part in ("mean", "std")]
        absent = [column for column in needed if column not in table]
        if absent:
            raise SsacError(f"{path}: the published table lacks the columns {', '.join(absent)}")
        tables[duration_s] = table
    return tables


def comparison_table(
    tables: Mapping[float, pd.DataFrame],
    published: Mapping[float, pd.DataFrame],
    reasons: tuple[Reason, ...] = REASONS,
    first: Mapping[float, pd.DataFrame] | None = None,
    errors: tuple[PublishedError, ...] = PUBLISHED_ERRORS,
) -> pd.DataFrame:
    """Compare our tables, by duration [s], with the published ones cell by cell.

    `first` are ours of the first PUBLISHED_RUNS flights alone, if there are further ones.

    Returns
    -------
    pd.DataFrame
        One row for each number that both have, in the paper's order of rows: duration, angle,
        offset, quantity (`method_error`), both means and deviations, our runs that are "ok"
        (`n_ours`), the ends of the 95 % interval of the difference, the verdict, whether our mean
        is of the paper's size or better (SIZE_RULE), whether it is at most the published mean, our
        numbers, interval and verdict by the first flights alone (`first_*`), and a note.
    """
    first = tables if first is None else first
    rows = []
    for duration_s, theirs in published.items():
        if duration_s not in tables:
            continue
        place_of_cell = ["angle_deg", "t_d_ms"]
        both = theirs.merge(tables[duration_s], on=place_of_cell)
        if duration_s not in first:
            raise SsacError(f"the first {PUBLISHED_RUNS} flights of {duration_s:g} s are not there")
        early = theirs.merge(first[duration_s], on=place_of_cell)
        pairs = zip(both.to_dict("records"), early.to_dict("records"), strict=True)
        for cell, first_cell in pairs:
            for quantity in errors:
                if f"{quantity.name}_mean" in cell:
                    place = {
                        "duration_s": duration_s,
                        "angle_deg": float(cell["angle_deg"]),
                        "t_d_ms": float(cell["t_d_ms"]),
                        "quantity": quantity.name,
                    }
                    rows.append({**place, **_compared(cell, first_cell, quantity)})
    if not rows:
        raise SsacError("our tables and the published ones have no cell in common")
    table: pd.DataFrame = pd.DataFrame(rows)
    keys = table[["quantity", "duration_s", "angle_deg", "t_d_ms"]]
    table["note"] = [
        "" if verdict == "agrees" else "; ".join(r.text for r in reasons if r.covers(*key))
        for verdict, key in zip(table["verdict"], keys.itertuples(index=False), strict=True)
    ]
    return table


def _compared(
    cell: Mapping[Any, Any], first_cell: Mapping[Any, Any], quantity: PublishedError
) -> dict[str, float | int | str]:
    """Compare one number of one row of both tables."""
    ours, first = (_ours(row, quantity) for row in (cell, first_cell))
    published = Sample(
        cell[f"{quantity.published}_mean"], cell[f"{quantity.published}_std"], PUBLISHED_RUNS
    )
    low, high = difference_interval(ours, published, quantity.resolution, 0.95)
    low_one_sided, _ = difference_interval(ours, published, quantity.resolution, 0.90)
    first_low, first_high = difference_interval(first, published, quantity.resolution, 0.95)
    return {
        "ours_mean": ours.mean,
        "ours_std": ours.std,
        "n_ours": ours.n,
        "published_mean": published.mean,
        "published_std": published.std,
        "difference_low": low,
        "difference_high": high,
        "verdict": verdict_of((low, high)),
        "paper_size_or_better": "yes" if low_one_sided <= 0.0 else "no",
        "mean_at_most_published": "yes" if ours.mean <= published.mean else "no",
        "first_mean": first.mean,
        "first_std": first.std,
        "first_n": first.n,
        "first_low": first_low,
        "first_high": first_high,
        "first_verdict": verdict_of((first_low, first_high)),
    }


def _ours(cell: Mapping[Any, Any], quantity: PublishedError) -> Sample:
    """Give what a row of our table knows of a quantity; a method may lack it in few flights."""
    mean, std = (float(cell.get(f"{quantity.name}_{part}", np.nan)) for part in ("mean", "std"))
    return Sample(mean, std, int(cell["n_runs"] - cell[f"{quantity.method}_failed"]))


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
    """Find the factor, at least 1, to which the ratio over cells of one duration is known.

    `sides` says whose scatter counts: "published", "ours" of all flights, "first" of our first
    ones. NaN where a cell has fewer than two runs or a mean of 0.
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
