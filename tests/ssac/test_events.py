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


@pytest.mark.parametrize("dtype", [np.int8, np.int64, bool])
def test_polarity_of_minus_one_becomes_zero_and_arguments_stay(dtype):
    p = np.array([0 if dtype is bool else -1, 1], dtype=dtype)
    before = p.tolist()
    assert events_from_arrays([0, 1], [0, 0], [0, 0], p)["p"].tolist() == [0, 1]
    assert p.tolist() == before


@pytest.mark.parametrize("step", [1, 3])
def test_copied_events_are_the_same_and_their_own(step):
    events = _events(np.arange(20))[::step]
    copy = copied(events)
    assert copy.dtype == EVENT_DTYPE
    assert np.array_equal(copy, events)
    assert not np.shares_memory(copy, events)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (([0, 1], [0, 1], [0], [0, 1]), r"cam1\.h5: t, x, y and p must be of one length"),
        (([0.1], [0], [0], [0]), r"t must hold whole numbers \(t in microseconds\)"),
        (([0], [-1], [0], [0]), "x must lie in 0 to 65535"),
        (([0], [65536], [0], [0]), "x must lie in 0 to 65535"),
    ],
)
def test_arrays_that_make_no_events_are_refused(columns, message):
    with pytest.raises(SsacError, match=message):
        events_from_arrays(*columns, name="cam1.h5")


UNUSABLE = [
    (lambda e: e[:0], "camera 1: there are no events"),
    (lambda e: e[::-1], "event 1 is at 2 us, after one at 3 us: sort the file"),
    (lambda e: e.astype([("t", "<f8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")]), "1-D array"),
    (lambda e: e.reshape(2, 2), "1-D array of"),
    (lambda e: _with(e, "x", 10), "sensor is 10 x 7 px, .* at x = 10"),
    (lambda e: _with(e, "y", 7), "sensor is 10 x 7 px, .* at y = 7"),
    (lambda e: _with(e, "p", 2), "polarity must be 0 or 1, got 2"),
    (
        lambda e: _with(_with(e, "t", 3), "t", 2**24 - 5, 2),
        r"begins anew at event 3, .* 24 bits .*; do not sort",
    ),
]


def _with(events, field, value, at=3):
    other = events.copy()
    other[field][at] = value
    return other


@pytest.mark.parametrize(("change", "message"), UNUSABLE)
def test_unusable_events_are_refused(change, message):
    events = _events([0, 1, 2, 3])
    check_events(events, 10, 7, "camera 1")
    check_events(events, None, None, "camera 1")
    with pytest.raises(SsacError, match=message):
        check_events(change(events), 10, 7, "camera 1")


def test_consecutive_slices_make_the_whole_and_are_views():
    t = np.sort(np.random.default_rng(0).integers(0, 1000, 500))
    events = _events(t)
    edges = [-10, 0, 17, 17, 500, 999, 1000, 2000]
    slices = [slice_time(events, a, b) for a, b in pairwise(edges)]
    for part, (start, end) in zip(slices, pairwise(edges), strict=True):
        assert np.all((part["t"] >= start) & (part["t"] < end))
    np.testing.assert_array_equal(np.concatenate(slices), events)
    assert np.shares_memory(slices[3], events)


EVEN = np.arange(0, 3, 1 / 30)


@pytest.mark.parametrize(
    ("times_s", "quantum_s"),
    [
        (np.floor(EVEN * 1e3) / 1e3, 0.001),
        (np.floor(EVEN * 1e2) / 1e2, 0.010),
        (np.floor(np.sort(np.random.default_rng(0).random(500)) * 1e3) / 1e3, 0.001),
        (np.arange(0, 3, 1 / 25), 0.0),  # whole milliseconds by the frame rate
        (EVEN, 0.0),
        (np.arange(5.0), 0.0),  # too few to tell
    ],
)
def test_times_that_were_cut_off_are_told_from_even_ones(times_s, quantum_s):
    assert time_quantum_s(times_s) == quantum_s
