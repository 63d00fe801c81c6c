"""Tangents of a spinning box whose corners alone make events, and what is estimated from them."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import joint_known, two_views
from ssac.camera import Camera, Rig
from ssac.geometry.epipolar import fundamental_from_pose, sampson_distance
from ssac.geometry.pose import pencils
from ssac.methods import tangency as by_tangents
from ssac.methods.algorithms import algorithm_2
from ssac.methods.joint import joint_from
from ssac.track.outline import OutlineConfig, near_outline, tangents
from tests.ssac import box, synthetic
from tests.ssac.cluttered import merged

SCENE = synthetic.make_scene(0, duration_s=6.0)
STREAMS = box.box_events(SCENE, 0)
VIEWS = two_views(*box.observations(*STREAMS), SCENE.unknown_rig, box.CLEAN)
START = box.off_the_truth(SCENE)
TRUTH = replace(START, t_d_s=box.T_D_S, R=SCENE.R, t=box.unit(SCENE.t))


def without_frames(events, phase_us):
    """Lose the events of readouts of 10 ms, 25 a second."""
    return events[(events["t"] - phase_us) % 40_000 >= 10_000]


@pytest.mark.parametrize("phases_us", [(3_000, 33_000), (10_000, 0)])
def test_frames_that_blind_the_cameras_do_not_shift_the_offset(phases_us):
    scene = synthetic.make_scene(0, duration_s=8.0)
    streams = box.box_events(scene, 0, 0.4)
    blinded = [without_frames(*one) for one in zip(streams, phases_us, strict=True)]
    views = two_views(*box.observations(*blinded), scene.rig, box.CLEAN)
    assert all(len(spans_us) > 150 for spans_us in views.alone.blind_us)  # of 200
    estimate = by_tangents.refine_tangents(box.off_the_truth(scene), views)
    assert estimate.status == "ok"
    # As of a lopsided box; with tangents found as ever, 2.0 and 0.5 ms.
    assert np.all(np.array(box.errors(estimate, scene)) < [0.3, 0.6, 0.3])


def test_nothing_changes_where_no_camera_was_blind():
    assert by_tangents.for_blind(VIEWS) is VIEWS


def with_thread(events, seed):
    """Events, those of a thread upwards from the box among them, and which these are."""
    rng = np.random.default_rng((seed, 5))
    thread = events[np.sort(rng.choice(len(events), len(events) // 10, replace=False))]
    above = rng.integers(1, 40, len(thread))
    thread["y"] -= np.minimum(above, thread["y"]).astype(np.uint16)
    order = np.argsort(np.concatenate([events["t"], thread["t"]]), kind="stable")
    return merged(events, thread), order >= len(events)


def test_the_outline_is_that_of_the_object_without_the_line_that_holds_it():
    errors_of = []
    for told in (False, True):
        held = [
            replace(synthetic.denoised(events), on_line=mask if told else None)
            for events, mask in map(with_thread, STREAMS, (0, 1))
        ]
        estimate = by_tangents.refine_tangents(START, two_views(*held, SCENE.rig, box.CLEAN))
        assert estimate.status == "ok"
        errors_of.append(np.array(box.errors(estimate, SCENE)))
    # The same events, so the same tangents, but for rounding of sums.
    alone = box.errors(by_tangents.refine_tangents(START, VIEWS), SCENE)
    assert errors_of[1] == pytest.approx(alone, rel=1e-3, abs=1e-4)
    assert errors_of[0] != pytest.approx(errors_of[1], rel=0.1)


@pytest.mark.parametrize("size_m", [0.2, 1.6])
def test_a_lopsided_object_biases_positions_and_not_tangents(size_m):
    means, outline = [], []
    for seed in range(2):
        scene = synthetic.make_scene(seed, duration_s=8.0)
        cameras = box.observations(*box.box_events(scene, seed, size_m, lopsided=3.0))
        # Whether means so biased are a start at all is for `joint` to say.
        views = two_views(*cameras, scene.rig, box.CLEAN)
        estimate = by_tangents.refine_tangents(box.off_the_truth(scene), views)
        assert estimate.status == "ok"
        outline.append(box.errors(estimate, scene))
        known = joint_known(*cameras, scene.rig, box.CLEAN)
        means.append(1e3 * abs(known.t_d_s - box.T_D_S))
    # A few pixels from 8 s of events, and eight corners alone: three times the tables' marks.
    assert np.all(np.mean(outline, axis=0) < [0.3, 0.6, 0.3])
    if size_m > 1.0:
        assert np.mean(means) > 3.0 * np.mean(outline, axis=0)[0]


def test_neither_the_start_nor_sparse_samples_matter():
    one, other = (by_tangents.refine_tangents(start, VIEWS) for start in (TRUTH, START))
    assert one.t_d_s == pytest.approx(other.t_d_s, abs=0.03e-3)  # where the rounds stop
    assert synthetic.rotation_angle_deg(one.R, other.R) < 0.03
    assert synthetic.angle_deg(one.t, other.t) < 0.03
    # Sparser than the smoothing.
    sparse = by_tangents.refine_tangents(
        START, VIEWS.by(tangency=by_tangents.TangencyConfig(step_s=0.08))
    )
    assert sparse.status == "ok"
    # A quarter of the samples, and eight corners alone: four times the tables' goal.
    assert abs(sparse.t_d_s - one.t_d_s) < 0.4e-3


def test_no_tangents_a_lost_minimum_and_rounds_that_run_out_are_refused():
    """Bug: what the last round had reached was "ok"."""
    once, known = (
        VIEWS.by(tangency=by_tangents.TangencyConfig(max_rounds=1)),
        replace(VIEWS, pose_is_known=True),
    )
    for start, views, status, words in (
        (replace(TRUTH, t_d_s=100.0), VIEWS, "too_few_samples", "only 0 tangents"),
        (replace(TRUTH, t_d_s=box.T_D_S + 0.12), known, "no_convergence", "further than 100 ms"),
        (START, once, "no_convergence", "still moved"),
    ):
        found = by_tangents.refine_tangents(start, views)
        assert (found.status, found.t_d_s) == (status, start.t_d_s)
        assert words in found.reason


def test_tangents_go_back_to_the_search_where_the_mean_is_refused():
    is_open = {"status": "degenerate_pose", "reason": "too large", "R": None, "t": None}
    refused = replace(joint_from(algorithm_2(VIEWS), VIEWS), **is_open)
    estimate = by_tangents.tangency_from(refused, VIEWS)
    assert (estimate.method, estimate.status) == ("tangency", "ok")
    alone = by_tangents.tangency_from(replace(refused, start=None), VIEWS)  # nothing to go back to
    assert alone.status == "degenerate_pose"


def found_tangents(scene, streams, rig):
    """Both views' tangents with the true pose and offset, at times in camera 1's clock."""
    seen = two_views(*box.observations(*streams), rig, box.CLEAN)
    motions = seen.motion1, seen.motion2
    times_s = np.arange(0.1, scene.duration_s - 0.1, by_tangents.TangencyConfig().step_s)
    pair = pencils(scene.R, box.unit(scene.t), rig.cam1.K, rig.cam2.K)
    views = []
    for motion, pencil, clock_s in zip(motions, pair, (times_s, times_s + box.T_D_S), strict=True):
        near = near_outline(motion, pencil, clock_s, OutlineConfig())
        views.append(tangents(motion, near, pencil, clock_s, OutlineConfig()))
    return times_s, pair, views


@pytest.mark.parametrize("scale", [1, 8])
def test_tangents_touch_the_outermost_corners(scale):
    scene = synthetic.make_scene(1, duration_s=6.0)
    camera = Camera(
        np.diag([scale, scale, 1.0]) @ synthetic.K,
        scale * synthetic.WIDTH,
        scale * synthetic.HEIGHT,
    )
    streams = box.box_events(scene, 0, size_m=0.5, scale=scale)
    config_rig = Rig(camera, camera)
    times_s, pair, views = found_tangents(scene, streams, config_rig)
    for view, pencil in enumerate(pair):
        corners = box.in_view(box.corners_m(scene, times_s, 0.5), scene, view)
        true_angles = pencil.angles(box.project(corners, camera.K).reshape(-1, 2)).reshape(-1, 8)
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
    scene = synthetic.make_scene(1, duration_s=6.0)
    streams = box.box_events(scene, 0, size_m=0.5)
    times_s, _, views = found_tangents(scene, streams, scene.unknown_rig)
    pairs = by_tangents.tangent_pairs(times_s, *views, box.T_D_S, by_tangents.TangencyConfig())
    F = fundamental_from_pose(synthetic.K, synthetic.K, scene.R, box.unit(scene.t))
    distances = sampson_distance(F, pairs.p1_px, pairs.p2_px)
    assert abs(np.median(distances)) < 0.1  # no bias
    assert np.median(np.abs(distances)) < 0.35  # rounding to pixels, as above
    assert np.median(pairs.weights) == pytest.approx(1.0)
