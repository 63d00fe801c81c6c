"""The rasteriser in compiled Python: triangles, point-sampled on the lattice.

It follows OpenGL's rules on the same grid as the shaders in `sim/render/shaders`: corners are
rounded to 1/256 of a sample, edge functions are whole numbers, a sample on an edge belongs to the
triangle that has the edge on its left or at its top, and 1/z is linear across a triangle. So it
covers the samples that an OpenGL driver covers, but for a few where the driver's single precision
rounds a corner the other way.

Depth and sample word share one 64-bit key, depth above: the nearest triangle has the largest key.
"""

import numpy as np
from numba import njit

from sim.render.lattice import COUNT_BIT, FULL_CODE, LANES, average_block, sum_runs
from sim.scene.rig import MIN_DEPTH_M

# Corners further out than this [1/256 sample] would overflow the products of the edge functions,
# which are three times its square at most. Triangles that reach beyond it are cut first.
GUARD = 1 << 29


@njit(cache=True, nogil=True)
def place(  # type: ignore[no-untyped-def]
    vertices, first_vertex, T_C_P, intrinsics, model, coeffs, lattice, shift_u, shift_v,
    placed, snapped,
):  # fmt: skip
    """Place vertices in the camera, `placed` (V, 4): x, y, z [m], 1/z; and on the lattice.

    Returns bounds of 1/z, and whether every triangle can be drawn as it is.
    """
    nearest, farthest, whole = 0.0, np.inf, True
    reach = GUARD / 256.0
    for part in range(T_C_P.shape[0]):
        T = T_C_P[part]
        for i in range(first_vertex[part], first_vertex[part + 1]):
            px, py, pz = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
            y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
            z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
            inverse = 1.0 / max(z, MIN_DEPTH_M)
            placed[i, 0], placed[i, 1], placed[i, 2], placed[i, 3] = x, y, z, inverse
            nearest, farthest = max(nearest, inverse), min(farthest, inverse)
            if z < MIN_DEPTH_M:
                whole = False
                continue
            u, v = on_lattice(
                x, y, inverse, intrinsics, model, coeffs, lattice, shift_u, shift_v
            )  # fmt: skip
            if not (abs(u) < reach and abs(v) < reach):
                whole = False
                continue
            snapped[i, 0], snapped[i, 1] = snap(u), snap(v)
    # Room at both ends, so that rounding leaves every depth within a key's bits, and above 0.
    return 1.05 * nearest, 0.95 * farthest, whole


@njit(cache=True, nogil=True)
def on_lattice(  # type: ignore[no-untyped-def]
    x, y, inverse_z, intrinsics, model, coeffs, lattice, shift_u, shift_v
):
    """Return the lattice coordinates of a point's image, from the tile's first sample."""
    dx, dy = _distort(x * inverse_z, y * inverse_z, model, coeffs)
    u = intrinsics[0] * dx + intrinsics[2]
    v = intrinsics[1] * dy + intrinsics[3]
    return lattice[0] * u - lattice[1] * v + shift_u, lattice[1] * u + lattice[0] * v + shift_v


@njit(cache=True, nogil=True)
def _distort(x, y, model, k):  # type: ignore[no-untyped-def]
    """Bend a ray's slopes as the lens does: 0 none, 1 radtan, 2 equidistant."""
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
def snap(at):  # type: ignore[no-untyped-def]
    """Round a lattice coordinate to 1/256."""
    return np.int64(np.floor(at * 256.0 + 0.5))


@njit(cache=True, nogil=True)
def shade(  # type: ignore[no-untyped-def]
    first_face, normals, albedo, T_C_P, light, ambient, words
):
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


@njit(cache=True, nogil=True)
def facing(faces, snapped, front):  # type: ignore[no-untyped-def]
    """Find the triangles that face the viewer; returns how many there are."""
    n = 0
    for f in range(faces.shape[0]):
        i0, i1, i2 = np.uint64(faces[f, 0]), np.uint64(faces[f, 1]), np.uint64(faces[f, 2])
        x0, y0 = snapped[i0, 0], snapped[i0, 1]
        ax, ay = snapped[i1, 0] - x0, snapped[i1, 1] - y0
        bx, by = snapped[i2, 0] - x0, snapped[i2, 1] - y0
        front[n] = f
        # Outward faces are counter-clockwise to the viewer: negative, as y points down.
        n += int(ax * by - bx * ay < 0)
    return n


DEPTH_BITS = 29  # of a key, above the word's 32: finer than the 24 of a depth buffer
FRACTION_BITS = 36  # of an edge's column
# Triangles of at least this height [1/256 sample], times twice their rows, or with corners this far
# out [1/256 sample], have their edges' columns found anew in each row: rounding would show.
ROUNDED = 1 << (FRACTION_BITS - 8)
LARGE = 1 << 20
MAX_CUT = 9  # corners of a triangle after one near plane and four borders


@njit(cache=True, nogil=True)
def paint_crops(  # type: ignore[no-untyped-def]
    vertices, first_vertex, faces, normals, albedo, first_face, T_C_P, visible,
    intrinsics, model, coeffs, lattice, centre, origins, block_px, tile_size,
    light, ambient, runs, n_samples, x0_px, y0_px, background, luminance,
):  # fmt: skip
    """Draw n instants, one crop each; `luminance` (n, height, width) takes them.

    A crop is drawn in blocks of pixels, whose samples stay in the processor's cache.
    """
    n_vertices = vertices.shape[0]
    height_px, width_px = luminance.shape[1:]
    width, height = tile_size
    keys = np.zeros(height * width + LANES, np.int64)
    touched = np.empty((height, 2), np.int64)  # of each row, first and last sample drawn
    touched[:, 0], touched[:, 1] = width, -1
    # One more takes the samples of the tile that belong to no pixel of the block.
    sums = np.zeros(block_px[0] * block_px[1] + 1, np.int64)
    placed = np.empty((n_vertices, 4))
    snapped = np.empty((n_vertices, 2), np.int64)
    words = np.empty(faces.shape[0], np.int64)
    scratch = np.empty((2, MAX_CUT, 4))
    front = np.empty(faces.shape[0], np.int64)
    run_of, run_start, run_pixel = runs
    for k in range(luminance.shape[0]):
        x0, y0 = x0_px[k], y0_px[k]
        behind = background[y0 : y0 + height_px, x0 : x0 + width_px]
        if not visible[k]:
            luminance[k] = behind
            continue
        shift_u = centre[0] - origins[k, 0]
        shift_v = centre[1] - origins[k, 1]
        nearest, farthest, whole = place(
            vertices, first_vertex, T_C_P[k], intrinsics, model, coeffs, lattice,
            shift_u, shift_v, placed, snapped,
        )  # fmt: skip
        scale = float(1 << DEPTH_BITS) / (nearest - farthest)
        shade(first_face, normals, albedo, T_C_P[k], light, ambient, words)
        n_front = facing(faces, snapped, front) if whole else 0
        for by in range(0, height_px, block_px[1]):
            for bx in range(0, width_px, block_px[0]):
                block_u = lattice[0] * bx - lattice[1] * by
                block_v = lattice[1] * bx + lattice[0] * by
                if whole:
                    _fill_all(
                        keys, touched, width, height, faces, front, n_front, snapped, placed, words,
                        256 * block_u, 256 * block_v, farthest, scale,
                    )  # fmt: skip
                else:
                    for f in range(faces.shape[0]):
                        _fill_cut(
                            keys, touched, width, height, placed, faces[f], intrinsics, model,
                            coeffs, lattice, shift_u - block_u, shift_v - block_v, farthest, scale,
                            words[f], scratch,
                        )  # fmt: skip
                sum_runs(keys, touched, width, height, run_of, run_start, run_pixel, sums)
                average_block(
                    sums, block_px[0], n_samples,
                    behind[by : by + block_px[1], bx : bx + block_px[0]],
                    luminance[k, by : by + block_px[1], bx : bx + block_px[0]],
                )  # fmt: skip


@njit(cache=True, nogil=True)
def _fill_all(  # type: ignore[no-untyped-def]
    keys, touched, width, height, faces, front, n_front, snapped, placed, words, block_u, block_v,
    farthest, scale,
):  # fmt: skip
    """Draw the triangles that face the viewer, none of which needs to be cut."""
    for k in range(n_front):
        f = np.uint64(front[k])
        i0, i1, i2 = np.uint64(faces[f, 0]), np.uint64(faces[f, 1]), np.uint64(faces[f, 2])
        x0, y0 = snapped[i0, 0] - block_u, snapped[i0, 1] - block_v
        x1, y1 = snapped[i1, 0] - block_u, snapped[i1, 1] - block_v
        x2, y2 = snapped[i2, 0] - block_u, snapped[i2, 1] - block_v
        d0 = (placed[i0, 3] - farthest) * scale
        d1 = (placed[i1, 3] - farthest) * scale
        d2 = (placed[i2, 3] - farthest) * scale
        _fill(keys, touched, width, height, x0, y0, x1, y1, x2, y2, d0, d1, d2, words[f])


@njit(cache=True, nogil=True)
def _column(xa, ya, xb, yb, v):  # type: ignore[no-untyped-def]
    """Return the last column left of an edge, in row v, which the edge reaches."""
    # A sample on the edge belongs to the triangle on the edge's right.
    dx, dy = xb - xa, yb - ya
    return (xa * dy + (256 * v - ya) * dx - 1) // (256 * dy)


@njit(cache=True, nogil=True)
def _start(xa, ya, xb, yb, v, room):  # type: ignore[no-untyped-def]
    """Return `_column` of row v, and its step from row to row, both times 2^FRACTION_BITS."""
    # They are rounded. `room` is more than the error that all rows add up to, so no column falls
    # below its true value, and twice the room does not reach the next whole column.
    per_dy = 1.0 / float(yb - ya)
    slope = float(xb - xa) * per_dy
    unit = float(1 << (FRACTION_BITS - 8))
    column = (float(xa) + float(256 * v - ya) * slope - per_dy) * unit
    return np.int64(column) + room, np.int64(slope * (256.0 * unit))


@njit(cache=True, nogil=True)
def _fill(  # type: ignore[no-untyped-def]
    keys, touched, width, height, x0, y0, x1, y1, x2, y2, d0, d1, d2, word
):
    """Draw one triangle that faces the viewer: corners [1/256 sample], depths in key units."""
    lowest = max(y0, y1, y2)
    first = max((min(y0, y1, y2) + 255) >> 8, 0)
    last = min(lowest >> 8, height - 1)
    if max(x0, x1, x2) < 0 or min(x0, x1, x2) > 256 * (width - 1):
        last = np.int64(-1)
    # From the top corner on: the next along the outline on the right, and on the left.
    if y0 <= y1 and y0 <= y2:
        xt, yt, xr, yr, xl, yl = x0, y0, x2, y2, x1, y1
    elif y1 <= y2:
        xt, yt, xr, yr, xl, yl = x1, y1, x0, y0, x2, y2
    else:
        xt, yt, xr, yr, xl, yl = x2, y2, x1, y1, x0, y0
    if yr == yl:  # a row through a level edge is inside where the edge is at the top
        last = min(last, (yr - 1) >> 8)
    if first <= last:
        area = float((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0))
        du = ((d1 - d0) * (y2 - y0) - (d2 - d0) * (y1 - y0)) / area
        dv = ((d2 - d0) * (x1 - x0) - (d1 - d0) * (x2 - x0)) / area
        key_step = np.int64(np.rint(256.0 * du)) << 32
        room = np.int64(last - first + 4)
        is_large = (lowest - yt) * 2 * room >= ROUNDED or max(abs(x0), abs(x1), abs(x2)) >= LARGE
        # The first row below the corner in the middle, where one side goes on as another edge.
        middle = min(max((min(yr, yl) + 255) >> 8, first), last + 1)
        left, left_step = np.int64(0), np.int64(0)
        right, right_step = np.int64(0), np.int64(0)
        if yl > yr or middle > first:
            left, left_step = _start(xt, yt, xl, yl, first, room)
        if yl <= yr or middle > first:
            right, right_step = _start(xt, yt, xr, yr, first, room)
        later, later_step = np.int64(0), np.int64(0)
        if middle <= last:
            if yl > yr:
                later, later_step = _start(xr, yr, xl, yl, middle, room)
            else:
                later, later_step = _start(xl, yl, xr, yr, middle, room)
        for v in range(first, last + 1):
            if v == middle:
                if yl > yr:
                    right, right_step = later, later_step
                else:
                    left, left_step = later, later_step
            low, high = (left >> FRACTION_BITS) + 1, right >> FRACTION_BITS
            left += left_step
            right += right_step
            if is_large:
                if v < middle:
                    low = _column(xt, yt, xl, yl, v) + 1
                    high = _column(xt, yt, xr, yr, v)
                elif yl > yr:
                    low = _column(xt, yt, xl, yl, v) + 1
                    high = _column(xr, yr, xl, yl, v)
                else:
                    low = _column(xl, yl, xr, yr, v) + 1
                    high = _column(xt, yt, xr, yr, v)
            low, high = max(low, np.int64(0)), min(high, width - 1)
            if low <= high:
                here = d0 + du * (256 * low - x0) + dv * (256 * v - y0)
                key = (np.int64(here) << 32) | word
                n = high - low + 1
                start = v * width + low
                # So many that the processor does LANES at a time, and none is left over.
                for lane in range((n + (LANES - 1)) & -LANES):
                    at = np.uint64(start + lane)
                    keys[at] = max(keys[at], key if lane < n else np.int64(0))
                    key += key_step
                row = np.uint64(v)
                touched[row, 0] = min(touched[row, 0], low)
                touched[row, 1] = max(touched[row, 1], high)


@njit(cache=True, nogil=True)
def _cut(corners, n, axis, bound, sign, out):  # type: ignore[no-untyped-def]
    """Keep the part of a polygon with sign * coordinate <= sign * bound (Sutherland & Hodgman)."""
    kept = 0
    for i in range(n):
        here, there = corners[i], corners[(i + 1) % n]
        inside = sign * (bound - here[axis])
        beyond = sign * (bound - there[axis])
        if inside >= 0.0:
            out[kept] = here
            kept += 1
        if (inside >= 0.0) != (beyond >= 0.0):
            share = inside / (inside - beyond)
            out[kept] = here + share * (there - here)
            out[kept, axis] = bound
            kept += 1
    return kept


@njit(cache=True, nogil=True)
def _fill_cut(  # type: ignore[no-untyped-def]
    keys, touched, width, height, placed, face, intrinsics, model, coeffs, lattice,
    shift_u, shift_v, farthest, scale, word, scratch,
):  # fmt: skip
    """Draw a triangle that may reach behind the camera or very far out: cut, then as a fan."""
    a, b = scratch[0], scratch[1]
    for n in range(3):
        a[n] = placed[face[n]]
    n = _cut(a, 3, 2, MIN_DEPTH_M, -1.0, b)
    for k in range(n):
        inverse = 1.0 / b[k, 2]
        u, v = on_lattice(
            b[k, 0], b[k, 1], inverse, intrinsics, model, coeffs, lattice, shift_u, shift_v
        )
        b[k, 0], b[k, 1], b[k, 3] = u, v, (inverse - farthest) * scale
    # Twice the tile is far enough out that rounding the new corners moves nothing within it, and
    # near enough that all products stay small.
    n = _cut(b, n, 0, -2.0 * width, -1.0, a)
    n = _cut(a, n, 0, 3.0 * width, 1.0, b)
    n = _cut(b, n, 1, -2.0 * height, -1.0, a)
    n = _cut(a, n, 1, 3.0 * height, 1.0, b)
    for k in range(2, n):
        x0, y0 = snap(b[0, 0]), snap(b[0, 1])
        x1, y1 = snap(b[k - 1, 0]), snap(b[k - 1, 1])
        x2, y2 = snap(b[k, 0]), snap(b[k, 1])
        if (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0) < 0:
            _fill(
                keys, touched, width, height, x0, y0, x1, y1, x2, y2,
                b[0, 3], b[k - 1, 3], b[k, 3], word,
            )  # fmt: skip
