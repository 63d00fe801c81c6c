"""What methods, offsets and parameters have in common is found once, and answers stay the same."""

from collections import Counter
from dataclasses import fields, replace
from importlib import import_module

import numpy as np
import pytest

import ssac
from ssac import Chain, Config, Observation, SsacError
from ssac.camera import Camera, Rig
from ssac.pipeline.registry import METHODS, OURS
from ssac.track.clean import clean
from tests.ssac.cluttered import noisy_flight
from tests.ssac.synthetic import CAMERA, HEIGHT, K, make_scene

T_D_S = 0.05
NAMES = [method.name for method in OURS]
STAGES = (
    "ssac.pipeline.chain.clean",
    "ssac.pipeline.chain.one_object",
    "ssac.track.motion._summed_up",
    "ssac.search.view.view_of",
    "ssac.methods.algorithms.algorithm_1",
    "ssac.methods.algorithms.algorithm_2",
    "ssac.methods.joint.joint_from",
    "ssac.methods.tangency.tangency_from",
)
SCENE = make_scene(seed=1, duration_s=6.0)
RIG = SCENE.rig


@pytest.fixture(scope="module")
def raw():
    """Two cameras with noise events, and with frames that flicker alike."""
    return noisy_flight(SCENE, T_D_S)


@pytest.fixture(scope="module")
def chain(raw):
    return Chain(raw, RIG)


@pytest.fixture
def calls(monkeypatch):
    """How often each stage is called from now on, by its name."""
    counts = Counter()

    def counted(name, work):
        def called(*args, **options):
            counts[name] += 1
            return work(*args, **options)

        return called

    for place in STAGES:
        module, _, name = place.rpartition(".")
        monkeypatch.setattr(place, counted(name, getattr(import_module(module), name)))
    return counts


def assert_equal(estimate, expected):
    for field in fields(expected):
        if field.compare:  # the start is compared as the method that it is of
            ours, theirs = getattr(estimate, field.name), getattr(expected, field.name)
            np.testing.assert_array_equal(ours, theirs, err_msg=field.name)  # the same arithmetic


class File:
    """What one camera recorded, and how often that was read."""

    name, has_track = "", False

    def __init__(self, seen: Observation) -> None:
        self.seen, self.asked = seen, []

    def read(self, frames=""):
        self.asked.append(frames)
        return self.seen


def test_each_stage_runs_once_for_all_ten_methods(raw, calls):
    files = [File(seen) for seen in raw]
    chain = Chain(files, RIG)
    for name in NAMES * 2:
        assert chain.estimate(name).method == name
    assert calls == {
        "clean": 2,  # cameras
        "one_object": 1,
        "_summed_up": 2,
        "view_of": 2,
        "algorithm_1": 1,
        "algorithm_2": 1,
        "joint_from": 2,  # of a free pose, and of a known one
        "tangency_from": 2,
    }
    # Once more for silhouettes: camera 1's do not close, so that nobody looks at camera 2's.
    assert [sorted(file.asked) for file in files] == [["", "", "means"], ["", "means"]]


@pytest.mark.parametrize("name", NAMES)
def test_a_method_changes_no_input_and_gives_the_same_for_what_is_clean_or_delayed(
    name, raw, chain
):
    before = [seen.events.copy() for seen in raw]
    assert chain.lacks(METHODS[name]) == ""
    expected = chain.estimate(name)
    assert (expected.status, expected.method) == ("ok", name)
    cleaned = [clean(seen, CAMERA, Config().cleaning) for seen in raw]
    assert_equal(getattr(ssac, name.replace("-", "_"))(*cleaned, RIG), expected)
    late = Chain([raw[0], raw[1].delayed(0.3)], RIG)  # of which nothing is there to be misused
    assert_equal(chain.delayed(0.3).estimate(name), late.estimate(name))
    for seen, kept in zip(raw, before, strict=True):
        np.testing.assert_array_equal(seen.events, kept)


def test_a_delay_takes_what_is_clean_and_summed_up_along(raw, calls):
    chain = Chain(raw, RIG)
    chain.estimate("joint")
    calls.clear()
    late = chain.delayed(0.1)
    assert late.clean(0) is chain.clean(0)
    assert np.array_equal(late.clean(1).events["t"], chain.clean(1).events["t"] + 100_000)
    found = late.estimate("joint")
    assert calls["clean"] == calls["_summed_up"] == 0
    assert calls["algorithm_2"] == calls["joint_from"] == 1
    again = chain.delayed(0.1).under(Config(n_samples=300)).under(Config())
    assert again.estimate("joint") is found  # the last delay is kept
    chain.delayed(0.2).clean(1)
    assert chain.delayed(0.1).estimate("joint") is not found
    assert chain.delayed(0.0) is chain
    with pytest.raises(SsacError, match="n_min must be a whole number of 1 "):
        late.under(Config(n_min=0))


FROM_VIEWS = {"view_of": 2, "algorithm_2": 1, "joint_from": 1}
SHARED = (
    (Config(), {}),
    (Config(skew_prior_ppm=20.0), {"joint_from": 1}),
    (Config(seed=5), {"algorithm_2": 1, "joint_from": 1}),
    (Config(half_window_s=0.015), FROM_VIEWS),
    (Config(border_px=9), {"_summed_up": 2, **FROM_VIEWS}),
    (Config(interval_s=(-0.5, 0.5)), {"one_object": 1, **FROM_VIEWS}),
    (Config(n_neighbours=2), {"clean": 2, "one_object": 1, "_summed_up": 2, **FROM_VIEWS}),
)


@pytest.mark.parametrize(("config", "expected"), SHARED, ids=range(len(SHARED)))
def test_other_parameters_share_all_that_they_leave_alone(config, expected, raw, chain, calls):
    chain.estimate("joint")
    calls.clear()
    found = chain.under(config).estimate("joint")
    assert +calls == Counter(expected)
    assert_equal(found, Chain(raw, RIG, config).estimate("joint"))


def test_other_cameras_than_those_of_what_is_clean_are_obeyed(raw):
    lens = Camera(K, CAMERA.width, CAMERA.height, "radtan", (-0.1, 0.02, 0.001, -0.001))
    rig = Rig(CAMERA, lens)
    cleaned = [clean(seen, CAMERA, Config().cleaning) for seen in raw]
    motions = [Chain(seen, rig).views().motion2 for seen in (cleaned, raw)]
    times_s = np.linspace(0.5, 5.5, 50)
    tracks = [motion.at(times_s).positions_px for motion in motions]
    np.testing.assert_array_equal(*tracks)
    plain = Chain(cleaned, RIG).views().motion2.at(times_s).positions_px
    assert np.nanmax(np.abs(tracks[0] - plain)) > 1.0
    smaller = replace(RIG, cam2=Camera(K, 100, HEIGHT))
    with pytest.raises(SsacError, match="camera 2: the sensor is 100 x 260 px"):
        Chain(cleaned, smaller).views()


def test_what_was_never_asked_for_need_not_be_usable(raw):
    backwards = replace(raw[1], events=raw[1].events[::-1])
    chain = Chain((raw[0], backwards), RIG)
    assert chain.estimate("zncc_f").status == "ok"  # which looks at frames alone
    with pytest.raises(SsacError, match="camera 2: events must be sorted"):
        chain.estimate("ssac")
    with pytest.raises(SsacError, match="3 recordings for the 2 cameras"):
        Chain((*raw, raw[0]), RIG)
