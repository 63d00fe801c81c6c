"""One path laid over another: similarities, and clocks over the whole range of shifts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ssac.clock import Clock
from ssac.errors import SsacError
from ssac.network.align import Similarity, best_shift, similarity
from ssac.network.tum import Path

RNG = np.random.default_rng(3)
POINTS = RNG.normal(size=(40, 3)) * (5.0, 2.0, 1.0)
TRUE = Similarity(2.5, Rotation.from_rotvec([0.4, -2.0, 1.0]).as_matrix(), np.array([3.0, -7.0, 1]))


def _same(a, b):
    assert a.scale == pytest.approx(b.scale, rel=1e-9)  # rounding
    np.testing.assert_allclose(a.R, b.R, atol=1e-9)
    np.testing.assert_allclose(a.t, b.t, atol=1e-8)


def test_a_similarity_is_that_of_the_points_and_one_of_a_group():
    for points in (POINTS, POINTS * (1.0, 1.0, 0.0)):  # of a plane too
        _same(similarity(points, TRUE.apply(points)), TRUE)
    mirrored = similarity(POINTS, POINTS * (1.0, 1.0, -1.0))
    assert np.linalg.det(mirrored.R) == pytest.approx(1.0)  # turned, not mirrored
    assert similarity(POINTS, TRUE.apply(POINTS), with_scale=False).scale == 1.0
    _same(TRUE.after(TRUE.inverse()), Similarity(1.0, np.eye(3), np.zeros(3)))
    other = similarity(POINTS, POINTS @ TRUE.R)
    np.testing.assert_allclose(other.after(TRUE).apply(POINTS), other.apply(TRUE.apply(POINTS)))
    target = TRUE.apply(POINTS) + RNG.normal(0.0, 0.3, POINTS.shape)
    found = similarity(POINTS, target)
    for _ in range(50):  # no other near by has less squares
        turn = Rotation.from_rotvec(RNG.normal(0.0, 0.01, 3)).as_matrix()
        scale, shift = found.scale * RNG.normal(1.0, 0.01), RNG.normal(0.0, 0.01, 3)
        near = Similarity(scale, turn @ found.R, found.t + shift)
        costs = [np.sum((fit.apply(POINTS) - target) ** 2) for fit in (near, found)]
        assert costs[0] > costs[1]


@pytest.mark.parametrize("points", [POINTS * (1.0, 0.0, 0.0), POINTS * 0.0, POINTS[:2]])
def test_a_line_or_a_point_does_not_tell_a_turn(points):
    for pair in ((points, POINTS[: len(points)]), (POINTS[: len(points)], points)):
        with pytest.raises(SsacError, match="lie on a line"):
            similarity(*pair)


FRAME = Similarity(21.0, Rotation.from_rotvec([0.3, 1.9, -0.6]).as_matrix(), np.array([9.0, -4, 2]))
NOISE_M = 0.02


def flight(duration_s, seed, hovers=()):
    """Give a flight [m] as a function of time [s]: random points every 4 s, but for hovers."""
    rng = np.random.default_rng(seed)
    knots_s = np.arange(-8.0, duration_s + 8.1, 4.0)
    points = np.cumsum(rng.normal(0.0, 4.0, (len(knots_s), 3)) * (1.0, 1.0, 0.3), axis=0)
    for start_s, end_s in hovers:
        still = (knots_s >= start_s) & (knots_s <= end_s)
        points[still] = points[still][0] + rng.normal(0.0, 0.05, (still.sum(), 3))
    return CubicSpline(knots_s, points)


def both(duration_s, seed, clock, span_s, hovers=(), rate_hz=30.0):
    """Give an estimate over `span_s` in its own frame, and the truth of the whole flight."""
    rng = np.random.default_rng(seed + 1000)
    position = flight(duration_s, seed, hovers)
    times_s = np.arange(*span_s, 1.0 / rate_hz)
    seen = FRAME.inverse().apply(position(times_s) + rng.normal(0.0, NOISE_M, (len(times_s), 3)))
    truth_s = np.arange(0.0, duration_s, 0.2)
    shown_s = clock.cam2_from_cam1(truth_s)
    noisy = position(truth_s) + rng.normal(0.0, NOISE_M, (len(truth_s), 3))
    return Path(times_s, seen), Path(shown_s, noisy)


def check(found, clock, tolerance_s=0.004):
    """Tolerance: 2 cm of noise at some 2 m/s are 10 ms a sample, of some hundred samples."""
    got, frame = found
    at_s = np.array([got.t_ref_s])
    assert got.cam2_from_cam1(at_s) == pytest.approx(clock.cam2_from_cam1(at_s), abs=tolerance_s)
    assert frame.scale == pytest.approx(FRAME.scale, rel=0.01)  # noise of 2 cm in some 10 m
    off = Rotation.from_matrix(frame.R.T @ FRAME.R).magnitude()
    assert np.degrees(off) < 0.5  # as the scale


@pytest.mark.parametrize("shift_s", [0.0, -301.37, 1.7e9])
def test_any_shift_is_found(shift_s):
    check(best_shift(*both(120.0, 0, Clock(shift_s), (20.0, 100.0))), Clock(shift_s))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("hovers", "span_s"),
    [
        ([(0.0, 120.0)], (90.0, 190.0)),  # the truth hovers where the estimate moves if shifted
        ([(40.0, 100.0), (130.0, 300.0)], (30.0, 200.0)),  # both hover most of the time
        ([(0.0, 60.0), (90.0, 150.0), (180.0, 300.0)], (0.0, 300.0)),
    ],
)
def test_a_hover_is_no_trap(seed, hovers, span_s):
    clock = Clock(57.3, 12.0, 0.0)
    # What moves is a third of the samples at least as short as 30 s.
    check(best_shift(*both(300.0, seed, clock, span_s, hovers)), clock, 0.01)


def test_the_rate_is_found_with_its_prior_and_without_one_is_not_tried():
    clock = Clock(-3.0, 400.0, 150.0)
    estimate, truth = both(300.0, 5, clock, (0.0, 300.0))
    got = best_shift(estimate, truth, rate_std_ppm=1000.0)
    check(got, clock)
    # 10 ms a sample, 1500 samples with deviation 87 s: 3 ppm; three deviations.
    assert got[0].skew_ppm == pytest.approx(400.0, abs=10.0)
    assert best_shift(estimate, truth, rate_std_ppm=0.0)[0].skew_ppm == 0.0


def test_gross_errors_and_gaps_change_nothing_and_a_known_scale_is_kept():
    clock = Clock(11.0)
    estimate, truth = both(120.0, 2, clock, (10.0, 110.0))
    rng = np.random.default_rng(9)
    positions = estimate.positions_m.copy()
    positions[rng.choice(len(positions), 50, replace=False)] += rng.normal(0.0, 50.0, (50, 3))
    kept = (estimate.times_s < 40.0) | (estimate.times_s > 60.0)
    spoilt = Path(estimate.times_s[kept], positions[kept])
    few = rng.random(len(truth)) > 0.1
    check(best_shift(spoilt, Path(truth.times_s[few], truth.positions_m[few])), clock, 0.01)
    metric = replace(estimate, positions_m=FRAME.scale * estimate.positions_m)
    got, frame = best_shift(metric, truth, with_scale=False)
    assert frame.scale == 1.0
    check((got, replace(frame, scale=FRAME.scale)), clock)


def test_shifts_beyond_the_bound_are_not_taken_and_paths_at_rest_have_none():
    clock, times_s = Clock(40.0), np.arange(0.0, 60.0, 0.2)
    estimate, truth = both(120.0, 1, clock, (20.0, 100.0))
    check(best_shift(estimate, truth, 60.0), clock)
    assert abs(best_shift(estimate, truth, 20.0)[0].t_d_s) < 25.0
    rest = Path(times_s, np.zeros((len(times_s), 3)))
    moving = Path(times_s, flight(60.0, 0)(times_s))
    for pair in ((rest, moving), (moving, rest)):
        with pytest.raises(SsacError, match="no shift at which"):
            best_shift(*pair)
    with pytest.raises(SsacError, match="no shift within 5 s"):
        best_shift(moving, Path(times_s + 100.0, moving.positions_m), 5.0)
