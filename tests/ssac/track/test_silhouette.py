"""Silhouettes of shapes that move before an ideal sensor: their centres are known."""

from functools import cache

import numpy as np
import pytest

from ssac.camera import Camera
from ssac.events import events_from_arrays
from ssac.rules import SilhouetteRules
from ssac.track.silhouette import Silhouettes, silhouettes

SIZE = 320
CAMERA = Camera(np.array([[100.0, 0.0, 160.0], [0.0, 100.0, 160.0], [0.0, 0.0, 1.0]]), SIZE, SIZE)
MIDDLE = np.array([160.3, 159.8])
WINDOW = 50  # that is drawn; a shape is within
LIGHT, DARK = 0.4, 0.05
THRESHOLD = 0.25
SPEED_PX_S, STEP_PX = 200.0, 0.1
FINE = 5  # samples across a pixel


def disc(u, v):
    """A disc of 13 px, some 9 px rms."""
    return np.hypot(u, v) < 13.0


def corner(u, v):
    """An L of arms 6 px wide and 30 and 20 px long, whose hull's centre is 4 px off its own."""
    along = (np.abs(u) < 3.0) & (np.abs(v) < 15.0)
    return along | ((u > 0.0) & (u < 20.0) & (v > 9.0) & (v < 15.0))


@cache
def recorded(shape, angle_deg, object_luminance=DARK, length_px=240.0):
    """Events of a shape that crosses the view; and times, true centres and moments."""
    way = np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    along = np.arange(-0.5 * length_px, 0.5 * length_px, STEP_PX)
    times_us = 1e6 * (along - along[0]) / SPEED_PX_S
    grid = (np.arange(FINE) + 0.5) / FINE - 0.5
    local = (np.arange(WINDOW)[:, None] + grid).ravel()
    reference = np.full((SIZE, SIZE), np.log(LIGHT))
    before = reference.copy()
    rows = []
    for i, s in enumerate(along):
        middle = MIDDLE + s * way
        left, top = np.rint(middle).astype(int) - WINDOW // 2
        u, v = np.meshgrid(left + local - middle[0], top + local - middle[1])
        share = shape(u, v).reshape(WINDOW, FINE, WINDOW, FINE).mean(axis=(1, 3))
        now = np.log(LIGHT + (object_luminance - LIGHT) * share)
        part = np.s_[top : top + WINDOW, left : left + WINDOW]
        held, was = reference[part], before[part]  # views
        if i == 0:
            held[:] = now
        change = now - held
        while np.abs(change).max() >= THRESHOLD:
            y, x = np.nonzero(np.abs(change) >= THRESHOLD)
            up = change[y, x] > 0.0
            held[y, x] += np.where(up, THRESHOLD, -THRESHOLD)
            done = (held[y, x] - was[y, x]) / (now[y, x] - was[y, x])
            t = times_us[i - 1] + done * (times_us[i] - times_us[i - 1])
            rows.append(np.column_stack([t, left + x, top + y, up]))
            change = now - held
        was[:] = now
    table = np.concatenate(rows)
    table = table[np.argsort(table[:, 0], kind="stable")]
    events = events_from_arrays(*np.rint(table).astype(np.int64).T)
    fine = np.arange(-25.0, 25.0, 0.05)
    u, v = np.meshgrid(fine, fine)
    inside = shape(u, v)
    offset = np.array([u[inside].mean(), v[inside].mean()])
    spread = np.cov(u[inside], v[inside])
    times_s = np.arange(0.005, 1e-6 * times_us[-1] - 0.005, 0.01)
    centres = MIDDLE + (along[0] + SPEED_PX_S * times_s)[:, None] * way + offset
    return events, times_s, centres, spread


def found_of(events, times_s, track_px, spread) -> Silhouettes | None:
    sizes = np.full(len(times_s), np.sqrt(np.trace(spread)))
    return silhouettes(events, CAMERA, times_s, track_px, sizes, SilhouetteRules())


@pytest.mark.parametrize("shape", [disc, corner])
@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0, 180.0])  # along edges of the L, and not
def test_the_centre_of_the_area_is_found_whichever_way_it_moves(shape, angle_deg) -> None:
    events, times_s, centres, spread = recorded(shape, angle_deg)
    # The mean of the events is elsewhere, and is all that the track tells.
    track = centres + np.array([0.8, -0.6])
    found = found_of(events, times_s, track, spread)
    assert found is not None
    known = found.known
    # Where it was at the start no pixel was seen bare: for as far as its box reaches.
    assert known[len(known) // 2 :].mean() > 0.9
    off = (found.centres_px - centres)[known]
    # What share of a pixel a level stands for is that of a middling contrast, not of this one: an
    # edge is off by 0.2 px at most, and edges on both sides the more alike the longer they are.
    assert np.abs(off.mean(axis=0)).max() < 0.2
    assert np.sqrt(np.mean(off**2)) < 0.2
    told = found.spreads_px2[known].mean(axis=0)
    # An edge's blur of a pixel widens it, and its faint half that has no event narrows it.
    scale = np.trace(spread)
    assert told == pytest.approx([spread[0, 0], spread[0, 1], spread[1, 1]], abs=0.08 * scale)


def test_a_bright_object_has_the_centre_of_a_dark_one() -> None:
    events, times_s, centres, spread = recorded(corner, 37.0, object_luminance=0.95)
    found = found_of(events, times_s, centres, spread)
    assert found is not None
    # Contrast is that of three and a half thresholds, so that levels are coarser.
    assert np.abs((found.centres_px - centres)[found.known].mean(axis=0)).max() < 0.3


def test_a_delayed_clock_shows_the_same_to_the_last_bit() -> None:
    events, times_s, track_px, spread = recorded(corner, 37.0)
    later = events.copy()
    later["t"] += 123_457
    one = found_of(events, times_s, track_px, spread)
    # The track is told on this clock, with rounding errors of its own.
    other = found_of(later, times_s + 0.123457, track_px * (1.0 + 1e-13), spread)
    np.testing.assert_array_equal(one.centres_px, other.centres_px)
    np.testing.assert_array_equal(one.spreads_px2, other.spreads_px2)
    np.testing.assert_array_equal(one.images.shares, other.images.shares)


def test_an_image_too_small_has_no_silhouette() -> None:
    events, times_s, centres, spread = recorded(disc, 0.0)
    small = np.diag([0.99 * SilhouetteRules.min_size_px, 0.0]) ** 2
    assert found_of(events, times_s, centres, small) is None
    assert found_of(events, times_s, centres, spread) is not None


def test_events_that_do_not_close_tell_no_silhouette() -> None:
    """A pixel that was left is to be where it had been: it is not, if events were taken out."""
    there = [recorded(corner, angle) for angle in (0.0, 180.0)]
    events, times_s, centres, spread = there[0]
    back = there[1][0].copy()
    back["t"] += events["t"][-1] + 100_000
    both = np.concatenate([events, back])
    shift_s = 1e-6 * (events["t"][-1] + 100_000)
    both_s = np.concatenate([times_s, there[1][1] + shift_s])
    track = np.concatenate([centres, there[1][2]])
    assert found_of(both, both_s, track, spread) is not None
    thinned = both[np.random.default_rng(0).random(len(both)) < 0.5]
    assert found_of(thinned, both_s, track, spread) is None
