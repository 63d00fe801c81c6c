"""Window means, velocities and the two rules of validity, against plain sums over the events."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.camera import Camera, undistort_points
from ssac.events import EVENT_DTYPE
from ssac.track.motion import object_motion
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_events, make_scene, track_pair

CAMERA = Camera(K, WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def flight():
    scene = make_scene(seed=0, duration_s=4.0)
    return scene, make_events(scene, seed=0)[0]


def column_of_events(t_us, x, y):
    events = np.zeros(len(t_us), EVENT_DTYPE)
    events["t"], events["x"], events["y"] = t_us, x, y
    return events


def test_positions_are_the_means_of_the_windows(flight):
    _, events = flight
    times_s = np.linspace(-0.1, 4.1, 43)
    track = object_motion(events, CAMERA).at(times_s)
    for i, time_s in enumerate(times_s):
        inside = np.abs(events["t"] + 0.5 - 1e6 * time_s) < 20_000  # [t - 20 ms, t + 20 ms)
        assert track.counts[i] == inside.sum()
        if inside.any():
            mean = [events["x"][inside].mean(), events["y"][inside].mean()]
            assert np.allclose(track.positions_px[i], mean, atol=1e-9)  # rounding of long sums
        else:
            assert np.isnan(track.positions_px[i]).all()
            assert not track.valid[i]


@pytest.mark.parametrize(
    "t_us",
    [
        np.repeat(np.arange(0, 3_000_000, 30_000), 40),  # many events at one time
        np.concatenate([np.arange(500), 2_000_000 + np.arange(3), 900_000_000 + np.arange(500)]),
        np.array([-70_000, -20_000, -20_000, 0, 20_000]),
        np.array([1_000_000]),
    ],
    ids=["repeated", "gaps", "negative", "single"],
)
def test_windows_are_found_in_uneven_recordings(t_us):
    motion = object_motion(column_of_events(t_us, x=100, y=100), CAMERA)
    # Window bounds on, just before and just after events, and far outside.
    at_us = np.unique(t_us)[:, None] + [-20_001, -20_000, -19_999, 0, 19_999, 20_000, 20_001]
    at_us = np.append(at_us, [-(10**12), 10**12])
    expected = np.searchsorted(t_us, at_us + 20_000) - np.searchsorted(t_us, at_us - 20_000)
    assert np.array_equal(motion.at(at_us * 1e-6).counts, expected)
    assert motion.at(at_us.reshape(1, -1, 1) * 1e-6).positions_px.shape == (1, len(at_us), 1, 2)


def test_rows_of_samples_are_as_each_of_them_alone(flight):
    motion = object_motion(flight[1], CAMERA)
    times_s = np.linspace(-0.1, 4.1, 42).reshape(3, 7, 2)[:, ::-1]
    together = motion.at(times_s)
    for place in np.ndindex(times_s.shape):
        alone = motion.at(times_s[place])
        np.testing.assert_array_equal(together.positions_px[place], alone.positions_px)
        assert (together.counts[place], together.valid[place]) == (alone.counts, alone.valid)


def test_velocities_follow_the_path(flight):
    scene, events = flight
    times_s = np.linspace(0.1, 3.9, 200)
    motion = object_motion(events, CAMERA)
    valid = motion.at(times_s).valid
    truth = (track_pair(scene, times_s + 1e-4)[0] - track_pair(scene, times_s - 1e-4)[0]) / 2e-4
    error = (motion.velocities_at(times_s) - truth)[valid]
    # 500 events of deviation 10 px in each half, 20 ms apart: 0.45 * sqrt(2) / 0.02 = 32 px/s.
    assert np.median(np.abs(error)) < 40.0
    assert np.abs(np.median(error)) < 10.0


def test_velocities_do_not_depend_on_when_the_events_come():
    # A pixel a millisecond, and ever more events: each half's mean time is late in it, as is its
    # mean position.
    t_ms = np.repeat(np.arange(60, 140), np.arange(1, 81) ** 2)
    events = column_of_events(1000 * t_ms, t_ms, np.full(len(t_ms), 50))
    velocity = object_motion(events, CAMERA).velocities_at(np.array([0.1]))[0]
    assert velocity == pytest.approx([1000.0, 0.0], abs=1e-6)  # rounding of sums


def test_times_far_from_zero_lose_nothing(flight):
    _, events = flight
    later = events.copy()
    later["t"] += 1_700_000_000_000_000  # a clock that shows the time of day in 2023
    times_s = np.linspace(0.5, 3.5, 31)
    near = object_motion(events, CAMERA)
    far = object_motion(later, CAMERA)
    # Seconds in float64 resolve 0.24 us there, so that a window may differ by one event.
    shift = np.abs(far.at(times_s + 1.7e9).positions_px - near.at(times_s).positions_px)
    assert np.nanmax(shift) < 0.1
    assert np.allclose(far.velocities_at(times_s + 1.7e9), near.velocities_at(times_s), atol=10.0)


def test_windows_with_fewer_than_n_min_events_are_invalid():
    events = column_of_events(np.arange(0, 40_000, 200), x=100, y=100)  # 200 events in 40 ms
    middle = np.array([0.02])
    assert object_motion(events, CAMERA, n_min=200).at(middle).valid.all()
    assert not object_motion(events, CAMERA, n_min=201).at(middle).valid.any()


@pytest.mark.parametrize(("x", "y"), [(4, 100), (341, 100), (100, 4), (100, 255)])
def test_windows_with_events_on_the_border_are_invalid(x, y):
    t_us = np.arange(0, 40_000, 100)
    for on_border, is_valid in ((20, True), (21, False)):  # 5 % of 400 events
        events = column_of_events(t_us, x=100, y=100)
        events["x"][:on_border], events["y"][:on_border] = x, y
        assert object_motion(events, CAMERA).at(np.array([0.02])).valid[0] == is_valid


def test_windows_that_reach_into_gaps_are_invalid():
    events = column_of_events(np.arange(0, 400_000, 100), x=100, y=100)
    whole = object_motion(events, CAMERA)
    gaps_us = np.array([[-(2**61), 50_000], [200_000, 220_000], [350_000, 2**61]])
    motion = replace(whole, gaps_us=gaps_us)
    times_s = np.array([0.069, 0.070, 0.180, 0.181, 0.210, 0.239, 0.240, 0.330, 0.331])
    assert whole.at(times_s).valid.all()
    expected = [False, True, True, False, False, False, True, True, False]
    assert motion.at(times_s).valid.tolist() == expected
    later = motion.delayed(1_000_000)
    assert later.at(times_s + 1.0).valid.tolist() == expected


def test_distortion_is_removed_before_the_mean():
    camera = Camera(K, WIDTH, HEIGHT, "radtan", (-0.2, 0.05, 0.001, -0.001))
    rng = np.random.default_rng(0)
    events = column_of_events(
        np.arange(0, 40_000, 50), rng.integers(20, 60, 800), rng.integers(20, 60, 800)
    )
    pixels = np.column_stack([events["x"], events["y"]]).astype(np.float64)
    expected = undistort_points(camera, pixels).mean(axis=0)
    track = object_motion(events, camera).at(np.array([0.02]))
    assert np.allclose(track.positions_px[0], expected, atol=1e-9)


def test_no_events_give_no_valid_sample():
    motion = object_motion(np.zeros(0, EVENT_DTYPE), CAMERA)
    assert not motion.at(np.array([0.0, 1.0])).valid.any()
    assert motion.span_s[0] > motion.span_s[1]


def test_sharp_positions_weigh_cells_by_the_square_root_of_their_events():
    t_us = np.arange(0, 40_000, 80)
    events = column_of_events(t_us, x=np.where(np.arange(500) % 5 == 0, 110, 100), y=50)
    motion = object_motion(events, CAMERA)
    middle = np.array([0.02])
    assert motion.at(middle).positions_px[0, 0] == pytest.approx(102.0)  # 400 and 100 events
    track = motion.sharp_at(middle)
    # The middle of the window is not that of its events: the first comes at its start.
    assert np.allclose(track.positions_px[0], [(20 * 100 + 10 * 110) / 30, 50.0], atol=0.01)
    assert track.sizes_px[0] == pytest.approx(10.0 * np.sqrt(2.0 / 9.0))
    assert track.valid[0]


def test_sharp_images_do_not_move():
    t_us = np.arange(0, 40_000, 50)
    events = column_of_events(t_us, x=100 + np.rint(1e-3 * t_us), y=50)  # 1000 px/s
    track = object_motion(events, CAMERA).sharp_at(np.array([0.02]))
    # Pixels and cells both round, by up to half a pixel, and not alike in both halves.
    assert np.allclose(track.positions_px[0], [120.0, 50.0], atol=0.25)
    assert track.sizes_px[0] < 1.0  # 12 px if it moved; pixels round by up to half of one
    assert np.allclose(track.velocities_px_s[0], [1000.0, 0.0], atol=10.0)


def test_centred_positions_do_not_depend_on_when_the_camera_was_blind():
    t_us = np.arange(0, 40_000, 50)
    events = column_of_events(t_us, x=100 + np.rint(1e-3 * t_us), y=50)  # 1000 px/s
    seen = events[(t_us < 21_000) | (t_us >= 31_000)]
    motion = object_motion(seen, CAMERA)
    # The events left are 18 ms old in the mean, and the mean of their pixels is as old.
    assert motion.at(np.array([0.02])).positions_px[0, 0] == pytest.approx(118.0, abs=0.25)
    centred = motion.centred_at(np.array([0.02, 0.1]))
    assert centred.positions_px[0, 0] == pytest.approx(120.0, abs=0.25)  # pixels round
    assert list(centred.valid) == [True, False]


def test_sharp_positions_follow_the_path(flight):
    scene, events = flight
    times_s = np.linspace(0.1, 3.9, 200)
    motion = object_motion(events, CAMERA)
    track = motion.sharp_at(times_s)
    assert np.array_equal(track.valid, motion.at(times_s).valid)
    error = (track.positions_px - track_pair(scene, times_s)[0])[track.valid]
    # A thousand events of deviation 10 px: 0.3 px; as much again for perspective.
    assert np.median(np.abs(error)) < 0.6


def test_sharp_positions_without_events_are_invalid():
    track = object_motion(np.zeros(0, EVENT_DTYPE), CAMERA).sharp_at(np.array([0.0, 1.0]))
    assert not track.valid.any()
    assert np.isnan(track.positions_px).all()


@pytest.mark.parametrize("shift_us", [5_000, 500_000, -123_457, 3_600_000_000])
def test_samples_half_way_between_microseconds_do_not_depend_on_the_clocks_zero(flight, shift_us):
    _, events = flight
    motion = object_motion(events, CAMERA)
    times_s = (np.arange(0, 4_000_000, 997) + 0.5) * 1e-6
    track, delayed = motion.at(times_s), motion.delayed(shift_us).at(times_s + 1e-6 * shift_us)
    np.testing.assert_array_equal(delayed.counts, track.counts)
    np.testing.assert_array_equal(delayed.positions_px, track.positions_px)
