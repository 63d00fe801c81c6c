"""The report: one whole page, every number from the files, nothing from elsewhere."""

import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.lab.cache import Cache
from experiments.lab.grid import flight_seed
from experiments.report import report
from experiments.report.animation import Animation, make_animation
from experiments.report.data import Results, load_results
from experiments.report.report import report_command, report_page
from experiments.report.tables import mean_and_std, number
from experiments.studies.ablations import ABLATIONS
from experiments.studies.figures import DRAWINGS
from ssac.errors import SsacError
from tests.experiments.reported import METHODS, made_up_runs, write_results

VOID = {"meta", "link", "img", "br", "input"}
PAGE = Path(report.__file__).parent / "page"


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


class Reader(HTMLParser):
    """Fails on elements that are not nested properly; keeps what a browser would load."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.text: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        names = dict(attrs)
        self.ids += [str(names["id"])] if "id" in names else []
        self.addresses += [str(v) for k, v in attrs if k in ("src", "href", "srcset", "action")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("script", "style"):
            self.text.append(data)


def section(results: Results, animation: Animation, name: str) -> str:
    """One section of the page."""
    page = report_page(results, animation)
    return page[page.index(f'<section id="{name}">') :].partition("</section>")[0]


def rows_of(table: str) -> list[list[str]]:
    """Cells of each row, tags removed."""
    rows = re.findall(r"<tr.*?</tr>", table)
    return [
        [re.sub("<[^>]*>", " ", cell) for cell in re.findall(r"<td.*?</td>", row)] for row in rows
    ]


def test_the_page_is_well_formed_and_needs_nothing_else(page: str) -> None:
    reader = Reader(page)
    assert len(set(reader.ids)) == len(reader.ids)
    assert reader.addresses
    assert all(address.startswith("data:") for address in reader.addresses)
    assert "default-src 'none'" in page
    style, script = (PAGE.joinpath(name).read_text() for name in ("report.css", "player.js"))
    for word in ("@import", "url(", "http:", "https:", "fetch(", "XMLHttpRequest", "import("):
        assert word not in style + script


def test_all_parts_that_the_script_looks_for_are_there() -> None:
    script, html = (PAGE.joinpath(name).read_text() for name in ("player.js", "report.html"))
    named = set(re.findall(r'find\("(\w+)"\)', script)) | {"view1", "view2", "clock1", "clock2"}
    assert named == set(re.findall(r'data-part="(\w+)"', html))


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_script_can_be_parsed() -> None:
    subprocess.run(["node", "--check", str(PAGE / "player.js")], check=True)


def test_the_same_input_gives_the_same_bytes(page: str, folder: Path, flight: Path) -> None:
    assert report_page(load_results(folder), make_animation(flight)) == page


def test_compared_numbers_stand_beside_the_papers(results: Results, animation: Animation) -> None:
    html = section(results, animation, "paper")
    cells = [cell for row in rows_of(html) for cell in row]
    assert len(cells) == len(results.comparison) == 150
    shown = [re.findall(r"[\d.]+ ± [\d.]+", cell) for cell in cells]
    for row, (ours, theirs) in zip(_row_order(results.comparison), shown, strict=True):
        assert ours == " ± ".join(mean_and_std(row["ours_mean"], row["ours_std"]))
        expected = mean_and_std(row["published_mean"], row["published_std"])
        assert theirs == " ± ".join(expected)


def test_every_verdict_has_its_colour_and_its_sign(results: Results, animation: Animation) -> None:
    html = section(results, animation, "paper")
    for verdict, count in results.comparison["verdict"].value_counts().items():
        assert html.count(f'<td class="{verdict}"') == count
        assert f"{verdict}: {count}</span>" in html


def test_the_note_of_a_cell_is_shown(results: Results, animation: Animation) -> None:
    comparison = results.comparison.assign(note="")
    comparison.loc[[3, 8], "note"] = "fewer <flights>"
    html = section(replace(results, comparison=comparison), animation, "paper")
    assert "<li>fewer &lt;flights&gt; (2 cells: " in html
    assert "Why cells do not agree" not in section(
        replace(results, comparison=comparison.assign(note="")), animation, "paper"
    )


def test_every_mean_is_in_the_tables(results: Results, animation: Animation) -> None:
    tables = re.findall(
        r"<table.*?</table>", section(results, animation, "tables"), flags=re.DOTALL
    )
    assert len(tables) == 6  # three kinds of error, two durations
    for table, duration_s in zip(tables, 3 * [10.0, 20.0], strict=True):
        methods = re.findall(r'<th scope="col"><code>(.*?)</code>', table)
        error = ("t_d_error_ms", "r_error_deg", "t_error_deg")[tables.index(table) // 2]
        ours = results.tables[duration_s]
        expected = ours[[f"{method}_{error}_mean" for method in methods]].to_numpy().ravel()
        shown = [cell.split()[0] for row in rows_of(table) for cell in row]
        assert shown == [number(value) for value in expected]


def test_a_method_from_outside_is_shown_like_ours(tmp_path: Path, animation: Animation) -> None:
    write_results(tmp_path, made_up_runs((*METHODS, "speedy"), flights=2))
    results = load_results(tmp_path)
    assert results.methods == [*METHODS, "speedy"]
    page = report_page(results, animation)
    assert page.count("<code>speedy</code>") == 3 + 6  # a row of each chart, a column of each table


def test_the_figures_are_those_that_are_drawn(results: Results, page: str) -> None:
    n_figures = len(DRAWINGS) + len(ABLATIONS)  # which their studies draw
    assert len(results.figures) == n_figures
    assert page.count('<img src="data:image/png;base64,') == n_figures
    assert results.figures[0].size_px == (60, 30)


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("runs.csv", "make tables"),
        ("esim_10.csv", "make tables"),
        ("esim_20.csv", "make tables"),
        ("comparison.csv", "make tables"),
        ("esim_20.provenance.json", "make tables"),
        ("fig4_epipolar.png", "make figures"),
        ("error_vs_angle.png", "make figures"),
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


def test_what_files_say_cannot_become_html(results: Results, animation: Animation) -> None:
    evil = "</script><script>alert('x')</script>&"
    runs = results.runs.copy()
    runs.loc[0, ["status", "reason"]] = ["crashed", evil]
    provenance = {evil: {"command": evil, "config": {evil: evil}}}
    page = report_page(replace(results, runs=runs, provenance=provenance), animation)
    assert "alert('x')" not in page
    assert "".join(Reader(page).text).count(evil) >= 4
    assert page.count("<script") == 2


def test_failures_are_counted_with_their_reasons(results: Results, animation: Animation) -> None:
    html = section(results, animation, "failures")
    failed = results.runs[results.runs["status"] != "ok"]
    assert len(failed) > 0
    assert (f"<p>{len(failed)} of {len(results.runs)} runs gave no estimate.") in html
    for method, group in failed.groupby("method"):
        assert f"<code>{method}</code>" in html
        assert f"<td>{len(group)} of {(results.runs['method'] == method).sum()}</td>" in html
    reasons = re.findall(r"<li>the best offset, .*? s, bounds the search \((\d+)\)", html)
    more = re.findall(r"<li>and (\d+) more in runs.csv", html)
    assert sum(map(int, [*reasons, *more])) == len(failed)


def test_without_failures_there_is_no_table(results: Results, animation: Animation) -> None:
    good = results.runs[results.runs["status"] == "ok"]
    html = section(replace(results, runs=good), animation, "failures")
    assert f"<p>All {len(good)} runs gave an estimate.</p>" in html
    assert "<table" not in html


def test_the_headline_is_computed(results: Results, animation: Animation) -> None:
    def headline(runs: pd.DataFrame) -> list[str]:
        page = report_page(replace(results, runs=runs), animation)
        return re.findall(r"<li><b>(.*?)</b><span>(.*?)</span></li>", page)

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


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0, "0.000"), (0.0123, "0.012"), (0.456, "0.46"), (12.34, "12.3"), (543.2, "543")],
)
def test_numbers_have_as_many_decimals_as_the_papers(value: float, shown: str) -> None:
    assert number(value) == shown
    assert mean_and_std(value, value)[1] == shown


def test_unknown_numbers_are_a_dash() -> None:
    assert number(np.nan) == "\N{EN DASH}"
    assert mean_and_std(np.nan, np.nan) == ("\N{EN DASH}", "\N{EN DASH}")


def test_provenance_of_several_files_made_at_once_is_shown_once(
    results: Results, animation: Animation
) -> None:
    (entry,) = results.provenance.values()
    other = {**entry, "command": "ssac figures"}
    page = report_page(
        replace(results, provenance={"esim_10": entry, "esim_20": entry, "figures": other}),
        animation,
    )
    assert "<b>esim_10, esim_20</b> <code>ssac tables</code>" in page
    assert "<b>figures</b> <code>ssac figures</code>" in page
    assert "0123456789ab" in page


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
    seed = flight_seed(20.0, 90.0, 0)
    assert [(config.angle_deg, seed) for config, seed in asked] == [(90.0, seed)]
    with pytest.raises(SsacError, match="is a folder: name a file"):
        report_command(folder, tmp_path / "cache", tmp_path)


def _row_order(comparison: pd.DataFrame) -> list[dict[str, float]]:
    """Rows as the page has them: by duration, cell, quantity."""
    quantities = list(dict.fromkeys(comparison["quantity"]))
    place = comparison["quantity"].map(quantities.index)
    keys = ["duration_s", "angle_deg", "t_d_ms", "place"]
    return comparison.assign(place=place).sort_values(keys).to_dict("records")
