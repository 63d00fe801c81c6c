"""Our tables compared with the paper's: the verdict on a cell and the ratio over a table."""

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import gmean, ttest_ind

from experiments.lab.results import csv_text
from experiments.lab.score import Truth, scored
from experiments.paper import comparison
from experiments.paper.comparison import PUBLISHED_RUNS, Sample, comparison_table, load_published
from experiments.paper.esim import ERRORS, RUN_COLUMNS, esim_tables
from ssac.errors import SsacError
from ssac.estimate import Estimate
from tests.experiments.reported import made_up_runs

interval = partial(comparison.difference_interval, confidence=0.95)


def as_ours(published: pd.DataFrame, factor: float = 1.0, n_runs: int = 10) -> pd.DataFrame:
    """Make a table of ours that has the published numbers times a factor."""
    table = published[["angle_deg", "t_d_ms"]].astype(float).assign(n_runs=n_runs)
    for quantity in comparison.PUBLISHED_ERRORS:
        for part in ("mean", "std"):
            table[f"{quantity.name}_{part}"] = factor * published[f"{quantity.published}_{part}"]
        table[f"{quantity.method}_failed"] = 0
    return table


def all_as_ours(*of: float) -> dict[float, pd.DataFrame]:
    return {duration_s: as_ours(table, *of) for duration_s, table in load_published().items()}


def compared(factor: float = 1.0, **reasons: Any) -> pd.DataFrame:
    return comparison_table(all_as_ours(factor), load_published(), reasons)


@pytest.mark.parametrize(
    ("ours", "published", "verdict"),
    [
        (Sample(0.2, 0.1, 10), Sample(0.16, 0.21, 10), "agrees"),
        (Sample(0.5, 0.1, 9), Sample(0.16, 0.1, 10), "differs"),
        (Sample(0.05, 0.02, 10), Sample(0.16, 0.05, 10), "better"),
        (Sample(300.0, 0.0, 4), Sample(17.0, 11.7, 10), "differs"),
        (Sample(12.0, 3.0, 2), Sample(17.0, 0.0, 10), "agrees"),
        # A difference within the rounding to hundredths is none.
        (Sample(0.1649, 0.0, 10), Sample(0.16, 0.0, 10), "agrees"),
        (Sample(0.1551, 0.0, 10), Sample(0.16, 0.0, 10), "agrees"),
        (Sample(0.1651, 0.0, 10), Sample(0.16, 0.0, 10), "differs"),
        (Sample(0.1549, 0.0, 10), Sample(0.16, 0.0, 10), "better"),
        # Fewer than two runs have no known scatter.
        (Sample(0.16, 0.0, 1), Sample(0.16, 0.1, 10), "differs"),
        (Sample(0.16, 0.0, 0), Sample(0.16, 0.1, 10), "differs"),
    ],
)
def test_verdicts_do_not_depend_on_the_unit_and_intervals_mirror(ours, published, verdict):
    low, high = interval(ours, published, 0.01)
    assert comparison.verdicts_of(low, high) == verdict
    assert interval(published, ours, 0.01) == pytest.approx((-high, -low), nan_ok=True)
    for factor in (1e-3, 0.7, 1e4):
        scaled = [Sample(factor * side.mean, factor * side.std, side.n)
                  for side in (ours, published)]  # fmt: skip
        other = interval(*scaled, 0.01 * factor)
        np.testing.assert_allclose(other, np.multiply(factor, (low, high)), rtol=1e-9)


def sample_of(errors: np.ndarray, decimals: int = 15) -> Sample:
    """Statistics of each row, as printed with so many decimals."""
    shown = (np.round(of(errors, axis=1), decimals) for of in (np.mean, np.std))
    return Sample(*shown, np.full(len(errors), errors.shape[1]))


def test_without_rounding_the_interval_is_welchs():
    draws = np.random.default_rng(3)
    ours, theirs = (draws.exponential(0.2, (50, n)) for n in (9, 10))
    welch = ttest_ind(ours, theirs, axis=1, equal_var=False).confidence_interval(0.95)
    np.testing.assert_allclose(interval(sample_of(ours), sample_of(theirs), 0.0), welch)


def mostly_small(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Draw errors [ms] of a correlation in steps of 10 ms; 15 % are of a wrong peak."""
    wrong = rng.random(shape) < 0.15
    return 10.0 * np.where(wrong, rng.integers(0, 100, shape), np.rint(rng.exponential(2.0, shape)))


@pytest.mark.parametrize(
    ("draw", "decimals"),
    [
        (lambda rng, shape: np.abs(rng.normal(0.0, 0.25, shape)), 2),
        (lambda rng, shape: rng.exponential(0.2, shape), 2),
        (lambda rng, shape: 0.15 * np.exp(rng.normal(0.0, 1.0, shape)), 2),
        (mostly_small, 1),
        (lambda rng, shape: 10.0 * rng.integers(0, 100, shape), 1),
    ],
    ids=["half-normal", "exponential", "lognormal", "outliers", "uniform"],
)
def test_one_distribution_on_both_sides_seldom_disagrees(draw, decimals):
    rng = np.random.default_rng(3)
    ours, theirs = (draw(rng, (2000, 10)) for _ in range(2))
    low, high = interval(sample_of(ours), sample_of(theirs, decimals), 10.0**-decimals)
    # The tolerance is three standard errors of a share of 5 % of 2000 cells.
    assert np.mean(comparison.verdicts_of(low, high) != "agrees") < 0.05 + 3 * 0.0049


@pytest.mark.parametrize("factor", [0.05, 0.7, 1.0, 1.4, 20.0])
def test_a_factor_is_found_in_the_ratio_and_columns_do_not_contradict_each_other(factor):
    table = compared(factor)
    assert len(table) == 2 * 15 * 5
    better, differs = (table["verdict"] == word for word in ("better", "differs"))
    lower, sized = table["mean_at_most_published"] == "yes", table["paper_size_or_better"] == "yes"
    assert (table["difference_low"] <= table["difference_high"]).all()
    assert not (better & ~lower).any()
    assert not (lower & ~sized).any()
    assert not (differs & sized).any()
    summary = comparison.summary_table(table)
    assert len(summary) == 2 * 5
    np.testing.assert_allclose(summary[["ratio", "ratio_min", "ratio_max"]], factor, rtol=1e-12)
    assert (summary[["agrees", "better", "differs"]].sum(axis=1) == 15).all()
    if factor == 1.0:  # the paper agrees with itself
        assert (summary["agrees"] == 15).all()
    elif not 0.1 < factor < 10.0:
        verdict = "better" if factor < 1.0 else "differs"
        assert (table["verdict"] == verdict).mean() > 0.5  # some published deviations are large
        assert set(table["verdict"]) <= {"agrees", verdict}


def test_failed_runs_count_for_n_and_rows_are_in_the_order_of_the_paper():
    published = load_published()
    ours = as_ours(published[10.0])
    ours.loc[0, "ssac_failed"] = 3
    table = comparison_table({10.0: ours}, published)
    first = table.query("angle_deg == 30 and t_d_ms == 5").set_index("quantity")
    expected = {one.name: 7 if one.method == "ssac" else 10 for one in comparison.PUBLISHED_ERRORS}
    assert dict(first["n_ours"]) == expected
    assert len(table) == 15 * 5
    assert csv_text(comparison_table({10.0: ours.iloc[::-1]}, published)) == csv_text(table)
    places = table[["angle_deg", "t_d_ms"]].drop_duplicates()
    np.testing.assert_array_equal(places, published[10.0][["angle_deg", "t_d_ms"]])


def test_a_reason_is_noted_only_where_a_cell_does_not_agree():
    of_R = {"quantity": ("ssac_r_error_deg",)}
    here = {"duration_s": (10.0,), "angle_deg": (30.0, 60.0), "t_d_ms": (5.0,)}
    reasons = {"another drone": of_R, "short": of_R | here}
    assert set(compared(1.0, **reasons)["note"]) == {""}
    table = compared(20.0, **reasons)
    noted = table[table["note"] != ""]
    assert set(noted["quantity"]) == {"ssac_r_error_deg"}
    of_R = table.query("quantity == 'ssac_r_error_deg' and verdict != 'agrees'")
    assert len(noted) == len(of_R)
    both = noted[noted["note"] == "another drone; short"]
    assert len(both)
    assert both[list(here)].isin(here).all(axis=None)


def test_ours_are_compared_by_their_own_names_as_far_as_there_are_runs():
    tables = esim_tables(made_up_runs(flights=3))
    table = comparison_table(tables, load_published())
    of = (table["quantity"] == "zncc_f_t_d_error_ms") & (table["duration_s"] == 20.0)
    row, ours = table[of].iloc[-1], tables[20.0].iloc[-1]
    place = (ours["angle_deg"], ours["t_d_ms"])
    assert (row["angle_deg"], row["t_d_ms"]) == place == (150.0, 500.0)
    assert row["ours_mean"] == ours["zncc_f_t_d_error_ms_mean"]
    assert (row["published_mean"], row["published_std"]) == (816.7, 163.6)
    few = comparison_table(esim_tables(made_up_runs(("ssac",), 2)), load_published())
    assert {name.partition("_")[0] for name in few["quantity"]} == {"ssac"}


def test_the_first_flights_alone_have_a_verdict_of_their_own():
    first, published = all_as_ours(1.3), load_published()
    table = comparison_table(all_as_ours(1.3, 1000), published, {}, first)
    alone = comparison_table(first, published, {})
    for name, of_first in (("verdict", "first_verdict"), ("difference_low", "first_low"),
                           ("n_ours", "first_n"), ("ours_mean", "first_mean")):  # fmt: skip
        assert list(table[of_first]) == list(alone[name]) == list(alone[of_first])
    wide, narrow = (table[f"{of}_high"] - table[f"{of}_low"] for of in ("first", "difference"))
    assert (narrow <= wide).all()


def test_an_unusable_published_table_is_named(tmp_path):
    with pytest.raises(SsacError, match=r"the paper's tables cannot be read: .*esim_10\.csv"):
        load_published(tmp_path)


def drawn(seed: int, n_ours: int) -> pd.DataFrame:
    """Draw a table's cells, all from one skewed distribution; three offsets per angle are equal."""
    rng = np.random.default_rng(seed)
    angles_deg = np.repeat((30.0, 60.0, 90.0, 120.0, 150.0), 3)
    part = pd.DataFrame({"angle_deg": angles_deg, "n_ours": n_ours, "first_n": PUBLISHED_RUNS})
    sizes = {"ours": n_ours, "published": PUBLISHED_RUNS, "first": PUBLISHED_RUNS}
    for side, n in sizes.items():
        errors = np.repeat(rng.gamma(2.0, 0.1, (5, n)), 3, axis=0)
        part[f"{side}_mean"], part[f"{side}_std"] = errors.mean(axis=1), errors.std(axis=1)
    return part


def ratio_of(part: pd.DataFrame) -> float:
    return gmean(part["ours_mean"] / part["published_mean"])


def test_the_interval_holds_the_true_ratio():
    parts = [drawn(seed, 30) for seed in range(300)]
    held = [abs(np.log(ratio_of(part))) < np.log(comparison.ratio_factor(part)) for part in parts]
    # 95 %, up to 2 % less for deviations of ten flights, and three standard errors of the share.
    assert 0.95 - 0.02 - 3 * 0.0126 < np.mean(held) < 0.95 + 3 * 0.0126


def test_more_flights_narrow_it_and_the_papers_own_bound_it():
    part = drawn(0, 30)
    paper = comparison.ratio_factor(part, ("published",))
    factors = [comparison.ratio_factor(part.assign(n_ours=n)) for n in (10, 30, 100, 10**9)]
    assert factors == sorted(factors, reverse=True)
    assert 1.0 < paper < factors[2]
    assert factors[-1] == pytest.approx(paper)
    # The unit does not matter, and more offsets do not count as more flights.
    scaled = part.copy()
    scaled[["ours_mean", "ours_std"]] *= 1000.0
    assert comparison.ratio_factor(scaled) == pytest.approx(comparison.ratio_factor(part))
    assert comparison.ratio_factor(part.iloc[::3]) == pytest.approx(comparison.ratio_factor(part))


@pytest.mark.parametrize(("column", "value"), [("ours_mean", 0.0), ("n_ours", 1)])
def test_a_cell_that_knows_no_scatter_leaves_none_known(column, value):
    part = drawn(2, 30)
    part.loc[4, column] = value
    assert np.isnan(comparison.ratio_factor(part))
    assert np.isfinite(comparison.ratio_factor(part, ("published",)))


def test_changed_verdicts_are_counted():
    part = drawn(3, 30).assign(
        quantity="ssac_t_d_error_ms", duration_s=10.0, difference_low=-0.1, difference_high=0.1,
        verdict="agrees", first_verdict="agrees",
    )  # fmt: skip
    part.loc[:1, "verdict"] = "differs"
    part.loc[2, "first_verdict"] = "better"
    (row,) = comparison.summary_table(part).to_dict("records")
    assert (row["agrees"], row["differs"], row["better"], row["changed"]) == (13, 2, 0, 3)
    assert (row["first_agrees"], row["first_differs"], row["first_better"]) == (14, 0, 1)
    assert row["ratio"] == pytest.approx(ratio_of(part))
    assert row["first_factor"] > row["factor"] > row["factor_paper"] > 1.0


def test_every_error_that_is_scored_is_a_column_of_the_runs():
    columns = scored(Estimate("m"), Truth(0.0, np.eye(3), np.eye(3)[0]))
    assert set(ERRORS) == {name for name in RUN_COLUMNS if "_error_" in name}
    assert set(RUN_COLUMNS[6:-2]) <= set(columns)
