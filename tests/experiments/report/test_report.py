"""The report: one whole page, every number from the files; its animation is what was estimated."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.lab.cache import Cache
from experiments.report import report
from experiments.report.animation import T_D_S, Animation, make_animation
from experiments.report.data import Results, load_results
from experiments.report.report import report_command, report_page
from experiments.report.tables import number
from experiments.studies.ablations import ABLATIONS
from sim.errors import SimError
from ssac.errors import SsacError
from ssac.files.hdf5 import load_events_h5, save_events_h5
from tests.experiments.reported import FIGURES, METHODS, made_up_runs, record_flight, write_results
from tests.html_pages import EVIL, check_page
from tests.ssac.synthetic import HEIGHT, WIDTH


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that nobody changes."""
    folder = tmp_path_factory.mktemp("flight")
    record_flight(folder)
    return folder


@pytest.fixture(scope="module")
def animation(flight: Path) -> Animation:
    return make_animation(flight)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    write_results(folder, made_up_runs(flights=4))
    return folder


@pytest.fixture(scope="module")
def results(folder: Path) -> Results:
    return load_results(folder)


@pytest.fixture(scope="module")
def page(results: Results, animation: Animation) -> str:
    return report_page(results, animation)


@pytest.fixture(scope="module")
def shown(results: Results, animation: Animation):
    """One section of the page, where some of the results are others."""

    def section(name: str, **changed: Any) -> str:
        page = report_page(replace(results, **changed), animation)
        return page[page.index(f'<section id="{name}">') :].partition("</section>")[0]

    return section


def rows_of(table: str) -> list[list[str]]:
    """Cells of each row, tags removed."""
    rows = re.findall(r"<tr.*?</tr>", table)
    return [
        [re.sub("<[^>]*>", " ", cell) for cell in re.findall(r"<td.*?</td>", row)] for row in rows
    ]


def test_the_page_is_well_formed_and_needs_nothing_else(
    page: str, folder: Path, flight: Path
) -> None:
    check_page(page)
    # The same input gives the same bytes.
    assert report_page(load_results(folder), make_animation(flight)) == page


def test_compared_numbers_stand_beside_the_papers_with_their_verdicts(results, shown) -> None:
    html, comparison = shown("paper"), results.comparison
    cells = [cell for row in rows_of(html) for cell in row]
    assert len(cells) == len(comparison) == 150
    found = [re.findall(r"[\d.]+ ± [\d.]+", cell) for cell in cells]
    # Rows as the page has them: by duration, cell, quantity.
    place = comparison["quantity"].map(list(comparison["quantity"].unique()).index)
    ordered = comparison.assign(place=place).sort_values(
        ["duration_s", "angle_deg", "t_d_ms", "place"]
    )
    for row, both in zip(ordered.to_dict("records"), found, strict=True):
        assert both == [
            f"{number(row[f'{of}_mean'])} ± {number(row[f'{of}_std'], row[f'{of}_mean'])}"
            for of in ("ours", "published")
        ]
    for verdict, count in comparison["verdict"].value_counts().items():
        assert html.count(f'<td class="{verdict}"') == count
        assert f"{verdict}: {count}</span>" in html
    comparison = comparison.assign(note="")
    assert "Why cells do not agree" not in shown("paper", comparison=comparison)
    comparison.loc[[3, 8], "note"] = "fewer <flights>"
    assert "<li>fewer &lt;flights&gt; (2 cells: " in shown("paper", comparison=comparison)


def test_every_mean_is_in_the_tables(results: Results, shown) -> None:
    tables = re.findall(r"<table.*?</table>", shown("tables"), flags=re.DOTALL)
    assert len(tables) == 6  # three kinds of error, two durations
    for n, (table, duration_s) in enumerate(zip(tables, 3 * [10.0, 20.0], strict=True)):
        methods = re.findall(r'<th scope="col"><code>(.*?)</code>', table)
        error = ("t_d_error_ms", "r_error_deg", "t_error_deg")[n // 2]
        ours = results.tables[duration_s]
        expected = ours[[f"{method}_{error}_mean" for method in methods]].to_numpy().ravel()
        means = [cell.split()[0] for row in rows_of(table) for cell in row]
        assert means == [number(value) for value in expected]


def test_a_method_from_outside_is_shown_like_ours(tmp_path: Path, animation: Animation) -> None:
    write_results(tmp_path, made_up_runs((*METHODS, "speedy"), flights=2))
    results = load_results(tmp_path)
    assert results.methods == [*METHODS, "speedy"]
    page = report_page(results, animation)
    assert page.count("<code>speedy</code>") == 3 + 6  # a row of each chart, a column of each table


def test_the_figures_are_those_that_are_drawn(results: Results, page: str) -> None:
    n_figures = len(FIGURES) + len(ABLATIONS)
    assert len(results.figures) == n_figures
    assert page.count('<img src="data:image/png;base64,') == n_figures
    assert results.figures[0].size_px == (60, 30)


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("runs.csv", "make tables"),
        ("comparison.csv", "make tables"),
        ("esim_20.provenance.json", "make tables"),
        ("fig4_epipolar.png", "make figures"),
        ("efficiency.png", "make studies"),
        ("ablation_window.png", "make ablations"),
    ],
)
def test_a_missing_or_damaged_file_names_its_command(
    name: str, command: str, folder: Path, tmp_path: Path
) -> None:
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    (tmp_path / name).write_bytes(b"\xff nonsense")
    with pytest.raises(SsacError, match=rf"{name} cannot be used .* run `{command}` again"):
        load_results(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(SsacError, match=rf"{name} is missing: run `{command}` first"):
        load_results(tmp_path)


def test_what_files_say_cannot_become_html_and_is_shown_once(
    results: Results, animation: Animation
) -> None:
    runs = results.runs.copy()
    runs.loc[0, ["status", "reason"]] = ["crashed", EVIL]
    (entry,) = results.provenance.values()
    provenance = {
        **{EVIL: {"command": EVIL, "config": {EVIL: EVIL}}},
        **{"esim_10": entry, "esim_20": entry, "figures": {**entry, "command": "ssac figures"}},
    }
    page = report_page(replace(results, runs=runs, provenance=provenance), animation)
    assert "".join(check_page(page).text).count(EVIL) >= 4
    assert "<b>esim_10, esim_20</b> <code>ssac tables</code>" in page
    assert "<b>figures</b> <code>ssac figures</code>" in page
    assert "0123456789ab" in page


def test_failures_are_counted_with_their_reasons(results: Results, shown) -> None:
    html, runs = shown("failures"), results.runs
    failed, good = (runs[(runs["status"] == "ok") == is_ok] for is_ok in (False, True))
    assert len(failed) > 0
    assert (f"<p>{len(failed)} of {len(runs)} runs gave no estimate.") in html
    for method, group in failed.groupby("method"):
        assert f"<code>{method}</code>" in html
        assert f"<td>{len(group)} of {(runs['method'] == method).sum()}</td>" in html
    reasons = re.findall(r"<li>the best offset, .*? s, bounds the search \((\d+)\)", html)
    more = re.findall(r"<li>and (\d+) more in runs.csv", html)
    assert sum(map(int, [*reasons, *more])) == len(failed)
    html = shown("failures", runs=good)
    assert f"<p>All {len(good)} runs gave an estimate.</p>" in html
    assert "<table" not in html


def test_the_headline_is_computed(results: Results, shown) -> None:
    def headline(runs: pd.DataFrame) -> list[str]:
        return re.findall(r"<li><b>(.*?)</b><span>(.*?)</span></li>", shown("numbers", runs=runs))

    runs = results.runs.copy()
    joint = runs["method"] == "joint"
    runs.loc[joint, ["t_d_error_ms", "r_error_deg", "t_error_deg"]] = [0.0625, 0.25, 0.125]
    best, ssac, verdicts, counts = headline(runs)
    assert best[0] == "0.062 ms"
    assert "<code>joint</code>" in best[1]
    assert "rotation 0.25&deg;, translation 0.12&deg;" in best[1]
    mean_ms = runs.loc[runs["method"] == "ssac", "t_d_error_ms"].mean()
    assert ssac[0] == f"{number(mean_ms)} ms"
    good = results.comparison["verdict"].isin(["agrees", "better"]).sum()
    assert verdicts[0] == f"{good} of 150"
    assert counts[0] == f"{len(runs):,}".replace(",", "\N{THIN SPACE}")
    # One run in five is too few for a method to be called the best.
    runs.loc[joint & (runs["flight"] > 0), "status"] = "search_bound"
    assert "<code>joint</code>" not in headline(runs)[0][1]


def test_numbers_have_as_many_decimals_as_the_papers() -> None:
    values = (0.0, 0.0123, 0.456, 12.34, 543.2, np.nan)
    shown = ["0.000", "0.012", "0.46", "12.3", "543", "\N{EN DASH}"]
    assert [number(value) for value in values] == shown
    assert [number(value, value) for value in values] == shown
    assert number(0.01234, 50.0) == "0.0"  # a deviation, to the decimal of its mean


def test_the_command_writes_the_page(
    folder: Path, flight: Path, tmp_path: Path, page: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    monkeypatch.setattr(
        Cache, "recording_folder", lambda self, config, seed: asked.append((config, seed)) or flight
    )
    out = tmp_path / "new" / "report.html"
    report_command(folder, tmp_path / "cache", out)
    assert out.read_text(encoding="utf-8") == page
    assert [(config.angle_deg, seed) for config, seed in asked] == [(90.0, report.SEED)]
    with pytest.raises(SsacError, match="is a folder: name a file"):
        report_command(folder, tmp_path / "cache", tmp_path)


def test_the_player_shows_the_offset_that_was_put_in(animation: Animation) -> None:
    # The synthetic tracks have about 1 px of noise at 180 px/s: 6 ms in one pair, 1 ms in hundreds.
    assert animation.estimate.t_d_s == pytest.approx(T_D_S, abs=1e-3)
    off_s = abs(animation.estimate.t_d_s - T_D_S)
    assert animation.errors.t_d_error_ms == pytest.approx(1e3 * off_s)
    assert animation.errors.r_error_deg < 2.0  # of the same cause: 1 px is 0.3 deg here
    assert animation.before_px > 20.0
    assert animation.after_px < 4.0  # 1000 events over 20 px: a mean that is good to 1 px
    (pair,) = animation.player["pairs"]
    assert animation.player["tour"]
    assert (pair["before"], pair["found"]) == (0.0, animation.estimate.t_d_s)


def test_a_recording_that_gives_no_estimate_is_refused(flight: Path, tmp_path: Path) -> None:
    shutil.copytree(flight, tmp_path / "few")
    events = load_events_h5(flight / "cam2.h5").events
    save_events_h5(tmp_path / "few" / "cam2.h5", events[: len(events) // 40], WIDTH, HEIGHT)
    with pytest.raises(SimError, match="tangency can synchronise, got"):
        make_animation(tmp_path / "few")
