"""The options of `ssac simulate` that say how bad a sensor is, and the sensor that they make."""

from collections.abc import Iterable
from dataclasses import fields, replace
from typing import Annotated, Any

import typer

from sim.effects.config import SENSOR_PRESETS, SensorEffects, SensorPreset, sensor_preset
from sim.errors import SimError
from sim.sensor.events import PRESETS
from ssac.console.options import number

IDEAL = "ideal"

PresetOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"Sensor model with the imperfections of a real one: {', '.join(SENSOR_PRESETS)}.",
    ),
]
IlluminanceOption = Annotated[
    float | None,
    number("Illuminance of the scene, on which the sensor's effects depend.", 1e-3, 1e6, "lux"),
]
EffectOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=VALUE",
        help="Set one effect of the sensor, overriding the preset; names in docs/physical.md. "
        "May be given several times.",
    ),
]
NoiseNameOption = Annotated[
    str,
    typer.Option(metavar="NAME", help=f"Pixel noise without other effects: {', '.join(PRESETS)}."),
]


def chosen_sensor(
    preset: str | None,
    noise: str,
    threshold_on: float | None,
    threshold_off: float | None,
    illuminance_lux: float | None,
    effects: Iterable[str],
) -> SensorPreset:
    """Make the sensor that the options ask for.

    Parameters
    ----------
    preset
        A name of `SENSOR_PRESETS`, or None.
    noise
        A name of `sim.sensor.events.PRESETS`.
    threshold_on, threshold_off, illuminance_lux
        In place of the preset's, unless None.
    effects
        Each "NAME=VALUE", after the fields of `SensorEffects`, in place of the preset's.

    Raises
    ------
    SimError
        When a name is unknown or a value makes no sense, or two options contradict each other.
    """
    if noise not in PRESETS:
        raise SimError(f"--noise: expected one of {', '.join(PRESETS)}, got {noise!r}")
    if preset is not None and noise != IDEAL:
        raise SimError(
            f"--preset {preset} has noise of its own, and so does --noise {noise}: leave one out"
        )
    if preset is not None and preset not in SENSOR_PRESETS:
        raise SimError(f"--preset: expected one of {', '.join(SENSOR_PRESETS)}, got {preset!r}")
    chosen = SensorPreset(PRESETS[noise], SensorEffects())
    if preset is not None:
        chosen = sensor_preset(preset)
    thresholds = {"threshold_on": threshold_on, "threshold_off": threshold_off}
    given = {name: value for name, value in thresholds.items() if value is not None}
    changes = dict(_parsed(effect) for effect in effects)
    if illuminance_lux is not None:
        if "illuminance_lux" in changes:
            raise SimError("--illuminance and --effect illuminance_lux are one: leave one out")
        changes["illuminance_lux"] = illuminance_lux
    return SensorPreset(replace(chosen.sensor, **given), replace(chosen.effects, **changes))


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
