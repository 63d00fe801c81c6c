"""Blind spans, in which events are lost to frame readouts, and rolling shutters."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from ssac import Config, joint, two_views
from ssac.camera import READOUT_STD_S, Camera, Rig, with_deviations
from ssac.rules import BlindRules
from ssac.search import view
from ssac.search.two_views import shutters_of
from ssac.track.observation import tracked
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_scene
from tests.ssac.tracks import frame_tracks

DURATION_US = 6_000_000


def blind_spans(times_us):
    return view.blind_spans(times_us, BlindRules())


def busy_times(seed, rate_hz=50_000.0):
    """Times [us] of a swinging object's events, whose rate is proportional to its speed."""
    rng = np.random.default_rng(seed)
    times_us = np.sort(rng.integers(0, DURATION_US, int(rate_hz * 1e-6 * DURATION_US)))
    speed = np.abs(np.cos(2.0 * np.pi * 0.8 * 1e-6 * times_us))
    return times_us[rng.random(len(times_us)) < speed]


def without_frames(times_us, rate_hz, gap_us):
    """Remove the events during each readout; return the others and the readouts' starts [us]."""
    starts_us = np.arange(3_000, DURATION_US, 1e6 / rate_hz)
    since_us = times_us - starts_us[np.searchsorted(starts_us[1:], times_us, side="right")]
    return times_us[(since_us < 0.0) | (since_us >= gap_us)], starts_us


def hidden(times_us, spans_us):
    for from_us, to_us in spans_us:
        times_us = times_us[(times_us < from_us) | (times_us > to_us)]
    return times_us


FRAMES = [(10.0, 25_000), (25.0, 10_000), (20.0, 5_000), (40.0, 8_000), (50.0, 5_000)]
NOISES = [(0, 0), (1, 0), (7, 3_000), (7, 30_000)]


@pytest.mark.parametrize(
    ("rate_hz", "gap_us", "seed", "noise_hz", "n_silent", "within_us"),
    [
        *((*frames, *noise, 0, 1_000.0) for frames, noise in product(FRAMES, NOISES)),
        (25.0, 6_000, 8, 0, 70, 500.0),  # half as many silences as readouts
    ],
)
def test_readouts_are_found_among_noise_and_silences_of_the_object_itself(
    rate_hz, gap_us, seed, noise_hz, n_silent, within_us
):
    """Noise stops during a readout, too. Edges fire in volleys, one for each row of pixels."""
    noise_us = np.random.default_rng(7).integers(0, DURATION_US, 6 * noise_hz)
    times_us = np.sort(np.append(busy_times(seed), noise_us))
    times_us, starts_us = without_frames(times_us, rate_hz, gap_us)
    silent_us = np.random.default_rng(8).integers(0, DURATION_US, n_silent)
    spans_us = blind_spans(hidden(times_us, [(at, at + 3_500) for at in silent_us]))
    periods_us = np.diff(spans_us[:, 0])
    assert np.median(periods_us) == pytest.approx(1e6 / rate_hz, rel=1e-2)  # events are some us off
    # A readout cannot be seen if the object is almost at rest at an end of the recording.
    assert len(starts_us) - 6 <= len(spans_us) <= len(starts_us)
    nearest = np.abs(spans_us[:, 0, None] - starts_us).min(axis=1)
    # The last event is a few mean intervals before a readout; 0.5 ms are 25 at full speed.
    assert np.median(nearest) < 500.0
    assert np.median(np.diff(spans_us)) == pytest.approx(gap_us, abs=within_us)


@pytest.mark.parametrize("rate_hz", [0.0, 300.0, 3_000.0, 50_000.0, 500_000.0])
@pytest.mark.parametrize("n_hidden", [0, 60])
def test_a_camera_without_frames_is_never_blind_nor_is_one_whose_object_hides(rate_hz, n_hidden):
    rng = np.random.default_rng(6)
    starts_us = rng.integers(0, DURATION_US, n_hidden)
    spans_us = [(at, at + rng.integers(3_000, 30_000)) for at in starts_us]
    assert len(blind_spans(hidden(busy_times(3, rate_hz), spans_us))) == 0


@pytest.mark.parametrize("events", [20, 100, 400])
@pytest.mark.parametrize("swing", [0.0, 0.5])
def test_edges_that_cross_rows_at_once_are_no_readouts(events, swing):
    time_s = np.arange(0.0, 1e-6 * DURATION_US, 1e-4)
    rows = np.cumsum(1e-4 * 80.0 * (1.0 + swing * np.sin(2.0 * np.pi * 0.7 * time_s)))
    crossings_us = 1e6 * np.interp(np.arange(1.0, rows[-1]), rows, time_s)
    late_us = np.random.default_rng(4).uniform(0.0, 3_000.0, (len(crossings_us), events))
    volleys = np.rint((crossings_us[:, None] + late_us).ravel())
    assert len(blind_spans(np.sort(volleys.astype(np.int64)))) == 0


# --- Rolling shutters ---

T_D_S = 0.1
CONFIG = Config(interval_s=(-0.2, 0.4))
WIDE = 4.0  # deviations: a right answer is further off in 1 of 16,000
CAMERA = with_deviations(Camera(K, WIDTH, HEIGHT))
UNKNOWN = replace(CAMERA, readout_std_s=READOUT_STD_S)


def flight(seed, readouts_s):
    seeds = 2 * seed, 2 * seed + 1
    return [*map(tracked, frame_tracks(make_scene(seed), T_D_S, 1.0, readouts_s, seeds))]


@pytest.mark.parametrize(
    ("seed", "readouts_s"), [(1, (0.020, 0.005)), (5, (0.007, 0.028)), (4, (0.0, 0.0))]
)
def test_readouts_are_found_beside_the_offset(seed, readouts_s):
    cameras = flight(seed, readouts_s)
    found = joint(*cameras, Rig(UNKNOWN, UNKNOWN), CONFIG)
    assert found.status == "ok"
    assert abs(found.t_d_s - T_D_S) < WIDE * found.t_d_std_s
    assert found.t_d_std_s < 2e-3  # two unknown readouts would add half of their 15 ms
    assert np.all(np.abs(found.readouts_s - readouts_s) < WIDE * found.readouts_std_s)
    assert np.all(found.readouts_std_s < 0.5 * READOUT_STD_S)  # told by the tracks, not the prior
    assert np.all(found.readouts_s >= 0.0)
    if max(readouts_s) > 0.0:
        plain = joint(*cameras, Rig(CAMERA, CAMERA), CONFIG)
        assert abs(plain.t_d_s - T_D_S) > WIDE * plain.t_d_std_s
        assert np.isnan(plain.readouts_s).all()


def test_images_move_as_the_readout_says():
    # The lens shifts rows by up to some 10 px, and the shutter reads distorted rows.
    lens = replace(UNKNOWN, distortion_model="radtan", distortion_coeffs=(-0.3, 0.1, 1e-3, -1e-3))
    views = two_views(*flight(2, (0.01, 0.02)), Rig(lens, lens), CONFIG)
    shutters = shutters_of(views)
    readouts_s, step_s, times_s = np.array([0.012, 0.017]), 1e-4, np.linspace(3.0, 17.0, 80)

    def positions(readouts_s):
        motions = shutters.views(views, readouts_s).motions
        return np.stack([motion.sharp_at(times_s).positions_px for motion in motions])

    read_out = shutters.views(views, readouts_s)
    moves = shutters.moves(read_out, (times_s, times_s))
    for k, (motion, by_readout) in enumerate(zip(read_out.motions, moves, strict=True)):
        # A row is read out later by its share of the readout, in the distorted image. Noise of
        # 0.3 px is smoothed, and the path between points 30 ms apart is a pixel off its chord.
        rows = np.interp(times_s, motion.times_s, motion.rows)
        wide = replace(motion, half_window_s=3.0 * motion.half_window_s)
        moved = -rows[:, None] * wide.sharp_at(times_s).velocities_px_s
        off = np.linalg.norm(by_readout[k] - moved, axis=1) / np.linalg.norm(moved, axis=1)
        assert np.nanmedian(off) < 2e-3  # undistorted rows would give 0.01
        step = step_s * np.eye(2)[k]
        numeric = (positions(readouts_s + step) - positions(readouts_s - step)) / (2.0 * step_s)
        errors = np.linalg.norm(np.stack(by_readout) - numeric, axis=2)
        # Points enter and leave the windows, so that noise of 0.3 px changes the velocities, which
        # are about 200 px/s, by some 10 px/s.
        assert np.nanmedian(errors) < 10.0
        assert np.nanmedian(np.linalg.norm(numeric[k], axis=1)) > 50.0
        assert np.all(by_readout[1 - k] == 0.0)
