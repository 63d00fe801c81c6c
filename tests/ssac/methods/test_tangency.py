"""Tangents and what is estimated from them, on a spinning box whose corners alone make events."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.camera import Camera, Rig
from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.events import EVENT_DTYPE
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.pencil import Pencil, pencils
from ssac.methods.algorithms import algorithm_2
from ssac.methods.joint import joint, joint_from, joint_known
from ssac.methods.tangency import (
    TangencyConfig,
    refine_tangents,
    tangency,
    tangency_from,
    tangency_known,
    tangent_pairs,
)
from ssac.search.two_views import two_views
from ssac.track.observation import Observation, object_motions
from ssac.track.outline import OutlineConfig, near_outline, tangents
from ssac.track.outline_kernels import (
    above_limit,
    angles_from_course,
    highest_in_blocks,
    outermost_from_course,
    ranked_in_windows,
)
from tests.ssac.synthetic import HEIGHT, WIDTH, K, angle_deg, make_scene, rotation_angle_deg

CLEAN = Config(denoise=False)
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
T_D_S = 0.05


def corners_m(scene, times_s, size_m):
    """The box's corners (n, 8, 3) [m] in camera 1's frame; it turns about a skew axis."""
    # The last corner sticks out, so that the box has no centre.
    shape = 0.5 * size_m * CORNERS * [1.0, 0.4, 0.7]
    shape[-1] *= 1.6
    turns = Rotation.from_rotvec(np.outer(times_s, [0.3, 0.9, 0.5])).as_matrix()
    return scene.path(times_s)[:, None] + np.einsum("nij,cj->nci", turns, shape)


def in_view(points_m, scene, view):
    """Points in the camera's own frame [m]."""
    return points_m @ scene.R.T + scene.t if view else points_m


def project(points_m, K):
    homogeneous = points_m @ K.T
    return homogeneous[..., :2] / homogeneous[..., 2:]


def box_events(scene, seed, size_m=0.8, t_d_s=T_D_S, lopsided=0.0, scale=1, rate_hz=20_000.0):
    """Events of both cameras at the corners' pixels.

    `lopsided`: how much more often the corners on one side of the box make events, the left side
    in camera 1 and the top in camera 2. `scale`: pixels per pixel of the ordinary camera.
    """
    rng = np.random.default_rng((seed, 3))
    streams = []
    for view, offset_s in enumerate((0.0, t_d_s)):
        n = int(rate_hz * scene.duration_s)
        times_s = np.sort(rng.uniform(0.0, scene.duration_s, n))
        odds = 1.0 + lopsided * (CORNERS[:, view] > 0)
        chosen = rng.choice(8, n, p=odds / odds.sum())
        points = in_view(corners_m(scene, times_s, size_m)[np.arange(n), chosen], scene, view)
        pixels = np.rint(scale * project(points, K))
        seen = np.all((pixels >= 0) & (pixels < [scale * WIDTH, scale * HEIGHT]), axis=1)
        seen &= points[:, 2] > 0.1
        events = np.zeros(int(seen.sum()), EVENT_DTYPE)
        events["t"] = np.rint((times_s[seen] + offset_s) * 1e6)
        events["x"], events["y"] = pixels[seen].T
        streams.append(events)
    return streams


def observations(*streams):
    return [Observation(events) for events in streams]


def unit(v):
    return v / np.linalg.norm(v)


def errors(estimate, scene):
    """Errors of t_d [ms], R [deg] and t [deg]."""
    return (
        abs(estimate.t_d_s - T_D_S) * 1e3,
        rotation_angle_deg(estimate.R, scene.R),
        angle_deg(estimate.t, scene.t),
    )


def off_the_truth(scene):
    """An estimate 2 ms, 1.5 deg and 1.3 deg off."""
    turn = Rotation.from_rotvec([0.01, -0.02, 0.015]).as_matrix()
    t = unit(unit(scene.t) + np.array([0.0, 0.02, 0.01]))
    return Estimate("tangency", t_d_s=T_D_S + 0.002, R=turn @ scene.R, t=t)


def found_tangents(scene, streams, rig):
    """Both views' tangents with the true pose and offset, at times in camera 1's clock."""
    motions = object_motions(*observations(*streams), rig, CLEAN)
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


def test_one_pass_gives_the_angles_and_the_highest_of_both_sides():
    rng = np.random.default_rng(3)
    pencil = Pencil(np.array([0.001, 0.002, -0.5]), np.array([0.0003, -0.0001, 1.0]))
    times_us, edges_us, bounds = in_blocks(rng, 4000, 60)
    sums_px = np.cumsum(rng.integers(0, 300, (4001, 2)), axis=0).astype(np.float64)
    course = rng.normal(0.0, 0.1, 61)
    values, tops, at = outermost_from_course(
        times_us, sums_px, bounds, edges_us, course, pencil.sine, pencil.cosine, 9
    )
    points = np.diff(sums_px, axis=0)
    expected = angles_from_course(
        times_us, points, bounds, edges_us, course, pencil.sine, pencil.cosine
    )
    kept = slice(bounds[0], bounds[-1])
    np.testing.assert_array_equal(values[kept], expected[kept])
    for k, side in enumerate((1.0, -1.0)):
        highest, indices = highest_in_blocks(expected, bounds, side, 9)
        np.testing.assert_array_equal(tops[k], highest)
        np.testing.assert_array_equal(at[k], indices)


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


def test_offset_and_pose_are_recovered():
    for seed in range(4):
        scene = make_scene(seed, angle_deg=(30.0, 60.0, 90.0, 150.0)[seed], duration_s=8.0)
        cameras = observations(*box_events(scene, seed))
        estimate = tangency(*cameras, scene.unknown_rig, CLEAN)
        assert (estimate.status, estimate.method) == ("ok", "tangency")
        assert estimate.t_d_s == pytest.approx(T_D_S, abs=5 * estimate.t_d_std_s)
        assert 0.01e-3 < estimate.t_d_std_s < 0.5e-3
        sigmas_deg = np.degrees(np.sqrt(np.diag(estimate.covariance)))
        # Norms of three and of two errors: 5 deviations as for t_d.
        assert errors(estimate, scene)[1] < 5 * np.linalg.norm(sigmas_deg[1:4])
        assert errors(estimate, scene)[2] < 5 * np.linalg.norm(sigmas_deg[4:])


@pytest.mark.parametrize("size_m", [0.2, 1.6])
def test_a_lopsided_object_biases_positions_and_not_tangents(size_m):
    means, outline = [], []
    for seed in range(2):
        scene = make_scene(seed, duration_s=8.0)
        cameras = observations(*box_events(scene, seed, size_m, lopsided=3.0))
        # Whether means so biased are a start at all is for `joint` to say.
        views = two_views(*cameras, scene.rig, CLEAN)
        estimate = refine_tangents(off_the_truth(scene), views)
        assert estimate.status == "ok"
        outline.append(errors(estimate, scene))
        known = joint_known(*cameras, scene.rig, CLEAN)
        means.append(1e3 * abs(known.t_d_s - T_D_S))
    # A few pixels from 8 s of events, and eight corners alone: three times the tables' marks.
    assert np.all(np.mean(outline, axis=0) < [0.3, 0.6, 0.3])
    if size_m > 1.0:
        assert np.mean(means) > 3.0 * np.mean(outline, axis=0)[0]


def test_noise_does_not_set_the_extremes():
    scene = make_scene(2, duration_s=8.0)
    streams = box_events(scene, 2)
    rng = np.random.default_rng(0)
    noisy = []
    for events in streams:
        # 10 a second, 5 to 20 px from an event: half of the windows have one or two outside.
        noise = events[np.sort(rng.choice(len(events), 80))].copy()
        shifts = rng.uniform(5.0, 20.0, (80, 2)) * rng.choice([-1, 1], (80, 2))
        for field, shift, size in zip("xy", shifts.T, (WIDTH, HEIGHT), strict=True):
            noise[field] = np.clip(np.rint(noise[field] + shift), 0, size - 1)
        both = np.concatenate([events, noise])
        noisy.append(both[np.argsort(both["t"], kind="stable")])
    clean = tangency(*observations(*streams), scene.unknown_rig, CLEAN)
    disturbed = tangency(*observations(*noisy), scene.unknown_rig, CLEAN)
    # A noise event takes one rank: the next is the same corner's in another window's place.
    assert disturbed.t_d_s == pytest.approx(clean.t_d_s, abs=0.1e-3)
    assert rotation_angle_deg(disturbed.R, clean.R) < 0.15
    assert angle_deg(disturbed.t, clean.t) < 0.1


def test_swapping_the_cameras_negates_the_offset():
    scene = make_scene(0, duration_s=8.0)
    cameras = observations(*box_events(scene, 0))
    there = tangency(*cameras, scene.unknown_rig, CLEAN)
    back = tangency(*cameras[::-1], scene.unknown_rig, CLEAN)
    # Other windows of the same events, and where the rounds stop: not a deviation.
    assert back.t_d_s == pytest.approx(-there.t_d_s, abs=there.t_d_std_s)
    sigmas_deg = np.degrees(np.sqrt(np.diag(there.covariance)))
    assert rotation_angle_deg(back.R, there.R.T) < np.linalg.norm(sigmas_deg[1:4])
    assert angle_deg(back.t, -there.R.T @ there.t) < np.linalg.norm(sigmas_deg[4:])


def test_the_start_does_not_matter():
    scene = make_scene(0, duration_s=8.0)
    cameras = observations(*box_events(scene, 0))
    views = two_views(*cameras, scene.rig, CLEAN)
    truth = Estimate("tangency", t_d_s=T_D_S, R=scene.R, t=unit(scene.t))
    one, other = (refine_tangents(start, views) for start in (truth, off_the_truth(scene)))
    assert one.t_d_s == pytest.approx(other.t_d_s, abs=0.03e-3)  # where the rounds stop
    assert rotation_angle_deg(one.R, other.R) < 0.03
    assert angle_deg(one.t, other.t) < 0.03


def test_a_known_pose_stays_and_the_offset_gets_a_deviation():
    scene = make_scene(0, duration_s=8.0)
    cameras = observations(*box_events(scene, 0))
    estimate = tangency_known(*cameras, scene.rig, CLEAN)
    assert (estimate.status, estimate.method) == ("ok", "tangency-known")
    assert np.array_equal(estimate.R, scene.R)
    assert estimate.covariance is None
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=5 * estimate.t_d_std_s)
    assert estimate.t_d_std_s < joint_known(*cameras, scene.rig, CLEAN).t_d_std_s
    with pytest.raises(SsacError, match="no T_2_1"):
        tangency_known(*cameras, scene.unknown_rig, CLEAN)


def test_a_start_that_is_there_need_not_be_searched_for():
    scene = make_scene(0, duration_s=6.0)
    cameras = observations(*box_events(scene, 0))
    start = joint(*cameras, scene.unknown_rig, CLEAN)
    given = tangency_from(start, two_views(*cameras, scene.unknown_rig, CLEAN))
    assert given.t_d_s == tangency(*cameras, scene.unknown_rig, CLEAN).t_d_s


def test_a_refused_start_is_returned_as_it_is():
    scene = make_scene(0, duration_s=4.0)
    cameras = observations(*box_events(scene, 0))
    estimate = tangency(*cameras, scene.rig, replace(CLEAN, n_min=100_000))
    assert (estimate.method, estimate.status) == ("tangency", "too_few_samples")


def test_no_tangents_and_a_lost_minimum_are_refused():
    scene = make_scene(0, duration_s=6.0)
    views = two_views(*observations(*box_events(scene, 0)), scene.rig, CLEAN)
    truth = Estimate("tangency", t_d_s=T_D_S, R=scene.R, t=unit(scene.t))
    nowhere = refine_tangents(replace(truth, t_d_s=100.0), views)
    assert nowhere.status == "too_few_samples"
    assert "only 0 tangents" in nowhere.reason
    views = replace(views, pose_is_known=True)
    far = refine_tangents(replace(truth, t_d_s=T_D_S + 0.12), views)
    assert far.status == "no_convergence"
    assert far.t_d_s == T_D_S + 0.12


def test_rounds_that_run_out_are_refused(monkeypatch):
    """Bug: what the last round had reached was "ok"."""
    scene = make_scene(0, duration_s=6.0)
    views = two_views(*observations(*box_events(scene, 0)), scene.rig, CLEAN)
    assert refine_tangents(off_the_truth(scene), views).status == "ok"
    monkeypatch.setattr("ssac.methods.tangency._ROUNDS", 1)
    estimate = refine_tangents(off_the_truth(scene), views)
    assert estimate.status == "no_convergence"
    assert "still moved" in estimate.reason


def test_a_search_is_not_repeated_where_the_mean_is_refused(monkeypatch):
    """Bug: where `joint` refused, the whole search was done a second time."""
    scene = make_scene(0, duration_s=6.0)
    views = two_views(*observations(*box_events(scene, 0)), scene.unknown_rig, CLEAN)
    search = algorithm_2(views)
    refused = replace(
        joint_from(search, views), status="degenerate_pose", reason="too large", R=None, t=None
    )
    for name in ("algorithm_1", "algorithm_2"):
        monkeypatch.delattr(f"ssac.methods.tangency.{name}")
    estimate = tangency_from(refused, views)
    assert (estimate.method, estimate.status) == ("tangency", "ok")
    alone = tangency_from(replace(refused, start=None), views)  # nothing to go back to
    assert alone.status == "degenerate_pose"
