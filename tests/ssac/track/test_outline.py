"""The outline of a square that makes events all over itself: its edges are known to be straight."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.camera import Camera
from ssac.events import events_from_arrays
from ssac.geometry.pose import Pencil
from ssac.track.motion import object_motion
from ssac.track.outline import OutlineConfig, highest_in_blocks, near_outline, tangents

WIDTH, HEIGHT, FOCAL_PX = 2000, 1000, 1000.0
SIDE_PX, MIDDLE_Y = 120.0, 500.0
DURATION_S = 4.0
# Epipolar planes that cut the image in level lines: the angle of y is atan((y - 500) / 1000).
LEVEL = Pencil(np.array([0.0, 1.0, -MIDDLE_Y]) / FOCAL_PX, np.array([0.0, 0.0, 1.0]))


def motion_of(times_s, points_px):
    """Motion of events at points (n, 2) between pixels: what is left of a lens's distortion."""
    order = np.argsort(times_s, kind="stable")
    t_us, pixels = np.rint(1e6 * times_s[order]).astype(int), np.rint(points_px[order]).astype(int)
    events = events_from_arrays(t_us, *pixels.T, np.zeros(len(t_us), int))
    camera = Camera(np.diag([FOCAL_PX, FOCAL_PX, 1.0]), WIDTH, HEIGHT)
    motion = object_motion(events, camera, n_min=50)
    sums_px = np.zeros((len(events) + 1, 2))
    np.cumsum(points_px[order], axis=0, out=sums_px[1:])
    return replace(motion, position_sums_px=sums_px)


def square(rate_hz, seed=0):
    """Times and points of a square that drifts along the lines, at even odds all over it."""
    rng = np.random.default_rng(seed)
    times_s = np.sort(rng.uniform(0.0, DURATION_S, rng.poisson(rate_hz * DURATION_S)))
    points_px = SIDE_PX * (rng.random((len(times_s), 2)) - 0.5) + [500.0, MIDDLE_Y]
    points_px[:, 0] += 200.0 * times_s
    return times_s, points_px


def edges_px(motion, config):
    """Heights (2, n) of the tangents, and their spreads."""
    times_s = np.arange(0.1, DURATION_S - 0.1, 0.02)
    near = near_outline(motion, LEVEL, times_s, config)
    found = tangents(motion, near, LEVEL, times_s, config)
    assert all(side.valid.mean() > 0.9 for side in found)
    kept = [(side.points_px[side.valid, 1], side.spreads_px[side.valid]) for side in found]
    return zip(*kept, strict=True)


@pytest.mark.parametrize("rate_hz", [20_000.0, 60_000.0])
def test_the_ranks_give_the_edge_itself(rate_hz):
    """An event of rank k lies k + 1 steps inside an even edge: half the gap of ranks 2 and 8."""
    (upper, lower), spreads = edges_px(motion_of(*square(rate_hz)), OutlineConfig())
    step_px = SIDE_PX / (0.040 * rate_hz)  # between events, of a window of 40 ms
    # 95 windows without common events, each off by two to three steps, and four deviations of that;
    # the outline is put ahead of its events by a twentieth of a pixel at most.
    atol = 4.0 * 2.5 * step_px / np.sqrt(95) + 0.05
    assert np.mean(upper) == pytest.approx(MIDDLE_Y + SIDE_PX / 2, abs=atol)
    assert np.mean(lower) == pytest.approx(MIDDLE_Y - SIDE_PX / 2, abs=atol)
    for spread in spreads:
        assert np.mean(spread) == pytest.approx(6.0 * step_px, rel=0.15)


def test_two_events_beyond_the_edge_hardly_move_it():
    times_s, points_px = square(40_000.0)
    (upper, _), _ = edges_px(motion_of(times_s, points_px), OutlineConfig())
    stray_s = np.arange(0.010, DURATION_S, 0.020)  # two in each window, 20 px out
    stray_px = np.column_stack([500.0 + 200.0 * stray_s, np.full(len(stray_s), MIDDLE_Y + 80.0)])
    disturbed = motion_of(np.append(times_s, stray_s), np.vstack([points_px, stray_px]))
    # They take two ranks, each a step of 0.075 px, and half as much again by the deeper rank.
    (pushed, _), _ = edges_px(disturbed, OutlineConfig())
    assert abs(np.mean(pushed) - np.mean(upper)) < 0.4


def test_a_tangent_cut_off_by_the_border_is_invalid():
    # The upper 3 px of 120 lie in the border of 5 px: too few events to drop the track's samples.
    times_s, points_px = square(40_000.0)
    points_px[:, 1] += HEIGHT - 2.0 - (MIDDLE_Y + SIDE_PX / 2)
    motion = motion_of(times_s, points_px)
    at_s = np.arange(0.1, DURATION_S - 0.1, 0.02)
    assert motion.at(at_s).valid.all()
    near = near_outline(motion, LEVEL, at_s, OutlineConfig())
    upper, lower = tangents(motion, near, LEVEL, at_s, OutlineConfig())
    assert not upper.valid.any()
    assert lower.valid.mean() > 0.9


def test_simultaneous_events_on_one_line_are_ranked_alike_whatever_rounding_does():
    # All events of a row are at one angle: which of them counts must not hang on the last bit.
    n, n_blocks = 400, 20
    values = np.repeat(np.random.default_rng(0).normal(size=n // 4), 4)
    bounds = np.linspace(0, n, n_blocks + 1).astype(np.intp)
    for seed in range(5):
        noise = 1e-15 * np.random.default_rng(seed).normal(size=n)
        for side in (1.0, -1.0):
            _, exact = highest_in_blocks(values, bounds, side, 9)
            _, noisy = highest_in_blocks(values + noise, bounds, side, 9)
            np.testing.assert_array_equal(noisy, exact)
