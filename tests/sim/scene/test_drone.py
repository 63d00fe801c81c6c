from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from sim.errors import SimError
from sim.scene.drone import DEFAULT_ALBEDO, Drone, Joint, Part, drone_from_file
from sim.scene.flyers import quadrotor, two_tone

Z_AXIS = np.array([0.0, 0.0, 1.0])
TWO_TONE = [0.696762889, 0.130206804, 0.00717278679, 0.0, 0.000715607516]
TWO_TONE += [0.00534553354, 0.00354055825, 0.000429919477, 0.00879122787]
Builder = Callable[..., Drone]
BUILDERS = pytest.mark.parametrize("build", [quadrotor, two_tone])


def as_mesh(part: Part) -> trimesh.Trimesh:
    return trimesh.Trimesh(part.vertices_B_m, part.faces, process=True)


def n_faces(drone: Drone) -> int:
    return sum(len(part.faces) for part in drone.parts)


# --- Quadrotors ------------------------------------------------------------------------------


@BUILDERS
@pytest.mark.parametrize("rotor_hz", [0.0, 40.0])
def test_quadrotor_fits_its_size(build: Builder, rotor_hz: float) -> None:
    drone = build(size_m=2.0, rotor_hz=rotor_hz)
    times_s = np.arange(180) / 180 / 40.0  # one turn; a tip misses the extreme by 1 - cos(1 deg)
    still = Joint(Z_AXIS, np.zeros(3), rate_hz=0.0)
    swept_B_m = [
        part.vertices_B_m @ T_B_P[:3, :3].T + T_B_P[:3, 3]
        for part in drone.parts
        for T_B_P in (part.joint or still).transforms(times_s)
    ]
    length, width, height = np.ptp(np.concatenate(swept_B_m), axis=0)
    assert length <= 2.0 + 1e-12
    assert width < length
    assert height < 0.5 * length
    if rotor_hz:
        assert length == pytest.approx(2.0, rel=1e-3)


@BUILDERS
def test_spinning_rotors_are_parts_of_their_own(build: Builder) -> None:
    still, spinning = build(), build(rotor_hz=40.0)
    assert len(still.parts) == 1
    assert still.parts[0].joint is None
    assert len(spinning.parts) == 5
    assert [part.joint is None for part in spinning.parts] == [True, False, False, False, False]
    assert n_faces(still) == n_faces(spinning)
    rates_hz = [part.joint.rate_hz for part in spinning.parts[1:] if part.joint]
    assert sorted(rates_hz) == [-40.0, -40.0, 40.0, 40.0]


@BUILDERS
def test_quadrotor_is_cheap(build: Builder) -> None:
    drone = build()
    assert 250 <= n_faces(drone) <= 550  # rendered 10,000 times a second
    albedo = drone.parts[0].albedo
    assert ((albedo > 0) & (albedo <= 1)).all()


@pytest.mark.parametrize("mirror", [(-1, 1, 1), (1, -1, 1)], ids=["fore and aft", "left and right"])
def test_quadrotor_is_its_own_mirror_image(mirror: tuple[int, int, int]) -> None:
    part = quadrotor().parts[0]
    assert len(np.unique(part.albedo)) == 1
    corners = np.unique(part.vertices_B_m, axis=0)
    to_image_m, _ = cKDTree(corners).query(corners * mirror)
    assert to_image_m.max() < 1e-12  # round-off
    # Every piece has a mirror image: as many corners do not suffice when blades stand askew.
    pieces = as_mesh(part).split()
    centres = np.array([piece.center_mass for piece in pieces])
    volumes = np.array([piece.volume for piece in pieces])
    to_image_m, image = cKDTree(centres).query(centres * mirror)
    assert to_image_m.max() < 1e-9  # round-off of integrals
    np.testing.assert_allclose(volumes, volumes[image], rtol=1e-9)


def test_quadrotor_turns_alike_on_both_sides() -> None:
    joints = [part.joint for part in quadrotor(rotor_hz=5.0).parts[1:] if part.joint]
    assert len(joints) == 4
    turns = {tuple(np.sign(joint.origin_B_m[:2])): joint.rate_hz for joint in joints}
    for (x_sign, y_sign), rate_hz in turns.items():
        assert turns[-x_sign, -y_sign] == rate_hz
        assert turns[x_sign, -y_sign] == -rate_hz
        assert turns[-x_sign, y_sign] == -rate_hz


def test_two_tone_is_paler_in_front_and_stands_askew() -> None:
    part = two_tone().parts[0]
    front = part.vertices_B_m[part.faces].mean(axis=1)[:, 0] > 0
    assert part.albedo[front].mean() > 1.2 * part.albedo[~front].mean()
    quadrotor_m, two_tone_m = (
        np.ptp(build().parts[0].vertices_B_m, axis=0) for build in (quadrotor, two_tone)
    )
    assert quadrotor_m[2] < 0.6 * two_tone_m[2]


def test_two_tone_is_what_it_was() -> None:
    # Figures of the mesh when it was the default: a change of it moves results of other names.
    part = two_tone(1.0).parts[0]
    triangles = part.vertices_B_m[part.faces]
    sides = triangles[:, 1:] - triangles[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    shine = part.albedo * area
    figures = [area.sum(), shine.sum(), *(shine @ triangles.mean(axis=1))]
    figures += [*(area @ triangles.var(axis=1)), as_mesh(part).volume]
    np.testing.assert_allclose(figures, TWO_TONE, rtol=1e-6, atol=1e-12)  # printed digits


# --- Joints -----------------------------------------------------------------------------------


def test_joint_keeps_its_axis_and_turns_by_the_right_hand() -> None:
    joint = Joint(axis_B=2.0 * Z_AXIS, origin_B_m=np.array([1.0, 0.0, 0.0]), rate_hz=5.0)
    T_B_P = joint.transforms(np.array([0.0, 0.05, 0.2]))  # no turn, a quarter, a whole one
    on_axis = np.array([1.0, 0.0, 3.0, 1.0])
    np.testing.assert_allclose(T_B_P @ on_axis, np.tile(on_axis, (3, 1)), atol=1e-14)
    off_axis = T_B_P @ np.array([2.0, 0.0, 0.0, 1.0])
    expected = [[2, 0, 0, 1], [1, 1, 0, 1], [2, 0, 0, 1]]
    np.testing.assert_allclose(off_axis, expected, atol=1e-14)  # round-off of sines


def test_joint_flaps_within_its_amplitude() -> None:
    joint = Joint(Z_AXIS, np.zeros(3), rate_hz=3.0, amplitude_rad=0.4, phase_rad=0.3)
    T_B_P = joint.transforms(np.linspace(0, 1, 1001))
    angle_rad = np.arctan2(T_B_P[:, 1, 0], T_B_P[:, 0, 0])
    # 333 samples per flap miss the extreme by less than 1e-4 of it.
    assert angle_rad.max() == pytest.approx(0.4, rel=1e-4)
    assert angle_rad.min() == pytest.approx(-0.4, rel=1e-4)
    assert angle_rad[0] == pytest.approx(0.4 * np.sin(0.3))


# --- Files ------------------------------------------------------------------------------------


def export(mesh: trimesh.Trimesh | trimesh.Scene, path: Path) -> Path:
    mesh.export(path)
    return path


def test_file_is_centred_and_scaled(tmp_path: Path) -> None:
    box = trimesh.creation.box((4.0, 2.0, 8.0))
    box.apply_translation((5.0, 6.0, 7.0))
    path = export(box, tmp_path / "box.stl")
    for size_m, extents in ((None, (4.0, 2.0, 8.0)), (0.5, (0.5, 0.25, 1.0))):
        drone = drone_from_file(path, size_m)
        vertices = drone.parts[0].vertices_B_m
        np.testing.assert_allclose(
            vertices.max(axis=0), np.divide(extents, 2), rtol=1e-6
        )  # float32
        np.testing.assert_allclose(vertices.min(axis=0), np.divide(extents, -2), rtol=1e-6)
        assert drone.size_m == pytest.approx(extents[0])
        assert drone.name == "box"


def test_inside_out_file_is_turned_outward(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    box.invert()
    part = drone_from_file(export(box, tmp_path / "box.stl")).parts[0]
    assert len(part.faces) == 12
    assert as_mesh(part).volume == pytest.approx(1.0)


def test_open_mesh_shows_both_sides(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    box.update_faces(np.arange(12) > 1)
    part = drone_from_file(export(box, tmp_path / "open.stl")).parts[0]
    assert len(part.faces) == len(part.albedo) == 20
    triangles = part.vertices_B_m[part.faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    np.testing.assert_allclose(normals[:10], -normals[10:], atol=1e-12)  # round-off


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".obj"])
def test_colours_become_linear_luminance(tmp_path: Path, suffix: str) -> None:
    box = trimesh.creation.box()
    box.visual.face_colors = (255, 0, 0, 255)
    part = drone_from_file(export(box, tmp_path / f"red{suffix}")).parts[0]
    np.testing.assert_allclose(part.albedo, 0.2126)  # red in Rec. 709
    box.visual.face_colors = (128, 128, 128, 255)
    part = drone_from_file(export(box, tmp_path / f"grey{suffix}")).parts[0]
    np.testing.assert_allclose(part.albedo, 0.2159, atol=1e-4)  # sRGB 128 / 255, by its table


def test_scene_keeps_each_mesh_its_colour(tmp_path: Path) -> None:
    red, green = trimesh.creation.box(), trimesh.creation.box()
    red.visual.face_colors = (255, 0, 0, 255)
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=(0, 255, 0, 255))
    green.visual = trimesh.visual.TextureVisuals(material=material)
    green.apply_translation((3.0, 0.0, 0.0))
    part = drone_from_file(export(trimesh.Scene([red, green]), tmp_path / "two.glb")).parts[0]
    behind = part.vertices_B_m[part.faces].mean(axis=1)[:, 0] < 0
    np.testing.assert_allclose(part.albedo[behind], 0.2126)
    np.testing.assert_allclose(part.albedo[~behind], 0.7152)


def test_file_without_colours_is_grey(tmp_path: Path) -> None:
    part = drone_from_file(export(trimesh.creation.box(), tmp_path / "box.stl")).parts[0]
    np.testing.assert_array_equal(part.albedo, DEFAULT_ALBEDO)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("mesh.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no faces"),
        ("mesh.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("mesh.obj", "v 0 0 0\nv 0 0 1\nv 0 0 2\nf 1 2 3\n", "no extent along x or y"),
        ("mesh.stl", "not a mesh", "has no faces"),
        ("mesh.docx", "not a mesh", "cannot read the drone's mesh"),
    ],
)
def test_bad_file(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(SimError, match=message) as error:
        drone_from_file(path)
    assert str(path) in str(error.value)


def test_face_without_its_vertices(tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\n"
        "property float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"
    )
    with pytest.raises(SimError, match="faces whose vertices are missing"):
        drone_from_file(path)


def test_missing_file_and_bad_size(tmp_path: Path) -> None:
    with pytest.raises(SimError, match="does not exist"):
        drone_from_file(tmp_path / "none.stl")
    path = export(trimesh.creation.box(), tmp_path / "box.stl")
    with pytest.raises(SimError, match="size must be a positive number of metres, got 0"):
        drone_from_file(path, size_m=0.0)
