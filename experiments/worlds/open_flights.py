"""Flights that leave the offset or the pose open, in part or in whole, and ordinary ones.

The drone turns as in ordinary flights, but four times as fast where its path alone makes too few
events to matter.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.recorded import Pair, recorded_pair
from experiments.lab.score import Truth
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig, Trajectory, random_spline, trajectory_to_csv
from sim.seeds import generator
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.arrays import Array
from ssac.camera import Rig, known_pose
from ssac.config import Config
from ssac.track.observation import Observation

Position = Callable[[Array], Array]  # (n,) [s] -> (n, 3) [m], world frame

T_D_S = 0.05
DURATION_S = 8.0
_APART_S = 60.0  # between two recordings without any common time
_CSV_HZ = 200.0
_OUTSIDE_S = 3.0  # an offset that the search interval does not hold
_SHORT_S = 0.6
_PATH_STREAM = 7  # of the seed
OTHER_OBJECT = "other-object"  # the kind of which camera 2 sees another flight
_PACES = {"slow": 0.25, "stationary": 4.0, "straight-uniform": 4.0}
"""How fast the drone turns, beside ordinary flights; of "slow" also how fast it flies."""


@dataclass(frozen=True)
class OpenCase:
    """What the methods are given, and what they are to find."""

    cam1: Observation
    cam2: Observation
    rig: Rig  # with the true extrinsics
    config: Config
    truth: Truth  # its offset is NaN where the cameras saw different objects: any is wrong


def _random_direction(rng: np.random.Generator) -> Array:
    direction = rng.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction))


def _frame(rng: np.random.Generator) -> Array:
    """Three random orthogonal unit vectors (3, 3), one per row."""
    return np.asarray(np.linalg.qr(rng.normal(size=(3, 3)))[0].T)


def _stationary(rng: np.random.Generator) -> Position:
    place = rng.uniform(-0.7, 0.7, 3)
    return lambda times_s: np.tile(place, (len(times_s), 1))


def _straight(rng: np.random.Generator) -> Position:
    """Draw a straight line, along which the speed varies as in an ordinary flight."""
    path = random_spline(SplineConfig(DURATION_S), rng).position
    direction, middle = _random_direction(rng), rng.uniform(-0.4, 0.4, 3)
    return lambda times_s: middle + 1.3 * path(times_s)[:, :1] * direction


def _straight_uniform(rng: np.random.Generator) -> Position:
    """Draw a straight line at one speed, 6.4 m in all; a part of it is in view."""
    direction, middle = _random_direction(rng), rng.uniform(-0.4, 0.4, 3)
    return lambda times_s: middle + 0.8 * (times_s - 0.5 * DURATION_S)[:, None] * direction


def _circle(rng: np.random.Generator, rise_m: float = 0.0) -> Position:
    (a, b, axis), middle = _frame(rng), rng.uniform(-0.3, 0.3, 3)
    radius_m, period_s, phase = rng.uniform(0.8, 1.5), rng.uniform(1.5, 4.0), rng.uniform(0.0, 6.0)

    def position(times_s: Array) -> Array:
        turn = phase + 2.0 * np.pi * times_s[:, None] / period_s
        height = rise_m * (times_s[:, None] / DURATION_S - 0.5)
        return np.asarray(middle + radius_m * (np.cos(turn) * a + np.sin(turn) * b) + height * axis)

    return position


def _planar(rng: np.random.Generator) -> Position:
    path = random_spline(SplineConfig(DURATION_S), rng).position
    plane, middle = _frame(rng)[:2], rng.uniform(-0.4, 0.4, 3)
    return lambda times_s: middle + 1.2 * path(times_s)[:, :2] @ plane


def _periodic(rng: np.random.Generator) -> Position:
    """Draw a closed path of three harmonics, flown again and again."""
    period_s = rng.uniform(0.7, 0.95)
    waves = rng.normal(size=(3, 2, 3)) * np.array([0.75, 0.35, 0.2])[:, None, None]

    def position(times_s: Array) -> Array:
        turns = 2.0 * np.pi * times_s[:, None] / period_s * np.arange(1.0, 4.0)
        return np.asarray(np.cos(turns) @ waves[:, 0] + np.sin(turns) @ waves[:, 1])

    return position


PATHS: dict[str, Callable[[np.random.Generator], Position]] = {
    "stationary": _stationary, "straight": _straight, "straight-uniform": _straight_uniform,
    "circle": _circle, "helix": lambda rng: _circle(rng, rise_m=2.0), "planar": _planar,
    "periodic": _periodic,
}  # fmt: skip
"""Kinds with a path of their own."""

KINDS_OF_FLIGHT: dict[str, tuple[str, ...]] = {
    **{path: (path,) for path in PATHS},
    "periodic": ("periodic", "periodic-wide"),
    "slow": ("slow",),
    "noise-kept": ("noise-kept",),
    "ordinary": ("ordinary", OTHER_OBJECT, "no-overlap", "small-overlap", "outside-search", "short",
                 "few-samples"),
}  # fmt: skip
"""Kinds by the flight that they are made of: those of one flight differ in what methods get."""

FLIGHT_OF = {kind: flight for flight, kinds in KINDS_OF_FLIGHT.items() for kind in kinds}


def flight_config(flight: str, angle_deg: float) -> SimConfig:
    """Give the configuration of a flight of KINDS_OF_FLIGHT, but for a path of its own."""
    spline, frames = SplineConfig(DURATION_S), FrameConfig(rate_hz=0.0)
    config = SimConfig(angle_deg=angle_deg, t_d_s=T_D_S, spline=spline, frames=frames)
    return replace(config, sensor=PRESETS["davis346"]) if flight == "noise-kept" else config


def flight_of(flight: str, config: SimConfig, seed: int, cache: Cache) -> Pair:
    """Load a flight of KINDS_OF_FLIGHT, of `flight_config`; the seed draws its path.

    The cache keeps recordings by what is in their path's file, not by its name.
    """
    if flight not in PATHS and flight not in _PACES:
        return recorded_pair(cache, config, seed)
    rng = generator(seed, _PATH_STREAM)
    pace = _PACES.get(flight, 1.0)
    random = random_spline(replace(config.spline, duration_s=pace * DURATION_S), rng)
    position = PATHS[flight](rng) if flight in PATHS else _slowed(random.position, pace)
    trajectory = Trajectory(DURATION_S, position, lambda times_s: random.attitude(pace * times_s))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "flight.csv"
        trajectory_to_csv(trajectory, file, _CSV_HZ)
        return recorded_pair(cache, replace(config, trajectory_file=file), seed)


def _slowed(position: Position, pace: float) -> Position:
    return lambda times_s: position(pace * times_s)


def open_case(kind: str, recording: Pair, other: Callable[[], Pair]) -> OpenCase:
    """Make of a recording of `flight_of` what the methods are given in a kind."""
    cam1, cam2, rig = recording
    t_d_s, config = T_D_S, Config(denoise=kind != "noise-kept")
    if kind == "periodic-wide":
        config = replace(config, interval_s=(-3.0, 3.0))
    elif kind == OTHER_OBJECT:
        cam2, t_d_s = other().cam2, np.nan
    elif kind == "no-overlap":
        cam2, t_d_s = cam2.delayed(_APART_S), t_d_s + _APART_S
        config = replace(config, search="interval")  # else all offsets are, and the true one found
    elif kind == "small-overlap":
        config = replace(config, interval_s=(DURATION_S - 1.0, DURATION_S - 0.1))
    elif kind == "outside-search":
        cam2, t_d_s = cam2.delayed(_OUTSIDE_S), t_d_s + _OUTSIDE_S
    elif kind == "short":
        cam1, cam2 = _shortened(cam1), _shortened(cam2)
    elif kind == "few-samples":
        config = replace(config, n_samples=25)
    return OpenCase(cam1, cam2, rig, config, Truth(t_d_s, *known_pose(rig)))


def _shortened(camera: Observation) -> Observation:
    """Keep the middle of a recording."""
    middle_us = (camera.events["t"][0] + camera.events["t"][-1]) // 2
    near = np.abs(camera.events["t"] - middle_us) < 0.5e6 * _SHORT_S
    return Observation(camera.events[near])
