"""Runs in; `results/` out: the runs, the tables, the comparison and the page, made from one text.

All that follows from the runs is made from the text of `runs.csv` as it was rounded there, so that
anyone who has that file makes the same bytes.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.lab.files import csv_text
from experiments.paper.comparison import (
    PUBLISHED,
    PUBLISHED_RUNS,
    comparison_table,
    load_published,
    summary_table,
)
from experiments.paper.esim import esim_tables, ordered_runs, runs_from_csv
from experiments.paper.page import results_page
from ssac.files.whole_file import whole_file

RUNS_FILE, COMPARISON_FILE, PAGE_FILE = "runs.csv", "comparison.csv", "README.md"
SUMMARY_FILE = "comparison_summary.csv"


def save_results(runs: pd.DataFrame, folder: Path, provenance: Mapping[str, Any]) -> None:
    """Write `runs.csv`, the tables, the comparison and the page into `folder`.

    Parameters
    ----------
    runs
        As `esim.ordered_runs` takes them.
    folder
        Is made when it is not there.
    provenance
        What `provenance.save_provenance` writes for the runs.
    """
    folder.mkdir(parents=True, exist_ok=True)
    runs_text = csv_text(ordered_runs(runs))
    for name, text in {RUNS_FILE: runs_text, **derived(runs_text, provenance)}.items():
        with whole_file(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")


def derived(
    runs_text: str, provenance: Mapping[str, Any], published: Path = PUBLISHED
) -> dict[str, str]:
    """Make all files that follow from `runs.csv`, from its text, so that anyone gets the same.

    Returns
    -------
    dict[str, str]
        Name of the file -> its text.
    """
    runs = ordered_runs(runs_from_csv(runs_text))
    tables = esim_tables(runs)
    comparison = compared_runs(runs, tables, published)
    files = {f"esim_{duration_s:g}.csv": csv_text(table) for duration_s, table in tables.items()}
    files[COMPARISON_FILE] = csv_text(comparison)
    files[SUMMARY_FILE] = csv_text(summary_table(comparison))
    files[PAGE_FILE] = results_page(runs, tables, comparison, provenance)
    return files


def compared_runs(
    runs: pd.DataFrame, tables: Mapping[float, pd.DataFrame], published: Path = PUBLISHED
) -> pd.DataFrame:
    """Compare the tables of all flights, and of the first as many as the paper's, with its own."""
    first = esim_tables(runs[runs["flight"] < PUBLISHED_RUNS])
    return comparison_table(tables, load_published(published), first=first)
