"""Several things before two cameras: the object that both saw is chosen, or none is."""

import numpy as np
import pytest

from ssac import Config, Observation, Status, joint
from ssac.camera import Rig
from ssac.objects.objects import BIN_US
from ssac.points import PointTrack
from ssac.search.one_object import one_object
from ssac.tool.registry import Chain
from ssac.track.observation import tracked
from tests.ssac.crowds import CAMERA, DURATION_S, T_D_S, branches, flight, mixed
from tests.ssac.synthetic import make_scene, rotation_angle_deg, track_pair

RIG = Rig(CAMERA, CAMERA)
NEAR_S = 3e-4  # an answer so near is right, whatever its deviation


def seen(*streams):
    return [Observation(events, denoised=True) for events in streams]


def crowd(ones, others):
    """Both cameras' events of two things, and which is which."""
    cameras = [mixed(one, other) for one, other in zip(ones, others, strict=True)]
    return seen(*(events for events, _ in cameras)), [thing for _, thing in cameras]


def assert_right(found, scene):
    assert found.status == Status.OK, found.reason
    # 0.15 ms, 0.2 deg on average for such clouds of 16 px, in the half that is left of 8 s.
    assert abs(found.t_d_s - T_D_S) < max(3.5 * found.t_d_std_s, NEAR_S)
    assert rotation_angle_deg(found.R, scene.R) < max(3.5 * found.r_std_deg, 0.5)


def test_one_thing_passes_as_it_is():
    cameras = seen(*flight(4))
    found = one_object(*cameras, RIG, Config())
    assert found.refusal is None
    assert [(used.seen, used.share) for used in found.objects] == [(1, 1.0), (1, 1.0)]
    for camera, left in zip(cameras, (found.cam1, found.cam2), strict=True):
        assert left.events is camera.events
        assert len(left.gaps_us) == 0


@pytest.mark.parametrize("share", [0.1, 0.2, 1.0])
def test_a_second_flight_is_left_out(share):
    cameras, things = crowd(flight(4), flight(5, share))
    found = one_object(*cameras, RIG, Config())
    assert found.refusal is None
    for camera, left, thing, used in zip(
        cameras, (found.cam1, found.cam2), things, found.objects, strict=True
    ):
        assert used.seen == 2
        assert used.share == len(left.events) / len(camera.events)
        # No event that is left lies in a gap.
        times_us = left.events["t"]
        at = np.searchsorted(left.gaps_us[:, 1], times_us, side="right")
        assert np.all(times_us < left.gaps_us[at, 0])
        # At an instant it is the one or the other: both bear out one geometry.
        kept = np.isin(camera.events["t"], times_us)
        bins = (camera.events["t"][kept] - camera.events["t"][0]) // BIN_US
        share_of_other = np.bincount(bins, thing[kept])[bins] / np.bincount(bins)[bins]
        assert np.mean((share_of_other > 0.1) & (share_of_other < 0.9)) < 0.1
    assert_right(joint(found.cam1, found.cam2, RIG, Config()), make_scene(4))


def test_a_clock_that_shows_more_changes_nothing():
    (cam1, cam2), _ = crowd(flight(4), flight(5))
    later_us = 123_457
    plain = one_object(cam1, cam2, RIG, Config())
    shifted = Config(interval_s=(-1.0 + 1e-6 * later_us, 1.0 + 1e-6 * later_us))
    late = one_object(cam1, cam2.delayed(1e-6 * later_us), RIG, shifted)
    assert np.array_equal(late.cam1.events, plain.cam1.events)
    assert np.array_equal(late.cam2.events["t"] - later_us, plain.cam2.events["t"])
    # But for those before and after all times.
    moved_us = plain.cam2.delayed(1e-6 * later_us).gaps_us
    assert np.array_equal(late.cam2.gaps_us.ravel()[1:-1], moved_us.ravel()[1:-1])


def test_other_things_in_each_view_are_left_out():
    first, second, third = flight(4), flight(5), flight(6)
    cameras, things = crowd(first, (second[0], third[1]))
    found = one_object(*cameras, RIG, Config())
    assert found.refusal is None
    for camera, left, thing in zip(cameras, (found.cam1, found.cam2), things, strict=True):
        chosen = np.isin(camera.events["t"], left.events["t"])
        assert np.mean(thing[chosen]) < 0.1  # times that both things share are a few
    assert_right(joint(found.cam1, found.cam2, RIG, Config()), make_scene(4))


def test_no_object_that_both_see_is_refused():
    cameras, _ = crowd(flight(4), flight(5))
    others, _ = crowd(flight(6), flight(7))
    chain = Chain(cameras[0], others[1], RIG, Config())
    for method in ("ssac", "joint", "tangency"):
        found = chain.estimate(method)
        assert (found.method, found.status) == (method, Status.SEVERAL_OBJECTS)
        assert "the cameras see 2 and 2 things at a time" in found.reason
        assert not found.has_offset
    # What is the paper's is left as it is.
    assert chain.estimate("albl").status != Status.SEVERAL_OBJECTS


def test_swaying_branches_are_left_out_or_told():
    cameras, _ = crowd(flight(4), (branches(1), branches(2)))
    found = one_object(*cameras, RIG, Config())
    if found.refusal is None:
        assert_right(joint(found.cam1, found.cam2, RIG, Config()), make_scene(4))
    else:
        assert found.refusal.status == Status.SEVERAL_OBJECTS


def test_a_track_beside_a_crowd_is_one_object():
    (cam1, _), _ = crowd(flight(4), flight(5))
    times_s = np.arange(0.0, DURATION_S, 0.02)
    points = track_pair(make_scene(4, duration_s=DURATION_S), times_s)[1]
    inside = np.all((points > 0.0) & (points < [CAMERA.width - 1, CAMERA.height - 1]), axis=1)
    track = tracked(PointTrack(times_s[inside] + T_D_S, points[inside]))
    found = one_object(cam1, track, RIG, Config())
    assert found.refusal is None
    assert [used.seen for used in found.objects] == [2, 1]
    assert found.cam2.track is track.track
    assert abs(joint(found.cam1, found.cam2, RIG, Config()).t_d_s - T_D_S) < 10 * NEAR_S


def test_noise_that_is_kept_hides_things():
    cameras, _ = crowd(flight(4), flight(5))
    kept = [Observation(camera.events) for camera in cameras]
    found = one_object(*kept, RIG, Config(denoise=False))
    assert found.cam1.events is kept[0].events
