"""When a camera reads its frames out is found among its events, and nowhere else."""

import numpy as np
import pytest

from ssac.rules import BlindRules
from ssac.search import view

DURATION_US = 6_000_000


def blind_spans(times_us):
    return view.blind_spans(times_us, BlindRules())


def busy_times(seed, rate_hz=50_000.0, swing_hz=0.8):
    """Times [us] of an object that swings: events come by its speed, and none where it turns."""
    rng = np.random.default_rng(seed)
    times_us = np.sort(rng.integers(0, DURATION_US, int(rate_hz * 1e-6 * DURATION_US)))
    speed = np.abs(np.cos(2.0 * np.pi * swing_hz * 1e-6 * times_us))
    return times_us[rng.random(len(times_us)) < speed]


def without_frames(times_us, rate_hz, gap_us, phase_us=3_000):
    """Lose the events of each readout, and say when these begin."""
    starts_us = np.arange(phase_us, DURATION_US, 1e6 / rate_hz)
    since_us = times_us - starts_us[np.searchsorted(starts_us[1:], times_us, side="right")]
    return times_us[(since_us < 0.0) | (since_us >= gap_us)], starts_us


def hidden(times_us, spans_us):
    """Lose the events of some spans."""
    for from_us, to_us in spans_us:
        times_us = times_us[(times_us < from_us) | (times_us > to_us)]
    return times_us


def assert_found(times_us, starts_us, rate_hz, gap_us, within_us):
    spans_us = blind_spans(times_us)
    periods_us = np.diff(spans_us[:, 0])
    assert np.median(periods_us) == pytest.approx(1e6 / rate_hz, rel=1e-2)  # events are some us off
    # Where the object is all but at rest at an end of the recording, nothing tells of one.
    assert len(starts_us) - 6 <= len(spans_us) <= len(starts_us)
    nearest = np.abs(spans_us[:, 0, None] - starts_us).min(axis=1)
    # The last event before a readout is a few event times early; 0.5 ms are 25 at full speed.
    assert np.median(nearest) < 500.0
    assert np.median(np.diff(spans_us)) == pytest.approx(gap_us, abs=within_us)


@pytest.mark.parametrize(
    ("rate_hz", "gap_us"),
    [(10.0, 25_000), (25.0, 10_000), (20.0, 5_000), (40.0, 8_000), (50.0, 5_000)],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_readouts_are_found(rate_hz, gap_us, seed):
    assert_found(*without_frames(busy_times(seed), rate_hz, gap_us), rate_hz, gap_us, 1_000.0)


def test_readouts_are_found_among_silences_of_the_object_itself():
    """Between volleys, one for each row of pixels that an edge crosses, it may be silent too."""
    times_us, starts_us = without_frames(busy_times(8), 25.0, 6_000)
    silent_us = np.random.default_rng(8).integers(0, DURATION_US, 70)  # half as many as readouts
    times_us = hidden(times_us, [(from_us, from_us + 3_500) for from_us in silent_us])
    assert_found(times_us, starts_us, 25.0, 6_000, 500.0)


@pytest.mark.parametrize("noise_hz", [3_000, 30_000])
def test_readouts_are_found_among_noise(noise_hz):
    """A blind sensor has no noise either."""
    n = noise_hz * DURATION_US // 1_000_000
    noise_us = np.random.default_rng(7).integers(0, DURATION_US, n)
    noisy_us = np.sort(np.append(busy_times(7), noise_us))
    assert_found(*without_frames(noisy_us, 25.0, 10_000), 25.0, 10_000, 1_000.0)


def test_spans_follow_the_clock():
    times_us, _ = without_frames(busy_times(2), 25.0, 10_000)
    here, there = blind_spans(times_us), blind_spans(times_us + 123_456_789)
    np.testing.assert_array_equal(here + 123_456_789, there)


@pytest.mark.parametrize("rate_hz", [0.0, 300.0, 3_000.0, 50_000.0, 500_000.0])
def test_a_camera_without_frames_is_never_blind(rate_hz):
    assert len(blind_spans(busy_times(3, rate_hz))) == 0


@pytest.mark.parametrize("events", [20, 100, 400])
@pytest.mark.parametrize("swing", [0.0, 0.5])
def test_edges_that_cross_rows_at_once_are_no_readouts(events, swing):
    """A small object's events come in volleys, one for each row of pixels that its edge crosses."""
    time_s = np.arange(0.0, 1e-6 * DURATION_US, 1e-4)
    rows = np.cumsum(1e-4 * 80.0 * (1.0 + swing * np.sin(2.0 * np.pi * 0.7 * time_s)))
    crossings_us = 1e6 * np.interp(np.arange(1.0, rows[-1]), rows, time_s)
    late_us = np.random.default_rng(4).uniform(0.0, 3_000.0, (len(crossings_us), events))
    volleys = np.rint((crossings_us[:, None] + late_us).ravel())
    assert len(blind_spans(np.sort(volleys.astype(np.int64)))) == 0


def test_an_object_that_is_hidden_now_and_then_is_not_blindness():
    rng = np.random.default_rng(6)
    spans_us = [(at, at + rng.integers(3_000, 30_000)) for at in rng.integers(0, DURATION_US, 60)]
    assert len(blind_spans(hidden(busy_times(5), spans_us))) == 0
