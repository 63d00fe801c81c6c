"""A body of balls that turns before cameras round it: its one point, beside where that is drawn."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.track.body import Look, body_moves

FOCAL_PX, DISTANCE_M, WIDTH = 200.0, 5.0, 45
ANGLES_DEG = (0.0, 60.0, 120.0, 180.0)
TIMES_S = np.arange(0.0, 4.0, 0.1)
FINE = 4  # samples across a pixel

BODY_M = np.array([
    [0.30, 0.22, 0.0, 0.06], [0.30, -0.22, 0.0, 0.06], [-0.30, 0.22, 0.0, 0.06],
    [-0.30, -0.22, 0.0, 0.06], [0.0, 0.0, 0.03, 0.09], [0.12, 0.0, 0.03, 0.06],
    [0.15, 0.11, 0.0, 0.04], [0.15, -0.11, 0.0, 0.04], [-0.15, 0.11, 0.0, 0.04],
    [-0.15, -0.11, 0.0, 0.04],
])  # fmt: skip
"""Balls: centre and radius. Those in the middle are above the arms, as of a drone."""

BALL_M = np.array([[0.0, 0.0, 0.0, 0.25]])


def attitudes(turning_deg_s: float) -> Rotation:
    """Tilts that come and go, and a slow turn about the upright."""
    tilt_deg = 15.0 * np.stack([np.sin(1.3 * TIMES_S), np.cos(0.9 * TIMES_S)], axis=1)
    yaw_deg = 20.0 + turning_deg_s * TIMES_S
    # y is down in the frame of the first camera.
    upright = Rotation.from_euler("x", 90.0, degrees=True)
    turns = np.column_stack([yaw_deg, tilt_deg])
    return upright * Rotation.from_euler("ZYX", turns, degrees=True)


@cache
def drawn(shape: str) -> tuple[list[Look], np.ndarray, list[np.ndarray]]:
    """What cameras see of it; its second moments; the centres of area less the origin's images."""
    balls = BODY_M if shape == "body" else BALL_M
    turns = attitudes(25.0)
    local = (np.arange(WIDTH * FINE) + 0.5) / FINE - 0.5
    u, v = np.meshgrid(local, local)
    looks, shifts = [], []
    for angle_deg in ANGLES_DEG:
        R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
        point = np.array([0.3, -0.2, DISTANCE_M])
        there = FOCAL_PX * point[:2] / point[2]
        corner = np.rint(there) - WIDTH // 2
        shares = np.zeros((len(TIMES_S), WIDTH, WIDTH), np.float32)
        off = np.zeros((len(TIMES_S), 2))
        rays = np.stack([(u + corner[0]) / FOCAL_PX, (v + corner[1]) / FOCAL_PX, 0 * u + 1], -1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        for i, turn in enumerate(turns):
            centres = turn.apply(balls[:, :3]) @ R.T + point
            covered = np.zeros(u.shape, np.bool_)
            for centre, radius in zip(centres, balls[:, 3], strict=True):
                covered |= centre @ centre - (rays @ centre) ** 2 < radius**2
            shares[i] = covered.reshape(WIDTH, FINE, WIDTH, FINE).mean(axis=(1, 3))
            off[i] = np.array([u[covered].mean(), v[covered].mean()]) + corner - there
        points, corners = np.tile(point, (len(TIMES_S), 1)), np.tile(corner, (len(TIMES_S), 1))
        looks.append(Look(TIMES_S, R, np.full(2, FOCAL_PX), points, shares, corners))
        shifts.append(off)
    weights = balls[:, 3] ** 2
    flat = (balls[:, :3] * weights[:, None]).T @ balls[:, :3] / weights.sum()
    flat += np.eye(3) * 0.2 * np.sum(weights * balls[:, 3] ** 2) / weights.sum()
    axes = turns.as_matrix()
    return looks, axes @ flat @ axes.transpose(0, 2, 1), shifts


@cache
def found(shape: str) -> list[np.ndarray]:
    looks, moments, _ = drawn(shape)
    moves = body_moves(looks, TIMES_S, moments)
    assert moves is not None
    return moves


def swayed_px(moves: list[np.ndarray]) -> float:
    """Rms of what is not the same at all times."""
    return float(np.sqrt(np.mean([np.nanvar(move, axis=0) for move in moves])))


def test_one_point_is_followed_where_the_centre_of_area_strays() -> None:
    _, _, shifts = drawn("body")
    # A point of the body need not be the origin: one fixed in it has a lever, which sways as the
    # body turns, by less than the centre does; what is left of the shape is some 0.02 px.
    assert np.isfinite(np.concatenate(found("body"))).mean() > 0.8
    assert swayed_px(found("body")) < 0.5 * swayed_px(shifts)


def test_a_ball_needs_no_correction() -> None:
    # Which way a ball is turned no image tells, and none needs to. Voxels 0.4 px apart are no ball:
    # what is left of them is some 0.05 px, as the axes of its moments take any direction.
    assert np.sqrt(np.nanmean(np.square(found("ball")))) < 0.1


def test_a_turned_frame_and_other_numbers_of_cameras_change_nothing() -> None:
    looks, moments, _ = drawn("body")
    G = Rotation.from_rotvec([0.4, -0.8, 0.3]).as_matrix()
    order = [2, 0, 3, 1]
    moved = [
        Look(look.times_s, look.R @ G.T, look.focal_px, look.points, look.shares, look.corners_px)
        for look in (looks[k] for k in order)
    ]
    moves = body_moves(moved, TIMES_S, G @ moments @ G.T)
    assert moves is not None
    for k, move in zip(order, moves, strict=True):
        # Sums are in another order, and axes may point the other way: voxels are then others.
        assert np.nanmax(np.abs(move - found("body")[k])) < 0.05


def test_images_of_no_rigid_body_are_refused() -> None:
    looks, moments, _ = drawn("body")
    rng = np.random.default_rng(1)
    torn = [
        Look(
            look.times_s, look.R, look.focal_px, look.points,
            look.shares[rng.permutation(len(look.shares))], look.corners_px,
        )
        for look in looks
    ]  # fmt: skip
    assert body_moves(torn, TIMES_S, moments) is None


@pytest.mark.parametrize("n", [0, 20])
def test_too_few_instants_are_left_alone(n: int) -> None:
    looks, moments, _ = drawn("body")
    unknown = moments.copy()
    unknown[n:] = np.nan
    assert body_moves(looks, TIMES_S, unknown) is None
