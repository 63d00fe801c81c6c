"""Tangents and what is estimated from them, on a spinning box whose corners alone make events."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import joint_known, tangency, two_views
from ssac.estimate import Estimate
from ssac.methods.algorithms import algorithm_2
from ssac.methods.joint import joint_from
from ssac.methods.tangency import TangencyConfig, for_blind, refine_tangents, tangency_from
from tests.ssac.box import CLEAN, T_D_S, box_events, errors, observations, off_the_truth, unit
from tests.ssac.synthetic import (
    HEIGHT,
    WIDTH,
    angle_deg,
    denoised,
    make_scene,
    rotation_angle_deg,
)


def without_frames(events, phase_us):
    """Lose the events of readouts of 10 ms, 25 a second."""
    return events[(events["t"] - phase_us) % 40_000 >= 10_000]


@pytest.mark.parametrize("phases_us", [(3_000, 33_000), (10_000, 0)])
def test_frames_that_blind_the_cameras_do_not_shift_the_offset(phases_us):
    scene = make_scene(0, duration_s=8.0)
    streams = box_events(scene, 0, 0.4)
    blinded = [without_frames(*one) for one in zip(streams, phases_us, strict=True)]
    views = two_views(*observations(*blinded), scene.rig, CLEAN)
    assert all(len(blind.spans_us) > 150 for blind in views.blind)  # of 200
    estimate = refine_tangents(off_the_truth(scene), views)
    assert estimate.status == "ok"
    # As of a lopsided box; with tangents found as ever, 2.0 and 0.5 ms.
    assert np.all(np.array(errors(estimate, scene)) < [0.3, 0.6, 0.3])


def test_nothing_changes_where_no_camera_was_blind():
    scene, config = make_scene(1, duration_s=8.0), TangencyConfig()
    views = two_views(*observations(*box_events(scene, 1)), scene.rig, CLEAN)
    assert for_blind(config, views) is config


def with_thread(events, seed):
    """Events, those of a thread upwards from the box among them, and which these are."""
    rng = np.random.default_rng((seed, 5))
    on = np.sort(rng.choice(len(events), len(events) // 10, replace=False))
    thread = events[on]
    above = rng.integers(1, 40, len(on))
    thread["y"] -= np.minimum(above, thread["y"]).astype(np.uint16)
    both = np.concatenate([events, thread])
    order = np.argsort(both["t"], kind="stable")
    return both[order], order >= len(events)


def test_the_outline_is_that_of_the_object_without_the_line_that_holds_it():
    scene = make_scene(0, duration_s=8.0)
    streams = box_events(scene, 0)
    start, errors_of = off_the_truth(scene), {}
    for told in (False, True):
        held = []
        for events, mask in map(with_thread, streams, (0, 1)):
            held.append(replace(denoised(events), on_line=mask if told else None))
        estimate = refine_tangents(start, two_views(*held, scene.rig, CLEAN))
        assert estimate.status == "ok"
        errors_of[told] = np.array(errors(estimate, scene))
    alone = refine_tangents(start, two_views(*observations(*streams), scene.rig, CLEAN))
    # The same events, so the same tangents, but for rounding of sums.
    assert errors_of[True] == pytest.approx(errors(alone, scene), rel=1e-3, abs=1e-4)
    assert errors_of[False] != pytest.approx(errors_of[True], rel=0.1)


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


def test_samples_sparser_than_the_smoothing_are_answered_alike():
    scene = make_scene(0, duration_s=8.0)
    views = two_views(*observations(*box_events(scene, 0)), scene.rig, CLEAN)
    start = off_the_truth(scene)
    dense = refine_tangents(start, views)
    sparse = replace(CLEAN.rules, tangency=replace(CLEAN.rules.tangency, step_s=0.08))
    views = two_views(*observations(*box_events(scene, 0)), scene.rig, replace(CLEAN, rules=sparse))
    found = refine_tangents(start, views)
    assert found.status == "ok"
    # A quarter of the samples, and eight corners alone: three times the tables' goal.
    assert abs(found.t_d_s - dense.t_d_s) < 0.3e-3


def test_the_start_does_not_matter():
    scene = make_scene(0, duration_s=8.0)
    cameras = observations(*box_events(scene, 0))
    views = two_views(*cameras, scene.rig, CLEAN)
    truth = Estimate("tangency", t_d_s=T_D_S, R=scene.R, t=unit(scene.t))
    one, other = (refine_tangents(start, views) for start in (truth, off_the_truth(scene)))
    assert one.t_d_s == pytest.approx(other.t_d_s, abs=0.03e-3)  # where the rounds stop
    assert rotation_angle_deg(one.R, other.R) < 0.03
    assert angle_deg(one.t, other.t) < 0.03


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


def test_rounds_that_run_out_are_refused():
    """Bug: what the last round had reached was "ok"."""
    scene = make_scene(0, duration_s=6.0)
    views = two_views(*observations(*box_events(scene, 0)), scene.rig, CLEAN)
    assert refine_tangents(off_the_truth(scene), views).status == "ok"
    estimate = refine_tangents(off_the_truth(scene), views, TangencyConfig(max_rounds=1))
    assert estimate.status == "no_convergence"
    assert "still moved" in estimate.reason


def test_tangents_go_back_to_the_search_where_the_mean_is_refused():
    scene = make_scene(0, duration_s=6.0)
    views = two_views(*observations(*box_events(scene, 0)), scene.unknown_rig, CLEAN)
    search = algorithm_2(views)
    refused = replace(
        joint_from(search, views), status="degenerate_pose", reason="too large", R=None, t=None
    )
    estimate = tangency_from(refused, views)
    assert (estimate.method, estimate.status) == ("tangency", "ok")
    alone = tangency_from(replace(refused, start=None), views)  # nothing to go back to
    assert alone.status == "degenerate_pose"
