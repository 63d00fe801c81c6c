"""Where the drone's image lies: the instants to render, and the pixels to draw at each."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.errors import SimError
from sim.render.config import SamplingConfig
from sim.scene.drone import Drone, piece_size_m
from sim.scene.rig import Camera
from sim.scene.trajectory import PosesAt, Trajectory

# An edge across half the view bows by some 10 px under strong distortion, such a piece by 0.6.
_PIECE_OF_SIZE = 1 / 4
_CHUNK = 256  # instants projected at a time, to bound memory
# Beyond this, products in the native renderer's edge functions overflow 64 bits: they are 3 times
# the square of a corner's coordinate, in 1/256 of a sample, with up to 32 samples along a pixel.
_FAR_PX = 1 << 16
# How far the image may lie beyond the projected hull: by the rasteriser's rounding, and under
# distortion also by the bend of an edge between two points.
_MARGIN_PX = {"none": 0.01, "radtan": 1.0, "equidistant": 1.0}


@dataclass(frozen=True)
class Footprint:
    """The drone's image in one camera at n instants."""

    depth_m: FloatArray  # (n, 2) least and greatest depth
    visible: NDArray[np.bool_]  # (n,) the outline's box overlaps the image
    boxes: IntArray  # (n, 4) x0, y0, x1, y1 (exclusive) of the whole pixels touched in the image
    moved_px: FloatArray  # (n,) largest image displacement of the outline since the instant before


def footprint(
    drone: Drone, camera: Camera, times_s: FloatArray, T_W_B: FloatArray | PosesAt
) -> Footprint:
    """Find where the drone's image lies at instants (n,) [s], with its body at T_W_B (n, 4, 4).

    `moved_px` is 0 unless the drone is visible at this and at the previous instant. SimError when
    the drone passes through the camera's image plane within its view.
    """
    # Between these points of a part, its silhouette is nearly straight.
    piece_m = piece_size_m(drone, camera, _PIECE_OF_SIZE)
    hulls = [_hull_points(part.vertices_B_m, piece_m) for part in drone.parts]
    parts: list[tuple[FloatArray, ...]] = []
    last_px: FloatArray | None = None
    for start in range(0, len(times_s), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        T_W_P = _parts_in_world(drone, times_s[chunk], T_W_B[chunk])
        points_W = np.concatenate(
            [
                hull @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
                for hull, T in zip(hulls, T_W_P, strict=True)
            ],
            axis=1,
        )
        depths_m = points_W @ camera.T_C_W[2, :3] + camera.T_C_W[2, 3]
        pixels = camera.project(points_W)
        _refuse_if_cut(drone, camera, pixels, times_s[chunk])
        at = np.ascontiguousarray(pixels.transpose(2, 0, 1))  # NumPy reduces it twice as fast
        dx, dy = np.diff(at, axis=1, prepend=at[:, :1] if last_px is None else last_px)
        moved = np.sqrt((dx**2 + dy**2).max(axis=1))
        depth = np.stack([depths_m.min(axis=1), depths_m.max(axis=1)], axis=-1)
        parts.append((at.min(axis=2).T, at.max(axis=2).T, depth, moved))
        last_px = at[:, -1:]
    low, high, depth, moved = (np.concatenate(column) for column in zip(*parts, strict=True))
    # A pixel reaches half a pixel beyond its centre.
    edge = np.array([camera.width, camera.height]) - 0.5
    visible = np.all((high > -0.5) & (low < edge), axis=-1)
    margin = _MARGIN_PX[camera.distortion_model]
    low = np.where(visible[:, None], low - margin, 0.0)
    high = np.where(visible[:, None], high + margin, 0.0)
    last = np.array([camera.width - 1, camera.height - 1])
    first_px = np.clip(np.floor(low + 0.5), 0, last)
    last_px = np.clip(np.floor(high + 0.5), 0, last)
    boxes: IntArray = np.concatenate([first_px, last_px + 1], axis=1).astype(np.int64)
    both = visible & np.concatenate([visible[:1], visible[:-1]])
    return Footprint(depth, visible, boxes, np.where(both, moved, 0.0))


def _parts_in_world(drone: Drone, times_s: FloatArray, T_W_B: FloatArray) -> FloatArray:
    """Return the poses of all parts, T_W_P (parts, n, 4, 4)."""
    joints = [part.joint for part in drone.parts]
    return np.stack([T_W_B @ joint.transforms(times_s) if joint else T_W_B for joint in joints])


def _refuse_if_cut(drone: Drone, camera: Camera, pixels: FloatArray, times_s: FloatArray) -> None:
    """Raise SimError if, in view, some of the outline has no image or one too far outside."""
    imaged = np.isfinite(pixels[..., 0])
    cut = imaged.any(axis=1) & ~imaged.all(axis=1)
    cut |= (np.abs(pixels) > _FAR_PX).any(axis=(1, 2))
    if not cut.any():
        return
    low = np.nanmin(pixels[cut], axis=1)
    high = np.nanmax(pixels[cut], axis=1)
    in_view = np.all((high > -0.5) & (low < [camera.width - 0.5, camera.height - 0.5]), axis=-1)
    for time_s in times_s[cut][in_view][:1]:
        raise SimError(
            f"{camera.name}: at {time_s:.3f} s the drone reaches into the camera, where it has no "
            "image: keep the trajectory further from the camera (--spread, --distance), or take a "
            f"drone smaller than {drone.size_m:g} m (--drone-size)"
        )


def _hull_points(vertices_m: FloatArray, piece_m: float) -> FloatArray:
    """Return a convex hull's corners and points no further apart than `piece_m` along its edges."""
    vertices_m = np.unique(vertices_m, axis=0)
    points, triangles = [vertices_m], np.arange(3)[None] % len(vertices_m)
    if len(vertices_m) > 3:
        try:
            hull = ConvexHull(vertices_m)
        except QhullError:  # a flat part has a hull when joggled
            hull = ConvexHull(vertices_m, qhull_options="QJ")
        points, triangles = [vertices_m[hull.vertices]], hull.simplices
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    starts, ends = vertices_m[np.unique(edges, axis=0)].transpose(1, 0, 2)
    for start, end in zip(starts, ends, strict=True):
        n = int(np.ceil(np.linalg.norm(end - start) / piece_m))
        points.append(start + (end - start) * (np.arange(1, n) / max(n, 1))[:, None])
    return np.concatenate(points)


PROBE_HZ = 1000.0  # rate at which the motion is probed beforehand, at least
PROBES_PER_TURN = 100  # probes along a turn of a rotor, at least


def choose_instants(
    drone: Drone, camera: Camera, trajectory: Trajectory, config: SamplingConfig
) -> FloatArray:
    """Choose the instants [s] to render for one camera, from 0 to the trajectory's end.

    While the drone is in view, no point of its outline moves by more than `max_step_px`, to about
    1 %, between two instants. Each camera has instants of its own.
    """
    turns_hz = [abs(part.joint.rate_hz) for part in drone.parts if part.joint is not None]
    probe_hz = max([PROBE_HZ, *(PROBES_PER_TURN * rate for rate in turns_hz)])
    n_probes = max(2, int(np.ceil(trajectory.duration_s * probe_hz)) + 1)
    probes_s: FloatArray = np.linspace(0.0, trajectory.duration_s, n_probes, dtype=np.float64)
    moved_px = footprint(drone, camera, probes_s, PosesAt(trajectory, probes_s)).moved_px
    # Steps are counted by displacement, or by time where that asks for more of them.
    steps = np.maximum(moved_px[1:] / config.max_step_px, np.diff(probes_s) * config.min_rate_hz)
    count = np.concatenate([[0.0], np.cumsum(steps)])
    n_instants = int(np.ceil(count[-1])) + 1
    return np.interp(np.linspace(0.0, count[-1], n_instants), count, probes_s)


class Views(NamedTuple):
    """What a painter needs to draw n instants of one camera."""

    times_s: FloatArray  # (n,) [s]
    visible: NDArray[np.bool_]  # (n,)
    depth_m: FloatArray  # (n, 2) least and greatest depth
    boxes: IntArray  # (n, 4), as in `Footprint`
    T_C_P: Float32Array  # (n, parts, 4, 4)


def crop_size(boxes: IntArray) -> tuple[int, int]:
    """Return the width and height [px] of the smallest crop that holds any of the boxes (n, 4)."""
    width, height = (boxes[:, 2:] - boxes[:, :2]).max(axis=0)
    return int(width), int(height)


def plan_views(
    drone: Drone,
    camera: Camera,
    seen: Footprint,
    chosen: IntArray,
    times_s: FloatArray,
    T_W_B: FloatArray | PosesAt,
) -> Views:
    """Return what a painter needs to draw the chosen instants."""
    visible = seen.visible[chosen]
    T_C_P = camera.T_C_W @ _parts_in_world(drone, times_s[chosen], T_W_B[chosen])
    # Out of view a part shrinks to a point on the axis, in front, which covers no sample.
    T_C_P[:, ~visible] = np.diag([0.0, 0.0, 0.0, 1.0])
    T_C_P[:, ~visible, 2, 3] = 1.0
    matrices = np.ascontiguousarray(T_C_P.swapaxes(0, 1), np.float32)
    return Views(times_s[chosen], visible, seen.depth_m[chosen], seen.boxes[chosen], matrices)
