"""A part of the drone in, its faces as every renderer draws them out."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.errors import SimError
from sim.scene.camera import Camera
from sim.scene.drone import Drone, Part

Float32Array = NDArray[np.float32]

# Under distortion a straight edge bends; pieces of this share of the drone stay straight enough.
PIECE_OF_SIZE = 1 / 16


@dataclass(frozen=True)
class Faces:
    """Faces of one part, counter-clockwise seen from outside, in single precision as OpenGL's."""

    corners_m: Float32Array  # (F, 3, 3) [m], frame of the part
    normals: Float32Array  # (F, 3), unit
    albedo: Float32Array  # (F,)


def piece_size_m(drone: Drone, camera: Camera) -> float | None:
    """Return the longest edge [m] that may be drawn straight in this camera; None: any."""
    return None if camera.distortion_model == "none" else drone.size_m * PIECE_OF_SIZE


def part_faces(part: Part, piece_m: float | None) -> Faces:
    """Return a part's faces.

    Parameters
    ----------
    part
    piece_m
        Split faces until no edge is longer [m]; None: leave them.

    Returns
    -------
    Faces

    Raises
    ------
    SimError
        The mesh does not fit the memory.
    """
    with in_memory(len(part.faces)):
        return _faces(part, piece_m)


@contextmanager
def in_memory(n_faces: int) -> Iterator[None]:
    """Refuse a mesh of so many faces that the memory does not hold."""
    try:
        yield
    except MemoryError as error:
        raise SimError(
            f"the drone's mesh of {n_faces} faces does not fit the memory: simplify it"
        ) from error


def _faces(part: Part, piece_m: float | None) -> Faces:
    vertices, faces, albedo = part.vertices_B_m, part.faces, part.albedo
    if piece_m is not None:
        vertices, faces, index = trimesh.remesh.subdivide_to_size(  # type: ignore[no-untyped-call]
            vertices, faces, piece_m, return_index=True
        )
        albedo = albedo[index]
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    has_area = length[:, 0] > 0.0  # the others show nothing
    return Faces(
        corners[has_area].astype(np.float32),
        (normals[has_area] / length[has_area]).astype(np.float32),
        albedo[has_area].astype(np.float32),
    )
