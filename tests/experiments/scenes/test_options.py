"""The options of `ssac simulate`: the configurations that they make."""

import inspect
from typing import get_args

import pytest

from experiments.scenes.options import OPTIONS, chosen, chosen_sensor
from experiments.scenes.simulate import simulate_command
from sim.disturb import DisturbConfig
from sim.effects.config import SENSOR_PRESETS
from sim.recording import SimConfig
from sim.render.config import RenderConfig
from sim.render.lattice import Lattice
from sim.sensor.events import PRESETS, SensorConfig

OTHERS = {"drone": "bird", "distortion_model": "radtan", "renderer": "pyrender", "gl": "egl",
          "trajectory": "flight.csv", "background": ("sky.png",), "distortion": (0.1, 0, 0, 0),
          "clock_jump": (1.0, 0.1), "drone_size": 0.5, "check": False, "resolution": (64, 48),
          "intrinsics_error": (1.0, 1.0)}  # fmt: skip
"""Values beside the default, where half of it is none."""


def test_an_option_that_is_not_given_has_the_default_of_its_field() -> None:
    parameters = inspect.signature(simulate_command).parameters
    defaults = {name: parameters[name].default for name in OPTIONS}
    defaults |= {"distortion": (), "background": ()}
    assert chosen(defaults) == (SimConfig(), DisturbConfig())


@pytest.mark.parametrize("name", [name for name, option in OPTIONS.items() if option.field])
def test_an_option_sets_its_field_and_no_other(name: str) -> None:
    parameter = inspect.signature(simulate_command).parameters[name]
    kind = get_args(parameter.annotation)[0]
    default = parameter.default
    value = OTHERS.get(name, 0.5 * default if default and kind is float else 1)
    field = OPTIONS[name].field
    root, *path = field.split(".") if field.startswith("disturb.") else ("sim", *field.split("."))
    before, after = (
        dict(zip(("sim", "disturb"), made, strict=True))
        for made in (chosen({}), chosen({name: value}))
    )
    assert {one for one in before if before[one] != after[one]} == {root}
    changed = [
        key for key in vars(before[root]) if getattr(before[root], key) != getattr(after[root], key)
    ]
    assert changed == path[:1]
    found = after[root]
    for part in path:
        found = getattr(found, part)
    assert found == value


def test_an_option_keeps_what_else_is_said_of_its_part() -> None:
    config, _ = chosen({"gl": "egl"}, render=RenderConfig(lattice=Lattice(4, 1)))
    assert config.render == RenderConfig(lattice=Lattice(4, 1), backend="egl")


def test_no_option_makes_the_ideal_sensor() -> None:
    sensor = chosen_sensor(None, "ideal", None, None, None, ())
    assert sensor.sensor == SensorConfig()
    assert sensor.effects.is_none
    assert chosen_sensor(None, "davis346", None, None, None, ()).sensor == PRESETS["davis346"]


def test_options_take_the_place_of_the_presets_values() -> None:
    effects = ["latency_s=2e-3", "hot_clusters = 7"]
    sensor = chosen_sensor("davis346-dim", "ideal", 0.1, None, 2.0, effects)
    preset = SENSOR_PRESETS["davis346-dim"]
    assert (sensor.sensor.threshold_on, sensor.sensor.threshold_off) == (
        0.1,
        preset.sensor.threshold_off,
    )
    assert sensor.effects.illuminance_lux == 2.0
    assert (sensor.effects.latency_s, sensor.effects.hot_clusters) == (2e-3, 7)
    assert sensor.effects.cutoff_hz_per_lux == preset.effects.cutoff_hz_per_lux
