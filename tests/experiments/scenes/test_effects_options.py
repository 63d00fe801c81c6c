"""`ssac simulate --preset`, `--illuminance` and `--effect`: the sensor that they make."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from experiments.cli import app
from experiments.scenes.effects_options import chosen_sensor
from sim.effects.config import SENSOR_PRESETS, SensorEffects
from sim.errors import SimError
from sim.sensor.events import PRESETS, SensorConfig

FAST = ["--duration", "1", "--max-step", "2", "--lattice", "2", "0", "--frame-rate", "25"]


def test_no_option_makes_the_ideal_sensor() -> None:
    chosen = chosen_sensor(None, "ideal", None, None, None, ())
    assert chosen.sensor == SensorConfig()
    assert chosen.effects.is_none
    assert chosen_sensor(None, "davis346", None, None, None, ()).sensor == PRESETS["davis346"]


def test_options_take_the_place_of_the_presets_values() -> None:
    effects = ["latency_s=2e-3", "hot_clusters = 7"]
    chosen = chosen_sensor("davis346-dim", "ideal", 0.1, None, 2.0, effects)
    preset = SENSOR_PRESETS["davis346-dim"]
    assert (chosen.sensor.threshold_on, chosen.sensor.threshold_off) == (
        0.1,
        preset.sensor.threshold_off,
    )
    assert chosen.effects.illuminance_lux == 2.0
    assert (chosen.effects.latency_s, chosen.effects.hot_clusters) == (2e-3, 7)
    assert chosen.effects.cutoff_hz_per_lux == preset.effects.cutoff_hz_per_lux


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "davis"], "--preset: expected one of davis346, davis346-dim, evk4"),
        (["--preset", "evk4", "--noise", "davis346"], "leave one out"),
        (["--noise", "loud"], "expected one of ideal, davis346, got 'loud'"),
        (["--effect", "latency=1"], "expected NAME=VALUE with a name of illuminance_lux"),
        (["--effect", "latency_s"], "expected NAME=VALUE"),
        (["--effect", "latency_s=late"], "--effect latency_s: expected a number, got 'late'"),
        (["--effect", "hot_clusters=1.5"], "expected a whole number, got '1.5'"),
        (["--effect", "jitter_s=-1"], "effects: jitter_s must be 0 or a positive number"),
        (["--effect", "cutoff_max_hz=0"], "effects: cutoff_max_hz must be a positive number"),
        (["--effect", "frame_gap_s=0.02"], "frame_gap_s must be less than 1 / rate_hz"),
        (["--illuminance", "0"], "--illuminance: expected 0.001 to 1000000 lux, got 0"),
        (["--illuminance", "9", "--effect", "illuminance_lux=8"], "are one: leave one out"),
    ],
)
def test_what_makes_no_sense_is_one_line(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    result = CliRunner().invoke(app, ["simulate", str(tmp_path / "out"), *arguments])
    assert result.exit_code != 0
    said = str(result.exception) if not result.output else result.output
    assert message in said
    assert "\n" not in said.strip()
    assert not (tmp_path / "out").exists()


def test_an_unknown_field_is_no_effect() -> None:
    with pytest.raises(SimError, match="expected NAME=VALUE"):
        chosen_sensor(None, "ideal", None, None, None, ["threshold_on=0.1"])


@pytest.mark.render
def test_a_preset_is_recorded_and_written_down(tmp_path: Path) -> None:
    out = tmp_path / "dim"
    arguments = ["--preset", "davis346-dim", "--effect", "camera2_light=0.5", "--no-check"]
    result = CliRunner().invoke(app, ["simulate", str(out), *FAST, *arguments])
    assert result.exit_code == 0, result.output
    written = json.loads((out / "truth.json").read_text())["provenance"]["config"]["effects"]
    assert written["camera2_light"] == 0.5
    assert set(written) == set(vars(SensorEffects()))
