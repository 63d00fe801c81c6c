"""Clean observations stay clean and move with their clock; events and points give the motion."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssac import PointTrack, SsacError
from ssac.camera import Camera, distort_points, undistort_points
from ssac.config import Cleaning, Config
from ssac.events import events_from_arrays
from ssac.rules import PointRules
from ssac.track.clean import clean
from ssac.track.motion import motion_of, object_motion, point_motion
from ssac.track.observation import tracked
from tests.answers import assert_same
from tests.ssac.cluttered import noisy_flight
from tests.ssac.synthetic import CAMERA, HEIGHT, WIDTH, K, make_events, make_scene, track_pair

HOW = Config().cleaning
WINDOWS = Config().windows
TRACK = PointTrack(0.1 * np.arange(10), np.ones((10, 2)))
RADTAN = Camera(K, WIDTH, HEIGHT, "radtan", (-0.3, 0.1, 0.001, -0.001))


@pytest.fixture(scope="module")
def raw():
    """One camera with noise events, and with frames."""
    return noisy_flight(make_scene(seed=1, duration_s=3.0), 0.05)[0]


def test_what_is_clean_is_not_cleaned_again(raw):
    cleaned = clean(raw, CAMERA, HOW)
    assert clean(cleaned, CAMERA, HOW) is cleaned
    # Equal cameras need not be one object, and noise that has been removed does not come back.
    same = Camera(K.copy(), WIDTH, HEIGHT)
    assert clean(cleaned, same, Cleaning(False, 7)) is cleaned
    track = clean(tracked(TRACK), CAMERA, HOW)
    assert track.denoised
    assert clean(track, CAMERA, HOW) is track


def test_noise_leaves_and_all_else_stays_also_where_it_was_skipped_before(raw):
    cleaned, noisy = (clean(raw, CAMERA, how) for how in (HOW, Cleaning(False, None)))
    assert not noisy.denoised
    assert noisy.events is raw.events
    motion_of(noisy, WINDOWS)  # keeps sums of noisy events, not of clean ones
    again = clean(noisy, CAMERA, HOW)
    for one in (cleaned, again):
        assert (one.denoised, one.n_recorded) == (True, len(raw.events))
        assert one.clutter is not None
        assert one.frames is raw.frames
        assert one.camera is CAMERA
    assert 0 < len(cleaned.events) < len(raw.events)
    assert np.array_equal(again.events, cleaned.events)
    assert_same(motion_of(again, WINDOWS), motion_of(cleaned, WINDOWS))


def test_another_camera_is_obeyed(raw):
    cleaned = clean(raw, CAMERA, HOW)
    before = motion_of(cleaned, WINDOWS)
    other = clean(cleaned, RADTAN, HOW)
    assert other.denoised
    assert other.camera is RADTAN
    found = motion_of(other, WINDOWS)
    assert_same(found, motion_of(replace(cleaned, camera=RADTAN), WINDOWS))
    assert not np.array_equal(found.position_sums_px, before.position_sums_px)
    with pytest.raises(SsacError, match="camera 2: the sensor is 100 x 260 px"):
        clean(cleaned, Camera(K, 100, HEIGHT), HOW, "camera 2")


@pytest.mark.parametrize("t_d_s", [1.6e-6, -1.234567, 3600.0])
@pytest.mark.parametrize("camera", [CAMERA, RADTAN], ids=["none", "radtan"])
def test_delaying_what_is_clean_equals_cleaning_what_is_delayed(camera, t_d_s, raw):
    before, shift_us = raw.events.copy(), round(t_d_s * 1e6)  # events and frames shift by whole us
    later, seen = raw.delayed(t_d_s), clean(raw, camera, HOW)
    times_us = motion_of(seen, WINDOWS).times_us.copy()  # its kept sums are delayed, too
    delayed, expected = seen.delayed(t_d_s), clean(later, camera, HOW)
    track = tracked(TRACK).delayed(t_d_s)
    assert np.array_equal(raw.events, before)  # the given events are unchanged
    assert np.array_equal(motion_of(seen, WINDOWS).times_us, times_us)
    # Whole microseconds: exact.
    assert np.array_equal(delayed.events, expected.events)
    assert_same(motion_of(delayed, WINDOWS), motion_of(expected, WINDOWS))
    assert np.array_equal(later.events["t"], raw.events["t"] + shift_us)
    assert np.array_equal(later.events[["x", "y", "p"]], raw.events[["x", "y", "p"]])
    # Seconds as float64 up to an hour: one unit in the last place is 5e-13 s.
    assert delayed.frame_times_s == pytest.approx(raw.frame_times_s + 1e-6 * shift_us, abs=1e-12)
    assert track.track.times_s == pytest.approx(TRACK.times_s + 1e-6 * shift_us, abs=1e-12)
    assert track.span_s == pytest.approx((1e-6 * shift_us, 0.9 + 1e-6 * shift_us), abs=1e-12)


# --- Motion of events ---

EVEN_US = np.arange(0, 40_000, 50)
MIDDLE_S = np.array([0.02])


@pytest.fixture(scope="module")
def flight():
    scene = make_scene(seed=0, duration_s=4.0)
    return scene, make_events(scene, seed=0)[0]


def column_of_events(t_us, x, y):
    x, y = (np.broadcast_to(side, np.shape(t_us)).astype(int) for side in (x, y))
    return events_from_arrays(t_us, x, y, np.zeros(len(t_us), int))


# Of a point that moves by 1000 px/s; pixels round.
MOVING = column_of_events(EVEN_US, x=100 + np.rint(1e-3 * EVEN_US), y=50)
STEPS_US = st.sampled_from([0, 1, 500, 20_000, 30_000, 900_000_000])  # many events at one time


@pytest.mark.parametrize("camera", [CAMERA, RADTAN], ids=["none", "radtan"])
@given(st.integers(-70_000, 1_000_000), st.lists(STEPS_US, max_size=400))
def test_positions_are_the_undistorted_means_of_windows_in_uneven_recordings_too(
    camera, first_us, steps_us
):
    t_us = np.cumsum([first_us, *steps_us])
    x, y = np.random.default_rng(0).integers(10, 200, (2, len(t_us)))
    motion = object_motion(column_of_events(t_us, x, y), camera)
    points_px = undistort_points(camera, np.column_stack([x, y]).astype(np.float64))
    # Window bounds on, just before and just after events, and far outside.
    at_us = np.unique(t_us)[:, None] + [-20_001, -20_000, -19_999, 0, 19_999, 20_000, 20_001]
    at_us = np.append(at_us, [-(10**12), 10**12])
    bounds = np.searchsorted(t_us, at_us - 20_000), np.searchsorted(t_us, at_us + 20_000)
    track = motion.at(at_us.reshape(1, -1, 1) * 1e-6)
    assert np.array_equal(track.counts.ravel(), bounds[1] - bounds[0])
    expected = [
        np.mean(points_px[first:last], axis=0) if first < last else [np.nan, np.nan]
        for first, last in zip(*bounds, strict=True)
    ]
    np.testing.assert_allclose(track.positions_px[0, :, 0], expected, atol=1e-9)  # rounding of sums


def test_velocities_and_sharp_positions_follow_the_path(flight):
    scene, events = flight
    times_s = np.linspace(0.1, 3.9, 200)
    motion = object_motion(events, CAMERA)
    track, valid = motion.sharp_at(times_s), motion.at(times_s).valid
    assert np.array_equal(track.valid, valid)
    assert np.array_equal(track.velocities_px_s, motion.velocities_at(times_s))
    truth = (track_pair(scene, times_s + 1e-4)[0] - track_pair(scene, times_s - 1e-4)[0]) / 2e-4
    error = (track.velocities_px_s - truth)[valid]
    # 500 events of deviation 10 px in each half, 20 ms apart: 0.45 * sqrt(2) / 0.02 = 32 px/s.
    assert np.median(np.abs(error)) < 40.0
    assert np.abs(np.median(error)) < 10.0
    error = (track.positions_px - track_pair(scene, times_s)[0])[valid]
    # A thousand events of deviation 10 px: 0.3 px; as much again for perspective.
    assert np.median(np.abs(error)) < 0.6


def test_velocities_do_not_depend_on_when_the_events_come():
    # One pixel per ms and ever more events: the mean time and position of each half are late.
    t_ms = np.repeat(np.arange(60, 140), np.arange(1, 81) ** 2)
    events = column_of_events(1000 * t_ms, t_ms, np.full(len(t_ms), 50))
    velocity = object_motion(events, CAMERA).velocities_at(np.array([0.1]))[0]
    assert velocity == pytest.approx([1000.0, 0.0], abs=1e-6)  # rounding of sums


@pytest.mark.parametrize(("x", "y"), [(4, 100), (341, 100), (100, 4), (100, 255)])
def test_windows_with_few_events_or_some_on_the_border_are_invalid(x, y):
    # The window needs 800 events, of which at most 5 % may lie on the border.
    for n_min, on_border, is_valid in ((800, 40, True), (801, 0, False), (800, 41, False)):
        events = column_of_events(EVEN_US, x=100, y=100)
        events["x"][:on_border], events["y"][:on_border] = x, y
        assert object_motion(events, CAMERA, n_min=n_min).at(MIDDLE_S).valid[0] == is_valid


def test_windows_that_reach_into_gaps_are_invalid():
    events = column_of_events(np.arange(0, 400_000, 100), x=100, y=100)
    whole = object_motion(events, CAMERA)
    gaps_us = np.array([[-(2**61), 50_000], [200_000, 220_000], [350_000, 2**61]])
    motion = replace(whole, gaps_us=gaps_us)
    times_s = np.array([0.069, 0.070, 0.180, 0.181, 0.210, 0.239, 0.240, 0.330, 0.331])
    assert whole.at(times_s).valid.all()
    expected = [False, True, True, False, False, False, True, True, False]
    assert motion.at(times_s).valid.tolist() == expected
    assert motion.delayed(1_000_000).at(times_s + 1.0).valid.tolist() == expected


def test_sharp_positions_weigh_cells_by_the_square_root_of_their_events():
    events = column_of_events(EVEN_US, x=np.where(np.arange(800) % 5 == 0, 110, 100), y=50)
    motion = object_motion(events, CAMERA)
    assert motion.at(MIDDLE_S).positions_px[0, 0] == pytest.approx(102.0)  # 640 and 160 events
    track = motion.sharp_at(MIDDLE_S)
    # The events' mean time is not the window's middle: the first event comes at its start.
    assert np.allclose(track.positions_px[0], [(2 * 100 + 110) / 3, 50.0], atol=0.01)
    assert track.sizes_px[0] == pytest.approx(10.0 * np.sqrt(2.0 / 9.0))
    assert track.valid[0]
    assert motion.sharp_at(MIDDLE_S.copy()) is track
    assert not motion.sampled_by(WINDOWS, n_min=801).sharp_at(MIDDLE_S).valid[0]  # other rules


def test_sharp_images_do_not_move():
    track = object_motion(MOVING, CAMERA).sharp_at(MIDDLE_S)
    # Pixels and cells both round, by up to half a pixel, and differently in the two halves.
    assert np.allclose(track.positions_px[0], [120.0, 50.0], atol=0.25)
    assert track.sizes_px[0] < 1.0  # 12 px with motion blur; pixels round by up to half a pixel
    assert np.allclose(track.velocities_px_s[0], [1000.0, 0.0], atol=10.0)


def test_centred_positions_do_not_depend_on_when_the_camera_was_blind():
    motion = object_motion(MOVING[(EVEN_US < 21_000) | (EVEN_US >= 31_000)], CAMERA)
    # The mean time of the events left is 18 ms, and the mean of their pixels belongs to that time.
    assert motion.at(MIDDLE_S).positions_px[0, 0] == pytest.approx(118.0, abs=0.25)
    centred = motion.centred_at(np.array([0.02, 0.1]))
    assert centred.positions_px[0, 0] == pytest.approx(120.0, abs=0.25)  # pixels round
    assert list(centred.valid) == [True, False]


@pytest.mark.parametrize(
    ("shift_us", "most_events", "most_px"),
    [
        (-123_457, 0, 0.0),
        (3_600_000_000, 0, 0.0),
        # float64 resolves Unix time in 2023 to 0.24 us: a window's ends may differ.
        (1_700_000_000_000_000, 2, 0.1),
    ],
)
def test_samples_half_way_between_microseconds_do_not_depend_on_the_clocks_zero(
    flight, shift_us, most_events, most_px
):
    motion = object_motion(flight[1], CAMERA)
    times_s = (np.arange(0, 4_000_000, 997) + 0.5) * 1e-6
    track, delayed = motion.at(times_s), motion.delayed(shift_us).at(times_s + 1e-6 * shift_us)
    np.testing.assert_allclose(delayed.counts, track.counts, rtol=0, atol=most_events)
    np.testing.assert_allclose(delayed.positions_px, track.positions_px, rtol=0, atol=most_px)


# --- Points: a parabola, which local parabolas follow exactly ------------------------------------

RULES = PointRules()
STEP_S = 0.04
TIMES_S = STEP_S * np.arange(100.0)


def path(times_s):
    return np.stack([20.0 + 90.0 * times_s - 8.0 * times_s**2, 30.0 + 11.0 * times_s**2], axis=-1)


def of_points(times_s, points_px=None, sigmas_px=None, camera=CAMERA, half_window_s=0.02):
    points_px = path(times_s) if points_px is None else points_px
    return point_motion(PointTrack(times_s, points_px, sigmas_px), camera, RULES, half_window_s)


def test_positions_and_velocities_between_points():
    wanted_s = np.linspace(0.2, 3.6, 78)
    motion = of_points(TIMES_S)
    sharp = motion.sharp_at(wanted_s)
    assert sharp.valid.all()
    np.testing.assert_allclose(sharp.positions_px, path(wanted_s), atol=1e-8)
    velocities = np.stack([90.0 - 16.0 * wanted_s, 22.0 * wanted_s], axis=-1)
    np.testing.assert_allclose(sharp.velocities_px_s, velocities, atol=1e-6)
    assert motion.half_window_s == pytest.approx(RULES.window_intervals * STEP_S)
    assert of_points(np.arange(0.0, 2.0, 1e-3)).half_window_s == 0.02  # of a faster camera
    folded = motion.at(wanted_s.reshape(6, 13)).positions_px
    np.testing.assert_array_equal(folded, sharp.positions_px.reshape(6, 13, 2))


def test_gaps_and_ends_are_not_valid():
    motion = of_points(TIMES_S[(TIMES_S < 1.0) | (TIMES_S > 2.0)])
    outside = np.array([-0.5, 0.01, 1.1, 1.5, 1.9, 3.95, 5.0])
    assert not motion.at(outside).valid.any()
    assert np.isnan(motion.at(outside).positions_px).all()
    assert of_points(np.delete(TIMES_S, 50)).at(TIMES_S[3:-3]).valid.all()  # one may be missing


@pytest.mark.parametrize("sigma_px", [0.1, 1.0])
def test_the_noise_of_points_is_measured(sigma_px):
    noise = np.random.default_rng(0).normal(0.0, sigma_px, (2000, 2))
    times_s = 1e-3 * np.arange(2000.0)
    motion = of_points(times_s, path(times_s) + noise)
    # The median of 4000 residuals, whose neighbours are correlated, is good to some 3 %.
    assert motion.sigmas_px[0] == pytest.approx(sigma_px, rel=0.1)


def test_points_count_by_their_deviations():
    is_off = np.arange(100) % 2 == 1
    points = path(TIMES_S) + np.where(is_off, 5.0, 0.0)[:, None]
    motion = of_points(TIMES_S, points, np.where(is_off, 1.0, 0.001), half_window_s=0.3)
    found = motion.at(TIMES_S[20:80]).positions_px
    np.testing.assert_allclose(found, path(TIMES_S[20:80]), atol=1e-3)


def test_rows_of_a_rolling_shutter_have_times_of_their_own():
    """The rows are those of the distorted image."""
    camera, seen = replace(RADTAN, readout_s=0.03), distort_points(RADTAN, path(TIMES_S[:60]))
    for _ in range(5):
        rows = seen[:, 1] / (HEIGHT - 1)
        seen = distort_points(RADTAN, path(TIMES_S[:60] + 0.03 * rows))
    motion = of_points(TIMES_S[:60], seen, camera=camera)
    np.testing.assert_allclose(motion.rows, seen[:, 1] / (HEIGHT - 1), rtol=1e-12)
    again = of_points(TIMES_S[:60], seen, camera=RADTAN).read_out(0.01).read_out(0.03)
    np.testing.assert_allclose(again.times_s, motion.times_s, atol=1e-12)  # the last alone counts
    assert again.interval_s == pytest.approx(STEP_S)
    wanted_s = np.linspace(0.3, 2.0, 9)
    np.testing.assert_allclose(motion.at(wanted_s).positions_px, path(wanted_s), atol=1e-5)
