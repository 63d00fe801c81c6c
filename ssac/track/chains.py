"""Pieces of paths in, chains of those that one thing may have gone, one after the other, out.

Where two things meet, both their pieces end, and new ones begin where they part. Which continues
which is told by where they lead, and by how large and how bright the image is: a guess, which the
two views have to bear out.
"""

import numpy as np
from numpy.typing import NDArray

from ssac.track.objects import Piece

Array = NDArray[np.float64]

_LONGEST_GAP = 30  # bins
_MEMORY = 6  # bins that tell a velocity
_MISS_PX, _MISS_PX_PER_BIN = 8.0, 2.5  # how far a path turns aside in a gap, besides
_DEAREST = 2.5  # of the links that are made


def chains_of(pieces: list[Piece]) -> list[list[int]]:
    """Link pieces, the likeliest first; of each chain the pieces' numbers in order of time.

    The chains come in the order of the bins in which they are seen, the longest first.
    """
    links = sorted(
        (cost, i, j)
        for i, one in enumerate(pieces)
        for j, other in enumerate(pieces)
        if one.last <= other.first <= one.last + _LONGEST_GAP
        if (cost := _cost(one, other)) < _DEAREST
    )
    following: dict[int, int] = {}
    taken: set[int] = set()
    for _, i, j in links:
        if i not in following and j not in taken:
            following[i] = j
            taken.add(j)
    chains = []
    for i in range(len(pieces)):
        if i in taken:
            continue
        chain = [i]
        while chain[-1] in following:
            chain.append(following[chain[-1]])
        chains.append(chain)
    return sorted(chains, key=lambda chain: -sum(len(pieces[i].positions_px) for i in chain))


def _cost(one: Piece, other: Piece) -> float:
    """How ill a piece continues another: 1 for each of what is ordinary."""
    gap = other.first - one.last + 1
    before, after = one.positions_px[-_MEMORY:], other.positions_px[:_MEMORY]
    steps_px = 0.5 * (_step_px(before) + _step_px(after))  # an even turn, in between
    miss_px = float(np.hypot(*(after[0] - before[-1] - gap * steps_px)))
    brighter = np.mean(other.n_events[:_MEMORY]) / np.mean(one.n_events[-_MEMORY:])
    larger = (other.size_px + 1.0) / (one.size_px + 1.0)
    unlike = abs(np.log(brighter)) / np.log(2.5) + abs(np.log(larger)) / np.log(1.6)
    return float(miss_px / (_MISS_PX + _MISS_PX_PER_BIN * gap) + unlike)


def _step_px(positions_px: Array) -> Array:
    """Velocity (2,) [px per bin] over positions (n, 2) of successive bins."""
    n = len(positions_px)
    return np.asarray((positions_px[-1] - positions_px[0]) / max(n - 1, 1))
