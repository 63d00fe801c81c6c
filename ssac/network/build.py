"""The network of all cameras of a group that fit, with its path."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ssac.arrays import Array, Mask
from ssac.network.adjustment import Network, adjust, cost_of, fit_of
from ssac.network.graph import Link, Pair, agreeing, supports
from ssac.network.normal import Solved, knots_for
from ssac.network.placing import Group, Placed, first_path, grown, place_all, rebased, triangulate
from ssac.network.state import CameraState, Priors, Sightings, is_near, network_times, with_strays
from ssac.rules import BodyRules, NetworkRules
from ssac.track.body import Look, body_moves
from ssac.track.moments import View, perspective_shifts, second_moments, spreads_near


@dataclass(frozen=True, eq=False)
class Built:
    """A network and the cameras in it."""

    members: list[int]  # cameras in it, in input order; the first is its reference
    network: Network
    solved: Solved

    @property
    def states(self) -> dict[int, CameraState]:
        """The state of each member, by its number."""
        return dict(zip(self.members, self.network.states, strict=True))


def build(group: Group, priors: list[Priors], distance: float, body: BodyRules) -> Built | None:
    """Build a group's network, scaled by its first two's distance; None: no pair gives a path."""
    placed = place_all(group, supports(group.links, group.rules))
    if placed is None:
        return None
    built = _first(placed, group, priors, distance)
    if built is None:
        return None
    more = grown(Placed(built.states, placed.inliers), group)
    if len(more.states) > len(built.members):
        built = _first(more, group, priors, distance)
    while built is not None and len(built.members) > 2:
        worst = _misfit(built, group.rules)
        if worst is None:
            break
        states = {k: state for k, state in built.states.items() if k != worst}
        built = _first(Placed(states, 0), group, priors, distance)
    return None if built is None else _trusted(built, group.links, body)


def _trusted(built: Built, links: Mapping[Pair, Link], body: BodyRules) -> Built:
    """Adjust all parameters; intrinsics that contradict the rig's count as less certain.

    Those of cameras that pairs suspect may be too far off to be pulled to their places: they are
    freed, focal lengths or principal points, if that is far likelier.
    """
    found, by = _unpulled(built, links, body), built.network.rules
    best, most = found, by.least_gain * sum(prior.is_suspect for prior in built.network.priors)
    for times in ((by.suspect_times, 1.0), (1.0, by.suspect_times)) if most else ():
        network = replace(
            built.network,
            states=found.network.states,
            path=found.network.path,
            priors=[
                prior.less_certain(*times) if prior.is_suspect else prior
                for prior in built.network.priors
            ],
        )
        other = _unpulled(replace(built, network=network), links, body)
        gain = _gain(found.network, other.network)
        if gain > most:
            best, most = other, gain
    return best


def _gain(one: Network, other: Network) -> float:
    """Return the logarithm of how much likelier, by independent sightings, another solution is."""
    there = replace(one, states=other.states, path=other.path, priors=other.priors)
    return (cost_of(one) - cost_of(there)) / one.repeats


def _unpulled(built: Built, links: Mapping[Pair, Link], body: BodyRules) -> Built:
    """Adjust all parameters, and widen deviations by which intrinsics are too far off.

    One camera's are widened at a time, those pulled the most: others yield to a wrong one too.
    """
    whole, by = _whole(built, links, body), built.network.rules
    for _ in range(by.most_doubts):
        network, priors = whole.network, list(built.network.priors)
        pulls = np.array([of.pulls(at) for of, at in zip(priors, network.states, strict=True)])
        k = int(np.argmax(pulls.max(axis=1)))
        most = float(pulls[k].max())
        if most <= by.most_pull or priors[k].pose_is_known:  # whose errors have effects as large
            break
        priors[k] = priors[k].less_certain(*np.where(pulls[k] == most, most, 1.0))
        built = replace(built, network=replace(built.network, priors=priors))
        whole = _whole(built, links, body)
    return whole


def _supported(
    states: list[CameraState], cameras: list[Sightings], reach_s: float
) -> tuple[list[Array], list[Mask]]:
    """Return the network times of each camera's sightings, and whether others see it then too."""
    times = [network_times(state, seen) for state, seen in zip(states, cameras, strict=True)]
    reaches_s = [max(reach_s, 2.5 * seen.interval_s) for seen in cameras]
    masks = [
        np.any([is_near(at_s, times[j], reaches_s[j]) for j in range(len(times)) if j != k], axis=0)
        for k, at_s in enumerate(times)
    ]
    return times, masks


def _knot_step_s(cameras: list[Sightings], rules: NetworkRules) -> float:
    """Time [s] between knots: dense, as the path's smoothness is told by the data."""
    intervals = sorted(seen.interval_s for seen in cameras)
    return float(np.clip(rules.knot_intervals * intervals[-2], *rules.knot_steps_s))


def _first(placed: Placed, group: Group, priors: list[Priors], distance: float) -> Built | None:
    """Adjust affine clocks and poses, without intrinsics, from the cameras' first placement.

    None: no two of them see the object on rays that are apart.
    """
    members, rules = sorted(placed.states), group.rules
    based = rebased(placed.states, members[0])
    apart = float(np.linalg.norm(based[members[1]].t))
    states = [replace(based[k], t=based[k].t * distance / apart) for k in members]
    cameras = [group.cameras[k] for k in members]
    step_s = _knot_step_s(cameras, rules)
    times, masks = _supported(states, cameras, step_s)
    shared_s = np.concatenate([t[mask] for t, mask in zip(times, masks, strict=True)])
    if len(shared_s) == 0:
        return None
    knots_s = knots_for(shared_s, step_s, rules.max_gap_s)
    sample_s = np.sort(shared_s)[:: max(1, len(shared_s) // (4 * len(knots_s)))]
    points = triangulate(states, cameras, sample_s, rules)
    seen = np.isfinite(points[:, 0])
    if not seen.any():
        return None
    path, jerk = first_path(knots_s, sample_s[seen], points[seen], rules)
    sigmas = np.array([rules.first_sigma_widths * camera.camera.width for camera in cameras])
    expected = []
    for k, state in zip(members, states, strict=True):
        is_fast = abs(state.rate) > rules.fast_sigmas * priors[k].rate
        expected.append(replace(priors[k], expected_rate=state.rate if is_fast else 0.0))
    network = Network(cameras, expected, masks, states, path, sigmas, jerk, distance, rules)
    return Built(members, *adjust(network, rules.first_rounds, with_intrinsics=False))


def _misfit(built: Built, rules: NetworkRules) -> int | None:
    """Return the camera that fits far worse than the others, or None."""
    cameras = enumerate(built.network.cameras)
    rms = np.array([fit_of(built.network, k).rms_px / seen.camera.width for k, seen in cameras])
    rms = np.nan_to_num(rms, nan=np.inf)  # of a camera none of whose sightings is used
    worst = int(np.argmax(rms))
    others = float(np.median(np.delete(rms, worst)))
    is_far = rms[worst] > max(rules.misfit * others, rules.least_misfit_widths)
    return built.members[worst] if is_far else None


def _whole(built: Built, links: Mapping[Pair, Link], body: BodyRules) -> Built:
    """Adjust all parameters without outliers; pairs enter last, so that wrong ones show."""
    network, by = built.network, built.network.rules
    states = [
        with_strays(state, seen, by.piece_s, by.most_pieces) if prior.roughness > 0.0 else state
        for state, seen, prior in zip(network.states, network.cameras, network.priors, strict=True)
    ]
    network, _ = adjust(replace(network, states=states), by.rounds)
    if any(seen.spreads_px2 is not None for seen in network.cameras):
        network = replace(network, cameras=_without_perspective(network, body))
        network, _ = adjust(network, by.rounds)
        followed = _by_their_body(network, body)
        if followed is not None:
            network, _ = adjust(replace(network, cameras=followed), by.rounds)
    cameras = network.cameras
    masks = _supported(network.states, cameras, _knot_step_s(cameras, by))[1]
    network, enabled = replace(network, enabled=masks), list[Mask]()
    for k, seen in enumerate(cameras):
        fit = fit_of(network, k)
        off = np.linalg.norm(fit.linear.residuals, axis=1) / (seen.shares * network.sigmas_px[k])
        enabled.append(fit.used & (off < by.gate))
    agreed = agreeing(links, built.members, network.states, by)
    network = replace(network, enabled=enabled, constraints=agreed)
    return Built(built.members, *adjust(network, by.rounds))


def _without_perspective(network: Network, rules: BodyRules) -> list[Sightings]:
    """Subtract the shift by perspective from the centroids of silhouettes."""
    even_s, moments = _shape(network)
    centred = []
    for k, seen in enumerate(network.cameras):
        if seen.spreads_px2 is None:
            centred.append(seen)
            continue
        times_s = _times_on_path(network, k)
        steps = (times_s - even_s[0]) / network.rules.shape_step_s
        nearest = np.clip(np.rint(steps), 0, len(even_s) - 1)
        view = _view(network, k, times_s, seen.spreads_px2)
        shifts_px = perspective_shifts(view, moments[nearest.astype(np.int64)], rules.depth_power)
        known = np.isfinite(seen.spreads_px2[:, :1])  # the others are no centroids
        points_px = seen.points_px - np.where(known, np.nan_to_num(shifts_px), 0.0)
        centred.append(replace(seen, points_px=points_px))
    return centred


def _by_their_body(network: Network, rules: BodyRules) -> list[Sightings] | None:
    """Follow one point of the body; elsewhere centroids count less. None: it is not determined."""
    looks = []
    for k, (state, seen) in enumerate(zip(network.states, network.cameras, strict=True)):
        if seen.images is None or seen.spreads_px2 is None or any(seen.camera.distortion_coeffs):
            return None
        times_s = _times_on_path(network, k)
        view = _view(network, k, times_s, seen.spreads_px2)
        corners = seen.images.corners_px - seen.camera.K[:2, 2] - state.centre_px
        corners = np.where(np.isfinite(seen.spreads_px2[:, :1]), corners, np.nan)
        shares = seen.images.shares
        looks.append(Look(times_s, state.R, view.focal_px, view.points, shares, corners))
    moves = body_moves(looks, *_shape(network), rules)
    if moves is None:
        return None
    followed = []
    for seen, state, look, move in zip(network.cameras, network.states, looks, moves, strict=True):
        there = look.focal_px * look.points[:, :2] / look.points[:, 2:]
        found = there + seen.camera.K[:2, 2] + state.centre_px + move
        is_known = np.isfinite(move[:, 0])
        points_px = np.where(is_known[:, None], found, seen.points_px)
        sigmas_px = np.where(is_known, 1.0, network.rules.centre_sigmas) * seen.sigmas_px
        followed.append(replace(seen, points_px=points_px, sigmas_px=sigmas_px))
    return followed


def _times_on_path(network: Network, k: int) -> Array:
    """Give the network's times (n,) of camera k's sightings, clipped to the path."""
    knots_s = network.path.knots_s
    return np.clip(network_times(network.states[k], network.cameras[k]), knots_s[0], knots_s[-1])


def _shape(network: Network) -> tuple[Array, Array]:
    """Return even network times (m,), and the object's second moments (m, 3, 3) at these."""
    knots_s, step_s = network.path.knots_s, network.rules.shape_step_s
    even_s: Array = np.arange(knots_s[0], knots_s[-1], step_s)
    even = []
    for k, (state, seen) in enumerate(zip(network.states, network.cameras, strict=True)):
        spreads: Array = np.full((len(even_s), 3), np.nan)
        if seen.spreads_px2 is not None:
            own_s, reach_s = state.own_from_network(even_s), 1.5 * seen.interval_s
            spreads = spreads_near(seen.spreads_px2, seen.times_s, own_s, reach_s)
        even.append(_view(network, k, even_s, spreads))
    return even_s, second_moments(even, network.rules.shape_smoothing_s / step_s)


def _view(network: Network, k: int, times_s: Array, spreads_px2: Array) -> View:
    """Give what camera k sees of the path at network times (n,)."""
    state, K = network.states[k], network.cameras[k].camera.K
    points = network.path.at(times_s) @ state.R.T + state.t
    return View(state.R, np.array([K[0, 0], K[1, 1]]) * (1.0 + state.focal), points, spreads_px2)
