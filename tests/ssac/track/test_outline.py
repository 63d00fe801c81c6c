"""The tangents of an object's outline, a line that holds the object, and things beside it."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import Camera, Observation
from ssac.config import Cleaning, Config
from ssac.events import EVENT_DTYPE, events_from_arrays
from ssac.geometry.pose import Pencil
from ssac.rules import LineRules, NoiseRules, ObjectRules, OutlineRules
from ssac.track.clean import clean
from ssac.track.denoise import without_noise
from ssac.track.motion import motion_of, object_motion
from ssac.track.objects import objects_of, seem_several
from ssac.track.outline import highest_in_windows, near_outline, tangents
from ssac.track.thin_line import events_on_line
from tests.ssac.cluttered import merged, noise
from tests.ssac.synthetic import CAMERA, HEIGHT, WIDTH, events_at, make_events, make_scene

FOCAL_PX = 1000.0
WIDE = Camera(np.diag([FOCAL_PX, FOCAL_PX, 1.0]), 2000, 1000)
SIDE_PX, MIDDLE_Y = 120.0, 500.0
DURATION_S = 4.0
AT_S = np.arange(0.1, DURATION_S - 0.1, 0.02)
# Epipolar planes that cut the image in level lines: the angle of y is atan((y - 500) / 1000).
LEVEL = Pencil(np.array([0.0, 1.0, -MIDDLE_Y]) / FOCAL_PX, np.array([0.0, 0.0, 1.0]))


def motion_between_pixels(times_s, points_px):
    """Motion of events at points (n, 2) between pixels, where undistorted events lie."""
    order = np.argsort(times_s, kind="stable")
    t_us, pixels = np.rint(1e6 * times_s[order]).astype(int), np.rint(points_px[order]).astype(int)
    events = events_from_arrays(t_us, *pixels.T, np.zeros(len(t_us), int))
    motion = object_motion(events, WIDE, n_min=50)
    sums_px = np.zeros((len(events) + 1, 2))
    np.cumsum(points_px[order], axis=0, out=sums_px[1:])
    return replace(motion, position_sums_px=sums_px)


def square(rate_hz):
    """Times and points of events all over a square that drifts along the epipolar lines."""
    rng = np.random.default_rng(0)
    times_s = np.sort(rng.uniform(0.0, DURATION_S, rng.poisson(rate_hz * DURATION_S)))
    points_px = SIDE_PX * (rng.random((len(times_s), 2)) - 0.5) + [500.0, MIDDLE_Y]
    points_px[:, 0] += 200.0 * times_s
    return times_s, points_px


def sides(motion):
    near = near_outline(motion, LEVEL, AT_S, OutlineRules())
    return tangents(motion, near, LEVEL, AT_S, OutlineRules())


def edges_px(motion):
    """Heights (2, n) of the tangents, and their spreads."""
    found = sides(motion)
    assert all(side.valid.mean() > 0.9 for side in found)
    kept = [(side.points_px[side.valid, 1], side.spreads_px[side.valid]) for side in found]
    return zip(*kept, strict=True)


@pytest.mark.parametrize("rate_hz", [20_000.0, 60_000.0])
def test_the_ranks_give_the_edge_itself(rate_hz):
    """Rank k lies k + 1 steps inside an even edge: rank 2 by half the gap of ranks 2 and 8."""
    (upper, lower), spreads = edges_px(motion_between_pixels(*square(rate_hz)))
    step_px = SIDE_PX / (0.040 * rate_hz)  # between events in a window of 40 ms
    # Four deviations of the mean of 95 windows without common events, each off by 2 to 3 steps; the
    # outline is put ahead of its events by a twentieth of a pixel at most.
    atol = 4.0 * 2.5 * step_px / np.sqrt(95) + 0.05
    assert np.mean(upper) == pytest.approx(MIDDLE_Y + SIDE_PX / 2, abs=atol)
    assert np.mean(lower) == pytest.approx(MIDDLE_Y - SIDE_PX / 2, abs=atol)
    for spread in spreads:
        assert np.mean(spread) == pytest.approx(6.0 * step_px, rel=0.15)


def test_two_events_beyond_the_edge_hardly_move_it():
    times_s, points_px = square(40_000.0)
    (upper, _), _ = edges_px(motion_between_pixels(times_s, points_px))
    stray_s = np.arange(0.010, DURATION_S, 0.020)  # two in each window, 20 px out
    stray_px = np.column_stack([500.0 + 200.0 * stray_s, np.full(len(stray_s), MIDDLE_Y + 80.0)])
    disturbed = motion_between_pixels(np.append(times_s, stray_s), np.vstack([points_px, stray_px]))
    # Stray events take two ranks, each a step of 0.075 px; the deeper rank adds half as much again.
    (pushed, _), _ = edges_px(disturbed)
    assert abs(np.mean(pushed) - np.mean(upper)) < 0.4


def test_a_tangent_cut_off_by_the_border_is_invalid():
    # The upper 3 px of 120 lie in the border of 5 px: too few events to make the track invalid.
    times_s, points_px = square(40_000.0)
    points_px[:, 1] += WIDE.height - 2.0 - (MIDDLE_Y + SIDE_PX / 2)
    motion = motion_between_pixels(times_s, points_px)
    assert motion.at(AT_S).valid.all()
    upper, lower = sides(motion)
    assert not upper.valid.any()
    assert lower.valid.mean() > 0.9


def test_simultaneous_events_on_one_line_are_ranked_alike_whatever_rounding_does():
    # All events of a row have one angle: the choice among them must not depend on the last bit.
    n, n_windows = 400, 20
    values = np.repeat(np.random.default_rng(0).normal(size=n // 4), 4)
    bounds = np.linspace(0, n, n_windows + 1).astype(np.intp)
    for seed in range(5):
        noise = 1e-15 * np.random.default_rng(seed).normal(size=n)
        for side in (1.0, -1.0):
            _, exact = highest_in_windows(values, bounds[:-1], bounds[1:], side, 9)
            _, noisy = highest_in_windows(values + noise, bounds[:-1], bounds[1:], side, 9)
            np.testing.assert_array_equal(noisy, exact)


# --- A line that holds it ---

HELD_S = 3.0
RADIUS_PX = 10.0  # of the object, a disc
NOISE = noise(WIDTH, HEIGHT, 0.5, round(1e6 * HELD_S))


def centres_px(times_s):
    return np.column_stack(
        [173.0 + 60.0 * np.sin(2.1 * times_s), 130.0 + 40.0 * np.sin(3.3 * times_s + 1.0)]
    )


def disc():
    rng = np.random.default_rng((0, 1))
    times_s = np.sort(rng.uniform(0.0, HELD_S, round(25_000 * HELD_S)))
    away = RADIUS_PX * np.sqrt(rng.random(len(times_s)))
    around = rng.uniform(0.0, 2.0 * np.pi, len(times_s))
    turned = np.column_stack([np.cos(around), np.sin(around)])
    return events_at(times_s, centres_px(times_s) + away[:, None] * turned)


def angles_rad(times_s, towards_deg):
    """Direction of a thread that swings by some 10 deg to either side."""
    return np.deg2rad(towards_deg) + 0.2 * np.sin(4.0 * times_s)


def thread(towards_deg, length_px=400.0, goes_along=True):
    """Events of a line that begins at the object's rim, 150 a second on each pixel of it."""
    rng = np.random.default_rng((0, 2))
    times_s = np.sort(rng.uniform(0.0, HELD_S, round(150.0 * length_px * HELD_S)))
    away = RADIUS_PX + rng.uniform(0.0, length_px, len(times_s))
    angle = angles_rad(times_s, towards_deg)
    turned = np.column_stack([np.cos(angle), np.sin(angle)])
    from_px = centres_px(times_s) if goes_along else [173.0, 130.0]
    return events_at(times_s, from_px + away[:, None] * turned)


def found_in(*streams):
    """The events that denoising leaves, and the mask of those found to be on a line."""
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
    assert mask[of_thread].mean() > 0.95  # the line is found to a fraction of a pixel
    # The strip on the thread's side, twice the half width wide, holds 13 % of the disc.
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
        [np.array_split(thread(-90.0), 5)[0], NOISE],  # a line needs three tenths of the windows
        [noise(WIDTH, HEIGHT, 5.0, round(1e6 * HELD_S))],
    ],
    ids=["alone", "noise", "antenna", "door", "short", "much noise"],
)
def test_nothing_else_is_taken_for_a_line(beside):
    kept, mask = found_in(disc(), *beside)
    assert len(kept) > 30_000  # the object is there
    assert mask is None
    assert events_on_line(kept, kept[:0], WIDTH, HEIGHT, LineRules()) is None


def test_the_motion_without_the_line_goes_where_the_motion_goes():
    held, free = Observation(merged(disc(), thread(-90.0), NOISE)), Observation(disc())
    one, other = (clean(seen, CAMERA, Cleaning(True, None)) for seen in (held, free))
    assert other.on_line is None
    assert motion_of(other, Config().windows).bare is None
    bare = motion_of(one, Config().windows).bare
    assert np.array_equal(bare.times_us, one.events["t"][~one.on_line])
    late = one.delayed(0.25)
    for config in (Config(), Config(half_window_s=0.01), Config(border_px=9)):  # kept, or made anew
        motion = motion_of(late, config.windows)
        assert np.array_equal(motion.bare.times_us, bare.times_us + 250_000)
        assert motion.bare.half_window_s == motion.half_window_s == config.half_window_s
        assert motion.bare.n_min == motion.n_min
        again = motion_of(replace(late), config.windows)
        assert np.array_equal(again.bare.border_sums, motion.bare.border_sums)


# --- Other things beside it ---

RULES = ObjectRules()


@pytest.mark.parametrize("size_m", [0.2, 0.8, 1.6])  # images of 8, 32 and 64 px
def test_one_thing_is_one_though_the_parts_of_a_large_one_seem_several(size_m):
    streams = make_events(make_scene(6, duration_s=8.0), 6, size_m=size_m)
    assert any(seem_several(one, CAMERA, RULES) for one in streams) == (size_m > 1.0)
    assert not any(objects_of(one, CAMERA, RULES).are_several for one in streams)
    assert not seem_several(np.empty(0, EVENT_DTYPE), CAMERA, RULES)
