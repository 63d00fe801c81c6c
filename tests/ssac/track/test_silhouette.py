"""Silhouettes give centres and second moments of images, and correct a turning body's track."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac import Camera
from ssac.events import events_from_arrays
from ssac.rules import BodyRules, SilhouetteRules
from ssac.track import moments
from ssac.track.body import Look, body_moves
from ssac.track.silhouette import Silhouettes, silhouettes
from tests.ssac.balls import BALL_M, BODY_M, attitudes, drawn_at, moments_of
from tests.ssac.cluttered import merged, noise

SIZE = 320
CAMERA = Camera(np.array([[100.0, 0.0, 160.0], [0.0, 100.0, 160.0], [0.0, 0.0, 1.0]]), SIZE, SIZE)
MIDDLE = np.array([160.3, 159.8])
WINDOW = 50  # width [px] of the part drawn, which holds the shape
LIGHT, DARK = 0.4, 0.05
BRIGHT = 0.95  # by three and a half thresholds only, so that levels are coarser
THRESHOLD = 0.25
SPEED_PX_S, STEP_PX = 200.0, 0.1
FINE = 5  # samples across a pixel


def disc(u, v):
    """A disc of radius 13 px, some 9 px rms."""
    return np.hypot(u, v) < 13.0


def corner(u, v):
    """An L with arms 6 px wide, 30 and 20 px long; its hull's centre is 4 px from its own."""
    along = (np.abs(u) < 3.0) & (np.abs(v) < 15.0)
    return along | ((u > 0.0) & (u < 20.0) & (v > 9.0) & (v < 15.0))


@cache
def recorded(shape, angle_deg, object_luminance=DARK, length_px=240.0):
    """Events of a shape that crosses the view; times [s], true centres and second moments."""
    way = np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    along = np.arange(-0.5 * length_px, 0.5 * length_px, STEP_PX)
    times_us = 1e6 * (along - along[0]) / SPEED_PX_S
    local = (np.arange(WINDOW * FINE) + 0.5) / FINE - 0.5
    reference = np.full((SIZE, SIZE), np.log(LIGHT))
    before = reference.copy()
    rows = []
    for i, s in enumerate(along):
        middle = MIDDLE + s * way
        left, top = np.rint(middle).astype(int) - WINDOW // 2
        u, v = np.meshgrid(left + local - middle[0], top + local - middle[1])
        share = shape(u, v).reshape(WINDOW, FINE, WINDOW, FINE).mean(axis=(1, 3))
        now = np.log(LIGHT + (object_luminance - LIGHT) * share)
        part = np.s_[top : top + WINDOW, left : left + WINDOW]
        held, was = reference[part], before[part]  # views
        if i == 0:
            held[:] = now
        while (is_over := np.abs(now - held) >= THRESHOLD).any():
            y, x = np.nonzero(is_over)
            up = now[y, x] > held[y, x]
            held[y, x] += np.where(up, THRESHOLD, -THRESHOLD)
            done = (held[y, x] - was[y, x]) / (now[y, x] - was[y, x])
            t = times_us[i - 1] + done * (times_us[i] - times_us[i - 1])
            rows.append(np.column_stack([t, left + x, top + y, up]))
        was[:] = now
    table = np.rint(np.concatenate(rows)).astype(np.int64)
    events = events_from_arrays(*table[np.argsort(table[:, 0], kind="stable")].T)
    fine = np.arange(-25.0, 25.0, 0.05)
    u, v = np.meshgrid(fine, fine)
    inside = shape(u, v)
    offset = np.array([u[inside].mean(), v[inside].mean()])
    spread = np.cov(u[inside], v[inside])
    times_s = np.arange(0.005, 1e-6 * times_us[-1] - 0.005, 0.01)
    centres = MIDDLE + (along[0] + SPEED_PX_S * times_s)[:, None] * way + offset
    return events, times_s, centres, spread


def found_of(events, times_s, track_px, spread, **rules) -> Silhouettes | None:
    sizes = np.full(len(times_s), np.sqrt(np.trace(spread)))
    return silhouettes(events, events, CAMERA, times_s, track_px, sizes, SilhouetteRules(**rules))


def off_px(found, centres):
    """Errors [px] of the centres found: the largest mean of a coordinate, and the rms."""
    off = (found.centres_px - centres)[found.known]
    return np.abs(off.mean(axis=0)).max(), np.sqrt(np.mean(off**2))


@pytest.mark.parametrize(
    ("shape", "angle_deg", "luminance", "within_px"),
    [
        (disc, 37.0, DARK, 0.2),
        # Along edges of the L, or oblique.
        *((corner, angle_deg, DARK, 0.2) for angle_deg in (0.0, 37.0, 90.0, 180.0)),
        (corner, 37.0, BRIGHT, 0.3),
    ],
)
def test_the_centre_of_the_area_is_found_whichever_way_it_moves(
    shape, angle_deg, luminance, within_px
) -> None:
    events, times_s, centres, spread = recorded(shape, angle_deg, luminance)
    # The track holds the mean of the events, which is not the centre of the area.
    found = found_of(events, times_s, centres + np.array([0.8, -0.6]), spread)
    known = found.known
    # Early images are unknown: their boxes hold pixels that have not been seen bare.
    assert known[len(known) // 2 :].mean() > 0.9
    # The covered share of a level assumes a middling contrast, not this one: an edge is off by
    # 0.2 px at most, and opposite edges are off the more alike the longer they are.
    assert max(off_px(found, centres)) < within_px
    told = found.spreads_px2[known].mean(axis=0)
    # The blur of an edge by a pixel widens the image; its faint half, without events, narrows it.
    scale = np.trace(spread)
    assert told == pytest.approx([spread[0, 0], spread[0, 1], spread[1, 1]], abs=0.08 * scale)


@pytest.mark.parametrize("luminance", [DARK, BRIGHT])
def test_what_a_large_object_covers_at_first_is_told_by_what_comes_later(luminance) -> None:
    # It moves by 60 px, and its box reaches over 30 px each way: most pixels never leave the box.
    events, times_s, centres, spread = recorded(corner, 37.0, luminance, length_px=60.0)
    assert found_of(events, times_s, centres, spread) is None
    found = found_of(events, times_s, centres, spread, large_px=5.0)
    assert found.known.mean() > 0.95
    # Pixels that are never uncovered, whose level is unsure, are few.
    assert np.all(np.less(off_px(found, centres), [0.3, 0.4]))
    # Each half of the object has a contrast of its own: it is both darker and lighter.
    left = events["x"] < MIDDLE[0]
    mixed = events_from_arrays(events["t"], events["x"], events["y"], events["p"] ^ left)
    assert found_of(mixed, times_s, centres, spread, large_px=5.0) is None


def test_images_too_small_and_events_that_do_not_come_back_tell_no_silhouette() -> None:
    events, times_s, centres, spread = to_and_fro()
    small = np.diag([0.99 * SilhouetteRules.min_size_px, 0.0]) ** 2
    assert found_of(events, times_s, centres, spread) is not None
    assert found_of(events, times_s, centres, small) is None
    assert found_of(thinned(events, 0.5), times_s, centres, spread) is None


@cache
def to_and_fro():
    """Events of a corner that crosses the view twice; times, centres and moments."""
    (events, times_s, centres, spread), (back, back_s, back_px, _) = (
        recorded(corner, angle_deg) for angle_deg in (0.0, 180.0)
    )
    back, shift_us = back.copy(), events["t"][-1] + 100_000
    back["t"] += shift_us
    times_s = np.concatenate([times_s, back_s + 1e-6 * shift_us])
    return np.concatenate([events, back]), times_s, np.concatenate([centres, back_px]), spread


def blind(events, lasting_us):
    """Leave out events that follow the pixel's last kept event within `lasting_us`."""
    kept, blind_until_us = [], np.zeros((SIZE, SIZE))
    for i, (t_us, x, y, _) in enumerate(events.tolist()):
        if t_us >= blind_until_us[y, x]:
            kept.append(i)
            blind_until_us[y, x] = t_us + lasting_us
    return events[kept]


def unequal(events, share):
    """Leave out a share of half the pixels' ON events, as with a larger ON threshold there."""
    drawn = np.random.default_rng(0).random((SIZE, SIZE))[events["y"], events["x"]]
    return events[(events["p"] == 0) | (drawn > 0.5) | (np.arange(len(events)) % 8 >= 8 * share)]


def thinned(events, share):
    return events[np.random.default_rng(0).random(len(events)) < share]


@pytest.mark.parametrize("share", [0.0, 0.25])  # levels are counted, or evened
def test_a_delayed_clock_shows_the_same_to_the_last_bit(share) -> None:
    events, times_s, track_px, spread = to_and_fro()
    events = unequal(events, share)
    later = events.copy()
    later["t"] += 123_457
    one = found_of(events, times_s, track_px, spread)
    # The track on the later clock has rounding errors of its own.
    other = found_of(later, times_s + 0.123457, track_px * (1.0 + 1e-13), spread)
    np.testing.assert_array_equal(one.centres_px, other.centres_px)
    np.testing.assert_array_equal(one.spreads_px2, other.spreads_px2)
    np.testing.assert_array_equal(one.images.shares, other.images.shares)


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda events: unequal(events, 0.25),
        lambda events: blind(events, 700),
        lambda events: merged(events, noise(SIZE, SIZE, 0.5, int(events["t"][-1]))),
        lambda events: thinned(events, 0.9),
    ],
    ids=["unequal thresholds", "blind after events", "background", "a tenth is missing"],
)
def test_levels_that_do_not_come_out_even_are_evened(spoilt) -> None:
    events, times_s, centres, spread = to_and_fro()
    evened, counted = (
        found_of(spoilt(events), times_s, centres, spread, min_closed_share=least)
        for least in (SilhouetteRules.min_closed_share, 0.0)
    )
    # A fraction of a pixel, of the object's 11: levels as counted leave a trail of pixels behind.
    rms_px = off_px(evened, centres)[1]
    assert rms_px < 0.5
    assert rms_px < 0.25 * off_px(counted, centres)[1]
    assert evened.known.mean() > 0.8


# --- A body ---

FOCAL_PX, DISTANCE_M, WIDTH = 200.0, 5.0, 45
ANGLES_DEG = (0.0, 60.0, 120.0, 180.0)
TIMES_S = np.arange(0.0, 4.0, 0.05)
RULES = BodyRules()


@cache
def drawn(shape: str) -> tuple[list[Look], np.ndarray, list[np.ndarray]]:
    """The cameras' looks at a shape, its second moments, and centres less images of its origin."""
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
    looks, of_body, _ = drawn(shape)
    # A ball has many voxels: at 4/3 of the width there are 0.4 times as many.
    rules = RULES if shape == "body" else BodyRules(voxels_across=15.0)
    return body_moves(looks, TIMES_S, of_body, rules)


def swayed_px(moves: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean([np.nanvar(move, axis=0) for move in moves])))


def test_one_point_is_followed_where_the_centre_of_area_strays() -> None:
    _, _, shifts = drawn("body")
    # The point found need not be the origin: a point at a lever from the origin sways as the body
    # turns, but by less than the centre of area does. The shape's error leaves some 0.02 px.
    assert np.isfinite(np.concatenate(found("body"))).mean() > 0.8
    assert swayed_px(found("body")) < 0.5 * swayed_px(shifts)


def test_a_ball_needs_no_correction() -> None:
    # No image shows a ball's attitude, and no correction needs it. Voxels 0.6 px apart do not make
    # an exact ball: as the axes of its moments take any direction, they cause some 0.05 px.
    assert np.sqrt(np.nanmean(np.square(found("ball")))) < 0.1


def test_a_turned_frame_and_other_numbers_of_cameras_change_nothing() -> None:
    looks, of_body, _ = drawn("body")
    G = Rotation.from_rotvec([0.4, -0.8, 0.3]).as_matrix()
    order = [2, 0, 3, 1]
    moved = [replace(looks[k], R=looks[k].R @ G.T) for k in order]
    moves = body_moves(moved, TIMES_S, G @ of_body @ G.T, RULES)
    for k, move in zip(order, moves, strict=True):
        # Sums are taken in another order, and axes may be reversed: the voxels then differ.
        assert np.nanmax(np.abs(move - found("body")[k])) < 0.05


@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (1, 3)])
def test_last_digits_decide_nothing_of_the_moments_of_two_views(pair: tuple[int, int]) -> None:
    looks, true, _ = drawn("body")

    def found(off: float) -> np.ndarray:
        rng, other = np.random.default_rng(5), np.random.default_rng(6)
        views = []
        for k in pair:
            R, focal_px, points = looks[k].R, looks[k].focal_px, looks[k].points
            by_place = moments.image_by_place(R, focal_px, points)
            spreads = (by_place @ true @ by_place.transpose(0, 2, 1))[:, [0, 0, 1], [0, 1, 1]]
            # Noise leaves some moments without depth; there a square root turns 1e-16 into 1e-8.
            spreads = spreads + 0.6 * spreads.mean() * rng.standard_normal(spreads.shape)
            spreads *= 1.0 + off * other.standard_normal(spreads.shape)
            views.append(moments.View(R, focal_px, points, spreads))
        return moments.moments_of_two(views, 2.0, 1, RULES)

    # Without the rounding in `moments_of_two`, this is 6e-9 of the largest moment.
    exact = found(0.0)
    assert found(1e-13) == pytest.approx(exact, rel=0.0, abs=1e-10 * np.abs(exact).max())


def test_points_without_an_image_do_not_change_the_size_of_the_others() -> None:
    (look, *others), of_body, _ = drawn("body")
    unseen = (np.arange(len(TIMES_S)) % 5 < 3)[:, None]
    look = replace(look, corners_px=np.where(unseen, np.nan, look.corners_px))
    near = replace(look, points=np.where(unseen, [0.0, 0.0, 1.0], look.points))
    found, same = (body_moves([one, *others], TIMES_S, of_body, RULES) for one in (look, near))
    np.testing.assert_array_equal(same, found)


def test_too_few_moments_are_refused() -> None:
    looks, of_body, _ = drawn("body")
    for n in (0, 20):
        known = np.where(np.arange(len(of_body))[:, None, None] < n, of_body, np.nan)
        assert body_moves(looks, TIMES_S, known, RULES) is None


N_TURNS = 25


def plate() -> np.ndarray:
    """Points all over a plate of 0.5 x 0.3 m, whose middle is the origin."""
    u, v = np.meshgrid(np.linspace(-0.25, 0.25, 81), np.linspace(-0.15, 0.15, 49))
    return np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])


def seen_by(angle_deg: float, turns: Rotation, size: float) -> tuple[moments.View, np.ndarray]:
    """A camera's view of the turning plate, and true centres of area less images of its middle."""
    R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    t = np.array([0.4, -0.3, DISTANCE_M])
    local = np.einsum("nij,pj->npi", R @ turns.as_matrix(), size * plate()) + t
    images = FOCAL_PX * local[..., :2] / local[..., 2:]
    weights = local[..., 2] ** -3.0  # relative image area of a part of the plane
    weights /= weights.sum(axis=1, keepdims=True)
    centres = np.einsum("np,npi->ni", weights, images)
    off = images - centres[:, None]
    spreads = np.einsum("np,npi,npj->nij", weights, off, off)[:, [0, 0, 1], [0, 1, 1]]
    points = np.tile(t, (N_TURNS, 1))
    view = moments.View(R, np.full(2, FOCAL_PX), points, spreads)
    return view, centres - FOCAL_PX * t[:2] / t[2]


@pytest.mark.parametrize("size", [1.0, 0.3, 0.1])
def test_moments_and_shifts_are_those_of_a_plate(size: float) -> None:
    # The plate turns by 3 deg in all, about a tilted attitude: smoothing leaves that as it is.
    angles = np.linspace(-1.5, 1.5, N_TURNS)
    attitudes_deg = np.column_stack([20.0 + angles, 35.0 + angles, angles])
    turns = Rotation.from_euler("xyz", attitudes_deg, degrees=True)
    told = [seen_by(angle_deg, turns, size) for angle_deg in ANGLES_DEG]
    views = [view for view, _ in told]
    told_m2 = moments.second_moments(views, 1.0)
    assert np.isnan(moments.second_moments(views[:2], 1.0)).all()  # they share one measured moment
    if size == 0.1:
        # Perspective adds an error of size over distance, 1 %; smoothing adds one at the ends.
        flat, axes = 0.01 * np.cov(plate().T, bias=True), turns.as_matrix()
        true = axes @ flat @ axes.transpose(0, 2, 1)
        assert told_m2[2:-2] == pytest.approx(true[2:-2], abs=0.03 * np.trace(flat))
    largest = max(np.abs(true).max() for _, true in told)
    for view, true in told:
        # The next order in size over distance is left: some 5 % of the largest shift.
        found = moments.perspective_shifts(view, told_m2, BodyRules.depth_power)
        assert found[2:-2] == pytest.approx(true[2:-2], abs=0.1 * largest)
