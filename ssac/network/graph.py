"""What pairs of cameras tell: which contradict each other, and who is connected by them.

The tangents of an object's outline are two-view constraints without the bias that limits the mean
of its events, which is what the network's sightings are. All tangents of a pair of event cameras
enter at once: by the clock and the pose that fit them best, and by the covariance of these.
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
"""By place of a camera's parameters: steps of the derivatives, all of functions nearly linear."""


@dataclass(frozen=True, eq=False)
class PairConstraint:
    """Clock and pose of camera b by camera a, and how sure they are."""

    clock: Clock
    R: Array  # (3, 3) x_b = R x_a + t
    t: Array  # (3,) of length 1
    factor: Array  # (7, 7) lower: of the covariance of offset [s], turn, direction [rad], skew

    def off(self, a: CameraState, b: CameraState) -> Array:
        """Give what it tells less what two states say (7,): of offset, turn, direction and skew."""
        own_s = np.array([self.clock.t_ref_s])
        shown_s = b.own_from_network(a.network_from_own(own_s))
        R = b.R @ a.R.T
        t = b.t - R @ a.t
        t = t / np.linalg.norm(t)
        return np.concatenate(
            [
                self.clock.cam2_from_cam1(own_s) - shown_s,
                Rotation.from_matrix(self.R @ R.T).as_rotvec(),
                tangent_basis(self.t) @ (self.t - t),
                [PPM * self.clock.skew_ppm - (1.0 - a.rate) / (1.0 - b.rate) + 1.0],
            ]
        )

    def fits(self, a: CameraState, b: CameraState, rules: NetworkRules) -> bool:
        """Whether two states are near what it tells."""
        off = self.off(a, b)
        turn_deg = np.rad2deg(np.linalg.norm(off[1:4]))
        return bool(abs(off[0]) < rules.max_off_s and turn_deg < rules.max_turn_deg)

    def rows(self, a: CameraState, b: CameraState) -> tuple[Array, Array, Array]:
        """Give derivatives (7, s) by a's and by b's parameters, and residuals (7,), all weighed."""
        off = self.off(a, b)
        by_a = _slopes(lambda moved: self.off(moved, b), a)
        by_b = _slopes(lambda moved: self.off(a, moved), b)
        beside = np.column_stack([by_a, by_b, off])
        weighed = np.asarray(solve_triangular(self.factor, beside, lower=True), dtype=np.float64)
        return weighed[:, : a.size], weighed[:, a.size : -1], weighed[:, -1]


def _slopes(off: Callable[[CameraState], Array], state: CameraState) -> Array:
    """Give derivatives (7, s), of what a state says, by differences."""
    by = np.zeros((_SIZE, state.size))
    for place, size in _STEPS.items():
        step = np.zeros(state.size)
        step[place] = size
        by[:, place] = (off(state.moved(-step)) - off(state.moved(step))) / (2.0 * size)
    return by


@dataclass(frozen=True, eq=False)
class Link:
    """What one pair of cameras (a, b) tells of both."""

    clock: Clock  # b's, by a's; its t_ref is in the middle of the common time
    is_reliable: bool  # by the estimate's own status; no: a guess
    cost: float  # how badly the two paths fit: the least of many is the best
    R: Array | None = None  # (3, 3) x_b = R x_a + t
    t: Array | None = None  # (3,) of length 1
    constraint: PairConstraint | None = None  # of two event cameras: how sure clock and pose are

    def reversed(self) -> "Link":
        """Give what the pair (b, a) tells."""
        R, t = (None, None) if self.R is None or self.t is None else (self.R.T, -self.R.T @ self.t)
        return Link(self.clock.inverse(), self.is_reliable, self.cost, R, t)


def closures_s(clocks: Mapping[Pair, Clock]) -> dict[Triple, float]:
    """Go from a to b to c, less from a to c straight [s] at its t_ref, in each triple."""
    found = {}
    for a, b, c in combinations(sorted({camera for pair in clocks for camera in pair}), 3):
        if all(pair in clocks for pair in ((a, b), (b, c), (a, c))):
            straight = clocks[a, c]
            way_s = clocks[b, c].cam2_from_cam1(clocks[a, b].cam2_from_cam1(straight.t_ref_s))
            found[a, b, c] = float(way_s - straight.cam2_from_cam1(straight.t_ref_s))
    return found


def supports(links: Mapping[Pair, Link], rules: NetworkRules) -> dict[Pair, int]:
    """Count the triples that close with each pair, as wrong clocks do not; -1: none of some."""
    closures = closures_s({pair: link.clock for pair, link in links.items()})
    found = dict[Pair, int]()
    for pair in links:
        around = [off for triple, off in closures.items() if set(pair) <= set(triple)]
        closing = sum(abs(off) <= rules.max_closure_s for off in around)
        found[pair] = closing if closing or not around else -1
    return found


def groups(n_cameras: int, links: Mapping[Pair, Link]) -> list[list[int]]:
    """Give the cameras that reliable links connect, the largest group first; lone ones too."""
    pairs = [pair for pair, link in links.items() if link.is_reliable]
    joined = np.zeros((n_cameras, n_cameras))
    joined[tuple(np.array(pairs, np.int64).reshape(-1, 2).T)] = 1.0
    n_groups, labels = connected_components(joined, directed=False)
    found = [np.flatnonzero(labels == k).tolist() for k in range(n_groups)]
    return sorted(found, key=lambda group: (-len(group), group))


def constraint_of(estimate: Estimate) -> PairConstraint | None:
    """Take what an estimate tells of clock and pose; None of one without their covariance."""
    known, R, t = estimate.covariance, estimate.R, estimate.t
    if estimate.status != Status.OK or known is None or R is None or t is None:
        return None
    if not (np.isfinite(estimate.t_ref_s) and estimate.skew_std_ppm > 0.0):
        return None
    covariance = np.zeros((_SIZE, _SIZE))
    covariance[:-1, :-1] = known
    covariance[-1, -1] = (PPM * estimate.skew_std_ppm) ** 2
    deviations = np.sqrt(np.diag(covariance))
    try:  # scaled, as seconds and radians are of very different size
        factor = np.linalg.cholesky(covariance / np.outer(deviations, deviations))
    except np.linalg.LinAlgError:
        return None
    clock = Clock(estimate.t_d_s, estimate.skew_ppm, estimate.t_ref_s)
    return PairConstraint(clock, R, t, deviations[:, None] * factor)


def agreeing(
    constraints: Mapping[Pair, PairConstraint],
    members: list[int],
    states: list[CameraState],
    rules: NetworkRules,
) -> dict[Pair, PairConstraint]:
    """Give the pairs of members that tell nearly what the states say, by places among these."""
    places = {k: place for place, k in enumerate(members)}
    return {
        (places[a], places[b]): one
        for (a, b), one in constraints.items()
        if a in places and b in places and one.fits(states[places[a]], states[places[b]], rules)
    }


def shared_by(constraints: Mapping[Pair, PairConstraint]) -> dict[Pair, float]:
    """Say for how many pairs each stands that share outlines: the mean of both cameras' pairs."""
    counts = Counter(camera for pair in constraints for camera in pair)
    return {(a, b): 0.5 * (counts[a] + counts[b]) for a, b in constraints}
