"""Every method takes prepared observations for raw ones, and a delay for a delayed recording."""

import pickle
from dataclasses import fields, replace

import numpy as np
import pytest

import ssac.track.observation
from ssac.camera import Camera, Rig, same_camera
from ssac.config import Config
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE
from ssac.tool.registry import METHODS
from ssac.track.observation import Observation, object_motions, prepare, usable_events
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_events, make_scene

T_D_S = 0.05
RADTAN = Camera(K, WIDTH, HEIGHT, "radtan", (-0.3, 0.1, 0.001, -0.001))


@pytest.fixture(scope="module")
def scene():
    return make_scene(seed=1, duration_s=6.0)


@pytest.fixture(scope="module")
def raw(scene):
    """Two cameras with noise events, and with frames that flicker alike."""
    rng = np.random.default_rng(0)
    frames = np.cumsum(rng.integers(0, 40, (300, 4, 5)), axis=0).astype(np.uint8)
    times_s = 0.02 * np.arange(300)
    cameras = []
    for events in make_events(scene, 1, T_D_S, size_m=0.4):
        noise = np.zeros(5_000, EVENT_DTYPE)
        noise["t"] = rng.integers(events["t"][0], events["t"][-1], size=len(noise))
        noise["x"], noise["y"] = rng.integers(WIDTH, size=5_000), rng.integers(HEIGHT, size=5_000)
        both = np.concatenate([events, noise])
        both = both[np.argsort(both["t"], kind="stable")]
        cameras.append(Observation(both, frames, times_s + T_D_S * len(cameras)))
    return cameras


@pytest.fixture(scope="module")
def prepared(raw, scene):
    return prepare(*raw, scene.rig, Config())


def assert_equal(estimate, expected):
    for field in fields(expected):
        if field.compare:  # the start is compared as the method that it is of
            ours, theirs = getattr(estimate, field.name), getattr(expected, field.name)
            np.testing.assert_array_equal(ours, theirs, err_msg=field.name)  # the same arithmetic


def assert_same_motion(motions, expected):
    for motion, other in zip(motions, expected, strict=True):
        for field in fields(other):
            ours, theirs = getattr(motion, field.name), getattr(other, field.name)
            np.testing.assert_array_equal(ours, theirs, err_msg=field.name)


@pytest.mark.parametrize("name", METHODS)
def test_a_method_gives_the_same_for_prepared_observations(name, raw, prepared, scene):
    method = METHODS[name]
    expected = method.estimate(*raw, scene.rig, Config())
    assert expected.status == "ok"
    assert expected.method == name
    assert_equal(method.estimate(*prepared, scene.rig, Config()), expected)


@pytest.mark.parametrize("name", METHODS)
def test_a_method_gives_the_same_for_a_delayed_observation(name, raw, prepared, scene):
    method = METHODS[name]
    late = raw[1].events.copy()
    late["t"] += 300_000
    cam2 = Observation(late, raw[1].frames, raw[1].frame_times_s + 0.3)
    expected = method.estimate(raw[0], cam2, scene.rig, Config())
    estimate = method.estimate(prepared[0], prepared[1].delayed(0.3), scene.rig, Config())
    assert_equal(estimate, expected)


def test_nothing_is_done_twice(prepared, scene, monkeypatch):
    def again(*_, **__):
        raise AssertionError("this was prepared")

    for work in ("check_events", "without_noise", "object_motion"):
        monkeypatch.setattr(ssac.track.observation, work, again)
    later = [camera.delayed(0.1) for camera in prepared]
    other_windows = Config(half_window_s=0.01, n_min=50, max_border_fraction=0.2, n_samples=100)
    for method in METHODS.values():
        method.estimate(*prepared, scene.rig, Config())
        method.estimate(*later, scene.rig, other_windows)
    # Equal cameras need not be one object, and preparing what is prepared does nothing.
    copy = Rig(Camera(K.copy(), WIDTH, HEIGHT), Camera(K.copy(), WIDTH, HEIGHT))
    prepare(*prepare(*prepared, copy, Config()), copy, other_windows)


@pytest.mark.parametrize(
    "config",
    [
        Config(half_window_s=0.010),
        Config(n_min=20),
        Config(max_border_fraction=0.5),
        Config(border_px=100),
        Config(denoise=False),
    ],
)
def test_other_parameters_than_prepared_are_obeyed(config, raw, prepared, scene):
    if not config.denoise:  # noise that has been removed does not come back
        raw = [Observation(camera.events) for camera in prepared]
    expected = object_motions(*raw, scene.rig, config)
    assert_same_motion(object_motions(*prepared, scene.rig, config), expected)


@pytest.mark.parametrize("camera", [RADTAN, Camera(K * [[2.0], [2.0], [1.0]], WIDTH, HEIGHT)])
def test_another_camera_than_prepared_is_obeyed(camera, raw, prepared, scene):
    rig = Rig(scene.rig.cam1, camera)
    expected = object_motions(*raw, rig, Config())
    assert_same_motion(object_motions(*prepared, rig, Config()), expected)
    smaller = replace(scene.rig, cam2=Camera(K, 100, HEIGHT))
    with pytest.raises(SsacError, match="camera 2: the sensor is 100 x 260 px"):
        usable_events(*prepared, smaller, Config())


def test_denoising_that_was_skipped_is_made_up_for(raw, prepared, scene):
    noisy = prepare(*raw, scene.rig, Config(denoise=False))
    assert [len(camera.events) for camera in noisy] == [len(camera.events) for camera in raw]
    again = prepare(*noisy, scene.rig, Config())
    for camera, expected in zip(again, prepared, strict=True):
        assert camera.denoised
        assert np.array_equal(camera.events, expected.events)
    assert_same_motion(
        object_motions(*noisy, scene.rig, Config()), object_motions(*raw, scene.rig, Config())
    )


@pytest.mark.parametrize("t_d_s", [0.005, 0.5, -1.234567, 3600.0])
@pytest.mark.parametrize("camera", [Camera(K, WIDTH, HEIGHT), RADTAN], ids=["none", "radtan"])
def test_delaying_what_is_prepared_equals_preparing_what_is_delayed(camera, t_d_s, raw):
    rig = Rig(camera, camera)
    later = [observation.delayed(t_d_s) for observation in raw]
    expected = prepare(*later, rig, Config())
    delayed = [observation.delayed(t_d_s) for observation in prepare(*raw, rig, Config())]
    for first, second, observation in zip(delayed, expected, raw, strict=True):
        # Whole microseconds: exact.
        assert np.array_equal(first.events, second.events)
        assert_same_motion([first.prepared.motion], [second.prepared.motion])
        assert np.array_equal(first.frame_times_s, second.frame_times_s)
        # Seconds as float64 up to an hour: one unit in the last place is 5e-13 s.
        assert first.frame_times_s == pytest.approx(observation.frame_times_s + t_d_s, abs=1e-12)
    assert np.array_equal(later[0].events["t"], raw[0].events["t"] + round(t_d_s * 1e6))
    assert np.array_equal(later[0].events[["x", "y", "p"]], raw[0].events[["x", "y", "p"]])


def test_a_delay_is_rounded_to_whole_microseconds_for_events_and_frames(raw):
    late = raw[0].delayed(1.6e-6)
    assert np.array_equal(late.events["t"], raw[0].events["t"] + 2)
    assert late.frame_times_s == pytest.approx(raw[0].frame_times_s + 2e-6, abs=1e-12)


def test_preparing_and_delaying_change_nothing_that_was_given(raw, scene):
    before = [camera.events.copy() for camera in raw]
    prepared = prepare(*raw, scene.rig, Config())
    times_us = prepared[0].prepared.motion.times_us.copy()
    prepared[0].delayed(1.0)
    assert all(np.array_equal(a, b.events) for a, b in zip(before, raw, strict=True))
    assert np.array_equal(prepared[0].prepared.motion.times_us, times_us)
    assert not raw[0].denoised


def test_other_events_in_a_prepared_observation_are_refused(prepared):
    with pytest.raises(SsacError, match="make a new Observation"):
        replace(prepared[0], events=prepared[0].events[:100])


def test_a_prepared_observation_survives_the_way_to_another_process(prepared, scene):
    there = [pickle.loads(pickle.dumps(camera)) for camera in prepared]
    assert_same_motion(
        object_motions(*there, scene.rig, Config()), object_motions(*prepared, scene.rig, Config())
    )
    assert there[0].delayed(0.1).denoised


def test_preparing_refuses_what_methods_refuse(raw, scene):
    backwards = Observation(raw[1].events[::-1])
    with pytest.raises(SsacError, match="camera 2: events must be sorted"):
        prepare(raw[0], backwards, scene.rig, Config())
    with pytest.raises(SsacError, match="n_min must be positive"):
        prepare(*raw, scene.rig, Config(n_min=0))


def test_cameras_are_the_same_by_their_values():
    camera = Camera(K, WIDTH, HEIGHT)
    assert same_camera(camera, Camera(K.copy(), WIDTH, HEIGHT))
    assert same_camera(RADTAN, replace(RADTAN))
    for other in (
        Camera(K + np.eye(3), WIDTH, HEIGHT),
        Camera(K, WIDTH + 1, HEIGHT),
        Camera(K, WIDTH, HEIGHT + 1),
        replace(RADTAN, distortion_coeffs=(-0.3, 0.1, 0.001, 0.0)),
        replace(RADTAN, distortion_model="equidistant"),
    ):
        assert not same_camera(camera, other)
        assert not same_camera(RADTAN, other)
