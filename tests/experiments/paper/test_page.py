"""`results/README.md`: every number of the tables, and the verdicts."""

import numpy as np
import pandas as pd
import pytest

from experiments.lab.summary import markdown_table, means_with_stds, number, paragraph
from experiments.paper.comparison import PUBLISHED_RUNS, comparison_table, load_published
from experiments.paper.esim import esim_tables
from experiments.paper.page import results_page
from tests.experiments.reported import PROVENANCE, made_up_runs

RUNS = made_up_runs()


def compared_runs(runs: pd.DataFrame) -> pd.DataFrame:
    first = esim_tables(runs[runs["flight"] < PUBLISHED_RUNS])
    return comparison_table(esim_tables(runs), load_published(), first=first)


def page_of(runs: pd.DataFrame) -> str:
    return results_page(runs, esim_tables(runs), compared_runs(runs), PROVENANCE)


@pytest.fixture(scope="module")
def page():
    return page_of(RUNS)


def rows_of(page: str, heading: str) -> list[list[str]]:
    section = page.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_every_mean_and_every_verdict_is_on_the_page(page):
    all_rows = []
    for duration_s, table in esim_tables(RUNS).items():
        rows = rows_of(page, f"Flights of {duration_s:g} s")
        shown = {float(cell.split(" ± ")[0]) for row in rows for cell in row if " ± " in cell}
        means = table.filter(regex="_mean$").to_numpy()
        assert means.shape[1] > 10
        # Means are shown with one to three decimals.
        assert np.isin([np.round(means, n) for n in (1, 2, 3)], [*shown]).any(axis=0).all()
        all_rows += rows
    comparison = compared_runs(RUNS)
    for word in ("agrees", "better", "differs"):
        assert sum(row.count(word) for row in all_rows) == (comparison["verdict"] == word).sum()
    listed = rows_of(page, "Cells that differ")
    differing = comparison[comparison["verdict"] == "differs"]
    assert len(listed) - 2 == len(differing) > 0
    assert [row[-1] for row in listed[2:]] == [note or "not known" for note in differing["note"]]
    # Where the provenance names no OpenGL, there still is a page.
    without = results_page(RUNS, esim_tables(RUNS), comparison, PROVENANCE | {"gl": None})
    assert "rendered by ?, ?; numpy 2.2.6." in " ".join(without.split())


def test_further_flights_have_a_section_that_lists_every_changed_verdict(page):
    heading = "What our further flights tell"
    assert heading not in page
    runs = made_up_runs(("ssac", "zncc_e"), 14)
    comparison = compared_runs(runs)
    changed = comparison[comparison["verdict"] != comparison["first_verdict"]]
    rows = rows_of(page_of(runs), heading)
    split = next(n for n, row in enumerate(rows) if row[-1] == "cells")
    assert sum(int(row[5]) for row in rows[2:split]) == len(changed) > 0
    listed = [cell for row in rows[split + 2 :] for cell in row[-1].split("; ")]
    assert sum(len(cell.split(",")) for cell in listed) == len(changed)


def test_a_cell_with_failed_runs_says_how_many_are_left():
    joint = RUNS.query("method == 'joint' and duration_s == 20 and t_d_ms == 50")
    lost = joint.query("angle_deg == 30 and flight < 2 or angle_deg == 60").index
    runs = RUNS.assign(status=RUNS["status"].mask(RUNS.index.isin(lost), "search_bound"))
    rows = rows_of(page := page_of(runs), "Flights of 20 s")
    start = next(n for n, row in enumerate(rows) if "`joint` t_d [ms]" in row)
    column = rows[start].index("`joint` t_d [ms]")
    cells = {tuple(row[:2]): row[column] for row in rows[start + 2 : start + 17]}
    assert cells["30", "50"].endswith("(8 runs)")
    assert cells["60", "50"] == "none"
    assert "runs" not in cells["90", "50"]
    rows = rows_of(page, "Runs without an estimate")
    assert sum(int(row[3]) for row in rows[2:]) == (runs["status"] != "ok").sum() > 0


def test_correlation_methods_stand_beside_the_paper_by_angle():
    runs = made_up_runs(("zncc_e",), 2)
    page = page_of(runs.assign(t_d_error_ms=np.where(runs["angle_deg"] < 90.0, 20.0, 500.0)))
    assert "\n0 of 60.\n" in page
    rows = rows_of(page, "Correlation methods by angle")
    ours = [row for row in rows if row[0] == "`zncc_e`" and row[2] == "ours"]
    assert [row[3:] for row in ours] == [["20", "20", "500", "500", "500"]] * 2


def test_numbers_stand_right_and_words_left():
    text = markdown_table(
        pd.DataFrame({"word": ["a", "b|c"], "number": ["-1.5", "none"], "empty": ["", "2 s"]})
    )
    assert text.splitlines() == [
        "| word | number | empty |",
        "| ---- | -----: | ----: |",
        "| a    |   -1.5 |       |",
        r"| b\|c |   none |   2 s |",
    ]
    means, stds = pd.Series([1.0, 22.25, np.nan]), pd.Series([0.5, 10.0, np.nan])
    assert means_with_stds(means, stds, 1) == ["1.0 ±  0.5", "22.2 ± 10.0", "none"]
    assert number(np.inf, 2) == "none"
    assert paragraph("- " + "word " * 30).splitlines()[1].startswith("  word")
