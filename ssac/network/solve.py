"""Clocks and poses of all cameras, and a path for each group that pairs connect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from ssac.arrays import Array, Mask
from ssac.camera import READOUT_STD_S, Camera, with_deviations
from ssac.clock import PPM, Clock
from ssac.config import Config
from ssac.estimate import Estimate, Status
from ssac.events import rounding_variance_s2
from ssac.geometry.pose import centre_covariance
from ssac.network import state as layout
from ssac.network.adjustment import Network, border_offsets, fit_of
from ssac.network.align import Similarity
from ssac.network.build import Built, build
from ssac.network.graph import Link, Pair, Triple, closures_s, factor_of, groups, suspects
from ssac.network.normal import basis
from ssac.network.placing import Group, are_apart
from ssac.network.state import CameraState, Priors, Sightings, is_near, network_times
from ssac.network.tum import Path
from ssac.search.all_offsets import Guess


@dataclass(frozen=True, eq=False)
class CameraAnswer:
    """The estimate of one camera; times are on the clock of its group's first camera."""

    name: str
    status: str = Status.OK
    reason: str = ""
    group: int = 0  # 0: none
    t_d_s: float = np.nan
    t_d_std_s: float = np.nan
    t_ref_s: float = np.nan
    skew_ppm: float = np.nan
    skew_std_ppm: float = np.nan
    readout_s: float = np.nan
    readout_std_s: float = np.nan
    R: Array | None = None  # (3, 3) x_k = R x_1 + t
    t: Array | None = None  # (3,)
    pose_covariance: Array | None = None  # (6, 6) of a small turn [rad] after R, and of t
    calibration: Camera | None = None  # found in place of the rig's, where that is contradicted
    knots_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) first camera's clock
    strays_s: Array = field(default_factory=lambda: np.empty(0))  # (k,)
    n_samples: int = 0
    n_seen: int = 0
    rms_px: float = np.nan

    @property
    def r_std_deg(self) -> float:
        """Standard deviation of R [deg]: the root of the trace of its angles' covariance."""
        if self.pose_covariance is None:
            return np.nan
        return float(np.rad2deg(np.sqrt(np.sum(np.diag(self.pose_covariance)[:3]))))

    @property
    def t_std(self) -> Array | None:
        """Standard deviations of t (3,) in its unit."""
        known = self.pose_covariance
        return None if known is None else np.sqrt(np.diag(known)[3:])

    @property
    def centre_covariance(self) -> Array | None:
        """Covariance (3, 3) of the projection centre."""
        if self.R is None or self.t is None or self.pose_covariance is None:
            return None
        return centre_covariance(self.R, self.t, self.pose_covariance)

    @property
    def centre(self) -> Array | None:
        """Projection centre (3,) in its group's frame; None where it is not known."""
        return None if self.R is None or self.t is None else np.asarray(-self.R.T @ self.t)

    @property
    def clock(self) -> Clock:
        """The camera's clock, as the first of its group sees it."""
        return Clock(self.t_d_s, self.skew_ppm, self.t_ref_s, self.knots_s, self.strays_s)


@dataclass(frozen=True, eq=False)
class PathAnswer:
    """The object's path in the frame and on the clock of a group's first camera."""

    path: Path
    spans_s: Array  # (k, 2) intervals in which the path holds


def answer_of(built: Built, k: int, group: int) -> CameraAnswer:
    """Return the estimate of the k-th camera of a network."""
    network = built.network
    state, seen, fit = network.states[k], network.cameras[k], fit_of(network, k)
    prior = network.priors[k]
    used_s = network_times(state, seen)[fit.used]
    t_ref_s = 0.5 * float(used_s[0] + used_s[-1])
    own_s = (t_ref_s + state.delay_s - state.rate * state.middle_s) / (1.0 - state.rate)
    at = int(border_offsets(network)[k])
    covariance = built.solved.border_covariance()[at : at + state.size, at : at + state.size]
    covariance = covariance * network.lasting
    by = np.zeros(state.size)
    by[layout.DELAY], by[layout.RATE] = 1.0, own_s - state.middle_s
    by /= 1.0 - state.rate
    deviations = np.sqrt(np.diag(covariance))
    pose = slice(layout.ROTATION.start, layout.TRANSLATION.stop)
    return CameraAnswer(
        seen.name,
        group=group,
        t_d_s=own_s - t_ref_s,
        t_d_std_s=float(np.sqrt(by @ covariance @ by)),
        t_ref_s=t_ref_s,
        skew_ppm=(1.0 / (1.0 - state.rate) - 1.0) / PPM,
        skew_std_ppm=float(deviations[layout.RATE]) / (1.0 - state.rate) ** 2 / PPM,
        readout_s=(seen.camera.readout_s or 0.0) + state.readout_s,
        readout_std_s=float(deviations[layout.READOUT]),
        R=state.R,
        t=state.t,
        pose_covariance=covariance[pose, pose],
        calibration=_calibration(seen.camera, state, deviations) if prior.in_doubt else None,
        knots_s=state.network_from_own(state.knots_s),
        strays_s=state.strays_s / (1.0 - state.rate),
        n_samples=int(np.count_nonzero(fit.used)),
        n_seen=len(seen),
        rms_px=fit.rms_px,
    )


def _calibration(camera: Camera, state: CameraState, deviations: Array) -> Camera:
    """Return a camera with the intrinsics found, and their deviations."""
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= 1.0 + state.focal
    K[:2, 2] += state.centre_px
    focals_px = np.diag(camera.K)[:2] * deviations[layout.FOCAL]
    stds_px = tuple(np.append(focals_px, deviations[layout.CENTRE]).tolist())
    return replace(camera, K=K, intrinsics_std_px=stds_px)


def _holds_at(network: Network, times_s: Array) -> Mask:
    """Whether the path holds at times (n,) of it: two cameras' rays to the object are apart."""
    rules, near = network.rules, list[Mask]()
    for state, seen, enabled in zip(network.states, network.cameras, network.enabled, strict=True):
        reach_s = max(rules.reach_s, rules.reach_intervals * seen.interval_s)
        near.append(is_near(times_s, network_times(state, seen)[enabled], reach_s))
    points = network.path.at(times_s)
    rays = np.stack([points - state.centre for state in network.states])
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    return are_apart(rays, np.stack(near), rules.least_angle_deg)


def path_at(built: Built, times_s: Array, frame: Similarity | None = None) -> Path:
    """Sample the path at times (n,), whether it holds or not; in `frame` or the first camera's."""
    network = built.network
    first, weights = basis(network.path.knots_s, times_s)
    covariances = built.solved.path_covariances(first, weights) * network.lasting
    points = network.path.at(times_s)
    if frame is not None:
        points = frame.apply(points)
        covariances = frame.scale**2 * frame.R @ covariances @ frame.R.T
    return Path(times_s, points, np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)))


def path_of(built: Built, frame: Similarity | None = None) -> PathAnswer:
    """Sample the path evenly where it holds; in a frame as of `path_at`."""
    network, knots_s = built.network, built.network.path.knots_s
    step_s = max(network.rules.path_step_s, min(seen.interval_s for seen in network.cameras))
    times_s = np.arange(knots_s[0], knots_s[-1] + 0.5 * step_s, step_s)
    times_s = np.minimum(times_s, knots_s[-1])
    holds = _holds_at(network, times_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(int)))
    spans_s = np.column_stack([times_s[edges[::2]], times_s[edges[1::2] - 1]])
    return PathAnswer(path_at(built, times_s[holds], frame), spans_s)


@dataclass(frozen=True, eq=False)
class NetworkAnswer:
    """The estimates of all cameras, and their networks and paths."""

    cameras: list[CameraAnswer]  # in input order
    closures_s: dict[Triple, float]  # closure errors of reliable pairs
    wrong_pairs: dict[Pair, float]  # by how much [s] their clocks contradict the network
    built: list[Built]  # a network for each group
    paths: list[PathAnswer]  # one for each network

    @property
    def status(self) -> Status:
        """Whether all cameras are in one network: `ok` if so."""
        return Status.OK if len(self.built) == 1 and not self.left_out else Status.NO_MATCH

    @property
    def left_out(self) -> list[str]:
        """Names of the cameras that are in no network."""
        return [camera.name for camera in self.cameras if camera.status != Status.OK]

    @property
    def reason(self) -> str:
        """Why not all cameras are in one network; empty where they are."""
        said = []
        if len(self.built) > 1:
            names = [" ".join(seen.name for seen in one.network.cameras) for one in self.built]
            said.append(f"no pair that fits connects {' with '.join(names)}: a solution for each")
        said += [f"{c.name}: {c.reason}" for c in self.cameras if c.status != Status.OK]
        return "; ".join(said)


def link_of(
    estimate: Estimate, guess: Guess | None, of_events: bool = False, contradicts: bool = False
) -> Link | None:
    """Return the link of a pair, with a factor if it is `of_events`; None if nothing is known.

    An estimate with an offset must have a `t_ref_s`: at other times the network's rates add to it.
    """
    if estimate.has_offset:  # the network estimates the strays
        skew_ppm = estimate.skew_ppm if np.isfinite(estimate.skew_ppm) else 0.0
        clock = Clock(estimate.t_d_s, skew_ppm, estimate.t_ref_s)
    elif guess is not None:
        clock = Clock(guess.t_d_s, 1e6 * (guess.rate - 1.0), guess.t_ref_s)
    else:
        return None
    cost = guess.cost if guess is not None else estimate.d_avg_px
    pose = (estimate.R, estimate.t) if estimate.status == Status.OK else (None, None)
    factor = factor_of(estimate) if of_events else None
    return Link(clock, estimate.has_offset, cost, *pose, factor, contradicts)


def _priors_of(seen: Sightings, config: Config, pose_is_known: bool, is_suspect: bool) -> Priors:
    """Give the priors of a camera's parameters: by its rig, and by its kind of clock."""
    may_wander = config.clock == "pieces" or (seen.has_frames and config.clock != "affine")
    is_exact = not any(seen.camera.intrinsics_std_px)
    camera = with_deviations(seen.camera) if is_suspect and is_exact else seen.camera
    std = np.array(camera.intrinsics_std_px, dtype=np.float64)
    focal = std[:2] / np.diag(camera.K)[:2]
    return Priors(
        rate=PPM * config.prior_ppm,
        readout_s=READOUT_STD_S if seen.has_frames and seen.camera.readout_s is None else 0.0,
        focal=(float(focal[0]), float(focal[1])),
        centre_px=(float(std[2]), float(std[3])),
        roughness=PPM * config.roughness_ppm if may_wander and config.prior_ppm else 0.0,
        pose_is_known=pose_is_known,
        is_suspect=is_suspect,
    )


def solve_network(
    cameras: Sequence[Sightings],
    links: Mapping[Pair, Link],
    config: Config,
    distance: float,
    pose_is_known: bool = False,
) -> NetworkAnswer:
    """Find clocks and poses of all cameras, in input order, and the path that they saw.

    Links of some pairs (a, b), a < b, may be wrong or missing. Of `config` the clocks' priors are
    taken, and the rules; `distance` is that between the first two cameras of each group. A pose
    that is known is held where the links place its camera.
    """
    listed, built_all, rules = list(cameras), list[Built](), config.rules
    prior_ppm = config.resolved(any(seen.has_frames for seen in listed)).prior_ppm
    config = replace(config, skew_prior_ppm=prior_ppm)
    suspect = suspects(links)
    priors = [
        _priors_of(seen, config, pose_is_known, k in suspect) for k, seen in enumerate(listed)
    ]
    answers = [
        CameraAnswer(seen.name, Status.NO_MATCH, _LONELY, n_seen=len(seen)) for seen in listed
    ]
    waiting = groups(len(listed), links)
    while waiting:
        members = waiting.pop(0)
        if len(members) < 2:
            continue
        group, built = Group(listed, links, members, rules.network), None
        try:
            built = build(group, priors, distance, rules.body)
            no_path = _NO_PATH.format(rules.network.least_angle_deg)
            reason = no_path if built is None else _MISFIT
        except np.linalg.LinAlgError:
            reason = _OPEN
        for k in members:
            if answers[k].reason == _LONELY:  # not of cameras that others left
                answers[k] = replace(answers[k], reason=reason)
        if built is not None:
            built_all.append(built)
            left = set(members) - set(built.members)  # by a wrong pair one with these
            waiting += groups(len(listed), {of: links[of] for of in links if left.issuperset(of)})
            for place, k in enumerate(built.members):
                answers[k] = answer_of(built, place, len(built_all))
    return NetworkAnswer(
        answers,
        closures_s({pair: link.clock for pair, link in links.items() if link.is_reliable}),
        _contradicted(built_all, links, rules.network.max_closure_s),
        built_all,
        [path_of(built) for built in built_all],
    )


_LONELY = (
    "no pair with another camera gave a reliable offset: see the pairs, and check that it saw the "
    "same flight"
)
_NO_PATH = (
    "no pair of the group gave a pose that puts the object in front of both cameras, on rays at "
    "least {:g} deg apart"
)
_OPEN = (
    "the object's path leaves clocks or poses of its group open, as one on a line or at rest does: "
    "record a flight with curves in it"
)
_MISFIT = (
    "it fits nowhere in the network that the others make: check its frame numbers, its frame rate "
    "and its calibration"
)


def rounded_by(answer: NetworkAnswer, quanta_s: Sequence[float]) -> NetworkAnswer:
    """Widen each offset's deviation by the shift that both cameras' steps `quanta_s` may cause."""
    cameras = list(answer.cameras)
    for built in answer.built:
        first, *others = built.members  # the offset of the first to itself is exact
        for k in others:
            hidden_s2 = rounding_variance_s2(quanta_s[first], quanta_s[k])
            t_d_std_s = float(np.sqrt(cameras[k].t_d_std_s ** 2 + hidden_s2))
            cameras[k] = replace(cameras[k], t_d_std_s=t_d_std_s)
    return replace(answer, cameras=cameras)


def _contradicted(
    built_all: list[Built], links: Mapping[Pair, Link], max_closure_s: float
) -> dict[Pair, float]:
    """Give the pairs whose clocks the network contradicts, and by how much [s]."""
    off_s = {
        (a, b): float(links[a, b].offset_off_s(built.states[a], built.states[b])[0])
        for built in built_all
        for a, b in combinations(built.members, 2)
        if (a, b) in links and links[a, b].is_reliable
    }
    return {pair: off for pair, off in off_s.items() if abs(off) > max_closure_s}
