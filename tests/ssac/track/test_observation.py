"""What is clean stays so, moves with its clock, and gives the motion of the raw recording."""

import pickle
from dataclasses import fields, replace

import numpy as np
import pytest

from ssac.camera import Camera, same_camera
from ssac.config import Cleaning, Config
from ssac.errors import SsacError
from ssac.points import PointTrack
from ssac.rules import Rules
from ssac.track.clean import clean
from ssac.track.motion import motion_of
from ssac.track.observation import tracked
from tests.ssac.cluttered import noisy_flight
from tests.ssac.synthetic import CAMERA, HEIGHT, WIDTH, K, make_scene

HOW = Config().cleaning
WINDOWS = Config().windows
TRACK = PointTrack(0.1 * np.arange(10), np.ones((10, 2)))
RADTAN = Camera(K, WIDTH, HEIGHT, "radtan", (-0.3, 0.1, 0.001, -0.001))


@pytest.fixture(scope="module")
def raw():
    """One camera with noise events, and with frames."""
    return noisy_flight(make_scene(seed=1, duration_s=3.0), 0.05)[0]


@pytest.fixture
def cleaned(raw):
    return clean(raw, CAMERA, HOW)


def assert_same_motion(motion, other):
    for field in fields(other):
        ours, theirs = getattr(motion, field.name), getattr(other, field.name)
        np.testing.assert_array_equal(ours, theirs, err_msg=field.name)


def test_noise_leaves_the_events_and_all_else_stays(raw, cleaned):
    assert cleaned.denoised
    assert cleaned.n_recorded == len(raw.events)
    assert 0 < len(cleaned.events) < len(raw.events)
    assert cleaned.clutter is not None
    assert cleaned.frames is raw.frames
    assert cleaned.camera is CAMERA
    noisy = clean(raw, CAMERA, Cleaning(False, None))
    assert not noisy.denoised
    assert noisy.events is raw.events


def test_rules_of_a_config_are_obeyed(raw, cleaned):
    for rule, value in (("ball_px", 4.0), ("ball_neighbours", 25), ("noisy_hz", -1.0)):
        rules = replace(Rules(), noise=replace(Rules().noise, **{rule: value}))
        assert clean(raw, CAMERA, Config(rules=rules).cleaning).clutter != cleaned.clutter
    points = clean(tracked(TRACK), CAMERA, HOW)
    longer = replace(Rules(), points=replace(Rules().points, window_intervals=4.0))
    windows = [Config(rules=rules).windows for rules in (Rules(), longer)]
    assert [motion_of(points, one).half_window_s for one in windows] == pytest.approx([0.26, 0.4])


def test_what_is_clean_is_not_cleaned_again(cleaned):
    assert clean(cleaned, CAMERA, HOW) is cleaned
    # Equal cameras need not be one object, and noise that has been removed does not come back.
    same = Camera(K.copy(), WIDTH, HEIGHT)
    assert clean(cleaned, same, Cleaning(False, 7)) is cleaned
    track = clean(tracked(TRACK), CAMERA, HOW)
    assert track.denoised
    assert clean(track, CAMERA, HOW) is track


def test_denoising_that_was_skipped_is_made_up_for(raw, cleaned):
    noisy = clean(raw, CAMERA, Cleaning(False, None))
    motion_of(noisy, WINDOWS)  # of events with noise: not those that are left
    again = clean(noisy, CAMERA, HOW)
    assert (again.denoised, again.n_recorded) == (True, len(raw.events))
    assert np.array_equal(again.events, cleaned.events)
    assert_same_motion(motion_of(again, WINDOWS), motion_of(cleaned, WINDOWS))


@pytest.mark.parametrize(
    "change",
    [{"half_window_s": 0.01}, {"n_min": 20}, {"max_border_fraction": 0.5}, {"border_px": 99}],
)
def test_other_windows_than_those_summed_up_are_obeyed(change, raw, cleaned):
    windows = Config(**change).windows
    motion_of(cleaned, WINDOWS)
    expected = motion_of(clean(raw, CAMERA, HOW), windows)
    assert_same_motion(motion_of(cleaned, windows), expected)
    assert_same_motion(motion_of(cleaned, WINDOWS), motion_of(clean(raw, CAMERA, HOW), WINDOWS))


@pytest.mark.parametrize("camera", [RADTAN, Camera(K * [[2.0], [2.0], [1.0]], WIDTH, HEIGHT)])
def test_another_camera_is_obeyed(camera, cleaned):
    before = motion_of(cleaned, WINDOWS)
    other = clean(cleaned, camera, HOW)
    assert other.denoised
    assert other.camera is camera
    expected = motion_of(replace(cleaned, camera=camera), WINDOWS)
    assert_same_motion(motion_of(other, WINDOWS), expected)
    times_s = np.array([1.0, 2.0])
    there, here = motion_of(other, WINDOWS).at(times_s), before.at(times_s)
    if camera is RADTAN:  # its points are undistorted; K itself moves none
        assert not np.array_equal(there.positions_px, here.positions_px)
    with pytest.raises(SsacError, match="camera 2: the sensor is 100 x 260 px"):
        clean(cleaned, Camera(K, 100, HEIGHT), HOW, "camera 2")


@pytest.mark.parametrize("t_d_s", [0.005, 0.5, -1.234567, 3600.0])
@pytest.mark.parametrize("camera", [CAMERA, RADTAN], ids=["none", "radtan"])
def test_delaying_what_is_clean_equals_cleaning_what_is_delayed(camera, t_d_s, raw):
    before = raw.events.copy()
    later, seen = raw.delayed(t_d_s), clean(raw, camera, HOW)
    times_us = motion_of(seen, WINDOWS).times_us.copy()  # so that its sums are delayed with it
    delayed, expected = seen.delayed(t_d_s), clean(later, camera, HOW)
    assert np.array_equal(raw.events, before)  # what was given is as it was
    assert np.array_equal(motion_of(seen, WINDOWS).times_us, times_us)
    # Whole microseconds: exact.
    assert np.array_equal(delayed.events, expected.events)
    assert_same_motion(motion_of(delayed, WINDOWS), motion_of(expected, WINDOWS))
    assert np.array_equal(delayed.frame_times_s, expected.frame_times_s)
    tiny = raw.delayed(1.6e-6)  # rounded to whole microseconds, of frames as well
    assert np.array_equal(tiny.events["t"], raw.events["t"] + 2)
    assert tiny.frame_times_s == pytest.approx(raw.frame_times_s + 2e-6, abs=1e-12)
    # Seconds as float64 up to an hour: one unit in the last place is 5e-13 s.
    assert delayed.frame_times_s == pytest.approx(raw.frame_times_s + t_d_s, abs=1e-12)
    assert np.array_equal(later.events["t"], raw.events["t"] + round(t_d_s * 1e6))
    assert np.array_equal(later.events[["x", "y", "p"]], raw.events[["x", "y", "p"]])


def test_a_delay_moves_gaps_and_tracks(cleaned):
    gaps_us = np.array([[1_000_000, 2_000_000]])
    assert np.array_equal(replace(cleaned, gaps_us=gaps_us).delayed(0.25).gaps_us - gaps_us,
                          [[250_000, 250_000]])  # fmt: skip
    late = tracked(TRACK).delayed(0.25)
    assert late.track.times_s == pytest.approx(0.1 * np.arange(10) + 0.25, abs=1e-12)
    assert late.span_s == pytest.approx((0.25, 1.15), abs=1e-12)


def test_sums_are_found_again_in_another_process_and_of_other_events(cleaned):
    motion = motion_of(cleaned, WINDOWS)
    some = replace(cleaned, events=cleaned.events[:10_000])  # other events are summed up anew
    assert np.array_equal(motion_of(some, WINDOWS).times_us, some.events["t"])
    there = pickle.loads(pickle.dumps(cleaned))
    assert not there.kept
    assert_same_motion(motion_of(there, WINDOWS), motion)
    assert there.delayed(0.1).denoised


def test_what_cannot_be_used_is_refused_by_the_name_it_has(raw):
    backwards = replace(raw, events=raw.events[::-1])
    with pytest.raises(SsacError, match="camera 2: events must be sorted"):
        clean(backwards, CAMERA, HOW, "camera 2")
    with pytest.raises(SsacError, match=r"left\.h5: events must be sorted"):
        clean(replace(backwards, name="left.h5"), CAMERA, HOW, "camera 2")


def test_cameras_are_the_same_by_their_values():
    camera = Camera(K, WIDTH, HEIGHT)
    assert same_camera(camera, Camera(K.copy(), WIDTH, HEIGHT))
    assert same_camera(RADTAN, replace(RADTAN))
    for other in (
        Camera(K + np.eye(3), WIDTH, HEIGHT),
        Camera(K, WIDTH + 1, HEIGHT),
        Camera(K, WIDTH, HEIGHT + 1),
        replace(RADTAN, distortion_coeffs=(-0.3, 0.1, 0.001, 0.0)),
        replace(RADTAN, distortion_model="equidistant"),
    ):
        assert not same_camera(camera, other)
        assert not same_camera(RADTAN, other)
