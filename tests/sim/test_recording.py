from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.interpolate import make_interp_spline

from sim.errors import SimError
from sim.recorded import Drift, drift_of
from sim.recording import simulate, stream
from sim.scene.flyers import DRONES, built_in_drone
from sim.scene.trajectory import random_spline, trajectory_from_csv, trajectory_to_csv
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.clock import Clock
from tests.sim.scenes import QUICK, counts, rng

pytestmark = pytest.mark.render

SKY = 128  # its code in a frame


def test_flights_differ_between_seeds_and_noise_also_between_cameras():
    config = replace(QUICK, sensor=replace(PRESETS["davis346"], background_hz=1.0))
    clean, noisy = ([simulate(one, seed) for seed in (3, 4)] for one in (QUICK, config))
    assert (clean[0].truth.T_W_B != clean[1].truth.T_W_B).any()
    of_cameras = [camera for recording in clean for camera in recording.cameras]
    still = sum(counts(camera.events, (260, 346)) for camera in of_cameras) == 0
    of_cameras = [camera for recording in noisy for camera in recording.cameras]
    noise = [counts(camera.events, (260, 346))[still] for camera in of_cameras]
    assert min(map(np.mean, noise)) > 0.5  # events a pixel in a second
    # Independent: no correlation beyond chance.
    assert np.abs(np.corrcoef(noise) - np.eye(4)).max() < 5 / still.sum() ** 0.5


def test_events_and_frames_show_the_drone_where_it_was():
    """The scene's time is camera 1's, and camera 2's minus the offset."""
    recording = simulate(replace(QUICK, t_d_s=0.25, frames=FrameConfig(20.0, 0.002)), 2)
    truth = recording.truth
    for camera, centres_px in zip(recording.cameras, truth.centres_px, strict=True):
        centre_px = make_interp_spline(truth.times_s, centres_px, k=1)
        scene_s = 1e-6 * camera.events["t"] - camera.camera.time_offset_s
        assert 0.0 <= scene_s.min() <= scene_s.max() <= 1.0 + 1e-6
        x, y = centre_px(scene_s).T
        distance_px = np.hypot(camera.events["x"] - x, camera.events["y"] - y)
        # The 0.7 m drone is at most 0.43 m from its centre: 43 px when 2 m away.
        depth_m = truth.T_W_B[:, :3, 3] @ camera.camera.T_C_W[2, :3] + camera.camera.T_C_W[2, 3]
        reach_px = 200.0 * 0.43 / (np.interp(scene_s, truth.times_s, depth_m) - 0.43) + 1.0
        assert (distance_px < reach_px).all()
        assert np.median(distance_px) < 0.5 * np.median(reach_px)
        assert camera.frames.images.shape == (20, 260, 346)
        frames_us = camera.frames.times_us - round(1e6 * camera.camera.time_offset_s)
        np.testing.assert_array_equal(frames_us, np.rint(1e6 * (np.arange(20) / 20 + 0.001)))
        for scene_us, image in zip(frames_us, camera.frames.images, strict=True):
            x, y = centre_px(1e-6 * scene_us)
            ys, xs = np.nonzero(image != SKY)
            if 40 < x < 306 and 40 < y < 220:
                # The middle of a 20 to 50 px silhouette is near the drone's centre.
                assert np.hypot(xs.mean() - x, ys.mean() - y) < 10.0


def test_a_scene_is_what_its_configuration_names(tmp_path):
    light = [replace(QUICK, drone=name).scene(1).drone.parts[0].albedo.sum() for name in DRONES]
    assert light == [built_in_drone(name).parts[0].albedo.sum() for name in DRONES]
    assert len(set(light)) == len(DRONES)
    assert len(replace(QUICK, drone="bird", flap_hz=0.0).scene(1).drone.parts) == 1
    trimesh.creation.box((2.0, 1.0, 0.5)).export(tmp_path / "brick.stl")
    trajectory_to_csv(random_spline(QUICK.spline, rng(8)), tmp_path / "path.csv", 500.0)
    walls, paths = rng().random((2, 260, 346), np.float32), (tmp_path / "1.npy", tmp_path / "2.npy")
    for path, wall in zip(paths, walls, strict=True):
        np.save(path, wall)
    recording = simulate(replace(QUICK, background_files=paths), 1)
    for camera, wall in zip(recording.cameras, walls, strict=True):
        assert (camera.frames.images == np.rint(wall * 255)).mean() > 0.9
    config = replace(
        QUICK,
        drone_file=tmp_path / "brick.stl",
        drone_size_m=0.6,
        trajectory_file=tmp_path / "path.csv",
        background_files=paths[:1],
    )
    scene, times_s = config.scene(1), np.linspace(0.0, 1.0, 99)
    assert (len(scene.drone.parts[0].faces), scene.drone.size_m) == (12, pytest.approx(0.6))
    expected = trajectory_from_csv(tmp_path / "path.csv").poses(times_s)
    np.testing.assert_array_equal(scene.trajectory.poses(times_s), expected)
    np.testing.assert_array_equal(scene.backgrounds, walls[[0, 0]])
    with pytest.raises(SimError, match="rotors spin on the built-in quadrotors only"):
        replace(config, rotor_hz=20.0).scene(1)


def test_a_drone_that_is_never_in_view():
    spline = replace(QUICK.spline, offset_xyz_m=(0.0, 0.0, 60.0))
    for camera in simulate(replace(QUICK, spline=spline), 1).cameras:
        assert len(camera.events) == 0
        assert (camera.frames.images == SKY).all()
        assert len(camera.frames.images) == 50
    noisy = simulate(replace(QUICK, spline=spline, sensor=PRESETS["davis346"]), 1)
    # 90,000 pixels for a second, each with a leak of 0.1 Hz and shot noise of 0.25 Hz in the dark.
    assert 10_000 < len(noisy.cameras[0].events) < 30_000


def test_what_is_recorded_is_handed_on_meanwhile(monkeypatch):
    """Frames come one by one and events in order; few of either are left for a camera's end."""
    monkeypatch.setattr("sim.render.native.BATCH", 32)  # as there are few instants
    cameras = {}

    def open_sink(camera, times_us, _):
        assert all(calls[-1][0] == "close" for calls in cameras.values())
        calls = cameras[camera.name] = [("open", len(times_us))]
        return SimpleNamespace(
            take_frame=lambda k, _: calls.append(("frame", k)),
            add=lambda events: calls.append(("events", events["t"].copy())),
            close=lambda: calls.append(("close", None)),
        )

    config = replace(QUICK, frames=FrameConfig(50.0))
    flight, progress = stream(config, 1, open_sink), []
    whole = simulate(config, 1, progress.append)
    assert flight.n_instants == whole.n_instants > 100
    assert 0.0 <= progress[0] <= progress[-1] == 1.0
    assert progress == sorted(progress)
    for camera, calls in zip(whole.cameras, cameras.values(), strict=True):
        assert (calls[0], calls[-1]) == (("open", 50), ("close", None))
        assert [k for what, k in calls if what == "frame"] == list(range(50))
        batches = [times_us for what, times_us in calls if what == "events"]
        np.testing.assert_array_equal(np.concatenate(batches), camera.events["t"])
        assert max(map(len, batches)) < 0.5 * len(camera.events)
        first, *_, last = (k for k, (what, _) in enumerate(calls) if what == "events")
        assert {10, 40} <= {k for what, k in calls[first:last] if what == "frame"}


@pytest.mark.parametrize("skew_ppm", [0.0, 50.0, -50.0, 100_000.0, -100_000.0])
def test_the_skew_adds_its_share_since_the_middle_and_keeps_the_order(skew_ppm):
    times_us = np.arange(0, 2_000_000, 7)
    drift = drift_of(skew_ppm, None, 2.0)
    expected_us = skew_ppm * 1e-6 * (times_us - 1e6)
    # Half a microsecond by rounding, and the last digits of a float.
    np.testing.assert_allclose(drift.added_us(times_us), expected_us, rtol=0, atol=0.5 + 1e-6)
    added_s = Clock(skew_ppm=skew_ppm, t_ref_s=1.0).added_s(1e-6 * times_us)  # by the estimator's
    np.testing.assert_allclose(1e6 * added_s, expected_us, rtol=0, atol=1e-6)
    dense_us = np.arange(0, 50_000)
    assert np.diff(dense_us + drift.added_us(dense_us)).min() >= 0


DRIFTING = {"skew_ppm": -20_000.0, "clock_jump": (0.7, 0.005)}


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(
    "clock",
    [*({"t_d_s": t_d_s} for t_d_s in (-0.7, 1e-6)), DRIFTING, DRIFTING | {"t_d_s": 0.0123456}],
)
def test_a_clock_changes_the_stamps_of_camera_2_and_nothing_else(clock, preset):
    """So one recording serves all offsets, to the last bit."""
    config = replace(QUICK, sensor=PRESETS[preset])
    plain, clocked = simulate(config, 5), simulate(replace(config, **clock), 5)
    np.testing.assert_array_equal(clocked.cameras[0].events, plain.cameras[0].events)
    drift, t_d_s = clocked.truth.drift, clock.get("t_d_s", 0.0)
    assert drift == Drift(clock.get("skew_ppm", 0.0), 0.5, clock.get("clock_jump"))
    assert clocked.truth.t_d_s == clocked.rig.cameras[1].time_offset_s == t_d_s
    before, after = plain.cameras[1], clocked.cameras[1]
    assert before.events["t"].max() <= 1_000_000  # arguments stay as they are
    events, stamps_us = before.events.copy(), before.frames.times_us
    events["t"] += drift.added_us(events["t"]) + round(1e6 * t_d_s)
    assert np.diff(events["t"]).min() >= 0
    np.testing.assert_array_equal(after.events, events)
    shown_us = stamps_us + drift.added_us(stamps_us) + round(1e6 * t_d_s)
    np.testing.assert_array_equal(after.frames.times_us, shown_us)
