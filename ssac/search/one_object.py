"""The one object that all cameras saw, of several things that moved before them.

Nearly all recordings show one thing that moves, and pass as they are. Where a camera sees several,
those pieces of paths are taken that one epipolar geometry and one offset explain in both views.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ssac.config import Interval
from ssac.estimate import Refusal, Status
from ssac.search.object_search import HALF_BIN_S, Match, both_see, matches
from ssac.track.clean import Clean, ObjectsUsed
from ssac.track.clutter import chosen_events
from ssac.track.motion import point_motion
from ssac.track.objects import BIN_US, Objects, Piece, objects_of, seem_several

Array = NDArray[np.float64]

MIN_COMMON_S = 1.5
"""Least time in which pieces of both views bear out one offset: less does so by chance."""

MIN_SHARE = 0.5
"""Least share of the time in which both cameras see anything move: things of other flights reach
0.44 of it, and two flights of which one is common have 0.66 and more."""

RIVAL = 0.7
"""Another offset borne out for this share of the best one's time may be the true one."""

_CLEARLY = 3.0  # times the best one's distance: such a rival is none
_LEAST_PX = 0.1
_FAR_US = 2**61  # before and after all times
_TRACK_SIZE_PX = 5.0  # of an object of which a track shows the path alone


def one_object(
    cleans: Sequence[Clean], interval_s: Interval | None = None
) -> tuple[tuple[Clean, ...], Refusal | None]:
    """Choose the object that all cameras saw, where one of them saw several things at a time.

    Parameters
    ----------
    cleans
        What two or more cameras recorded. With noise in it nothing is chosen: that hangs together
        too.
    interval_s
        Least and largest offset between the clocks of two of them; None for any.

    Returns
    -------
    tuple
        Each camera with the events of that object alone, or as it is where all saw one thing; and
        why no object is told from the others, if so. Of more than two cameras, the two that bear
        out one object for longest say which it is; a further one that saw nothing of it has no
        events left.
    """
    seem = [one.denoised and seem_several(one.events, one.camera) for one in cleans]
    if not any(seem) or any(not one.has_track and len(one.events) == 0 for one in cleans):
        return tuple(cleans), None
    objects = [_objects(one) for one in cleans]
    if not any(one.are_several for one, several in zip(objects, seem, strict=True) if several):
        return tuple(cleans), None
    pieces = _chosen(objects, interval_s)
    if isinstance(pieces, Refusal):
        seen = [ObjectsUsed(one.n_seen, 0.0) for one in objects]
        return tuple(replace(one, used=n) for one, n in zip(cleans, seen, strict=True)), pieces
    return tuple(_only(*one) for one in zip(cleans, objects, pieces, strict=True)), None


def _chosen(objects: list[Objects], interval_s: Interval | None) -> list[set[int]] | Refusal:
    """Give the numbers of each camera's pieces that are one object's."""
    matched, refusals = dict[tuple[int, int], Match](), list[Refusal]()
    for a, b in combinations(range(len(objects)), 2):
        found = _matched(objects[a], objects[b], interval_s)
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
        found_by = [_matched(one, objects[k], interval_s) for one in alone]
        fits = [one for one in found_by if isinstance(one, Match)]
        best = max(fits, key=lambda one: one.common, default=None)
        pieces[k] = set() if best is None else {both[1] for both in best.pairs}
    return [pieces[k] for k in range(len(objects))]


def _with_only(objects: Objects, numbers: set[int]) -> Objects:
    """Give what a camera saw without the other pieces."""
    return replace(objects, n_seen=1, pieces=[objects.pieces[i] for i in sorted(numbers)])


def _objects(seen: Clean) -> Objects:
    """Follow the things that one camera saw; a track of points is that of one object."""
    if seen.track is None:
        return objects_of(seen.events, seen.camera)
    start_s, end_s = seen.span_s
    times_s = np.arange(start_s + HALF_BIN_S, end_s, 2.0 * HALF_BIN_S, np.float64)
    track = point_motion(seen.track, seen.camera, HALF_BIN_S).at(times_s)
    positions = np.where(track.valid[:, None], track.positions_px, np.nan)
    none = np.empty(0, np.int64)
    piece = Piece(0, positions, np.ones(len(times_s)), _TRACK_SIZE_PX, none)
    return Objects(round(1e6 * start_s), False, 1, [piece], none.astype(np.int32))


def _matched(one: Objects, other: Objects, interval_s: Interval | None) -> Match | Refusal:
    """Match the pieces of two views at the offset that they bear out best.

    Refused where none are one object's, or those of several offsets may be.
    """
    start_s = 1e-6 * (other.start_us - one.start_us)  # of camera 2 after camera 1
    if interval_s is not None:
        interval_s = (interval_s[0] - start_s, interval_s[1] - start_s)
    found = matches(one.pieces, other.pieces, interval_s)
    things = f"the cameras see {one.n_seen} and {other.n_seen} things at a time"
    pieces = one.pieces, other.pieces
    needed_s = MIN_COMMON_S
    if found:
        needed_s = max(needed_s, MIN_SHARE * HALF_BIN_S * both_see(*pieces, found[0].lag))
    common_s = HALF_BIN_S * found[0].common if found else 0.0
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
        if match.common >= RIVAL * best.common
        and match.distance_px <= _CLEARLY * max(best.distance_px, _LEAST_PX)
    ]
    if not rivals:
        return best
    offsets_s = [start_s + HALF_BIN_S * match.lag for match in [best, *rivals]]
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
        events=chosen_events(seen.events, chosen),
        clutter=None,
        on_line=None,
        gaps_us=_gaps_us(objects.start_us, pieces),
        used=ObjectsUsed(objects.n_seen, float(np.mean(chosen))),
    )


def _gaps_us(start_us: int, pieces: list[Piece]) -> NDArray[np.int64]:
    """Give the times (g, 2) [us] between pieces, in order of time, and beyond all."""
    ends = np.array([(piece.first, piece.last) for piece in pieces], np.int64).ravel()
    gaps_us = np.concatenate([[-_FAR_US], start_us + BIN_US * ends, [_FAR_US]]).reshape(-1, 2)
    return np.asarray(gaps_us[gaps_us[:, 1] > gaps_us[:, 0]])
