"""The options of `ssac simulate`: each but a few sets one field of a configuration.

Such an option has the type and the default of its field, so that the two cannot come apart.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from sim.disturb import MAX_FOCAL_PERCENT, DisturbConfig
from sim.effects.config import SENSOR_PRESETS, SensorEffects, SensorPreset, sensor_preset
from sim.errors import SimError
from sim.recorded import MAX_SKEW_PPM
from sim.recording import SimConfig
from sim.render.config import RENDERERS
from sim.scene.flyers import DRONES
from sim.sensor.events import PRESETS
from ssac.cli.options import Option, flag, named, number

MAX_SEED = 2**32 - 1

_IDEAL = "ideal"
_DISTURB = "disturb."
_ON = SimConfig().sensor.threshold_on


@dataclass(frozen=True)
class SimOption(Option):
    """One option; its field is of SimConfig, or of DisturbConfig after `disturb.`, dotted."""

    type: Any = None  # None: the field's, as is the default then

    @property
    def parameter(self) -> tuple[Any, Any]:
        """Type and default of the command's parameter."""
        hint, default = self.type, self.default
        if self.field and hint is None:
            config: Any = DisturbConfig() if self.field.startswith(_DISTURB) else SimConfig()
            *path, last = self.field.removeprefix(_DISTURB).split(".")
            for name in path:
                config = getattr(config, name)
            hint, default = get_type_hints(type(config))[last], getattr(config, last)
        return Annotated[hint, self.info], default


OPTIONS: Mapping[str, SimOption] = {
    "angle": SimOption(
        number("Angle between the two lines of sight.", 1, 179, "degrees"), "angle_deg"
    ),
    "duration": SimOption(
        number("Duration of the flight.", 1, 3600, "seconds"), "spline.duration_s"
    ),
    "t_d": SimOption(
        number("Time offset: t_cam2 = t_cam1 + t_d.", -86400, 86400, "seconds"), "t_d_s"
    ),
    "skew_ppm": SimOption(
        number("Camera 2's clock runs fast by this rate; t_d then holds at mid-flight.",
               -MAX_SKEW_PPM, MAX_SKEW_PPM, "ppm"), "skew_ppm"
    ),
    "clock_jump": SimOption(
        named("T S", "Camera 2's clock jumps forward by S seconds (S > 0) at time T."),
        "clock_jump", tuple[float, float] | None
    ),
    "seed": SimOption(
        number("Random seed: the same seed gives the same bytes.", 0, MAX_SEED),
        type=int, default=0
    ),
    "trajectory": SimOption(
        named("FILE", "CSV t,x,y,z,qx,qy,qz,qw instead of a random spline; sets the duration."),
        "trajectory_file"
    ),
    "drone": SimOption(
        named("NAME", f"{', '.join(DRONES)}, or a mesh file."), type=str, default=SimConfig.drone
    ),
    "drone_size": SimOption(
        number("Largest extent of the drone.", 0.01, 100, "metres"), "drone_size_m"
    ),
    "rotor_hz": SimOption(
        number("Turns per second of a quadrotor's rotors.", -1000, 1000, "hertz"), "rotor_hz"
    ),
    "flap_hz": SimOption(
        number("Beats per second of the bird's wings.", 0, 100, "hertz"), "flap_hz"
    ),
    "distance": SimOption(
        number("Distance of the cameras from the point they look at.", 0.1, 10_000, "metres"),
        "distance_m"
    ),
    "spread": SimOption(
        number("Scale of the random flight; below 1 keeps a near drone in view.", 0.01, 100),
        type=float, default=1.0
    ),
    "focal": SimOption(number("Focal length.", 10, 100_000, "pixels"), "focal_px"),
    "resolution": SimOption(
        number("Width and height of each camera's image.", 16, 8192, "pixels", "WIDTH HEIGHT"),
        "resolution"
    ),
    "distortion_model": SimOption(
        named("NAME", "none, radtan or equidistant."), "distortion_model"
    ),
    "distortion": SimOption(
        number("Distortion coefficients: k1 k2 p1 p2 (radtan) or k1 k2 k3 k4 (equidistant).",
               -10, 10, metavar="K K K K"),
        "distortion_coeffs", tuple[float, float, float, float], (0.0, 0.0, 0.0, 0.0)
    ),
    "background": SimOption(
        named("FILE", "Image behind the drone: give one for all cameras, or one for each."),
        "background_files", list[Path] | None
    ),
    "background_luminance": SimOption(
        number("Luminance of the sky where there is no image.", 0, 1), "background_luminance"
    ),
    "preset": SimOption(
        named("NAME", "Sensor model with the imperfections of a real one: "
               f"{', '.join(SENSOR_PRESETS)}."), type=str | None
    ),
    "illuminance": SimOption(
        number("Illuminance of the scene, on which the sensor's effects depend.",
               1e-3, 1e6, "lux"), type=float | None
    ),
    "effect": SimOption(
        named("NAME=VALUE", "Set one effect of the sensor, overriding the preset; names in "
               "docs/sensor.md. May be given several times."), type=list[str] | None
    ),
    "noise": SimOption(
        named("NAME", f"Pixel noise without other effects: {', '.join(PRESETS)}."),
        type=str, default=_IDEAL
    ),
    "lamp": SimOption(
        number("Side of a flickering square, such as a lamp; 0 for none.", 0, 100, "pixels"),
        "disturb.lamp_px"
    ),
    "hot_clusters": SimOption(
        number("Number of 3x3 clusters of hot pixels.", 0, 1000), "disturb.hot_clusters"
    ),
    "noise_hz": SimOption(
        number("Rate of noise events per pixel, added to --noise.", 0, 100, "hertz"),
        "disturb.noise_hz"
    ),
    "branches": SimOption(
        number("Number of events from swaying branches, in each camera.", 0, 100_000_000,
               metavar="EVENTS"), "disturb.branches"
    ),
    "people": SimOption(
        number("Number of people who walk through each view.", 0, 100), "disturb.people"
    ),
    "clouds": SimOption(
        number("Speed of drifting clouds; 0 for none.", 0, 100, "px/s"), "disturb.clouds_px_s"
    ),
    "second_object": SimOption(
        number("Add this share of the events of a second drone.", 0, 1, metavar="SHARE"),
        "disturb.second_object"
    ),
    "intrinsics_error": SimOption(
        number("Standard deviations of errors drawn for the rig file: focal lengths, at most "
               f"{MAX_FOCAL_PERCENT:g} %, and centres.", 0, 100, metavar="PERCENT PX"),
        "disturb.intrinsics_error"
    ),
    "threshold_on": SimOption(
        number(f"ON contrast threshold, in log intensity; default: {_ON:g}, or the preset's.",
               0.01, 5), type=float | None
    ),
    "threshold_off": SimOption(
        number("OFF contrast threshold; same default.", 0.01, 5), type=float | None
    ),
    "frame_rate": SimOption(
        number("Intensity frames per second; 0 for none.", 0, 1000, "hertz"), "frames.rate_hz"
    ),
    "exposure": SimOption(
        number("Exposure time of a frame.", 1e-5, 1, "seconds"), "frames.exposure_s"
    ),
    "max_step": SimOption(
        number("Largest image motion between rendered instants.", 0.005, 10, "pixels"),
        "sampling.max_step_px"
    ),
    "lattice": SimOption(
        number("Supersampling: a*a + b*b samples per pixel, b = 0 or 1.", 0, 64, metavar="A B"),
        type=tuple[int, int], default=(SimConfig().render.lattice.a, SimConfig().render.lattice.b)
    ),
    "renderer": SimOption(
        named("NAME", f"Renderer: {' or '.join(RENDERERS)} (OpenGL)."), "render.renderer"
    ),
    "check": SimOption(
        typer.Option("--check/--no-check",
                     help="Check some instants against OpenGL; --no-check where there is none."),
        "render.check"
    ),
    "gl": SimOption(named("NAME", "GL backend: auto, osmesa or egl."), "render.backend"),
    "text": SimOption(flag("text", "Write ESIM text files too."), type=bool, default=False),
    "figures": SimOption(
        flag("figures", "Print statistics of the scene beside those of the authors' sample."),
        type=bool, default=False
    ),
}  # fmt: skip
"""By the name of the parameter, in the order of the help."""


def chosen(options: Mapping[str, Any], **more: Any) -> tuple[SimConfig, DisturbConfig]:
    """Make the configurations that options ask for; those that set no field are left out.

    `more` are further fields of SimConfig: of dataclasses, options may set fields too.
    """
    values = {OPTIONS[name].field: value for name, value in options.items()}
    values.pop("", None)
    disturb = {name.removeprefix(_DISTURB): values.pop(name)
               for name in list(values) if name.startswith(_DISTURB)}  # fmt: skip
    return _changed(SimConfig(), values, more), _changed(DisturbConfig(), disturb, {})


def _changed(default: Any, values: Mapping[str, Any], whole: Mapping[str, Any]) -> Any:
    """Change fields by dotted names, all at once: a configuration checks them together."""
    changes, parts = dict(whole), dict[str, dict[str, Any]]()
    for name, value in values.items():
        head, _, rest = name.partition(".")
        if rest:
            parts.setdefault(head, {})[rest] = value
        else:
            changes[head] = value
    for head, part in parts.items():
        changes[head] = _changed(changes.get(head, getattr(default, head)), part, {})
    return replace(default, **changes)


def chosen_sensor(
    preset: str | None,
    noise: str,
    threshold_on: float | None,
    threshold_off: float | None,
    illuminance_lux: float | None,
    effects: Iterable[str],
) -> SensorPreset:
    """Make the sensor that the options ask for: what is given takes the place of the preset's.

    SimError when a name is unknown, a value makes no sense, or two options contradict each other.
    """
    if noise not in PRESETS:
        raise SimError(f"--noise: expected one of {', '.join(PRESETS)}, got {noise!r}")
    if preset is not None and noise != _IDEAL:
        raise SimError(
            f"--preset {preset} has noise of its own, and so does --noise {noise}: leave one out"
        )
    if preset is not None and preset not in SENSOR_PRESETS:
        raise SimError(f"--preset: expected one of {', '.join(SENSOR_PRESETS)}, got {preset!r}")
    start = SensorPreset(PRESETS[noise], SensorEffects())
    if preset is not None:
        start = sensor_preset(preset)
    thresholds = {"threshold_on": threshold_on, "threshold_off": threshold_off}
    given = {name: value for name, value in thresholds.items() if value is not None}
    changes = dict(_parsed(effect) for effect in effects)
    if illuminance_lux is not None:
        if "illuminance_lux" in changes:
            raise SimError("--illuminance and --effect illuminance_lux are one: leave one out")
        changes["illuminance_lux"] = illuminance_lux
    return SensorPreset(replace(start.sensor, **given), replace(start.effects, **changes))


def _parsed(effect: str) -> tuple[str, Any]:
    """Read a name and a value: a field of `SensorEffects`."""
    name, equals, text = (part.strip() for part in effect.partition("="))
    types = {one.name: type(getattr(SensorEffects(), one.name)) for one in fields(SensorEffects)}
    if not equals or name not in types:
        raise SimError(
            f"--effect: expected NAME=VALUE with a name of {', '.join(types)}, got {effect!r}"
        )
    try:
        return name, types[name](text)
    except ValueError:
        kind = "a whole number" if types[name] is int else "a number"
        raise SimError(f"--effect {name}: expected {kind}, got {text!r}") from None
