"""A body, and a flat plate, that turn before cameras round them: beside what is drawn of them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.rules import BodyRules
from ssac.track.body import Look, body_moves
from ssac.track.moments import View, perspective_shifts, second_moments
from tests.ssac.balls import BALL_M, BODY_M, attitudes, drawn_at, moments_of

FOCAL_PX, DISTANCE_M, WIDTH = 200.0, 5.0, 45
ANGLES_DEG = (0.0, 60.0, 120.0, 180.0)
TIMES_S = np.arange(0.0, 4.0, 0.05)
RULES = BodyRules()


@cache
def drawn(shape: str) -> tuple[list[Look], np.ndarray, list[np.ndarray]]:
    """What cameras see of it; its second moments; the centres of area less the origin's images."""
    body, turns = BODY_M if shape == "body" else BALL_M, attitudes(TIMES_S, 25.0)
    looks, shifts = [], []
    for angle_deg in ANGLES_DEG:
        view = Rotation.from_euler("y", angle_deg, degrees=True)
        points = np.tile([0.3, -0.2, DISTANCE_M], (len(TIMES_S), 1))
        shares, corners, off, _ = drawn_at(body, view * turns, points, FOCAL_PX, WIDTH)
        focal_px = np.full(2, FOCAL_PX)
        looks.append(Look(TIMES_S, view.as_matrix(), focal_px, points, shares, corners))
        shifts.append(off)
    return looks, moments_of(body, turns), shifts


@cache
def found(shape: str) -> list[np.ndarray]:
    looks, moments, _ = drawn(shape)
    # A ball has many voxels: of twice the width they are an eighth as many.
    rules = RULES if shape == "body" else BodyRules(voxels_across=15.0)
    moves = body_moves(looks, TIMES_S, moments, rules)
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
    # Which way a ball is turned no image tells, and none needs to. Voxels 0.8 px apart are no ball:
    # what is left of them is some 0.05 px, as the axes of its moments take any direction.
    assert np.sqrt(np.nanmean(np.square(found("ball")))) < 0.1


def test_a_turned_frame_and_other_numbers_of_cameras_change_nothing() -> None:
    looks, moments, _ = drawn("body")
    G = Rotation.from_rotvec([0.4, -0.8, 0.3]).as_matrix()
    order = [2, 0, 3, 1]
    moved = [replace(looks[k], R=looks[k].R @ G.T) for k in order]
    moves = body_moves(moved, TIMES_S, G @ moments @ G.T, RULES)
    assert moves is not None
    for k, move in zip(order, moves, strict=True):
        # Sums are in another order, and axes may point the other way: voxels are then others.
        assert np.nanmax(np.abs(move - found("body")[k])) < 0.05


def test_images_of_no_rigid_body_and_too_few_are_refused() -> None:
    looks, moments, _ = drawn("body")
    rng = np.random.default_rng(1)
    torn = [replace(look, shares=look.shares[rng.permutation(len(look.shares))]) for look in looks]
    assert body_moves(torn, TIMES_S, moments, RULES) is None
    for n in (0, 20):
        known = np.where(np.arange(len(moments))[:, None, None] < n, moments, np.nan)
        assert body_moves(looks, TIMES_S, known, RULES) is None


N_TURNS = 25


def plate() -> np.ndarray:
    """Points all over a plate of 0.5 x 0.3 m, whose middle is the origin."""
    u, v = np.meshgrid(np.linspace(-0.25, 0.25, 81), np.linspace(-0.15, 0.15, 49))
    return np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])


def seen_by(angle_deg: float, turns: Rotation, size: float) -> tuple[View, np.ndarray]:
    """A camera's view of the plate as it turns, and true centres less images of its middle."""
    R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    t = np.array([0.4, -0.3, DISTANCE_M])
    spreads, shifts = np.zeros((N_TURNS, 3)), np.zeros((N_TURNS, 2))
    for i, turn in enumerate(turns):
        local = turn.apply(size * plate()) @ R.T + t
        image = FOCAL_PX * local[:, :2] / local[:, 2:]
        weights = local[:, 2] ** -3.0  # of the area that a part of a plane has in an image
        centre = weights @ image / weights.sum()
        off = image - centre
        covariance = (off * weights[:, None]).T @ off / weights.sum()
        spreads[i] = covariance[0, 0], covariance[0, 1], covariance[1, 1]
        shifts[i] = centre - FOCAL_PX * t[:2] / t[2]
    points = np.tile(t, (N_TURNS, 1))
    return View(R, np.full(2, FOCAL_PX), points, spreads), shifts


def slowly_turning() -> Rotation:
    """Turns of 3 deg in all, about a tilted attitude: smoothing leaves them as they are."""
    angles = np.linspace(-1.5, 1.5, N_TURNS)
    return Rotation.from_euler("xyz", np.column_stack([20.0 + angles, 35.0 + angles, angles]), True)


def test_second_moments_are_those_of_the_object() -> None:
    turns, flat = slowly_turning(), 0.01 * np.cov(plate().T, bias=True)
    views = [seen_by(angle_deg, turns, 0.1)[0] for angle_deg in ANGLES_DEG]
    assert np.isnan(second_moments(views[:2], 1.0)).all()  # two views have one in common
    found = second_moments(views, 1.0)
    true = turns.as_matrix() @ flat @ turns.as_matrix().transpose(0, 2, 1)
    # Perspective's own share is the size over the distance, 1 %, and smoothing's at the ends.
    assert found[2:-2] == pytest.approx(true[2:-2], abs=0.03 * np.trace(flat))


@pytest.mark.parametrize("size", [1.0, 0.3])
def test_shifts_are_those_of_a_plate(size: float) -> None:
    turns = slowly_turning()
    told = [seen_by(angle_deg, turns, size) for angle_deg in ANGLES_DEG]
    moments = second_moments([view for view, _ in told], 1.0)
    largest = max(np.abs(true).max() for _, true in told)
    for view, true in told:
        # The next order, of the size over the distance, is left: some 5 % of the largest shift.
        found = perspective_shifts(view, moments, BodyRules.depth_power)
        assert found[2:-2] == pytest.approx(true[2:-2], abs=0.1 * largest)
