"""Tests the types that all stages share: events, cameras, clocks, estimates, and rules."""

import ast
from dataclasses import asdict
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import ssac
from experiments.lab.grid import _flat, configs_of
from sim.scene.rig import Camera as SimulatedCamera
from ssac import Clock, Config, SsacError, checked
from ssac.camera import (
    MAX_ROUND_TRIP_PX,
    Camera,
    check_camera,
    distort_points,
    same_camera,
    undistort_points,
    undistortion_map,
)
from ssac.estimate import POSE_IS_OPEN, Estimate, Refusal, Status, first
from ssac.events import EVENT_DTYPE, check_events, events_from_arrays, time_quantum_s
from ssac.rules import Rules, VerdictRules


@pytest.mark.parametrize("dtype", [np.int8, np.int64, bool])
def test_every_value_is_kept_but_a_polarity_of_minus_one_and_arguments_stay(dtype):
    p = np.array([0 if dtype is bool else -1, 1, 1], dtype=dtype)
    before = p.tolist()
    events = events_from_arrays([-5, 0, 2**62], [0, 1, 65535], [3, 4, 5], p)
    assert events.dtype == EVENT_DTYPE
    assert events.tolist() == [(-5, 0, 3, 0), (0, 1, 4, 1), (2**62, 65535, 5, 1)]
    assert p.tolist() == before


@pytest.mark.parametrize(("t", "x"), [(0.1, 0), (0, -1), (0, 65536)])
def test_arrays_that_make_no_events_are_refused(t, x):
    with pytest.raises(SsacError, match=r"t must hold whole numbers|x must lie in 0 to 65535"):
        events_from_arrays([t], [x], [0], [0])


def _with(events, field, value, at=3):
    other = events.copy()
    other[field][at] = value
    return other


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda e: e[::-1], "event 1 is at 2 us, after one at 3 us: copy or record it again if"),
        (lambda e: e.astype([("t", "<f8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")]), "1-D array"),
        (lambda e: e.reshape(2, 2), "1-D array of"),
        (lambda e: _with(e, "y", 7), "sensor is 10 x 7 px, .* at y = 7"),
        (lambda e: _with(e, "p", 2), "polarity must be 0 or 1, got 2"),
        (lambda e: _with(e, "t", 2**24 - 5, 2), r"anew at event 3, .* 24 bits .*; do not sort"),
    ],
)
def test_unusable_events_are_refused(change, message):
    each = np.arange(4)
    events = events_from_arrays(each, each, each, each % 2)
    check_events(events, 10, 7, "camera 1")
    check_events(events, None, None, "camera 1")
    with pytest.raises(SsacError, match=message):
        check_events(change(events), 10, 7, "camera 1")


EVEN = np.arange(0, 3, 1 / 30)
UNEVEN = np.sort(np.random.default_rng(0).random(500))
LOST = np.random.default_rng(1).random(1000)


@pytest.mark.parametrize(
    ("times_s", "quantum_s"),
    [
        (np.floor(EVEN * 1e3) / 1e3, 0.001),
        (np.floor(EVEN * 1e2) / 1e2, 0.010),
        # At a frame every one to two steps, all gaps are whole multiples of the least.
        *((np.floor(1e2 * np.arange(0.003, 3, 1 / fps)) / 1e2, 0.01) for fps in (59.94, 60, 90)),
        *((np.arange(0, 3, 1 / fps), 0.0) for fps in (50, 100)),
        *((np.arange(0, 10, 1 / fps)[LOST[: 10 * fps] > 0.3], 0.0) for fps in (50, 100)),
        (np.arange(5.0), 0.0),  # too few to tell
        *(  # of clocks that began just now, or hours or decades ago
            (start_s + times_s, quantum_s)
            for start_s in (0.0, 6e3, 1.7e9)
            for times_s, quantum_s in (
                (UNEVEN, 0.0),
                (np.floor(UNEVEN * 1e3) / 1e3, 0.001),
                (np.arange(0, 3, 1 / 25), 0.0),  # whole milliseconds by the frame rate
                (EVEN, 0.0),
            )
        ),
    ],
)
def test_times_that_were_cut_off_are_told_from_even_ones(times_s, quantum_s):
    assert time_quantum_s(times_s) == quantum_s


# --- Cameras ---

K = np.array([[200.0, 0.0, 173.0], [0.0, 210.0, 130.0], [0.0, 0.0, 1.0]])
LENSES = [
    ("none", ()),
    ("radtan", (-0.3, 0.1, 1e-3, -5e-4)),
    ("radtan", (0.2, 0.1, -1e-3, 1e-3)),
    ("radtan", (-0.3, 0.1, 1e-3, -5e-4, -0.01)),
    ("equidistant", (-0.05, 0.02, -0.01, 0.003)),
    ("equidistant", (0.0, 0.0, 0.0, 0.0)),
]
POINTS = np.random.default_rng(0).uniform((0, 0), (345, 259), (500, 2))


def _camera(model="none", coeffs=()):
    return Camera(K, 346, 260, model, coeffs)


def test_a_camera_takes_lists_and_arrays_and_can_be_compared_and_kept():
    lens, stds_px = LENSES[1][1], (1.0, 1.0, 2.0, 2.0)
    plain = Camera(K, 346, 260, "radtan", lens, stds_px)
    given = Camera(K.tolist(), 346, 260, "radtan", np.array(lens), list(stds_px))
    assert same_camera(plain, given)
    assert len({plain.intrinsics_std_px, given.intrinsics_std_px}) == 1


@pytest.mark.parametrize(("model", "coeffs"), LENSES)
def test_distorting_is_as_in_the_simulator_and_undoes_undistorting_as_does_the_map(model, coeffs):
    camera, points = _camera(model, coeffs), POINTS.copy()
    there_and_back = distort_points(camera, undistort_points(camera, points))
    # These lenses are invertible over the whole sensor.
    np.testing.assert_allclose(there_and_back, POINTS, rtol=0, atol=MAX_ROUND_TRIP_PX)
    back_and_there = undistort_points(camera, distort_points(camera, points))
    # The inverse magnifies the round trip's error by no more than 10 for these lenses.
    np.testing.assert_allclose(back_and_there, POINTS, rtol=0, atol=10 * MAX_ROUND_TRIP_PX)
    np.testing.assert_array_equal(points, POINTS)  # the argument is unchanged
    if model == "none":
        np.testing.assert_array_equal(undistort_points(camera, points), POINTS)
        np.testing.assert_array_equal(distort_points(camera, points), POINTS)
    for change in (undistort_points, distort_points):
        assert change(camera, np.empty((0, 2))).shape == (0, 2)
    table = undistortion_map(camera)
    assert table.shape == (260, 346, 2)
    pixels = np.array([[0.0, 0.0], [345.0, 259.0], [10.0, 200.0]])
    looked_up = table[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    np.testing.assert_array_equal(looked_up, undistort_points(camera, pixels))
    # Radial distortion does not move the optical axis, nor do p1 and p2.
    np.testing.assert_allclose(table[130, 173], (173, 130), rtol=0, atol=MAX_ROUND_TRIP_PX)
    if len(coeffs) < 5:  # the simulator writes out Kalibr's formulas, which have four, itself
        simulated = SimulatedCamera("cam1", K, 346, 260, model, coeffs, np.eye(4), 0.0)
        points_m = np.column_stack([POINTS, np.ones(len(POINTS))]) @ np.linalg.inv(K).T
        # The tolerance is the rounding of one formula in two orders of operations.
        measured_px = distort_points(camera, POINTS)
        np.testing.assert_allclose(measured_px, simulated.project(points_m), rtol=0, atol=1e-9)


def test_points_that_no_ray_reaches_are_nan():
    # r (1 - 0.4 r^2) is at most 0.609, so nothing reaches the sensor's corners at r = 1.06.
    table = undistortion_map(_camera("radtan", (-0.4, 0.0, 0.0, 0.0)))
    assert np.isnan(table[[0, 0, -1, -1], [0, -1, 0, -1]]).all()
    assert np.isfinite(table[80:180, 123:223]).all()


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (Camera(np.diag([-200.0, 200.0, 1.0]), 346, 260), "focal lengths must be positive"),
        (Camera(K + np.eye(3, k=1), 346, 260), "without skew"),
        (Camera(K, 0, 260), "at least 1 x 1 px and at most 200000000 pixels, got 0 x 260"),
        (_camera(["radtan"]), "cam0: unknown distortion model"),
        (_camera("none", "abcd"), "the distortion model 'none' needs 0 finite"),
        (Camera(K, 346, 260, intrinsics_std_px="abcd"), "intrinsics_std must be 4 deviations"),
        (Camera(K, 346, 260, intrinsics_std_px=(0, 0, 0, -1)), "intrinsics_std must be 4 devi"),
        (_camera("fov", (0.9,)), "unknown distortion model 'fov': use one of none, radtan"),
        (_camera("radtan", (0.1,)), "'radtan' needs 4 or 5 or 8 finite coefficients"),
        (_camera("equidistant", (0, 0, 0, np.nan)), "'equidistant' needs 4 finite coefficients"),
        (Camera(K, 346, 260, readout_s=-0.01), "must take 0 to 0.2 s, .* got -0.01 s and 0.0 s"),
        (Camera(K, 346, 260, readout_std_s=-1.0), "got None s and -1.0 s"),
    ],
)
def test_unusable_cameras_and_points_are_refused(camera, message):
    with pytest.raises(SsacError, match=message):
        check_camera(camera, "cam0")
    with pytest.raises(SsacError, match=r"shape \(N, 2\), got \(2,\)"):
        undistort_points(_camera(), np.zeros(2))


# --- Clocks ---

TIMES_S = np.linspace(-50.0, 150.0, 1001)
KNOTS_S = np.arange(0.0, 101.0, 5.0)
CLOCKS = {
    "the same": Clock(),
    "delay": Clock(-0.7),
    "skew": Clock(0.05, 1000.0, 41.0),
    "fast by a half": Clock(12.0, 5e5, -3.0),
    "pieces": Clock(0.05, -300.0, 41.0, KNOTS_S, 0.02 * np.sin(KNOTS_S / 9.0)),
}


@pytest.mark.parametrize("clock", CLOCKS.values(), ids=CLOCKS)
def test_times_come_back_and_swapped_cameras_have_the_inverse_clock(clock):
    shown_s, back_s = clock.cam2_from_cam1(TIMES_S), clock.cam1_from_cam2(TIMES_S)
    inverse = clock.inverse()
    for found_s, expected_s in (
        (clock.cam1_from_cam2(shown_s), TIMES_S),
        (clock.cam2_from_cam1(back_s), TIMES_S),
        (inverse.cam2_from_cam1(TIMES_S), back_s),
        (inverse.cam1_from_cam2(TIMES_S), shown_s),
    ):
        # The tolerance is the rounding of times of about 150 s.
        np.testing.assert_allclose(found_s, expected_s, rtol=0, atol=2e-13)


def test_a_clock_is_what_it_says():
    delay, skew = Clock(0.0123), CLOCKS["skew"]
    np.testing.assert_array_equal(delay.cam2_from_cam1(TIMES_S), TIMES_S + 0.0123)
    np.testing.assert_array_equal(delay.cam1_from_cam2(TIMES_S), TIMES_S - 0.0123)
    assert skew.cam2_from_cam1(41.0) == 41.05  # the offset holds at the reference
    assert skew.cam2_from_cam1(51.0) == pytest.approx(51.06, abs=1e-12)  # 1000 ppm of 10 s
    strays = Clock(0.0, 0.0, 0.0, np.array([0.0, 10.0]), np.array([0.001, 0.003]))
    added_s = strays.added_s(np.array([-5.0, 0.0, 5.0, 10.0, 20.0]))
    np.testing.assert_allclose(added_s, [0.001, 0.001, 0.002, 0.003, 0.003])


# --- Estimates ---


def test_the_first_of_several_refusals_is_that_of_the_earliest_stage():
    for earlier, later in combinations(Status, 2):
        one, other = Refusal(earlier, "one"), Refusal(later, "other")
        assert first(one, other) is first(other, None, one) is one
    one, other = Refusal(Status.NO_MATCH, "one"), Refusal(Status.NO_MATCH, "other")
    assert first(one, other) is one
    assert first() is first(None, None) is None


def test_a_word_of_ours_becomes_its_status_and_another_stays():
    assert Estimate("mine", "no_match").status is Status.NO_MATCH
    assert Estimate("mine").status is Status.OK
    own = Estimate("mine", "too_dark", "the sun had set", t_d_s=0.1)
    assert (own.status, own.has_offset) == ("too_dark", False)
    for status in Status:  # an offset holds where no more than the pose is open
        holds = status == Status.OK or status in POSE_IS_OPEN
        assert Estimate("mine", status, t_d_s=0.1).has_offset == holds
        assert not Estimate("mine", status).has_offset


def test_deviations_of_the_pose_are_roots_of_summed_variances():
    covariance = np.diag(np.deg2rad([9.0, 1.0, 2.0, 2.0, 3.0, 4.0]) ** 2)
    estimate = Estimate("mine", covariance=covariance)
    assert (estimate.r_std_deg, estimate.t_std_deg) == pytest.approx((3.0, 5.0))
    assert np.isnan([Estimate("mine").r_std_deg, Estimate("mine").t_std_deg]).all()


def test_a_delay_moves_all_offsets_of_an_estimate():
    start = Estimate("search", t_d_s=0.1, candidates_s=np.array([0.0, 0.1]))
    others_s = np.array([0.4])
    estimate = Estimate("mine", t_d_s=0.11, t_d_std_s=0.02, alternatives_s=others_s, start=start)
    delayed = estimate.delayed(0.5)
    assert (delayed.t_d_s, delayed.start.t_d_s) == pytest.approx((0.61, 0.6))
    assert delayed.t_d_std_s == 0.02
    assert delayed.alternatives_s == pytest.approx([0.9])
    assert delayed.start.candidates_s == pytest.approx([0.5, 0.6])
    assert np.isnan(Estimate("mine").delayed(0.5).t_d_s)


# --- Rules ---

RULES = dict(_flat(asdict(Rules())))


def other(value):
    if isinstance(value, tuple):
        return tuple(map(other, value))
    return not value if isinstance(value, bool) else value + 1


@pytest.mark.parametrize("name", RULES)
def test_a_sweep_sets_a_rule_by_its_dotted_name_and_one_that_makes_no_sense_is_named(name):
    value = RULES[name]
    config = checked(configs_of({f"ssac.rules.{name}": other(value)})[1])
    assert dict(_flat(asdict(config.rules))) == RULES | {name: other(value)} != RULES
    assert hash(config) != hash(Config())  # so results under other rules are not reused
    for wrong in (None, "many", [value], *(() if isinstance(value, bool) else (np.nan, True))):
        if isinstance(value, tuple) and not isinstance(wrong, list):
            wrong = (wrong, *value[1:])
        with pytest.raises(SsacError, match=rf"rules\.{name}(\[0\])?: expected [^\n]*$"):
            checked(configs_of({f"ssac.rules.{name}": wrong})[1])


def test_rules_of_another_kind_are_refused_and_any_number_is_taken():
    for wrong in (None, Config(), Rules().verdict, {}):
        with pytest.raises(SsacError, match=r"rules: expected a ssac\.rules\.Rules"):
            checked(Config(rules=wrong))
    with pytest.raises(SsacError, match=r"rules\.verdict: expected VerdictRules"):
        checked(Config(rules=Rules(verdict=None)))
    for value in (np.float64(0.5), np.int64(1), 1):
        checked(Config(rules=Rules(verdict=VerdictRules(max_spread=value))))


def test_a_stage_has_no_rules_but_those_of_its_config():
    """Only the config makes rules, and each rule is read somewhere."""
    made, read = set(), set()
    for path in Path(ssac.__file__).parent.rglob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        read |= {node.attr for node in nodes if isinstance(node, ast.Attribute)}
        called = [node.func for node in nodes if isinstance(node, ast.Call)]
        if any(isinstance(one, ast.Name) and one.id.endswith("Rules") for one in called):
            made.add(path.name)
    # align.py and faint.py have functions that people call without a config.
    assert made == {"rules.py", "align.py", "faint.py"}
    assert {name.rpartition(".")[2] for name in RULES} <= read
