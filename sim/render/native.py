"""The renderer without OpenGL: triangles, point-sampled on the lattice in compiled Python.

It draws what `sim.render.gl_atlas` draws, by OpenGL's rules on the same grid as the shaders in
`sim/render/shaders`: corners are rounded to 1/256 of a sample, edge functions are whole numbers, a
sample on an edge belongs to the triangle that has the edge on its left or at its top, and 1/z is
linear across a triangle. So it covers the samples that an OpenGL driver covers, but for a few where
the driver's single precision rounds a corner the other way.

Depth and sample word share one 64-bit key, depth above: the nearest triangle has the largest key.
"""

import numpy as np
from numba import njit

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.render.config import DISTORTION_MODELS, RenderConfig
from sim.render.footprint import Views, crop_size
from sim.render.lattice import COUNT_BIT, FULL_CODE, LANES, average_block, runs_of_tile, sum_runs
from sim.scene.drone import Drone, in_memory, part_faces, piece_size_m
from sim.scene.rig import MIN_DEPTH_M, Camera

BATCH = 256  # instants, at most
BATCH_PIXELS = 1 << 21  # of all their crops, at most: 8 MB
# The most samples each way of a block of pixels: its keys then stay in the processor's cache.
BLOCK_SAMPLES = 384


_Mesh = tuple[FloatArray, IntArray, IntArray, FloatArray, FloatArray, IntArray]
"""Vertices, first vertex of each part, faces, normals, albedo, and first face of each part."""


class NativePainter:
    """Draws one drone in compiled Python, crop by crop."""

    def __init__(self, drone: Drone, config: RenderConfig) -> None:
        self._drone, self._config = drone, config
        self._meshes: dict[float, _Mesh] = {}  # by the size of their pieces

    def room(self, width_px: int, height_px: int) -> int:
        """Return how many crops of this size may be drawn at a time."""
        return int(min(BATCH, max(1, BATCH_PIXELS // (width_px * height_px))))

    def paint(
        self, camera: Camera, views: Views, corner_px: IntArray, background: Float32Array
    ) -> Float32Array:
        """Draw crops (n, height, width), whose first pixels are at `corner_px` (n, 2)."""
        lattice = self._config.lattice
        width, height = crop_size(views.boxes)
        largest = max(1, BLOCK_SAMPLES // lattice.a)
        block_px = tuple(-(-size // -(-size // largest)) for size in (width, height))
        tile = lattice.tile_size(*block_px)
        piece_m = piece_size_m(self._drone, camera)
        if piece_m not in self._meshes:
            self._meshes[piece_m] = _mesh(self._drone, piece_m)
        K = camera.K
        luminance = np.empty((len(views.times_s), height, width), np.float32)
        _paint_crops(
            *self._meshes[piece_m], views.T_C_P.astype(np.float64), views.visible,
            (K[0, 0], K[1, 1], K[0, 2], K[1, 2]), DISTORTION_MODELS[camera.distortion_model],
            tuple(camera.distortion_coeffs) or (0.0, 0.0, 0.0, 0.0), (lattice.a, lattice.b),
            tuple(lattice.centre),
            lattice.tile_origin(corner_px, block_px[1]),
            block_px, tile, tuple(self._config.light_in(camera)), self._config.ambient,
            runs_of_tile(lattice, block_px), lattice.samples_per_pixel,
            corner_px[:, 0], corner_px[:, 1], background, luminance,
        )  # fmt: skip
        return luminance


def _mesh(drone: Drone, piece_m: float) -> _Mesh:
    """Put all parts into one list of faces, in double precision."""
    parts = [part_faces(part, piece_m) for part in drone.parts]
    with in_memory(sum(len(part.albedo) for part in parts)):
        corners = [part.corners_m.reshape(-1, 3) for part in parts]
        found = [np.unique(one, axis=0, return_inverse=True) for one in corners]
        first = np.cumsum([0] + [len(vertices) for vertices, _ in found])
        faces = [index.reshape(-1, 3) + n for (_, index), n in zip(found, first, strict=False)]
        return (
            np.concatenate([vertices for vertices, _ in found]).astype(np.float64),
            first,
            np.concatenate(faces),
            np.concatenate([part.normals for part in parts]).astype(np.float64),
            np.concatenate([part.albedo for part in parts]).astype(np.float64),
            np.cumsum([0] + [len(part.albedo) for part in parts]),
        )


@njit(cache=True, nogil=True)
def _place(
    vertices, first_vertex, T_C_P, intrinsics, model, coeffs, lattice, shift_u, shift_v,
    inverse_z, snapped,
):  # fmt: skip
    """Find 1/z and lattice position, rounded to 1/256, of all vertices; returns bounds of 1/z."""
    nearest, farthest = 0.0, np.inf
    for part in range(T_C_P.shape[0]):
        T = T_C_P[part]
        for i in range(first_vertex[part], first_vertex[part + 1]):
            px, py, pz = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
            y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
            z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
            inverse = 1.0 / max(z, MIN_DEPTH_M)
            inverse_z[i] = inverse
            nearest, farthest = max(nearest, inverse), min(farthest, inverse)
            dx, dy = _distort(x * inverse, y * inverse, model, coeffs)
            u = intrinsics[0] * dx + intrinsics[2]
            v = intrinsics[1] * dy + intrinsics[3]
            snapped[i, 0] = _snap(lattice[0] * u - lattice[1] * v + shift_u)
            snapped[i, 1] = _snap(lattice[1] * u + lattice[0] * v + shift_v)
    # Room at both ends, so that rounding leaves every depth within a key's bits, and above 0.
    return 1.05 * nearest, 0.95 * farthest


@njit(cache=True, nogil=True)
def _distort(x, y, model, k):
    """Distort a ray's slopes by the lens model: 0 none, 1 radtan, 2 equidistant."""
    if model == 1:
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k[0] + r2 * k[1])
        bent_x = x * radial + 2.0 * x * y * k[2] + k[3] * (r2 + 2.0 * x * x)
        bent_y = y * radial + 2.0 * x * y * k[3] + k[2] * (r2 + 2.0 * y * y)
        return bent_x, bent_y
    if model == 2:
        r = np.sqrt(x * x + y * y)
        if r > 1e-8:
            theta = np.arctan(r)
            s = theta * theta
            scale = theta * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))) / r
            return x * scale, y * scale
    return x, y


@njit(cache=True, nogil=True)
def _snap(at):
    """Round a lattice coordinate to whole units of 1/256."""
    return np.int64(np.floor(at * 256.0 + 0.5))


@njit(cache=True, nogil=True)
def _shade(first_face, normals, albedo, T_C_P, light, ambient, words):
    """Give each face its sample word: one object sample of its Lambert luminance."""
    for part in range(T_C_P.shape[0]):
        T = T_C_P[part]
        for f in range(first_face[part], first_face[part + 1]):
            x, y, z = normals[f, 0], normals[f, 1], normals[f, 2]
            nx = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z
            ny = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z
            nz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            lit = max((nx * light[0] + ny * light[1] + nz * light[2]) / length, 0.0)
            luminance = min(max(albedo[f] * (ambient + (1.0 - ambient) * lit), 0.0), 1.0)
            words[f] = (np.int64(1) << COUNT_BIT) | np.int64(luminance * FULL_CODE + 0.5)


DEPTH_BITS = 29  # of a key, above the word's 32: finer than the 24 of a depth buffer


@njit(cache=True, nogil=True)
def _paint_crops(
    vertices, first_vertex, faces, normals, albedo, first_face, T_C_P, visible,
    intrinsics, model, coeffs, lattice, centre, origins, block_px, tile_size,
    light, ambient, runs, n_samples, x0_px, y0_px, background, luminance,
):  # fmt: skip
    """Draw n instants into `luminance` (n, height, width), each in blocks of pixels."""
    n_vertices = vertices.shape[0]
    height_px, width_px = luminance.shape[1:]
    width, height = tile_size
    keys = np.zeros(height * width + LANES, np.int64)
    touched = np.empty((height, 2), np.int64)  # of each row, first and last sample drawn
    touched[:, 0], touched[:, 1] = width, -1
    # The last sum takes the samples of the tile that belong to no pixel of the block.
    sums = np.zeros(block_px[0] * block_px[1] + 1, np.int64)
    inverse_z = np.empty(n_vertices)
    snapped = np.empty((n_vertices, 2), np.int64)
    words = np.empty(faces.shape[0], np.int64)
    run_of, run_start, run_pixel = runs
    for k in range(luminance.shape[0]):
        x0, y0 = x0_px[k], y0_px[k]
        behind = background[y0 : y0 + height_px, x0 : x0 + width_px]
        if not visible[k]:
            luminance[k] = behind
            continue
        shift_u = centre[0] - origins[k, 0]
        shift_v = centre[1] - origins[k, 1]
        nearest, farthest = _place(
            vertices, first_vertex, T_C_P[k], intrinsics, model, coeffs, lattice,
            shift_u, shift_v, inverse_z, snapped,
        )  # fmt: skip
        scale = float(1 << DEPTH_BITS) / (nearest - farthest)
        _shade(first_face, normals, albedo, T_C_P[k], light, ambient, words)
        for by in range(0, height_px, block_px[1]):
            for bx in range(0, width_px, block_px[0]):
                block_u = lattice[0] * bx - lattice[1] * by
                block_v = lattice[1] * bx + lattice[0] * by
                _fill_all(
                    keys, touched, width, height, faces, snapped, inverse_z, words,
                    256 * block_u, 256 * block_v, farthest, scale,
                )  # fmt: skip
                sum_runs(keys, touched, width, height, run_of, run_start, run_pixel, sums)
                average_block(
                    sums, block_px[0], n_samples,
                    behind[by : by + block_px[1], bx : bx + block_px[0]],
                    luminance[k, by : by + block_px[1], bx : bx + block_px[0]],
                )  # fmt: skip


@njit(cache=True, nogil=True)
def _fill_all(
    keys, touched, width, height, faces, snapped, inverse_z, words, block_u, block_v,
    farthest, scale,
):  # fmt: skip
    """Draw the triangles that face the viewer into one block."""
    for f in range(faces.shape[0]):
        i0, i1, i2 = np.uint64(faces[f, 0]), np.uint64(faces[f, 1]), np.uint64(faces[f, 2])
        x0, y0 = snapped[i0, 0] - block_u, snapped[i0, 1] - block_v
        x1, y1 = snapped[i1, 0] - block_u, snapped[i1, 1] - block_v
        x2, y2 = snapped[i2, 0] - block_u, snapped[i2, 1] - block_v
        # Outward faces are counter-clockwise to the viewer: negative, as y points down.
        if (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0) >= 0:
            continue
        d0 = (inverse_z[i0] - farthest) * scale
        d1 = (inverse_z[i1] - farthest) * scale
        d2 = (inverse_z[i2] - farthest) * scale
        _fill(keys, touched, width, height, x0, y0, x1, y1, x2, y2, d0, d1, d2, words[f])


@njit(cache=True, nogil=True)
def _column(xa, ya, xb, yb, v):
    """Return the last column left of an edge, in row v, which the edge reaches."""
    # A sample on the edge belongs to the triangle on the edge's right.
    dx, dy = xb - xa, yb - ya
    return (xa * dy + (256 * v - ya) * dx - 1) // (256 * dy)


@njit(cache=True, nogil=True)
def _fill(keys, touched, width, height, x0, y0, x1, y1, x2, y2, d0, d1, d2, word):
    """Draw one triangle that faces the viewer: corners [1/256 sample], depths in key units."""
    lowest = max(y0, y1, y2)
    first = max((min(y0, y1, y2) + 255) >> 8, 0)
    last = min(lowest >> 8, height - 1)
    if max(x0, x1, x2) < 0 or min(x0, x1, x2) > 256 * (width - 1):
        last = np.int64(-1)
    # The top corner (t), and the corners next to it along the outline: right (r) and left (l).
    if y0 <= y1 and y0 <= y2:
        xt, yt, xr, yr, xl, yl = x0, y0, x2, y2, x1, y1
    elif y1 <= y2:
        xt, yt, xr, yr, xl, yl = x1, y1, x0, y0, x2, y2
    else:
        xt, yt, xr, yr, xl, yl = x2, y2, x1, y1, x0, y0
    if yr == yl:  # a row through a level edge is inside where the edge is at the top
        last = min(last, (yr - 1) >> 8)
    if first > last:
        return
    area = float((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0))
    du = ((d1 - d0) * (y2 - y0) - (d2 - d0) * (y1 - y0)) / area
    dv = ((d2 - d0) * (x1 - x0) - (d1 - d0) * (x2 - x0)) / area
    key_step = np.int64(np.rint(256.0 * du)) << 32
    for v in range(first, last + 1):
        if 256 * v < min(yr, yl):
            low, high = _column(xt, yt, xl, yl, v) + 1, _column(xt, yt, xr, yr, v)
        elif yl > yr:
            low, high = _column(xt, yt, xl, yl, v) + 1, _column(xr, yr, xl, yl, v)
        else:
            low, high = _column(xl, yl, xr, yr, v) + 1, _column(xt, yt, xr, yr, v)
        low, high = max(low, np.int64(0)), min(high, width - 1)
        if low <= high:
            here = d0 + du * (256 * low - x0) + dv * (256 * v - y0)
            key = (np.int64(here) << 32) | word
            n = high - low + 1
            start = v * width + low
            # The count is rounded up to whole LANES, which the processor does at a time.
            for lane in range((n + (LANES - 1)) & -LANES):
                at = np.uint64(start + lane)
                keys[at] = max(keys[at], key if lane < n else np.int64(0))
                key += key_step
            row = np.uint64(v)
            touched[row, 0] = min(touched[row, 0], low)
            touched[row, 1] = max(touched[row, 1], high)
