import numpy as np
import pytest
from scipy.special import ellipk

from sim.twin.pendulum import GRAVITY_M_S2, PendulumConfig, hanging, swing

LENGTH_M = 0.45
STEP_S = 1e-3


def free_swing(angle_rad: float, damping_per_s: float = 0.0, turns: float = 0.0) -> np.ndarray:
    """States of a pendulum whose hand stands still, over 10 s."""
    start = np.array([np.sin(angle_rad), 0.0, -np.cos(angle_rad), 0.0, turns, 0.0])
    return swing(LENGTH_M, damping_per_s, np.zeros((20_001, 3)), start, STEP_S)


def energy(states: np.ndarray) -> np.ndarray:
    """Energy over mass times length [m/s^2]."""
    return 0.5 * LENGTH_M * np.sum(states[:, 3:] ** 2, axis=1) + GRAVITY_M_S2 * states[:, 2]


def test_a_swing_in_space_keeps_its_energy_and_the_wire_its_length() -> None:
    states = free_swing(0.6, turns=1.5)
    # Runge and Kutta's fourth order: the error of 10,000 steps of 1 ms, each of some (5e-3)^5.
    assert np.ptp(energy(states)) < 1e-7
    np.testing.assert_allclose(np.linalg.norm(states[:, :3], axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("angle_rad", [0.05, 0.5, 1.2])
def test_the_period_is_the_pendulums(angle_rad: float) -> None:
    x = free_swing(angle_rad)[:, 0]
    k = np.flatnonzero((x[:-1] > 0.0) & (x[1:] <= 0.0))
    crossings_s = STEP_S * (k + x[k] / (x[k] - x[k + 1]))
    exact_s = 4.0 * np.sqrt(LENGTH_M / GRAVITY_M_S2) * ellipk(np.sin(0.5 * angle_rad) ** 2)
    # The line between two steps errs by far less than a step.
    np.testing.assert_allclose(np.diff(crossings_s), exact_s, atol=1e-6)


def test_air_takes_the_energy_at_the_rate_of_the_damping() -> None:
    damping_per_s = 0.3
    left = energy(free_swing(0.05, damping_per_s)) + GRAVITY_M_S2
    # Of a small swing the mean over a period falls as exp(-c t); over whole periods it is its own.
    rate = -np.polyfit(STEP_S * np.arange(len(left)), np.log(left), 1)[0]
    assert rate == pytest.approx(damping_per_s, rel=0.02)


def test_the_body_is_one_wire_from_a_hand_that_stands_still() -> None:
    config = PendulumConfig(hand_m=(0.0, 0.0, 0.0), start_rad=0.1, damping_per_s=0.0)
    drawn = hanging(config, 5.0, np.random.default_rng(3))
    times_s = np.linspace(0.0, 5.0, 501)
    wire = drawn.wire(times_s)
    held = drawn.hand(times_s)
    np.testing.assert_allclose(held, np.broadcast_to([0.0, 0.0, config.length_m], held.shape))
    body = drawn.trajectory.position(times_s)
    # Two cubic splines through nodes 2 ms apart.
    np.testing.assert_allclose(body, held + config.length_m * wire, atol=1e-9)


def test_the_body_hangs_along_the_wire_when_nothing_rocks_it() -> None:
    drawn = hanging(PendulumConfig(rocking_rad=0.0), 5.0, np.random.default_rng(0))
    times_s = np.linspace(0.0, 5.0, 100)
    up = drawn.trajectory.poses(times_s)[:, :3, 2]
    # The wire's spline is of unit length at its nodes only.
    np.testing.assert_allclose(up, -drawn.wire(times_s), atol=1e-8)


def test_the_same_seed_gives_the_same_motion_within_the_ball() -> None:
    config, times_s = PendulumConfig(), np.linspace(0.0, 20.0, 1000)
    one, again, other = (
        hanging(config, 20.0, np.random.default_rng(seed)).trajectory.position(times_s)
        for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.01
    assert np.linalg.norm(one, axis=1).max() <= config.max_radius_m + 1e-6
