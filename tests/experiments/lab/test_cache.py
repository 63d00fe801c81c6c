"""The cache: what an entry depends on, and that nothing is made twice or half."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import experiments.lab.cache as module
import experiments.lab.grid as grid
from experiments.lab.cache import (
    Brightness,
    Cache,
    Denoised,
    content,
    recording_key,
    run_key,
)
from experiments.lab.grid import Cell
from sim.errors import SimError
from sim.recording import SimConfig
from sim.render.config import RenderConfig
from ssac.config import Config
from ssac.errors import WriteError
from ssac.pipeline.registry import METHODS

pytestmark = pytest.mark.render  # a recording's key names the GL driver

DENOISED = Denoised(
    np.array([11, 12]),
    *(
        np.full((9, 6), 3, np.uint8),
        np.array([[0, 512]]),
        np.array([1.0, 9.0, 0.1, 5.0, 20.0, 20.0]),
    ),
    *(np.empty(0, np.bool_), np.full((2, 6), 7, np.uint8), np.empty((0, 2), np.int64)),
    *(np.array([0.0, 0.0, 0.2, 3.0, 5.0, 12.0]), np.array([True, False])),
)


def test_every_parameter_and_the_seed_make_another_recording_but_the_offset_does_not():
    base = recording_key(SimConfig(), 0)
    others = [
        recording_key(SimConfig(), 1),
        recording_key(replace(SimConfig(), angle_deg=91.0), 0),
        recording_key(replace(SimConfig(), sensor=replace(SimConfig().sensor, leak_hz=0.1)), 0),
    ]
    assert len({base, *others}) == 4
    assert recording_key(replace(SimConfig(), t_d_s=0.5), 0) == base
    assert recording_key(SimConfig(), 0) == base


def test_a_file_counts_by_what_is_in_it(tmp_path):
    one, two = tmp_path / "one.ply", tmp_path / "two.ply"
    one.write_text("a")
    two.write_text("a")
    assert content(SimConfig(drone_file=one)) == content(SimConfig(drone_file=two))
    two.write_text("b")
    assert content(SimConfig(drone_file=one)) != content(SimConfig(drone_file=two))


def test_every_part_makes_another_run():
    base = (("recording",), (0.05, Config(), "ssac", ""), ("experiments.lab.scored",))
    others = [
        (("other",), *base[1:]),
        (("recording", "other"), *base[1:]),
        (*base[:2], ("experiments.studies.refusal",)),
    ]
    inputs = (0.06, Config(n_min=100), "joint", "1.0")
    for at, value in enumerate(inputs):
        changed = (*base[1][:at], value, *base[1][at + 1 :])
        others.append((base[0], changed, base[2]))
    assert len({run_key(*parts) for parts in (base, *others)}) == 1 + len(others)


@pytest.mark.parametrize("packages", ["SIM_PACKAGES", "SSAC_PACKAGES"])
def test_another_version_of_a_package_is_another_key(monkeypatch, packages):
    def keys():
        return {
            "SIM_PACKAGES": recording_key(SimConfig(), 0),
            "SSAC_PACKAGES": run_key((), 1, ("experiments.lab.scored",)),
        }

    before, real = keys(), module.package_versions
    listed = getattr(module, packages)
    monkeypatch.setattr(
        module, "package_versions",
        lambda names: real(names) | ({"numpy": "0.1"} if names == listed else {}),
    )  # fmt: skip
    assert {name for name, key in keys().items() if key != before[name]} == {packages}


def test_a_recording_is_simulated_once_and_kept_as_a_whole(tmp_path, monkeypatch):
    calls = []

    def counted(config, seed, *rest):
        calls.append((config, seed))
        return record(config, seed, *rest)

    record = module.record
    monkeypatch.setattr(module, "record", counted)
    spline = replace(SimConfig().spline, duration_s=0.5)
    config = SimConfig(t_d_s=0.3, spline=spline)
    cache = Cache(tmp_path / "cache")
    folder = cache.recording_folder(config, 3)
    names = {"cam1.h5", "cam2.h5", "rig.yaml", "rig_extrinsics.yaml", "truth.json"}
    assert {path.name for path in folder.iterdir()} == names
    assert cache.recording_folder(replace(config, t_d_s=0.0), 3) == folder
    assert calls == [(replace(config, t_d_s=0.0), 3)]
    assert cache.size_bytes() == sum(
        path.stat().st_size for path in (tmp_path / "cache").rglob("*") if path.is_file()
    )


def test_a_simulation_that_fails_leaves_nothing(tmp_path):
    config = SimConfig(angle_deg=200.0)
    with pytest.raises(SimError):
        Cache(tmp_path).recording_folder(config, 0)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_backend_that_is_not_there_is_the_simulators_error(tmp_path):
    config = SimConfig(render=RenderConfig(backend="vulkan"))
    with pytest.raises(SimError, match="vulkan"):
        Cache(tmp_path).recording_folder(config, 0)


def test_brightness_is_measured_once(tmp_path):
    cache, recording = Cache(tmp_path), tmp_path / "recordings" / "abc"
    times_us = np.array([2_500, 22_500])
    made = Brightness(np.array([0.1, 0.2]), times_us, np.empty(0), np.empty(0, np.int64))
    cache.brightness(recording, lambda: made)

    def never():
        raise AssertionError("done before")

    for one, other in zip(made, cache.brightness(recording, never), strict=True):
        assert np.array_equal(one, other)
        assert one.dtype == other.dtype


def test_what_denoising_did_is_found_once_for_each_number_of_neighbours(tmp_path):
    cache, recording = Cache(tmp_path), tmp_path / "recordings" / "abc"
    found = []
    for n_neighbours in (None, 5, None, 5):
        made = cache.denoised(
            recording, n_neighbours, lambda n=n_neighbours: found.append(n) or DENOISED
        )
        for one, other in zip(made, DENOISED, strict=True):
            np.testing.assert_array_equal(one, other, strict=True)
    assert found == [None, 5]


def test_a_run_comes_back_as_it_went_in(tmp_path):
    cache = Cache(tmp_path)
    row = {"status": "ok", "reason": "", "t_d_error_ms": 0.1 + 0.2, "r_error_deg": None}
    assert cache.load_run("abcd") is None
    cache.save_run("abcd", row)
    assert cache.load_run("abcd") == row
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["abcd.json"]


def test_a_run_that_could_not_be_written_whole_is_not_there(tmp_path, monkeypatch):
    cache, row = Cache(tmp_path), {"status": "ok", "reason": ""}
    write = Path.write_text

    def half(path, text, **options):
        write(path, text[: len(text) // 2], **options)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", half)
    with pytest.raises(WriteError, match="No space left on device"):
        cache.save_run("abcd", row)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    monkeypatch.undo()
    cache.save_run("abcd", row)
    assert cache.load_run("abcd") == row


def test_another_version_of_a_method_is_another_run(monkeypatch):
    cell = Cell(SimConfig(), 0, 0, 0.05, Config(), "ssac", {})
    before = cell.inputs
    method = replace(METHODS["ssac"], version="of yesterday")
    monkeypatch.setattr(grid, "METHODS", {"ssac": method})
    assert cell.inputs != before
    assert run_key(("recording",), cell.inputs, ()) != run_key(("recording",), before, ())
