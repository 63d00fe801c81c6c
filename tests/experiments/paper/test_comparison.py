from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_ind_from_stats

from experiments.lab.files import csv_text
from experiments.paper.comparison import (
    PUBLISHED,
    PUBLISHED_ERRORS,
    PUBLISHED_RUNS,
    Reason,
    Sample,
    comparison_table,
    difference_interval,
    load_published,
    summary_table,
    verdict_of,
)
from experiments.paper.esim import esim_tables
from ssac.errors import SsacError
from tests.experiments.reported import made_up_runs

CASES = [
    (Sample(0.2, 0.1, 10), Sample(0.16, 0.21, 10)),
    (Sample(0.5, 0.1, 9), Sample(0.16, 0.1, 10)),
    (Sample(0.05, 0.02, 10), Sample(0.16, 0.05, 10)),
    (Sample(300.0, 0.0, 4), Sample(17.0, 11.7, 10)),
    (Sample(12.0, 3.0, 2), Sample(17.0, 0.0, 10)),
]


def as_ours(published: pd.DataFrame, factor: float = 1.0, n_runs: int = 10) -> pd.DataFrame:
    """Make a table of ours that has the published numbers times a factor."""
    table = published[["angle_deg", "t_d_ms"]].astype(float).assign(n_runs=n_runs)
    for quantity in PUBLISHED_ERRORS:
        for part in ("mean", "std"):
            table[f"{quantity.name}_{part}"] = factor * published[f"{quantity.published}_{part}"]
        table[f"{quantity.method}_failed"] = 0
    return table


def compared(factor: float = 1.0, reasons: tuple[Reason, ...] = ()) -> pd.DataFrame:
    published = load_published()
    ours = {duration_s: as_ours(table, factor) for duration_s, table in published.items()}
    return comparison_table(ours, published, reasons)


@pytest.mark.parametrize(("ours", "published"), CASES)
@pytest.mark.parametrize("factor", [1e-3, 0.7, 1e4])
def test_the_unit_does_not_matter(ours, published, factor):
    scaled = [Sample(factor * side.mean, factor * side.std, side.n) for side in (ours, published)]
    interval = difference_interval(ours, published, 0.01, 0.95)
    other = difference_interval(*scaled, 0.01 * factor, 0.95)
    np.testing.assert_allclose(other, np.multiply(factor, interval), rtol=1e-9)
    assert verdict_of(other) == verdict_of(interval)


@pytest.mark.parametrize(("ours", "published"), CASES)
def test_swapping_the_sides_mirrors_the_interval(ours, published):
    low, high = difference_interval(ours, published, 0.1, 0.95)
    assert difference_interval(published, ours, 0.1, 0.95) == pytest.approx((-high, -low))


@pytest.mark.parametrize(("ours", "published"), CASES)
def test_without_rounding_the_rule_is_welchs_test(ours, published):
    verdict = verdict_of(difference_interval(ours, published, 0.0, 0.95))
    # scipy wants deviations over n - 1.
    sides = [
        part
        for side in (ours, published)
        for part in (side.mean, side.std * np.sqrt(side.n / (side.n - 1)), side.n)
    ]
    significant = ttest_ind_from_stats(*sides, equal_var=False).pvalue < 0.05
    assert (verdict != "agrees") == significant
    if significant:
        assert verdict == ("better" if ours.mean < published.mean else "differs")


def test_the_cases_above_have_all_verdicts():
    verdicts = {verdict_of(difference_interval(*case, 0.01, 0.95)) for case in CASES}
    assert verdicts == {"agrees", "better", "differs"}


@pytest.mark.parametrize(
    ("mean", "verdict"),
    [(0.1649, "agrees"), (0.1551, "agrees"), (0.1651, "differs"), (0.1549, "better")],
)
def test_what_rounding_hides_is_no_difference(mean, verdict):
    exact = Sample(mean, 0.0, 10), Sample(0.16, 0.0, 10)
    assert verdict_of(difference_interval(*exact, 0.01, 0.95)) == verdict


@pytest.mark.parametrize("n", [0, 1])
def test_fewer_than_two_runs_do_not_agree(n):
    interval = difference_interval(Sample(0.16, 0.0, n), Sample(0.16, 0.1, 10), 0.01, 0.95)
    assert np.isnan(interval).all()
    assert verdict_of(interval) == "differs"


def mostly_small(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Errors of a correlation that now and then takes a wrong peak, in units of 10 ms."""
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
def test_one_distribution_on_both_sides_seldom_disagrees(
    draw: Callable[[np.random.Generator, tuple[int, int]], np.ndarray], decimals: int
):
    n_cells = 2000
    rng = np.random.default_rng(3)
    ours, theirs = (draw(rng, (n_cells, 10)) for _ in range(2))
    verdicts = [
        verdict_of(
            difference_interval(
                Sample(mine.mean(), mine.std(), 10),
                Sample(round(other.mean(), decimals), round(other.std(), decimals), 10),
                10.0**-decimals,
                0.95,
            )
        )
        for mine, other in zip(ours, theirs, strict=True)
    ]
    # 5 %, and three standard errors of a share of 5 % of 2000 cells.
    assert np.mean([verdict != "agrees" for verdict in verdicts]) < 0.05 + 3 * 0.0049


def test_the_published_deviations_are_over_ten_runs():
    """Ten errors of ZNCC_E, multiples of its 10 ms, that have the published mean and deviation."""
    feasible = {0: 0, 1: 0}
    for table in load_published().values():
        for row in table.to_dict("records"):
            odd = row["t_d_ms"] == 5  # |10 k - 5| are odd multiples of 5, |10 k - 50| of 10
            unit = 5.0 if odd else 10.0
            total = PUBLISHED_RUNS * row["zncc_e_error_ms_mean"] / unit
            assert total == pytest.approx(round(total))
            for ddof in feasible:
                # The sum of squares lies between these, as the deviation is rounded to 0.1 ms.
                low, high = (
                    (PUBLISHED_RUNS - ddof) * ((row["zncc_e_error_ms_std"] + half) / unit) ** 2
                    + total**2 / PUBLISHED_RUNS
                    for half in (-0.05, 0.05)
                )
                sums = np.arange(np.ceil(low - 1e-9), np.floor(high + 1e-9) + 1)
                # Odd squares are 1 modulo 8; a square is odd just when its root is.
                fits = sums % 8 == PUBLISHED_RUNS % 8 if odd else sums % 2 == round(total) % 2
                feasible[ddof] += bool(fits.any())
    assert feasible[0] == 30
    assert feasible[1] < 30


def test_the_paper_agrees_with_itself():
    table = compared()
    assert len(table) == 2 * 15 * 5
    assert set(table["verdict"]) == {"agrees"}
    assert set(table["paper_size_or_better"]) == set(table["mean_at_most_published"]) == {"yes"}
    summary = summary_table(table)
    assert len(summary) == 2 * 5
    assert (summary["agrees"] == 15).all()
    np.testing.assert_allclose(summary[["ratio", "ratio_min", "ratio_max"]], 1.0, rtol=1e-12)


@pytest.mark.parametrize(("factor", "verdict"), [(0.05, "better"), (20.0, "differs")])
def test_a_factor_is_found_in_the_ratio_and_the_verdicts(factor, verdict):
    table = compared(factor)
    summary = summary_table(table)
    np.testing.assert_allclose(summary["ratio"], factor, rtol=1e-12)
    assert (summary[["agrees", "better", "differs"]].sum(axis=1) == 15).all()
    assert (table["verdict"] == verdict).mean() > 0.5  # some published deviations are large
    assert set(table["verdict"]) <= {"agrees", verdict}


@pytest.mark.parametrize("factor", [0.3, 0.7, 1.4, 3.0])
def test_the_columns_do_not_contradict_each_other(factor):
    table = compared(factor)
    better, differs = (table["verdict"] == word for word in ("better", "differs"))
    lower, sized = table["mean_at_most_published"] == "yes", table["paper_size_or_better"] == "yes"
    assert (table["difference_low"] <= table["difference_high"]).all()
    assert not (better & ~lower).any()
    assert not (lower & ~sized).any()
    assert not (differs & sized).any()


def test_failed_runs_count_for_n():
    published = load_published()
    ours = as_ours(published[10.0])
    ours.loc[0, "ssac_failed"] = 3
    table = comparison_table({10.0: ours}, published)
    first = table[(table["angle_deg"] == 30) & (table["t_d_ms"] == 5)].set_index("quantity")[
        "n_ours"
    ]
    assert dict(first) == {
        "ssac_t_d_error_ms": 7, "zncc_e_t_d_error_ms": 10, "zncc_f_t_d_error_ms": 10,
        "ssac_r_error_deg": 7, "ssac_t_error_deg": 7,
    }  # fmt: skip
    assert len(table) == 15 * 5


def test_rows_are_in_the_order_of_the_paper_whatever_the_order_of_ours():
    published = load_published()
    ours = as_ours(published[20.0])
    reference = comparison_table({20.0: ours}, published)
    turned = comparison_table({20.0: ours.iloc[::-1]}, published)
    places = reference[["angle_deg", "t_d_ms"]].drop_duplicates()
    np.testing.assert_array_equal(places, published[20.0][["angle_deg", "t_d_ms"]])
    assert csv_text(turned) == csv_text(reference)


def test_a_reason_is_noted_only_where_a_cell_does_not_agree():
    everywhere = Reason("another drone", ("ssac_r_error_deg",))
    here = Reason("short", ("ssac_r_error_deg",), (10.0,), (30.0, 60.0), (5.0,))
    assert set(compared(1.0, (everywhere, here))["note"]) == {""}
    table = compared(20.0, (everywhere, here))
    noted = table[table["note"] != ""]
    assert set(noted["quantity"]) == {"ssac_r_error_deg"}
    assert (
        len(noted)
        == ((table["quantity"] == "ssac_r_error_deg") & (table["verdict"] != "agrees")).sum()
    )
    both = noted[noted["note"] == "another drone; short"]
    assert set(both["duration_s"]) == {10.0}
    assert set(both["angle_deg"]) <= {30.0, 60.0}
    assert set(both["t_d_ms"]) == {5.0}


def test_ours_are_compared_by_their_own_names():
    tables = esim_tables(made_up_runs(flights=3))
    table = comparison_table(tables, load_published())
    row = table[(table["quantity"] == "zncc_f_t_d_error_ms") & (table["duration_s"] == 20.0)].iloc[
        -1
    ]
    ours = tables[20.0].iloc[-1]
    assert (
        (row["angle_deg"], row["t_d_ms"]) == (ours["angle_deg"], ours["t_d_ms"]) == (150.0, 500.0)
    )
    assert row["ours_mean"] == ours["zncc_f_t_d_error_ms_mean"]
    assert (row["published_mean"], row["published_std"]) == (816.7, 163.6)


def test_methods_without_runs_are_left_out_and_nothing_in_common_is_an_error():
    table = comparison_table(esim_tables(made_up_runs(("ssac",), 2)), load_published())
    assert {name.partition("_")[0] for name in table["quantity"]} == {"ssac"}
    with pytest.raises(SsacError, match="no cell in common"):
        comparison_table(esim_tables(made_up_runs(("joint",), 2)), load_published())


def test_the_first_flights_alone_have_a_verdict_of_their_own():
    published = load_published()
    first = {duration_s: as_ours(table, 1.3) for duration_s, table in published.items()}
    all_of = {key: as_ours(table, 1.3, 1000) for key, table in published.items()}
    table = comparison_table(all_of, published, (), first)
    alone = comparison_table(first, published, ())
    for name, of_first in (("verdict", "first_verdict"), ("difference_low", "first_low"),
                           ("n_ours", "first_n"), ("ours_mean", "first_mean")):  # fmt: skip
        assert list(table[of_first]) == list(alone[name]) == list(alone[of_first])
    wide, narrow = (table[f"{of}_high"] - table[f"{of}_low"] for of in ("first", "difference"))
    assert (narrow <= wide).all()
    with pytest.raises(SsacError, match="the first 10 flights of 20 s are not there"):
        comparison_table(all_of, published, (), {10.0: first[10.0]})


def test_an_unusable_published_table_is_named(tmp_path):
    with pytest.raises(SsacError, match=r"esim_10\.csv: the published table cannot be read"):
        load_published(tmp_path)
    for name in ("esim_10.csv", "esim_20.csv"):
        text = (PUBLISHED / name).read_text()
        (tmp_path / name).write_text(text.replace("r_error_deg_std", "r_std"))
    with pytest.raises(SsacError, match=r"esim_10\.csv.*lacks the columns r_error_deg_std"):
        load_published(tmp_path)
