"""Recordings that cannot be answered, each for one cause, and what would mend them.

Flights are simulated where events matter; else they are projected, as tracks of points in a camera
and another one of other intrinsics. What the drone does, how long, and what spoils the recording
are given by the cause; the angle and all that is drawn by the cell.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.recorded import Pair, recorded_pair
from experiments.lab.score import Truth
from experiments.worlds.open_flights import PATHS, OpenCase, flight_config, flight_of
from experiments.worlds.spoilt import ORDINARY, KindCell
from sim.disturb import merged
from sim.recorded import Drift, Jump
from sim.scene.rig import FOCAL_PX, two_view_rig
from sim.scene.trajectory import random_spline
from sim.seeds import generator
from ssac.camera import Camera, Rig, known_pose
from ssac.config import Config
from ssac.estimate import Status
from ssac.points import PointTrack
from ssac.track.observation import Observation, tracked

Rng = np.random.Generator
Spoil = Callable[["Scene", OpenCase, Rng], OpenCase]

DURATION_S, LONG_S = 8.0, 12.0
EVENT_T_D_S = 0.05
MOST_T_D_S = 20.0  # of tracks, of which all offsets are searched
RATE_HZ, SIGMA_PX = 60.0, 0.3  # of tracks
OTHER_K = np.array([[1.3 * FOCAL_PX, 0.0, 185.0], [0.0, 1.3 * FOCAL_PX, 118.0], [0.0, 0.0, 1.0]])
_PATH_STREAM, _TRACK_STREAM, _SPOIL_STREAM, _JUMP_STREAM = 7, 21, 22, 23  # of the seed


@dataclass(frozen=True)
class Cause:
    """Why a recording cannot be answered, and which refusals say so."""

    named_by: tuple[Status, ...]
    words: str  # an expression that is found in a true reason
    spoil: Spoil = lambda scene, case, rng: case
    path: str = ORDINARY
    duration_s: float = DURATION_S
    of_events: bool = False
    method: str = ""  # the best one, unless it is named
    mended_by: str = ""  # the advice after which nothing is spoilt any more
    scale: float = 1.0  # of the path
    config: Config = field(default_factory=Config)


@dataclass(frozen=True)
class Scene:
    """A flight before two cameras: as a cause has it, or as an advice changes it."""

    cause: Cause
    cell: KindCell
    cache: Cache

    def made(self) -> OpenCase:
        """Record the flight, and spoil what was recorded."""
        return self.cause.spoil(self, self.plain(), generator(self.cell.seed, _SPOIL_STREAM))

    def plain(self, other: bool = False) -> OpenCase:
        """Record the flight, or another one before the same cameras, and spoil nothing."""
        seed = self.cell.other_seed if other else self.cell.seed
        pair, t_d_s = self._filmed(seed) if self.cause.of_events else self._tracked(seed)
        return OpenCase(*pair, self.cause.config, Truth(t_d_s, *known_pose(pair.rig)))

    def changed(self, **fields: Any) -> "Scene":
        """Give another flight, or one that is recorded otherwise."""
        return replace(self, cause=replace(self.cause, **fields))

    def _filmed(self, seed: int) -> tuple[Pair, float]:
        cause = self.cause
        config = flight_config(cause.path, self.cell.sim.angle_deg)
        spline = replace(config.spline, duration_s=cause.duration_s)
        config = replace(config, spline=spline, t_d_s=EVENT_T_D_S)
        if cause.path in PATHS:
            return flight_of(cause.path, config, seed, self.cache), EVENT_T_D_S
        return recorded_pair(self.cache, config, seed), EVENT_T_D_S

    def _tracked(self, seed: int) -> tuple[Pair, float]:
        cause, rng = self.cause, generator(seed, _PATH_STREAM)
        spline = replace(self.cell.sim.spline, duration_s=cause.duration_s)
        path = (
            PATHS[cause.path](rng) if cause.path in PATHS else random_spline(spline, rng).position
        )
        rig, rng = two_view_rig(self.cell.sim.angle_deg), generator(seed, _TRACK_STREAM)
        t_d_s = float(rng.uniform(-MOST_T_D_S, MOST_T_D_S))
        cameras = rig.cameras[0], replace(rig.cameras[1], K=OTHER_K)
        seen = []
        for camera, first_s in zip(cameras, (0.0, t_d_s), strict=True):
            n = int(RATE_HZ * cause.duration_s)
            times_s = (np.arange(n, dtype=np.float64) + rng.uniform(0.0, 1.0)) / RATE_HZ
            points_px = camera.project(cause.scale * path(times_s))
            points_px = points_px + SIGMA_PX * rng.standard_normal(points_px.shape)
            most = np.array([camera.width, camera.height]) - 1
            inside = np.all((points_px >= 0) & (points_px <= most), axis=1)
            seen.append(tracked(PointTrack(first_s + times_s[inside], points_px[inside])))
        cam1, cam2 = (Camera(one.K, one.width, one.height) for one in cameras)
        return Pair(seen[0], seen[1], Rig(cam1, cam2, rig.relative_pose(0, 1))), t_d_s


def cut(seen: Observation, from_s: float, to_s: float) -> Observation:
    """Keep what a camera recorded from one instant of its clock up to another."""
    events, track = seen.events, seen.track
    events = events[(events["t"] >= 1e6 * from_s) & (events["t"] < 1e6 * to_s)]
    if track is not None:
        inside = (track.times_s >= from_s) & (track.times_s < to_s)
        track = PointTrack(track.times_s[inside], track.points_px[inside])
    return replace(seen, events=events, track=track)


def _later(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let camera 2's clock show up to a minute more."""
    late_s = float(np.round(rng.uniform(20.0, 60.0), 3))
    truth = replace(case.truth, t_d_s=case.truth.t_d_s + late_s)
    return replace(case, cam2=case.cam2.delayed(late_s), truth=truth)


def _elsewhere(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Ask for an interval that the true offset is 1 to 4 s beyond."""
    beyond_s = float(rng.choice((-1.0, 1.0)) * rng.uniform(2.0, 5.0))
    middle_s = case.truth.t_d_s + beyond_s
    return replace(case, config=replace(case.config, interval_s=(middle_s - 1.0, middle_s + 1.0)))


def _of_others(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let camera 2 see another flight."""
    return replace(case, cam2=scene.plain(other=True).cam2, truth=replace(case.truth, t_d_s=np.nan))


def _convoy(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let a second drone follow the first on its path, 0.3 to 0.6 s later."""
    late_s = float(rng.uniform(0.3, 0.6))
    both = [
        Observation(merged(one.events, one.delayed(late_s).events))
        for one in (case.cam1, case.cam2)
    ]
    return replace(case, cam1=both[0], cam2=both[1])


def _jumping(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let camera 2's clock jump somewhere in the middle."""
    return _drifting(case, Drift(jump=jump_of(scene)))


def jump_of(scene: Scene) -> Jump:
    """Draw when a clock jumps, in the middle 0.4 of a recording, and by how much."""
    rng = generator(scene.cell.seed, _JUMP_STREAM)
    by_s = (0.008, 0.04) if scene.cause.of_events else (0.05, 0.3)
    at_s = float(rng.uniform(0.3, 0.7) * scene.cause.duration_s)
    return at_s, float(rng.uniform(*by_s))


def _drifting(case: OpenCase, drift: Drift) -> OpenCase:
    cam2, t_d_s = case.cam2.delayed(-case.truth.t_d_s), case.truth.t_d_s
    events, track = cam2.events.copy(), cam2.track
    events["t"] += drift.added_us(events["t"])
    if track is not None:
        times_us = np.rint(1e6 * track.times_s).astype(np.int64)
        times_s = (times_us + drift.added_us(times_us)).astype(np.float64) / 1e6
        track = replace(track, times_s=times_s)
    return replace(case, cam2=replace(cam2, events=events, track=track).delayed(t_d_s))


def _at_other_rate(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let camera 2's clock run 2 to 5 % fast."""
    ppm, middle_s = float(rng.uniform(2e4, 5e4)), 0.5 * scene.cause.duration_s
    made = _drifting(case, Drift(ppm, middle_s))
    return replace(made, truth=replace(case.truth, skew_ppm=ppm, t_mid_s=middle_s))


def _apart(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let each camera record another half of the flight."""
    half_s, t_d_s = 0.5 * scene.cause.duration_s, case.truth.t_d_s
    cam1, cam2 = cut(case.cam1, 0.0, half_s), cut(case.cam2, half_s + t_d_s, np.inf)
    return replace(case, cam1=cam1, cam2=cam2, truth=replace(case.truth, t_d_s=np.nan))


def _wrong_focal(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Give one camera a focal length that is half or double, or worse."""
    cameras, index = [case.rig.cam1, case.rig.cam2], int(rng.integers(2))
    K, factor = cameras[index].K.copy(), float(rng.uniform(2.0, 4.0))
    K[[0, 1], [0, 1]] *= factor ** float(rng.choice((-1.0, 1.0)))
    cameras[index] = Camera(K, cameras[index].width, cameras[index].height)
    return replace(case, rig=Rig(cameras[0], cameras[1], case.rig.T_2_1))


def exchanged(case: OpenCase) -> OpenCase:
    """Exchange the intrinsics of the cameras in the rig."""
    return replace(case, rig=Rig(case.rig.cam2, case.rig.cam1, case.rig.T_2_1))


def inverted(case: OpenCase) -> OpenCase:
    """Give the inverse of the rig's transform."""
    assert case.rig.T_2_1 is not None
    inverse = np.linalg.inv(case.rig.T_2_1).astype(np.float64)
    return replace(case, rig=replace(case.rig, T_2_1=inverse))


_NOT_THERE = (
    Status.NO_MATCH, Status.SEARCH_BOUND, Status.TOO_LITTLE_MOTION, Status.AMBIGUOUS_OFFSET,
)  # fmt: skip
_UNLIKE = (Status.NO_MATCH, Status.AMBIGUOUS_OFFSET, Status.POOR_FIT)
_OPEN_POSE = (Status.DEGENERATE_POSE, Status.AMBIGUOUS_POSE)

CAUSES: dict[str, Cause] = {
    "at rest": Cause((Status.NO_MOTION,), "at rest", path="stationary", of_events=True),
    "at rest, tracks": Cause((Status.NO_MOTION,), "at rest", path="stationary"),
    "no common time in the interval": Cause(
        (Status.NO_COMMON_TIME,), "no common time", _later, of_events=True,
        config=Config(interval_s=(-1.0, 1.0)),
    ),
    "outside the interval": Cause(
        _NOT_THERE, "outside the search",
        _elsewhere, of_events=True,
    ),
    "outside the interval, tracks": Cause(
        _NOT_THERE, "outside the search", _elsewhere,
    ),
    "brief": Cause(
        (Status.TOO_FEW_SAMPLES, Status.TOO_LITTLE_MOTION, Status.AMBIGUOUS_OFFSET),
        "to and fro|needed|enough|hardly tells",
        duration_s=0.5, of_events=True,
    ),
    "short": Cause(
        (Status.TOO_LITTLE_MOTION, Status.AMBIGUOUS_OFFSET), "to and fro|too little of one flight",
        duration_s=1.5, of_events=True,
    ),
    "short, tracks": Cause(
        (Status.TOO_FEW_SAMPLES, Status.TOO_LITTLE_MOTION, Status.AMBIGUOUS_OFFSET),
        "to and fro|long enough|too little of one flight", duration_s=1.5,
    ),
    "slow": Cause((Status.TOO_LITTLE_MOTION,), "to and fro", path="slow", of_events=True),
    "different objects": Cause(
        _UNLIKE, "different objects", _of_others, of_events=True,
        mended_by="record one flight",
    ),
    "different objects, tracks": Cause(
        (*_UNLIKE, Status.TOO_LITTLE_MOTION), "different objects", _of_others,
        mended_by="record one flight",
    ),
    "nothing common": Cause(
        (*_UNLIKE, Status.TOO_LITTLE_MOTION), "too little of one flight|objects", _apart,
        duration_s=LONG_S, mended_by="record one flight",
    ),
    "convoy": Cause(
        (Status.SEVERAL_OBJECTS,), "", _convoy, of_events=True, mended_by="record one object",
    ),
    "clock jumps": Cause(
        (Status.CLOCK_JUMP,), "jumps", _jumping, duration_s=LONG_S, of_events=True,
    ),
    "clock jumps, tracks": Cause(
        (Status.CLOCK_JUMP,), "jumps", _jumping, duration_s=LONG_S,
    ),
    "other rate": Cause(
        (Status.NO_MATCH, Status.AMBIGUOUS_OFFSET, Status.POOR_FIT, Status.CLOCK_JUMP),
        "rate of its own", _at_other_rate, of_events=True,
    ),
    "wrong focal length": Cause(
        (Status.POOR_FIT, Status.NO_MATCH), "focal length|calibrat", _wrong_focal,
        mended_by="calibrate again",
    ),
    "exchanged cameras": Cause(
        (Status.POOR_FIT, Status.NO_MATCH, Status.NO_CONVERGENCE), "exchange",
        lambda scene, case, rng: exchanged(case),
    ),
    "inverse transform": Cause(
        (Status.POOR_FIT, Status.NO_MATCH, Status.NO_CONVERGENCE), "inverse",
        lambda scene, case, rng: inverted(case), method="joint-known",
    ),
    "uniform line": Cause((Status.AMBIGUOUS_OFFSET,), "line", path="straight-uniform"),
    "circle": Cause((Status.AMBIGUOUS_OFFSET,), "circle", path="circle"),
    "helix": Cause((Status.AMBIGUOUS_OFFSET,), "helix", path="helix"),
    "periodic": Cause((Status.AMBIGUOUS_OFFSET,), "repeats", path="periodic"),
    "straight": Cause(_OPEN_POSE, "line", path="straight"),
    "planar": Cause(_OPEN_POSE, "plane", path="planar"),
    "small": Cause(_OPEN_POSE, "leaves the pose open", scale=0.05),
}  # fmt: skip
"""Why recordings cannot be answered."""
