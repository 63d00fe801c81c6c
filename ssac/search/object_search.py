"""The pieces of paths that two cameras saw in; those that are one object, at one offset, out.

Long chains of one view and of the other are paired, and all offsets are tried for each pair of
them, as far as whole bins of time go. What is best for some pair is a hypothesis: an offset and an
F. It is judged by the time in which any pieces of both views, of that chain or not, bear it out.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.fundamental import lmeds_fundamental, reweighted_fundamental
from ssac.search.lag_costs import costs_at_lags, local_minima
from ssac.track.objects import BIN_US, Piece, chains_of

Array = NDArray[np.float64]

HALF_BIN_S = 0.5e-6 * BIN_US
"""Step of the offsets that are told from each other [s]."""

_CHAINS, _ALONE = 3, 2  # of each view: the longest chains, and the longest pieces
_MINIMA = 2  # of each pair's cost
_STARTS = 16  # of all pairs, that are looked into
_SAME = 2  # half bins between offsets that are one
_AS_OFTEN = 0.6  # of the time that another object is seen
_PAIRS, _ITERATIONS = 120, 4  # of a fit
_LEAST_PAIRS = 60  # half bins that a pair of chains has in common
_LEAST_PX = (1.0, 1.0)  # that both move between samples that count
_TRIALS = 1000
_LEAST_COMMON = 8  # half bins of two pieces that tell whether they are one object's
_NEAR_PX, _NEAR = 1.5, 0.2  # distance of pieces of one object: plus a share of their sizes
_FIRM_PX, _FIRM = 1.0, 8.0  # the same once there is a match: plus a share of its distance
_ROUNDS = 3


@dataclass(frozen=True)
class Match:
    """An offset and an F, and the pieces of both views that bear them out."""

    lag: int  # half bins: t_d, as if both recordings started at a time
    F: Array  # (3, 3)
    pairs: tuple[tuple[int, int], ...]  # numbers of pieces of camera 1 and of camera 2
    common: int  # half bins in which they do
    n_events: float  # of them all
    distance_px: float  # their median


@dataclass(frozen=True)
class _Grid:
    """Paths sampled at half bins."""

    first: int  # half bins from the recording's start
    positions_px: Array  # (n, 2)
    valid: NDArray[np.bool_]  # (n,)


def matches(
    pieces1: list[Piece], pieces2: list[Piece], interval_s: tuple[float, float] | None
) -> list[Match]:
    """Find offsets at which pieces of both views are of one object, the best borne out first.

    Parameters
    ----------
    pieces1, pieces2
        Of camera 1 and of camera 2.
    interval_s
        Least and largest offset [s], as if both recordings started at a time; None for any.
    """
    grids1, grids2 = list(map(_grid, pieces1)), list(map(_grid, pieces2))
    starts = []
    for chain1 in _candidates(pieces1):
        one = _joined([grids1[i] for i in chain1])
        for chain2 in _candidates(pieces2):
            other = _joined([grids2[j] for j in chain2])
            for cost, lag in _minima(one, other, interval_s):
                starts.append((cost, lag, one, other, (chain1, chain2)))
    found: list[Match] = []
    for _, lag, one, other, chains in sorted(starts, key=lambda start: start[:2])[:_STARTS]:
        F = lmeds_fundamental(*_common(one, other, lag), _TRIALS)
        if np.isfinite(F).all():
            match = _grown(lag, F, (grids1, grids2), (pieces1, pieces2), chains)
            found += [] if match is None else [match]
    return _distinct(sorted(found, key=lambda match: -match.common))


def both_see(pieces1: list[Piece], pieces2: list[Piece], lag: int) -> int:
    """Count the half bins in which both cameras see anything that moves, at an offset."""
    seen1 = {k for piece in pieces1 for k in range(2 * piece.first, 2 * piece.last)}
    seen2 = {k - lag for piece in pieces2 for k in range(2 * piece.first, 2 * piece.last)}
    return len(seen1 & seen2)


def _candidates(pieces: list[Piece]) -> list[list[int]]:
    """Longest chains, and the longest pieces by themselves: no wrong turn is in these."""
    chains = chains_of(pieces)[:_CHAINS]
    longest = np.argsort([-len(piece.positions_px) for piece in pieces], kind="stable")
    alone = [[int(i)] for i in longest[:_ALONE]]
    return chains + [piece for piece in alone if piece not in chains]


def _distinct(found: list[Match]) -> list[Match]:
    """Take one match for each offset: of two objects that bear out the same, that of more events.

    The other has to be seen for most of the time that the best borne out is.
    """
    kept: list[Match] = []
    left = found
    while left:
        same = [match for match in left if abs(match.lag - left[0].lag) <= _SAME]
        left = [match for match in left if abs(match.lag - left[0].lag) > _SAME]
        often = [match for match in same if match.common >= _AS_OFTEN * same[0].common]
        kept.append(max(often, key=lambda match: match.n_events))
    return kept


def _grid(piece: Piece) -> _Grid:
    """Sample a piece at half bins, in between by the mean of its neighbours."""
    positions = piece.positions_px
    between = 0.5 * (positions[:-1] + positions[1:])
    sampled = np.empty((2 * len(positions) - 1, 2))
    sampled[::2], sampled[1::2] = positions, between
    return _Grid(2 * piece.first, np.nan_to_num(sampled), np.isfinite(sampled[:, 0]))


def _joined(grids: list[_Grid]) -> _Grid:
    """Put pieces that follow each other on one grid."""
    first, last = grids[0].first, grids[-1].first + len(grids[-1].valid)
    positions, valid = np.zeros((last - first, 2)), np.zeros(last - first, np.bool_)
    for grid in grids:
        part = slice(grid.first - first, grid.first - first + len(grid.valid))
        positions[part], valid[part] = grid.positions_px, grid.valid
    return _Grid(first, positions, valid)


def _minima(
    one: _Grid, other: _Grid, interval_s: tuple[float, float] | None
) -> list[tuple[float, int]]:
    """Find the costs of the best offsets of two chains, and these offsets [half bins].

    The more path they have in common, the less an offset costs.
    """
    shift = other.first - one.first
    first, last = 1 - len(one.valid), len(other.valid) - 1
    if interval_s is not None:
        low, high = (bound_s / HALF_BIN_S - shift for bound_s in interval_s)
        first, last = max(first, int(np.ceil(low))), min(last, int(np.floor(high)))
    lags = np.arange(first, last + 1, dtype=np.int64)
    costs, counts = costs_at_lags(
        one.positions_px,
        one.valid,
        other.positions_px,
        other.valid,
        lags,
        _LEAST_PX,
        _PAIRS,
        _LEAST_PAIRS,
        _ITERATIONS,
    )
    shared = costs / np.maximum(counts, 1)
    return [(float(shared[m]), int(lags[m]) + shift) for m in local_minima(shared, _MINIMA)]


def _common(one: _Grid, other: _Grid, lag: int) -> tuple[Array, Array]:
    """Positions (n, 2) of two paths at the half bins that both have, the second's `lag` later."""
    first = max(one.first, other.first - lag)
    last = min(one.first + len(one.valid), other.first - lag + len(other.valid))
    if last <= first:
        return np.empty((0, 2)), np.empty((0, 2))
    here = slice(first - one.first, last - one.first)
    there = slice(first + lag - other.first, last + lag - other.first)
    both = one.valid[here] & other.valid[there]
    return one.positions_px[here][both], other.positions_px[there][both]


def _grown(
    lag: int,
    F: Array,
    grids: tuple[list[_Grid], list[_Grid]],
    pieces: tuple[list[Piece], list[Piece]],
    chains: tuple[list[int], list[int]],
) -> Match | None:
    """Take the pieces that bear an offset and an F out, refine both with these, and again."""
    best: Match | None = None
    for _ in range(_ROUNDS):
        most_px = np.inf if best is None else _FIRM_PX + _FIRM * best.distance_px
        taken = _consistent(lag, F, grids, pieces, chains, most_px)
        if not taken:
            return best
        positions = [_common(grids[0][i], grids[1][j], lag) for i, j in taken]
        p1, p2 = (np.concatenate(side) for side in zip(*positions, strict=True))
        if len(p1) < _LEAST_PAIRS:
            return best
        refit = reweighted_fundamental(p1, p2)
        if _distance_px(refit, p1, p2) < _distance_px(F, p1, p2):
            F = refit
        n_events = sum(
            float(np.sum(pieces[k][i].n_events))
            for k in range(2)
            for i in {pair[k] for pair in taken}
        )
        best = Match(lag, F, tuple(taken), len(p1), n_events, _distance_px(F, p1, p2))
        refined = _refined(best, grids)
        lag, F = refined.lag, refined.F
    return best


def _consistent(
    lag: int,
    F: Array,
    grids: tuple[list[_Grid], list[_Grid]],
    pieces: tuple[list[Piece], list[Piece]],
    chains: tuple[list[int], list[int]],
    most_px: float,
) -> list[tuple[int, int]]:
    """Pairs of pieces near their epipolar lines, those of the chains first; one at a time a view.

    A piece is taken whole: it has to be consistent with all of the other view that it meets.
    """
    order = []
    is_near: dict[tuple[int, int], bool] = {}
    firsts = np.array([other.first for other in grids[1]]) - lag
    lasts = firsts + [len(other.valid) for other in grids[1]]
    for i, one in enumerate(grids[0]):
        common = np.minimum(one.first + len(one.valid), lasts) - np.maximum(one.first, firsts)
        for j in map(int, np.flatnonzero(common >= _LEAST_COMMON)):
            p1, p2 = _common(one, grids[1][j], lag)
            if len(p1) < _LEAST_COMMON:
                continue
            size_px = float(np.hypot(pieces[0][i].size_px, pieces[1][j].size_px))
            limit_px = min(_NEAR_PX + _NEAR * size_px, most_px)
            is_near[i, j] = _distance_px(F, p1, p2) < limit_px
            order.append((-(i in chains[0]) - (j in chains[1]), -len(p1), i, j))
    taken: list[tuple[int, int]] = []
    for _, _, i, j in sorted(order):
        if is_near[i, j] and all(
            (k == i or not _meet(pieces[0][i], pieces[0][k]))
            and (m == j or not _meet(pieces[1][j], pieces[1][m]))
            and is_near.get((i, m), True)
            and is_near.get((k, j), True)
            for k, m in taken
        ):
            taken.append((i, j))
    return taken


def _distance_px(F: Array, p1_px: Array, p2_px: Array) -> float:
    """Median distance of pairs (n, 2) from F."""
    return float(np.median(np.abs(sampson_distance(F, p1_px, p2_px))))


def _meet(one: Piece, other: Piece) -> bool:
    """Whether two pieces are seen at a time."""
    return one.first < other.last and other.first < one.last


def _refined(match: Match, grids: tuple[list[_Grid], list[_Grid]]) -> Match:
    """Shift the offset by half bins as long as its pieces then fit better."""
    best = match
    for lag in range(match.lag - 2, match.lag + 3):
        positions = [_common(grids[0][i], grids[1][j], lag) for i, j in match.pairs]
        p1, p2 = (np.concatenate(side) for side in zip(*positions, strict=True))
        if len(p1) < _LEAST_PAIRS:
            continue
        F = reweighted_fundamental(p1, p2)
        distance_px = _distance_px(F, p1, p2)
        if distance_px < best.distance_px:
            best = replace(match, lag=lag, F=F, distance_px=distance_px)
    return best
