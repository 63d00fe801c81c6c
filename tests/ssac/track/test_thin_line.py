"""A line that holds the object is found, in any direction, and nothing else is taken for one."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.config import Cleaning, Config
from ssac.events import events_from_arrays
from ssac.rules import LineRules, NoiseRules
from ssac.track.clean import clean
from ssac.track.denoise import without_noise
from ssac.track.motion import motion_of
from ssac.track.observation import Observation
from ssac.track.thin_line import events_on_line
from tests.ssac.cluttered import merged, noise
from tests.ssac.synthetic import CAMERA, HEIGHT, WIDTH

DURATION_S = 3.0
RADIUS_PX = 10.0  # of the object, a disc
NOISE = noise(WIDTH, HEIGHT, 0.5, round(1e6 * DURATION_S))


def centres_px(times_s):
    """Path (n, 2) of the object's middle."""
    return np.column_stack(
        [173.0 + 60.0 * np.sin(2.1 * times_s), 130.0 + 40.0 * np.sin(3.3 * times_s + 1.0)]
    )


def drawn(times_s, points_px):
    """Events at places (n, 2), as far as these are in view."""
    pixels = np.rint(points_px)
    seen = np.all((pixels >= 0) & (pixels < [WIDTH, HEIGHT]), axis=1)
    at_us = np.rint(1e6 * times_s[seen]).astype(np.int64)
    x, y = pixels[seen].astype(np.int64).T
    return events_from_arrays(at_us, x, y, np.ones(len(x), np.int64))


def disc(seed=0, rate_hz=25_000):
    """Events of the object."""
    rng = np.random.default_rng((seed, 1))
    times_s = np.sort(rng.uniform(0.0, DURATION_S, round(rate_hz * DURATION_S)))
    away = RADIUS_PX * np.sqrt(rng.random(len(times_s)))
    around = rng.uniform(0.0, 2.0 * np.pi, len(times_s))
    turned = np.column_stack([np.cos(around), np.sin(around)])
    return drawn(times_s, centres_px(times_s) + away[:, None] * turned)


def angles_rad(times_s, towards_deg):
    """Direction of a thread that swings by some 10 deg to either side."""
    return np.deg2rad(towards_deg) + 0.2 * np.sin(4.0 * times_s)


def thread(towards_deg, length_px=400.0, rate_hz=150.0, goes_along=True, seed=0):
    """Events of a line from the object's rim on, `rate_hz` on each of its pixels."""
    rng = np.random.default_rng((seed, 2))
    times_s = np.sort(rng.uniform(0.0, DURATION_S, round(rate_hz * length_px * DURATION_S)))
    away = RADIUS_PX + rng.uniform(0.0, length_px, len(times_s))
    angle = angles_rad(times_s, towards_deg)
    turned = np.column_stack([np.cos(angle), np.sin(angle)])
    from_px = centres_px(times_s) if goes_along else [173.0, 130.0]
    return drawn(times_s, from_px + away[:, None] * turned)


def found_in(*streams):
    """What denoising leaves, and which of it is found to be of a line."""
    events = merged(*streams)
    kept, _ = without_noise(events, WIDTH, HEIGHT, None, NoiseRules())
    return kept, events_on_line(events, kept, WIDTH, HEIGHT, LineRules())


@pytest.mark.parametrize("towards_deg", [-90.0, 0.0, 40.0, 180.0])
def test_a_thread_is_found_on_whichever_side_it_is(towards_deg):
    kept, mask = found_in(disc(), thread(towards_deg), NOISE)
    times_s = 1e-6 * kept["t"]
    angle = angles_rad(times_s, towards_deg)
    x, y = (np.column_stack([kept["x"], kept["y"]]) - centres_px(times_s)).T
    along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    of_thread = (along > RADIUS_PX + 1.0) & (np.abs(across) < 1.5)
    assert np.count_nonzero(of_thread) > 100  # which denoising leaves beside the object
    assert mask[of_thread].mean() > 0.95  # its place is found to a fraction of a pixel
    # Of the disc, what lies in the strip on that side: 13 % where it is twice the half width.
    share = 2.0 * LineRules.half_width_px * RADIUS_PX / (np.pi * RADIUS_PX**2)
    assert mask[np.hypot(x, y) < RADIUS_PX].mean() == pytest.approx(share, rel=0.15)
    assert mask[along < -2.0].mean() < 1e-3


@pytest.mark.parametrize(
    "beside",
    [
        [],
        [NOISE],
        [thread(-90.0, length_px=15.0), NOISE],  # an antenna: it ends
        [thread(-90.0, goes_along=False), NOISE],  # stays where it is, as the edge of a door
        [noise(WIDTH, HEIGHT, 5.0, round(1e6 * DURATION_S))],
    ],
    ids=["alone", "noise", "antenna", "door", "much noise"],
)
def test_nothing_else_is_taken_for_a_line(beside):
    kept, mask = found_in(disc(), *beside)
    assert len(kept) > 30_000  # the object is there
    assert mask is None


def test_a_line_in_too_little_of_the_recording_is_none():
    short = thread(-90.0)
    short = short[short["t"] < 0.2e6 * DURATION_S]  # of the three tenths that are asked for
    assert found_in(disc(), short, NOISE)[1] is None
    assert events_on_line(NOISE, NOISE[:0], WIDTH, HEIGHT, LineRules()) is None


def test_the_motion_without_the_line_goes_where_the_motion_goes():
    held, free = Observation(merged(disc(), thread(-90.0), NOISE)), Observation(disc())
    one, other = (clean(seen, CAMERA, Cleaning(True, None)) for seen in (held, free))
    assert other.on_line is None
    assert motion_of(other, Config().windows).bare is None
    bare = motion_of(one, Config().windows).bare
    assert len(bare.times_us) == np.count_nonzero(~one.on_line)
    assert np.array_equal(bare.times_us, one.events["t"][~one.on_line])
    late = one.delayed(0.25)
    for config in (Config(), Config(half_window_s=0.01), Config(border_px=9)):  # kept, or made anew
        motion = motion_of(late, config.windows)
        assert np.array_equal(motion.bare.times_us, bare.times_us + 250_000)
        assert motion.bare.half_window_s == motion.half_window_s == config.half_window_s
        assert motion.bare.n_min == motion.n_min
        again = motion_of(replace(late), config.windows)
        assert np.array_equal(again.bare.border_sums, motion.bare.border_sums)
