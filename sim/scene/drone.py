"""Drones as closed triangle meshes with albedo, some of them on joints.

Body frame B: x forward, y left, z up, metres; origin within the drone. All faces are
counter-clockwise seen from outside.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.errors import SimError
from sim.scene.background import LUMINANCE_WEIGHTS, linear_from_srgb
from sim.scene.rig import Camera

DEFAULT_SIZE_M = 0.65
DEFAULT_ALBEDO = 0.25  # of a mesh file without colours: dark grey
MIN_ALBEDO = 0.01  # a black face still reflects a little


@dataclass(frozen=True)
class Joint:
    """An axis fixed in the body, about which a part spins or flaps."""

    axis_B: FloatArray  # (3,), any length but 0
    origin_B_m: FloatArray  # (3,) [m], a point on the axis
    rate_hz: float  # turns, or flaps, per second; the sign is the sense of turning
    amplitude_rad: float | None = None  # of a flap; None: the part spins

    def transforms(self, times_s: FloatArray) -> FloatArray:
        """Return T_B_P (n, 4, 4): the part's vertices at rest [m] to the body frame, at each time.

        The angle is `2 pi rate t` of a part that spins, `amplitude sin(2 pi rate t)` of a flap.
        """
        cycle_rad = 2.0 * np.pi * self.rate_hz * np.asarray(times_s)
        if self.amplitude_rad is None:
            angle_rad = cycle_rad
        else:
            angle_rad = self.amplitude_rad * np.sin(cycle_rad)
        axis = self.axis_B / np.linalg.norm(self.axis_B)
        R = Rotation.from_rotvec(angle_rad[:, None] * axis).as_matrix()
        T_B_P = np.zeros((len(R), 4, 4))
        T_B_P[:, :3, :3] = R
        T_B_P[:, :3, 3] = self.origin_B_m - R @ self.origin_B_m
        T_B_P[:, 3, 3] = 1.0
        return T_B_P


@dataclass(frozen=True)
class Part:
    """A rigid piece of the drone: closed, with faces counter-clockwise seen from outside."""

    vertices_B_m: FloatArray  # (V, 3) [m], frame B, at rest
    faces: IntArray  # (F, 3), indices of vertices
    albedo: FloatArray  # (F,), in (0, 1], linear luminance (no gamma)
    joint: Joint | None = None  # None: fixed to the body


@dataclass(frozen=True)
class Drone:
    """The object that the cameras watch."""

    parts: tuple[Part, ...]
    size_m: float  # largest horizontal extent, including what the joints sweep


def solid(mesh: trimesh.Trimesh, albedo: float) -> Part:
    """Return a mesh of one colour as a part."""
    return Part(np.array(mesh.vertices), np.array(mesh.faces), np.full(len(mesh.faces), albedo))


def join(parts: list[Part], scale: float = 1.0, joint: Joint | None = None) -> Part:
    """Join parts into a single one, scaled, on the given joint."""
    first = np.cumsum([0] + [len(part.vertices_B_m) for part in parts])
    vertices = np.concatenate([part.vertices_B_m for part in parts]) * scale
    faces = np.concatenate([part.faces + n for part, n in zip(parts, first, strict=False)])
    return Part(vertices, faces, np.concatenate([part.albedo for part in parts]), joint)


def check_size(size_m: float) -> None:
    """Raise SimError unless the size of a drone is finite and positive."""
    if not (np.isfinite(size_m) and size_m > 0):
        raise SimError(f"the drone's size must be a positive number of metres, got {size_m}")


def drone_from_file(path: Path, size_m: float | None = None) -> Drone:
    """Read a user's own mesh, of any format that trimesh reads; a scene's meshes are joined.

    x is forward, y left, z up; the middle of the bounding box becomes the origin. With a size [m]
    the mesh is scaled so that its larger horizontal extent has this size; else the file's units are
    metres. Albedo is the luminance of the file's colours (sRGB, alpha ignored), or a dark grey. A
    mesh that is not closed shows both sides. SimError for a file that cannot be used.
    """
    if size_m is not None:
        check_size(size_m)
    mesh = join([_closed(mesh) for mesh in _load_meshes(path)])
    low, high = mesh.vertices_B_m.min(axis=0), mesh.vertices_B_m.max(axis=0)
    extent_m = float((high - low)[:2].max())
    if extent_m <= 0.0:
        raise SimError(f"{path}: the drone's mesh has no extent along x or y")
    scale = 1.0 if size_m is None else size_m / extent_m
    centred = replace(mesh, vertices_B_m=(mesh.vertices_B_m - 0.5 * (low + high)) * scale)
    return Drone((centred,), extent_m * scale)


def _load_meshes(path: Path) -> list[trimesh.Trimesh]:
    if not path.is_file():
        raise SimError(f"the drone's mesh {path} does not exist")
    try:
        geometries = trimesh.load_scene(path, process=False).dump()
    except Exception as error:  # a reader raises whatever its format's parser does
        raise SimError(f"cannot read the drone's mesh {path}: {error}") from error
    meshes = [mesh for mesh in geometries if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not meshes:
        raise SimError(f"{path}: the drone's mesh has no faces")
    if any(mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices) for mesh in meshes):
        raise SimError(f"{path}: the drone's mesh has faces whose vertices are missing")
    if not all(np.isfinite(mesh.vertices).all() for mesh in meshes):
        raise SimError(f"{path}: the drone's mesh has vertices that are not finite")
    return meshes


def _closed(mesh: trimesh.Trimesh) -> Part:
    """Return a mesh with outward faces; a mesh that is not closed gets each face on both sides."""
    albedo = _albedo(mesh)
    mesh = mesh.copy()
    mesh.merge_vertices(merge_tex=True, merge_norm=True)  # files repeat vertices along every seam
    # Also of a closed mesh: one of its bodies, such as a mirrored arm, may be inside out.
    trimesh.repair.fix_normals(mesh, multibody=True)  # type: ignore[no-untyped-call]
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    if not mesh.is_volume:
        faces = np.concatenate([faces, faces[:, ::-1]])
        albedo = np.concatenate([albedo, albedo])
    return Part(vertices, faces, albedo)


def _albedo(mesh: trimesh.Trimesh) -> FloatArray:
    """Return the linear luminance (F,) of a mesh's face colours."""
    visual = mesh.visual
    if isinstance(visual, trimesh.visual.TextureVisuals):
        material, images = visual.material, ("image", "baseColorTexture")
        if any(getattr(material, name, None) is not None for name in images):
            corners = visual.to_color().vertex_colors  # type: ignore[no-untyped-call]
        else:
            corners = material.main_color
        colors = np.broadcast_to(corners, (len(mesh.vertices), 4))[mesh.faces].mean(axis=1)
    elif visual is None or visual.kind is None:
        return np.full(len(mesh.faces), DEFAULT_ALBEDO)
    else:
        colors = np.asarray(visual.face_colors)
    linear = linear_from_srgb(colors[:, :3] / 255.0)
    luminance: FloatArray = np.clip(linear @ LUMINANCE_WEIGHTS, MIN_ALBEDO, 1.0)
    return luminance


def hull(points: ArrayLike) -> trimesh.Trimesh:
    """Return the convex hull of points (n, 3)."""
    mesh: trimesh.Trimesh = trimesh.convex.convex_hull(np.asarray(points, dtype=np.float64))
    return mesh


def hexagonal_hull(sections: Sequence[tuple[float, float, float, float]]) -> trimesh.Trimesh:
    """Return the hull of hexagonal cross sections: x, half width, bottom, top of each."""
    return hull(
        [
            (x, side * share * half_width, z)
            for x, half_width, bottom, top in sections
            for share, z in ((1.0, 0.0), (0.6, bottom), (0.6, top))
            for side in (-1, 1)
        ]
    )


def panel(outline: Sequence[tuple[float, float, float, float]]) -> trimesh.Trimesh:
    """Return a flat convex panel about its corners: x, y, z, thickness along z of each."""
    return hull([(x, y, z + 0.5 * side * h) for x, y, z, h in outline for side in (-1, 1)])


def beam(start: ArrayLike, end: ArrayLike, width: float) -> trimesh.Trimesh:
    """Return a beam between two points, its section a triangle with an edge on top."""
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    bar = moved(prism(3, 0.62 * width, length), (0.0, 0.0, 0.0), pitch_rad=np.pi / 2)
    yaw_rad = float(np.arctan2(along[1], along[0]))
    return moved(bar, 0.5 * np.add(start, end), yaw_rad, -float(np.arcsin(along[2] / length)))


def prism(n_sides: int, radius: float, length: float) -> trimesh.Trimesh:
    """Return a regular prism along z about the origin, of as few faces as can be."""
    angles_rad = 2.0 * np.pi * np.arange(n_sides) / n_sides
    ring = radius * np.column_stack([-np.cos(angles_rad), np.sin(angles_rad)])
    ends = [np.column_stack([ring, np.full(n_sides, z)]) for z in (-length / 2, length / 2)]
    return hull(np.concatenate(ends))


def moved(
    mesh: trimesh.Trimesh, by: ArrayLike, yaw_rad: float = 0.0, pitch_rad: float = 0.0
) -> trimesh.Trimesh:
    """Turn a mesh about y, then about z, and move it, in place; returns it."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZY", [yaw_rad, pitch_rad]).as_matrix()
    T[:3, 3] = by
    mesh.apply_transform(T)
    return mesh


# Under distortion a straight edge bends; pieces of this share of the size stay straight enough.
PIECE_OF_SIZE = 1 / 16


@dataclass(frozen=True)
class Faces:
    """Faces of one part, counter-clockwise seen from outside, in single precision as OpenGL's."""

    corners_m: Float32Array  # (F, 3, 3) [m], frame of the part
    normals: Float32Array  # (F, 3), unit
    albedo: Float32Array  # (F,)


def piece_size_m(drone: Drone, camera: Camera, share: float = PIECE_OF_SIZE) -> float:
    """Return the longest edge [m] that stays straight: a share of the size, inf if undistorted.

    The size is the height where that is larger: else a thin pole has millions of pieces.
    """
    heights_m = np.concatenate([part.vertices_B_m[:, 2] for part in drone.parts])
    size_m = max(drone.size_m, float(np.ptp(heights_m)))
    return np.inf if camera.distortion_model == "none" else size_m * share


@contextmanager
def in_memory(n_faces: int) -> Iterator[None]:
    """Raise SimError, with the mesh's number of faces, when the block runs out of memory."""
    try:
        yield
    except MemoryError as error:
        raise SimError(
            f"the drone's mesh of {n_faces} faces does not fit the memory: simplify it"
        ) from error


def part_faces(part: Part, piece_m: float) -> Faces:
    """Split a part's faces until no edge is longer than `piece_m`; SimError if out of memory."""
    with in_memory(len(part.faces)):
        split: Any = trimesh.remesh.subdivide_to_size
        vertices, faces, index = split(part.vertices_B_m, part.faces, piece_m, return_index=True)
        corners, albedo = vertices[faces], part.albedo[index]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        has_area = length[:, 0] > 0.0  # faces without area show nothing
        shown = (corners[has_area], normals[has_area] / length[has_area], albedo[has_area])
        return Faces(*(values.astype(np.float32) for values in shown))
