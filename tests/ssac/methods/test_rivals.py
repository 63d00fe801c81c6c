"""Which of several solutions is taken and which are refused: where the thresholds of that lie."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac import (
    Config,
    Estimate,
    Observation,
    Status,
    joint,
    joint_known,
    ssac,
    two_views,
)
from ssac.methods.hypotheses import Solution, choose
from ssac.methods.joint import joint_from
from ssac.methods.tangency import tangency_from
from ssac.rules import Rules
from tests.ssac.methods.test_refusal import (
    CLEAN,
    DURATION_S,
    MIDDLE,
    T_D_S,
    circle,
    periodic,
    scene_of,
    seen,
)
from tests.ssac.synthetic import Scene, make_events, make_scene


def continued(method, start: Estimate, scene: Scene) -> Estimate:
    """What a refining method makes of a start that is given."""
    return method(start, two_views(*seen(scene), scene.rig, CLEAN))


def nearly_periodic(stray_m: float, from_s: float = 0.0) -> Scene:
    """Go round every 0.8 s, and from a time on stray from that by so much, never alike."""
    wandering = make_scene(7, duration_s=DURATION_S).path

    def path(times_s):
        stray = stray_m * (times_s > from_s)[..., None]
        return periodic(times_s) + stray * (wandering(times_s) - MIDDLE) / 2.5

    return scene_of(path)


@pytest.mark.parametrize(
    ("stray_m", "status"), [(0.01, Status.AMBIGUOUS_OFFSET), (0.02, Status.OK)]
)
def test_an_offset_must_fit_twice_as_well_as_any_other(stray_m, status):
    # The mean of 1000 events is off by 0.2 px. A stray of 0.01 m, 0.4 px, less what the pose takes
    # of it, makes an offset a turn away fit 1.1 to 2 times worse; twice that, 2 to 3.5 times.
    scene = nearly_periodic(stray_m)
    estimate = joint(*seen(scene), scene.rig, CLEAN)
    assert estimate.status == status
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=5e-4)  # a few deviations of joint's


def test_all_but_the_worst_pairs_tell_solutions_apart():
    # For two fifths of the flight an offset a turn away fits as well as the true one.
    scene = nearly_periodic(0.03, from_s=0.4 * DURATION_S)
    assert joint_known(*seen(scene), scene.rig, CLEAN).status == Status.OK


def test_where_the_fundamental_matrix_is_open_other_offsets_are_tried():
    # On a circle each offset has a pose that fits, the wrong ones at 0.1 s too.
    scene = scene_of(circle)
    start = Estimate("ssac", Status.DEGENERATE_POSE, "F is open", t_d_s=T_D_S)
    estimate = continued(joint_from, start, scene)
    assert estimate.status == Status.AMBIGUOUS_OFFSET
    assert not estimate.has_offset


@pytest.mark.parametrize(("std_s", "status"), [(0.001, Status.DEGENERATE_POSE), (0.005, Status.OK)])
def test_tangents_may_not_stray_far_from_a_start_they_are_to_mend(std_s, status):
    scene = make_scene(1, duration_s=DURATION_S)
    found = joint(*seen(scene), scene.rig, CLEAN)
    start = replace(
        found,
        status=Status.DEGENERATE_POSE,
        reason="open",
        t_d_s=T_D_S + 0.005,  # 5 deviations, or 1
        t_d_std_s=std_s,
        R=None,
        t=None,
    )
    assert continued(tangency_from, start, scene).status == status


def test_time_out_of_view_is_no_motion():
    # 0.7 s, 8.3 s of nothing, and 0.7 s: six swings between them that nobody saw.
    scene = make_scene(5, duration_s=12.0)
    streams = make_events(scene, 5, T_D_S, size_m=0.4)
    cameras = []
    for events, offset_s in zip(streams, (0.0, T_D_S), strict=True):
        times_s = 1e-6 * events["t"] - offset_s
        seen_then = ((times_s > 1.0) & (times_s < 1.7)) | ((times_s > 10.0) & (times_s < 10.7))
        cameras.append(Observation(events[seen_then]))
    config = Config(interval_s=(T_D_S - 0.25, T_D_S + 0.25), denoise=False)
    estimate = ssac(*cameras, scene.rig, config)
    assert estimate.status == Status.TOO_LITTLE_MOTION


@pytest.mark.parametrize(
    ("std_rad", "status"),
    [(np.deg2rad(0.5), Status.AMBIGUOUS_POSE), (np.deg2rad(5.5), Status.DEGENERATE_POSE)],
)
def test_an_open_pose_is_degenerate_before_it_is_ambiguous(std_rad, status):
    """Bug: the search put the one first and the refinement the other."""
    variances = [1e-6, std_rad**2, *[1e-6] * 4]
    solutions = [
        Solution(
            Estimate(
                "joint",
                t_d_s=T_D_S,
                t_d_std_s=1e-3,
                R=Rotation.from_euler("y", turn_deg, degrees=True).as_matrix(),
                t=np.array([1.0, 0.0, 0.0]),
                covariance=np.diag(variances),
            ),
            distance_px=distance_px,
            object_px=10.0,
        )
        for turn_deg, distance_px in ((0.0, 0.10), (20.0, 0.11))
    ]
    found = choose(Estimate("joint"), solutions, Rules())
    assert found.status == status
    assert found.t_d_s == T_D_S
    assert found.R is None
