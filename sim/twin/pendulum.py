"""The motion of a body that hangs on a wire from a moving hand.

The wire is straight and of constant length, without mass; the body hangs along it, turns about it
and rocks a little. The hand follows a random smooth path. Frames as in `sim.scene.trajectory`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from sim.arrays import FloatArray
from sim.errors import SimError, check_numbers
from sim.scene.trajectory import MAX_DRAWS, Attitude, Trajectory, Vector3

GRAVITY_M_S2 = 9.81
STEPS_HZ = 500.0  # integration steps per second: a swing takes a second
_N_WAVES = 3  # sines that add up to a twist or a rocking
_SPREAD = 0.3  # of their frequencies, as a share

Waves = Callable[[FloatArray], FloatArray]  # (n,) [s] -> an angle (n,) [rad]


@dataclass(frozen=True)
class PendulumConfig:
    """How a hand swings a small model, so that it moves about the middle of both views."""

    length_m: float = 1.0  # of the wire: the shorter, the more the model tilts where it swings
    damping_per_s: float = 0.15  # of the swing, by the air
    start_rad: float = 0.15  # deviation of both components of the initial deflection
    hand_m: Vector3 = (0.05, 0.05, 0.18)  # half range of its random places; only the hand lifts
    hand_hz: float = 2.0  # random places per second, on a smooth curve
    twist_hz: float = 0.3  # of the body's turning about the wire
    twist_rad: float = 1.2  # deviation
    rocking_hz: float = 5.0  # of the body's rocking about its x and y axes
    rocking_rad: float = 0.05  # deviation
    max_radius_m: float = 0.22  # of the model from the point that the cameras look at

    def __post_init__(self) -> None:
        positive = ("length_m", "hand_hz", "twist_hz", "rocking_hz", "max_radius_m")
        or_zero = ("damping_per_s", "start_rad", "twist_rad", "rocking_rad")
        check_numbers(self, "pendulum: ", positive, or_zero)
        if not (np.isfinite(self.hand_m).all() and min(self.hand_m) >= 0.0):
            raise SimError(
                f"pendulum: hand_m must be three numbers, 0 or positive, got {self.hand_m}"
            )


@dataclass(frozen=True)
class Hanging:
    """A body on a wire, and where the wire is held."""

    trajectory: Trajectory
    hand: BSpline  # times [s] -> (n, 3) [m], frame W
    wire: CubicSpline  # times [s] -> (n, 3), unit, from the hand to the body


def hanging(config: PendulumConfig, duration_s: float, rng: np.random.Generator) -> Hanging:
    """Draw the motion of a hanging body that stays within `max_radius_m`, on a taut wire.

    The radius is about the origin. SimError when none of MAX_DRAWS motions meets both conditions.
    """
    for _ in range(MAX_DRAWS):
        drawn = _draw(config, duration_s, rng)
        if drawn is not None:
            return drawn
    raise SimError(
        f"{MAX_DRAWS} random swings all went more than {config.max_radius_m:g} m away from the "
        "point that the cameras look at, or let the wire go slack: lower hand_m or start_rad, or "
        "raise max_radius_m"
    )


@njit(cache=True, nogil=True)
def _rate(length: float, damping: float, hand: FloatArray, state: FloatArray) -> FloatArray:
    """Return the time derivative (6,) of q and q'."""
    q, dq = state[:3], state[3:]
    pull = -hand
    pull[2] -= GRAVITY_M_S2
    along = pull - (pull * q).sum() * q
    rate = np.empty(6)
    rate[:3] = dq
    rate[3:] = along / length - (dq * dq).sum() * q - damping * dq
    return rate


@njit(cache=True, nogil=True)
def swing(
    length_m: float, damping_per_s: float, hand_m_s2: FloatArray, start: FloatArray, step_s: float
) -> FloatArray:
    """Solve the motion of a point that hangs on a straight wire from a moving hand.

    With q the unit vector along the wire, a the hand's acceleration (2 n + 1, 3) [m/s^2], at every
    half step, and g gravity's, q'' = ((g - a) - ((g - a) . q) q) / L - |q'|^2 q - c q', by the
    fourth-order Runge-Kutta method. `start` (6,) has q and q' [1/s]; returns q and q' at the start
    and after every step, (n + 1, 6).
    """
    n = hand_m_s2.shape[0] // 2
    states = np.empty((n + 1, 6))
    states[0] = start
    for k in range(n):
        state = states[k]
        first = _rate(length_m, damping_per_s, hand_m_s2[2 * k], state)
        second = _rate(length_m, damping_per_s, hand_m_s2[2 * k + 1], state + 0.5 * step_s * first)
        third = _rate(length_m, damping_per_s, hand_m_s2[2 * k + 1], state + 0.5 * step_s * second)
        fourth = _rate(length_m, damping_per_s, hand_m_s2[2 * k + 2], state + step_s * third)
        after = state + step_s / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        after[:3] /= np.sqrt((after[:3] * after[:3]).sum())
        states[k + 1] = after
    return states


def _draw(config: PendulumConfig, duration_s: float, rng: np.random.Generator) -> Hanging | None:
    """Draw a motion; None where it leaves the ball or the wire goes slack."""
    n_places = max(6, int(np.ceil(duration_s * config.hand_hz)) + 4)
    places_s = np.arange(n_places) / config.hand_hz - 1.5 / config.hand_hz  # around the recording
    above_m = np.array([0.0, 0.0, config.length_m])
    places_m = above_m + rng.uniform(-1.0, 1.0, (n_places, 3)) * config.hand_m
    # The places are control points of the spline, not points on it, for a smooth path.
    hand = BSpline(make_interp_spline(places_s, places_m, k=3).t, places_m, 3)
    tilt_rad = config.start_rad * rng.standard_normal(2)
    q = np.array([np.sin(tilt_rad[0]), np.sin(tilt_rad[1]), -1.0])
    q /= np.linalg.norm(q)
    sideways = np.append(rng.standard_normal(2), 0.0)
    swing_rad_s = config.start_rad * np.sqrt(GRAVITY_M_S2 / config.length_m)
    dq = swing_rad_s * (sideways - (sideways @ q) * q)
    rocking = (config.rocking_hz, config.rocking_rad)
    waves = [_waves(*of, rng) for of in ((config.twist_hz, config.twist_rad), rocking, rocking)]
    n_steps = max(4, int(np.ceil(duration_s * STEPS_HZ)))
    halves_s: FloatArray = np.linspace(0.0, duration_s, 2 * n_steps + 1, dtype=np.float64)
    times_s, start = halves_s[::2], np.append(q, dq)
    states = swing(config.length_m, config.damping_per_s, hand(halves_s, 2), start, times_s[1])
    q, dq = states[:, :3], states[:, 3:]
    pull = -hand(times_s, 2) - np.array([0.0, 0.0, GRAVITY_M_S2])
    tension = np.sum(pull * q, axis=1) + config.length_m * np.sum(dq * dq, axis=1)
    places = hand(times_s) + config.length_m * q
    if tension.min() <= 0.0 or np.linalg.norm(places, axis=1).max() > config.max_radius_m:
        return None
    wire, position = CubicSpline(times_s, q), CubicSpline(times_s, places)
    return Hanging(Trajectory(duration_s, position, _attitude(wire, waves)), hand, wire)


def _waves(rate_hz: float, deviation: float, rng: np.random.Generator) -> Waves:
    """Sum sines of random phases."""
    amplitudes = np.full(_N_WAVES, deviation * np.sqrt(2.0 / _N_WAVES))
    rates_hz = rate_hz * (1.0 + _SPREAD * rng.uniform(-1.0, 1.0, _N_WAVES))
    phases_rad = rng.uniform(0.0, 2.0 * np.pi, _N_WAVES)

    def value(times_s: FloatArray) -> FloatArray:
        angles = 2.0 * np.pi * np.multiply.outer(times_s, rates_hz) + phases_rad
        summed: FloatArray = np.sin(angles) @ amplitudes
        return summed

    return value


def _attitude(wire: CubicSpline, waves: list[Waves]) -> Attitude:
    """Return the attitude: up along the wire, turned about it, rocking about the body's x and y."""

    def rotations(times_s: FloatArray) -> Rotation:
        up = -wire(times_s)
        up /= np.linalg.norm(up, axis=-1, keepdims=True)
        # The smallest rotation that takes the world's z to the wire's direction upwards.
        axis = np.stack([-up[..., 1], up[..., 0], np.zeros_like(up[..., 0])], axis=-1)
        sine = np.linalg.norm(axis, axis=-1, keepdims=True)
        angle = np.arctan2(sine, up[..., 2:])
        per_sine = np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-12)
        twist, about_x, about_y = (wave(times_s) for wave in waves)
        rocking = np.stack([about_x, about_y, np.zeros_like(about_x)], axis=-1)
        tilt, turn = Rotation.from_rotvec(axis * per_sine), Rotation.from_euler("z", twist)
        return tilt * turn * Rotation.from_rotvec(rocking)

    return rotations
