"""The report: one complete page, every number from the files, an animation of the estimate."""

import html
import json
import re
import shutil
from unittest.mock import Mock

import pandas as pd
import pytest

from experiments.lab.cache import Cache
from experiments.lab.results import MERGED, Results, csv_text
from experiments.report import report
from experiments.studies import tables
from experiments.studies.ablations import ABLATIONS
from ssac.errors import SsacError
from tests.experiments.reported import FIGURES, METHODS, made_up_runs, write_results
from tests.html_pages import EVIL, check_page


@pytest.fixture(scope="module")
def animation(flight_folder):
    return report.make_animation(flight_folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    # A method of another package is shown like ours.
    write_results(folder, made_up_runs((*METHODS, "speedy"), flights=2))
    return folder


@pytest.fixture(scope="module")
def page(folder, animation):
    return report.report_page(report.read_results(folder), animation)


def test_its_tables_are_those_of_the_readme_and_verdicts_are_marked(page, folder):
    """The content of the tables is tested in `tests/experiments/paper/test_page.py`."""
    one = (folder / "esim_20.provenance.json").read_text()
    merged = f'{{"command": "{MERGED}", "config": {{}}, "shards": [{one}, {one}]}}'
    results, of_shards = (Results(folder, {"runs.provenance.json": of}) for of in (one, merged))
    of_whole = tables.page(results)
    of_both = of_whole.replace("0.2 minutes (3 rec", "0.4 minutes (6 rec")
    assert tables.page(of_shards) == of_both != of_whole
    readme = re.findall(r"^\| (?!--)(.*) \|$", of_whole, re.MULTILINE)
    plain = [re.sub(r"`|\*\*", "", line) for line in readme]
    expected = {tuple(re.sub(r"(?<!\\)\|", " ", line).split()) for line in plain}
    rows = [re.sub("</t[hd]>", " ", row) for row in re.findall(r"<tr>.*?</tr>", page)]
    assert len(rows) > 100
    assert {tuple(html.unescape(re.sub("<.*?>", "", row)).split()) for row in rows} == expected
    assert "speedy t_d [ms]" in page.replace("<code>", "").replace("</code>", "")
    for verdict, count in tables.comparison(results)["verdict"].value_counts().items():
        assert page.count(f'<td class="{verdict}">') == count


@pytest.mark.parametrize(
    ("name", "command", "is_damaged"),
    [
        ("runs.csv", "make tables", False),
        ("esim_20.provenance.json", "make tables", True),
        ("fig4_epipolar.png", "make figures", False),
        ("efficiency.png", "make studies", True),
        ("ablation_window.png", "make ablations", False),
    ],
)
def test_a_missing_or_damaged_file_names_its_command(name, command, is_damaged, folder, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    path = tmp_path / name
    path.write_bytes(b"\xff nonsense") if is_damaged else path.unlink()
    with pytest.raises(SsacError, match=rf"{name}.*: run `{command}`"):
        report.read_results(tmp_path)


def test_what_files_say_cannot_become_html_and_is_shown_once(folder, animation, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    runs = made_up_runs(flights=2)
    runs.loc[0, ["status", "reason"]] = ["crashed", EVIL]
    (tmp_path / "runs.csv").write_text(csv_text(runs))
    entry = json.loads((folder / "esim_20.provenance.json").read_text())
    evil = {"command": EVIL, "config": {EVIL: EVIL}}
    for name, made in (("esim_10", entry), ("figures", evil)):
        (tmp_path / f"{name}.provenance.json").write_text(json.dumps(made))
    page = report.report_page(report.read_results(tmp_path), animation)
    assert "".join(check_page(page).text).count(EVIL) >= 4
    assert "<b>esim_10, esim_20</b> <code>ssac tables</code>" in page
    assert "0123456789ab" in page


def test_the_headline_is_computed():
    runs = made_up_runs(flights=4)
    joint = runs["method"] == "joint"
    runs.loc[joint, ["t_d_error_ms", "r_error_deg", "t_error_deg"]] = [0.0625, 0.25, 0.125]
    compared = pd.DataFrame({"published_mean": [0.5, 0.25] * 2})
    verdicts = ["agrees", "better", "differs", "agrees"]
    compared = compared.assign(quantity="ssac_t_d_error_ms", verdict=verdicts)
    found = report.headline(runs, compared)
    assert (found["best"], found["best_errors"]) == ("joint", [0.0625, 0.25, 0.125])
    assert found["ours"] == runs.loc[runs["method"] == "ssac", "t_d_error_ms"].mean()
    assert (found["published"], found["n_good"], found["n_cells"]) == (0.375, 3, 4)
    # One answered run in four is too few for a method to be called the best.
    runs.loc[joint & (runs["flight"] > 0), "status"] = "search_bound"
    assert report.headline(runs, compared)["best"] not in ("joint", "")


def test_the_command_writes_one_page_that_is_well_formed_and_needs_nothing_else(
    folder, flight_folder, tmp_path, page, monkeypatch
):
    recorded = Mock(return_value=flight_folder)
    monkeypatch.setattr(Cache, "recording_folder", recorded)
    check_page(page)
    n_figures = len(FIGURES) + len(ABLATIONS)
    assert page.count('<img src="data:image/png;base64,') == n_figures
    assert page.count('width="60" height="30"') == n_figures
    out = tmp_path / "new" / "report.html"
    report.report_command(folder, tmp_path / "cache", out)
    assert out.read_text(encoding="utf-8") == page  # the same input gives the same bytes
    ((config, seed),) = (call.args for call in recorded.call_args_list)
    assert (config.angle_deg, seed) == (90.0, report.SEED)
    with pytest.raises(SsacError, match="is a folder: name a file"):
        report.report_command(folder, tmp_path / "cache", tmp_path)


def test_the_player_shows_the_offset_that_was_put_in(animation):
    # About 1 px of noise at 180 px/s is 6 ms for one pair of points, and below 1 ms for hundreds.
    assert animation["estimate"].t_d_s == pytest.approx(report.T_D_S, abs=1e-3)
    off_s = abs(animation["estimate"].t_d_s - report.T_D_S)
    assert animation["errors"]["t_d_error_ms"] == pytest.approx(1e3 * off_s)
    assert animation["errors"]["r_error_deg"] < 2.0  # from the same noise: 1 px is 0.3 deg here
    assert animation["before_px"] > 20.0
    assert animation["after_px"] < 4.0  # the mean of 1000 events over 20 px is good to 1 px
    (pair,) = animation["player"]["pairs"]
    assert animation["player"]["tour"]
    assert (pair["before"], pair["found"]) == (0.0, animation["estimate"].t_d_s)
