"""Clocks found pair by pair in; which of them contradict each other, and who is connected, out."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ssac.clock import Clock

Array = NDArray[np.float64]
Pair = tuple[int, int]
Triple = tuple[int, int, int]

MAX_CLOSURE_S = 0.25
"""Three clocks that go round to within this agree: readouts and wandering clocks stay below it, and
an offset found by chance is off by seconds."""


@dataclass(frozen=True, eq=False)
class Link:
    """What one pair of cameras (a, b) tells of both."""

    clock: Clock  # b's, by a's; its t_ref is in the middle of the common time
    is_reliable: bool  # by the estimate's own status; no: a guess
    cost: float  # how badly the two paths fit: the least of many is the best
    R: Array | None = None  # (3, 3) x_b = R x_a + t
    t: Array | None = None  # (3,) of length 1
    status: str = "ok"
    reason: str = ""

    def reversed(self) -> "Link":
        """Give what the pair (b, a) tells."""
        clock = self.clock.inverse()
        if self.R is None or self.t is None:
            return Link(clock, self.is_reliable, self.cost, None, None, self.status, self.reason)
        R, t = self.R.T, -self.R.T @ self.t
        return Link(clock, self.is_reliable, self.cost, R, t, self.status, self.reason)


def closures_s(clocks: Mapping[Pair, Clock]) -> dict[Triple, float]:
    """Go round each triple (a, b, c), a < b < c, of which all three pairs are answered.

    From a to b to c, less from a to c straight [s], at the reference time of (a, c).
    """
    cameras = sorted({camera for pair in clocks for camera in pair})
    found = {}
    for a, b, c in combinations(cameras, 3):
        if all(pair in clocks for pair in ((a, b), (b, c), (a, c))):
            time_s = clocks[a, c].t_ref_s
            round_about = clocks[b, c].cam2_from_cam1(clocks[a, b].cam2_from_cam1(time_s))
            found[a, b, c] = float(round_about - clocks[a, c].cam2_from_cam1(time_s))
    return found


def supports(links: Mapping[Pair, Link]) -> dict[Pair, int]:
    """Count, for each pair, the triples that close with it; -1 where it has some and none does.

    A wrong clock closes no triple, but by chance, and spoils those of others: these close with the
    cameras that are right.
    """
    closures = closures_s({pair: link.clock for pair, link in links.items()})
    found = dict[Pair, int]()
    for pair in links:
        around = [off for triple, off in closures.items() if set(pair) <= set(triple)]
        closing = sum(abs(off) <= MAX_CLOSURE_S for off in around)
        found[pair] = closing if closing or not around else -1
    return found


def groups(n_cameras: int, links: Mapping[Pair, Link]) -> list[list[int]]:
    """Give the cameras that reliable links connect, the largest group first; lone ones too."""
    parents = list(range(n_cameras))

    def root(camera: int) -> int:
        while parents[camera] != camera:
            camera = parents[camera]
        return camera

    for (a, b), link in links.items():
        if link.is_reliable:
            parents[max(root(a), root(b))] = min(root(a), root(b))
    found = dict[int, list[int]]()
    for camera in range(n_cameras):
        found.setdefault(root(camera), []).append(camera)
    return sorted(found.values(), key=lambda group: (-len(group), group))
