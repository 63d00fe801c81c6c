"""The animation: what is shown is what was estimated, and the page holds it whole."""

import base64
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

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
from experiments.report.player import (
    CAMERA_RGB,
    curve_points,
    event_image,
    packed_events,
    player_json,
    still_view,
    stills,
)
from sim.errors import SimError
from ssac.files.hdf5 import load_events_h5, save_events_h5
from tests.experiments.reported import record_flight
from tests.ssac.synthetic import HEIGHT, WIDTH, K

TICKS = 1 << 13


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
