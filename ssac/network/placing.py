"""A first clock and pose for every camera of a network, and a first path.

Each pair with a pose is tried as a seed: the other cameras are resected on the path that it gives,
and the seed that places the most cameras wins. No camera's error can thus spoil the rest.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product

import cv2
import numpy as np

from ssac.arrays import Array, Mask
from ssac.clock import Clock
from ssac.geometry.pose import rays_of
from ssac.network.graph import Link, Pair
from ssac.network.normal import Linear, Normal, Spline, basis, jerks, solve
from ssac.network.state import CameraState, Sightings
from ssac.rules import NetworkRules


def triangulate(
    states: list[CameraState], cameras: list[Sightings], times_s: Array, rules: NetworkRules
) -> Array:
    """Triangulate points (n, 3) at the network's times (n,); NaN where fewer than two cameras see.

    A point is the nearest to all rays. It must be in front of at least two cameras and near their
    rays, which must be apart. Rays that are far off are left out once.
    """
    rays = np.stack(
        [
            rays_of(seen.camera.K, seen.motion.at(state.own_from_network(times_s)).positions_px)
            @ state.R
            for state, seen in zip(states, cameras, strict=True)
        ]
    )
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    centres = np.stack([state.centre for state in states])[:, None, :]
    seen_by = np.asarray(np.isfinite(rays).all(axis=2))
    filled = np.where(seen_by[:, :, None], rays, 0.0)
    across = np.eye(3) - filled[..., :, None] * filled[..., None, :]
    for _ in range(2):
        is_enough = np.count_nonzero(seen_by, axis=0) >= 2
        is_enough &= are_apart(filled, seen_by, rules.least_angle_deg)
        counted = np.where(seen_by[..., None, None], across, 0.0)
        matrices = np.sum(counted, axis=0)
        rights = np.einsum("cnxy,cny->nx", counted, np.broadcast_to(centres, rays.shape))
        points = np.full((len(times_s), 3), np.nan)
        if is_enough.any():
            solved = np.linalg.solve(matrices[is_enough], rights[is_enough][:, :, None])
            points[is_enough] = solved[:, :, 0]
        to_points = points - centres
        depths = np.sum(to_points * filled, axis=2)
        off = np.linalg.norm(np.cross(to_points, filled), axis=2)
        with np.errstate(invalid="ignore"):
            fits = seen_by & (depths > 0.0) & (off < rules.max_off_depths * depths)
        bad = is_enough & (np.count_nonzero(fits, axis=0) < 2)
        points[bad] = np.nan
        if (fits == seen_by).all():
            break
        seen_by = fits
    return points


def are_apart(rays: Array, seen_by: Mask, least_deg: float) -> Mask:
    """Whether, at each time (n,), two of the rays (c, n, 3) seen are apart and tell a depth."""
    found = np.zeros(rays.shape[1], dtype=bool)
    least = np.sin(np.deg2rad(least_deg))
    for i, j in combinations(range(len(rays)), 2):
        sines = np.linalg.norm(np.cross(rays[i], rays[j]), axis=1)
        found |= seen_by[i] & seen_by[j] & (sines > least)
    return found


def first_path(
    knots_s: Array, times_s: Array, points: Array, rules: NetworkRules
) -> tuple[Spline, float]:
    """Fit a smooth path robustly to points (n, 3) at times (n,); also return the points' extent."""
    middle = np.median(points, axis=0)
    extent = float(np.median(np.linalg.norm(points - middle, axis=1))) + 1e-12
    first, weights = basis(knots_s, times_s)
    span_first, span_weights = jerks(knots_s)
    span_weights = span_weights / (rules.first_jerk * extent)
    path = Spline(knots_s, np.tile(middle, (len(knots_s) - 4, 1)))
    sigma = np.full(len(points), 0.01 * extent)
    n, no_columns = len(points), np.zeros((len(points), 0), np.int64)
    for _ in range(5):
        residuals = points - path.at(times_s)
        normal = Normal(len(path.coefficients), 0)
        for axis in range(3):
            by_point = np.zeros((n, 2, 3))
            by_point[:, 0, axis] = 1.0 / sigma
            over = np.zeros((n, 2))
            over[:, 0] = residuals[:, axis] / sigma
            normal.add(Linear(first, weights, by_point, np.zeros((n, 2, 0)), no_columns, over))
        normal.add_smoothness(span_first, span_weights, path.coefficients)
        normal.band[0] += 1e-9 * normal.band[0].max()
        step = solve(normal, np.empty(0, np.int64)).path
        path = replace(path, coefficients=path.coefficients + step)
        off = np.linalg.norm(points - path.at(times_s), axis=1)
        typical = float(np.median(off)) + 1e-4 * extent
        sigma = typical * np.sqrt(1.0 + (off / (2.0 * typical)) ** 2)
    return path, extent


@dataclass(frozen=True, eq=False)
class Placed:
    """Cameras with a first clock and pose; network time is that of the seed's first camera."""

    states: dict[int, CameraState]
    inliers: int  # sample times at which the path fits a camera, summed over cameras


@dataclass(frozen=True, eq=False)
class Group:
    """Cameras that are to be in one network."""

    cameras: list[Sightings]  # all of them
    links: Mapping[Pair, Link]  # of pairs (a, b), a < b
    members: list[int]  # numbers of the group's cameras
    rules: NetworkRules

    def clock(self, a: int, b: int) -> Clock | None:
        """Return camera b's clock relative to a's, which may be later; None without a link."""
        if (a, b) in self.links:
            return self.links[a, b].clock
        return self.links[b, a].clock.inverse() if (b, a) in self.links else None


def place_all(group: Group, trust: Mapping[Pair, int]) -> Placed | None:
    """Place as many cameras of a group as fit; None where no pair gives a path."""
    links, members, rules = group.links, group.members, group.rules
    seeds = [
        pair
        for pair, link in links.items()
        if set(pair) <= set(members) and link.is_reliable and link.R is not None
    ]
    seeds.sort(key=lambda pair: (-trust[pair], links[pair].cost))
    best, merit = None, (0, 0)
    for pair in seeds[: rules.most_seeds]:
        placed = _seed(group, pair, links[pair])
        if placed is None:
            continue
        placed = grown(placed, group)
        # More cameras count first, then more sightings in place.
        if (len(placed.states), placed.inliers) > merit:
            best, merit = placed, (len(placed.states), placed.inliers)
        if len(placed.states) == len(members) and seeds.index(pair) >= rules.enough_seeds:
            break
    return best


def grown(placed: Placed, group: Group) -> Placed:
    """Add the cameras that see the path of those placed, the best first, as long as any fits."""
    while True:
        times_s, points = _path_of(placed, group)
        known = np.isfinite(points[:, 0])
        path, best, found = (times_s[known], points[known]), 0, placed.states
        others = [k for k in group.members if k not in placed.states]
        for k, (one, state) in product(others, placed.states.items()):
            clock, seen = group.clock(one, k), group.cameras[k]
            if clock is not None:
                start = _with_clock(CameraState(middle_s=seen.middle_s), clock, state)
                inliers, fitted = _resected(start, seen, *path, group.rules)
                if fitted is not None and inliers > best:
                    best, found = inliers, placed.states | {k: fitted}
        if not best:
            return placed
        placed = Placed(found, placed.inliers + best)


def rebased(states: dict[int, CameraState], reference: int) -> dict[int, CameraState]:
    """Express affine clocks and poses in the clock and the frame of one camera."""
    base = states[reference]
    alpha = 1.0 / (1.0 - base.rate)
    beta_s = float(base.own_from_network(np.zeros(1))[0])
    found = {}
    for k, state in states.items():
        delay_s = state.middle_s - alpha * (state.middle_s - state.delay_s) - beta_s
        rate, R = 1.0 - alpha * (1.0 - state.rate), state.R @ base.R.T
        found[k] = replace(state, delay_s=delay_s, rate=rate, R=R, t=state.t - R @ base.t)
    return found


def _seed(group: Group, pair: Pair, link: Link) -> Placed | None:
    """Place a pair; None unless enough of its path is in front of both cameras."""
    (a, b), cameras, rules = pair, group.cameras, group.rules
    first = CameraState(middle_s=cameras[a].middle_s)
    R, t = np.asarray(link.R), np.asarray(link.t)  # which seeds have
    second = _with_clock(CameraState(middle_s=cameras[b].middle_s, R=R, t=t), link.clock, first)
    placed = Placed({a: first, b: second}, 0)
    points = _path_of(placed, group)[1]
    inliers = int(np.count_nonzero(np.isfinite(points[:, 0])))
    is_enough = inliers >= max(rules.least_inliers, rules.seed_share * len(points))
    return Placed(placed.states, 2 * inliers) if is_enough else None


def _with_clock(state: CameraState, clock: Clock, other: CameraState) -> CameraState:
    """Set a camera's clock, given relative to that of another camera, which is placed."""
    away_s = 1.0 + abs(state.middle_s) * 1e-3
    own_s = state.middle_s + away_s * np.array([-1.0, 1.0])
    passed_s = other.network_from_own(clock.cam1_from_cam2(own_s))
    rate = 1.0 - float(passed_s[1] - passed_s[0]) / (2.0 * away_s)
    return replace(state, delay_s=state.middle_s - float(np.mean(passed_s)), rate=rate)


def _path_of(placed: Placed, group: Group) -> tuple[Array, Array]:
    """Return times (n,) at which two placed cameras see the object, and points (n, 3) or NaN."""
    states, cameras = list(placed.states.values()), [group.cameras[k] for k in placed.states]
    both = list(zip(states, cameras, strict=True))
    spans = [state.network_from_own(np.array(seen.span_s)) for state, seen in both]
    start_s, end_s = min(span[0] for span in spans), max(span[1] for span in spans)
    times_s = np.linspace(start_s, end_s, 8 * group.rules.samples, dtype=np.float64)
    seen_by = [seen.motion.at(state.own_from_network(times_s)).valid for state, seen in both]
    times_s = times_s[np.count_nonzero(seen_by, axis=0) >= 2]
    times_s = times_s[:: max(1, len(times_s) // group.rules.samples)]
    return times_s, triangulate(states, cameras, times_s, group.rules)


def _resected(
    state: CameraState, seen: Sightings, times_s: Array, points: Array, rules: NetworkRules
) -> tuple[int, CameraState | None]:
    """Resect a camera of known clock on points (n, 3): inliers and state, or 0 and None."""
    track = seen.motion.at(state.own_from_network(times_s))
    valid = track.valid
    n = int(np.count_nonzero(valid))
    if n < rules.least_inliers:
        return 0, None
    world, image = points[valid], track.positions_px[valid]
    scale = float(np.median(np.linalg.norm(world - np.median(world, axis=0), axis=1))) + 1e-12
    world = np.ascontiguousarray(world / scale)
    off_px = rules.max_off_widths * seen.camera.width
    try:
        is_found, turn, shift, chosen = cv2.solvePnPRansac(
            world, np.ascontiguousarray(image), seen.camera.K, None, iterationsCount=rules.trials,
            reprojectionError=off_px, confidence=0.9999, flags=cv2.SOLVEPNP_SQPNP,
        )  # fmt: skip
    except cv2.error:
        return 0, None
    least = max(rules.least_inliers, rules.least_inlier_share * n)
    if not is_found or chosen is None or len(chosen) < least:
        return 0, None
    places = chosen.ravel()
    turn, shift = cv2.solvePnPRefineLM(
        world[places], image[places], seen.camera.K, None, turn, shift
    )
    R = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    t = np.asarray(shift, dtype=np.float64).ravel()
    depths = world[places] @ R[2] + t[2]
    if np.mean(depths > 0.0) < 0.9:
        return 0, None
    return len(places), replace(state, R=R, t=scale * t)
