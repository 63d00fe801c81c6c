"""A body of voxels: how it is drawn, fitted to images, and turned until it is drawn as they are.

A voxel darkens the pixels it is before; what shines through all of them is not covered. Optical
depths are summed on pixels of half the size, shares are their means.
"""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Array, IntArray, Mask

Images = NDArray[np.float32]
Voxels = tuple[Array, Array, float]
"""Voxels (m, 3) in the body's frame, their optical depths (m,) and their width."""

Drawn = tuple[Images, Array, Array, Array, Array]
"""Of n images: the share of each pixel that is covered (n, w, w), where their first pixels are from
the principal point (n, 2) [px], the body's origin in the cameras' frames (n, 3), its axes there, or
what turns the axes' frame to the cameras' (n, 3, 3), and focal lengths (n, 2) [px]."""

Seen = tuple[Images, Array, Array, Mask, Array, Array]
"""What c cameras saw at n instants: shares (n, c, w, w), where their first pixels are (n, c, 2) and
the body's origin is (n, c, 3), which there are (n, c); what turns the axes' frame to the cameras'
(c, 3, 3), and focal lengths (c, 2)."""

View = tuple[Array, Array, Array, Array]
"""Of one image the same but for the image itself, and the body's axes first: as a camera has it."""

FINE = 2
"""Pixels of a drawing across one of the image."""

_NONE = 1e-9
_LEAST_CURVATURE = 1e-6
_MOST_TURN_RAD, _MOST_MOVE_PX = 0.15, 1.0  # of one round


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
        top, bottom, left, right = _draw(depths, body, view)
        for y in range(top, bottom):
            for x in range(left, right):
                share = _share_of(depths, y, x)
                for row in range(FINE * y, FINE * y + FINE):
                    for col in range(FINE * x, FINE * x + FINE):
                        by_image[row, col] = depths[row, col] * images[i, y, x]
                        by_drawn[row, col] = depths[row, col] * share
                        depths[row, col] = 0.0
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
    body: Voxels, seen: Seen, places: IntArray, attitudes: Array, rounds: int
) -> tuple[Array, Array]:
    """Turn the body at m instants, and move each of its drawings, until they are as their images.

    By rounds of least squares from attitudes (m, 3, 3) on, at places (m,) among the instants. Gives
    the attitudes, and which share of the images was left (m,), as squares, before the last step.
    """
    images, corners, points, is_seen, views, focals = seen
    m, c, width = len(places), images.shape[1], images.shape[2]
    found, costs = attitudes.copy(), np.zeros(m)
    work = _work(width)
    for i in range(m):
        at = places[i]
        moves = np.zeros((c, 2))
        for _ in range(rounds):
            cost, whole = 0.0, _NONE
            normal, right = np.eye(3), np.zeros(3)  # a prior: 1 rad as 1 px^2 of an image
            own, mixed, left = np.zeros((c, 2, 2)), np.zeros((c, 2, 3)), np.zeros((c, 2))
            for k in range(c):
                if not is_seen[at, k]:
                    continue
                corner = corners[at, k] - moves[k]
                view = views[k] @ found[i], points[at, k], focals[k], corner
                J, r, squares, all_squares = _normal(work, body, view, images[at, k], 0)
                cost, whole = cost + squares, whole + all_squares
                own[k] = np.linalg.inv(J[3:, 3:] + _LEAST_CURVATURE * np.eye(2))
                mixed[k] = J[3:, :3]
                left[k] = r[3:]
                normal += J[:3, :3] - mixed[k].T @ own[k] @ mixed[k]
                right += r[:3] - mixed[k].T @ own[k] @ left[k]
            turn = _within(np.linalg.solve(normal, right), _MOST_TURN_RAD)
            for k in range(c):
                moves[k] += _within(own[k] @ (left[k] - mixed[k] @ turn), _MOST_MOVE_PX)
            found[i] = found[i] @ _turned(turn)
            costs[i] = cost / whole
    return found, costs


@numba.njit(cache=True)
def aligned(body: Voxels, drawn: Drawn, rounds: int) -> tuple[Array, Array]:
    """Move each of n drawings until it is as its image: by (n, 2) [px], and what is left (n,)."""
    images, corners, points, turns, focals = drawn
    n = len(images)
    moves, costs = np.zeros((n, 2)), np.zeros(n)
    work = _work(images.shape[1])
    for i in range(n):
        for _ in range(rounds):
            view = turns[i], points[i], focals[i], corners[i] - moves[i]
            J, r, squares, all_squares = _normal(work, body, view, images[i], 3)
            step = np.linalg.solve(J[3:, 3:] + _LEAST_CURVATURE * np.eye(2), r[3:])
            moves[i] += _within(step, _MOST_MOVE_PX)
            costs[i] = squares / (all_squares + _NONE)
    return moves, costs


@numba.njit(cache=True)
def _work(width: int) -> tuple[Array, Array]:
    """Give room for depths, and for how they change by three turns and two moves; all zero."""
    fine = FINE * width
    return np.zeros((fine, fine)), np.zeros((fine, fine, 5))


@numba.njit(cache=True)
def _within(step: NDArray[Any], most: float) -> Array:
    """Shorten a step that is too long."""
    return np.asarray(step * min(1.0, most / (np.sqrt(np.sum(step**2)) + _NONE)))


@numba.njit(cache=True)
def _normal(
    work: tuple[Array, Array], body: Voxels, view: View, image: NDArray[np.float32], first: int
) -> tuple[Array, Array, float, float]:
    """Give the normal equations of turns and moves, from `first` on: (5, 5) and (5,).

    Then the squares of what is left of the image, and of all of it. Turns are about the body's
    axes. The room for work is all zero again.
    """
    depths, slopes = work
    top, bottom, left, right = _draw_sloped(depths, slopes, body, view, first)
    by, J, r = np.zeros(5), np.zeros((5, 5)), np.zeros(5)
    whole = 0.0
    for y in range(len(image)):
        for x in range(len(image)):
            whole += image[y, x] ** 2
    cost = whole
    for y in range(top, bottom):
        for x in range(left, right):
            share = 0.0
            by[:] = 0.0
            for row in range(FINE * y, FINE * y + FINE):
                for col in range(FINE * x, FINE * x + FINE):
                    if depths[row, col] > 0.0:
                        through = np.exp(-depths[row, col])
                        share += (1.0 - through) / FINE**2
                        for a in range(first, 5):
                            by[a] += through * slopes[row, col, a] / FINE**2
                        depths[row, col] = 0.0
                        slopes[row, col] = 0.0
            off = image[y, x] - share
            cost += off**2 - image[y, x] ** 2
            if share == 0.0:
                continue
            for a in range(first, 5):
                r[a] += by[a] * off
                for b in range(first, a + 1):
                    J[a, b] += by[a] * by[b]
    for a in range(first, 5):
        for b in range(first, a):
            J[b, a] = J[a, b]
    return J, r, cost, whole


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
def _draw(depths: Array, body: Voxels, view: View) -> tuple[int, int, int, int]:
    """Add optical depths (FINE w, FINE w), in place; give the first and past the last pixels."""
    voxels, densities, step = body
    bounds = _no_bounds(len(depths))
    area = (FINE * step) ** 2 * view[2][0] * view[2][1]
    for j in range(len(voxels)):
        b, a, q, p, z = _placed(voxels[j], view, FINE, len(depths))
        if b < 0:
            continue
        bounds = _widened(bounds, b, a)
        depth = densities[j] * area / z**2
        _add(depths, b, a, q, p, depth)
    return _of_pixels(bounds)


@numba.njit(cache=True)
def _draw_sloped(
    depths: Array, slopes: Array, body: Voxels, view: View, first: int
) -> tuple[int, int, int, int]:
    """Add optical depths and, from `first` on, how they change, as `_draw` does.

    Slopes (FINE w, FINE w, 5) are by turns [rad] about the body's axes and by moves [px].
    """
    voxels, densities, step = body
    turn, focal = view[0], view[2]
    area = (FINE * step) ** 2 * focal[0] * focal[1]
    bounds = _no_bounds(len(depths))
    by_u, by_v = np.zeros(5), np.zeros(5)
    by_u[3], by_v[4] = FINE, FINE
    for j in range(len(voxels)):
        b, a, q, p, z = _placed(voxels[j], view, FINE, len(depths))
        if b < 0:
            continue
        bounds = _widened(bounds, b, a)
        depth = densities[j] * area / z**2
        if first == 0:
            x, y, h = voxels[j]
            # What is there less the origin of the image's rays, over the depth.
            u = ((a + p - 0.5 * (FINE - 1)) / FINE + view[3][0]) / focal[0]
            v = ((b + q - 0.5 * (FINE - 1)) / FINE + view[3][1]) / focal[1]
            for k in range(3):
                # The voxel moves by axis x voxel.
                d0, d1, d2 = 0.0, 0.0, 0.0
                if k == 0:
                    d1, d2 = -h, y
                elif k == 1:
                    d0, d2 = h, -x
                else:
                    d0, d1 = -y, x
                dx = turn[0, 0] * d0 + turn[0, 1] * d1 + turn[0, 2] * d2
                dy = turn[1, 0] * d0 + turn[1, 1] * d1 + turn[1, 2] * d2
                dz = turn[2, 0] * d0 + turn[2, 1] * d1 + turn[2, 2] * d2
                by_u[k] = FINE * focal[0] * (dx - u * dz) / z
                by_v[k] = FINE * focal[1] * (dy - v * dz) / z
        _add(depths, b, a, q, p, depth)
        for k in range(first, 5):
            du, dv = depth * by_u[k], depth * by_v[k]
            slopes[b, a, k] -= du * (1.0 - q) + dv * (1.0 - p)
            slopes[b, a + 1, k] += du * (1.0 - q) - dv * p
            slopes[b + 1, a, k] += dv * (1.0 - p) - du * q
            slopes[b + 1, a + 1, k] += du * q + dv * p
    return _of_pixels(bounds)


@numba.njit(cache=True)
def _add(depths: Array, row: int, col: int, down: float, right: float, depth: float) -> None:
    """Add a depth to the four pixels that a voxel is between, as `_placed` gives its place."""
    depths[row, col] += depth * (1.0 - right) * (1.0 - down)
    depths[row, col + 1] += depth * right * (1.0 - down)
    depths[row + 1, col] += depth * (1.0 - right) * down
    depths[row + 1, col + 1] += depth * right * down


@numba.njit(cache=True)
def _no_bounds(fine: int) -> tuple[int, int, int, int]:
    return fine, 0, fine, 0


@numba.njit(cache=True)
def _widened(bounds: tuple[int, int, int, int], row: int, col: int) -> tuple[int, int, int, int]:
    """Let bounds hold a fine pixel, and the ones right and below."""
    top, bottom, left, right = bounds
    return min(top, row), max(bottom, row + 2), min(left, col), max(right, col + 2)


@numba.njit(cache=True)
def _of_pixels(bounds: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """Give the pixels that hold fine ones."""
    top, bottom, left, right = bounds
    return top // FINE, -(-bottom // FINE), left // FINE, -(-right // FINE)


@numba.njit(cache=True)
def _share_of(depths: Array, y: int, x: int) -> float:
    """Give which share of a pixel is covered; depths become what shines through them, in place."""
    share = 0.0
    for row in range(FINE * y, FINE * y + FINE):
        for col in range(FINE * x, FINE * x + FINE):
            through = 1.0
            if depths[row, col] > 0.0:
                through = np.exp(-depths[row, col])
            depths[row, col] = through
            share += 1.0 - through
    return share / FINE**2


@numba.njit(cache=True)
def _turned(vector: Array) -> Array:
    """Give the turn by a rotation vector."""
    angle = np.sqrt(np.sum(vector**2))
    x, y, z = vector / max(angle, _NONE)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))
