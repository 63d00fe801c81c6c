"""A mesh and its pose in, its corners on the sample lattice and its faces' light out, compiled."""

import numpy as np
from numba import njit

from sim.render.lattice import FULL_CODE, WORD_COUNT_BIT
from sim.scene.camera import MIN_DEPTH_M

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
            words[f] = (np.int64(1) << WORD_COUNT_BIT) | np.int64(luminance * FULL_CODE + 0.5)


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
