from itertools import pairwise

import numpy as np
import pytest

from ssac.errors import SsacError
from ssac.events import (
    EVENT_DTYPE,
    check_events,
    copied,
    events_from_arrays,
    slice_time,
    time_quantum_s,
)


def _events(t):
    n = len(t)
    return events_from_arrays(t, np.arange(n) % 10, np.arange(n) % 7, np.arange(n) % 2)


def test_events_from_arrays_keeps_every_value():
    t = [-5, 0, 2**62]
    events = events_from_arrays(t, [0, 1, 65535], [3, 4, 5], [0, 1, 1])
    assert events.dtype == EVENT_DTYPE
    assert events.tolist() == [(-5, 0, 3, 0), (0, 1, 4, 1), (2**62, 65535, 5, 1)]


@pytest.mark.parametrize("dtype", [np.int8, np.int16, np.int64])
def test_polarity_of_minus_one_becomes_zero(dtype):
    events = events_from_arrays([0, 1], [0, 0], [0, 0], np.array([-1, 1], dtype=dtype))
    assert events["p"].tolist() == [0, 1]


def test_boolean_polarity():
    events = events_from_arrays([0, 1], [0, 0], [0, 0], np.array([False, True]))
    assert events["p"].tolist() == [0, 1]


def test_events_from_arrays_does_not_change_its_arguments():
    p = np.array([-1, 1])
    events_from_arrays([0, 1], [0, 0], [0, 0], p)
    assert p.tolist() == [-1, 1]


def test_arrays_of_different_length_are_refused():
    with pytest.raises(SsacError, match=r"cam1\.h5: t, x, y and p must be of one length"):
        events_from_arrays([0, 1], [0, 1], [0], [0, 1], name="cam1.h5")


@pytest.mark.parametrize("step", [1, 3])
def test_copied_events_are_the_same_and_their_own(step):
    events = _events(np.arange(20))[::step]
    copy = copied(events)
    assert copy.dtype == EVENT_DTYPE
    assert np.array_equal(copy, events)
    assert not np.shares_memory(copy, events)


def test_times_in_seconds_are_refused():
    with pytest.raises(SsacError, match=r"t must hold whole numbers \(t in microseconds\)"):
        events_from_arrays([0.1, 0.2], [0, 1], [0, 1], [0, 1])


@pytest.mark.parametrize("x", [-1, 65536])
def test_coordinates_that_would_wrap_around_are_refused(x):
    with pytest.raises(SsacError, match="x must lie in 0 to 65535"):
        events_from_arrays([0, 1], [0, x], [0, 0], [0, 1])


def test_valid_events_pass():
    events = _events([0, 1, 1, 2])
    check_events(events, 10, 7, "camera 1")
    check_events(events, None, None, "camera 1")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda e: e[:0], "camera 1: there are no events"),
        (lambda e: e[::-1], "event 1 is at 2 us, after one at 3 us: sort the file"),
        (lambda e: e.astype([("t", "<f8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")]), "1-D array"),
        (lambda e: e.reshape(2, 2), "1-D array of"),
    ],
)
def test_unusable_events_are_refused(change, message):
    with pytest.raises(SsacError, match=message):
        check_events(change(_events([0, 1, 2, 3])), 10, 7, "camera 1")


@pytest.mark.parametrize(("width", "height", "field"), [(3, 7, "x"), (10, 3, "y")])
def test_events_outside_the_sensor_are_refused(width, height, field):
    with pytest.raises(SsacError, match=rf"sensor is {width} x {height} px, .* at {field} = 3"):
        check_events(_events([0, 1, 2, 3]), width, height, "camera 1")


def test_polarity_above_one_is_refused():
    with pytest.raises(SsacError, match="polarity must be 0 or 1, got 2"):
        check_events(events_from_arrays([0], [0], [0], [2]), 10, 7, "camera 1")


def test_consecutive_slices_make_the_whole():
    t = np.sort(np.random.default_rng(0).integers(0, 1000, 500))
    events = _events(t)
    edges = [-10, 0, 17, 17, 500, 999, 1000, 2000]
    slices = [slice_time(events, a, b) for a, b in pairwise(edges)]
    for part, (start, end) in zip(slices, pairwise(edges), strict=True):
        assert np.all((part["t"] >= start) & (part["t"] < end))
    np.testing.assert_array_equal(np.concatenate(slices), events)


def test_a_slice_is_a_view():
    events = _events([0, 1, 2, 3])
    assert np.shares_memory(slice_time(events, 1, 3), events)


def test_a_counter_of_24_bits_is_named_and_not_to_be_sorted():
    times_us = np.array([1, 2**24 - 5, 3], np.int64)
    events = events_from_arrays(times_us, *np.zeros((3, 3), np.int64))
    with pytest.raises(SsacError, match=r"begins anew at event 2, .* 24 bits .*; do not sort"):
        check_events(events, None, None, "cam1.h5")


@pytest.mark.parametrize(
    ("times_s", "quantum_s"),
    [
        (np.floor(np.arange(0, 3, 1 / 30) * 1e3) / 1e3, 0.001),
        (np.floor(np.arange(0, 3, 1 / 30) * 1e2) / 1e2, 0.010),
        (np.floor(np.sort(np.random.default_rng(0).random(500)) * 1e3) / 1e3, 0.001),
        (np.arange(0, 3, 1 / 25), 0.0),  # whole milliseconds by the frame rate
        (np.arange(0, 3, 1 / 30), 0.0),
        (np.arange(5.0), 0.0),  # too few to tell
    ],
)
def test_times_that_were_cut_off_are_told_from_even_ones(times_s, quantum_s):
    assert time_quantum_s(times_s) == quantum_s
