"""All cameras and what every pair told in; clocks, poses and paths of each connected group, out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ssac.camera import READOUT_STD_S, Camera
from ssac.clock import PPM, Clock
from ssac.estimate import Estimate, Status
from ssac.network.answers import CameraAnswer, PathAnswer, answer_of, left_out, path_of
from ssac.network.build import Built, build
from ssac.network.graph import MAX_CLOSURE_S, Link, Pair, Triple, closures_s, groups, told_by
from ssac.network.sightings import Sightings
from ssac.network.state import Priors
from ssac.search.all_offsets import Guess


@dataclass(frozen=True, eq=False)
class NetworkAnswer:
    """What is found of many cameras."""

    cameras: list[CameraAnswer]  # in input order
    links: dict[Pair, Link]
    closures_s: dict[Triple, float]
    wrong_pairs: dict[Pair, float]  # by how much [s] their clocks contradict the network
    built: list[Built]  # a network for each group
    paths: list[PathAnswer]  # theirs

    @property
    def status(self) -> Status:
        """Whether all cameras are in one network: `ok` if so."""
        if not self.built:
            return Status.NO_MATCH
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
            names = [" ".join(seen.name for seen in built.cameras) for built in self.built]
            said.append(f"no pair connects {' with '.join(names)}: a solution for each")
        said += [f"{c.name}: {c.reason}" for c in self.cameras if c.status != Status.OK]
        return "; ".join(said)


def link_of(estimate: Estimate, guess: Guess | None, of_events: bool = False) -> Link | None:
    """Say what a pair's estimate tells the network; None where it tells nothing.

    That of two event cameras tells of more than their sightings, and enters the adjustment too.
    """
    reliable = estimate.has_offset
    if reliable:
        t_ref_s = estimate.t_ref_s
        if not np.isfinite(t_ref_s):
            t_ref_s = 0.0 if guess is None else guess.t_ref_s
        skew_ppm = estimate.skew_ppm if np.isfinite(estimate.skew_ppm) else 0.0
        clock = Clock(estimate.t_d_s, skew_ppm, t_ref_s)  # what it strays is the network's to find
    elif guess is not None:
        clock = Clock(guess.t_d_s, guess.skew_ppm, guess.t_ref_s)
    else:
        return None
    is_ok = estimate.status == Status.OK
    cost = guess.cost if guess is not None else estimate.d_avg_px
    pose = (estimate.R, estimate.t) if is_ok else (None, None)
    told = told_by(estimate) if of_events else None
    return Link(clock, reliable, cost, *pose, str(estimate.status), estimate.reason, told)


def priors_of(camera: Camera, has_frames: bool, skew_prior_ppm: float) -> Priors:
    """Give the priors of a camera's parameters: by its rig, and by its kind of clock."""
    std = np.array(camera.intrinsics_std_px, dtype=np.float64)
    focal = std[:2] / np.diag(camera.K)[:2]
    return Priors(
        rate=PPM * skew_prior_ppm,
        readout_s=READOUT_STD_S if has_frames and camera.readout_s is None else 0.0,
        focal=(float(focal[0]), float(focal[1])),
        centre_px=(float(std[2]), float(std[3])),
    )


def solve_network(
    cameras: Sequence[Sightings],
    links: Mapping[Pair, Link],
    skew_prior_ppm: float,
    distance: float = 1.0,
) -> NetworkAnswer:
    """Find clocks and poses of all cameras, and the path that they saw.

    Parameters
    ----------
    cameras
        In input order.
    links
        What their pairs (a, b), a < b, tell; some may be wrong or missing.
    skew_prior_ppm
        Prior deviation of the clocks' skews.
    distance
        Between the first two cameras of each group.
    """
    listed = list(cameras)
    priors = [priors_of(seen.camera, seen.has_frames, skew_prior_ppm) for seen in listed]
    answers = [left_out(seen, 0, _LONELY) for seen in listed]
    built_all: list[Built] = []
    for group in groups(len(listed), links):
        if len(group) < 2:
            continue
        try:
            built, reason = build(listed, links, group, priors, distance), _NO_PATH
        except np.linalg.LinAlgError:
            built, reason = None, _OPEN
        if built is None:
            for k in group:
                answers[k] = left_out(listed[k], 0, reason)
            continue
        built_all.append(built)
        for place, k in enumerate(built.members):
            answers[k] = answer_of(built, place, len(built_all))
        for k in built.misfits:
            answers[k] = left_out(listed[k], 0, _MISFIT)
    closures = closures_s({pair: link.clock for pair, link in links.items()})
    return NetworkAnswer(
        answers,
        dict(links),
        closures,
        _contradicted(built_all, links),
        built_all,
        [path_of(built) for built in built_all],
    )


_LONELY = (
    "no pair with another camera gave a reliable offset: see the pairs, and check that it saw the "
    "same flight"
)
_NO_PATH = "no pair of its group gave a pose that puts the object in front of both cameras"
_OPEN = (
    "the object's path leaves clocks or poses of its group open, as one on a line or at rest does: "
    "record a flight with curves in it"
)
_MISFIT = (
    "it fits nowhere in the network that the others make: check its frame numbers, its frame rate "
    "and its calibration"
)


def _contradicted(built_all: list[Built], links: Mapping[Pair, Link]) -> dict[Pair, float]:
    """Give the pairs whose clocks the network contradicts, and by how much [s]."""
    found = {}
    for built in built_all:
        states = dict(zip(built.members, built.network.states, strict=True))
        for a, b in combinations(built.members, 2):
            link = links.get((a, b))
            if link is None:
                continue
            own_s = np.array([link.clock.t_ref_s])
            shown_s = states[b].own_from_network(states[a].network_from_own(own_s))
            off_s = float((link.clock.cam2_from_cam1(own_s) - shown_s)[0])
            if abs(off_s) > MAX_CLOSURE_S:
                found[a, b] = off_s
    return found
