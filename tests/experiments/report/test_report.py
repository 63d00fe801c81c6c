"""The report: one whole page, every number from the files; its animation is what was estimated."""

import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.lab.cache import Cache
from experiments.report import report
from experiments.report.animation import (
    CAMERA_RGB,
    HALF_WINDOW_S,
    LENGTH_S,
    T_D_S,
    TRACK_STEP_S,
    TRAIL_S,
    Animation,
    View,
    event_image,
    make_animation,
    packed_events,
    player_json,
    still_view,
    stills,
)
from experiments.report.data import Results, load_results
from experiments.report.report import report_command, report_page
from experiments.report.tables import number
from experiments.studies.ablations import ABLATIONS
from experiments.studies.figures import DRAWINGS
from sim.errors import SimError
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE
from ssac.files.hdf5 import load_events_h5, save_events_h5
from tests.experiments.reported import METHODS, made_up_runs, record_flight, write_results
from tests.ssac.synthetic import HEIGHT, WIDTH, K

VOID = {"meta", "link", "img", "br", "input"}
PAGE = Path(report.__file__).parent / "page"
TICKS = 1 << 13
EVIL = "</script><script>alert('x')</script>&"


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
    reader = Reader(page)
    assert len(set(reader.ids)) == len(reader.ids)
    assert reader.addresses
    assert all(address.startswith("data:") for address in reader.addresses)
    assert "default-src 'none'" in page
    style, script, html = (
        PAGE.joinpath(name).read_text() for name in ("report.css", "player.js", "report.html")
    )
    for word in ("@import", "url(", "http:", "https:", "fetch(", "XMLHttpRequest", "import("):
        assert word not in style + script
    # All parts that the script looks for are there.
    named = set(re.findall(r'find\("(\w+)"\)', script)) | {"view1", "view2", "clock1", "clock2"}
    assert named == set(re.findall(r'data-part="(\w+)"', html))
    # The same input gives the same bytes.
    assert report_page(load_results(folder), make_animation(flight)) == page


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_script_can_be_parsed() -> None:
    subprocess.run(["node", "--check", str(PAGE / "player.js")], check=True)


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
    n_figures = len(DRAWINGS) + len(ABLATIONS)  # which their studies draw
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
    assert "alert('x')" not in page
    assert "".join(Reader(page).text).count(EVIL) >= 4
    assert page.count("<script") == 2
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


def test_the_offset_that_was_put_in_is_found(animation: Animation) -> None:
    # The synthetic tracks have about 1 px of noise at 180 px/s: 6 ms in one pair, 1 ms in hundreds.
    assert animation.t_d_s == pytest.approx(T_D_S, abs=1e-3)
    assert animation.errors.t_d_error_ms == pytest.approx(1e3 * abs(animation.t_d_s - T_D_S))
    assert animation.errors.r_error_deg < 2.0  # of the same cause: 1 px is 0.3 deg here
    least_s = animation.offsets_s[np.nanargmin(animation.curve_px)]
    assert least_s == pytest.approx(animation.t_d_s, abs=5e-3)  # one step of the curve
    assert animation.offsets_s[[0, -1]] == pytest.approx([0.0, 2.0 * T_D_S])
    assert len(animation.curve_points.split()) == len(animation.offsets_s)
    times_s = np.arange(0.0, LENGTH_S, TRACK_STEP_S)
    seen = [np.isfinite(animation.distance_px(t, animation.t_d_s)) for t in times_s]
    assert np.mean(seen) > 0.8  # the scene is in both views 94 % of the time


def test_stills_show_the_drone_off_the_line_before_and_on_it_after(animation: Animation) -> None:
    before, after = stills(animation)
    assert (before["offset_s"], after["offset_s"]) == (0.0, animation.t_d_s)
    assert before["distance_px"] > 20.0
    # The tracks' noise: 1000 events over a cloud 20 px wide make a mean that is good to 1 px.
    assert after["distance_px"] < 4.0
    for still in (before, after):
        assert all(png.startswith(b"\x89PNG") for png, _, _ in still["views"])
        _, line, gap = still_view(animation, 0, animation.telling_time_s, still["offset_s"])
        along, to_foot = line[2:] - line[:2], gap[2:] - line[:2]
        off_px = abs(along[0] * to_foot[1] - along[1] * to_foot[0]) / np.linalg.norm(along)
        assert off_px < 1e-6  # rounding, over a line of some 1000 px
        assert np.linalg.norm(gap[2:] - gap[:2]) == pytest.approx(still["distance_px"], abs=1e-9)


def test_the_plan_shows_the_drone_where_the_camera_sees_it(animation: Animation) -> None:
    """Bearing x / z in camera 1, by the truth from above and by the track of its events."""
    plan, track_px = animation.plan, animation.views[0].track_px
    np.testing.assert_allclose(plan.sights[0], [0.0, 1.0], atol=1e-12)
    bearings = (track_px[:, 0] - K[0, 2]) / K[0, 0]
    skip = round(T_D_S / TRACK_STEP_S)  # the path starts earlier, for what camera 2 shows
    from_cam1 = plan.path_m[skip : skip + len(bearings)] - plan.cameras_m[0]
    expected = from_cam1[:, 0] / from_cam1[:, 1]
    assert np.nanmax(np.abs(bearings - expected)) < 0.03  # 6 px: the mean of a tumbling cloud
    # Both sights meet in the point that both cameras look at.
    np.testing.assert_allclose(*(plan.cameras_m + 5.0 * plan.sights), atol=1e-9)


def test_thinning_keeps_the_last_event_of_a_pixel(animation: Animation, flight: Path) -> None:
    view = animation.views[0]
    events = load_events_h5(flight / "cam1.h5").events
    times_us = np.rint((view.times_s + animation.start_s) * 1e6).astype(np.int64)
    assert (np.diff(times_us) >= 0).all()
    all_of = {(t, x, y) for t, x, y in zip(events["t"], events["x"], events["y"], strict=True)}
    kept = list(zip(times_us, view.events["x"], view.events["y"], strict=True))
    assert set(kept) <= all_of
    moments = {(t // 10_000, x, y) for t, x, y in kept}
    assert len(moments) == len(kept)
    first, last = times_us[0], times_us[-1]
    whole = {(t // 10_000, x, y) for t, x, y in all_of if first <= t <= last}
    assert moments == whole
    assert first >= 1e6 * (animation.start_s - TRAIL_S) - 1
    assert last <= 1e6 * (animation.start_s + LENGTH_S + HALF_WINDOW_S) + 1


def made_view(times_s: list[float], **events: Any) -> View:
    made = np.zeros(len(times_s), EVENT_DTYPE)
    for field, values in events.items():
        made[field] = values
    return View(np.array(times_s), made, np.zeros((201, 2)))  # of 2 s


def test_an_event_that_rounding_puts_beyond_an_end_is_packed_at_it() -> None:
    view = made_view([-TRAIL_S - 1e-12, 2.0 + HALF_WINDOW_S + 1e-12])
    first, last = np.frombuffer(packed_events(view), "<u4") >> 19
    assert (first, last) == (0, 8191)


def test_the_json_is_safe_in_a_script_and_small_and_its_events_come_back(
    animation: Animation,
) -> None:
    text = player_json(animation)
    assert "<" not in text
    assert len(text) < 3e6
    views = json.loads(text)["views"]
    assert len(views[1]["track"]) - len(views[0]["track"]) == round(2.0 * T_D_S / TRACK_STEP_S)
    for view, content in zip(animation.views, views, strict=True):
        words = np.frombuffer(base64.b64decode(content["events"]), "<u4")
        np.testing.assert_array_equal(words & 511, view.events["x"])
        np.testing.assert_array_equal(words >> 9 & 511, view.events["y"])
        np.testing.assert_array_equal(words >> 18 & 1, view.events["p"] > 0)
        tick_s = (TRAIL_S + content["end"] + HALF_WINDOW_S) / TICKS
        late_s = view.times_s - ((words >> 19) * tick_s - TRAIL_S)
        assert (late_s >= 0.0).all()
        assert late_s.max() < tick_s * 1.001  # rounding of a product
    with pytest.raises(SimError, match=r"at most 512 px, got 640 x 480"):
        player_json(replace(animation, width=640, height=480))


def test_the_newest_event_of_a_pixel_is_drawn(animation: Animation) -> None:
    view = made_view([1.0, 1.1, 1.3, 2.0], x=[7, 7, 8, 9], y=5, p=[1, 0, 1, 1])
    made = replace(animation, views=(view, view))
    image = event_image(made, 0, 1.1)
    (bright, dark) = CAMERA_RGB[0]
    assert tuple(image[5, 7]) == (*dark[::-1], 255)
    assert not image[5, 8:].any()  # they are still to come
    faded = event_image(made, 0, 1.4)
    assert 0 < faded[5, 7, 3] < faded[5, 8, 3] < 255
    assert tuple(faded[5, 8, :3]) == bright[::-1]


def test_a_recording_that_is_short_or_gives_no_estimate_is_refused(
    flight: Path, tmp_path: Path
) -> None:
    record_flight(tmp_path / "short", duration_s=5.0)
    with pytest.raises(SimError, match="simulate a longer one"):
        make_animation(tmp_path / "short")
    shutil.copytree(flight, tmp_path / "few")
    events = load_events_h5(flight / "cam2.h5").events
    save_events_h5(tmp_path / "few" / "cam2.h5", events[: len(events) // 40], WIDTH, HEIGHT)
    with pytest.raises(SimError, match="tangency can synchronise, got"):
        make_animation(tmp_path / "few")
