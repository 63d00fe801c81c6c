"""The page on a recording: whole by itself, whatever came of it, and what it draws is what was."""

import base64
import json
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest

import ssac
from ssac.camera import Camera, distort_points
from ssac.estimate import Status
from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import save_track
from ssac.geometry.epipolar import fundamental_from_pose
from ssac.geometry.pose import moved_pose
from ssac.pipeline.html_report import report_page, seen_by
from ssac.pipeline.plots import material_of
from ssac.pipeline.scene import scene_of_two
from ssac.pipeline.streams import streams
from tests.html_pages import EVIL, check_page
from tests.ssac.command import run
from tests.ssac.synthetic import HEIGHT, WIDTH, K
from tests.ssac.tracks import frame_track

BOTH = (0, 1)


@pytest.fixture(scope="module")
def result(recorded):
    return ssac.sync(recorded / "cam1.h5", recorded / "cam2.h5", recorded / "rig.yaml")


@pytest.fixture(scope="module")
def drawn(result):
    """What the player draws of both cameras."""
    return laid_out(result.answer)


def laid_out(answer):
    materials = {BOTH: material_of(answer)}
    return streams({BOTH: answer}, materials, seen_by({BOTH: answer}, materials))


def unpacked(text, dtype):
    """Numbers as the player reads them."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    size = np.dtype(dtype).itemsize
    return np.ascontiguousarray(planes.reshape(size, -1).T).view(dtype).ravel()


def events_of(view):
    """Frames, x, y [px] and polarities (n,) of a view."""
    counts, steps = unpacked(view["counts"], "<u4"), unpacked(view["events"], "<u4")
    cells = np.concatenate(
        [np.cumsum(part >> 1) for part in np.split(steps, np.cumsum(counts)[:-1])]
    )
    y, x = np.divmod(cells, view["columns"])
    frames = np.repeat(np.arange(len(counts)), counts)
    middle = 0.5 * view["cell"]
    x_px, y_px = view["left"] + view["cell"] * x, view["top"] + view["cell"] * y
    return frames, x_px + middle, y_px + middle, steps & 1


def page_of(answer, summary="", command=""):
    return report_page({BOTH: answer}, None, summary, command)


def test_the_page_says_what_was_found(result):
    page = page_of(result.answer, result.summary(), "ssac sync 'my cam1.h5'")
    text = "".join(check_page(page).text)
    said = f"{1e3 * result.t_d_s:.3f}\N{NO-BREAK SPACE}ms"
    assert f"Camera 2's clock is {said} ahead of camera 1's" in text
    low, high = (1e3 * (result.t_d_s + side * 1.96 * result.t_d_std_s) for side in (-1, 1))
    assert f"95 % interval {low:.3f} to {high:.3f} ms; 1 sigma" in text
    for line in result.summary().splitlines():
        assert line[15:].strip() in text
    for words in ("ssac sync 'my cam1.h5'", "numpy", "Reliable", "Residuals over time"):
        assert words in text
    assert page_of(result.answer, result.summary(), "ssac sync 'my cam1.h5'") == page


def test_nothing_that_files_say_becomes_html(result):
    cleans = tuple(replace(one, name=f"{EVIL}{k}") for k, one in enumerate(result.answer.cleans))
    estimate = replace(result.estimate, status=Status.NO_MATCH, reason=EVIL)
    answer = replace(result.answer, cleans=cleans, rig_name=EVIL, estimate=estimate)
    text = "".join(check_page(page_of(answer, f"note           {EVIL}", EVIL)).text)
    assert text.count(EVIL) >= 7  # twice each file, rig, reason, summary, command


@pytest.mark.parametrize("status", [one for one in Status if one is not Status.OK])
def test_every_refusal_has_a_page_that_says_what_to_do(status, result, drawn, monkeypatch):
    if status is not Status.NO_MATCH:  # the others' player and charts are its or the answered one's
        monkeypatch.setattr("ssac.pipeline.html_report.streams", lambda *_: drawn)
        monkeypatch.setattr("ssac.pipeline.html_report.sample_charts", lambda *_: [])
        none = dict.fromkeys(("cost", "residuals", "clock"), ())
        monkeypatch.setattr("ssac.pipeline.html_report.charts_of", lambda *_: none)
    has_offset = status.has_offset
    estimate = replace(
        result.estimate,
        status=status,
        reason="why",
        R=None,
        t=None,
        F=result.estimate.F if has_offset else None,
        costs=np.empty(0),
        t_d_s=result.t_d_s if has_offset else np.nan,
    )
    page = page_of(replace(result.answer, estimate=estimate))
    text = "".join(check_page(page).text)
    assert f"What mostly helps: {status.remedy}." in text
    assert ("In part" if has_offset else "Refused") in text
    assert ("When each camera sees the object" in text) == (status is Status.NO_MATCH)


@pytest.mark.parametrize(
    "method", ["ssac", "albl", "joint-known", "zncc_e", "zncc_f", "event_rate"]
)
def test_every_method_has_a_page(method, recorded):
    result = ssac.sync(*recorded.pair, recorded / "rig_extrinsics.yaml", method)
    text = "".join(check_page(page_of(result.answer, result.summary())).text)
    assert result.answer.method.summary in text
    assert ("Near the minimum" in text) == (result.F is not None)


def test_a_camera_that_saw_nothing_has_a_page(recorded, tmp_path):
    events = ssac.load_events(recorded / "cam2.h5").events
    save_events_h5(tmp_path / "cam2.h5", events[::400], WIDTH, HEIGHT)
    result = ssac.sync(recorded / "cam1.h5", tmp_path / "cam2.h5", recorded / "rig.yaml")
    assert not result.has_offset
    check_page(result.report(tmp_path / "page.html").read_text(encoding="utf-8"))
    # All events are shown, those that denoising took away too.
    frames, *_ = events_of(laid_out(result.answer)["views"][1])
    assert len(frames) == len(events[::400])  # so few that no two share a pixel of a frame


def test_the_players_events_are_the_recordings(result, drawn):
    for view, clean in zip(drawn["views"], result.answer.cleans, strict=True):
        frames, x, y, p = events_of(view)
        events, keys = clean.events, {}
        since_s = events["t"] / 1e6 - view["start"]
        for key in zip(
            (since_s / view["frame"]).astype(int), events["x"], events["y"], strict=True
        ):
            keys[key] = True
        n_frames = unpacked(view["counts"], "<u4").size
        inside = {key for key in keys if 0 <= key[0] < n_frames - 1}
        shown = {(f, x, y) for f, x, y in zip(frames, x, y, strict=True) if f < n_frames - 1}
        assert shown == inside
        assert 0.2 < np.mean(p) < 0.8


def test_the_players_positions_are_those_of_the_views(result, drawn):
    material = material_of(result.answer)
    for view, motion in zip(drawn["views"], material.motions, strict=True):
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
    for dx, dy in np.ndindex(3, 3):  # a cell's middle is up to a pixel off its event
        hit[events["y"] + dy, events["x"] + dx] = True
    places = np.rint(measured).astype(int) + 1
    assert np.mean(hit[places[:, 1], places[:, 0]]) == 1.0


def test_two_minutes_of_noise_fit_on_a_page(result):
    rng = np.random.default_rng(0)
    events = np.zeros(4_000_000, ssac.EVENT_DTYPE)
    events["t"] = np.sort(rng.integers(0, 120_000_000, len(events)))
    for name, size in (("x", WIDTH), ("y", HEIGHT), ("p", 2)):
        events[name] = rng.integers(0, size, len(events))
    n = len(events)
    cleans = tuple(replace(one, events=events, n_recorded=n) for one in result.answer.cleans)
    assert len(page_of(replace(result.answer, cleans=cleans))) < 3_000_000


def test_the_path_is_seen_where_both_cameras_see_it(result):
    material = material_of(result.answer)
    scene = scene_of_two(material)
    points, times_s = np.array(scene["path"]), np.array(scene["times"])
    seen, _ = material.views.sharp_at(times_s, result.t_d_s)
    images = points @ K.T
    off_px = np.linalg.norm(images[:, :2] / images[:, 2:] - seen.positions_px, axis=1)
    # Half of the distance between two rays, of positions some pixels off their lines.
    assert np.nanmedian(off_px) < 2.0


def test_the_spread_of_camera_2_is_that_of_the_pose(result):
    """By draws from the covariance; 4000 of them give each deviation to 1 %."""
    rng = np.random.default_rng(0)
    steps = rng.multivariate_normal(np.zeros(5), 1e-4 * result.covariance[1:, 1:], 4000)
    poses = [moved_pose(result.R, result.t, step) for step in steps]
    drawn = 1e2 * np.std([-R.T @ t for R, t in poses], axis=0)
    axes = np.array(scene_of_two(material_of(result.answer))["cameras"][1]["axes"])
    np.testing.assert_allclose(np.sqrt(np.sum(axes**2, axis=0)), drawn, rtol=0.1)


def test_fitted_intrinsics_are_those_of_the_fundamental_matrix(recorded):
    joint = ssac.sync(
        recorded / "cam1.h5", recorded / "cam2.h5", recorded / "rig.yaml", "joint", focal_std=0.02
    )
    assert np.abs(joint.Ks[0] - K).max() > 1e-3
    F = fundamental_from_pose(*joint.Ks, joint.R, joint.t)
    np.testing.assert_allclose(joint.F, F / np.linalg.norm(F), rtol=1e-9)
    assert "Table of intrinsics" in page_of(joint.answer)


def test_the_command_writes_the_page_and_opens_it(recorded, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    out, args = tmp_path / "page.html", (*recorded.pair, "--rig", recorded / "rig.yaml")
    code, _, err = run("sync", *args, "--method", "joint", "--report", out, "--open")
    assert code == 0, err
    assert opened == [out.as_uri()]
    assert "ssac sync" not in err
    check_page(out.read_text(encoding="utf-8"))
    code, _, err = run("sync", *args, "--open")
    assert (code, "--open: opens the page of --report" in err) == (2, True)
    assert run("sync", *args, "--report", tmp_path).exit_code == 2


def test_many_cameras_have_a_page_and_figures_of_each_pair(recorded, tmp_path, monkeypatch):
    rig = Camera(K, WIDTH, HEIGHT)
    files = [tmp_path / f"cam{k}.csv" for k in (1, 2, 3)]
    for k, file in enumerate(files):
        save_track(file, frame_track(recorded.scene, min(k + 1, 2), 30.0 + k))
    found = ssac.sync(files, [rig, rig, rig])
    page = found.report(tmp_path / "page.html").read_text(encoding="utf-8")
    text = "".join(check_page(page).text)
    placed = sum(one.status == "ok" for one in found.cameras)
    assert f"{placed} of 3 cameras on one clock" in text
    assert "Cameras 2 and 3" in text
    data = json.loads(re.search(r'id="player-data">(.*?)</script>', page).group(1))
    assert [pair["cameras"] for pair in data["pairs"]] == [[0, 1], [0, 2], [1, 2]]
    monkeypatch.setattr("ssac.pipeline.plots.save_figures", lambda target, _: [target])
    of_pairs = ["1-2", "1-3", "2-3"]
    assert found.plotted(tmp_path) == [tmp_path / pair for pair in of_pairs]
    assert found.plotted(tmp_path / "a.png") == [tmp_path / f"a-{pair}.png" for pair in of_pairs]
