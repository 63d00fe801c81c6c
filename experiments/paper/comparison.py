"""The esim tables and the paper's in, one row for each compared number with a verdict out.

The rule (`RULE`) is Welch's: the 95 % interval of the difference of the two means. Errors are not
negative, and skewed; but they are so on both sides, and the difference of two means loses most of
it: where both sides draw from one distribution, however skewed, the rule is wrong in at most 5 % of
the cells (tested). To compare logarithms would seem more natural, yet where a few runs are gross
errors, as with the correlation methods, it is wrong in about 20 %.

Our flights may be more than the paper's; each verdict is also given by our first as many alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from experiments.paper.published import PUBLISHED_ERRORS, PUBLISHED_RUNS, PublishedError
from ssac.errors import SsacError

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

    Parameters
    ----------
    ours, published
    resolution
        Unit of the last printed digit of the published mean; half of it is added on both sides.
    confidence
        Of the interval, 0 to 1.

    Returns
    -------
    tuple of float
        Its ends; NaN when a side has fewer than two runs.
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


def comparison_table(
    tables: Mapping[float, pd.DataFrame],
    published: Mapping[float, pd.DataFrame],
    reasons: tuple[Reason, ...] = REASONS,
    first: Mapping[float, pd.DataFrame] | None = None,
    errors: tuple[PublishedError, ...] = PUBLISHED_ERRORS,
) -> pd.DataFrame:
    """Compare cell by cell.

    Parameters
    ----------
    tables
        Ours, as of `esim.esim_tables`, by duration [s].
    published
        The paper's, as of `published.load_published`.
    reasons
        For the notes.
    first
        Ours of the first PUBLISHED_RUNS flights alone, by duration [s]; where there are no further
        ones, they are `tables` and need not be given.
    errors
        That are compared.

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
