"""What two cameras recorded in; the same with the events of one object alone, or a refusal, out.

Nearly all recordings show one thing that moves, and pass as they are. Where a camera sees several,
those pieces of paths are taken that one epipolar geometry and one offset explain in both views.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Camera, Rig
from ssac.config import Config
from ssac.estimate import Estimate, Status
from ssac.search.object_search import HALF_BIN_S, Match, both_see, matches
from ssac.track.clutter import chosen_events
from ssac.track.objects import BIN_US, Objects, Piece, objects_of, seem_several
from ssac.track.observation import Observation, denoised
from ssac.track.point_motion import point_motion

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


@dataclass(frozen=True)
class ObjectsUsed:
    """What became of the things that one camera saw."""

    seen: int  # at a time
    share: float  # of the events, those of the object that was used


@dataclass(frozen=True)
class OneObject:
    """Both cameras with the events of one object, and what else there was."""

    cam1: Observation
    cam2: Observation
    objects: tuple[ObjectsUsed, ObjectsUsed]
    refusal: Estimate | None = None  # without a method's name: no object was told from the others

    def refused(self, method: str) -> Estimate | None:
        """Give the refusal in the name of a method; None where there is none."""
        return None if self.refusal is None else replace(self.refusal, method=method)

    @property
    def words(self) -> str:
        """What the cameras saw, and what is left of it."""
        if self.refusal is not None:
            return "several, and none told from the others"
        if all(used.seen == 1 for used in self.objects):
            return "one at a time"
        seen = " and ".join(str(used.seen) for used in self.objects)
        shares = " and ".join(f"{100.0 * used.share:.0f} %" for used in self.objects)
        return f"{seen} at a time; {shares} of the events are of one that both cameras see"


def one_object(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config, search_all: bool = False
) -> OneObject:
    """Choose the object that both cameras saw, where one of them saw several things at a time.

    Parameters
    ----------
    cam1, cam2, rig, config
        As a method takes them. With `denoise` off nothing is chosen: noise hangs together too.
    search_all
        Offsets outside the config's interval are tried too.

    Returns
    -------
    OneObject
        The cameras denoised, and otherwise as they are where both saw one thing.

    Raises
    ------
    SsacError
        If a camera's events cannot be used.
    """
    cameras = denoised(cam1, cam2, rig, config)
    both = list(zip(cameras, (rig.cam1, rig.cam2), strict=True))
    as_it_is = OneObject(*cameras, (ObjectsUsed(1, 1.0), ObjectsUsed(1, 1.0)))
    seem = [seen.denoised and seem_several(seen.events, camera) for seen, camera in both]
    if not any(seem):
        return as_it_is
    objects = [_objects(*one) for one in both]
    if not any(one.are_several for one, several in zip(objects, seem, strict=True) if several):
        return as_it_is
    start_s = 1e-6 * (objects[1].start_us - objects[0].start_us)  # of camera 2 after camera 1
    low_s, high_s = config.interval_s
    interval_s = None if search_all else (low_s - start_s, high_s - start_s)
    found = matches(objects[0].pieces, objects[1].pieces, interval_s)
    refusal = _refusal(found, objects, start_s)
    if refusal is not None:
        used = (ObjectsUsed(objects[0].n_seen, 0.0), ObjectsUsed(objects[1].n_seen, 0.0))
        return OneObject(*cameras, used, refusal)
    pieces = [{pair[k] for pair in found[0].pairs} for k in range(2)]
    left = [_only(*one) for one in zip(cameras, objects, pieces, strict=True)]
    return OneObject(left[0][0], left[1][0], (left[0][1], left[1][1]))


def _objects(seen: Observation, camera: Camera) -> Objects:
    """Follow the things that one camera saw; a track of points is that of one object."""
    if seen.track is None:
        return objects_of(seen.events, camera)
    start_s, end_s = seen.span_s
    times_s = np.arange(start_s + HALF_BIN_S, end_s, 2.0 * HALF_BIN_S, np.float64)
    track = point_motion(seen.track, camera, HALF_BIN_S).at(times_s)
    positions = np.where(track.valid[:, None], track.positions_px, np.nan)
    none = np.empty(0, np.int64)
    piece = Piece(0, positions, np.ones(len(times_s)), _TRACK_SIZE_PX, none)
    return Objects(round(1e6 * start_s), False, 1, [piece], none.astype(np.int32))


def _refusal(found: list[Match], objects: list[Objects], start_s: float) -> Estimate | None:
    """Refuse where no pieces of both views are one object's, or those of several offsets may be.

    Camera 2's recording starts `start_s` after camera 1's, each by its own clock.
    """
    seen = " and ".join(str(one.n_seen) for one in objects)
    things = f"the cameras see {seen} things at a time"
    nothing = Estimate("", Status.SEVERAL_OBJECTS)
    pieces = objects[0].pieces, objects[1].pieces
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
        return replace(nothing, reason=reason)
    best = found[0]
    rivals = [
        match
        for match in found[1:]
        if match.common >= RIVAL * best.common
        and match.distance_px <= _CLEARLY * max(best.distance_px, _LEAST_PX)
    ]
    if not rivals:
        return None
    offsets_s = [start_s + HALF_BIN_S * match.lag for match in [best, *rivals]]
    others = ", ".join(f"{offset_s:.2f}" for offset_s in offsets_s[1:6])
    reason = (
        f"{things}: two of them fit one epipolar geometry at an offset of {offsets_s[0]:.2f} s, and"
        f" others about as well at {others} s: record one object, or mask the others"
    )
    return replace(nothing, reason=reason, alternatives_s=np.array(sorted(offsets_s)))


def _only(
    seen: Observation, objects: Objects, numbers: set[int]
) -> tuple[Observation, ObjectsUsed]:
    """Keep the events of some pieces alone."""
    if seen.track is not None:
        return seen, ObjectsUsed(1, 1.0)
    pieces = [objects.pieces[i] for i in sorted(numbers)]
    chosen = objects.events_of(pieces)
    left = Observation(
        chosen_events(seen.events, chosen),
        seen.frames,
        seen.frame_times_s,
        denoised=True,
        gaps_us=_gaps_us(objects.start_us, pieces),
    )
    return left, ObjectsUsed(objects.n_seen, float(np.mean(chosen)))


def _gaps_us(start_us: int, pieces: list[Piece]) -> NDArray[np.int64]:
    """Give the times (g, 2) [us] between pieces, in order of time, and beyond all."""
    ends = np.array([(piece.first, piece.last) for piece in pieces], np.int64).ravel()
    gaps_us = np.concatenate([[-_FAR_US], start_us + BIN_US * ends, [_FAR_US]]).reshape(-1, 2)
    return np.asarray(gaps_us[gaps_us[:, 1] > gaps_us[:, 0]])
