"""Poses and a camera in; where the drone's image lies and how far it moves, out."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from sim.errors import SimError
from sim.scene.drone import Drone
from sim.scene.rig import MIN_DEPTH_M, Camera
from sim.scene.trajectory import PosesAt

FloatArray = NDArray[np.float64]

# An edge across half the view bows by some 10 px under strong distortion, this piece of it by 0.6.
_PIECE_OF_SIZE = 1 / 4
_CHUNK = 1024  # instants projected at a time, to bound memory
_SURE_SLOPE = 3.0  # of a ray: less than 77 deg off the axis, which every pinhole images


@dataclass(frozen=True)
class Footprint:
    """The drone's image in one camera at n instants."""

    low_px: FloatArray  # (n, 2) least column and row of its outline; NaN where not visible
    high_px: FloatArray  # (n, 2) greatest
    depth_m: FloatArray  # (n, 2) least and greatest depth
    visible: NDArray[np.bool_]  # (n,) the outline's box overlaps the image
    moved_px: FloatArray  # (n,) largest image displacement of the outline since the instant before


def outline_points(drone: Drone, camera: Camera) -> tuple[FloatArray, ...]:
    """Return points of each part [m] between which its silhouette is all but straight.

    They are the corners of its convex hull; where the camera bends lines, points along the hull's
    edges too.
    """
    piece_m = None if camera.distortion_model == "none" else drone.size_m * _PIECE_OF_SIZE
    return tuple(_hull_points(part.vertices_B_m, piece_m) for part in drone.parts)


def footprint(
    drone: Drone, camera: Camera, times_s: FloatArray, T_W_B: FloatArray | PosesAt
) -> Footprint:
    """Find where the drone's image lies.

    Parameters
    ----------
    drone
    camera
    times_s
        Instants, shape (n,) [s]; they set the joints.
    T_W_B
        Poses of the drone's body at those instants, shape (n, 4, 4).

    Returns
    -------
    Footprint
        `moved_px` is 0 wherever the drone is not visible, before or after.

    Raises
    ------
    SimError
        The drone passes through the camera's image plane within its view.
    """
    n = len(times_s)
    low, high = np.empty((n, 2)), np.empty((n, 2))
    depth, moved = np.empty((n, 2)), np.zeros(n)
    hulls = outline_points(drone, camera)
    last_px: FloatArray | None = None
    for start in range(0, n, _CHUNK):
        chunk = slice(start, min(start + _CHUNK, n))
        points_W = _outline_in_world(drone, hulls, times_s[chunk], T_W_B[chunk])
        depths = points_W @ camera.T_C_W[2, :3] + camera.T_C_W[2, 3]
        depth[chunk] = np.stack([depths.min(axis=1), depths.max(axis=1)], axis=-1)
        last_px = _project(
            camera, points_W, times_s[chunk], last_px, low[chunk], high[chunk], moved[chunk]
        )
    # A pixel reaches half a pixel beyond its centre.
    edge = np.array([camera.width, camera.height]) - 0.5
    visible = np.all((high > -0.5) & (low < edge), axis=-1)
    both = visible & np.concatenate([visible[:1], visible[:-1]])
    return Footprint(low, high, depth, visible, np.where(both, moved, 0.0))


def _project(
    camera: Camera,
    points_W: FloatArray,
    times_s: FloatArray,
    last_px: FloatArray | None,
    low: FloatArray,
    high: FloatArray,
    moved: FloatArray,
) -> FloatArray:
    """Fill a chunk's boxes (n, 2) and displacements (n,) [px]; returns the last instant's pixels.

    `last_px` (1, corners, 2) are those of the instant before; None: there is none.
    """
    K = camera.K
    was_imaged = last_px is None or np.isfinite(last_px).all()
    if camera.distortion_model == "none" and not (K[0, 1] or K[1, 0]) and was_imaged:
        points_C = points_W @ camera.T_C_W[:3, :3].T + camera.T_C_W[:3, 3]
        at = np.empty((1, points_W.shape[1], 2)) if last_px is None else last_px.copy()
        intrinsics = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        about = (points_C, intrinsics, last_px is None, at[0], low, high, moved)
        if _follow_corners(*about):  # type: ignore[no-untyped-call]
            return at
    pixels = camera.project(points_W)
    _refuse_if_cut(camera, pixels, times_s)
    low[:], high[:] = pixels.min(axis=1), pixels.max(axis=1)
    before = pixels[:1] if last_px is None else last_px
    steps = np.linalg.norm(np.diff(pixels, axis=0, prepend=before), axis=-1)
    moved[:] = steps.max(axis=1)
    return pixels[-1:]


@njit(cache=True, nogil=True)
def _follow_corners(  # type: ignore[no-untyped-def]
    points_C, intrinsics, is_first, at, low, high, moved
):
    """Do what `_project` does, in one pass, as long as all corners surely have an image.

    `at` (corners, 2) holds the pixels of the instant before, and then of the last; `is_first`: it
    does not yet. Returns whether all have been followed.
    """
    fx, fy, cx, cy = intrinsics
    for k in range(points_C.shape[0]):
        x0, y0, x1, y1, farthest = np.inf, np.inf, -np.inf, -np.inf, 0.0
        for i in range(points_C.shape[1]):
            z = points_C[k, i, 2]
            if not z > MIN_DEPTH_M:
                return False
            x, y = points_C[k, i, 0] / z, points_C[k, i, 1] / z
            if not (abs(x) < _SURE_SLOPE and abs(y) < _SURE_SLOPE):
                return False
            u, v = fx * x + cx, fy * y + cy
            if k > 0 or not is_first:
                du, dv = u - at[i, 0], v - at[i, 1]
                farthest = max(farthest, np.sqrt(du * du + dv * dv))
            x0, y0, x1, y1 = min(x0, u), min(y0, v), max(x1, u), max(y1, v)
            at[i, 0], at[i, 1] = u, v
        low[k, 0], low[k, 1], high[k, 0], high[k, 1] = x0, y0, x1, y1
        moved[k] = farthest
    return True


def _outline_in_world(
    drone: Drone, hulls: tuple[FloatArray, ...], times_s: FloatArray, T_W_B: FloatArray
) -> FloatArray:
    """Place the corners of all hulls in the world, shape (n, corners, 3) [m]."""
    placed = []
    for part, corners in zip(drone.parts, hulls, strict=True):
        T_W_P = T_W_B if part.joint is None else T_W_B @ part.joint.transforms(times_s)
        placed.append(corners @ T_W_P[:, :3, :3].transpose(0, 2, 1) + T_W_P[:, None, :3, 3])
    return np.concatenate(placed, axis=1)


def _refuse_if_cut(camera: Camera, pixels: FloatArray, times_s: FloatArray) -> None:
    """Refuse instants at which only some of the outline has an image, and it lies in view."""
    imaged = np.isfinite(pixels[..., 0])
    cut = imaged.any(axis=1) & ~imaged.all(axis=1)
    if not cut.any():
        return
    low = np.nanmin(pixels[cut], axis=1)
    high = np.nanmax(pixels[cut], axis=1)
    in_view = np.all((high > -0.5) & (low < [camera.width - 0.5, camera.height - 0.5]), axis=-1)
    for time_s in times_s[cut][in_view][:1]:
        raise SimError(
            f"{camera.name}: at {time_s:.3f} s the drone reaches into the camera, where it has no "
            "image: keep the trajectory further from the camera"
        )


def _hull_points(vertices_m: FloatArray, piece_m: float | None) -> FloatArray:
    """Return a convex hull's corners and points no further apart than `piece_m` along its edges."""
    vertices_m = np.unique(vertices_m, axis=0)
    points, triangles = [vertices_m], np.arange(3)[None] % len(vertices_m)
    if len(vertices_m) > 3:
        try:
            hull = ConvexHull(vertices_m)
        except QhullError:  # a flat part has a hull when joggled
            hull = ConvexHull(vertices_m, qhull_options="QJ")
        points, triangles = [vertices_m[hull.vertices]], hull.simplices
    if piece_m is not None:
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        starts, ends = vertices_m[np.unique(edges, axis=0)].transpose(1, 0, 2)
        for start, end in zip(starts, ends, strict=True):
            n = int(np.ceil(np.linalg.norm(end - start) / piece_m))
            points.append(start + (end - start) * (np.arange(1, n) / max(n, 1))[:, None])
    return np.concatenate(points)
