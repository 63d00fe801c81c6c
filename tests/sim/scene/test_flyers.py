"""The drones that are built in code, by name: closed, sized, lopsided, and flapping."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from sim.recording import SimConfig, simulate
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.footprint import choose_instants, footprint
from sim.render.lattice import Lattice
from sim.scene.drone import Drone, Part
from sim.scene.flyers import DRONES, FLAP_RAD, QUADROTORS, bird, built_in_drone, plane
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import SplineConfig, random_spline

# 0.3 s of a coarse recording.
QUICK = SimConfig(
    spline=SplineConfig(duration_s=1.0),
    sampling=SamplingConfig(max_step_px=1.0),
    render=RenderConfig(Lattice(3, 1)),
)


def vertices_m(drone: Drone, time_s: float = 0.0) -> np.ndarray:
    """All corners (n, 3) [m] at this time, frame B."""
    return np.concatenate([at(part, time_s) for part in drone.parts])


def at(part: Part, time_s: float) -> np.ndarray:
    if part.joint is None:
        return part.vertices_B_m
    T_B_P = part.joint.transforms(np.array([time_s]))[0]
    return part.vertices_B_m @ T_B_P[:3, :3].T + T_B_P[:3, 3]


@pytest.mark.parametrize(
    "drone",
    [*(build(rotor_hz=hz) for build in QUADROTORS.values() for hz in (0.0, 40.0)),
     bird(), bird(flap_hz=0.0), plane()],
)  # fmt: skip
def test_every_piece_is_closed_and_faces_outward(drone: Drone) -> None:
    for part in drone.parts:
        pieces = trimesh.Trimesh(part.vertices_B_m, part.faces, process=True).split()
        assert sum(len(piece.faces) for piece in pieces) == len(part.faces)
        for piece in pieces:
            assert piece.is_volume
            assert piece.volume > 0


@pytest.mark.parametrize("name", DRONES)
def test_size_is_the_largest_horizontal_extent_and_scales_all(name: str) -> None:
    small, large = built_in_drone(name, 0.5), built_in_drone(name, 1.5)
    assert (small.name, small.size_m, large.size_m) == (name, 0.5, 1.5)
    np.testing.assert_allclose(3.0 * vertices_m(small), vertices_m(large), atol=1e-15)  # round-off
    length, width, height = np.ptp(vertices_m(large), axis=0)
    # A quadrotor's blades at rest do not reach the end of their sweep.
    assert max(length, width) == pytest.approx(1.5, rel=0.1 if name in QUADROTORS else 1e-12)
    assert height < 0.5 * max(length, width)


@pytest.mark.parametrize("drone", [bird(2.0), plane(2.0)])
def test_bird_and_plane_are_not_symmetric(drone: Drone) -> None:
    corners = [part.vertices_B_m[part.faces].mean(axis=1) for part in drone.parts]
    centres, albedo = np.concatenate(corners), np.concatenate([p.albedo for p in drone.parts])
    assert ((albedo > 0) & (albedo <= 1)).all()
    assert len(np.unique(albedo)) >= 5
    wings = np.abs(centres[:, 1]) > 0.26 * drone.size_m  # beyond the plane's pod
    left = centres[:, 1] > 0
    assert albedo[wings & left].mean() > 1.5 * albedo[wings & ~left].mean()
    low, high = vertices_m(drone).min(axis=0), vertices_m(drone).max(axis=0)
    assert abs(low[0] + high[0]) > 0.02 * drone.size_m  # the origin is not in the middle


@pytest.mark.parametrize("name", QUADROTORS)
def test_the_built_in_quadrotors(name: str) -> None:
    by_name, built = built_in_drone(name, 1.0, rotor_hz=40.0), QUADROTORS[name](1.0, 40.0)
    for mine, theirs in zip(by_name.parts, built.parts, strict=True):
        np.testing.assert_array_equal(mine.vertices_B_m, theirs.vertices_B_m)
        np.testing.assert_array_equal(mine.faces, theirs.faces)


# --- Wings ------------------------------------------------------------------------------------


def test_both_wings_rise_and_fall_together() -> None:
    drone = bird(1.0, flap_hz=5.0)
    assert [part.joint is None for part in drone.parts] == [True, False, False]
    shoulders = [part.joint.origin_B_m for part in drone.parts[1:] if part.joint]
    np.testing.assert_array_equal(shoulders[0] * [1, -1, 1], shoulders[1])
    for time_s, angle_rad in ((0.0, 0.0), (0.05, FLAP_RAD), (0.15, -FLAP_RAD)):
        left, right = (at(part, time_s) for part in drone.parts[1:])
        np.testing.assert_allclose(left * [1, -1, 1], right, atol=1e-12)  # round-off
        tip = left[np.argmax(left[:, 1])] - shoulders[0]
        # The tip is 1.5 mm thick at 465 mm from the shoulder.
        assert np.arctan2(tip[2], tip[1]) == pytest.approx(angle_rad, abs=0.004)


def test_a_gliding_bird_is_one_part_with_level_wings() -> None:
    gliding, flapping = bird(flap_hz=0.0), bird(flap_hz=5.0)
    assert len(gliding.parts) == 1
    np.testing.assert_allclose(
        vertices_m(gliding), vertices_m(flapping, 0.2), atol=1e-12
    )  # round-off


@pytest.mark.parametrize("flap_hz", [3.0, 8.0])
def test_no_step_is_longer_than_the_bound_when_wings_flap(flap_hz: float) -> None:
    drone, camera = bird(1.0, flap_hz), two_view_rig(90.0).cameras[0]
    trajectory = random_spline(SplineConfig(duration_s=2.0), np.random.default_rng(1))
    times_s = choose_instants(drone, camera, trajectory, SamplingConfig(max_step_px=0.25))
    T_W_B = trajectory.poses(times_s)
    # Every corner of the mesh, not the hulls' alone by which the instants were chosen.
    corners_B_m = np.stack([vertices_m(drone, time_s) for time_s in times_s])
    corners_W_m = corners_B_m @ T_W_B[:, :3, :3].transpose(0, 2, 1) + T_W_B[:, None, :3, 3]
    steps_px = np.linalg.norm(np.diff(camera.project(corners_W_m), axis=0), axis=-1).max(axis=1)
    seen = footprint(drone, camera, times_s, T_W_B).visible
    both = seen[1:] & seen[:-1]
    # Between probes, 1 ms apart, the speed is taken as constant; a wing gains 2 % on it.
    assert steps_px[both].max() <= 1.02 * 0.25
    still_s = choose_instants(bird(1.0, 0.0), camera, trajectory, SamplingConfig(max_step_px=0.25))
    assert len(times_s) > 1.1 * len(still_s)  # so the flapping counts


# --- By configuration -------------------------------------------------------------------------


@pytest.mark.render
def test_a_drone_by_its_name() -> None:
    recordings = {name: simulate(replace(QUICK, drone=name), 1) for name in DRONES}
    counts = {name: len(found.cameras[0].events) for name, found in recordings.items()}
    assert min(counts.values()) > 1000
    assert len(set(counts.values())) == len(DRONES)
    gliding = simulate(replace(QUICK, drone="bird", flap_hz=0.0), 1)
    assert len(gliding.cameras[0].events) < counts["bird"]
    # The path is the flight's own, whatever flies it.
    paths = [found.truth.T_W_B for found in recordings.values()]
    np.testing.assert_array_equal(paths[0], paths[1])
