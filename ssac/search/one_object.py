"""The one object that all cameras saw, of several things that moved before them.

Nearly all recordings show one thing that moves, and pass as they are. Where a camera sees several,
those pieces of paths are taken that one epipolar geometry and one offset explain in both views.

Long chains of one view and of the other are paired, and all offsets are tried for each pair of
them, as far as whole bins of time go. What is best for some pair is a hypothesis: an offset and an
F. It is judged by the time in which any pieces of both views, of that chain or not, bear it out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ssac.config import Interval
from ssac.estimate import Refusal, Status
from ssac.geometry.epipolar import sampson_distance
from ssac.geometry.fundamental import lmeds_fundamental, reweighted_fundamental
from ssac.rules import Rules
from ssac.search.all_offsets import Grid, costs_at_lags, local_minima
from ssac.track.clean import Clean, ObjectsUsed
from ssac.track.motion import point_motion
from ssac.track.objects import Objects, Piece, chains_of, objects_of, seem_several

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Match:
    """An offset and an F, and the pieces of both views that bear them out."""

    lag: int  # half bins: t_d, as if both recordings started at a time
    F: Array  # (3, 3)
    pairs: tuple[tuple[int, int], ...]  # numbers of pieces of camera 1 and of camera 2
    common: int  # half bins in which they do
    n_events: float  # of them all
    distance_px: float  # their median


def matches(
    pieces1: list[Piece],
    pieces2: list[Piece],
    interval_s: tuple[float, float] | None,
    rules: Rules,
) -> list[Match]:
    """Find offsets at which pieces of both views are of one object, the best borne out first.

    The interval is of offsets [s], as if both recordings started at a time; None for any.
    """
    grids1, grids2 = (
        [_sampled(piece, rules.match.least_moved_px) for piece in pieces]
        for pieces in (pieces1, pieces2)
    )
    starts = []
    for chain1 in _candidates(pieces1, rules):
        one = _joined([grids1[i] for i in chain1])
        for chain2 in _candidates(pieces2, rules):
            other = _joined([grids2[j] for j in chain2])
            for cost, lag in _minima(one, other, interval_s, rules):
                starts.append((cost, lag, one, other, (chain1, chain2)))
    found: list[Match] = []
    for _, lag, one, other, chains in sorted(starts, key=lambda start: start[:2])[
        : rules.match.starts
    ]:
        F = lmeds_fundamental(*_common(one, other, lag), rules.match.trials)
        if np.isfinite(F).all():
            match = _grown(lag, F, (grids1, grids2), (pieces1, pieces2), chains, rules)
            found += [] if match is None else [match]
    return _distinct(sorted(found, key=lambda match: -match.common), rules)


def both_see(pieces1: list[Piece], pieces2: list[Piece], lag: int) -> int:
    """Count the half bins in which both cameras see anything that moves, at an offset."""
    seen1 = {k for piece in pieces1 for k in range(2 * piece.first, 2 * piece.last)}
    seen2 = {k - lag for piece in pieces2 for k in range(2 * piece.first, 2 * piece.last)}
    return len(seen1 & seen2)


def _candidates(pieces: list[Piece], rules: Rules) -> list[list[int]]:
    """Longest chains, and the longest pieces by themselves: no wrong turn is in these."""
    chains = chains_of(pieces, rules.objects)[: rules.match.max_chains]
    longest = np.argsort([-len(piece.positions_px) for piece in pieces], kind="stable")
    alone = [[int(i)] for i in longest[: rules.match.max_alone]]
    return chains + [piece for piece in alone if piece not in chains]


def _distinct(found: list[Match], rules: Rules) -> list[Match]:
    """Take one match for each offset: of two that bear out the same, that of more events."""
    kept: list[Match] = []
    left = found
    while left:
        same = [match for match in left if abs(match.lag - left[0].lag) <= rules.match.same_lag]
        left = [match for match in left if abs(match.lag - left[0].lag) > rules.match.same_lag]
        often = [match for match in same if match.common >= rules.match.as_often * same[0].common]
        kept.append(max(often, key=lambda match: match.n_events))
    return kept


def _sampled(piece: Piece, least_px: float) -> Grid:
    """Sample a piece at half bins, in between by the mean of its neighbours."""
    positions = piece.positions_px
    between = 0.5 * (positions[:-1] + positions[1:])
    sampled = np.empty((2 * len(positions) - 1, 2))
    sampled[::2], sampled[1::2] = positions, between
    return Grid(2 * piece.first, np.nan_to_num(sampled), np.isfinite(sampled[:, 0]), least_px)


def _joined(grids: list[Grid]) -> Grid:
    """Put pieces that follow each other on one grid."""
    first, last = grids[0].first, grids[-1].first + len(grids[-1].valid)
    positions, valid = np.zeros((last - first, 2)), np.zeros(last - first, np.bool_)
    for grid in grids:
        part = slice(grid.first - first, grid.first - first + len(grid.valid))
        positions[part], valid[part] = grid.p_px, grid.valid
    return Grid(first, positions, valid, grids[0].least_px)


def _minima(
    one: Grid, other: Grid, interval_s: tuple[float, float] | None, rules: Rules
) -> list[tuple[float, int]]:
    """Find the costs of the best offsets of two chains, and these offsets [half bins]."""
    shift, half_bin_s = other.first - one.first, 0.5e-6 * rules.objects.bin_us
    first, last = 1 - len(one.valid), len(other.valid) - 1
    if interval_s is not None:
        low, high = (bound_s / half_bin_s - shift for bound_s in interval_s)
        first, last = max(first, int(np.ceil(low))), min(last, int(np.floor(high)))
    lags = np.arange(first, last + 1, dtype=np.int64)
    match = rules.match
    costs, counts = costs_at_lags(
        one, other, lags, match.pairs, match.least_pairs, match.iterations
    )
    shared = costs / np.maximum(counts, 1)
    return [
        (float(shared[m]), int(lags[m]) + shift) for m in local_minima(shared, rules.match.minima)
    ]


def _common(one: Grid, other: Grid, lag: int) -> tuple[Array, Array]:
    """Positions (n, 2) of two paths at the half bins that both have, the second's `lag` later."""
    first = max(one.first, other.first - lag)
    last = min(one.first + len(one.valid), other.first - lag + len(other.valid))
    if last <= first:
        return np.empty((0, 2)), np.empty((0, 2))
    here = slice(first - one.first, last - one.first)
    there = slice(first + lag - other.first, last + lag - other.first)
    both = one.valid[here] & other.valid[there]
    return one.p_px[here][both], other.p_px[there][both]


def _grown(
    lag: int,
    F: Array,
    grids: tuple[list[Grid], list[Grid]],
    pieces: tuple[list[Piece], list[Piece]],
    chains: tuple[list[int], list[int]],
    rules: Rules,
) -> Match | None:
    """Take the pieces that bear an offset and an F out, refine both with these, and again."""
    best: Match | None = None
    for _ in range(rules.match.rounds):
        most_px = np.inf
        if best is not None:
            most_px = rules.match.firm_px + rules.match.firm_times * best.distance_px
        taken = _consistent(lag, F, grids, pieces, chains, most_px, rules)
        if not taken:
            return best
        positions = [_common(grids[0][i], grids[1][j], lag) for i, j in taken]
        p1, p2 = (np.concatenate(side) for side in zip(*positions, strict=True))
        if len(p1) < rules.match.least_pairs:
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
        refined = _refined(best, grids, rules)
        lag, F = refined.lag, refined.F
    return best


def _consistent(
    lag: int,
    F: Array,
    grids: tuple[list[Grid], list[Grid]],
    pieces: tuple[list[Piece], list[Piece]],
    chains: tuple[list[int], list[int]],
    most_px: float,
    rules: Rules,
) -> list[tuple[int, int]]:
    """Pairs of pieces near their epipolar lines, those of the chains first, one at a time."""
    order = []
    is_near: dict[tuple[int, int], bool] = {}
    firsts = np.array([other.first for other in grids[1]]) - lag
    lasts = firsts + [len(other.valid) for other in grids[1]]
    for i, one in enumerate(grids[0]):
        common = np.minimum(one.first + len(one.valid), lasts) - np.maximum(one.first, firsts)
        for j in map(int, np.flatnonzero(common >= rules.match.least_common)):
            p1, p2 = _common(one, grids[1][j], lag)
            if len(p1) < rules.match.least_common:
                continue
            size_px = float(np.hypot(pieces[0][i].size_px, pieces[1][j].size_px))
            limit_px = min(rules.match.near_px + rules.match.near_share * size_px, most_px)
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


def _refined(match: Match, grids: tuple[list[Grid], list[Grid]], rules: Rules) -> Match:
    """Shift the offset by half bins as long as its pieces then fit better."""
    best = match
    for lag in range(match.lag - 2, match.lag + 3):
        positions = [_common(grids[0][i], grids[1][j], lag) for i, j in match.pairs]
        p1, p2 = (np.concatenate(side) for side in zip(*positions, strict=True))
        if len(p1) < rules.match.least_pairs:
            continue
        F = reweighted_fundamental(p1, p2)
        distance_px = _distance_px(F, p1, p2)
        if distance_px < best.distance_px:
            best = replace(match, lag=lag, F=F, distance_px=distance_px)
    return best


def one_object(
    cleans: Sequence[Clean], rules: Rules, interval_s: Interval | None = None
) -> tuple[tuple[Clean, ...], Refusal | None]:
    """Choose the object that all cameras saw, where one of them saw several things at a time.

    Of cameras with noise in their events nothing is chosen: that hangs together too. The interval
    is of offsets between the clocks of two of them; None for any.

    Returns
    -------
    tuple
        Each camera with the events of that object alone, or as it is where all saw one thing; and
        why no object is told from the others, if so. Of more than two cameras, the two that bear
        out one object for longest say which it is; a further one that saw nothing of it has no
        events left.
    """
    seem = [one.denoised and seem_several(one.events, one.camera, rules.objects) for one in cleans]
    if not any(seem) or any(not one.has_track and len(one.events) == 0 for one in cleans):
        return tuple(cleans), None
    objects = [_objects(one, rules) for one in cleans]
    if not any(one.are_several for one, several in zip(objects, seem, strict=True) if several):
        return tuple(cleans), None
    pieces = _chosen(objects, interval_s, rules)
    if isinstance(pieces, Refusal):
        seen = [ObjectsUsed(one.n_seen, 0.0) for one in objects]
        return tuple(replace(one, used=n) for one, n in zip(cleans, seen, strict=True)), pieces
    return tuple(_only(*one) for one in zip(cleans, objects, pieces, strict=True)), None


def _chosen(
    objects: list[Objects], interval_s: Interval | None, rules: Rules
) -> list[set[int]] | Refusal:
    """Give the numbers of each camera's pieces that are one object's."""
    matched, refusals = dict[tuple[int, int], Match](), list[Refusal]()
    for a, b in combinations(range(len(objects)), 2):
        found = _matched(objects[a], objects[b], interval_s, rules)
        if isinstance(found, Refusal):
            refusals.append(found)
        else:
            matched[a, b] = found
    if not matched:
        return refusals[0]
    pair = max(matched, key=lambda one: matched[one].common)
    pieces = {k: {both[place] for both in matched[pair].pairs} for place, k in enumerate(pair)}
    alone = [_with_only(objects[k], pieces[k]) for k in pair]
    for k in set(range(len(objects))) - set(pair):
        found_by = [_matched(one, objects[k], interval_s, rules) for one in alone]
        fits = [one for one in found_by if isinstance(one, Match)]
        best = max(fits, key=lambda one: one.common, default=None)
        pieces[k] = set() if best is None else {both[1] for both in best.pairs}
    return [pieces[k] for k in range(len(objects))]


def _with_only(objects: Objects, numbers: set[int]) -> Objects:
    """Give what a camera saw without the other pieces."""
    return replace(objects, n_seen=1, pieces=[objects.pieces[i] for i in sorted(numbers)])


def _objects(seen: Clean, rules: Rules) -> Objects:
    """Follow the things that one camera saw; a track of points is that of one object."""
    if seen.track is None:
        return objects_of(seen.events, seen.camera, rules.objects)
    start_s, end_s = seen.span_s
    half_bin_s = 0.5e-6 * rules.objects.bin_us
    times_s = np.arange(start_s + half_bin_s, end_s, 2.0 * half_bin_s, np.float64)
    track = point_motion(seen.track, seen.camera, rules.points, half_bin_s).at(times_s)
    positions = np.where(track.valid[:, None], track.positions_px, np.nan)
    none = np.empty(0, np.int64)
    piece = Piece(0, positions, np.ones(len(times_s)), rules.match.track_size_px, none)
    return Objects(
        round(1e6 * start_s), rules.objects.bin_us, False, 1, [piece], none.astype(np.int32)
    )


def _matched(
    one: Objects, other: Objects, interval_s: Interval | None, rules: Rules
) -> Match | Refusal:
    """Match the pieces of two views at the offset that they bear out best."""
    start_s = 1e-6 * (other.start_us - one.start_us)  # of camera 2 after camera 1
    if interval_s is not None:
        interval_s = (interval_s[0] - start_s, interval_s[1] - start_s)
    found = matches(one.pieces, other.pieces, interval_s, rules)
    things = f"the cameras see {one.n_seen} and {other.n_seen} things at a time"
    pieces = one.pieces, other.pieces
    needed_s, half_bin_s = rules.match.min_common_s, 0.5e-6 * rules.objects.bin_us
    if found:
        needed_s = max(
            needed_s, rules.match.min_share * half_bin_s * both_see(*pieces, found[0].lag)
        )
    common_s = half_bin_s * found[0].common if found else 0.0
    if common_s < needed_s:
        reason = (
            f"{things}, and no two of them follow one epipolar geometry for more than"
            f" {common_s:.1f} s, of {needed_s:.1f} s needed, at any offset searched: record one"
            " object, or mask the others"
        )
        return Refusal(Status.SEVERAL_OBJECTS, reason)
    best = found[0]
    rivals = [
        match
        for match in found[1:]
        if match.common >= rules.match.rival * best.common
        and match.distance_px
        <= rules.match.clearly * max(best.distance_px, rules.match.least_distance_px)
    ]
    if not rivals:
        return best
    offsets_s = [start_s + half_bin_s * match.lag for match in [best, *rivals]]
    others = ", ".join(f"{offset_s:.2f}" for offset_s in offsets_s[1:6])
    reason = (
        f"{things}: two of them fit one epipolar geometry at an offset of {offsets_s[0]:.2f} s, and"
        f" others about as well at {others} s: record one object, or mask the others"
    )
    return Refusal(Status.SEVERAL_OBJECTS, reason, alternatives_s=tuple(sorted(offsets_s)))


def _only(seen: Clean, objects: Objects, numbers: set[int]) -> Clean:
    """Keep the events of some pieces alone."""
    if seen.track is not None:
        return seen
    pieces = [objects.pieces[i] for i in sorted(numbers)]
    chosen = objects.events_of(pieces)
    return replace(
        seen,
        events=seen.events.compress(chosen),
        clutter=None,
        on_line=None,
        gaps_us=_gaps_us(objects, pieces),
        used=ObjectsUsed(objects.n_seen, float(np.mean(chosen))),
    )


def _gaps_us(objects: Objects, pieces: list[Piece]) -> NDArray[np.int64]:
    """Give the times (g, 2) [us] between pieces, in order of time, and beyond all."""
    far_us = 2**61  # before and after all times
    ends = np.array([(piece.first, piece.last) for piece in pieces], np.int64).ravel()
    ends_us = objects.start_us + objects.bin_us * ends
    gaps_us = np.concatenate([[-far_us], ends_us, [far_us]]).reshape(-1, 2)
    return np.asarray(gaps_us[gaps_us[:, 1] > gaps_us[:, 0]])
