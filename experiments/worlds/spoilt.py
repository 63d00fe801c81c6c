"""Imperfect recordings, as real ones are: clutter, clocks that drift apart, wrong intrinsics.

A flight is simulated and cached as any other. Disturbances are added when it is loaded, so that one
flight serves many kinds. All recordings of a kind have the same disturbances; the flight's seed
draws where they lie, and what else varies from flight to flight.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

from experiments.lab.cell import FlightCell
from experiments.lab.grid import flight_seed
from experiments.lab.recorded import Flown, Pair
from sim.disturb import DisturbConfig, View, clutter, merged, thinned, wrong_intrinsics
from sim.recorded import Drift, Jump
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig
from sim.seeds import generator
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.camera import Camera, Rig, with_deviations
from ssac.track.observation import Observation

T_D_S = 0.05
DURATION_S = 20.0

GOOD, CARELESS = (0.1, 0.3), (1.0, 3.0)
"""Standard deviations of calibrations: of focal lengths [%] and of the principal point [px]."""

Errors = tuple[float, float, float, float]
"""Errors of a camera's fu and fv, as shares, and of its pu and pv [px]; positive if too large."""

RIGHT: Errors = (0.0, 0.0, 0.0, 0.0)

ORDINARY = "ordinary"
TEXTURE = Path(__file__).parents[1] / "configs" / "backgrounds" / "leaves.png"
_NEAR = 0.6  # factor on the box of the flight, so that a large drone stays in view
_SKEW_STREAM = 12  # of the seed


@dataclass(frozen=True)
class KindCell(FlightCell):
    """A method on a kind of recording that is made of a flight."""

    kind: str
    other_seed: int  # of another flight, where the kind has one
    method: str

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is."""
        return {"kind": self.kind, **self.flown, "method": self.method}


def kind_cells(
    sim: SimConfig, flight: int, step: int, kinds: Iterable[str], methods: Sequence[str]
) -> list[KindCell]:
    """List every method on every kind of a flight; `step` leads to the number of the other one."""
    numbers = flight, flight + step
    seed, other = (flight_seed(sim.spline.duration_s, sim.angle_deg, one) for one in numbers)
    every = product(kinds, methods)
    return [KindCell(sim, flight, seed, kind, other, method) for kind, method in every]


@dataclass(frozen=True)
class Kind:
    """How a recording is spoilt."""

    scene: str  # name of what is filmed
    disturb: DisturbConfig = field(default_factory=DisturbConfig)
    others: bool = False  # camera 2 sees another flight than camera 1
    skew_std_ppm: float = 0.0  # deviation of the drawn skews of camera 2's clock
    skew_ppm: float | None = None  # the same in all flights; None: it is drawn
    jump: Jump | None = None  # of camera 2's clock
    errors: tuple[Errors, Errors] = (RIGHT, RIGHT)  # of the rig's intrinsics
    stated: tuple[float, float] | None = None  # deviations in the rig: focal [%], centre [px]

    def skew_of(self, seed: int) -> float:
        """Give the skew [ppm] of the recordings of a flight."""
        if self.skew_ppm is not None:
            return self.skew_ppm
        return self.skew_std_ppm * float(generator(seed, _SKEW_STREAM).standard_normal())


def _scenes() -> dict[str, SimConfig]:
    """Return scene and sensor by name; a size [px] is the drone's in the middle of the flight."""
    plain = SimConfig(t_d_s=T_D_S, spline=SplineConfig(DURATION_S), frames=FrameConfig(rate_hz=0.0))
    x, y, z = (_NEAR * multiplier for multiplier in plain.spline.multiplier_xyz_m)
    radius_m = _NEAR * plain.spline.max_radius_m
    near = replace(plain.spline, multiplier_xyz_m=(x, y, z), max_radius_m=radius_m)
    noisy = replace(plain, sensor=PRESETS["davis346"])
    return {
        ORDINARY: plain,
        "5 px": replace(plain, drone_size_m=0.12),
        "10 px": replace(plain, drone_size_m=0.24),
        "60 px": replace(plain, drone_size_m=1.4, spline=near),
        "davis346": noisy,
        "5 px, davis346": replace(noisy, drone_size_m=0.12),
        "bright sky": replace(plain, background_luminance=0.9),
        "dark sky": replace(plain, background_luminance=0.15),
        "leaves behind": replace(plain, background_files=(TEXTURE,)),
        "spinning rotors": replace(plain, rotor_hz=30.0),
        "60 s": replace(plain, spline=SplineConfig(60.0)),
        "120 s": replace(plain, spline=SplineConfig(120.0)),
    }


SCENES = _scenes()


def spoilt_pair(flown: Flown, kind: Kind, duration_s: float) -> Pair:
    """Return the two recordings, with their rig, that a kind makes of a flight with equal clocks.

    But for a jump, camera 2's clock shows `T_D_S` more in the middle. The rig has the kind's wrong
    intrinsics, and the true pose.
    """
    seed, flight = flown.seed, flown.flight
    seen = flight.cam1, flown.other.cam2 if kind.others else flight.cam2
    cameras, models = [], []
    for index, model in enumerate((flight.rig.cam1, flight.rig.cam2)):
        view = View(model.width, model.height, duration_s)
        streams = [seen[index].events, clutter(kind.disturb, view, seed, index)]
        if kind.disturb.second_object > 0.0:
            second = flown.other[:2][index].events
            streams.append(thinned(second, kind.disturb.second_object, seed, index))
        cameras.append(merged(*streams))
        models.append(_wrong(model, kind, seed, index))
    drift = Drift(kind.skew_of(seed), 0.5 * duration_s, kind.jump)
    cameras[1]["t"] += drift.added_us(cameras[1]["t"])
    rig = Rig(models[0], models[1], flight.rig.T_2_1)
    return Pair(Observation(cameras[0]), Observation(cameras[1]).delayed(T_D_S), rig)


def _wrong(camera: Camera, kind: Kind, seed: int, index: int) -> Camera:
    """Give a camera the intrinsics of the kind's calibration, with their stated deviations."""
    K, deviations_px = wrong_intrinsics(camera.K, kind.disturb, seed, index)
    fu, fv, pu_px, pv_px = kind.errors[index]
    K[0, 0] *= 1.0 + fu
    K[1, 1] *= 1.0 + fv
    K[:2, 2] += pu_px, pv_px
    camera = replace(camera, K=K, intrinsics_std_px=tuple(deviations_px.tolist()))
    if kind.stated is None:
        return camera
    percent, centre_px = kind.stated
    return with_deviations(camera, 0.01 * percent, centre_px)
