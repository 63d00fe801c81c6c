"""Links between pairs of cameras: which contradict each other, and which cameras they connect.

The tangents of an object's outline are two-view constraints without the bias that limits the mean
of its events, on which the network's sightings rest. All tangents of a pair of event cameras enter
together: as the clock and the pose that fit them best, with the covariance of these.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from ssac.arrays import Array
from ssac.clock import PPM, Clock
from ssac.estimate import Estimate, Status
from ssac.geometry.pose import tangent_basis
from ssac.network.state import DELAY, RATE, ROTATION, TRANSLATION, CameraState
from ssac.rules import NetworkRules

Pair = tuple[int, int]
Triple = tuple[int, int, int]

_SIZE = 7  # offset, turn, direction, skew
_STEPS = {DELAY: 1e-6, RATE: 1e-9, **dict.fromkeys(range(ROTATION.start, TRANSLATION.stop), 1e-6)}
"""Steps of numerical derivatives of nearly linear functions, by place of a camera's parameter."""

_EXACT_PPM = 1e-3
"""Least deviation of a skew, of one that is exact too: clocks that run alike."""

_LATE_S = 2e3
"""Time from which on those of clocks grow with it: the last digits of times since 1970, some
0.2 us, would hide a step of the rate."""


@dataclass(frozen=True, eq=False)
class Link:
    """Clock and pose of camera b relative to camera a, as their pair (a, b) tells them."""

    clock: Clock  # b's relative to a's; its t_ref is in the middle of the common time
    is_reliable: bool  # the pair has an estimate of the offset; False: a guess
    cost: float  # misfit of the two tracks: the least is the best
    R: Array | None = None  # (3, 3) x_b = R x_a + t
    t: Array | None = None  # (3,) of length 1
    factor: Array | None = None
    """(7, 7) lower Cholesky factor of the covariance of offset [s], turn, direction [rad] and skew,
    for two event cameras whose tangents tell more than their sightings."""
    contradicts: bool = False  # what the pair sees contradicts the intrinsics in its rig

    def offset_off_s(self, a: CameraState, b: CameraState) -> Array:
        """Return the link's offset less that of two states (1,) [s]."""
        own_s = np.array([self.clock.t_ref_s])
        return self.clock.cam2_from_cam1(own_s) - b.own_from_network(a.network_from_own(own_s))

    def off(self, a: CameraState, b: CameraState) -> Array:
        """Return the link's offset, turn, direction and skew less those of two states (7,)."""
        told_R, told_t = np.asarray(self.R), np.asarray(self.t)
        R, t = _between(a, b)
        turn = Rotation.from_matrix(told_R @ R.T).as_rotvec()
        direction = tangent_basis(told_t) @ (told_t - t)
        skew = PPM * self.clock.skew_ppm - (1.0 - a.rate) / (1.0 - b.rate) + 1.0
        return np.concatenate([self.offset_off_s(a, b), turn, direction, [skew]])

    def rows(self, a: CameraState, b: CameraState) -> tuple[Array, Array, Array]:
        """Return derivatives (7, s) by a's and by b's parameters, and residuals (7,), whitened."""
        off = self.off(a, b)
        by_a = _slopes(lambda moved: self.off(moved, b), a)
        by_b = _slopes(lambda moved: self.off(a, moved), b)
        beside = np.column_stack([by_a, by_b, off])
        factor = np.asarray(self.factor)
        weighed = np.asarray(solve_triangular(factor, beside, lower=True), dtype=np.float64)
        return weighed[:, : a.size], weighed[:, a.size : -1], weighed[:, -1]


def _slopes(off: Callable[[CameraState], Array], state: CameraState) -> Array:
    """Return derivatives (7, s) of what a state predicts, by central differences."""
    by = np.zeros((_SIZE, state.size))
    late = max(1.0, abs(state.middle_s) / _LATE_S, abs(state.delay_s) / _LATE_S)
    for place, size in _STEPS.items():
        size *= late if place in (DELAY, RATE) else 1.0
        step = np.zeros(state.size)
        step[place] = size
        by[:, place] = (off(state.moved(-step)) - off(state.moved(step))) / (2.0 * size)
    return by


def closures_s(clocks: Mapping[Pair, Clock]) -> dict[Triple, float]:
    """Closure error [s] of each triple: a to b to c less a to c directly, at the latter's t_ref."""
    found = {}
    for a, b, c in combinations(sorted({camera for pair in clocks for camera in pair}), 3):
        if all(pair in clocks for pair in ((a, b), (b, c), (a, c))):
            straight = clocks[a, c]
            way_s = clocks[b, c].cam2_from_cam1(clocks[a, b].cam2_from_cam1(straight.t_ref_s))
            found[a, b, c] = float(way_s - straight.cam2_from_cam1(straight.t_ref_s))
    return found


def supports(links: Mapping[Pair, Link], rules: NetworkRules) -> dict[Pair, int]:
    """Count, for each pair, the triples whose clocks agree; -1 if it has triples, but no such."""
    closures = closures_s({pair: link.clock for pair, link in links.items()})
    found = dict[Pair, int]()
    for pair in links:
        around = [off for triple, off in closures.items() if set(pair) <= set(triple)]
        closing = sum(abs(off) <= rules.max_closure_s for off in around)
        found[pair] = closing if closing or not around else -1
    return found


def _between(a: CameraState, b: CameraState) -> tuple[Array, Array]:
    """Return R (3, 3) and the direction (3,) of t of camera b relative to a."""
    R = b.R @ a.R.T
    t = b.t - R @ a.t
    return R, t / np.linalg.norm(t)


def suspects(links: Mapping[Pair, Link]) -> set[int]:
    """Return the cameras in all pairs that contradict their rig; if none is, those in any of these.

    A wrong one contradicts half of its pairs or more: one of many, as of cameras that face each
    other, contradicts the rig by chance.
    """
    wrong = [pair for pair, link in links.items() if link.contradicts]
    anywhere = set[int]().union(*wrong)
    return {
        k
        for k in anywhere.intersection(*wrong) or anywhere
        if 2 * sum(k in pair for pair in wrong) >= sum(k in pair for pair in links)
    }


def groups(n_cameras: int, links: Mapping[Pair, Link]) -> list[list[int]]:
    """Return groups of cameras that reliable links connect, largest first; lone cameras too."""
    pairs = [pair for pair, link in links.items() if link.is_reliable]
    joined = np.zeros((n_cameras, n_cameras))
    joined[tuple(np.array(pairs, np.int64).reshape(-1, 2).T)] = 1.0
    n_groups, labels = connected_components(joined, directed=False)
    found = [np.flatnonzero(labels == k).tolist() for k in range(n_groups)]
    return sorted(found, key=lambda group: (-len(group), group))


def factor_of(estimate: Estimate) -> Array | None:
    """Return an estimate's covariance factor, as of `Link`; None where it has no covariance."""
    known = estimate.covariance
    if estimate.status != Status.OK or known is None or estimate.R is None:
        return None
    if not (np.isfinite(estimate.t_ref_s) and estimate.skew_std_ppm >= 0.0):
        return None
    covariance = np.zeros((_SIZE, _SIZE))
    covariance[:-1, :-1] = known
    covariance[-1, -1] = (PPM * max(estimate.skew_std_ppm, _EXACT_PPM)) ** 2
    deviations = np.sqrt(np.diag(covariance))
    try:  # scaled, as seconds and radians are of very different size
        factor = np.linalg.cholesky(covariance / np.outer(deviations, deviations))
    except np.linalg.LinAlgError:
        return None
    return np.asarray(deviations[:, None] * factor)


def agreeing(
    links: Mapping[Pair, Link], members: list[int], states: list[CameraState], rules: NetworkRules
) -> dict[Pair, Link]:
    """Return the links with a factor that nearly agree with the states, by places of these.

    A link tells an affine clock: it agrees with none that strays.
    """
    found, places = dict[Pair, Link](), {k: place for place, k in enumerate(members)}
    strays = {k for k, place in places.items() if len(states[place].knots_s)}
    for (a, b), link in links.items():
        if link.factor is not None and a in places and b in places and not strays & {a, b}:
            off = link.off(states[places[a]], states[places[b]])
            t = _between(states[places[a]], states[places[b]])[1]
            cosine = min(1.0, float(t @ np.asarray(link.t)))  # off has the sine, also of 179 deg
            turn_deg = np.rad2deg(max(np.linalg.norm(off[1:4]), np.arccos(cosine)))
            if abs(off[0]) < rules.max_off_s and turn_deg < rules.max_turn_deg:
                found[places[a], places[b]] = link
    return found


def shared_by(constraints: Mapping[Pair, Link]) -> dict[Pair, float]:
    """Return how many pairs share outlines with each: the mean of both cameras' counts."""
    counts = Counter(camera for pair in constraints for camera in pair)
    return {(a, b): 0.5 * (counts[a] + counts[b]) for a, b in constraints}
