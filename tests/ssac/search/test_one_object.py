"""Several things in view: the object that all cameras saw is chosen, or none is."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import Cameras, Chain, Config, PointTrack, Rig, Status, joint
from ssac.pipeline import retries
from ssac.rules import Rules
from ssac.search.one_object import one_object
from ssac.track.clean import clean
from ssac.track.observation import tracked
from tests.ssac.cluttered import DURATION_S, T_D_S, branches, flight, mixed
from tests.ssac.synthetic import CAMERA, denoised, make_scene, rotation_angle_deg
from tests.ssac.tracks import frame_track

RIG = Rig(CAMERA, CAMERA)
RULES = Rules()
NEAR = (-1.0, 1.0)  # offsets searched
NEAR_S = 3e-4  # an error of up to this is right, whatever the deviation


def crowd(others):
    """Return two cameras that see flight 4 and other things, and the thing of each event."""
    cameras = [mixed(one, other) for one, other in zip(flight(4), others, strict=True)]
    return [denoised(events) for events, _ in cameras], [thing for _, thing in cameras]


def assert_right(found):
    assert found.status == Status.OK, found.reason
    # The mean errors are 0.15 ms and 0.2 deg for clouds of 16 px in the 4 of 8 s that are kept.
    assert abs(found.t_d_s - T_D_S) < max(3.5 * found.t_d_std_s, NEAR_S)
    assert rotation_angle_deg(found.R, make_scene(4).R) < max(3.5 * found.r_std_deg, 0.5)


@pytest.fixture(scope="module")
def two_flights():
    """Return two cameras that see both flights, the flight of each event, and the choice."""
    cameras, things = crowd(flight(5))
    return cameras, things, one_object(cameras, RULES, NEAR)


@pytest.mark.parametrize(
    ("others", "n_seen", "most_of_other"),
    [
        # Either flight may be kept at an instant, as both support the same geometry.
        (None, [2, 2], 1.0),
        (lambda: flight(5, 0.1), [2, 2], 1.0),
        # Only a few of the times that are kept hold both things.
        (lambda: (flight(5)[0], flight(6)[1]), [2, 2], 0.1),
        # Few leaves lie beyond the cells that leaves fill in a third of the bins.
        (lambda: (branches(1), branches(2)), [5, 4], 0.02),
    ],
    ids=["as-dense", "a-tenth", "other-in-each-view", "branches"],
)
def test_other_things_are_left_out(others, n_seen, most_of_other, two_flights):
    cameras, things, (found, refusal) = two_flights
    if others is not None:
        cameras, things = crowd(others())
        found, refusal = one_object(cameras, RULES, NEAR)
    assert refusal is None
    assert [left.used.seen for left in found] == n_seen
    for camera, left, thing in zip(cameras, found, things, strict=True):
        assert left.used.share == len(left.events) / len(camera.events)
        # No event that is kept lies in a gap.
        times_us = left.events["t"]
        at = np.searchsorted(left.gaps_us[:, 1], times_us, side="right")
        assert np.all(times_us < left.gaps_us[at, 0])
        kept = np.isin(camera.events["t"], times_us)
        bins = (camera.events["t"][kept] - camera.events["t"][0]) // RULES.objects.bin_us
        share_of_other = np.bincount(bins, thing[kept])[bins] / np.bincount(bins)[bins]
        assert np.mean((share_of_other > 0.1) & (share_of_other < 0.9)) < 0.1
        assert np.mean(thing[kept]) <= most_of_other
    assert_right(joint(*found, RIG))


def test_a_clock_that_shows_more_changes_nothing(two_flights):
    (cam1, cam2), _, (plain, _) = two_flights
    later_us = 123_457
    shifted = (-1.0 + 1e-6 * later_us, 1.0 + 1e-6 * later_us)
    late, _ = one_object([cam1, cam2.delayed(1e-6 * later_us)], RULES, shifted)
    assert np.array_equal(late[0].events, plain[0].events)
    assert np.array_equal(late[1].events["t"] - later_us, plain[1].events["t"])
    # The first and the last bound stand for all earlier and later times, so they do not move.
    moved_us = plain[1].delayed(1e-6 * later_us).gaps_us
    assert np.array_equal(late[1].gaps_us.ravel()[1:-1], moved_us.ravel()[1:-1])


@pytest.mark.parametrize("seen", [slice(None), slice(1), np.r_[0:90, 310:400]])
def test_a_track_beside_a_crowd_is_one_object_where_it_has_points(seen, two_flights):
    (cam1, _), *_ = two_flights
    whole = frame_track(make_scene(4, duration_s=DURATION_S), 2, 50.0, T_D_S)
    track = tracked(PointTrack(whole.times_s[seen], whole.points_px[seen]))
    track = clean(track, CAMERA, Config().cleaning)
    found, refusal = one_object([cam1, track], RULES, NEAR)
    assert (refusal is None) == (len(track.track) > 1)
    if len(track.track) == len(whole):
        assert [left.used.seen for left in found] == [2, 1]
        assert found[1].track is track.track
        assert abs(joint(*found, RIG).t_d_s - T_D_S) < 10 * NEAR_S


def test_noise_that_is_kept_hides_things(two_flights):
    kept = [replace(camera, denoised=False) for camera in two_flights[0]]
    found, _ = one_object(kept, RULES, NEAR)
    assert found[0].events is kept[0].events


def third_camera(one_seed, other_seed):
    return mixed(flight(one_seed, angle_deg=40.0)[1], flight(other_seed, angle_deg=40.0)[1])


def test_three_cameras_keep_one_flight(two_flights):
    """Bug: each pair chose on its own, so that a camera's two pairs were of different flights."""
    cameras, things, _ = two_flights
    third, thing = third_camera(4, 5)
    found, refusal = one_object([*cameras, denoised(third)], RULES, NEAR)
    assert refusal is None
    recorded = (*(camera.events for camera in cameras), third)
    is_second = []  # in tenths of a second of camera 1's clock; NaN where few events are kept
    for left, events, which, t_d_us in zip(
        found, recorded, (*things, thing), (0, 50_000, 50_000), strict=True
    ):
        assert left.used.seen == 2
        kept = np.isin(events["t"], left.events["t"])
        bins = (events["t"][kept] - t_d_us) // 100_000
        n = np.bincount(bins, minlength=80)[:80]
        share = np.bincount(bins, which[kept], 80)[:80] / np.maximum(n, 1)
        is_second.append(np.where(n < 200, np.nan, share > 0.5))
    by_all = np.isfinite(is_second).all(axis=0)
    assert np.count_nonzero(by_all) > 50
    # If one camera loses a thing before another does, a tenth of a second may hold both.
    assert np.mean(np.ptp(np.array(is_second)[:, by_all], axis=0)) < 0.05


def test_an_interval_on_one_side_of_zero_holds_for_any_three_cameras(two_flights):
    one, other = two_flights[0]
    early = third_camera(4, 5)[0]
    early = denoised(early[: len(early) // 2])  # seen for less, it is matched with the others' pair
    cameras = early, one.delayed(0.4), other.delayed(0.8)
    (near, _), (wide, _) = (one_object(cameras, RULES, interval) for interval in ((0.2, 1.0), NEAR))
    assert all(np.array_equal(a.events, b.events) for a, b in zip(near, wide, strict=True))


def test_a_camera_that_saw_other_things_is_refused_without_events(two_flights, monkeypatch):
    monkeypatch.setattr(retries, "WAYS", ())
    third = denoised(third_camera(6, 7)[0])
    chain = Chain((*two_flights[0], third), Cameras((CAMERA,) * 3), Config(interval_s=NEAR))
    for method in ("joint", "ssac", "tangency"):
        found = chain.estimate(method, 0, 2)
        assert (found.method, found.status) == (method, Status.SEVERAL_OBJECTS)
        assert "none of the 2 things that camera 2 sees" in found.reason  # of the pair
        assert not found.has_offset
    # A method of the paper gets all events.
    assert chain.estimate("albl", 0, 2).status != Status.SEVERAL_OBJECTS
    assert len(chain.answer("joint", 0, 2).cleans[1].events) == 0
    assert_right(chain.estimate("joint"))
    _, refusal = one_object([two_flights[0][0], third], RULES, NEAR)
    assert "the cameras see 2 and 2 things at a time" in refusal.reason
