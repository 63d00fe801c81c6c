"""Tests that disturbances make events where, when and as often as their configuration says."""

from dataclasses import replace

import numpy as np
import pytest

from sim import disturb
from sim.disturb import LAMP_HZ, LAMP_STEPS, DisturbConfig, View, clutter, thinned
from sim.effects.pixels import CLUSTER_PX
from sim.recording import simulate
from sim.render.config import RenderConfig
from sim.render.lattice import Lattice
from tests.sim.scenes import QUICK, rng

VIEW, SMALL_VIEW = View(346, 260, 2.0), View(120, 90, 2.0)

KINDS = {
    "lamp": DisturbConfig(lamp_px=6),
    "clusters": DisturbConfig(hot_clusters=5),
    "noise": DisturbConfig(noise_hz=1.0),
    "branches": DisturbConfig(branches=20_000),
    "people": DisturbConfig(people=3),
    "clouds": DisturbConfig(clouds_px_s=20.0),
}


def drawn(config, seed=0, camera=0):
    return clutter(config, VIEW, seed, camera)


@pytest.mark.parametrize("kind", KINDS)
def test_clutter_is_in_order_within_view_and_time_and_drawn_by_seed_and_camera(kind):
    events = drawn(KINDS[kind])
    assert len(events) > 500
    assert np.all(np.diff(events["t"]) >= 0)
    assert 0 <= events["t"][0] <= events["t"][-1] < 1e6 * VIEW.duration_s
    assert events["x"].max() < VIEW.width
    assert events["y"].max() < VIEW.height
    assert np.array_equal(events, drawn(KINDS[kind]))
    for other in (drawn(KINDS[kind], camera=1), drawn(KINDS[kind], seed=1)):
        assert len(other) != len(events) or not np.array_equal(other, events)


def test_one_disturbance_more_leaves_the_others_as_they_are():
    assert len(drawn(DisturbConfig())) == 0
    both = drawn(DisturbConfig(hot_clusters=5, people=3))
    assert np.array_equal(both, disturb.merged(drawn(KINDS["clusters"]), drawn(KINDS["people"])))


def test_a_lamp_is_a_square_that_flickers_at_100_hz():
    events = drawn(KINDS["lamp"])
    assert np.ptp(events["x"]) + 1 == np.ptp(events["y"]) + 1 == 6
    # Only events that the jitter moves beyond the ends are lost.
    assert len(events) == pytest.approx(36 * VIEW.duration_s * LAMP_HZ * 2 * LAMP_STEPS, rel=1e-3)
    phases = np.exp(2j * np.pi * LAMP_HZ * 1e-6 * events["t"][events["p"] == 1])
    # The two steps are a quarter of a cycle apart; the jitter lowers the mean by 0.2 %.
    assert abs(np.mean(phases)) == pytest.approx(np.cos(np.pi / 4), abs=0.01)
    assert np.mean(events["p"]) == pytest.approx(0.5, abs=1e-3)


def test_hot_clusters_are_squares_of_pixels_that_fire_on_and_on():
    events = drawn(KINDS["clusters"])
    pixels, counts = np.unique(events["x"].astype(int) * 1000 + events["y"], return_counts=True)
    assert len(pixels) == 5 * CLUSTER_PX**2  # of these seeds, no two overlap
    # Medians of 45 log-normal rates scatter by 1.25 * 0.7 / sqrt(45) = 13 %.
    assert np.median(counts) == pytest.approx(disturb.CLUSTER_HZ * VIEW.duration_s, rel=0.4)
    assert events["p"].all()


def test_noise_has_its_rate_everywhere():
    events = drawn(KINDS["noise"])
    expected = VIEW.width * VIEW.height * VIEW.duration_s
    assert len(events) == pytest.approx(expected, abs=5 * np.sqrt(expected))
    halves = [np.mean(events[name] < half) for name, half in (("x", 173), ("y", 130), ("t", 1e6))]
    assert halves == pytest.approx([0.5] * 3, abs=5 * 0.5 / np.sqrt(expected))


def test_branches_stay_about_their_places_and_fire_while_they_move():
    events = drawn(KINDS["branches"])
    assert 10_000 < len(events) <= 20_000  # some sway out of the view
    place = np.unique(events["x"] // 40 * 100 + events["y"] // 40)
    assert len(place) < 45  # of 63 tiles: a dozen places, each in four tiles at most


def test_people_walk_in_over_a_side():
    events = drawn(DisturbConfig(people=1))
    first, last = (events["x"][part].astype(float) for part in (slice(200), slice(-200, None)))
    assert min(first.min(), VIEW.width - 1 - first.max()) < 5
    assert abs(np.median(last) - np.median(first)) > 5  # 10 px/s for a second, at least
    assert np.ptp(events["y"]) <= 0.3 * VIEW.height


def test_of_a_second_object_a_share_is_kept_of_each_camera_by_itself():
    events = drawn(KINDS["noise"])
    assert len(thinned(events, 0.0, 0, 0)) == 0
    np.testing.assert_array_equal(thinned(events, 1.0, 0, 0), events)
    times_us = [set(thinned(events, 0.1, 0, camera)["t"]) for camera in (0, 1)]
    expected = 0.1 * len(events)
    # Each event is kept or dropped by a draw of its own.
    assert len(thinned(events, 0.1, 0, 0)) == pytest.approx(expected, abs=5 * expected**0.5)
    # Both keep one event in a hundred; events that share a microsecond add some times in common.
    assert len(times_us[0] & times_us[1]) < 0.3 * expected
    assert len({disturb.second_seed(seed) for seed in range(100)} | set(range(100))) == 200


def test_wrong_intrinsics_are_draws_of_the_stated_deviations():
    K = np.array([[200.0, 0.0, 173.0], [0.0, 210.0, 130.0], [0.0, 0.0, 1.0]])
    config = DisturbConfig(intrinsics_error=(1.0, 3.0))
    draws = [disturb.wrong_intrinsics(K, config, *each) for each in np.ndindex(400, 2)]
    wrong, deviations_px = map(np.array, zip(*draws, strict=True))
    np.testing.assert_allclose(deviations_px, [[2.0, 2.1, 3.0, 3.0]] * 800)
    errors = (wrong - K)[:, [0, 1, 0, 1], [0, 1, 2, 2]]
    assert np.count_nonzero(wrong - K) == np.count_nonzero(errors)
    # The eight numbers of two cameras are independent, of mean 0 and deviation 1: products of 400
    # pairs of normal draws have means that scatter by 1 / sqrt(400), squares by sqrt(2 / 400).
    drawn_by = (errors / deviations_px).reshape(400, 8)
    assert np.abs(drawn_by.mean(axis=0)).max() < 5 / 400**0.5
    np.testing.assert_allclose(drawn_by.T @ drawn_by / 400, np.eye(8), atol=5 * (2 / 400) ** 0.5)
    exact, none = disturb.wrong_intrinsics(K, DisturbConfig(), 0, 0)
    assert np.array_equal(exact, K)
    assert not none.any()


def test_clutter_bears_the_clock_of_the_camera_that_sees_it():
    drifting = {"t_d_s": 0.25, "skew_ppm": -20_000.0, "clock_jump": (0.7, 0.005)}
    config = replace(QUICK, render=RenderConfig(Lattice(2, 0), check=False), **drifting)
    recording, added = simulate(config, 5), DisturbConfig(noise_hz=0.5)
    spoilt = disturb.disturbed(recording, added, 5)
    for index, (before, after) in enumerate(zip(recording.cameras, spoilt.cameras, strict=True)):
        noise = clutter(added, View(346, 260, 1.0), 5, index)
        t_us = noise["t"].copy()
        if index == 1:  # fast by -2 % about the middle, and late from 0.7 s on
            t_us += np.rint(-0.02 * (noise["t"] - 500_000)).astype(int) + 250_000
            t_us += np.where(noise["t"] >= 700_000, 5_000, 0)
        both = np.sort(np.concatenate([before.events["t"], t_us]))
        np.testing.assert_array_equal(after.events["t"], both)
        assert len(noise) > 30_000


def test_a_sky_has_blue_and_white_and_is_one_again_beyond_its_border():
    sky = disturb.cloudy_sky(SMALL_VIEW, rng(0))
    assert sky.shape == (256, 256)
    low, high = (np.float32(light) for light in (disturb.SKY_LUMINANCE, disturb.CLOUD_LUMINANCE))
    assert sky.min() >= low * (1.0 - 1e-6)  # single precision
    assert sky.max() <= high * (1.0 + 1e-6)
    clear, white = np.mean(sky < 1.01 * low), np.mean(sky > 0.99 * high)
    assert min(clear, white) > 0.05
    # A step across the border is like any other step.
    for turned in (sky, sky.T):
        steps, across = np.diff(turned, axis=0), turned[0] - turned[-1]
        # Unrelated borders differ by some seven times as much; edges of clouds lie unevenly.
        assert np.sqrt(np.mean(across**2)) < 3.0 * np.sqrt(np.mean(steps**2))


def test_clouds_twice_as_fast_make_twice_the_events_all_along():
    slow, fast = (disturb.clouds(SMALL_VIEW, speed, rng(7)) for speed in (4.0, 8.0))
    # In its first half the fast sky moves as far as the slow one in all; later parts differ.
    first = fast[fast["t"] < 1e6]
    assert len(first) == pytest.approx(len(slow), rel=0.02)  # frames lie elsewhere
    # No burst at the start: pixels remember what they saw before.
    assert np.mean(slow["t"] < 2e5) == pytest.approx(0.1, abs=0.03)
