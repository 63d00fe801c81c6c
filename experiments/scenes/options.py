"""The options of `ssac simulate`, most of which set one field of a configuration.

Such an option takes its type and default from the field, so that option and field always agree.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from experiments.lab.grid import changed
from sim.disturb import MAX_FOCAL_PERCENT, DisturbConfig
from sim.effects.config import SENSOR_PRESETS, SensorEffects, SensorPreset
from sim.errors import SimError
from sim.recorded import MAX_SKEW_PPM
from sim.recording import SimConfig
from sim.render.config import RENDERERS
from sim.scene.flyers import DRONES
from sim.sensor.events import PRESETS, SensorConfig
from ssac.cli.options import Option, flag, named, number

MAX_SEED = 2**32 - 1

_IDEAL = "ideal"
_DISTURB = "disturb."
_THRESHOLDS = ("threshold_on", "threshold_off")  # options of their own, not of --effect
_ON = SimConfig().sensor.threshold_on


@dataclass(frozen=True)
class SimOption(Option):
    """One option; its field is a dotted name in SimConfig, or in DisturbConfig after `disturb.`."""

    type: Any = None  # None: type and default are the field's

    @property
    def parameter(self) -> tuple[Any, Any]:
        """Type and default of the command's parameter."""
        if not self.field or self.type is not None:
            return Annotated[self.type, self.info], self.default
        config: Any = DisturbConfig() if self.field.startswith(_DISTURB) else SimConfig()
        *path, last = self.field.removeprefix(_DISTURB).split(".")
        owner = reduce(getattr, path, config)
        return Annotated[get_type_hints(type(owner))[last], self.info], getattr(owner, last)


def _of(field: str, info: Any) -> SimOption:
    """Make an option with the type and the default of its field."""
    return SimOption(info, field)


def _own(type_: Any, default: Any, info: Any, field: str = "") -> SimOption:
    """Make an option with a type and a default of its own."""
    return SimOption(info, field, type_, default)


OPTIONS: Mapping[str, SimOption] = {
    "angle": _of("angle_deg", number("Angle between the two lines of sight.", 1, 179, "degrees")),
    "cameras": _own(int, 2, number(
        "Number of cameras, each turned by --angle from the one before, its clock off by --t-d.",
        2, 100, metavar="COUNT",
    )),
    "duration": _of("spline.duration_s", number("Duration of the flight.", 1, 3600, "seconds")),
    "t_d": _of(
        "t_d_s", number("Time offset: t_cam2 = t_cam1 + t_d.", -86400, 86400, "seconds")
    ),
    "skew_ppm": _of("skew_ppm", number(
        "Camera 2's clock runs fast by this rate; t_d then holds at mid-flight.",
        -MAX_SKEW_PPM, MAX_SKEW_PPM, "ppm",
    )),
    "clock_jump": _own(tuple[float, float] | None, None, named(
        "T S", "Camera 2's clock jumps forward by S seconds (S > 0) at time T."), "clock_jump"
    ),
    "seed": _own(int, 0, number("Random seed: the same seed gives the same bytes.", 0, MAX_SEED)),
    "trajectory": _of("trajectory_file", named(
        "FILE", "CSV t,x,y,z,qx,qy,qz,qw instead of a random spline; sets the duration."
    )),
    "drone": _own(str, SimConfig.drone, named("NAME", f"{', '.join(DRONES)}, or a mesh file.")),
    "drone_size": _of("drone_size_m", number(
        "Largest horizontal extent of the drone.", 0.01, 100, "metres"
    )),
    "rotor_hz": _of(
        "rotor_hz", number("Turns per second of a quadrotor's rotors.", -1000, 1000, "hertz")
    ),
    "flap_hz": _of("flap_hz", number("Beats per second of the bird's wings.", 0, 100, "hertz")),
    "distance": _of("distance_m", number(
        "Distance of the cameras from the point they look at.", 0.1, 10_000, "metres"
    )),
    "spread": _own(float, 1.0, number(
        "Scale of the random flight; below 1 keeps a near drone in view.", 0.01, 100
    )),
    "focal": _of("focal_px", number("Focal length.", 10, 100_000, "pixels")),
    "resolution": _of("resolution", number(
        "Width and height of each camera's image.", 16, 8192, "pixels", "WIDTH HEIGHT"
    )),
    "distortion_model": _of("distortion_model", named("NAME", "none, radtan or equidistant.")),
    "distortion": _own(tuple[float, float, float, float], (0.0, 0.0, 0.0, 0.0), number(
        "Distortion coefficients: k1 k2 p1 p2 (radtan) or k1 k2 k3 k4 (equidistant).",
        -10, 10, metavar="K K K K"), "distortion_coeffs",
    ),
    "background": _own(list[Path] | None, None, named(
        "FILE", "Image behind the drone: give one for all cameras, or one for each of two."),
        "background_files",
    ),
    "background_luminance": _of(
        "background_luminance", number("Luminance of the sky where there is no image.", 0, 1)
    ),
    "preset": _own(str | None, None, named(
        "NAME", f"Sensor model with the imperfections of a real one: {', '.join(SENSOR_PRESETS)}."
    )),
    "illuminance": _own(float | None, None, number(
        "Illuminance of the scene, on which the sensor's effects depend.", 1e-3, 1e6, "lux"
    )),
    "effect": _own(list[str] | None, None, named(
        "NAME=VALUE", "Set one effect of the sensor, overriding the preset and --noise; names in "
        "docs/sensor.md. May be given several times."
    )),
    "noise": _own(str, _IDEAL, named(
        "NAME", f"Pixel noise without other effects: {', '.join(PRESETS)}."
    )),
    "lamp": _of("disturb.lamp_px", number(
        "Side of a flickering square, such as a lamp; 0 for none.", 0, 100, "pixels"
    )),
    "hot_clusters": _of(
        "disturb.hot_clusters", number("Number of 3x3 clusters of hot pixels.", 0, 1000)
    ),
    "noise_hz": _of("disturb.noise_hz", number(
        "Rate of noise events per pixel, added to --noise.", 0, 100, "hertz"
    )),
    "branches": _of("disturb.branches", number(
        "Rough number of events from swaying branches, a camera.", 0, 100_000_000, metavar="EVENTS"
    )),
    "people": _of(
        "disturb.people", number("Number of people who walk through each view.", 0, 100)
    ),
    "clouds": _of(
        "disturb.clouds_px_s", number("Speed of drifting clouds; 0 for none.", 0, 100, "px/s")
    ),
    "second_object": _of("disturb.second_object", number(
        "Add this share of the events of a second drone.", 0, 1, metavar="SHARE"
    )),
    "intrinsics_error": _of("disturb.intrinsics_error", number(
        "Standard deviations of errors drawn for the rig file: focal lengths, at most "
        f"{MAX_FOCAL_PERCENT:g} %, and centres.", 0, 100, metavar="PERCENT PX"
    )),
    "threshold_on": _own(float | None, None, number(
        f"ON contrast threshold, in log intensity; default: {_ON:g}, or the preset's.", 0.01, 5
    )),
    "threshold_off": _own(
        float | None, None, number("OFF contrast threshold; same default.", 0.01, 5)
    ),
    "frame_rate": _of(
        "frames.rate_hz", number("Intensity frames per second; 0 for none.", 0, 1000, "hertz")
    ),
    "exposure": _of("frames.exposure_s", number("Exposure time of a frame.", 1e-5, 1, "seconds")),
    "max_step": _of("sampling.max_step_px", number(
        "Largest image motion between rendered instants.", 0.005, 10, "pixels"
    )),
    "lattice": _own(
        tuple[int, int], (SimConfig().render.lattice.a, SimConfig().render.lattice.b), number(
            "Supersampling: a*a + b*b samples per pixel, a above 0, b = 0 or 1.", 0, 31,
            metavar="A B",
    )),
    "renderer": _of(
        "render.renderer", named("NAME", f"Renderer: {' or '.join(RENDERERS)} (OpenGL).")
    ),
    "check": _of("render.check", typer.Option(
        "--check/--no-check",
        help="Check some instants against OpenGL; --no-check where there is none.",
    )),
    "gl": _of("render.backend", named("NAME", "GL backend: auto, osmesa or egl.")),
    "text": _own(bool, False, flag("text", "Write ESIM text files too.")),
}  # fmt: skip
"""Options by the name of the command's parameter, in the order of the help."""


def chosen(options: Mapping[str, Any], **more: Any) -> tuple[SimConfig, DisturbConfig]:
    """Make configurations of the options that set fields, and of `more`, fields of SimConfig."""
    values = {OPTIONS[name].field: value for name, value in options.items() if OPTIONS[name].field}
    disturb = {name: values.pop(name) for name in list(values) if name.startswith(_DISTURB)}
    of_disturb = {name.removeprefix(_DISTURB): value for name, value in disturb.items()}
    return changed(SimConfig(), more | values), replace(DisturbConfig(), **of_disturb)


def chosen_sensor(options: Mapping[str, Any]) -> SensorPreset:
    """Return the sensor that the options set; each given value replaces the preset's."""
    preset, noise = options["preset"], options["noise"]
    for name, value, known in (("noise", noise, PRESETS), ("preset", preset, SENSOR_PRESETS)):
        if value is not None and value not in known:
            raise SimError(f"--{name}: expected one of {', '.join(known)}, got {value!r}")
    if preset is not None and noise != _IDEAL:
        raise SimError(
            f"--preset {preset} has noise of its own, and so does --noise {noise}: leave one out"
        )
    ideal = SensorPreset(PRESETS[noise], SensorEffects())
    start = ideal if preset is None else SENSOR_PRESETS[preset]
    given = {name: options[name] for name in _THRESHOLDS if options[name] is not None}
    changes = dict(_parsed(effect) for effect in options["effect"] or ())
    if options["illuminance"] is not None:
        if "illuminance_lux" in changes:
            raise SimError("--illuminance and --effect illuminance_lux are one: leave one out")
        changes["illuminance_lux"] = options["illuminance"]
    given |= {name: changes.pop(name) for name in list(changes) if hasattr(SensorConfig, name)}
    return SensorPreset(replace(start.sensor, **given), replace(start.effects, **changes))


def _parsed(effect: str) -> tuple[str, Any]:
    """Parse NAME=VALUE, where the name is a field of `SensorEffects`, or of the sensor itself."""
    name, equals, text = (part.strip() for part in effect.partition("="))
    known = vars(SensorEffects()) | vars(SensorConfig())
    types = {field: type(value) for field, value in known.items() if field not in _THRESHOLDS}
    if not equals or name not in types:
        raise SimError(
            f"--effect: expected NAME=VALUE with a name of {', '.join(types)}, got {effect!r}"
        )
    try:
        return name, types[name](text)
    except ValueError:
        kind = "a whole number" if types[name] is int else "a number"
        raise SimError(f"--effect {name}: expected {kind}, got {text!r}") from None
