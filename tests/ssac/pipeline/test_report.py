"""Reports of an answer: text and JSON, figures, and the HTML page."""

import base64
import json
import pickle
import re
import zlib
from dataclasses import replace
from html import unescape
from urllib.parse import unquote

import cv2
import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure

import ssac
from ssac import ClockJump, Estimate, PointTrack, SsacError, Status
from ssac.camera import Camera, distort_points
from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import save_track
from ssac.files.whole_file import FIGURE_SUFFIXES
from ssac.geometry.epipolar import fundamental_from_pose
from ssac.geometry.pose import moved_pose
from ssac.pipeline import pair_charts, plots
from ssac.pipeline.html_report import report_page, seen_by
from ssac.pipeline.many import write_two
from ssac.pipeline.opened import NOTHING, opened, opened_rig
from ssac.pipeline.registry import METHODS
from ssac.pipeline.report import report_json, report_rows
from ssac.pipeline.retries import TINY
from ssac.pipeline.streams import scene_of_two, streams
from ssac.search.all_offsets import AllOffsets, Guess
from ssac.search.start import Start
from ssac.track.clean import ObjectsUsed
from ssac.track.denoise import Clutter
from tests.html_pages import EVIL, check_page
from tests.ssac.cluttered import noise
from tests.ssac.command import run
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_scene, track_pair
from tests.ssac.tracks import frame_track, frame_tracks


@pytest.fixture(scope="module")
def answer(recorded):
    return ssac.sync(*recorded.pair, recorded / "rig.yaml", "ssac").answer


@pytest.fixture(scope="module")
def result(recorded):
    return ssac.sync(*recorded.pair, recorded / "rig.yaml")


def changed(answer, **changes):
    return replace(answer, estimate=replace(answer.estimate, **changes))


def told(answer, **changes):
    """Return the text and the JSON report of an answer whose estimate is changed."""
    other = changed(answer, **changes)
    return ssac.Result(other).summary(), report_json(other)


def used(answer, *objects):
    pairs = zip(answer.cleans, objects, strict=True)
    return replace(answer, cleans=tuple(replace(seen, used=said) for seen, said in pairs))


NO_POSE = {"reason": "so it is", "R": None, "t": None}


def test_an_offset_is_explained_where_it_holds_alone(answer):
    others_s, direction = np.array([-0.75, 0.85]), np.eye(6)[[5]]
    text, report = told(answer, status="ambiguous_offset", alternatives_s=others_s, **NO_POSE)
    assert text.startswith("no estimate    ambiguous_offset: so it is\nnot reliable   t_d = ")
    assert "or             t_d = -750, 850 ms" in text
    assert "camera 2's clock" not in text
    assert report["alternatives_s"] == [-0.75, 0.85]
    assert report["t_d_is_reliable"] is False
    text, report = told(answer, status="degenerate_pose", unobservable=direction, **NO_POSE)
    assert text.startswith("no pose        degenerate_pose: so it is\ntime offset    t_d = ")
    assert "camera 2's clock shows" in text
    assert "rotation" not in text
    by_sign = "less than camera 1's; add it to", "more than camera 1's; subtract it from"
    for t_d_s, words in zip((-0.05, 0.05), by_sign, strict=True):
        text, _ = told(answer, t_d_s=t_d_s, t_d_std_s=1e-3)
        assert f"shows 50.000 ms {words} camera 2's timestamps" in " ".join(text.split())
    assert report["t_d_is_reliable"] is True
    assert report["unobservable"] == direction.tolist()


def test_clocks_are_told(answer, tmp_path):
    plain = report_json(answer)
    names = ("t_ref_s", "skew_ppm", "skew_std_ppm", "clock_covariance", "clock_jump")
    assert [plain[name] for name in names] == [None] * 5  # the paper's method has no skew
    assert plain["clock_knots"] == []
    clock = {"t_ref_s": 5.0, "skew_ppm": -400.0, "skew_std_ppm": 2.5}
    strays_s = np.array([0.001, -0.002, 0.001])
    knots = {"knots_s": np.array([0.0, 5.0, 10.0]), "strays_std_s": np.full(3, 1e-4)}
    text, report = told(answer, strays_s=strays_s, **clock, **knots)
    assert "clock skew     -400.0 ppm, 1 sigma 2.5 ppm\n" in text
    assert "for a straight line, from which it strays by up to 2.000 ms, and by\n" in text
    assert "-2.000 ms at that time: 3 knots\n" in text
    rig = tmp_path / "rig.yaml"
    wandering = changed(answer, strays_s=strays_s, **clock, **knots)
    write_two(wandering, NOTHING, None, rig, str)
    shift_s = yaml.safe_load(rig.read_text())["cam1"]["timeshift_cn_cnm1"]
    assert shift_s == pytest.approx(wandering.estimate.t_d_s - 0.002)  # what the clock shows then
    assert "far beyond the 50 ppm expected of such clocks: see --skew-prior\n" in text
    assert {name: report[name] for name in clock} == clock
    assert report["clock_knots"][1] == {"t_s": 5.0, "stray_s": -0.002, "std_s": 1e-4}
    jump = ClockJump(3.0, 0.02, np.nan, 0.05, 0.07)  # a large jump's size has no deviation
    jumping = replace(answer, estimate=Estimate("joint", "clock_jump", "so it is", jump=jump))
    assert ssac.Result(jumping).summary().startswith("no estimate    clock_jump: so")
    report = report_json(jumping)
    assert report["clock_jump"] == vars(jump) | {"size_std_s": None}
    assert (report["t_d_s"], report["t_d_is_reliable"]) == (None, False)


def test_a_skew_is_a_finding_beyond_one_deviation_and_where_it_is_not_of_its_prior(answer):
    for skew_ppm, words in (
        (-20.0, "the clocks run alike, as far as this tells"),
        (-20.1, "camera 2's clock runs slow"),
        (20.1, "camera 2's clock runs fast"),
    ):
        text, _ = told(answer, t_ref_s=5.0, skew_ppm=skew_ppm, skew_std_ppm=20.0)
        assert f"\n               {words}; t_d holds at 5.000 s of camera 1's\n" in text
    assumed = "rather taken to be within 50 ppm than found: see --skew-prior"
    # If the rate was searched for, the prior is centred on the rate found, and says nothing of it.
    for std_ppm, rate, is_assumed in (  # 50 / sqrt(2)
        *((35.0, rate, False) for rate in (None, 1.0, 0.7)),
        *((36.0, rate, rate != 0.7) for rate in (None, 1.0, 0.7)),
    ):
        guesses = [Guess(0.05, 5.0, rate, 1.0)]
        start = Start(AllOffsets(np.zeros(1), np.zeros(1), guesses, 0.02)) if rate else None
        other = replace(answer, start=start)
        text, _ = told(other, t_ref_s=5.0, skew_ppm=8.0, skew_std_ppm=std_ppm)
        assert (assumed in text) is is_assumed


def test_every_line_fits_a_screen(answer):
    reason = "other offsets fit about as well: " * 9
    text, _ = told(answer, status="ambiguous_offset", reason=reason, R=None, t=None)
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    assert [line[:15].strip() for line in lines[:3]] == ["no estimate", "", ""]
    assert " ".join(line[15:] for line in lines).count("other offsets fit about as well:") == 9


def test_a_search_of_all_offsets_without_an_answer_is_said_to_be_of_all():
    """Bug: it was half a second around the best of them."""
    (one, _), (_, other) = (frame_tracks(make_scene(k, duration_s=8.0), 30.0) for k in (0, 1))
    refused = ssac.sync(one, other, [Camera(K, WIDTH, HEIGHT)] * 2).answer
    assert not refused.estimate.has_offset
    low_s, high_s = report_json(refused)["search_s"]
    assert 22.0 < low_s < 27.0  # some common time of the 8 s is needed
    assert 33.0 < high_s < 38.0
    none = replace(refused, start=Start(AllOffsets(np.empty(0), np.empty(0), [], 0.0)))
    assert report_json(none)["search_s"] == list(refused.config.interval_s)


def test_clutter_is_told(answer):
    assert "clutter" not in ssac.Result(answer).summary()
    plain = report_json(answer)["clutter"]
    assert [camera["masked_pixels"] for camera in plain] == [0, 0]
    assert [(camera["n_neighbours"], camera["n_min"]) for camera in plain] == [(20, 200)] * 2
    one, other = answer.cleans
    lamp = replace(one, clutter=Clutter(36, 7200, 0.2, 5.0, 20, 200))
    noisy = replace(other, clutter=Clutter(0, 0, 9.8, 3.0, 12, 150))
    rows = report_rows(replace(answer, cleans=(lamp, noisy)))
    needed = "12 others within 3 px, ms, and a position 150 events"
    assert [value for name, value in rows if name == "clutter"] == [
        "camera 1: 36 px that fire by themselves masked (7200 events)",
        f"camera 2: with a background of 9.8 Hz/px an event needs {needed}",
    ]
    held = np.arange(len(one.events)) % 10 == 0
    said = f"a line that holds the object is seen, and no part of its outline ({held.sum()} events)"
    rows = report_rows(replace(answer, cleans=(replace(one, on_line=held), other)))
    assert ("clutter", f"camera 1: {said}") in rows
    config = replace(answer.config, n_min=30)
    found = report_json(replace(answer, cleans=(one, noisy), config=config))["clutter"][1]
    assert found == {
        "masked_pixels": 0, "masked_events": 0, "background_hz": 9.8, "radius_px": 3.0,
        "n_neighbours": 12, "n_min": 30,
    }  # fmt: skip


def test_a_start_that_is_the_answer_is_called_so(result):
    assert "tangents to the outline" in ssac.Result(result.answer).summary()
    text = ssac.Result(replace(result.answer, of_start=TINY)).summary()
    assert "note           the object is too small for an outline" in text
    assert "pairs of positions used, of 400 sample times" in text


def test_several_things_are_told(answer):
    assert report_json(answer)["objects"] == [{"seen": 1, "share": 1.0}] * 2
    assert "objects" not in ssac.Result(answer).summary()
    crowded = used(answer, ObjectsUsed(3, 0.25), ObjectsUsed(1, 1.0))
    row = "objects        camera 1 sees 3, 25 % of its events used; camera 2 sees 1, 100 % of"
    assert row in ssac.Result(crowded).summary()
    assert report_json(crowded)["objects"][0] == {"seen": 3, "share": 0.25}
    refused = used(answer, ObjectsUsed(3, 0.0), ObjectsUsed(2, 0.0))
    assert "objects        camera 1 sees 3; camera 2 sees 2\n" in ssac.Result(refused).summary()
    # A method that does not select an object reports no objects.
    assert report_json(replace(answer, method=METHODS["albl"]))["objects"] is None


# --- Figures ---


def test_a_folder_gets_one_picture_per_figure_and_a_page_all_of_them(result, tmp_path, monkeypatch):
    monkeypatch.setattr("ssac.pipeline.plots._DPI", 40)  # drawn in a third of the time
    written = result.plotted(tmp_path / "new" / "figures")
    assert [path.name for path in written] == ["d_avg.png", "epipolar.png"]
    figures = [cv2.imread(str(path)) for path in written]
    assert min(map(np.std, figures)) > 10.0  # not blank
    with pytest.raises(SsacError, match=r"page\.gif: cannot write the extension '\.gif'"):
        result.plot(tmp_path / "page.gif")
    assert isinstance(result.plot(tmp_path / "page.png"), Figure)
    height, width, _ = cv2.imread(str(tmp_path / "page.png")).shape
    assert (height, width) == (sum(len(figure) for figure in figures), figures[0].shape[1])


def test_without_a_pose_there_is_the_curve_alone_and_of_nothing_no_picture(result, tmp_path):
    costs = {"candidates_s": np.linspace(-1, 1, 9), "costs": -np.cos(np.linspace(-1, 1, 9))}
    found = Estimate("albl", "too_few_samples", "few"), Estimate("zncc_e", t_d_s=0.0, **costs)
    refused, curve = (replace(result, answer=replace(result.answer, estimate=one)) for one in found)
    assert refused.plotted(tmp_path / "page.png") == []
    assert refused.plot() is None
    assert not list(tmp_path.iterdir())
    assert curve.plotted(tmp_path) == [tmp_path / "d_avg.png"]
    for file in (tmp_path / f"page{suffix}" for suffix in FIGURE_SUFFIXES):
        assert curve.plotted(file) == [file]
        assert file.stat().st_size > 1000


@pytest.mark.parametrize(("t_d_s", "n_rows"), [(-1.7, 2), (0.0, 1)])
def test_odd_offsets_can_be_drawn(t_d_s, n_rows, result):
    """At 0 there is no row for "before"; at -1.7 s the recordings overlap only in part."""
    search, epipolar = replace(result, answer=changed(result.answer, t_d_s=t_d_s)).plot().subfigs
    assert [len(part.axes) for part in (search, epipolar)] == [2, 2 * n_rows]
    assert all(axes.collections for axes in epipolar.axes)


def test_what_is_drawn_is_the_search(result):
    search = Figure()
    plots.draw_search(search, result.answer)
    whole, zoom = search.axes
    assert np.array_equal(whole.lines[0].get_data(), (result.candidates_s, result.costs))
    near_ms, d_avg_px = zoom.lines[0].get_data()
    np.testing.assert_allclose(near_ms[[0, -1]], [-1e3 * plots.ZOOM_S, 1e3 * plots.ZOOM_S])
    # Tangents give the estimate, means the curve: on these random pixels they differ by some 1 ms.
    assert abs(near_ms[np.argmin(d_avg_px)]) < 2.0


def test_one_point_has_one_plane_angle_in_both_views(recorded, result):
    scene = recorded.scene
    exact = changed(result.answer, R=scene.R, t=scene.t / np.linalg.norm(scene.t))
    p1, p2 = track_pair(scene, np.linspace(0.5, 7.5, 50))
    angles_1, angles_2 = plots.plane_angles(exact, 0, p1), plots.plane_angles(exact, 1, p2)
    np.testing.assert_allclose(angles_1, angles_2, atol=1e-9)
    assert np.ptp(angles_1) > 5.0


# --- The page ---

BOTH = (0, 1)


def laid_out(answer):
    return streams({BOTH: answer}, seen_by({BOTH: answer}))


def unpacked(text, dtype):
    """Decode an array of numbers (n,) as the player does."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    size = np.dtype(dtype).itemsize
    return np.ascontiguousarray(planes.reshape(size, -1).T).view(dtype).ravel()


def events_of(view):
    """Return the frames, x, y [px] and polarities, each (n,), of a view's events."""
    counts, steps = unpacked(view["counts"], "<u4"), unpacked(view["events"], "<u4")
    cells = np.concatenate(
        [np.cumsum(part >> 1) for part in np.split(steps, np.cumsum(counts)[:-1])]
    )
    y, x = np.divmod(cells, view["columns"])
    frames = np.repeat(np.arange(len(counts)), counts)
    middle = 0.5 * view["cell"]
    x_px, y_px = view["left"] + view["cell"] * x, view["top"] + view["cell"] * y
    return frames, x_px + middle, y_px + middle, steps & 1


def page_of(answer, summary=(), command=""):
    return report_page({BOTH: answer}, None, summary, command)


def test_the_page_says_what_was_found(result):
    page = page_of(result.answer, report_rows(result.answer), "ssac sync 'my cam1.h5'")
    text = "".join(check_page(page).text)
    said = f"{1e3 * result.t_d_s:.3f}\N{NO-BREAK SPACE}ms"
    assert f"Camera 2's clock is {said} ahead of camera 1's" in text
    low, high = (1e3 * (result.t_d_s + side * 1.96 * result.t_d_std_s) for side in (-1, 1))
    assert f"95 % interval {low:.3f} to {high:.3f} ms; 1 sigma" in text
    assert all(value in text for _, value in report_rows(result.answer))
    for words in ("ssac sync 'my cam1.h5'", "numpy", "Reliable", "Residuals over time"):
        assert words in text
    assert page_of(result.answer, report_rows(result.answer), "ssac sync 'my cam1.h5'") == page


def test_page_terminal_and_json_say_the_same_of_length_and_skew(result):
    skewed = changed(result.answer, t_ref_s=2.5, skew_ppm=8.8, skew_std_ppm=52.0)
    near = replace(skewed, distance_m=7.07)
    for answer, words in ((result.answer, "of unknown length"), (near, "7.07 m long as stated")):
        text = "".join(check_page(page_of(answer)).text)
        assert (words in text, words in ssac.Result(answer).summary()) == (True, True)
    vector = ", ".join(f"{value:.4f}" for value in 7.07 * result.t)
    assert f"t = ({vector}) m, 7.07 m long as stated" in ssac.Result(near).summary()
    assert "camera 2 lies at (" in ssac.Result(near).summary()
    report = report_json(near)
    assert (report["distance_m"], report["t"]) == (7.07, result.t.tolist())
    unsure = "".join(check_page(page_of(changed(near, covariance=None))).text)
    assert "7.07 m long as stated, of unknown accuracy" in unsure
    assert text.count("the clocks run alike, as far as this tells") == 1  # the last is near's
    assert "runs fast" not in text
    # A rate that was searched, of clocks whose skew has a prior of 0, has no deviation.
    searched = changed(result.answer, t_ref_s=2.5, skew_ppm=8.8, skew_std_ppm=0.0)
    for text in (page_of(searched), ssac.Result(searched).summary()):
        assert "+8.8 ppm" in text
        assert "camera 2's clock runs fast" in unescape(text)
        assert "1 sigma 0.0 ppm" not in text


def test_a_charts_numbers_and_images_stand_as_they_were_drawn(result):
    """Bug: the tick 0.25 lost its last digit, and the image of all events was too small."""
    charts = []
    with pair_charts._chart(charts, "", "") as axes:
        axes.plot([0.0, 1.0], [0.0, 1 / 3])
        axes.set_yticks([0.25, 0.75])
    svg = unquote(charts[0].svg)
    assert all(f">{tick}</text>" in svg for tick in (0.25, 0.75))
    assert not re.search(r' d="[^"]*\.\d\d', svg)  # coordinates have one decimal at most
    image = unquote(pair_charts.sample_charts(seen_by({BOTH: result.answer}), 100)[-1].svg)
    assert re.search(r"matrix\(\d\.\d{3}", image)


def test_nothing_that_files_say_becomes_html(result):
    cleans = tuple(replace(one, name=f"{EVIL}{k}") for k, one in enumerate(result.answer.cleans))
    answer = replace(result.answer, cleans=cleans, rig_name=EVIL)
    answer = changed(answer, status=Status.NO_MATCH, reason=EVIL)
    text = "".join(check_page(page_of(answer, [("note", EVIL)], EVIL)).text)
    assert text.count(EVIL) >= 7  # twice each file, rig, reason, summary, command


def test_a_refusal_has_a_page_that_says_what_to_do_and_with_f_what_was_tried(result):
    no_offset, no_curve = {"t_d_s": np.nan}, {"costs": np.empty(0)}
    for status, less in (
        (Status.NO_MATCH, no_offset | no_curve | {"F": None}),
        (Status.DEGENERATE_POSE, no_curve),
        (Status.POOR_FIT, no_offset),
    ):
        answer = changed(result.answer, status=status, **less, **NO_POSE)
        text = "".join(check_page(page_of(answer)).text)
        assert f"What mostly helps: {status.remedy}." in text
        assert ("In part" if status.has_offset else "Refused") in text
        assert "When each camera sees the object" in text
    assert "What was tried" in text
    assert "Residuals over time" in text
    (pair,) = laid_out(answer)["pairs"]
    best_s = result.candidates_s[np.nanargmin(result.costs)]
    assert (pair["found"], pair["holds"]) == (pytest.approx(best_s, abs=1e-6), False)
    assert all(one.remedy for one in Status if one is not Status.OK)


@pytest.mark.parametrize("method", ["albl", "joint-known", "zncc_f"])
def test_every_method_has_a_page_that_calls_only_a_known_accuracy_reliable(method, recorded):
    result = ssac.sync(*recorded.pair, recorded / "rig_extrinsics.yaml", method)
    text = "".join(check_page(page_of(result.answer, report_rows(result.answer))).text)
    assert result.answer.method.summary in text
    assert ("Near the minimum" in text) == (result.F is not None)
    said = [words in text for words in ("Reliable", "to be relied upon", "accuracy is unknown")]
    is_known = method == "joint-known"
    assert (result.status, said) == ("ok", [is_known, is_known, not is_known])


def test_a_camera_that_saw_nothing_has_a_page(recorded, tmp_path):
    events = ssac.load_events(recorded / "cam2.h5").events
    save_events_h5(tmp_path / "cam2.h5", events[::400], WIDTH, HEIGHT)
    result = ssac.sync(recorded / "cam1.h5", tmp_path / "cam2.h5", recorded / "rig.yaml")
    assert not result.has_offset
    check_page(result.report(tmp_path / "page.html").read_text(encoding="utf-8"))
    # All events are shown, also those that denoising removed.
    frames, *_ = events_of(laid_out(result.answer)["views"][1])
    assert len(frames) == len(events[::400])  # so few that no two share a pixel of a frame


def test_cameras_that_begin_late_or_have_frames_alone_have_a_page(recorded, tmp_path):
    """Bug: with nothing to draw of a camera in the part shown, the page was a ValueError."""
    scene = make_scene(0, duration_s=200.0)
    one, other = frame_tracks(scene, 0.1)
    late = other.times_s > 160.0
    other = PointTrack(other.times_s[late], other.points_px[late])
    rig = [scene.rig.cam1, scene.rig.cam2]
    result = ssac.sync(one, other, rig, interval_s=(-0.5, 0.5))
    assert result.has_offset
    check_page(result.report(tmp_path / "late.html").read_text(encoding="utf-8"))
    # Camera 2 begins 40 s before the end, which are therefore a part of the 120 s that are shown.
    view = laid_out(result.answer)["views"][1]
    shown_s = view["start"] + np.array([0.0, view["frame"] * view["n_frames"]])
    assert shown_s == pytest.approx(other.times_s[[0, -1]], abs=view["frame"])  # whole frames
    seen = opened(recorded.pair, opened_rig(recorded / "rig.yaml", 2))
    none = np.empty(0, ssac.EVENT_DTYPE)
    frames = [replace(source.read("images"), events=none) for source in seen]
    result = ssac.sync(*frames, recorded / "rig.yaml", "zncc_f")
    assert result.has_offset
    check_page(result.report(tmp_path / "frames.html").read_text(encoding="utf-8"))


def test_the_players_events_are_the_recordings_and_its_positions_those_of_the_views(result):
    answer = result.answer
    views, motions = laid_out(answer)["views"], answer.paired.motions
    for view, clean, motion in zip(views, answer.cleans, motions, strict=True):
        *shown, p = events_of(view)
        events, last = clean.events, unpacked(view["counts"], "<u4").size - 1
        frames = ((events["t"] / 1e6 - view["start"]) / view["frame"]).astype(int)
        found, expected = (
            {cell for cell in zip(*columns, strict=True) if 0 <= cell[0] < last}
            for columns in (shown, (frames, events["x"], events["y"]))
        )
        assert found == expected
        assert 0.2 < np.mean(p) < 0.8
        track = unpacked(view["track"], "<i2").reshape(-1, 2).astype(float)
        seen = motion.at(view["start"] + view["frame"] * np.arange(len(track)))
        valid = track[:, 0] > -32768
        np.testing.assert_array_equal(valid, seen.valid)
        shown_px = view["unit"] * track[valid] + (view["left"], view["top"])
        np.testing.assert_allclose(shown_px, seen.positions_px[valid], atol=view["unit"])


def test_events_of_a_distorted_lens_stand_where_a_straight_one_has_them(result):
    camera = Camera(K, WIDTH, HEIGHT, "radtan", (-0.2, 0.05, 0.0, 0.0))
    cleans = tuple(replace(one, camera=camera) for one in result.answer.cleans)
    rig = replace(result.answer.rig, cam1=camera, cam2=camera)
    view = laid_out(replace(result.answer, cleans=cleans, rig=rig))["views"][0]
    _, x, y, _ = events_of(view)
    measured = distort_points(camera, np.column_stack([x, y]).astype(float))
    events = result.answer.cleans[0].events
    hit = np.zeros((HEIGHT + 2, WIDTH + 2), bool)
    for dx, dy in np.ndindex(3, 3):  # a cell's centre is up to a pixel from its event
        hit[events["y"] + dy, events["x"] + dx] = True
    places = np.rint(measured).astype(int) + 1
    assert np.mean(hit[places[:, 1], places[:, 0]]) == 1.0


def test_two_minutes_of_noise_fit_on_a_page(result):
    events = noise(WIDTH, HEIGHT, 0.14, 120_000_000)  # 1.5 million
    n = len(events)
    cleans = tuple(replace(one, events=events, n_recorded=n) for one in result.answer.cleans)
    assert len(page_of(replace(result.answer, cleans=cleans))) < 3_000_000


def test_the_path_is_seen_where_both_cameras_see_it_and_camera_2_spreads_as_the_pose(result):
    scene = scene_of_two(result.answer)
    points, times_s = np.array(scene["path"]), np.array(scene["times"])
    seen = result.answer.paired.motion1.sharp_at(times_s)
    images = points @ K.T
    off_px = np.linalg.norm(images[:, :2] / images[:, 2:] - seen.positions_px, axis=1)
    # The path is midway between rays of positions that lie some pixels off their epipolar lines.
    assert np.nanmedian(off_px) < 2.0
    # The deviations are compared with those of 4000 draws, which are known to 1 %.
    rng = np.random.default_rng(0)
    steps = rng.multivariate_normal(np.zeros(5), 1e-4 * result.covariance[1:, 1:], 4000)
    poses = [moved_pose(result.R, result.t, step) for step in steps]
    drawn = 1e2 * np.std([-R.T @ t for R, t in poses], axis=0)
    axes = np.array(scene["cameras"][1]["axes"])
    np.testing.assert_allclose(np.sqrt(np.sum(axes**2, axis=0)), drawn, rtol=0.1)


def test_fitted_intrinsics_are_those_of_the_fundamental_matrix(recorded):
    joint = ssac.sync(*recorded.pair, recorded / "rig.yaml", "joint", focal_std=0.02)
    assert np.abs(joint.Ks[0] - K).max() > 1e-3
    F = fundamental_from_pose(*joint.Ks, joint.R, joint.t)
    np.testing.assert_allclose(joint.F, F / np.linalg.norm(F), rtol=1e-9)
    assert "Table of intrinsics" in page_of(joint.answer)


def test_the_command_writes_the_page_and_opens_it(recorded, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    out, args = tmp_path / "page.html", (*recorded.pair, "--rig", recorded / "rig.yaml")
    _, _, err = run("sync", *args, "--method", "event_rate", "--report", out, "--open")
    assert opened == [out.as_uri()]
    assert "ssac sync" not in err
    check_page(out.read_text(encoding="utf-8"))
    _, _, err = run("sync", *args, "--open", code=2)
    assert "--open: opens the page of --report" in err


def test_many_cameras_have_a_page_and_figures_of_each_pair(recorded, tmp_path, monkeypatch):
    rig = Camera(K, WIDTH, HEIGHT)
    files = [tmp_path / f"cam{k}.csv" for k in (1, 2, 3)]
    for k, file in enumerate(files):
        save_track(file, frame_track(recorded.scene, min(k + 1, 2), 30.0 + k))
    found = ssac.sync(files, [rig, rig, rig], search="interval")
    assert repr(found).startswith(f"<ssac.NetworkResult {found.status}, ")
    assert found._repr_html_().count("<tr>") == len(found.rows())
    assert pickle.loads(pickle.dumps(found)).summary() == found.summary()
    page = found.report(tmp_path / "page.html").read_text(encoding="utf-8")
    text = "".join(check_page(page).text)
    placed = sum(one.status == "ok" for one in found.cameras)
    assert f"{placed} of 3 cameras on one clock" in text
    of_last = page.split("<b>Cameras 2 and 3</b>")[1].split("</details>")[0]
    assert re.findall("the start of camera .", of_last) == ["the start of camera 2"] * 2
    data = json.loads(re.search(r'id="player-data">(.*?)</script>', page).group(1))
    assert [pair["cameras"] for pair in data["pairs"]] == [[0, 1], [0, 2], [1, 2]]
    monkeypatch.setattr("ssac.pipeline.plots.save_figures", lambda target, _: [target])
    of_pairs = ["1-2", "1-3", "2-3"]
    assert found.plot(str(tmp_path)) == [tmp_path / pair for pair in of_pairs]
    assert found.plotted(tmp_path / "a.png") == [tmp_path / f"a-{pair}.png" for pair in of_pairs]
