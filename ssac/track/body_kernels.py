"""A body of voxels: how it is drawn, fitted to images, and turned until it is drawn as they are.

A voxel darkens the pixels it is before; what shines through all of them is not covered. Optical
depths are summed on pixels of half the size, shares are their means.
"""

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Images = NDArray[np.float32]
Voxels = tuple[Array, Array, float]
"""Voxels (m, 3) in the body's frame, their optical depths (m,) and their width."""

Drawn = tuple[Images, Array, Array, Array, Array]
"""Of n images: the share of each pixel that is covered (n, w, w), where their first pixels are from
the principal point (n, 2) [px], the body's origin in the cameras' frames (n, 3), its axes there, or
what turns the axes' frame to the cameras' (n, 3, 3), and focal lengths (n, 2) [px]."""

View = tuple[Array, Array, Array, Array]
"""Of one image the same but for the image itself, and the body's axes first: as a camera has it."""

FINE = 2
"""Pixels of a drawing across one of the image."""

_NONE = 1e-9


@numba.njit(cache=True)
def seen_shares(voxels: Array, least: float, drawn: Drawn) -> Array:
    """Give the share (m,) of the images that are at least that much covered at each voxel."""
    images, corners, points, turns, focals = drawn
    hits = np.zeros(len(voxels))
    width = images.shape[1]
    for i in range(len(images)):
        view = turns[i], points[i], focals[i], corners[i]
        for j in range(len(voxels)):
            b, a, q, p, _ = _placed(voxels[j], view, 1, width)
            if b < 0:
                continue
            above = images[i, b, a] * (1.0 - p) + images[i, b, a + 1] * p
            below = images[i, b + 1, a] * (1.0 - p) + images[i, b + 1, a + 1] * p
            hits[j] += above * (1.0 - q) + below * q >= least
    return hits / max(len(images), 1)


@numba.njit(cache=True)
def improved(body: Voxels, drawn: Drawn) -> Array:
    """Fit the voxels' densities (m,) to images by one multiplicative step of least squares."""
    voxels, densities, _ = body
    images, corners, points, turns, focals = drawn
    m, width = len(voxels), images.shape[1]
    fine = FINE * width
    depths, by_image, by_drawn = np.zeros((3, fine, fine))
    seen, shown = np.full(m, _NONE), np.full(m, _NONE)
    for i in range(len(images)):
        view = turns[i], points[i], focals[i], corners[i]
        _draw(depths, body, view)
        for y in range(width):
            for x in range(width):
                share = _share_of(depths, y, x)
                for row in range(FINE * y, FINE * y + FINE):
                    for col in range(FINE * x, FINE * x + FINE):
                        through = np.exp(-depths[row, col])
                        by_image[row, col] = through * images[i, y, x]
                        by_drawn[row, col] = through * share
        for j in range(m):
            b, a, q, p, _ = _placed(voxels[j], view, FINE, fine)
            if b < 0:
                continue
            for row, col, weight in (
                (b, a, (1.0 - p) * (1.0 - q)),
                (b, a + 1, p * (1.0 - q)),
                (b + 1, a, (1.0 - p) * q),
                (b + 1, a + 1, p * q),
            ):
                seen[j] += weight * by_image[row, col]
                shown[j] += weight * by_drawn[row, col]
    return np.asarray(densities * seen / shown)


@numba.njit(cache=True)
def registered(
    body: Voxels, drawn: Drawn, attitude: Array, turning: bool, rounds: int
) -> tuple[Array, Array, float]:
    """Turn the body, and move each of its drawings, until they are as c images of one instant.

    By rounds of least squares from an attitude (3, 3) on, its axes in the frame that `drawn` turns
    to the cameras'; without turning, drawings are only moved. Gives the attitude; how far the
    drawings were moved (c, 2) [px]; which share of the images was left, as squares, before the last
    round's step.
    """
    images, corners, points, views, focals = drawn
    turn_rad, move_px = 0.02, 0.1  # steps of the derivatives
    most_turn_rad, most_move_px = 0.15, 1.0  # of one round
    c, width = len(images), images.shape[1]
    moves, cost, whole = np.zeros((c, 2)), 0.0, _NONE
    depths = np.zeros((FINE * width, FINE * width))
    shares = np.zeros((6, width, width))
    for _ in range(rounds):
        cost, whole = 0.0, _NONE
        normal, right = np.eye(3), np.zeros(3)  # a prior: 1 rad as 1 px^2 of an image
        own = np.zeros((c, 2, 2))
        mixed = np.zeros((c, 2, 3))
        left = np.zeros((c, 2))
        for k in range(c):
            corner = corners[k] - moves[k]
            for changed in range(6):
                if 1 <= changed <= 3 and not turning:
                    continue
                axes, off = attitude, corner.copy()
                if 1 <= changed <= 3:
                    small = np.zeros(3)
                    small[changed - 1] = turn_rad
                    axes = attitude @ _turned(small)
                elif changed:
                    off[changed - 4] -= move_px
                _draw(depths, body, (views[k] @ axes, points[k], focals[k], off))
                for y in range(width):
                    for x in range(width):
                        shares[changed, y, x] = _share_of(depths, y, x)
            by = np.zeros(5)
            J, r = np.zeros((5, 5)), np.zeros(5)
            for y in range(width):
                for x in range(width):
                    share = shares[0, y, x]
                    off_share = images[k, y, x] - share
                    cost += off_share**2
                    whole += images[k, y, x] ** 2
                    if share == 0.0:
                        continue
                    for a in range(3):
                        by[a] = (shares[a + 1, y, x] - share) / turn_rad if turning else 0.0
                    for a in range(2):
                        by[3 + a] = (shares[a + 4, y, x] - share) / move_px
                    for a in range(5):
                        r[a] += by[a] * off_share
                        for b in range(5):
                            J[a, b] += by[a] * by[b]
            own[k] = np.linalg.inv(J[3:, 3:] + 1e-6 * np.eye(2))
            mixed[k] = J[3:, :3]
            left[k] = r[3:]
            normal += J[:3, :3] - mixed[k].T @ own[k] @ mixed[k]
            right += r[:3] - mixed[k].T @ own[k] @ left[k]
        turn = np.linalg.solve(normal, right) if turning else np.zeros(3)
        turn *= min(1.0, most_turn_rad / (np.sqrt(np.sum(turn**2)) + _NONE))
        for k in range(c):
            move = own[k] @ (left[k] - mixed[k] @ turn)
            moves[k] += move * min(1.0, most_move_px / (np.sqrt(np.sum(move**2)) + _NONE))
        attitude = attitude @ _turned(turn)
    return attitude, moves, cost / whole


@numba.njit(cache=True)
def aligned(body: Voxels, drawn: Drawn, rounds: int) -> tuple[Array, Array]:
    """Move each of n drawings until it is as its image: by (n, 2) [px], and what is left (n,)."""
    images, corners, points, turns, focals = drawn
    n = len(images)
    moves, costs = np.zeros((n, 2)), np.zeros(n)
    view = np.eye(3).reshape(1, 3, 3)
    for i in range(n):
        k = slice(i, i + 1)
        one = images[k], corners[k], points[k], view, focals[k]
        _, move, costs[i] = registered(body, one, turns[i], False, rounds)
        moves[i] = move[0]
    return moves, costs


@numba.njit(cache=True)
def _placed(
    voxel: Array, view: View, scale: int, width: int
) -> tuple[int, int, float, float, float]:
    """Give the pixel up and left of a voxel's image, how far down and right of it, and the depth.

    The image has `scale` times as many pixels as the camera's, so many across; row -1: outside.
    """
    turn, point, focal, corner = view
    x = turn[0, 0] * voxel[0] + turn[0, 1] * voxel[1] + turn[0, 2] * voxel[2] + point[0]
    y = turn[1, 0] * voxel[0] + turn[1, 1] * voxel[1] + turn[1, 2] * voxel[2] + point[1]
    z = turn[2, 0] * voxel[0] + turn[2, 1] * voxel[1] + turn[2, 2] * voxel[2] + point[2]
    z = max(z, _NONE)
    u = scale * (focal[0] * x / z - corner[0]) + 0.5 * (scale - 1)
    v = scale * (focal[1] * y / z - corner[1]) + 0.5 * (scale - 1)
    column, row = int(np.floor(u)), int(np.floor(v))
    is_in = 0 <= column < width - 1 and 0 <= row < width - 1
    return row if is_in else -1, column, v - row, u - column, z


@numba.njit(cache=True)
def _draw(depths: Array, body: Voxels, view: View) -> None:
    """Sum up optical depths (FINE w, FINE w), in place."""
    voxels, densities, step = body
    depths[:] = 0.0
    area = (FINE * step) ** 2 * view[2][0] * view[2][1]
    for j in range(len(voxels)):
        b, a, q, p, z = _placed(voxels[j], view, FINE, len(depths))
        if b < 0:
            continue
        depth = densities[j] * area / z**2
        depths[b, a] += depth * (1.0 - p) * (1.0 - q)
        depths[b, a + 1] += depth * p * (1.0 - q)
        depths[b + 1, a] += depth * (1.0 - p) * q
        depths[b + 1, a + 1] += depth * p * q


@numba.njit(cache=True)
def _share_of(depths: Array, y: int, x: int) -> float:
    """Give which share of a pixel is covered."""
    share = 0.0
    for row in range(FINE * y, FINE * y + FINE):
        for col in range(FINE * x, FINE * x + FINE):
            if depths[row, col] > 0.0:
                share += 1.0 - np.exp(-depths[row, col])
    return share / FINE**2


@numba.njit(cache=True)
def _turned(vector: Array) -> Array:
    """Give the turn by a rotation vector."""
    angle = np.sqrt(np.sum(vector**2))
    x, y, z = vector / max(angle, _NONE)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))
