"""A fit that is far from ordinary is never "ok": its last step's distances are judged."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import Observation, Status, joint, joint_known
from ssac.camera import Rig
from ssac.estimate import Estimate
from ssac.methods.verdict import certain, doubt
from ssac.rules import Rules
from tests.ssac.methods.test_refusal import CLEAN
from tests.ssac.synthetic import make_events, make_scene, rotation_angle_deg

RULES = Rules().verdict
OBJECT_PX = 10.0
T_D_S = 0.05
NEAR_S = 3e-4  # an answer so near is right, whatever its deviation


def normal(spread_px, n=2000):
    return np.random.default_rng(0).normal(0.0, spread_px, n)


def test_ordinary_distances_are_not_doubted():
    for spread_px in (0.0, 0.01, 0.3, 0.9 * RULES.max_spread * OBJECT_PX):
        assert doubt(normal(spread_px), OBJECT_PX, RULES) == ""
    # Long tails of small distances are the rule: a thin tip is missed in one view.
    some = np.random.default_rng(1).standard_cauchy(2000)
    assert doubt(0.02 * np.clip(some, -40.0, 40.0), OBJECT_PX, RULES) == ""


def test_large_distances_are_doubted():
    assert "far for an object of 10.0 px rms" in doubt(
        normal(1.2 * RULES.max_spread * OBJECT_PX), OBJECT_PX, RULES
    )
    # Half as large an object, and the same distances are far.
    assert doubt(normal(0.9 * RULES.max_spread * OBJECT_PX), 0.5 * OBJECT_PX, RULES)


def test_a_tenth_far_out_is_doubted():
    distances_px = normal(0.3)
    distances_px[::10] += 15.0  # where another object pulls the positions away
    assert np.mean(np.abs(distances_px)) > RULES.max_tail * 0.3
    assert "something else moves in view" in doubt(distances_px, OBJECT_PX, RULES)


def test_intrinsics_that_fit_better_are_doubted():
    assert doubt(normal(0.3), OBJECT_PX, RULES, RULES.max_against - 0.1) == ""
    assert "calibrate again" in doubt(normal(0.3), OBJECT_PX, RULES, RULES.max_against + 0.1)


def test_a_doubted_estimate_is_refused():
    found = Estimate("joint", t_d_s=T_D_S, t_d_std_s=1e-4, R=np.eye(3), doubt="too far off")
    refused = certain(found, RULES)
    assert (refused.status, refused.reason) == (Status.POOR_FIT, "too far off")
    assert not refused.has_offset
    assert refused.R is None
    assert certain(replace(found, doubt=""), RULES).status == Status.OK


@pytest.mark.parametrize("share", [0.1, 0.2, 1.0])
def test_a_second_object_is_refused_or_does_no_harm(share):
    scene, other = make_scene(seed=4, duration_s=8.0), make_scene(seed=5, duration_s=8.0)
    streams = []
    for events, clutter in zip(
        make_events(scene, seed=4, t_d_s=T_D_S, size_m=0.4),
        make_events(other, seed=5, t_d_s=T_D_S, rate_hz=25_000.0 * share, size_m=0.4),
        strict=True,
    ):
        mixed = np.concatenate([events, clutter])
        streams.append(mixed[np.argsort(mixed["t"], kind="stable")])
    cameras = [Observation(events) for events in streams]
    found = joint(*cameras, scene.unknown_rig, CLEAN)
    if found.status == Status.OK:
        error_s = abs(found.t_d_s - T_D_S)
        assert error_s < max(3.5 * found.t_d_std_s, NEAR_S)
        assert rotation_angle_deg(found.R, scene.R) < max(3.5 * found.r_std_deg, 0.3)
    else:
        assert found.reason


def test_extrinsics_of_another_rig_are_refused_or_widen_the_deviation():
    scene, other = make_scene(seed=4, duration_s=8.0), make_scene(seed=4, angle_deg=97.0)
    streams = make_events(scene, seed=4, t_d_s=T_D_S, size_m=0.4)
    cameras = [Observation(events) for events in streams]
    assert joint_known(*cameras, scene.rig, CLEAN).status == Status.OK
    wrong = Rig(scene.rig.cam1, scene.rig.cam2, other.rig.T_2_1)
    found = joint_known(*cameras, wrong, CLEAN)
    is_held = abs(found.t_d_s - T_D_S) < 3.5 * found.t_d_std_s
    assert found.status != Status.OK or is_held
