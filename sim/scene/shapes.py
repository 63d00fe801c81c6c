"""Measures in; closed triangle meshes, of which the drones are put together, out.

The unit of length is the caller's. All faces are counter-clockwise seen from outside.
"""

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]


def hull(points: ArrayLike) -> trimesh.Trimesh:
    """Return the convex hull of points (n, 3)."""
    mesh: trimesh.Trimesh = trimesh.convex.convex_hull(np.asarray(points, dtype=np.float64))
    return mesh


def hexagonal_hull(sections: Sequence[tuple[float, float, float, float]]) -> trimesh.Trimesh:
    """Return the hull of hexagonal cross sections: x, half width, bottom, top of each."""
    return hull(
        [
            (x, y, z)
            for x, half_width, bottom, top in sections
            for y, z in (
                (-half_width, 0.0),
                (half_width, 0.0),
                (-0.6 * half_width, bottom),
                (0.6 * half_width, bottom),
                (-0.6 * half_width, top),
                (0.6 * half_width, top),
            )
        ]
    )


def panel(outline: Sequence[tuple[float, float, float, float]]) -> trimesh.Trimesh:
    """Return a flat convex panel about its outline's corners: x, y, z, thickness along z of each.

    The thickness lets it taper: the corners must lie on one plane, and convexly.
    """
    return hull([(x, y, z + 0.5 * side * h) for x, y, z, h in outline for side in (-1, 1)])


def beam(start: ArrayLike, end: ArrayLike, width: float) -> trimesh.Trimesh:
    """Return a beam between two points, its section a triangle with an edge on top."""
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    bar = prism(3, radius=0.62 * width, length=length)
    bar.apply_transform(pose((0.0, 0.0, 0.0), pitch_rad=np.pi / 2))
    yaw_rad = float(np.arctan2(along[1], along[0]))
    pitch_rad = -float(np.arcsin(along[2] / length))
    bar.apply_transform(pose(0.5 * np.add(start, end), yaw_rad, pitch_rad))
    return bar


def prism(n_sides: int, radius: float, length: float) -> trimesh.Trimesh:
    """Return a regular prism along z about the origin, of as few faces as can be."""
    angles_rad = 2.0 * np.pi * np.arange(n_sides) / n_sides
    ring = radius * np.column_stack([-np.cos(angles_rad), np.sin(angles_rad)])
    ends = [np.column_stack([ring, np.full(n_sides, z)]) for z in (-length / 2, length / 2)]
    return hull(np.concatenate(ends))


def pose(origin: ArrayLike, yaw_rad: float = 0.0, pitch_rad: float = 0.0) -> FloatArray:
    """Return the (4, 4) transform that turns about y, then about z, then moves to `origin`."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZY", [yaw_rad, pitch_rad]).as_matrix()
    T[:3, 3] = origin
    return T
