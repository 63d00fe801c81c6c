"""Ordinary and odd recordings, each drawn from a base seed and its number alone.

So any range of numbers may be looked at, and another one kept for the end. What spoils a recording
is added when it is loaded, as in `spoilt`; of clocks only the offset is in the configuration.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell
from experiments.lab.grid import flight_seed
from experiments.lab.recorded import Flown, Pair, recorded_pair
from experiments.lab.score import Truth
from experiments.worlds.spoilt import GOOD, RIGHT, T_D_S, Errors, Kind, spoilt_pair
from sim.disturb import DisturbConfig, second_seed
from sim.effects.config import SENSOR_PRESETS
from sim.recording import SimConfig
from sim.scene.rig import DISTANCE_M, FOCAL_PX, PRINCIPAL_POINT
from sim.scene.trajectory import SplineConfig
from sim.sensor.frames import FrameConfig
from ssac.camera import known_pose

Rng = np.random.Generator

SHORT_S = 6.0
WRONG_RIG = "wrong rig"
IDEAL, NOISY = "ideal", ("davis346", "evk4", "davis346-dim", "v2e-noisy")


@dataclass(frozen=True)
class Draw:
    """What the recordings of a kind are drawn from: uniformly, or so in the logarithm."""

    duration_s: tuple[float, float] = (6.0, 60.0)  # log
    distance_m: tuple[float, float] = (2.0, 40.0)  # log
    size_px: tuple[float, float] = (6.0, 120.0)  # log; in the middle of the flight
    focal_px: float = FOCAL_PX
    sensors: tuple[str, ...] = (IDEAL, IDEAL, *NOISY[:2])
    far: float | None = None  # share of clocks up to an hour apart; None: as asked for
    skew_ppm: tuple[float, float] | None = None  # log, either way; None: normal, as of oscillators


KINDS: Mapping[str, Draw] = {
    "plain": Draw(duration_s=(3.0, 60.0)),
    "short": Draw(duration_s=(3.0, SHORT_S)),
    "far clocks": Draw(duration_s=(6.0, 30.0), far=1.0),
    "fast clocks": Draw(skew_ppm=(200.0, 3000.0)),
    "faint": Draw(distance_m=(10.0, 100.0), size_px=(2.5, 7.0), sensors=(IDEAL, NOISY[0])),
    "clutter": Draw(duration_s=(6.0, 30.0), sensors=NOISY),
    "two objects": Draw(duration_s=(6.0, 30.0), size_px=(6.0, 60.0)),
    WRONG_RIG: Draw(duration_s=(6.0, 30.0)),
    "wide": Draw(distance_m=(2.0, 6.0), size_px=(6.0, 60.0), focal_px=90.0),
}
"""Recording k is of the k-th kind, in turns."""

SKEW_STD_PPM = 20.0
MAX_M_S, _PLAIN_M_S = 15.0, 5.0
"""Median speed of the fastest flights, and of `SplineConfig`'s."""

CALIBRATIONS = (GOOD, GOOD, (0.3, 1.0), (1.0, 3.0))
"""Deviations of focal lengths [%] and centres [px] that rigs are drawn from and state."""


@dataclass(frozen=True)
class OddCell(FlightCell):
    """One recording."""

    base: int
    kind: str
    sensor: str
    size_px: float
    spoilt: Kind
    spoilt_by: str  # in words

    @property
    def columns(self) -> dict[str, Any]:
        """Which one it is, and all that was drawn."""
        sim, (percent, _) = self.sim, self.spoilt.disturb.intrinsics_error
        return {
            "base": self.base, "kind": self.kind, **self.flown, "distance_m": sim.distance_m,
            "size_px": self.size_px, "focal_px": sim.focal_px, "sensor": self.sensor,
            "slowness": round(SplineConfig().sampling_hz / sim.spline.sampling_hz, 2),
            "t_d_s": sim.t_d_s, "skew_ppm": self.spoilt.skew_ppm, "focal_std_percent": percent,
            "spoilt_by": self.spoilt_by,
        }  # fmt: skip


def recorded(cell: OddCell, cache: Cache) -> Pair:
    """Give what both cameras recorded, and the rig as it is stated, with the true pose."""
    load = partial(recorded_pair, cache, replace(cell.sim, t_d_s=0.0))
    flown = Flown(load, cell.seed, second_seed(cell.seed))
    pair = spoilt_pair(flown, cell.spoilt, cell.sim.spline.duration_s)
    return pair._replace(cam2=pair.cam2.delayed(cell.sim.t_d_s - T_D_S))


def truth_of(cell: OddCell, pair: Pair) -> Truth:
    """Give what is true of it."""
    sim, skew_ppm = cell.sim, cell.spoilt.skew_of(cell.seed)
    return Truth(sim.t_d_s, *known_pose(pair.rig), skew_ppm, 0.5 * sim.spline.duration_s)


def drawn(base: int, flight: int, far: float = 0.5) -> OddCell:
    """Draw a recording by its number; `far` is the share of offsets beyond 1 s in most kinds."""
    rng = np.random.default_rng((base, flight))
    kind = list(KINDS)[flight % len(KINDS)]
    draw = KINDS[kind]
    duration_s = round(_log_uniform(rng, *draw.duration_s), 1)
    angle_deg = round(rng.uniform(20.0, 160.0), 1)
    distance_m = round(_log_uniform(rng, *draw.distance_m), 1)
    size_px = round(_log_uniform(rng, *draw.size_px), 1)
    sensor = str(rng.choice(draw.sensors))
    sim = SimConfig(
        angle_deg=angle_deg,
        t_d_s=_offset_s(rng, far if draw.far is None else draw.far),
        spline=_spline(rng, duration_s, distance_m, size_px),
        drone_size_m=round(size_px * distance_m / draw.focal_px, 3),
        distance_m=distance_m,
        focal_px=draw.focal_px,
        frames=FrameConfig(rate_hz=0.0),
    )
    if sensor != IDEAL:
        preset = SENSOR_PRESETS[sensor]
        sim = replace(sim, sensor=preset.sensor, effects=preset.effects)
    skew_ppm = SKEW_STD_PPM * rng.standard_normal()
    if draw.skew_ppm is not None:
        skew_ppm = _log_uniform(rng, *draw.skew_ppm) * rng.choice((-1.0, 1.0))
    calibration = CALIBRATIONS[rng.integers(len(CALIBRATIONS))]
    spoilt = Kind("", DisturbConfig(intrinsics_error=calibration), skew_ppm=round(skew_ppm, 1))
    spoilt, words = _SPOILS[kind](spoilt, rng, duration_s) if kind in _SPOILS else (spoilt, "")
    seed = flight_seed(duration_s, angle_deg, flight, base)
    return OddCell(sim, flight, seed, base, kind, sensor, size_px, spoilt, words)


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _offset_s(rng: Rng, far: float) -> float:
    near_s, far_s = rng.uniform(-1.0, 1.0), _log_uniform(rng, 1.0, 3600.0) * rng.choice((-1, 1))
    return round(float(far_s if rng.random() < far else near_s), 6)


def _spline(rng: Rng, duration_s: float, distance_m: float, size_px: float) -> SplineConfig:
    """Fill the view with the flight, less so for large objects, slower if long or fast."""
    plain, slowest = SplineConfig(), float(np.clip(duration_s / 8.0, 1.0, 2.5))
    slowness = _log_uniform(rng, 1.0, slowest)
    spread = distance_m / DISTANCE_M * rng.uniform(0.6, 1.0) * (1.0 - size_px / 240.0)
    too_fast = max(1.0, _PLAIN_M_S * spread / slowness / MAX_M_S)
    slowness, spread = round(slowness * too_fast**0.5, 2), spread / too_fast**0.5
    x, y, z = (round(spread * one, 3) for one in plain.multiplier_xyz_m)
    return replace(
        plain, duration_s=duration_s, sampling_hz=plain.sampling_hz / slowness,
        smoothing=plain.smoothing * slowness**3, multiplier_xyz_m=(x, y, z),
        max_radius_m=spread * plain.max_radius_m,
    )  # fmt: skip


def _cluttered(kind: Kind, rng: Rng, duration_s: float) -> tuple[Kind, str]:
    what = rng.integers(3)
    people = int(rng.integers(1, 4)) if what != 1 else 0
    branches = round(rng.uniform(5e3, 25e3) * duration_s) if what != 0 else 0
    disturb = replace(kind.disturb, people=people, branches=branches)
    return replace(kind, disturb=disturb), f"people {people} branches {branches}"


def _two_objects(kind: Kind, rng: Rng, duration_s: float) -> tuple[Kind, str]:
    share = round(rng.uniform(0.3, 1.0), 2)
    return replace(kind, disturb=replace(kind.disturb, second_object=share)), f"second {share}"


def _wrong_rig(kind: Kind, rng: Rng, duration_s: float) -> tuple[Kind, str]:
    """Spoil one thing, of which the rig states nothing."""
    index, sign = int(rng.integers(2)), rng.choice((-1.0, 1.0))
    focal, pu_px = round(sign * rng.uniform(0.0, 0.3), 3), round(sign * rng.uniform(5.0, 40.0), 1)
    both = round(sign * rng.uniform(0.0, 0.02), 4)
    swap_px = PRINCIPAL_POINT[1] - PRINCIPAL_POINT[0]
    errors, words = [
        (_one(index, (focal, focal, 0.0, 0.0)), f"focal length {index + 1} {100 * focal:+.1f} %"),
        (_one(index, (0.0, 0.0, swap_px, -swap_px)), f"principal point {index + 1} swapped"),
        (_one(index, (0.0, 0.0, pu_px, 0.0)), f"principal point {index + 1} {pu_px:+.1f} px"),
        (((both, both, 0.0, 0.0),) * 2, f"focal lengths {100 * both:+.1f} %"),
    ][int(rng.choice(4, p=(0.4, 0.2, 0.2, 0.2)))]
    disturb = replace(kind.disturb, intrinsics_error=(0.0, 0.0))
    return replace(kind, disturb=disturb, errors=errors, stated=GOOD), words


def _one(index: int, errors: Errors) -> tuple[Errors, Errors]:
    return (RIGHT, errors) if index else (errors, RIGHT)


_SPOILS: Mapping[str, Callable[[Kind, Rng, float], tuple[Kind, str]]] = {
    "clutter": _cluttered, "two objects": _two_objects, WRONG_RIG: _wrong_rig,
}  # fmt: skip
