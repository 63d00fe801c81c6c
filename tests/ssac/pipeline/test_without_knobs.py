"""What nobody set is found out: far and fast clocks, few events, and what is wrong with a rig."""

from dataclasses import replace

import numpy as np
import pytest

import ssac
from ssac.camera import Camera, Rig
from ssac.config import Config
from ssac.estimate import Estimate, Status
from ssac.pipeline.retries import by_several, other_ways
from ssac.track.clean import ObjectsUsed
from ssac.track.denoise import Clutter
from tests.ssac.cluttered import merged, noise
from tests.ssac.synthetic import CAMERA, HEIGHT, WIDTH, K, denoised, make_events, make_scene
from tests.ssac.tracks import frame_track

T_D_S = 0.05
SCENE = make_scene(1, duration_s=8.0)
UNSTATED = Camera(K, WIDTH, HEIGHT)  # whose deviations are those of a good calibration


@pytest.fixture(scope="module")
def events():
    return make_events(SCENE, 1, T_D_S, 20_000.0, 0.1)


def clocked(events, clock):
    moved = events.copy()
    moved["t"] = np.rint(clock(events["t"].astype(np.float64)))
    return moved


def longer(camera, share):
    """Give a camera with focal lengths that are longer by a share, and nothing stated of them."""
    K_longer = camera.K.copy()
    K_longer[[0, 1], [0, 1]] *= 1.0 + share
    return Camera(K_longer, camera.width, camera.height)


@pytest.mark.parametrize("t_d_s", [1.5, -4.0, 3600.0])
def test_clocks_far_apart_are_found(events, t_d_s):
    one, other = events
    moved = clocked(other, lambda t: t + 1e6 * (t_d_s - T_D_S))
    result = ssac.sync(one, moved, [CAMERA, CAMERA])
    assert result.status == Status.OK
    assert abs(result.t_d_s - t_d_s) < 4.0 * result.t_d_std_s


@pytest.mark.parametrize("skew_ppm", [1000.0, -3000.0])
def test_a_fast_clock_is_no_jump(events, skew_ppm):
    one, other = events
    fast = clocked(other, lambda t: (1.0 + 1e-6 * skew_ppm) * t)
    result = ssac.sync(one, fast, [CAMERA, CAMERA])
    assert result.status == Status.OK
    assert abs(result.skew_ppm - skew_ppm) < 4.0 * result.skew_std_ppm
    assert "prior deviation of 1000 ppm" in result.to_dict()["note"]


def test_a_fast_clock_far_away_is_found():
    one, other = make_events(make_scene(1, duration_s=16.0), 1, T_D_S, 20_000.0, 0.1)
    fast = clocked(other, lambda t: 1.003 * t + 42e6)
    result = ssac.sync(one, fast, [CAMERA, CAMERA])
    assert result.status == Status.OK
    assert abs(result.skew_ppm - 3000.0) < 4.0 * result.skew_std_ppm


def test_a_jump_stays_one(events):
    one, other = events
    result = ssac.sync(one, clocked(other, lambda t: t + 20_000.0 * (t > 4e6)), [CAMERA, CAMERA])
    assert result.status == Status.CLOCK_JUMP
    assert result.jump.at_s == pytest.approx(4.0, abs=0.2)  # as far as a second's tries tell


def test_an_interval_that_was_asked_for_is_kept(events):
    one, other = events
    moved = clocked(other, lambda t: t + 4e6)
    result = ssac.sync(one, moved, [CAMERA, CAMERA], interval_s=(-1.0, 1.0))
    assert not result.estimate.has_offset


def test_a_track_at_another_rate_is_found():
    tracks = frame_track(SCENE, 1, 25.0, 0.0), frame_track(SCENE, 2, 30.0, 3.0, 0.71)
    result = ssac.sync(*tracks, [CAMERA, CAMERA])
    assert result.status == Status.OK
    assert 1.0 + 1e-6 * result.skew_ppm == pytest.approx(0.71, abs=1e-3)


def test_few_events_are_enough_where_there_is_no_noise():
    scene = make_scene(2, duration_s=8.0)
    one, other = make_events(scene, 2, T_D_S, 300.0, 0.1)
    result = ssac.sync(one, other, [CAMERA, CAMERA])
    assert result.status == Status.OK
    assert abs(result.t_d_s - T_D_S) < 4.0 * result.t_d_std_s


@pytest.mark.parametrize("share", [0.05, 0.1, -0.1])
def test_no_wrong_focal_length_is_believed(events, share):
    estimate = ssac.sync(*events, [longer(CAMERA, share), UNSTATED]).estimate
    if estimate.status == Status.OK:  # as of a calibration that is less certain
        off_deg = np.degrees(np.arccos((np.trace(estimate.R @ SCENE.R.T) - 1.0) / 2.0))
        assert off_deg < 4.0 * estimate.r_std_deg


def test_a_wrong_focal_length_is_named(events):
    result = ssac.sync(*events, [longer(CAMERA, 0.3), UNSTATED])
    assert result.status == Status.POOR_FIT
    assert "camera 1's focal length wants to be 23 % shorter" in result.reason  # 1 / 1.3


def test_intrinsics_in_doubt_widen_the_deviations(events):
    sure = ssac.sync(*events, [CAMERA, CAMERA])
    less = ssac.sync(*events, [longer(CAMERA, 0.02), UNSTATED])
    assert less.status == Status.OK
    assert "what is seen contradicts the rig: " in less.note
    assert less.estimate.r_std_deg > 1.5 * sure.estimate.r_std_deg


def test_it_is_said_how_far_focal_lengths_turn_the_pose(events):
    right = ssac.sync(*events, [CAMERA, CAMERA]).estimate
    wrong = ssac.sync(*events, [longer(CAMERA, 0.02), longer(CAMERA, 0.02)]).estimate
    turned_deg = np.degrees(np.arccos((np.trace(wrong.R @ right.R.T) - 1.0) / 2.0))
    assert 0.02 * right.per_focal_deg[0] == pytest.approx(turned_deg, rel=0.2)  # to first order


@pytest.mark.parametrize("focal", [0.008, 8.0, 1e6])
def test_focal_lengths_that_are_no_camera_s_are_refused(events, focal):
    K_wrong = np.array([[focal, 0.0, 173.0], [0.0, focal, 130.0], [0.0, 0.0, 1.0]])
    with pytest.raises(ssac.SsacError, match="give them in pixels of this resolution"):
        ssac.sync(*events, [Camera(K_wrong, WIDTH, HEIGHT), CAMERA])


def test_a_principal_point_outside_of_the_image_is_told(events):
    far = Camera(K + np.array([[0.0, 0.0, 300.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), WIDTH, HEIGHT)
    note = ssac.sync(*events, [far, UNSTATED]).note
    assert "camera 1's principal point, (473, 130) px, lies outside of its image" in note


def test_an_inverse_transform_is_told(events):
    inverse = replace(SCENE.rig, T_2_1=np.linalg.inv(SCENE.rig.T_2_1))
    known = ssac.sync(*events, SCENE.rig, known_extrinsics=True)
    assert known.to_dict()["deg_per_percent_of_focals"] == [None, None]  # no pose is estimated
    result = ssac.sync(*events, inverse, known_extrinsics=True)
    assert not result.estimate.has_offset
    assert result.reason.endswith(
        "the rig's transform leads the other way: give its inverse, x2 = T x1"
    )


def test_exchanged_cameras_are_told():
    K_2 = np.array([[330.0, 0.0, 150.0], [0.0, 330.0, 150.0], [0.0, 0.0, 1.0]])
    scene = replace(SCENE, cam2=Camera(K_2, WIDTH, HEIGHT))
    events = make_events(scene, 1, T_D_S, 20_000.0, 0.1)
    result = ssac.sync(*events, Rig(scene.cam2, UNSTATED))
    assert not result.estimate.has_offset
    assert "the intrinsics of the cameras are exchanged in the rig" in result.reason


@pytest.mark.parametrize("seen_hz", [150.0, 0.0])
def test_a_faint_object_is_followed_through_noise_or_said_to_be_hidden(seen_hz):
    scene, noise_hz = make_scene(1, duration_s=12.0), 0.25  # as of a DAVIS346
    faint = make_events(scene, 1, T_D_S, max(seen_hz, 1.0), 0.0)
    noisy = [
        merged(one if seen_hz else one[:0], noise(WIDTH, HEIGHT, noise_hz, 12_000_000, seed))
        for seed, one in enumerate(faint)
    ]
    result = ssac.sync(*noisy, [CAMERA, CAMERA])
    if seen_hz:
        assert result.status == Status.OK
        assert abs(result.t_d_s - T_D_S) < 4.0 * result.t_d_std_s
        assert "followed through the noise" in result.to_dict()["note"]
    else:
        assert result.status == Status.NO_MOTION
        assert "0.25 Hz of each pixel hides it" in result.estimate.reason


@pytest.mark.parametrize(
    ("status", "noise_hz", "asked", "is_tried"),
    [
        (Status.POOR_FIT, 0.1, Config(), True),
        (Status.DEGENERATE_POSE, 0.1, Config(), True),
        (Status.TOO_FEW_SAMPLES, 0.0, Config(), True),
        (Status.POOR_FIT, 0.0, Config(), False),
        (Status.SEARCH_BOUND, 0.1, Config(), False),
        (Status.POOR_FIT, 0.1, Config(n_min=50), False),
    ],
)
def test_less_is_filtered_where_noise_may_explain_a_refusal(
    events, status, noise_hz, asked, is_tried
):
    clutter = Clutter(0, 0, noise_hz, 5.0, 20, 200)
    seen = tuple(replace(denoised(one), clutter=clutter) for one in events)
    ways = list(other_ways(asked, seen, Estimate("joint", status, "why")))
    assert any(way.n_neighbours == 3 and way.n_min == 8 for way in ways) is is_tried


@pytest.mark.parametrize(
    ("status", "things", "said"),
    [
        (Status.AMBIGUOUS_OFFSET, 2, Status.SEVERAL_OBJECTS),
        (Status.TOO_LITTLE_MOTION, 2, Status.SEVERAL_OBJECTS),
        (Status.AMBIGUOUS_OFFSET, 1, Status.AMBIGUOUS_OFFSET),
        (Status.CLOCK_JUMP, 2, Status.CLOCK_JUMP),
        (Status.DEGENERATE_POSE, 2, Status.DEGENERATE_POSE),
        (Status.OK, 2, Status.OK),
    ],
)
def test_what_is_left_of_several_things_is_refused_as_that(events, status, things, said):
    seen = [replace(denoised(one), used=ObjectsUsed(things, 0.4)) for one in events]
    found = by_several(seen, Estimate("joint", status, "why"))
    assert found.status == said
    assert "why" in found.reason
