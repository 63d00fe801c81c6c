"""Data that leave something open: each gets a status and a reason, and what is observable of it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ssac import (
    Estimate,
    Observation,
    joint,
    joint_known,
    ssac,
    ssac_known,
    tangency,
    tangency_known,
)
from ssac.config import Config
from ssac.events import EVENT_DTYPE
from tests.ssac.synthetic import DISTANCE_M, Scene, make_events, make_scene, rotation_angle_deg

T_D_S = 0.05
CLEAN = Config(denoise=False)
DURATION_S = 8.0
MIDDLE = np.array([0.0, 0.0, DISTANCE_M])
AXES = np.linalg.qr(np.array([[1.0, 0.3, 0.5], [0.2, 1.0, -0.4], [-0.3, 0.1, 1.0]]))[0].T

FREE = (ssac, joint, tangency)  # of the pose
KNOWN = (ssac_known, joint_known, tangency_known)
ALL = FREE + KNOWN

Position = Callable[[np.ndarray], np.ndarray]  # (n,) [s] -> (n, 3) [m], camera 1's frame


def scene_of(position: Position, angle_deg: float = 90.0) -> Scene:
    return replace(make_scene(0, angle_deg, DURATION_S), path=position)


def answer(method: Callable[..., Estimate], scene: Scene, config: Config = CLEAN) -> Estimate:
    return method(*seen(scene), scene.rig, config)


def seen(scene: Scene, seed: int = 0) -> list[Observation]:
    return [Observation(events) for events in make_events(scene, seed, T_D_S, size_m=0.4)]


def sway(times_s: np.ndarray) -> np.ndarray:
    """Go to and fro between -1 and 1 without repeating."""
    flight = make_scene(3, duration_s=DURATION_S).path
    return (flight(times_s)[..., :1] - MIDDLE[0]) / 2.0


def free(times_s: np.ndarray) -> np.ndarray:
    return make_scene(0, duration_s=DURATION_S).path(times_s)


def at_rest(times_s: np.ndarray) -> np.ndarray:
    return np.broadcast_to(MIDDLE, (*times_s.shape, 3))


def straight(times_s: np.ndarray) -> np.ndarray:
    return MIDDLE + 1.5 * sway(times_s) * AXES[0]


def straight_uniform(times_s: np.ndarray) -> np.ndarray:
    return MIDDLE + 0.4 * (times_s - DURATION_S / 2)[..., None] * AXES[0]


def circle(times_s: np.ndarray, rise_m_s: float = 0.0) -> np.ndarray:
    turn = 2.0 * np.pi * times_s[..., None] / 2.7
    height = rise_m_s * (times_s[..., None] - DURATION_S / 2)
    around = np.cos(turn) * AXES[0] + np.sin(turn) * AXES[1]
    return MIDDLE + 1.2 * around + height * AXES[2]


def helix(times_s: np.ndarray) -> np.ndarray:
    return circle(times_s, rise_m_s=0.25)


def planar(times_s: np.ndarray) -> np.ndarray:
    flight = make_scene(5, duration_s=DURATION_S).path(times_s) - MIDDLE
    return MIDDLE + 0.8 * flight[..., :2] @ AXES[:2]


def periodic(times_s: np.ndarray, period_s: float = 0.8) -> np.ndarray:
    turn = 2.0 * np.pi * times_s[..., None] / period_s
    return (
        MIDDLE
        + (np.cos(turn) + 0.4 * np.sin(2 * turn)) * AXES[0]
        + (0.8 * np.sin(turn) + 0.3 * np.cos(3 * turn)) * AXES[1]
        + 0.7 * np.cos(2 * turn + 1.0) * AXES[2]
    )


MOVING = "ambiguous_offset", "too_little_motion", "no_match"
OUTSIDE = "no_match", "search_bound"
REFUSED = [  # path, methods, statuses, words of the reason, fields of the config
    (at_rest, ALL, ("no_motion",), "at rest", {}),
    (at_rest, ALL, ("no_motion",), "at rest", {"search": "all"}),  # Bug: it was no match
    (straight_uniform, FREE, MOVING, "", {}),
    (circle, FREE, MOVING, "", {}),
    (helix, FREE, MOVING, "", {}),
    # Bug: 25 sample times gave errors of 500 ms with status "ok".
    (free, FREE, ("too_few_samples",), "", {"n_samples": 25}),
    # Bug: an interval of offsets near the recordings' length left few pairs, which F fits.
    (free, FREE, (), "", {"interval_s": (DURATION_S - 1, DURATION_S - 0.1)}),
]


@pytest.mark.parametrize(
    ("path", "method", "statuses", "words", "fields"),
    [
        pytest.param(path, method, *others, id=f"{path.__name__}-{method.__name__}-{k}")
        for k, (path, methods, *others) in enumerate(REFUSED)
        for method in methods
    ],
)
def test_what_leaves_all_open_is_refused(path, method, statuses, words, fields):
    estimate = answer(method, scene_of(path), replace(CLEAN, **fields))
    assert estimate.status in statuses or (not statuses and estimate.status != "ok")
    assert words in estimate.reason
    assert estimate.reason
    assert not estimate.has_offset
    assert estimate.R is None
    assert estimate.t is None


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize(
    ("other", "later_s", "interval_s", "statuses"),
    [
        (1, 0.0, None, OUTSIDE),  # different objects
        (0, 2.5, None, OUTSIDE),  # an offset outside the search
        (0, 100.0, (-1.0, 1.0), ("no_common_time",)),
    ],
)
def test_cameras_that_saw_no_one_path_are_refused(method, other, later_s, interval_s, statuses):
    scene = make_scene(0, duration_s=DURATION_S)
    cam1 = seen(scene)[0]
    cam2 = seen(make_scene(other, duration_s=DURATION_S))[1].delayed(later_s)
    estimate = method(cam1, cam2, scene.rig, replace(CLEAN, interval_s=interval_s))
    assert estimate.status in statuses
    assert not estimate.has_offset


@pytest.mark.parametrize("method", ALL)
def test_the_same_pixel_all_the_time_is_refused(method):
    """Bug: the fit of F divided by the points' spread, zero here."""
    events = np.zeros(200_000, EVENT_DTYPE)
    events["t"] = np.arange(len(events)) * 40
    events["x"], events["y"] = 100, 80
    elsewhere = events.copy()
    elsewhere["x"] = 120
    cameras = Observation(events), Observation(elsewhere)
    estimate = method(*cameras, scene_of(at_rest).rig, CLEAN)
    assert estimate.status in ("no_motion", "too_few_samples")


@pytest.mark.parametrize("method", FREE)
def test_a_straight_line_tells_the_offset_but_no_pose(method):
    estimate = answer(method, scene_of(straight))
    assert estimate.status == "degenerate_pose"
    assert "straight line" in estimate.reason
    assert estimate.R is None
    assert estimate.t is None
    assert estimate.has_offset
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=5 * estimate.t_d_std_s)
    # 0.1 px of noise in each mean of 1000 events, at 100 px/s and 400 samples: 0.1 ms
    assert estimate.t_d_std_s < 1e-3
    assert estimate.unobservable.shape[1] == 6


@pytest.mark.parametrize("method", KNOWN)
@pytest.mark.parametrize("path", [straight, circle, helix])
def test_a_known_pose_leaves_the_offset_alone_to_be_told(method, path):
    estimate = answer(method, scene_of(path))
    assert estimate.status == "ok"
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=2e-3)  # 0.2 px at 100 px/s


def test_a_plane_leaves_the_fundamental_matrix_open_but_not_the_offset():
    estimate = answer(ssac, scene_of(planar))
    assert estimate.status == "degenerate_pose"
    assert "plane" in estimate.reason
    assert estimate.R is None
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=5e-3)  # F's family is searched along with it


@pytest.mark.parametrize("method", [joint, tangency])
def test_a_calibrated_pose_is_found_from_a_plane_or_said_to_be_ambiguous(method):
    scene = scene_of(planar)
    estimate = answer(method, scene)
    assert estimate.has_offset
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=5 * estimate.t_d_std_s)
    if estimate.status == "ok":
        # A plane has a second pose, tens of degrees away; noise moves the true one by less.
        assert rotation_angle_deg(estimate.R, scene.R) < 5.0
    else:
        assert estimate.status in ("ambiguous_pose", "degenerate_pose")


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("interval_s", [(-1.0, 1.0), (-3.0, 3.0)])
def test_periodic_motion_names_the_other_offsets(method, interval_s):
    estimate = answer(method, scene_of(periodic), replace(CLEAN, interval_s=interval_s))
    assert estimate.status == "ambiguous_offset"
    offsets_s = np.append(estimate.alternatives_s, estimate.t_d_s)
    assert len(offsets_s) >= 2
    assert np.min(np.abs(offsets_s - T_D_S)) < 0.020  # the coarse step, for ssac's alternatives


@pytest.mark.parametrize("method", [joint, joint_known])
def test_clocks_far_apart_are_no_obstacle_where_no_interval_is_given(method):
    """Bug: only the command line searched all offsets then."""
    scene = make_scene(0, duration_s=DURATION_S)
    cam1, cam2 = seen(scene)
    estimate = method(cam1, cam2.delayed(100.0), scene.rig, CLEAN)
    assert estimate.status == "ok"
    assert estimate.t_d_s == pytest.approx(100.0 + T_D_S, abs=5 * estimate.t_d_std_s)


@pytest.mark.parametrize("method", FREE)
def test_too_short_a_flight_tells_no_pose(method):
    estimate = answer(method, make_scene(0, duration_s=0.6))
    assert estimate.status in ("too_little_motion", "search_bound")
    assert not estimate.has_offset


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("angle_deg", [30.0, 150.0])
def test_an_ordinary_flight_is_not_refused(method, angle_deg):
    estimate = answer(method, make_scene(1, angle_deg, DURATION_S))
    assert estimate.status == "ok", estimate.reason
    assert estimate.t_d_s == pytest.approx(T_D_S, abs=3e-3)  # a few times ssac's usual error
    assert len(estimate.alternatives_s) == 0
    assert len(estimate.unobservable) == 0
