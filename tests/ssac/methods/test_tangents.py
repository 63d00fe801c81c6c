"""Tangents of an outline: their angles, ranks and points, and that these are pairs."""

import numpy as np
import pytest

from ssac import two_views
from ssac.camera import Camera, Rig
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.pose import pencils
from ssac.methods.tangency import TangencyConfig, tangent_pairs
from ssac.track.outline import OutlineConfig, near_outline, tangents
from ssac.track.outline_kernels import (
    above_limit,
    angles_from_course,
    highest_in_blocks,
    ranked_in_windows,
)
from tests.ssac.box import CLEAN, T_D_S, box_events, corners_m, in_view, observations, project, unit
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_scene


def found_tangents(scene, streams, rig):
    """Both views' tangents with the true pose and offset, at times in camera 1's clock."""
    seen = two_views(*observations(*streams), rig, CLEAN)
    motions = seen.motion1, seen.motion2
    times_s = np.arange(0.1, scene.duration_s - 0.1, TangencyConfig().step_s)
    pair = pencils(scene.R, unit(scene.t), rig.cam1.K, rig.cam2.K)
    views = []
    for motion, pencil, clock_s in zip(motions, pair, (times_s, times_s + T_D_S), strict=True):
        near = near_outline(motion, pencil, clock_s, OutlineConfig())
        views.append(tangents(motion, near, pencil, clock_s, OutlineConfig()))
    return times_s, pair, views


def test_a_plane_has_the_same_angle_in_both_views():
    rng = np.random.default_rng(0)
    scene = make_scene(0, angle_deg=60.0)
    points = rng.uniform(-1.0, 1.0, (200, 3)) + np.array([0.0, 0.0, 5.0])
    first, second = pencils(scene.R, unit(scene.t), K, K)
    angles = [
        pencil.angles(project(in_view(points, scene, view), K))
        for view, pencil in enumerate((first, second))
    ]
    np.testing.assert_allclose(angles[0], angles[1], atol=1e-12)  # rounding
    pixels, h = project(points, K), 1e-4
    for axis in range(2):
        step = h * np.eye(2)[axis]
        numeric = (first.angles(pixels + step) - first.angles(pixels - step)) / (2 * h)
        # Central differences of angles of order 1: 1e-16 / 1e-4.
        np.testing.assert_allclose(first.gradients(pixels)[:, axis], numeric, atol=1e-10)


def in_blocks(rng, n_events, n_blocks):
    """Sorted times [us] of events, the blocks' edges [us], and the first event from each on."""
    times_us = np.sort(rng.integers(0, 1_000_000, n_events))
    edges_us = np.linspace(100_000.0, 900_000.0, n_blocks + 1)
    return times_us, edges_us, np.searchsorted(times_us, edges_us)


def test_angles_from_a_course_are_differences_of_angles():
    rng = np.random.default_rng(0)
    scene = make_scene(0, angle_deg=60.0)
    pencil, _ = pencils(scene.R, unit(scene.t), K, K)
    times_us, edges_us, bounds = in_blocks(rng, 3000, 40)
    points = rng.uniform([0.0, 0.0], [WIDTH, HEIGHT], (3000, 2))
    course = pencil.angles(np.array([[WIDTH / 2, HEIGHT / 2]])) + 1e-6 * edges_us  # 1 rad/s
    tangents_of = angles_from_course(
        times_us, points, bounds, edges_us, course, pencil.sine, pencil.cosine
    )
    kept = slice(bounds[0], bounds[-1])
    differences = pencil.angles(points) - np.interp(times_us, edges_us, course)
    differences = (differences + np.pi) % (2 * np.pi) - np.pi
    beyond = np.abs(differences) > np.pi / 2
    np.testing.assert_array_equal(np.isnan(tangents_of[kept]), beyond[kept])
    # A chord in place of an arc of 0.02 rad: 0.02^3 / 36 sqrt(3).
    near = kept.start + np.flatnonzero(~beyond[kept])
    np.testing.assert_allclose(np.arctan(tangents_of[near]), differences[near], rtol=0, atol=1.3e-7)


def test_ranks_are_those_of_all_events_of_a_window():
    rng = np.random.default_rng(1)
    _, _, bounds = in_blocks(rng, 2000, 50)
    values = rng.normal(size=2000)
    values[rng.choice(2000, 50)] = np.nan
    firsts = np.arange(0, 46, 3)
    usable = rng.random(len(firsts)) < 0.8
    for side in (1.0, -1.0):
        tops = highest_in_blocks(values, bounds, side, 9)
        ranked, indices = ranked_in_windows(*tops, firsts, 4, usable, 2, 8)
        for i, first in enumerate(firsts):
            window = values[bounds[first] : bounds[first + 4]]
            descending = np.sort(side * window[np.isfinite(window)])[::-1]
            expected = [descending[2], descending[8]] if usable[i] else [np.nan, np.nan]
            np.testing.assert_array_equal(ranked[i], expected)
            if usable[i]:
                assert side * values[indices[i]] == descending[2]
    few, _ = ranked_in_windows(*tops, firsts, 4, usable | True, 2, 8)
    assert np.isfinite(few).all()
    too_few = highest_in_blocks(values[:20], np.array([0, 2, 4]), 1.0, 9)
    assert np.isnan(ranked_in_windows(*too_few, np.array([0]), 2, usable[:1] | True, 2, 8)[0]).all()
    limits = rng.normal(size=51)
    chosen = above_limit(values, bounds, 1.0, limits)
    block = np.searchsorted(bounds, np.arange(2000), side="right") - 1
    inside = (block >= 0) & (block < 50)
    lower = np.minimum(limits[:-1], limits[1:])[np.clip(block, 0, 49)]
    np.testing.assert_array_equal(chosen, np.flatnonzero(inside & (values > lower)))


@pytest.mark.parametrize("scale", [1, 8])
def test_tangents_touch_the_outermost_corners(scale):
    scene = make_scene(1, duration_s=6.0)
    camera = Camera(np.diag([scale, scale, 1.0]) @ K, scale * WIDTH, scale * HEIGHT)
    streams = box_events(scene, 0, size_m=0.5, scale=scale)
    config_rig = Rig(camera, camera)
    times_s, pair, views = found_tangents(scene, streams, config_rig)
    for view, pencil in enumerate(pair):
        corners = in_view(corners_m(scene, times_s, 0.5), scene, view)
        true_angles = pencil.angles(project(corners, camera.K).reshape(-1, 2)).reshape(-1, 8)
        extremes = true_angles.max(axis=1), true_angles.min(axis=1)
        for found, true in zip(views[view], extremes, strict=True):
            valid = found.valid
            assert valid.sum() > 100
            across = np.linalg.norm(pencil.gradients(found.points_px[valid]), axis=1)
            misses_px = (pencil.angles(found.points_px[valid]) - true[valid]) / across / scale
            # An event is up to 0.7 px from its corner, and those furthest out are taken. Of a finer
            # sensor's pixels little is left, but the corner's course bends within a window.
            assert np.median(np.abs(misses_px)) < (0.7 if scale == 1 else 0.2)
            rates = np.gradient(true, times_s)[valid]
            speeds = np.sum(
                found.velocities_px_s[valid] * pencil.gradients(found.points_px[valid]), axis=1
            )
            # The tangent goes over from corner to corner, where its rate jumps.
            assert np.median(np.abs(speeds - rates)) < 0.1 * np.median(np.abs(rates))


def test_frontier_points_are_pairs():
    scene = make_scene(1, duration_s=6.0)
    streams = box_events(scene, 0, size_m=0.5)
    times_s, _, views = found_tangents(scene, streams, scene.unknown_rig)
    pairs = tangent_pairs(times_s, *views, T_D_S, TangencyConfig())
    K_inverse = np.linalg.inv(K)
    t = unit(scene.t)
    cross = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    F = K_inverse.T @ cross @ scene.R @ K_inverse
    distances = sampson_distance(F, pairs.p1_px, pairs.p2_px)
    assert abs(np.median(distances)) < 0.1  # no bias
    assert np.median(np.abs(distances)) < 0.35  # rounding to pixels, as above
    assert np.median(pairs.weights) == pytest.approx(1.0)
