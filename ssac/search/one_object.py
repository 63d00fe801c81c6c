"""The choice of the one object that all cameras saw, where several moved before them.

Nearly all recordings show one moving object, and pass unchanged. Where a camera sees several, those
pieces of paths are taken that one epipolar geometry and one offset explain in both views.

All offsets are tried in steps of a bin. At each, a piece of one view and a piece of the other, seen
at the same time, are a pair. Each of the longest pairs, and every two of them, give an F: one pair
often fits many. The hypotheses, each an offset and an F, are first ranked by how long any pieces
support them, and the best then by how long pieces that may be one object's do.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, combinations_with_replacement

import numba
import numpy as np

from ssac.arrays import Array, IntArray
from ssac.config import N_MIN, Interval
from ssac.estimate import Refusal, Status
from ssac.geometry.epipolar import distances_of
from ssac.geometry.fundamental import reweighted_fundamental
from ssac.rules import Rules
from ssac.search.all_offsets import Grid
from ssac.track.clean import Clean, ObjectsUsed
from ssac.track.motion import point_motion
from ssac.track.objects import Objects, Piece, objects_of, seem_several


@dataclass(frozen=True)
class Match:
    """An offset and an F, and the pieces of both views that bear them out."""

    lag: int  # t_d in half bins, as if both recordings started together
    F: Array  # (3, 3)
    pairs: tuple[tuple[int, int], ...]  # numbers of pieces of camera 1 and of camera 2
    common: int  # half bins in which both pieces of a pair are seen, summed over the pairs
    n_events: float  # of all these pieces
    distance_px: float  # median Sampson distance of the pairs' positions from F


SCALE_PX = 100.0  # unit that makes coordinates about 1, as Hartley's normalisation does


class _Matching:
    """The search for pieces of both views that are one object's, on grids of half bins."""

    def __init__(
        self, pieces: tuple[list[Piece], list[Piece]], interval_s: Interval | None, rules: Rules
    ) -> None:
        """Take pieces, and the offsets [s] searched, as if both recordings started together."""
        self.pieces, self.interval_s = pieces, interval_s
        self.rules, self.match = rules, rules.match
        self.grids = [[self._sampled(piece) for piece in of_view] for of_view in pieces]

    def matches(self) -> list[Match]:
        """Find offsets at which pieces of both views are of one object, the best first."""
        found = [match for lag, F in self._starts() if (match := self._grown(lag, F)) is not None]
        left = sorted(found, key=lambda match: -match.common)
        kept: list[Match] = []  # one for each offset: of equally good ones, that of most events
        while left:
            same = [one for one in left if abs(one.lag - left[0].lag) <= self.match.same_lag]
            often = [one for one in same if one.common >= self.match.as_often * same[0].common]
            most_px = self.match.as_near * min(one.distance_px for one in often)
            often = [one for one in often if one.distance_px <= most_px]
            kept.append(max(often, key=lambda match: match.n_events))
            left = [one for one in left if abs(one.lag - left[0].lag) > self.match.same_lag]
        return kept

    def both_see(self, lag: int) -> int:
        """Count the half bins in which both cameras see anything that moves, at an offset."""
        seen1, seen2 = (
            {
                2 * (piece.first + k) + half
                for piece in of_view
                for k in np.flatnonzero(np.isfinite(piece.positions_px[:, 0])).tolist()
                for half in (0, 1)
            }
            for of_view in self.pieces
        )
        return len(seen1 & {k - lag for k in seen2})

    def _sampled(self, piece: Piece) -> Grid:
        """Sample a piece at half bins: between bins it is the mean of its neighbours."""
        positions = piece.positions_px
        sampled = np.empty((max(2 * len(positions) - 1, 0), 2))
        sampled[::2], sampled[1::2] = positions, 0.5 * (positions[:-1] + positions[1:])
        return Grid(2 * piece.first, np.nan_to_num(sampled), np.isfinite(sampled[:, 0]))

    def _starts(self) -> list[tuple[int, Array]]:
        """Find the offsets [half bins] that pieces bear out for longest, with the F of each."""
        starts = sorted(
            (start for lag in self._lags() if (start := self._start(lag)) is not None),
            key=lambda start: start[:2],
        )
        kept: list[tuple[int, Array]] = []
        for _, lag, F in starts:
            if all(abs(lag - other) > self.match.same_lag for other, _ in kept):
                kept.append((lag, F))
        return kept[: self.match.starts]

    def _lags(self) -> range:
        """Offsets [half bins] to try, at which pieces of both views may overlap in time."""
        spans = [
            (min(one.first for one in grids), max(one.first + len(one.valid) for one in grids))
            for grids in self.grids
            if grids
        ]
        if len(spans) < 2:
            return range(0)
        first, last = spans[1][0] - spans[0][1], spans[1][1] - spans[0][0]
        if self.interval_s is not None:
            low, high = (bound / (0.5e-6 * self.rules.objects.bin_us) for bound in self.interval_s)
            first, last = max(first, int(np.ceil(low))), min(last, int(np.floor(high)))
        return range(first, last + 1, self.match.lag_step)

    def _start(self, lag: int) -> tuple[float, int, Array] | None:
        """Find the F that pieces bear out for longest at an offset: (-length, lag, F)."""
        match = self.match
        together = sorted(self._together(lag), key=lambda pair: -len(pair[2]))[: match.max_pairs]
        lengths = np.array([len(p1) for _, _, p1, _ in together])
        if np.sum(lengths) < match.least_pairs:
            return None
        at = np.linspace(0, lengths - 1, match.points, axis=1).astype(np.int64)
        x1, T1 = _centred(np.stack([p1[k] for k, (_, _, p1, _) in zip(at, together, strict=True)]))
        x2, T2 = _centred(np.stack([p2[k] for k, (_, _, _, p2) in zip(at, together, strict=True)]))
        h1, h2 = (np.insert(x, 2, 1.0, axis=-1) for x in (x1, x2))
        products = (h2[..., :, None] * h1[..., None, :]).reshape(*x1.shape[:2], 9)
        moments = np.einsum("npi,npj->nij", products, products)
        longest = range(min(match.long_pairs, len(together)))
        a, b = np.array(list(combinations_with_replacement(longest, 2))).T
        _, vectors = np.linalg.eigh(moments[a] + moments[b])
        limits_px = np.array([self._near_px(i, j) for i, j, _, _ in together])
        places = np.array([i for i, *_ in together])
        Fs = np.ascontiguousarray(vectors[:, :, 0])
        best, F = _most_borne_out(Fs, x1, x2, limits_px / SCALE_PX, lengths, places)
        return -best, lag, T2.T @ F.reshape(3, 3) @ T1

    def _together(self, lag: int) -> Iterator[tuple[int, int, Array, Array]]:
        """Yield the pairs that overlap at an offset: their numbers, and common positions (n, 2)."""
        firsts = np.array([other.first for other in self.grids[1]]) - lag
        lasts = firsts + [len(other.valid) for other in self.grids[1]]
        for i, one in enumerate(self.grids[0]):
            common = np.minimum(one.first + len(one.valid), lasts) - np.maximum(one.first, firsts)
            for j in map(int, np.flatnonzero(common >= self.match.least_common)):
                p1, p2 = _common(one, self.grids[1][j], lag)
                if len(p1) >= self.match.least_common:
                    yield i, j, p1, p2

    def _near_px(self, i: int, j: int) -> float:
        """Largest distance from the epipolar lines at which a pair may be of one object."""
        size_px = float(np.hypot(self.pieces[0][i].size_px, self.pieces[1][j].size_px))
        return self.match.near_px + self.match.near_share * size_px

    def _grown(self, lag: int, F: Array) -> Match | None:
        """Find, in rounds, the pairs that bear out an offset and an F, and refine both by them."""
        best: Match | None = None
        for _ in range(self.match.rounds):
            most_px = np.inf
            if best is not None:
                most_px = self.match.firm_px + self.match.firm_times * best.distance_px
            taken = self._consistent(lag, F, most_px)
            if not taken:
                return best
            p1, p2 = self._positions(taken, lag)
            if len(p1) < self.match.least_pairs:
                return best
            refit = reweighted_fundamental(p1, p2)
            if _median_distance(refit, p1, p2) < _median_distance(F, p1, p2):
                F = refit
            n_events = sum(
                float(np.sum(of_view[i].n_events))
                for of_view, numbers in zip(self.pieces, zip(*taken, strict=True), strict=True)
                for i in set(numbers)
            )
            best = Match(lag, F, tuple(taken), len(p1), n_events, _median_distance(F, p1, p2))
            refined = self._refined(best)
            lag, F = refined.lag, refined.F
        return best

    def _positions(self, pairs: Sequence[tuple[int, int]], lag: int) -> tuple[Array, Array]:
        """Join the common positions (n, 2) of all pairs at an offset, in both views."""
        of_each = [_common(self.grids[0][i], self.grids[1][j], lag) for i, j in pairs]
        p1, p2 = (np.concatenate(side) for side in zip(*of_each, strict=True))
        return p1, p2

    def _consistent(self, lag: int, F: Array, most_px: float) -> list[tuple[int, int]]:
        """Choose pairs near their epipolar lines, the longest first, that may be of one object."""
        order, (pieces1, pieces2) = [], self.pieces
        is_near: dict[tuple[int, int], bool] = {}
        for i, j, p1, p2 in self._together(lag):
            is_near[i, j] = _median_distance(F, p1, p2) < min(self._near_px(i, j), most_px)
            order.append((-len(p1), i, j))
        taken: list[tuple[int, int]] = []
        for _, i, j in sorted(order):
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
        """Find the offset within two half bins that fits the pairs best, with an F for each."""
        best = match
        for lag in range(match.lag - 2, match.lag + 3):
            p1, p2 = self._positions(match.pairs, lag)
            if len(p1) < self.match.least_pairs:
                continue
            F = reweighted_fundamental(p1, p2)
            distance_px = _median_distance(F, p1, p2)
            if distance_px < best.distance_px:
                best = replace(match, lag=lag, F=F, distance_px=distance_px)
        return best


@numba.njit(cache=True)
def _median_distance(F: Array, p1: Array, p2: Array) -> float:
    """Median Sampson distance of pairs (n, 2) from F, (3, 3) or (9,), in their unit."""
    return float(np.median(np.abs(distances_of(F.ravel(), p1, p2))))


@numba.njit(cache=True)
def _most_borne_out(
    Fs: Array, x1: Array, x2: Array, limits: Array, lengths: IntArray, places: IntArray
) -> tuple[float, Array]:
    """Return how long pieces of camera 1 bear out the best of Fs (m, 9), and that F."""
    best, best_F = 0.0, np.zeros(9)
    longest = np.empty(int(np.max(places)) + 1)  # at a time, a piece matches one of the other view
    for F in Fs:
        longest[:] = 0.0
        for k in range(len(x1)):
            if _median_distance(F, x1[k], x2[k]) < limits[k]:
                longest[places[k]] = max(longest[places[k]], lengths[k])
        if np.sum(longest) > best:
            best, best_F = np.sum(longest), F
    return best, best_F


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


def _centred(p_px: Array) -> tuple[Array, Array]:
    """Centre and scale points (..., 2); return the transform (3, 3) that does so, too."""
    centre = np.mean(p_px.reshape(-1, 2), axis=0)
    T = np.diag([1.0 / SCALE_PX, 1.0 / SCALE_PX, 1.0])
    T[:2, 2] = -centre / SCALE_PX
    return (p_px - centre) / SCALE_PX, T


def _meet(one: Piece, other: Piece) -> bool:
    """Whether two pieces of one view overlap in time."""
    return one.first < other.last and other.first < one.last


def one_object(
    cleans: Sequence[Clean], rules: Rules, interval_s: Interval | None = None
) -> tuple[tuple[Clean, ...], Refusal | None]:
    """Choose the object that all cameras saw, where one of them saw several things at a time.

    Each camera is returned with the events of that object alone, or unchanged if all saw one thing;
    with a refusal if no object is told from the others. A camera with noise in its events does not
    count as seeing several, as noise forms clusters too. Of more than two cameras, the two that
    share one object for longest decide; another that saw nothing of it has no events left.
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
    """Return the numbers of each camera's pieces that are of the one object, or a refusal."""
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
    back = None if interval_s is None else (-interval_s[1], -interval_s[0])
    for k in set(range(len(objects))) - set(pair):
        found_by = [
            _matched(one, objects[k], interval_s if place < k else back, rules)
            for place, one in zip(pair, alone, strict=True)
        ]
        fits = [one for one in found_by if isinstance(one, Match)]
        best = max(fits, key=lambda one: one.common, default=None)
        pieces[k] = set() if best is None else {both[1] for both in best.pairs}
    return [pieces[k] for k in range(len(objects))]


def _objects(seen: Clean, rules: Rules) -> Objects:
    """Follow the objects that one camera saw; a track of points counts as one object."""
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
    """Match the pieces of two views at the offset that they bear out best, or refuse them."""
    start_s = 1e-6 * (other.start_us - one.start_us)  # camera 2's start less camera 1's
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
    """Keep only the events of the numbered pieces."""
    if seen.track is not None:
        return seen
    pieces = [objects.pieces[i] for i in sorted(numbers)]
    chosen, far_us = objects.events_of(pieces), 2**61  # before and after all times
    ends = np.array([(piece.first, piece.last) for piece in pieces], np.int64).ravel()
    ends_us = objects.start_us + objects.bin_us * ends
    # Gaps lie between pieces, in order of time, and before and after all.
    gaps_us = np.concatenate([[-far_us], ends_us, [far_us]]).reshape(-1, 2)
    return replace(
        seen,
        events=seen.events.compress(chosen),
        clutter=seen.clutter and replace(seen.clutter, n_min=N_MIN),
        on_line=None,
        gaps_us=np.asarray(gaps_us[gaps_us[:, 1] > gaps_us[:, 0]]),
        used=ObjectsUsed(objects.n_seen, float(np.mean(chosen))),
    )
