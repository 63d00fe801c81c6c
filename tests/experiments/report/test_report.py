"""The report: one whole page, every number from the files; its animation is what was estimated."""

import base64
import json
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
from experiments.report.animation import (
    HALF_WINDOW_S,
    LENGTH_S,
    T_D_S,
    TRACK_STEP_S,
    TRAIL_S,
    Animation,
    View,
    make_animation,
)
from experiments.report.data import Results, load_results
from experiments.report.player import (
    CAMERA_RGB,
    curve_points,
    event_image,
    packed_events,
    player_json,
    still_view,
    stills,
)
from experiments.report.report import report_command, report_page
from experiments.report.tables import mean_and_std, number
from experiments.studies.ablations import ABLATIONS
from experiments.studies.figures import DRAWINGS
from sim.errors import SimError
from ssac.errors import SsacError
from ssac.files.hdf5 import load_events_h5, save_events_h5
from tests.experiments.reported import METHODS, made_up_runs, record_flight, write_results
from tests.ssac.synthetic import HEIGHT, WIDTH, K

VOID = {"meta", "link", "img", "br", "input"}
PAGE = Path(report.__file__).parent / "page"
TICKS = 1 << 13


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
    [
        (0.0, "0.000"),
        (0.0123, "0.012"),
        (0.456, "0.46"),
        (12.34, "12.3"),
        (543.2, "543"),
        (np.nan, "\N{EN DASH}"),
    ],
)
def test_numbers_have_as_many_decimals_as_the_papers(value: float, shown: str) -> None:
    assert number(value) == shown
    assert mean_and_std(value, value)[1] == shown


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


def test_the_offset_that_was_put_in_is_found(animation: Animation) -> None:
    # The synthetic tracks have about 1 px of noise at 180 px/s: 6 ms in one pair, 1 ms in hundreds.
    assert animation.t_d_s == pytest.approx(T_D_S, abs=1e-3)
    assert animation.errors.t_d_error_ms == pytest.approx(1e3 * abs(animation.t_d_s - T_D_S))
    assert animation.errors.r_error_deg < 2.0  # of the same cause: 1 px is 0.3 deg here


def test_the_curve_has_its_minimum_at_the_offset_found(animation: Animation) -> None:
    least_s = animation.offsets_s[np.nanargmin(animation.curve_px)]
    assert least_s == pytest.approx(animation.t_d_s, abs=5e-3)  # one step of the curve
    assert animation.offsets_s[[0, -1]] == pytest.approx([0.0, 2.0 * T_D_S])
    assert len(curve_points(animation).split()) == len(animation.offsets_s)


def test_the_drone_is_off_the_line_before_and_on_it_after(animation: Animation) -> None:
    time_s = animation.telling_time_s
    assert animation.distance_px(time_s, 0.0) > 20.0
    # The tracks' noise: 1000 events over a cloud 20 px wide make a mean that is good to 1 px.
    assert animation.distance_px(time_s, animation.t_d_s) < 4.0


def test_the_stretch_is_one_that_both_cameras_see(animation: Animation) -> None:
    times_s = np.arange(0.0, LENGTH_S, TRACK_STEP_S)
    seen = [np.isfinite(animation.distance_px(t, animation.t_d_s)) for t in times_s]
    assert np.mean(seen) > 0.8  # the scene is in both views 94 % of the time


def test_the_plan_shows_the_drone_where_the_camera_sees_it(animation: Animation) -> None:
    """Bearing x / z in camera 1, by the truth from above and by the track of its events."""
    plan, track_px = animation.plan, animation.views[0].track_px
    np.testing.assert_allclose(plan.sights[0], [0.0, 1.0], atol=1e-12)
    bearings = (track_px[:, 0] - K[0, 2]) / K[0, 0]
    skip = round(T_D_S / TRACK_STEP_S)  # the path starts earlier, for what camera 2 shows
    from_cam1 = plan.path_m[skip : skip + len(bearings)] - plan.cameras_m[0]
    expected = from_cam1[:, 0] / from_cam1[:, 1]
    assert np.nanmax(np.abs(bearings - expected)) < 0.03  # 6 px: the mean of a tumbling cloud


def test_both_sights_meet_in_the_point_that_both_cameras_look_at(animation: Animation) -> None:
    plan = animation.plan
    np.testing.assert_allclose(*(plan.cameras_m + 5.0 * plan.sights), atol=1e-9)


def test_thinning_keeps_the_last_event_of_a_pixel(animation: Animation, flight: Path) -> None:
    view = animation.views[0]
    events = load_events_h5(flight / "cam1.h5").events
    times_us = np.rint((view.times_s + animation.start_s) * 1e6).astype(np.int64)
    assert (np.diff(times_us) >= 0).all()
    all_of = {(t, x, y) for t, x, y in zip(events["t"], events["x"], events["y"], strict=True)}
    kept = list(zip(times_us, view.x_px, view.y_px, strict=True))
    assert set(kept) <= all_of
    moments = {(t // 10_000, x, y) for t, x, y in kept}
    assert len(moments) == len(kept)
    first, last = times_us[0], times_us[-1]
    whole = {(t // 10_000, x, y) for t, x, y in all_of if first <= t <= last}
    assert moments == whole
    assert first >= 1e6 * (animation.start_s - TRAIL_S) - 1
    assert last <= 1e6 * (animation.start_s + LENGTH_S + HALF_WINDOW_S) + 1


def test_an_event_that_rounding_puts_beyond_an_end_is_packed_at_it() -> None:
    ends_s = np.array([-TRAIL_S - 1e-12, 2.0 + HALF_WINDOW_S + 1e-12])
    nowhere = np.zeros(2, np.uint16)
    view = View(ends_s, nowhere, nowhere, np.zeros(2, bool), np.zeros((1, 2)))
    first, last = np.frombuffer(packed_events(view, 2.0), "<u4") >> 19
    assert (first, last) == (0, 8191)


@pytest.mark.parametrize("camera", [0, 1])
def test_packed_events_come_back(animation: Animation, camera: int) -> None:
    view = animation.views[camera]
    content = json.loads(player_json(animation))["views"][camera]
    end_s = content["end"]
    data = base64.b64decode(content["events"])
    assert data == packed_events(view, end_s)
    words = np.frombuffer(data, "<u4")
    np.testing.assert_array_equal(words & 511, view.x_px)
    np.testing.assert_array_equal(words >> 9 & 511, view.y_px)
    np.testing.assert_array_equal(words >> 18 & 1, view.brighter)
    tick_s = (TRAIL_S + end_s + HALF_WINDOW_S) / TICKS
    times_s = (words >> 19) * tick_s - TRAIL_S
    assert (view.times_s - times_s >= 0.0).all()
    assert (view.times_s - times_s).max() < tick_s * 1.001  # rounding of a product


def test_the_json_is_safe_in_a_script_and_small(animation: Animation) -> None:
    text = player_json(animation)
    assert "<" not in text
    assert len(text) < 3e6
    assert text == player_json(animation)
    tracks = [view["track"] for view in json.loads(text)["views"]]
    assert len(tracks[1]) - len(tracks[0]) == round(2.0 * T_D_S / TRACK_STEP_S)


def test_the_newest_event_of_a_pixel_is_drawn(animation: Animation) -> None:
    view = replace(
        animation.views[0],
        times_s=np.array([1.0, 1.1, 1.3, 2.0]),
        x_px=np.array([7, 7, 8, 9], np.uint16),
        y_px=np.array([5, 5, 5, 5], np.uint16),
        brighter=np.array([True, False, True, True]),
    )
    image = event_image(replace(animation, views=(view, view)), 0, 1.1)
    (bright, dark) = CAMERA_RGB[0]
    assert tuple(image[5, 7]) == (*dark[::-1], 255)
    assert not image[5, 8:].any()  # they are still to come
    faded = event_image(replace(animation, views=(view, view)), 0, 1.4)
    assert 0 < faded[5, 7, 3] < faded[5, 8, 3] < 255
    assert tuple(faded[5, 8, :3]) == bright[::-1]


@pytest.mark.parametrize("offset_s", [0.0, T_D_S])
def test_the_gap_in_a_still_ends_on_the_line(animation: Animation, offset_s: float) -> None:
    time_s = animation.telling_time_s
    view = still_view(animation, 0, time_s, offset_s)
    line, gap = view.line, view.gap
    along, to_foot = line[2:] - line[:2], gap[2:] - line[:2]
    off_px = abs(along[0] * to_foot[1] - along[1] * to_foot[0]) / np.linalg.norm(along)
    assert off_px < 1e-6  # rounding, over a line of some 1000 px
    length_px = np.linalg.norm(gap[2:] - gap[:2])
    assert length_px == pytest.approx(animation.distance_px(time_s, offset_s), abs=1e-9)


def test_stills_show_both_cameras_before_and_after(animation: Animation) -> None:
    before, after = stills(animation)
    assert (before.offset_s, after.offset_s) == (0.0, animation.t_d_s)
    assert before.distance_px > after.distance_px
    assert all(view.png.startswith(b"\x89PNG") for view in (*before.views, *after.views))


def test_the_image_may_not_be_too_large_to_pack(animation: Animation) -> None:
    with pytest.raises(SimError, match=r"at most 512 px, got 640 x 480"):
        player_json(replace(animation, width=640, height=480))


def test_a_short_recording_is_refused(tmp_path: Path) -> None:
    record_flight(tmp_path, duration_s=5.0)
    with pytest.raises(SimError, match="simulate a longer one"):
        make_animation(tmp_path)


def test_a_recording_without_an_estimate_is_refused(flight: Path, tmp_path: Path) -> None:
    shutil.copytree(flight, tmp_path, dirs_exist_ok=True)
    events = load_events_h5(flight / "cam2.h5").events
    save_events_h5(tmp_path / "cam2.h5", events[: len(events) // 40], WIDTH, HEIGHT)
    with pytest.raises(SimError, match="tangency can synchronise, got"):
        make_animation(tmp_path)
