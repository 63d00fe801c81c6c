"""Clocks found pair by pair in; how far they contradict each other, round triples, out."""

from collections.abc import Mapping
from itertools import combinations

from ssac.clock import Clock

Pair = tuple[int, int]


def closures_s(clocks: Mapping[Pair, Clock]) -> dict[tuple[int, int, int], float]:
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
