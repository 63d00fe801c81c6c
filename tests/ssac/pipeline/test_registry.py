"""A contract over our methods, and the choice of a method."""

from dataclasses import replace

import numpy as np
import pytest

import ssac.methods.algorithms
from ssac.camera import Rig
from ssac.config import Config
from ssac.errors import SsacError
from ssac.files.rigs import load_rig
from ssac.pipeline.chain import Chain
from ssac.pipeline.opened import Recording
from ssac.pipeline.registry import DEFAULT, METHODS, OURS, Input, choose_method
from ssac.track.observation import Observation
from tests.recorded import T_D_S

NAMES = [method.name for method in OURS]


@pytest.fixture(scope="module")
def data(recorded):
    rig = load_rig(recorded / "rig_extrinsics.yaml")
    cameras = (Recording(recorded / f"cam{k}.h5", rig.cam1, f"camera {k}") for k in (1, 2))
    return *(camera.read("images") for camera in cameras), rig


def chain_of(data, config=None) -> Chain:
    cam1, cam2, rig = data
    return Chain((cam1, cam2), rig, config)


def test_the_names_of_the_design_are_there():
    assert {"ssac", "ssac-known", "joint", "zncc_e", "zncc_f", "event_rate", "albl"} <= set(METHODS)
    assert all(METHODS[name].name == name for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_method_keeps_the_contract(name, data):
    cam1, cam2, _ = data
    method = METHODS[name]
    assert method.summary
    assert method.version == ""
    before = cam1.events.copy(), cam2.events.copy()
    config = Config(denoise=False)
    chain = chain_of(data, config)
    assert chain.lacks(method) == ""
    estimate = chain.estimate(name)
    assert np.array_equal(before[0], cam1.events)
    assert np.array_equal(before[1], cam2.events)
    assert estimate.status == "ok"
    assert config.offsets_s[0] <= estimate.t_d_s <= config.offsets_s[1]
    if method.input is Input.TRACKS:
        assert estimate.R is not None
        assert estimate.t is not None
        np.testing.assert_allclose(estimate.R @ estimate.R.T, np.eye(3), atol=1e-9)
        assert np.linalg.norm(estimate.t) == pytest.approx(1.0)
        assert estimate.n_samples > 0
        assert abs(estimate.t_d_s - T_D_S) < 3e-3  # 8 s of noisy pixels: about 1 ms


@pytest.mark.parametrize("name", [method.name for method in OURS if method.needs_extrinsics])
def test_without_extrinsics_a_method_that_needs_them_says_so(name, data):
    cam1, cam2, rig = data
    chain = chain_of((cam1, cam2, Rig(rig.cam1, rig.cam2)))
    assert f"the rig: {name} needs the extrinsics" in chain.lacks(METHODS[name])
    with pytest.raises(SsacError, match=f"the rig: {name} needs the extrinsics .*: add them"):
        chain.estimate(name)


def test_without_frames_a_method_that_needs_them_says_so(data):
    cam1, cam2, rig = data
    chain = chain_of((cam1, Observation(cam2.events), rig))
    said = "camera 2: zncc_f compares intensity frames, and there are none"
    assert said in chain.lacks(METHODS["zncc_f"])
    with pytest.raises(SsacError, match=said):
        chain.estimate("zncc_f")


def test_the_best_method_is_the_default():
    assert choose_method().name == DEFAULT
    assert choose_method(known_extrinsics=True).name == "tangency-known"
    assert choose_method("ssac", known_extrinsics=True).name == "ssac-known"
    assert choose_method("ssac-known").name == "ssac-known"


def test_a_variant_for_known_extrinsics_needs_them():
    for method in OURS:
        if method.known_variant:
            assert METHODS[method.known_variant].needs_extrinsics


@pytest.mark.parametrize("name", [name for name in NAMES if METHODS[name].starts_from])
def test_a_method_that_starts_from_another_gives_the_same_with_its_estimate(name, data):
    shared, method = chain_of(data), METHODS[name]
    started = shared.estimate(method.starts_from)
    refined, whole = shared.estimate(name), chain_of(data).estimate(name)
    assert refined.start is started
    assert (refined.method, refined.status, refined.t_d_s) == (name, "ok", whole.t_d_s)
    assert np.array_equal(refined.R, whole.R)
    assert np.array_equal(refined.covariance, whole.covariance)


@pytest.mark.parametrize("delay_s", [-0.3, 0.005, 0.5])
@pytest.mark.parametrize("name", [name for name in NAMES if METHODS[name].follows_clock])
def test_a_delay_of_camera_2_moves_the_offset_and_nothing_else(name, delay_s, data):
    cam1, cam2, rig = data
    config = Config(interval_s=(-0.4, 0.5))
    delayed = replace(config, interval_s=(-0.4 + delay_s, 0.5 + delay_s))
    expected = chain_of(data, config).estimate(name).delayed(delay_s)
    estimate = chain_of((cam1, cam2.delayed(delay_s), rig), delayed).estimate(name)
    assert (estimate.status, estimate.n_samples) == ("ok", expected.n_samples)
    for field in ("t_d_s", "t_d_std_s", "R", "t", "covariance", "candidates_s", "costs"):
        found, wanted = getattr(estimate, field), getattr(expected, field)
        assert (found is None) == (wanted is None)
        if wanted is not None:
            # Rounding of times in seconds; events may not enter or leave the windows by it.
            np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-10)


def test_a_chain_finds_each_estimate_once(data, monkeypatch):
    found = []
    for name in ("algorithm_1", "algorithm_2"):
        function = getattr(ssac.methods.algorithms, name)

        def counted(views, function=function):
            found.append(function.__name__)
            return function(views)

        monkeypatch.setattr(ssac.methods.algorithms, name, counted)
    chain = chain_of(data)
    for name in ("tangency", "joint", "ssac", "joint-known", "tangency"):
        assert chain.estimate(name).method == name
    assert found == ["algorithm_2", "algorithm_1"]


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(SsacError, match=r"unknown method 'scac': use one of .*ssac-known"):
        choose_method("scac")


def test_extrinsics_are_not_dropped_in_silence():
    with pytest.raises(SsacError, match="zncc_e makes no use of known extrinsics"):
        choose_method("zncc_e", known_extrinsics=True)
