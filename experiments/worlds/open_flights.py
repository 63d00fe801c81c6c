"""Flights that leave the offset or the pose undetermined, and recordings that cannot be solved.

The drone rotates as in ordinary flights, but four times as fast where its path alone makes too few
events, and with its course where it orbits.

A `Cause` says how the drone flies, for how long, what spoils the recording and which advice mends
it; the cell gives the angle and the seeds of all draws. Where events matter, a flight is simulated;
else its path is projected to noisy point tracks in two cameras of different intrinsics.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.lab.cache import Cache
from experiments.lab.recorded import Pair, recorded_pair
from experiments.lab.score import Truth
from experiments.worlds.spoilt import ORDINARY, KindCell
from sim.disturb import merged
from sim.recorded import Drift, Jump
from sim.recording import SimConfig
from sim.scene.rig import FOCAL_PX, two_view_rig
from sim.scene.trajectory import (
    Attitude,
    SplineConfig,
    Trajectory,
    random_spline,
    trajectory_to_csv,
)
from sim.seeds import generator
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.arrays import Array
from ssac.camera import Camera, Rig, known_pose
from ssac.config import Config
from ssac.estimate import Status
from ssac.pipeline.chain import Chain
from ssac.points import PointTrack
from ssac.track.observation import Observation, tracked

Rng = np.random.Generator
Position = Callable[[Array], Array]  # (n,) [s] -> (n, 3) [m], world frame

T_D_S = 0.05
DURATION_S = 8.0
_APART_S = 60.0  # between two recordings without any common time
_CSV_HZ = 200.0
_OUTSIDE_S = 3.0  # an offset that the search interval does not hold
_SHORT_S = 0.6
_PATH_STREAM = 7  # of the seed
_PACES = {"slow": 0.25, "stationary": 4.0, "straight-uniform": 4.0}
"""Factors on the rates of rotation of ordinary flights, and for "slow" also on their speed."""


@dataclass(frozen=True)
class OpenCase:
    """What the methods are given, and what they are to find."""

    cam1: Observation
    cam2: Observation
    rig: Rig  # with the true extrinsics
    config: Config
    truth: Truth  # its offset is NaN where none is right, as of different objects

    @property
    def chain(self) -> Chain:
        """Recordings, rig and config, as the input of a method."""
        return Chain((self.cam1, self.cam2), self.rig, self.config)


def _random_direction(rng: Rng) -> Array:
    direction = rng.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction))


def _frame(rng: Rng) -> Array:
    """Three random orthogonal unit vectors (3, 3), one per row."""
    return np.asarray(np.linalg.qr(rng.normal(size=(3, 3)))[0].T)


def _stationary(rng: Rng) -> Position:
    place = rng.uniform(-0.7, 0.7, 3)
    return lambda times_s: np.tile(place, (len(times_s), 1))


def _straight(rng: Rng) -> Position:
    """Draw a straight line, along which the speed varies as in an ordinary flight."""
    path = random_spline(SplineConfig(DURATION_S), rng).position
    direction, middle = _random_direction(rng), rng.uniform(-0.4, 0.4, 3)
    return lambda times_s: middle + 1.3 * path(times_s)[:, :1] * direction


def _straight_uniform(rng: Rng) -> Position:
    """Draw a straight line at one speed, 6.4 m in all; a part of it is in view."""
    direction, middle = _random_direction(rng), rng.uniform(-0.4, 0.4, 3)
    return lambda times_s: middle + 0.8 * (times_s - 0.5 * DURATION_S)[:, None] * direction


def _circle(rng: Rng, rise_m: float = 0.0) -> Position:
    (a, b, axis), middle = _frame(rng), rng.uniform(-0.3, 0.3, 3)
    radius_m, period_s, phase = rng.uniform(0.8, 1.5), rng.uniform(1.5, 4.0), rng.uniform(0.0, 6.0)

    def position(times_s: Array) -> Array:
        turn = phase + 2.0 * np.pi * times_s[:, None] / period_s
        height = rise_m * (times_s[:, None] / DURATION_S - 0.5)
        return np.asarray(middle + radius_m * (np.cos(turn) * a + np.sin(turn) * b) + height * axis)

    return position


def _planar(rng: Rng) -> Position:
    path = random_spline(SplineConfig(DURATION_S), rng).position
    plane, middle = _frame(rng)[:2], rng.uniform(-0.4, 0.4, 3)
    return lambda times_s: middle + 1.2 * path(times_s)[:, :2] @ plane


def _periodic(rng: Rng) -> Position:
    """Draw a closed path of three harmonics, flown again and again."""
    period_s = rng.uniform(0.7, 0.95)
    waves = rng.normal(size=(3, 2, 3)) * np.array([0.75, 0.35, 0.2])[:, None, None]

    def position(times_s: Array) -> Array:
        turns = 2.0 * np.pi * times_s[:, None] / period_s * np.arange(1.0, 4.0)
        return np.asarray(np.cos(turns) @ waves[:, 0] + np.sin(turns) @ waves[:, 1])

    return position


PATHS: dict[str, Callable[[Rng], Position]] = {
    "stationary": _stationary, "straight": _straight, "straight-uniform": _straight_uniform,
    "circle": _circle, "helix": lambda rng: _circle(rng, rise_m=2.0), "planar": _planar,
    "periodic": _periodic,
}  # fmt: skip
"""Draws of the flights whose path is no random spline, by name."""


def _nose_first(position: Position) -> Attitude:
    """Turn a body's x axis along its course, and its z axis along that of the curve."""

    def attitude(times_s: Array) -> Rotation:
        step_s = 1e-3
        before, here, after = (position(times_s + k * step_s) for k in (-1, 0, 1))
        ahead, inward = after - before, after - 2.0 * here + before
        up = np.cross(ahead, inward)
        axes = np.stack([ahead, np.cross(up, ahead), up], axis=-1)
        return Rotation.from_matrix(axes / np.linalg.norm(axes, axis=1, keepdims=True))

    return attitude


def flight_config(flight: str, angle_deg: float) -> SimConfig:
    """Give a flight's configuration, without the trajectory file that `flight_of` may add."""
    spline, frames = SplineConfig(DURATION_S), FrameConfig(rate_hz=0.0)
    config = SimConfig(angle_deg=angle_deg, t_d_s=T_D_S, spline=spline, frames=frames)
    return replace(config, sensor=PRESETS["davis346"]) if flight == "noise-kept" else config


def flight_of(flight: str, config: SimConfig, seed: int, cache: Cache) -> Pair:
    """Load a flight of `flight_config`; the seed draws its path.

    A recording's key in the cache has the content of its trajectory file, not the name.
    """
    is_orbit = flight == "orbit"  # a circle flown nose first: outlines tell no more than it does
    path = "circle" if is_orbit else flight
    if path not in PATHS and path not in _PACES:
        return recorded_pair(cache, config, seed)
    rng = generator(seed, _PATH_STREAM)
    pace = _PACES.get(path, 1.0)
    random = random_spline(replace(config.spline, duration_s=pace * DURATION_S), rng)
    own = PATHS[path](rng) if path in PATHS else None
    position = own or (lambda times_s: random.position(pace * times_s))
    trajectory = Trajectory(DURATION_S, position, lambda times_s: random.attitude(pace * times_s))
    if is_orbit:
        trajectory = replace(trajectory, attitude=_nose_first(position))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "flight.csv"
        trajectory_to_csv(trajectory, file, _CSV_HZ)
        return recorded_pair(cache, replace(config, trajectory_file=file), seed)


Spoil = Callable[["Scene", OpenCase, Rng], OpenCase]

LONG_S = 12.0
MOST_T_D_S = 20.0  # of tracks, whose search covers all offsets
RATE_HZ, SIGMA_PX = 60.0, 0.3  # of tracks
OTHER_K = np.array([[1.3 * FOCAL_PX, 0.0, 185.0], [0.0, 1.3 * FOCAL_PX, 118.0], [0.0, 0.0, 1.0]])
_TRACK_STREAM, _SPOIL_STREAM, _JUMP_STREAM = 21, 22, 23  # of the seed


@dataclass(frozen=True)
class Cause:
    """Why a recording cannot be solved, or leaves something open, and which refusals say so."""

    named_by: tuple[Status, ...] = ()
    words: str = ""  # regular expression that the reason of a true refusal matches
    spoil: Spoil = lambda scene, case, rng: case
    path: str = ORDINARY
    duration_s: float = DURATION_S
    of_events: bool = False
    method: str = ""  # name of the method; "": the best one
    mended_by: str = ""  # phrase of the advice that undoes `spoil`
    scale: float = 1.0  # of the path of tracks
    config: Config = field(default_factory=Config)


@dataclass(frozen=True)
class Scene:
    """A flight before two cameras under a cause, or under a cause that an advice has changed."""

    cause: Cause
    cell: KindCell
    cache: Any  # a Cache; rows do not depend on its code

    def made(self) -> OpenCase:
        """Record the flight, and spoil what was recorded."""
        return self.cause.spoil(self, self.plain(), generator(self.cell.seed, _SPOIL_STREAM))

    def plain(self, other: bool = False) -> OpenCase:
        """Record the flight, or another one before the same cameras, and spoil nothing."""
        seed = self.cell.other_seed if other else self.cell.seed
        pair, t_d_s = self._filmed(seed) if self.cause.of_events else self._tracked(seed)
        return OpenCase(*pair, self.cause.config, Truth(t_d_s, *known_pose(pair.rig)))

    def changed(self, **fields: Any) -> "Scene":
        """Return the scene with some fields of its cause replaced."""
        return replace(self, cause=replace(self.cause, **fields))

    def _filmed(self, seed: int) -> tuple[Pair, float]:
        cause, sim = self.cause, self.cell.sim
        sim = replace(sim, spline=replace(sim.spline, duration_s=cause.duration_s))
        return flight_of(cause.path, sim, seed, self.cache), T_D_S

    def _tracked(self, seed: int) -> tuple[Pair, float]:
        cause, rng = self.cause, generator(seed, _PATH_STREAM)
        spline = replace(self.cell.sim.spline, duration_s=cause.duration_s)
        has_own = cause.path in PATHS
        path = PATHS[cause.path](rng) if has_own else random_spline(spline, rng).position
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


def _delayed(case: OpenCase, late_s: float) -> OpenCase:
    truth = replace(case.truth, t_d_s=case.truth.t_d_s + late_s)
    return replace(case, cam2=case.cam2.delayed(late_s), truth=truth)


def _later(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let camera 2's clock show 20 to 60 s more."""
    return _delayed(case, float(np.round(rng.uniform(20.0, 60.0), 3)))


def _shortened(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Keep the middle of each recording."""
    kept = []
    for one in (case.cam1, case.cam2):
        middle_us = (one.events["t"][0] + one.events["t"][-1]) // 2
        near = np.abs(one.events["t"] - middle_us) < 0.5e6 * _SHORT_S
        kept.append(Observation(one.events[near]))
    return replace(case, cam1=kept[0], cam2=kept[1])


def _elsewhere(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Search an interval whose nearer end is 1 to 4 s from the true offset."""
    beyond_s = float(rng.choice((-1.0, 1.0)) * rng.uniform(2.0, 5.0))
    middle_s = case.truth.t_d_s + beyond_s
    return replace(case, config=replace(case.config, interval_s=(middle_s - 1.0, middle_s + 1.0)))


def _of_others(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let camera 2 see another flight."""
    return replace(case, cam2=scene.plain(other=True).cam2, truth=replace(case.truth, t_d_s=np.nan))


def _convoy(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let a second drone follow the first on its path, 0.3 to 0.6 s later."""
    late_s = float(rng.uniform(0.3, 0.6))
    cam1, cam2 = (
        Observation(merged(one.events, one.delayed(late_s).events))
        for one in (case.cam1, case.cam2)
    )
    return replace(case, cam1=cam1, cam2=cam2)


def _jumping(scene: Scene, case: OpenCase, rng: Rng) -> OpenCase:
    """Let camera 2's clock jump somewhere in the middle."""
    return _drifting(case, Drift(jump=jump_of(scene)))


def jump_of(scene: Scene) -> Jump:
    """Draw the time of a clock's jump, in the middle 40 % of a recording, and its size."""
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
    """Multiply or divide one camera's focal length by 2 to 4."""
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
_TOO_SHORT = (Status.TOO_FEW_SAMPLES, Status.TOO_LITTLE_MOTION, Status.AMBIGUOUS_OFFSET)
_MISFIT = (Status.POOR_FIT, Status.NO_MATCH, Status.NO_CONVERGENCE)
_OPEN_POSE = (Status.DEGENERATE_POSE, Status.AMBIGUOUS_POSE)

CAUSES: dict[str, Cause] = {
    "at rest": Cause((Status.NO_MOTION,), "at rest", path="stationary", of_events=True),
    "at rest, tracks": Cause((Status.NO_MOTION,), "at rest", path="stationary"),
    "no common time in the interval": Cause(
        (Status.NO_COMMON_TIME,), "no common time", _later, of_events=True,
        config=Config(interval_s=(-1.0, 1.0)),
    ),
    "outside the interval": Cause(_NOT_THERE, "outside the search", _elsewhere, of_events=True),
    "outside the interval, tracks": Cause(_NOT_THERE, "outside the search", _elsewhere),
    "brief": Cause(
        _TOO_SHORT, "to and fro|needed|enough|hardly tells", duration_s=0.5, of_events=True
    ),
    "short": Cause(
        _TOO_SHORT[1:], "to and fro|too little of one flight", duration_s=1.5, of_events=True
    ),
    "short, tracks": Cause(
        _TOO_SHORT, "to and fro|long enough|too little of one flight", duration_s=1.5
    ),
    "slow": Cause((Status.TOO_LITTLE_MOTION,), "to and fro", path="slow", of_events=True),
    "different objects": Cause(
        _UNLIKE, "different objects", _of_others, of_events=True, mended_by="record one flight"
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
        (Status.SEVERAL_OBJECTS,), "", _convoy, of_events=True, mended_by="record one object"
    ),
    "clock jumps": Cause(
        (Status.CLOCK_JUMP,), "jumps", _jumping, duration_s=LONG_S, of_events=True
    ),
    "clock jumps, tracks": Cause((Status.CLOCK_JUMP,), "jumps", _jumping, duration_s=LONG_S),
    "other rate": Cause(
        (*_UNLIKE, Status.CLOCK_JUMP), "rate of its own", _at_other_rate, of_events=True
    ),
    "wrong focal length": Cause(
        _MISFIT[:2], "focal length|calibrat", _wrong_focal, mended_by="calibrate again"
    ),
    "exchanged cameras": Cause(_MISFIT, "exchange", lambda scene, case, rng: exchanged(case)),
    "inverse transform": Cause(
        _MISFIT, "inverse", lambda scene, case, rng: inverted(case), method="joint-known"
    ),
    "uniform line": Cause((Status.AMBIGUOUS_OFFSET,), "line", path="straight-uniform"),
    "circle": Cause((Status.AMBIGUOUS_OFFSET,), "circle", path="circle"),
    "helix": Cause((Status.AMBIGUOUS_OFFSET,), "helix", path="helix"),
    "orbit": Cause((Status.AMBIGUOUS_OFFSET,), "circle", path="orbit", of_events=True),
    "periodic": Cause((Status.AMBIGUOUS_OFFSET,), "repeats", path="periodic"),
    "straight": Cause(_OPEN_POSE, "line", path="straight"),
    "planar": Cause(_OPEN_POSE, "plane", path="planar"),
    "small": Cause(_OPEN_POSE, "leaves the pose open", scale=0.05),
}  # fmt: skip
"""Causes by name: most prevent an answer, the last ones leave the pose open."""


def _open(path: str = ORDINARY, spoil: Spoil = Cause.spoil, **config: Any) -> Cause:
    return Cause(spoil=spoil, path=path, of_events=True, config=Config(**config))


KINDS: dict[str, Cause] = {
    **{path: _open(path) for path in PATHS},
    "periodic-wide": _open("periodic", interval_s=(-3.0, 3.0)),
    "slow": _open("slow"),
    "noise-kept": _open("noise-kept", denoise=False),
    "ordinary": _open(),
    "orbit": _open("orbit"),
    "other-object": _open(spoil=_of_others),
    # A search of all offsets would find the true one.
    "no-overlap": _open(spoil=lambda _, case, rng: _delayed(case, _APART_S), search="interval"),
    "small-overlap": _open(interval_s=(DURATION_S - 1.0, DURATION_S - 0.1)),
    "outside-search": _open(spoil=lambda _, case, rng: _delayed(case, _OUTSIDE_S)),
    "short": _open(spoil=_shortened),
    "few-samples": _open(n_samples=25),
}
"""Recordings that leave something open, and ordinary ones; those of one path share flights."""
