"""Data that leave something open: each gets a status and a reason, and what is observable of it."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import Chain, Observation
from ssac.events import EVENT_DTYPE
from tests.ssac.methods import flights
from tests.ssac.methods.flights import CLEAN, DURATION_S, T_D_S, found, scene_of, seen
from tests.ssac.synthetic import make_scene, rotation_angle_deg

FREE = ("ssac", "joint", "tangency")  # of the pose
KNOWN = ("ssac-known", "joint-known", "tangency-known")
ALL = FREE + KNOWN
MOVING = "ambiguous_offset", "too_little_motion", "no_match"
OUTSIDE = "no_match", "search_bound"
REFUSED = [  # path, methods, statuses, words of the reason, fields of the config
    (flights.at_rest, ALL, ("no_motion",), "at rest", {}),
    (flights.at_rest, ALL, ("no_motion",), "at rest", {"search": "all"}),  # Bug: it was no match
    (flights.straight_uniform, FREE, MOVING, "", {"interval_s": (-0.15, 0.25)}),
    (flights.circle, FREE, MOVING, "", {}),
    (flights.helix, FREE, MOVING, "", {"interval_s": (-0.2, 0.3)}),
    # Bug: 25 sample times gave errors of 500 ms with status "ok".
    (flights.free, FREE, ("too_few_samples",), "", {"n_samples": 25}),
    # Bug: an interval of offsets near the recordings' length left few pairs, which F fits.
    (flights.free, FREE, (), "", {"interval_s": (DURATION_S - 1, DURATION_S - 0.1)}),
]


@pytest.mark.parametrize(
    ("path", "method", "statuses", "words", "fields"),
    [
        pytest.param(path, method, *others, id=f"{path.__name__}-{method}-{k}")
        for k, (path, methods, *others) in enumerate(REFUSED)
        for method in methods
    ],
)
def test_what_leaves_all_open_is_refused(path, method, statuses, words, fields):
    estimate = found(path, method, **fields)
    assert estimate.status in statuses or (not statuses and estimate.status != "ok")
    assert words in estimate.reason
    assert estimate.reason
    assert not estimate.has_offset
    assert estimate.R is estimate.t is None


def same_pixel(x):
    events = np.zeros(200_000, EVENT_DTYPE)
    events["t"], events["x"], events["y"] = np.arange(len(events)) * 40, x, 80
    return Observation(events)


@pytest.mark.parametrize(
    ("cameras", "interval_s", "statuses"),
    [
        # Different objects; of so few swings that none tells them from one.
        (lambda one, two, other: (one, other), None, (*OUTSIDE, "too_little_motion")),
        (lambda one, two, other: (one, two.delayed(2.5)), (-1.0, 1.0), OUTSIDE),  # of the search
        (lambda one, two, other: (one, two.delayed(100.0)), (-1.0, 1.0), ("no_common_time",)),
        # Bug: the fit of F divided by the points' spread, zero here.
        (lambda *_: (same_pixel(100), same_pixel(120)), None, ("no_motion", "too_few_samples")),
    ],
    ids=["other-object", "outside", "no-common-time", "one-pixel"],
)
def test_cameras_that_saw_no_one_path_are_refused(cameras, interval_s, statuses):
    scene = make_scene(0, duration_s=DURATION_S)
    (one, two), (_, other) = seen(scene), seen(make_scene(1, duration_s=DURATION_S))
    config = replace(CLEAN, interval_s=interval_s)
    chain = Chain(cameras(one, two, other), scene.rig, config)
    for method in ALL:
        estimate = chain.estimate(method)
        assert estimate.status in statuses
        assert not estimate.has_offset


@pytest.mark.parametrize("method", FREE)
def test_a_straight_line_tells_the_offset_but_no_pose(method):
    estimate = found(flights.straight, method)
    assert estimate.status == "degenerate_pose"
    assert "straight line" in estimate.reason
    assert estimate.R is estimate.t is None
    assert estimate.has_offset
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=5 * estimate.t_d_std_s)
    # 0.1 px of noise in each mean of 1000 events, at 100 px/s and 400 samples: 0.1 ms
    assert estimate.t_d_std_s < 1e-3
    assert estimate.unobservable.shape[1] == 6


@pytest.mark.parametrize("method", KNOWN)
@pytest.mark.parametrize("path", [flights.straight, flights.circle, flights.helix])
def test_a_known_pose_leaves_the_offset_alone_to_be_told(method, path):
    estimate = found(path, method)
    assert estimate.status == "ok"
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=2e-3)  # 0.2 px at 100 px/s


def test_a_plane_leaves_the_fundamental_matrix_open_but_not_the_offset():
    estimate = found(flights.planar, "ssac")
    assert estimate.status == "degenerate_pose"
    assert "plane" in estimate.reason
    assert estimate.R is None
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=5e-3)  # F's family is searched along with it


@pytest.mark.parametrize("method", ["joint", "tangency"])
def test_a_calibrated_pose_is_found_from_a_plane_or_said_to_be_ambiguous(method):
    estimate = found(flights.planar, method)
    assert estimate.has_offset
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=5 * estimate.t_d_std_s)
    if estimate.status == "ok":
        # A plane has a second pose, tens of degrees away; noise moves the true one by less.
        assert rotation_angle_deg(estimate.R, scene_of(flights.planar).R) < 5.0
    else:
        assert estimate.status in ("ambiguous_pose", "degenerate_pose")


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("interval_s", [(-1.0, 1.0), (-3.0, 3.0)])
def test_periodic_motion_names_the_other_offsets(method, interval_s):
    estimate = found(flights.periodic, method, interval_s=interval_s)
    assert estimate.status == "ambiguous_offset"
    offsets_s = np.append(estimate.alternatives_s, estimate.t_d_s)
    assert len(offsets_s) >= 2
    assert np.min(np.abs(offsets_s - T_D_S)) < 0.020  # the coarse step, for ssac's alternatives


def test_too_short_a_flight_tells_no_pose():
    scene = make_scene(0, duration_s=0.6)
    chain = Chain(seen(scene), scene.rig, CLEAN)
    for method in FREE:
        estimate = chain.estimate(method)
        assert estimate.status in ("too_little_motion", "search_bound")
        assert not estimate.has_offset


@pytest.mark.parametrize("angle_deg", [30.0, 150.0])
def test_an_ordinary_flight_is_not_refused(angle_deg):
    scene = make_scene(1, angle_deg, DURATION_S)
    chain = Chain(seen(scene), scene.rig, CLEAN)
    for method in ALL:
        estimate = chain.estimate(method)
        assert estimate.status == "ok", estimate.reason
        assert estimate.t_d_s == pytest.approx(T_D_S, abs=3e-3)  # a few times ssac's usual error
        assert len(estimate.alternatives_s) == len(estimate.unobservable) == 0
