from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from experiments.worlds.bound import Bound, cramer_rao_bound, fisher_information, known_pose_bound
from ssac.camera import Rig
from ssac.fit.least_squares import Parameters, Problem, WeighedPairs, moved, solve
from ssac.geometry.epipolar import cross_matrix, fundamental_from_pose, sampson_distance
from ssac.geometry.pose import tangent_basis
from ssac.rules import FitRules
from tests.ssac.synthetic import (
    HEIGHT,
    WIDTH,
    K,
    Scene,
    angle_deg,
    make_scene,
    rotation_angle_deg,
    track_pair,
)

Array = NDArray[np.float64]

NOISE_PX = 0.3
TRIALS = 300
WITHIN = 3.0 / np.sqrt(2.0 * TRIALS)  # three deviations of a root mean square of as many errors
STEP_S = 1e-4  # of differences: they err by its square
LEAST_SQUARES = 1e6  # Cauchy's loss turns nowhere


@dataclass(frozen=True)
class Flight:
    """The true track of a scene, as far as both cameras see it."""

    p1: Array
    p2: Array
    v1: Array
    v2: Array
    R: Array
    t: Array
    rig: Rig

    def information(self, noise_px: float = NOISE_PX) -> Array:
        return fisher_information(self.p1, self.p2, self.v2, self.R, self.t, self.rig, noise_px)


def fly(scene: Scene, n: int = 400) -> Flight:
    times_s = scene.duration_s * (np.arange(n) + 0.5) / n
    p1, p2 = track_pair(scene, times_s)
    before, after = (track_pair(scene, times_s + step) for step in (-STEP_S, STEP_S))
    v1, v2 = ((b - a) / (2.0 * STEP_S) for a, b in zip(before, after, strict=True))
    seen = np.all((p1 >= 0) & (p1 < [WIDTH, HEIGHT]) & (p2 >= 0) & (p2 < [WIDTH, HEIGHT]), axis=1)
    t = scene.t / np.linalg.norm(scene.t)
    return Flight(p1[seen], p2[seen], v1[seen], v2[seen], scene.R, t, scene.unknown_rig)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return fly(make_scene(seed=3))


def errors_with_noise(flight: Flight, noises_px: Array, pose_is_known: bool = False) -> Array:
    """Errors (TRIALS, 3) of t_d [s] and of the angles [rad] of R and t, by least squares."""
    rng = np.random.default_rng(0)
    truth = Parameters(0.0, flight.R, flight.t)
    n = len(flight.p1)
    errors = []
    for _ in range(TRIALS):
        noise = noises_px[:, None] * rng.standard_normal((2, n, 2))
        pairs = WeighedPairs(
            np.arange(n, dtype=np.float64),
            flight.p1 + noise[0],
            flight.p2 + noise[1],
            flight.v2,
            1.0 / noises_px,
            0.0,
        )
        problem = Problem(pairs, flight.rig, FitRules(), pose_is_known, turn=LEAST_SQUARES)
        found = solve(problem, truth).parameters
        angles_deg = rotation_angle_deg(found.R, flight.R), angle_deg(found.t, flight.t)
        errors.append([found.t_d_s, *np.deg2rad(angles_deg)])
    return np.array(errors)


def alike(flight: Flight) -> Array:
    return np.full(len(flight.p1), NOISE_PX)


def rms(errors: Array) -> Array:
    return np.sqrt(np.mean(errors**2, axis=0))


def test_least_squares_reach_the_bound(flight: Flight) -> None:
    bound = cramer_rao_bound(flight.information())
    errors = rms(errors_with_noise(flight, alike(flight)))
    assert errors == pytest.approx([bound.t_d_s, bound.R_rad, bound.t_rad], rel=WITHIN)


def test_least_squares_reach_the_bound_when_the_pose_is_known(flight: Flight) -> None:
    bound = known_pose_bound(flight.information())
    errors = rms(errors_with_noise(flight, alike(flight), pose_is_known=True))
    assert errors[0] == pytest.approx(bound.t_d_s, rel=WITHIN)
    assert bound == Bound(bound.t_d_s, 0.0, 0.0)


def test_least_squares_reach_the_bound_of_unlike_noise_by_its_weights(flight: Flight) -> None:
    noises_px = NOISE_PX * np.random.default_rng(1).uniform(0.3, 3.0, len(flight.p1))
    information = fisher_information(
        flight.p1, flight.p2, flight.v2, flight.R, flight.t, flight.rig, noises_px
    )
    bound = cramer_rao_bound(information)
    errors = rms(errors_with_noise(flight, noises_px))
    assert errors == pytest.approx([bound.t_d_s, bound.R_rad, bound.t_rad], rel=WITHIN)


def test_the_information_is_that_of_numeric_derivatives(flight: Flight) -> None:
    def distances(step: Array) -> Array:
        at = moved(Parameters(0.0, flight.R, flight.t), step)
        F = fundamental_from_pose(K, K, at.R, at.t)
        return sampson_distance(F, flight.p1, flight.p2 + at.t_d_s * flight.v2)

    small = 1e-6
    J = np.column_stack(
        [(distances(small * k) - distances(-small * k)) / (2.0 * small) for k in np.eye(6)]
    )
    # Differences over 2e-6 of distances that are computed to 1e-12 px or so, of 1e2 px/rad.
    np.testing.assert_allclose(flight.information(1.0), J.T @ J, rtol=1e-5, atol=1e-5 * len(J))


def test_the_information_is_that_of_the_textbook(flight: Flight) -> None:
    """DESIGN's formula, written out pair by pair."""
    R, t = flight.R, flight.t
    F = fundamental_from_pose(K, K, R, t)
    information = np.zeros((6, 6))
    for p1, p2, v2 in zip(flight.p1, flight.p2, flight.v2, strict=True):
        x1, x2 = np.append(p1, 1.0), np.append(p2, 1.0)
        y1, y2 = np.linalg.solve(K, x1), np.linalg.solve(K, x2)
        turns = [y2 @ cross_matrix(t) @ cross_matrix(axis) @ R @ y1 for axis in np.eye(3)]
        shifts = [y2 @ cross_matrix(b) @ R @ y1 for b in tangent_basis(t)]
        J = np.array([(F @ x1)[:2] @ v2, *turns, *shifts])
        s2 = np.sum((F @ x1)[:2] ** 2) + np.sum((F.T @ x2)[:2] ** 2)
        information += np.outer(J, J) / (NOISE_PX**2 * s2)
    # The pairs fulfil the epipolar constraint but for rounding.
    np.testing.assert_allclose(flight.information(), information, rtol=1e-8, atol=1e-6)


def test_the_order_of_the_cameras_does_not_count(flight: Flight) -> None:
    bound = cramer_rao_bound(flight.information())
    swapped = Flight(
        flight.p2, flight.p1, flight.v2, flight.v1, flight.R.T, -flight.R.T @ flight.t, flight.rig
    )
    other = cramer_rao_bound(swapped.information())
    # The velocities are differences. t is another vector: its error now has a part of R's.
    assert other.t_d_s == pytest.approx(bound.t_d_s, rel=1e-5)
    assert other.R_rad == pytest.approx(bound.R_rad, rel=1e-5)


def test_the_bound_follows_noise_samples_and_speed(flight: Flight) -> None:
    bound = cramer_rao_bound(flight.information())
    noisier = cramer_rao_bound(flight.information(2.0 * NOISE_PX))
    assert noisier.t_d_s == pytest.approx(2.0 * bound.t_d_s)
    assert noisier.t_rad == pytest.approx(2.0 * bound.t_rad)
    fourfold = cramer_rao_bound(4.0 * flight.information())  # every pair four times
    assert fourfold.R_rad == pytest.approx(0.5 * bound.R_rad)
    faster = Flight(**{**vars(flight), "v2": 2.0 * flight.v2})
    assert cramer_rao_bound(faster.information()).t_d_s == pytest.approx(0.5 * bound.t_d_s)
    assert cramer_rao_bound(faster.information()).R_rad == pytest.approx(bound.R_rad)


def test_to_know_the_pose_can_only_help(flight: Flight) -> None:
    information = flight.information()
    known, unknown = known_pose_bound(information), cramer_rao_bound(information)
    assert known.t_d_s < unknown.t_d_s
    # DESIGN's 1 / (I_dd - I_dp I_pp^-1 I_pd).
    schur = information[0, 1:] @ np.linalg.solve(information[1:, 1:], information[1:, 0])
    assert unknown.t_d_s == pytest.approx((information[0, 0] - schur) ** -0.5)


def test_a_circle_does_not_tell_the_offset() -> None:
    """Turned about its axis, a uniform circle is itself a moment later."""
    centre, turn = np.array([0.0, 0.0, 5.0]), np.array([1.0, 0.0, 0.0])
    scene = make_scene(seed=0)

    def path(times_s: Array) -> Array:
        angle = 2.0 * times_s[:, None]
        return centre + turn * np.cos(angle) + np.array([0.0, 0.6, 0.8]) * np.sin(angle)

    circle = Scene(scene.R, scene.t, path, 20.0)  # type: ignore[arg-type]
    bound, usual = (cramer_rao_bound(fly(one).information()) for one in (circle, scene))
    # Infinite but for the velocities, which are differences with a relative error of 1e-8.
    assert bound.t_d_s > 1e3 * usual.t_d_s


def test_what_the_motion_does_not_tell_has_no_bound(flight: Flight) -> None:
    few = Flight(
        flight.p1[:5], flight.p2[:5], flight.v1, flight.v2[:5], flight.R, flight.t, flight.rig
    )
    assert cramer_rao_bound(few.information()).t_d_s == np.inf
    assert np.isfinite(known_pose_bound(few.information()).t_d_s)
    still = Flight(**{**vars(flight), "v2": 0.0 * flight.v2})
    assert known_pose_bound(still.information()).t_d_s == np.inf
