"""`ssac simulate` as its users run it, and the configurations that its options make."""

import inspect
from dataclasses import asdict, replace
from functools import partial
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from experiments.lab import provenance
from experiments.scenes.demo import FILES
from experiments.scenes.options import OPTIONS, chosen, chosen_sensor
from experiments.scenes.simulate import simulate_command
from sim.disturb import DisturbConfig
from sim.effects.config import SENSOR_PRESETS
from sim.recording import SimConfig
from sim.render.config import RenderConfig
from sim.render.lattice import Lattice
from sim.sensor.events import PRESETS, SensorConfig
from ssac.errors import SsacError
from ssac.files.event_files import load_events
from ssac.files.rigs import load_rig
from ssac.network.tum import read_path
from tests.experiments.command import run
from tests.left_over import ended_process, made_by
from tests.ssac.command import read_json

FAST = ["--duration", "2", "--max-step", "2", "--lattice", "2", "0"]

simulate = partial(run, "simulate")


@pytest.mark.render
def test_the_folder_holds_what_the_design_says(tmp_path):
    plain = tmp_path / "new" / "recording"
    simulate(plain, *FAST, "--t-d", 0.05, "--skew-ppm", 1000, "--angle", 60, "--text")
    files = {"cam1.h5", "cam2.h5", "rig.yaml", "rig_extrinsics.yaml", "truth.json", "truth.tum"}
    assert files == FILES  # of a demo, which replaces no others
    assert {path.name for path in plain.iterdir()} == {*files, "cam1.txt", "cam2.txt"}
    truth = read_json(plain / "truth.json")
    assert truth["t_d_s"] == 0.05
    assert "disturbances" not in truth["provenance"]
    path = read_path(plain / "truth.tum")
    np.testing.assert_allclose(path.times_s, truth["times_s"], atol=1e-7)  # a TUM file's digits
    np.testing.assert_allclose(path.positions_m, truth["drone_position_W_m"], atol=1e-8)
    turned = Rotation.from_quat(truth["drone_quaternion_W_B_xyzw"])
    assert (Rotation.from_quat(path.quaternions) * turned.inv()).magnitude().max() < 1e-7


@pytest.mark.render
def test_more_cameras_are_spread_by_the_angle_and_their_clocks_by_the_offset(tmp_path):
    options = ["--cameras", 3, "--angle", 50, "--t-d", 0.05, "--frame-rate", 0, "--lamp", 4]
    simulate(tmp_path / "a", *FAST, *options)
    cameras = read_json(tmp_path / "a" / "truth.json")["cameras"]
    assert [one["time_offset_s"] for one in cameras.values()] == [0.0, 0.05, 0.1]
    views = [np.array(one["T_C_W"])[:3, :3] for one in cameras.values()]
    for k in (1, 2):
        turn = Rotation.from_matrix(views[k] @ views[0].T)
        assert np.degrees(turn.magnitude()) == pytest.approx(50.0 * k)
        rig = load_rig(tmp_path / "a" / "rig_extrinsics.yaml", (k, k + 1))
        np.testing.assert_allclose(rig.T_2_1[:3, :3], views[k] @ views[k - 1].T, atol=1e-12)
        starts_us = [load_events(tmp_path / "a" / f"cam{n}.h5").events["t"][0] for n in (k, k + 1)]
        # The lamp flickers from the start, at 100 Hz.
        assert np.diff(starts_us) == pytest.approx(50_000, abs=10_000)


@pytest.mark.render
def test_the_same_arguments_give_the_same_bytes_of_what_they_say(tmp_path):
    """The recordings are of a bird close to cameras that have a preset."""
    near = ["--drone", "bird", "--distance", 1.5, "--spread", 0.15, "--frame-rate", 25]
    preset = ["--preset", "davis346-dim", "--effect", "camera2_light=0.5", "--no-check"]
    for left in (tmp_path / "a" / "a", tmp_path / "b"):  # by runs that were killed
        made_by(left, ended_process()).mkdir(parents=True)
    for name in ("a", "b"):
        simulate(tmp_path / name, *FAST, "--seed", 2**32 - 1, *near, *preset)
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}
    a, b = ({p.name: p.read_bytes() for p in (tmp_path / name).iterdir()} for name in "ab")
    assert a == b
    truth = read_json(tmp_path / "a" / "truth.json")
    assert np.abs(truth["drone_position_W_m"]).max() < 0.2 * 3.6
    effects = replace(SENSOR_PRESETS["davis346-dim"].effects, camera2_light=0.5)
    assert truth["provenance"]["config"]["effects"] == provenance.plain(effects)
    assert min(camera["n_events"] for camera in truth["cameras"].values()) > 10_000


def test_the_folder_appears_with_all_that_it_holds(tmp_path, monkeypatch):
    full = Mock(side_effect=SsacError("no space left"))
    monkeypatch.setattr("experiments.scenes.simulate.write_path", full)
    with pytest.raises(SsacError, match="no space left"):
        simulate(tmp_path / "out", *FAST, "--duration", 1)
    assert [*tmp_path.iterdir()] == []


OTHERS = {"distortion_model": "radtan", "renderer": "pyrender", "gl": "egl",
          "trajectory": "flight.csv", "background": ("sky.png",), "distortion": (0.1, 0, 0, 0),
          "clock_jump": (1.0, 0.1), "drone_size": 0.5, "check": False, "resolution": (64, 48),
          "intrinsics_error": (1.0, 1.0)}  # fmt: skip
"""Values for options where half the default, or 1, is no valid value."""

DEFAULTS = {name: inspect.signature(simulate_command).parameters[name].default for name in OPTIONS}


def flat(sim, disturb):
    fields = asdict(sim) | {"disturb": asdict(disturb)}
    return pd.json_normalize(fields).astype(object).iloc[0].to_dict()


@pytest.mark.parametrize("name", [name for name, option in OPTIONS.items() if option.field])
def test_an_option_sets_its_field_and_no_other_and_else_that_has_its_default(name):
    default, defaults = DEFAULTS[name], DEFAULTS | {"distortion": (), "background": ()}
    assert chosen(defaults) == (SimConfig(), DisturbConfig())
    value = OTHERS.get(name, 0.5 * default if default and isinstance(default, float) else 1)
    before, after = (flat(*chosen(defaults | given)) for given in ({}, {name: value}))
    changed = {key: one for key, one in after.items() if one != before.get(key)}
    assert changed == {OPTIONS[name].field: value}


def test_an_option_keeps_what_else_is_said_of_its_part():
    config, _ = chosen({"gl": "egl"}, render=RenderConfig(lattice=Lattice(4, 1)))
    assert config.render == RenderConfig(lattice=Lattice(4, 1), backend="egl")
    # Both options together are valid: 250 frames a second have no room for the default of 5 ms.
    config, _ = chosen({"frame_rate": 250.0, "exposure": 1e-3})
    assert (config.frames.rate_hz, config.frames.exposure_s) == (250.0, 1e-3)


def test_options_take_the_place_of_the_presets_values():
    ideal, noisy = (chosen_sensor(DEFAULTS | {"noise": name}) for name in PRESETS)
    assert ideal.sensor == SensorConfig()
    assert ideal.effects.is_none
    assert noisy.sensor == PRESETS["davis346"]
    given = {"preset": "davis346-dim", "threshold_on": 0.1, "illuminance": 2.0,
             "effect": ["latency_s=2e-3", "hot_clusters = 7", "refractory_s=1e-3"]}  # fmt: skip
    made, preset = chosen_sensor(DEFAULTS | given), SENSOR_PRESETS["davis346-dim"]
    assert made.sensor == replace(preset.sensor, threshold_on=0.1, refractory_s=1e-3)
    changed = {"illuminance_lux": 2.0, "latency_s": 2e-3, "hot_clusters": 7}
    assert made.effects == replace(preset.effects, **changed)
