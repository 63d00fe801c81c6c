"""The ratio over a table's cells: the factor to which it is known, and what bounds it."""

import numpy as np
import pandas as pd
import pytest

from experiments.paper.comparison import PUBLISHED_RUNS, geometric_mean, ratio_factor, summary_table

ANGLES_DEG, OFFSETS = np.repeat((30.0, 60.0, 90.0, 120.0, 150.0), 3), 3


def drawn(rng: np.random.Generator, n_ours: int) -> pd.DataFrame:
    """One table's cells: both sides of one skewed distribution, offsets of an angle alike."""
    part = pd.DataFrame({"angle_deg": ANGLES_DEG, "n_ours": n_ours, "first_n": PUBLISHED_RUNS})
    sizes = {"ours": n_ours, "published": PUBLISHED_RUNS, "first": PUBLISHED_RUNS}
    for side, n in sizes.items():
        errors = np.repeat(rng.gamma(2.0, 0.1, (len(ANGLES_DEG) // OFFSETS, n)), OFFSETS, axis=0)
        part[f"{side}_mean"], part[f"{side}_std"] = errors.mean(axis=1), errors.std(axis=1)
    return part


def ratio_of(part: pd.DataFrame) -> float:
    return geometric_mean((part["ours_mean"] / part["published_mean"]).to_numpy())


@pytest.mark.parametrize("n_ours", [10, 30])
def test_the_interval_holds_the_true_ratio(n_ours: int) -> None:
    rng = np.random.default_rng(n_ours)
    parts = [drawn(rng, n_ours) for _ in range(300)]
    held = np.mean([abs(np.log(ratio_of(part))) < np.log(ratio_factor(part)) for part in parts])
    # 95 %, less up to 2 % as the deviations are of ten flights; three standard errors of the share.
    assert 0.95 - 0.02 - 3 * 0.0126 < held <= 1.0


def test_more_flights_narrow_it_and_the_papers_own_bound_it() -> None:
    part = drawn(np.random.default_rng(0), 30)
    paper = ratio_factor(part, ("published",))
    factors = []
    for n in (10, 30, 100, 10**9):
        part["n_ours"] = n
        factors.append(ratio_factor(part))
    assert factors == sorted(factors, reverse=True)
    assert 1.0 < paper < factors[2]
    assert factors[-1] == pytest.approx(paper)


def test_neither_unit_nor_scale_matters_and_offsets_are_no_further_flights() -> None:
    part = drawn(np.random.default_rng(1), 30)
    scaled = part.copy()
    scaled[["ours_mean", "ours_std"]] *= 1000.0
    assert ratio_factor(scaled) == pytest.approx(ratio_factor(part))
    assert ratio_factor(part.iloc[::OFFSETS]) == pytest.approx(ratio_factor(part))


@pytest.mark.parametrize(("column", "value"), [("ours_mean", 0.0), ("n_ours", 1)])
def test_a_cell_that_knows_no_scatter_leaves_none_known(column: str, value: float) -> None:
    part = drawn(np.random.default_rng(2), 30)
    part.loc[4, column] = value
    assert np.isnan(ratio_factor(part))
    assert np.isfinite(ratio_factor(part, ("published",)))


def test_changed_verdicts_are_counted() -> None:
    part = drawn(np.random.default_rng(3), 30).assign(
        quantity="ssac_t_d_error_ms", duration_s=10.0, difference_low=-0.1, difference_high=0.1,
        verdict="agrees", first_verdict="agrees",
    )  # fmt: skip
    part.loc[:1, "verdict"] = "differs"
    part.loc[2, "first_verdict"] = "better"
    (row,) = summary_table(part).to_dict("records")
    assert (row["agrees"], row["differs"], row["better"], row["changed"]) == (13, 2, 0, 3)
    assert (row["first_agrees"], row["first_differs"], row["first_better"]) == (14, 0, 1)
    assert row["ratio"] == pytest.approx(ratio_of(part))
    assert row["first_factor"] > row["factor"] > row["factor_paper"] > 1.0
