"""A kind of imperfect recording by its name in; how it is simulated, and what spoils it, out.

Kinds of one scene are made of the same flight. What varies from flight to flight within a kind, as
the skew and the error of the intrinsics, is drawn from the deviations that stand here.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

from sim.disturb import DisturbConfig
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig
from sim.seeds import generator
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig

T_D_S = 0.05
DURATION_S = 20.0
SKEW_STD_PPM = 50.0
"""Of clocks that run by oscillators: the prior of the methods."""

GOOD, CARELESS = (0.1, 0.3), (1.0, 3.0)
"""Calibrations: deviations of the focal lengths [%] and of the centre [px]."""

ORDINARY = "ordinary"
TEXTURE = Path(__file__).parents[1] / "configs" / "backgrounds" / "leaves.png"
_NEAR = 0.6  # of the box of the flight: so that a large drone stays in view
_SKEW_STREAM = 12  # of the seed


@dataclass(frozen=True)
class Kind:
    """One kind of recording."""

    scene: str  # of SCENES
    disturb: DisturbConfig = field(default_factory=DisturbConfig)
    skew_std_ppm: float = 0.0  # of the draws of camera 2's clock

    def skew_ppm(self, seed: int) -> float:
        """Draw the skew of a flight's recordings of this kind."""
        return self.skew_std_ppm * float(generator(seed, _SKEW_STREAM).standard_normal())


def _scenes() -> dict[str, SimConfig]:
    """List what is filmed and by which sensor; a size is that in the middle of the flight."""
    plain = SimConfig(t_d_s=T_D_S, spline=SplineConfig(DURATION_S), frames=FrameConfig(rate_hz=0.0))
    x, y, z = (_NEAR * multiplier for multiplier in plain.spline.multiplier_xyz_m)
    near = replace(
        plain.spline, multiplier_xyz_m=(x, y, z), max_radius_m=_NEAR * plain.spline.max_radius_m
    )
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

_TYPICAL = DisturbConfig(noise_hz=1.0, hot_clusters=2, intrinsics_error=GOOD)
_ALL = DisturbConfig(
    lamp_px=6, hot_clusters=5, noise_hz=1.0, branches=100_000, people=1, second_object=0.1,
    intrinsics_error=GOOD,
)  # fmt: skip

KINDS: dict[str, Kind] = {
    ORDINARY: Kind(ORDINARY),
    **{
        f"noise {hz:g} Hz/px": Kind(ORDINARY, DisturbConfig(noise_hz=hz)) for hz in (1.0, 3.0, 10.0)
    },
    "good calibration": Kind(ORDINARY, DisturbConfig(intrinsics_error=GOOD)),
    "careless calibration": Kind(ORDINARY, DisturbConfig(intrinsics_error=CARELESS)),
    "skew": Kind(ORDINARY, skew_std_ppm=SKEW_STD_PPM),
    **{
        f"second object {100 * share:g} %": Kind(ORDINARY, DisturbConfig(second_object=share))
        for share in (0.1, 0.2, 1.0)
    },
    "lamp 6 px": Kind(ORDINARY, DisturbConfig(lamp_px=6)),
    "lamp 12 px": Kind(ORDINARY, DisturbConfig(lamp_px=12)),
    "hot clusters": Kind(ORDINARY, DisturbConfig(hot_clusters=5)),
    "branches": Kind(ORDINARY, DisturbConfig(branches=500_000)),
    "people": Kind(ORDINARY, DisturbConfig(people=2)),
    "all at once": Kind(ORDINARY, _ALL, SKEW_STD_PPM),
    **{
        name: kind
        for scene in SCENES
        if scene != ORDINARY
        for name, kind in (
            (scene, Kind(scene)),
            (f"{scene}, typical", Kind(scene, _TYPICAL, SKEW_STD_PPM)),
        )
    },
}
"""By name. "Typical" is noise of 1 Hz/px, two hot clusters, a good calibration and a skew."""
