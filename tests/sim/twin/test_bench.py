"""The bench: model, walls, cameras and room."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import sim.twin.bench
from sim.recording import simulate
from sim.render.config import RenderConfig
from sim.scene.trajectory import SplineConfig
from sim.sensor.events import SensorConfig
from sim.twin.bench import TwinConfig, bench_rig, hanging_of, printed, wall
from sim.twin.room import RoomConfig, room_events, wire_columns, wire_contrast

SHORT = TwinConfig(
    angle_deg=65.06, spline=SplineConfig(1.0), render=RenderConfig(check=False), textured=False
)


@pytest.mark.parametrize("angle_deg", [43.14, 131.77])
def test_the_lines_of_sight_are_the_angle_apart(angle_deg: float) -> None:
    rig = bench_rig(replace(SHORT, angle_deg=angle_deg, setup_seed=3))
    one, two = (-c.T_C_W[:3, :3].T @ c.T_C_W[:3, 3] for c in rig.cameras)
    cosine = one @ two / np.linalg.norm(one) / np.linalg.norm(two)
    assert np.rad2deg(np.arccos(cosine)) == pytest.approx(angle_deg, abs=1e-9)
    assert (np.linalg.norm(one), np.linalg.norm(two)) == pytest.approx(SHORT.distances_m)
    for camera in rig.cameras:  # which look at the origin
        np.testing.assert_allclose(camera.project(np.zeros(3)), camera.K[:2, 2], atol=1e-9)


def test_recordings_of_a_set_up_share_all_but_the_motion() -> None:
    config = replace(SHORT, textured=True)
    one, other = config.scene(1), config.scene(2)
    elsewhere = replace(config, setup_seed=1).scene(1)
    np.testing.assert_array_equal(one.backgrounds, other.backgrounds)
    np.testing.assert_array_equal(one.rig.cameras[0].K, other.rig.cameras[0].K)
    assert not np.array_equal(one.rig.cameras[0].K, elsewhere.rig.cameras[0].K)
    assert not np.array_equal(one.backgrounds[0], elsewhere.backgrounds[0])
    times_s = np.array([0.5])
    assert np.abs(one.trajectory.position(times_s) - other.trajectory.position(times_s)).max() > 0
    np.testing.assert_array_equal(
        one.trajectory.position(times_s), elsewhere.trajectory.position(times_s)
    )


def test_a_level_drone_moves_but_does_not_turn() -> None:
    level = replace(SHORT, turning=False).scene(4).trajectory.poses(np.linspace(0.0, 1.0, 5))
    turning = SHORT.scene(4).trajectory.poses(np.linspace(0.0, 1.0, 5))
    np.testing.assert_array_equal(level[:, :3, :3], np.broadcast_to(np.eye(3), (5, 3, 3)))
    np.testing.assert_array_equal(level[:, :3, 3], turning[:, :3, 3])


@pytest.mark.render
def test_both_cameras_see_the_drone_where_the_truth_says() -> None:
    recording = simulate(SHORT, 0)
    for index, camera in enumerate(recording.cameras):
        events = camera.events
        assert len(events) > 1000
        times_s = 1e-6 * events["t"]
        centres = [
            np.interp(times_s, recording.truth.times_s, recording.truth.centres_px[index, :, k])
            for k in (0, 1)
        ]
        far_px = np.hypot(events["x"] - centres[0], events["y"] - centres[1])
        # A corner is 2.1 cm from the middle; a lens of this series may have 1 % more than 300 px.
        times_s = np.linspace(0.0, 1.0, 50)
        T_C_W = bench_rig(SHORT).cameras[index].T_C_W
        depths_m = SHORT.scene(0).trajectory.position(times_s) @ T_C_W[2, :3] + T_C_W[2, 3]
        assert np.quantile(far_px, 0.999) < 1.0 + 1.03 * 300.0 * 0.0212 / depths_m.min()


def events_of(room: RoomConfig, index: int = 0, **sensor: float) -> np.ndarray:
    config = replace(SHORT, textured=True)
    return room_events(
        room, config.scene(0), hanging_of(config, 0), SensorConfig(**sensor), 0, index
    )


def test_a_still_room_makes_no_events() -> None:
    assert len(events_of(RoomConfig())) == 0


def test_the_events_of_all_pixels_rebuild_one_course_of_the_light() -> None:
    threshold = 0.05
    events = events_of(RoomConfig(light_std=0.3), threshold_on=threshold, threshold_off=threshold)
    net = np.zeros((260, 346), np.int64)
    np.add.at(net, (events["y"], events["x"]), 2 * events["p"].astype(np.int64) - 1)
    assert np.abs(np.median(net)) >= 2  # the light did change
    # Each remembers a level less than a threshold from the light, at first and at last.
    assert np.ptp(net) <= 4
    other = events_of(RoomConfig(light_std=0.3), 1, threshold_on=threshold, threshold_off=threshold)
    assert np.sum(2.0 * other["p"] - 1.0) == pytest.approx(net.sum(), rel=0.05)  # one lamp


def test_a_shadow_is_where_the_hand_is_and_no_deeper_than_it_says() -> None:
    events = events_of(RoomConfig(shadow=0.3))
    assert len(events) > 1000
    # log(1 / 0.7) = 0.36: wherever a pixel starts, two thresholds of 0.25 at most below or one
    # above, however often the edge of the shadow comes and goes.
    net = np.zeros((260, 346), np.int64)
    for row, column, p in zip(events["y"], events["x"], events["p"], strict=True):
        net[row, column] += 2 * int(p) - 1
        assert -2 <= net[row, column] <= 1
    # It goes with the hand, which is out of view, as far below it as the wire is long.
    config = replace(SHORT, textured=True)
    lowered = hanging_of(config, 0).hand(1e-6 * events["t"].astype(float))
    assert config.scene(0).rig.cameras[0].project(lowered)[:, 1].max() < 0.0
    lowered -= [0.0, 0.0, config.pendulum.length_m]
    u, v = config.scene(0).rig.cameras[0].project(lowered).T
    far_px = np.hypot(np.abs(events["x"] - u) - 60.0, events["y"] - v + 100.0)
    # A radius of 45 px, and a penumbra whose last hundredth is 4.6 / 4 of its 18 px further out;
    # pixels that are nearly due fire at less: 1 % of the light is 4 % of a threshold.
    assert np.quantile(far_px, 0.97) < 45.0 + 1.15 * 18.0


def test_each_pixel_that_the_wire_passes_may_fire_off_then_on() -> None:
    config = replace(SHORT, textured=True)
    rig, hanging = config.scene(0).rig, hanging_of(config, 0)
    room = RoomConfig(wire_m=2e-4)
    events = events_of(room)
    columns = wire_columns(rig.cameras[0], hanging, 1e-6 * events["t"].astype(float), 260)
    at = columns[np.arange(len(events)), events["y"]]
    # An event is stamped when the wire is on a pixel's border.
    assert np.quantile(np.abs(at - events["x"]), 0.99) < 0.6
    assert 0.3 < events["p"].mean() < 0.7
    thick = wire_contrast(RoomConfig(wire_m=4e-4), rig.cameras[0], 0.5)
    # log(1 - x): twice the thread keeps back a little more than twice the light.
    assert thick / wire_contrast(room, rig.cameras[0], 0.5) == pytest.approx(2.0, rel=0.1)


def test_the_model_is_three_by_three_by_one_centimetres() -> None:
    (part,) = printed().parts
    extent_m = np.ptp(part.vertices_B_m, axis=0)
    np.testing.assert_allclose(extent_m, (0.03, 0.03, 0.01), rtol=1e-9)
    np.testing.assert_allclose(part.vertices_B_m.min(0) + part.vertices_B_m.max(0), 0.0, atol=1e-12)


def test_all_its_pieces_are_closed_and_face_outward() -> None:
    (part,) = printed().parts
    mesh = trimesh.Trimesh(part.vertices_B_m, part.faces, process=False)
    for piece in mesh.split(only_watertight=False):
        assert piece.is_watertight
        assert piece.volume > 0.0


def test_a_wall_is_its_seeds_and_smoother_the_further_it_is_out_of_focus(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    soft, again, other = (wall(346, 260, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(soft, again)
    assert not np.array_equal(soft, other)
    monkeypatch.setattr(sim.twin.bench, "DEFOCUS_PX", 0.3)  # next to no neighbour has a share
    sharp = wall(346, 260, np.random.default_rng(1))
    assert sharp.shape == (260, 346)
    assert 0.0 < sharp.min() <= sharp.max() < 1.0
    assert np.abs(np.diff(soft, axis=1)).max() < np.abs(np.diff(sharp, axis=1)).max() / 3.0
