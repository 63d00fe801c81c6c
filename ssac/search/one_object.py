"""The one object that all cameras saw, of several things that moved before them.

Nearly all recordings show one thing that moves, and pass as they are. Where a camera sees several,
those pieces of paths are taken that one epipolar geometry and one offset explain in both views.

Long chains of one view and of the other are paired, and all offsets are tried for each pair of
them, as far as whole bins of time go. What is best for some pair is a hypothesis: an offset and an
F. It is judged by the time in which any pieces of both views, of that chain or not, bear it out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

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


Pieces = tuple[list[Piece], list[Piece]]  # of both views
Chains = tuple[list[int], list[int]]  # places of pieces


class _Matching:
    """The pieces of both views on grids of half bins, and what they have in common."""

    def __init__(self, pieces: Pieces, interval_s: Interval | None, rules: Rules) -> None:
        """Take pieces, and the offsets [s] searched, as if both recordings started at a time."""
        self.pieces, self.interval_s = pieces, interval_s
        self.rules, self.match = rules, rules.match
        self.grids = [[self._sampled(piece) for piece in of_view] for of_view in pieces]

    def matches(self) -> list[Match]:
        """Find offsets at which pieces of both views are of one object, the best first."""
        one, other = (self._chains(of_view) for of_view in self.pieces)
        starts = [
            (cost, lag, chains)
            for chains in product(one, other)
            for cost, lag in self._minima(*self._joined(chains))
        ]
        starts.sort(key=lambda start: start[:2])
        found: list[Match] = []
        for _, lag, chains in starts[: self.match.starts]:
            F = lmeds_fundamental(*_common(*self._joined(chains), lag), self.match.trials)
            match = self._grown(lag, F, chains) if np.isfinite(F).all() else None
            found += [] if match is None else [match]
        left = sorted(found, key=lambda match: -match.common)
        kept: list[Match] = []  # one for each offset: of two that bear out the same, that of more
        while left:
            same = [one for one in left if abs(one.lag - left[0].lag) <= self.match.same_lag]
            often = [one for one in same if one.common >= self.match.as_often * same[0].common]
            kept.append(max(often, key=lambda match: match.n_events))
            left = [one for one in left if abs(one.lag - left[0].lag) > self.match.same_lag]
        return kept

    def both_see(self, lag: int) -> int:
        """Count the half bins in which both cameras see anything that moves, at an offset."""
        seen1, seen2 = (
            {k for piece in of_view for k in range(2 * piece.first, 2 * piece.last)}
            for of_view in self.pieces
        )
        return len(seen1 & {k - lag for k in seen2})

    def _chains(self, pieces: list[Piece]) -> list[list[int]]:
        """Longest chains, and the longest pieces by themselves: no wrong turn is in these."""
        chains = chains_of(pieces, self.rules.objects)[: self.match.max_chains]
        longest = np.argsort([-len(piece.positions_px) for piece in pieces], kind="stable")
        alone = [[int(i)] for i in longest[: self.match.max_alone]]
        return chains + [piece for piece in alone if piece not in chains]

    def _sampled(self, piece: Piece) -> Grid:
        """Sample a piece at half bins, in between by the mean of its neighbours."""
        positions = piece.positions_px
        sampled = np.empty((2 * len(positions) - 1, 2))
        sampled[::2], sampled[1::2] = positions, 0.5 * (positions[:-1] + positions[1:])
        known, least_px = np.isfinite(sampled[:, 0]), self.match.least_moved_px
        return Grid(2 * piece.first, np.nan_to_num(sampled), known, least_px)

    def _joined(self, chains: Chains) -> tuple[Grid, Grid]:
        """Put pieces that follow each other on one grid, of each view."""
        joined = []
        for of_view, chain in zip(self.grids, chains, strict=True):
            grids = [of_view[i] for i in chain]
            first, last = grids[0].first, grids[-1].first + len(grids[-1].valid)
            positions, valid = np.zeros((last - first, 2)), np.zeros(last - first, np.bool_)
            for grid in grids:
                part = slice(grid.first - first, grid.first - first + len(grid.valid))
                positions[part], valid[part] = grid.p_px, grid.valid
            joined.append(Grid(first, positions, valid, grids[0].least_px))
        return joined[0], joined[1]

    def _minima(self, one: Grid, other: Grid) -> list[tuple[float, int]]:
        """Find the costs of the best offsets of two chains, and these offsets [half bins]."""
        shift, half_bin_s = other.first - one.first, 0.5e-6 * self.rules.objects.bin_us
        first, last = 1 - len(one.valid), len(other.valid) - 1
        if self.interval_s is not None:
            low, high = (bound_s / half_bin_s - shift for bound_s in self.interval_s)
            first, last = max(first, int(np.ceil(low))), min(last, int(np.floor(high)))
        lags, match = np.arange(first, last + 1, dtype=np.int64), self.match
        least = match.least_pairs
        costs, counts = costs_at_lags(one, other, lags, match.pairs, least, match.iterations)
        shared = costs / np.maximum(counts, 1)
        best = local_minima(shared, match.minima)
        return [(float(shared[m]), int(lags[m]) + shift) for m in best]

    def _grown(self, lag: int, F: Array, chains: Chains) -> Match | None:
        """Take the pieces that bear an offset and an F out, refine both with these, and again."""
        best: Match | None = None
        for _ in range(self.match.rounds):
            most_px = np.inf
            if best is not None:
                most_px = self.match.firm_px + self.match.firm_times * best.distance_px
            taken = self._consistent(lag, F, chains, most_px)
            if not taken:
                return best
            p1, p2 = self._positions(taken, lag)
            if len(p1) < self.match.least_pairs:
                return best
            refit = reweighted_fundamental(p1, p2)
            if _distance_px(refit, p1, p2) < _distance_px(F, p1, p2):
                F = refit
            n_events = sum(
                float(np.sum(of_view[i].n_events))
                for of_view, numbers in zip(self.pieces, zip(*taken, strict=True), strict=True)
                for i in set(numbers)
            )
            best = Match(lag, F, tuple(taken), len(p1), n_events, _distance_px(F, p1, p2))
            refined = self._refined(best)
            lag, F = refined.lag, refined.F
        return best

    def _positions(self, pairs: Sequence[tuple[int, int]], lag: int) -> tuple[Array, Array]:
        """Join what the pieces of pairs have in common at an offset: positions (n, 2) of both."""
        of_each = [_common(self.grids[0][i], self.grids[1][j], lag) for i, j in pairs]
        p1, p2 = (np.concatenate(side) for side in zip(*of_each, strict=True))
        return p1, p2

    def _consistent(
        self, lag: int, F: Array, chains: Chains, most_px: float
    ) -> list[tuple[int, int]]:
        """Pairs of pieces near their epipolar lines, those of the chains first, one at a time."""
        order, match, (pieces1, pieces2) = [], self.match, self.pieces
        is_near: dict[tuple[int, int], bool] = {}
        firsts = np.array([other.first for other in self.grids[1]]) - lag
        lasts = firsts + [len(other.valid) for other in self.grids[1]]
        for i, one in enumerate(self.grids[0]):
            common = np.minimum(one.first + len(one.valid), lasts) - np.maximum(one.first, firsts)
            for j in map(int, np.flatnonzero(common >= match.least_common)):
                p1, p2 = _common(one, self.grids[1][j], lag)
                if len(p1) < match.least_common:
                    continue
                size_px = float(np.hypot(pieces1[i].size_px, pieces2[j].size_px))
                limit_px = min(match.near_px + match.near_share * size_px, most_px)
                is_near[i, j] = _distance_px(F, p1, p2) < limit_px
                order.append((-(i in chains[0]) - (j in chains[1]), -len(p1), i, j))
        taken: list[tuple[int, int]] = []
        for _, _, i, j in sorted(order):
            if is_near[i, j] and all(
                (k == i or not _meet(pieces1[i], pieces1[k]))
                and (m == j or not _meet(pieces2[j], pieces2[m]))
                and is_near.get((i, m), True)
                and is_near.get((k, j), True)
                for k, m in taken
            ):
                taken.append((i, j))
        return taken

    def _refined(self, match: Match) -> Match:
        """Shift the offset by half bins as long as its pieces then fit better."""
        best = match
        for lag in range(match.lag - 2, match.lag + 3):
            p1, p2 = self._positions(match.pairs, lag)
            if len(p1) < self.match.least_pairs:
                continue
            F = reweighted_fundamental(p1, p2)
            distance_px = _distance_px(F, p1, p2)
            if distance_px < best.distance_px:
                best = replace(match, lag=lag, F=F, distance_px=distance_px)
        return best


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


def _distance_px(F: Array, p1_px: Array, p2_px: Array) -> float:
    """Median distance of pairs (n, 2) from F."""
    return float(np.median(np.abs(sampson_distance(F, p1_px, p2_px))))


def _meet(one: Piece, other: Piece) -> bool:
    """Whether two pieces are seen at a time."""
    return one.first < other.last and other.first < one.last


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
    pieces, both = _chosen(objects, interval_s, rules), zip(cleans, objects, strict=True)
    if isinstance(pieces, Refusal):
        return tuple(replace(one, used=ObjectsUsed(of.n_seen, 0.0)) for one, of in both), pieces
    return tuple(_only(*two, one) for two, one in zip(both, pieces, strict=True)), None


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
    alone = [
        replace(objects[k], n_seen=1, pieces=[objects[k].pieces[i] for i in sorted(pieces[k])])
        for k in pair
    ]
    for k in set(range(len(objects))) - set(pair):
        found_by = [_matched(one, objects[k], interval_s, rules) for one in alone]
        fits = [one for one in found_by if isinstance(one, Match)]
        best = max(fits, key=lambda one: one.common, default=None)
        pieces[k] = set() if best is None else {both[1] for both in best.pairs}
    return [pieces[k] for k in range(len(objects))]


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
    start_us, bin_us = round(1e6 * start_s), rules.objects.bin_us
    return Objects(start_us, bin_us, False, 1, [piece], none.astype(np.int32))


def _matched(
    one: Objects, other: Objects, interval_s: Interval | None, rules: Rules
) -> Match | Refusal:
    """Match the pieces of two views at the offset that they bear out best."""
    start_s = 1e-6 * (other.start_us - one.start_us)  # of camera 2 after camera 1
    if interval_s is not None:
        interval_s = (interval_s[0] - start_s, interval_s[1] - start_s)
    matching = _Matching((one.pieces, other.pieces), interval_s, rules)
    found, match = matching.matches(), rules.match
    things = f"the cameras see {one.n_seen} and {other.n_seen} things at a time"
    needed_s, half_bin_s = match.min_common_s, 0.5e-6 * rules.objects.bin_us
    if found:
        needed_s = max(needed_s, match.min_share * half_bin_s * matching.both_see(found[0].lag))
    common_s = half_bin_s * found[0].common if found else 0.0
    if common_s < needed_s:
        reason = (
            f"{things}, and no two of them follow one epipolar geometry for more than"
            f" {common_s:.1f} s, of {needed_s:.1f} s needed, at any offset searched: record one"
            " object, or mask the others"
        )
        return Refusal(Status.SEVERAL_OBJECTS, reason)
    best = found[0]
    most_px = match.clearly * max(best.distance_px, match.least_distance_px)
    often = [one for one in found[1:] if one.common >= match.rival * best.common]
    rivals = [one for one in often if one.distance_px <= most_px]
    if not rivals:
        return best
    offsets_s = [start_s + half_bin_s * one.lag for one in [best, *rivals]]
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
    chosen, far_us = objects.events_of(pieces), 2**61  # before and after all times
    ends = np.array([(piece.first, piece.last) for piece in pieces], np.int64).ravel()
    ends_us = objects.start_us + objects.bin_us * ends
    # Between pieces, in order of time, and beyond all.
    gaps_us = np.concatenate([[-far_us], ends_us, [far_us]]).reshape(-1, 2)
    return replace(
        seen,
        events=seen.events.compress(chosen),
        clutter=None,
        on_line=None,
        gaps_us=np.asarray(gaps_us[gaps_us[:, 1] > gaps_us[:, 0]]),
        used=ObjectsUsed(objects.n_seen, float(np.mean(chosen))),
    )
