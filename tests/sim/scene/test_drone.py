import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from sim.scene.drone import DEFAULT_ALBEDO, Joint, drone_from_file, part_faces, piece_size_m
from sim.scene.flyers import DRONES, FLAP_RAD, QUADROTORS, bird, built_in_drone, quadrotor
from sim.twin.bench import printed
from tests.sim.scenes import LENSES, box_drone, make_camera


def vertices_m(drone, time_s=0.0):
    return np.concatenate([at(part, time_s) for part in drone.parts])


def at(part, time_s):
    if part.joint is None:
        return part.vertices_B_m
    T_B_P = part.joint.transforms(np.array([time_s]))[0]
    return part.vertices_B_m @ T_B_P[:3, :3].T + T_B_P[:3, 3]


def as_mesh(part):
    return trimesh.Trimesh(part.vertices_B_m, part.faces, process=True)


@pytest.mark.parametrize("build", QUADROTORS.values())
def test_spinning_rotors_are_parts_of_their_own_and_turn_alike_on_both_sides(build):
    still, spinning = build(), build(rotor_hz=40.0)
    assert [part.joint is None for part in still.parts] == [True]
    assert [part.joint is None for part in spinning.parts] == [True, False, False, False, False]
    n_faces = sum(len(part.faces) for part in spinning.parts)
    assert len(still.parts[0].faces) == n_faces
    assert 250 <= n_faces <= 550  # rendered 10,000 times a second
    assert ((still.parts[0].albedo > 0) & (still.parts[0].albedo <= 1)).all()
    joints = [part.joint for part in spinning.parts[1:]]
    turns = {tuple(np.sign(joint.origin_B_m[:2])): joint.rate_hz for joint in joints}
    rate_hz = turns[1, 1]
    assert turns == {(1, 1): rate_hz, (-1, -1): rate_hz, (1, -1): -rate_hz, (-1, 1): -rate_hz}
    assert abs(rate_hz) == 40.0


@pytest.mark.parametrize("mirror", [(-1, 1, 1), (1, -1, 1)], ids=["fore and aft", "left and right"])
def test_quadrotor_is_its_own_mirror_image(mirror):
    part = quadrotor().parts[0]
    assert len(np.unique(part.albedo)) == 1
    corners = np.unique(part.vertices_B_m, axis=0)
    to_image_m, _ = cKDTree(corners).query(corners * mirror)
    assert to_image_m.max() < 1e-12  # round-off
    # Every piece has a mirror image: matching corners do not suffice when blades stand askew.
    pieces = as_mesh(part).split()
    centres = np.array([piece.center_mass for piece in pieces])
    volumes = np.array([piece.volume for piece in pieces])
    to_image_m, image = cKDTree(centres).query(centres * mirror)
    assert to_image_m.max() < 1e-9  # round-off of integrals
    np.testing.assert_allclose(volumes, volumes[image], rtol=1e-9)


def test_two_tone_is_brighter_in_front():
    (part,) = built_in_drone("two-tone").parts
    front = as_mesh(part).triangles_center[:, 0] > 0
    assert part.albedo[front].mean() > 1.5 * part.albedo[~front].mean()


def test_joint_keeps_its_axis_and_turns_by_the_right_hand():
    joint = Joint(axis_B=2.0 * np.eye(3)[2], origin_B_m=np.array([1.0, 0.0, 0.0]), rate_hz=5.0)
    T_B_P = joint.transforms(np.array([0.0, 0.05, 0.2]))  # no turn, a quarter, a whole one
    on_axis = np.array([1.0, 0.0, 3.0, 1.0])
    np.testing.assert_allclose(T_B_P @ on_axis, np.tile(on_axis, (3, 1)), atol=1e-14)
    expected = [[2, 0, 0, 1], [1, 1, 0, 1], [2, 0, 0, 1]]
    np.testing.assert_allclose(T_B_P @ [2.0, 0.0, 0.0, 1.0], expected, atol=1e-14)  # sines


def from_file(mesh, path, size_m=None):
    mesh.export(path)
    return drone_from_file(path, size_m)


@pytest.mark.parametrize(("size_m", "extents"), [(None, (4.0, 2.0, 8.0)), (0.5, (0.5, 0.25, 1.0))])
def test_file_is_centred_scaled_and_grey_without_colours(tmp_path, size_m, extents):
    box = trimesh.creation.box((4.0, 2.0, 8.0))
    box.apply_translation((5.0, 6.0, 7.0))
    drone = from_file(box, tmp_path / "box.stl", size_m)
    ends_m = np.stack([drone.parts[0].vertices_B_m.min(axis=0), vertices_m(drone).max(axis=0)])
    np.testing.assert_allclose(ends_m, np.outer((-0.5, 0.5), extents), rtol=1e-6)  # float32
    assert drone.size_m == pytest.approx(extents[0])
    np.testing.assert_array_equal(drone.parts[0].albedo, DEFAULT_ALBEDO)


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_each_body_of_a_closed_mesh_faces_outward(tmp_path, suffix):
    body, arm = trimesh.creation.box((1.0, 1.0, 0.3)), trimesh.creation.box((0.2, 0.2, 0.2))
    arm.apply_translation((0.0, 0.0, 0.6))
    arm.invert()  # as many a program leaves what it mirrors
    (part,) = from_file(trimesh.util.concatenate([body, arm]), tmp_path / f"two.{suffix}").parts
    volumes = [one.volume for one in as_mesh(part).split()]
    np.testing.assert_allclose(sorted(volumes), [0.008, 0.3], rtol=1e-5)  # float32


@pytest.mark.parametrize("lens", LENSES)
def test_a_thin_pole_is_split_into_few_pieces_along_it(lens):
    pole = box_drone((0.005, 0.005, 0.6))
    piece_m = piece_size_m(pole, make_camera(lens))
    faces = part_faces(pole.parts[0], piece_m)
    edges_m = np.linalg.norm(np.diff(faces.corners_m, axis=1), axis=-1)
    assert edges_m.max() <= piece_m * (1.0 + 1e-6)  # float32
    assert len(faces.albedo) < 2000  # by the width it would be some millions


def test_open_mesh_shows_both_sides(tmp_path):
    box = trimesh.creation.box()
    box.update_faces(np.arange(12) > 1)
    (part,) = from_file(box, tmp_path / "open.stl").parts
    assert len(part.faces) == len(part.albedo) == 20
    normals = as_mesh(part).face_normals
    np.testing.assert_allclose(normals[:10], -normals[10:], atol=1e-12)  # round-off


# Red by Rec. 709, and sRGB 128 / 255 by its table.
@pytest.mark.parametrize("suffix", [".ply", ".glb", ".obj"])
@pytest.mark.parametrize(("rgb", "light"), [((255, 0, 0), 0.2126), ((128, 128, 128), 0.2159)])
def test_colours_become_linear_luminance(tmp_path, suffix, rgb, light):
    box = trimesh.creation.box()
    box.visual.face_colors = (*rgb, 255)
    (part,) = from_file(box, tmp_path / f"box{suffix}").parts
    np.testing.assert_allclose(part.albedo, light, atol=5e-5)  # the expected light's last digit


def test_a_material_without_image_has_its_colour(tmp_path):
    """As a file of Blender's names it, whose faces have no places in an image."""
    box = trimesh.creation.box()
    lines = [f"v {x} {y} {z}" for x, y, z in box.vertices]
    lines += ["mtllib box.mtl", "usemtl red", *(f"f {a} {b} {c}" for a, b, c in box.faces + 1)]
    (tmp_path / "box.obj").write_text("\n".join(lines))
    (tmp_path / "box.mtl").write_text("newmtl red\nKd 1 0 0\n")
    (part,) = drone_from_file(tmp_path / "box.obj").parts
    np.testing.assert_allclose(part.albedo, 0.2126, atol=5e-5)


def test_scene_keeps_each_mesh_its_colour(tmp_path):
    red, green = trimesh.creation.box(), trimesh.creation.box()
    red.visual.face_colors = (255, 0, 0, 255)
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=(0, 255, 0, 255))
    green.visual = trimesh.visual.TextureVisuals(material=material)
    green.apply_translation((3.0, 0.0, 0.0))
    (part,) = from_file(trimesh.Scene([red, green]), tmp_path / "two.glb").parts
    behind = as_mesh(part).triangles_center[:, 0] < 0
    np.testing.assert_allclose(part.albedo, np.where(behind, 0.2126, 0.7152))


@pytest.mark.parametrize(
    "drone",
    [
        *(build(rotor_hz=40.0) for build in QUADROTORS.values()),
        *(bird(flap_hz=0.0), *map(built_in_drone, DRONES), printed()),
    ],
)
def test_a_drone_is_of_closed_pieces_that_face_outward_and_is_split_by_its_width(drone):
    assert piece_size_m(drone, make_camera("radtan"), 0.25) == 0.25 * drone.size_m  # as it is flat
    for part in drone.parts:
        pieces = as_mesh(part).split()
        assert sum(len(piece.faces) for piece in pieces) == len(part.faces)
        for piece in pieces:
            assert piece.is_volume
            assert piece.volume > 0


@pytest.mark.parametrize("name", DRONES)
def test_size_is_the_largest_horizontal_extent_and_scales_all(name):
    small, large = built_in_drone(name, 0.5), built_in_drone(name, 1.5)
    assert (small.size_m, large.size_m) == (0.5, 1.5)
    np.testing.assert_allclose(3.0 * vertices_m(small), vertices_m(large), atol=1e-15)  # round-off
    times_s = [0.0]
    if name in QUADROTORS:  # with what its blades sweep in one turn
        large, times_s = built_in_drone(name, 1.5, rotor_hz=40.0), np.arange(180) / 180 / 40.0
    swept_m = np.concatenate([vertices_m(large, time_s) for time_s in times_s])
    length, width, height = np.ptp(swept_m, axis=0)
    # A tip misses the extreme by 1 - cos(1 deg).
    assert max(length, width) == pytest.approx(1.5, rel=1e-3 if name in QUADROTORS else 1e-12)
    assert height < 0.5 * max(length, width)


@pytest.mark.parametrize("drone", [built_in_drone(name, 2.0) for name in ("bird", "plane")])
def test_bird_and_plane_are_not_symmetric(drone):
    centres = np.concatenate([as_mesh(part).triangles_center for part in drone.parts])
    albedo = np.concatenate([part.albedo for part in drone.parts])
    assert ((albedo > 0) & (albedo <= 1)).all()
    assert len(np.unique(albedo)) >= 5
    wings = np.abs(centres[:, 1]) > 0.26 * drone.size_m  # beyond the plane's pod
    left = centres[:, 1] > 0
    assert albedo[wings & left].mean() > 1.5 * albedo[wings & ~left].mean()
    low, high = vertices_m(drone).min(axis=0), vertices_m(drone).max(axis=0)
    assert abs(low[0] + high[0]) > 0.02 * drone.size_m  # the origin is not in the middle


def test_both_wings_rise_and_fall_together():
    drone = bird(1.0, flap_hz=5.0)
    assert [part.joint is None for part in drone.parts] == [True, False, False]
    shoulders = [part.joint.origin_B_m for part in drone.parts[1:]]
    np.testing.assert_array_equal(shoulders[0] * [1, -1, 1], shoulders[1])
    for time_s, angle_rad in ((0.0, 0.0), (0.05, FLAP_RAD), (0.15, -FLAP_RAD)):
        left, right = (at(part, time_s) for part in drone.parts[1:])
        np.testing.assert_allclose(left * [1, -1, 1], right, atol=1e-12)  # round-off
        tip = left[np.argmax(left[:, 1])] - shoulders[0]
        # The tip is 1.5 mm thick at 465 mm from the shoulder.
        assert np.arctan2(tip[2], tip[1]) == pytest.approx(angle_rad, abs=0.004)
    gliding = bird(1.0, flap_hz=0.0)
    assert len(gliding.parts) == 1
    # Level, as at half a beat; round-off.
    np.testing.assert_allclose(vertices_m(gliding), vertices_m(drone, 0.2), atol=1e-12)
