"""A contract over the whole registry, and the choice of a method."""

import numpy as np
import pytest

from experiments.load import load_pair
from experiments.methods import DEFAULT, METHODS, Input, choose_method
from ssac.camera import Rig
from ssac.errors import SsacError
from ssac.interface import Config, Observation
from tests.experiments.recorded import T_D_S


@pytest.fixture(scope="module")
def data(recorded):
    paths = (recorded / "cam1.h5", recorded / "cam2.h5", recorded / "rig_extrinsics.yaml")
    return load_pair(paths, METHODS["zncc_f"])


def test_the_names_of_the_design_are_there():
    assert {"ssac", "ssac-known", "joint", "zncc_e", "zncc_f", "event_rate", "albl"} <= set(METHODS)
    assert all(name == method.name for name, method in METHODS.items())


@pytest.mark.parametrize("name", METHODS)
def test_every_method_keeps_the_contract(name, data):
    cam1, cam2, rig = data
    method = METHODS[name]
    assert method.summary
    assert method.skip_reason(*data) == ""
    before = cam1.events.copy(), cam2.events.copy()
    config = Config(denoise=False)
    estimate = method.estimate(cam1, cam2, rig, config)
    assert np.array_equal(before[0], cam1.events)
    assert np.array_equal(before[1], cam2.events)
    assert estimate.status == "ok"
    assert config.interval_s[0] <= estimate.t_d_s <= config.interval_s[1]
    if method.input is Input.TRACKS:
        assert estimate.R is not None
        assert estimate.t is not None
        np.testing.assert_allclose(estimate.R @ estimate.R.T, np.eye(3), atol=1e-9)
        assert np.linalg.norm(estimate.t) == pytest.approx(1.0)
        assert estimate.n_samples > 0
        assert abs(estimate.t_d_s - T_D_S) < 3e-3  # 8 s of noisy pixels: about 1 ms


@pytest.mark.parametrize("name", [name for name, m in METHODS.items() if m.needs_extrinsics])
def test_without_extrinsics_a_method_that_needs_them_is_skipped(name, data):
    cam1, cam2, rig = data
    unknown = Rig(rig.cam1, rig.cam2)
    assert "extrinsics" in METHODS[name].skip_reason(cam1, cam2, unknown)
    with pytest.raises(SsacError):
        METHODS[name].estimate(cam1, cam2, unknown, Config(denoise=False))


def test_without_frames_a_method_that_needs_them_is_skipped(data):
    cam1, cam2, rig = data
    reason = METHODS["zncc_f"].skip_reason(cam1, Observation(cam2.events), rig)
    assert "camera 2 has none" in reason


def test_the_best_method_is_the_default():
    assert choose_method().name == DEFAULT
    assert choose_method(known_extrinsics=True).name == "joint-known"
    assert choose_method("ssac", known_extrinsics=True).name == "ssac-known"
    assert choose_method("ssac-known").name == "ssac-known"


def test_a_variant_for_known_extrinsics_needs_them():
    for method in METHODS.values():
        if method.known_variant:
            assert METHODS[method.known_variant].needs_extrinsics


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(SsacError, match=r"unknown method 'scac': use one of .*ssac-known"):
        choose_method("scac")


def test_extrinsics_are_not_dropped_in_silence():
    with pytest.raises(SsacError, match="zncc_e makes no use of known extrinsics"):
        choose_method("zncc_e", known_extrinsics=True)
