"""Small recordings of all kinds, as files, for which every way must give the same answer."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.interpolate import make_interp_spline

from ssac.arrays import Array
from ssac.events import US_PER_S
from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import save_track
from ssac.points import PointTrack
from tests.answers import Recorded
from tests.recorded import add_frames
from tests.ssac.cluttered import merged, mixed, noise
from tests.ssac.synthetic import HEIGHT, WIDTH, Scene, clocked, make_events, make_scene
from tests.ssac.tracks import frame_track, frame_tracks, rig_document

DURATION_S, T_D_S, SIZE_M = 5.0, 0.05, 0.4
RATE_HZ = 8_000.0  # the lowest rate of events at which most kinds get an answer
DURATION_US = round(DURATION_S * US_PER_S)
SCENE = make_scene(0, duration_s=DURATION_S)


@dataclass(frozen=True)
class Seen:
    """What the cameras recorded, and their poses."""

    cameras: Sequence[Any]  # each is events or a track
    scenes: tuple[Scene, ...] = (SCENE,)  # of camera 1 with each further camera
    has_pose: bool = True  # whether the rig holds the poses
    t_d_s: float | None = T_D_S  # offset of camera 2's frames; None: no frames
    options: dict[str, Any] = field(default_factory=dict)  # of `Recorded`


def write(name: str, folder: Path) -> Recorded:
    """Write a recording of RECORDINGS into a folder of its name."""
    seen, folder = RECORDINGS[name](), folder / name
    folder.mkdir(parents=True)
    files = []
    for number, camera in enumerate(seen.cameras, start=1):
        if isinstance(camera, PointTrack):
            files.append(folder / f"cam{number}.csv")
            save_track(files[-1], camera)
        else:
            files.append(folder / f"cam{number}.h5")
            save_events_h5(files[-1], camera, WIDTH, HEIGHT)
            if seen.t_d_s is not None:
                add_frames(files[-1], seen.t_d_s * (number - 1))
    rig = folder / "rig.yaml"
    rig.write_text(yaml.safe_dump(_rig(seen)))
    return Recorded(name, tuple(map(str, files)), str(rig), **seen.options)


def _rig(seen: Seen) -> dict[str, Any]:
    """Return a rig of equal cameras; each but the first has its pose relative to the previous."""
    entry, rig, before = rig_document()["cam0"], dict[str, Any](), np.eye(4)
    for k, scene in enumerate((None, *seen.scenes)):
        rig[f"cam{k}"] = dict(entry)
        if scene is not None and seen.has_pose:
            T_k_1 = scene.rig.T_2_1
            rig[f"cam{k}"]["T_cn_cnm1"] = (T_k_1 @ np.linalg.inv(before)).tolist()
            before = T_k_1
    return rig


def _events(scene: Scene = SCENE, t_d_s: float = T_D_S, size_m: float = SIZE_M) -> list[Any]:
    return list(make_events(scene, 0, t_d_s, RATE_HZ, size_m))


def _along(path: Callable[[Array], list[Array]]) -> Scene:
    """Return SCENE with another path [m], relative to the point that both cameras look at."""
    times_s = np.linspace(-1.0, DURATION_S + 1.0, 200)
    x, y, z = np.broadcast_arrays(*path(times_s))
    return replace(SCENE, path=make_interp_spline(times_s, np.column_stack([x, y, z + 5.0]), k=5))


def _crowd(*seeds: int, duration_s: float = DURATION_S) -> list[Any]:
    flights = [
        make_events(make_scene(seed, duration_s=duration_s), seed, T_D_S, RATE_HZ * share, SIZE_M)
        for seed, share in zip(seeds, (1.0, 0.5, 0.5), strict=False)
    ]
    return [mixed(*streams)[0] for streams in zip(*flights, strict=True)]


LONG = make_scene(1, duration_s=8.0)
REST = _along(lambda t: [0.3 + 0.0 * t, 0.2, 0.1])


def _clocked(one: Any, other: Any, clock: Callable[[Array], Array]) -> Seen:
    """Camera 2's clock shows clock(t) [us] in place of t."""
    return Seen((one, clocked(other, clock)))


def _tracks(
    t_d_s: float = T_D_S, rate: float = 1.0, readout_s: float = 0.0, **options: Any
) -> Seen:
    """Tracks of the longer flight; camera 1 has the readout."""
    return Seen(frame_tracks(LONG, t_d_s, rate, (readout_s, 0.0)), (LONG,), options=options)


def _wandering() -> Seen:
    one, other = frame_tracks(LONG, 0.3)
    wandered_s = other.times_s + 0.012 * np.sin(2.0 * np.pi * other.times_s / LONG.duration_s)
    return Seen((one, replace(other, times_s=wandered_s)), (LONG,))


def _round(seed: int) -> tuple[Scene, Scene]:
    first, second = (make_scene(seed, angle, 4.0) for angle in (50.0, 110.0))
    return first, second


def _three(seed: int, share: float = 1.0) -> list[Any]:
    first, second = _round(seed)
    one, two = make_events(first, seed, T_D_S, RATE_HZ * share, SIZE_M)
    return [one, two, make_events(second, seed, -0.1, 0.96 * RATE_HZ * share, SIZE_M)[1]]


FAR_S = 1000.0
APART = {"config": {"interval_s": (-1.5, 1.5)}}
SHORT = make_scene(2, duration_s=3.0)
LINE = _along(lambda t: [1.2 * np.sin(2.0 * t), 0.5 * np.sin(2.0 * t), 0.0])

RECORDINGS: dict[str, Callable[[], Seen]] = {
    "ordinary": lambda: Seen(_events()),
    "without_pose": lambda: Seen(_events(), has_pose=False),
    "known_extrinsics": lambda: Seen(_events(), options={"known_extrinsics": True}),
    "without_frames": lambda: Seen(_events(), t_d_s=None),
    "no_denoise": lambda: Seen(_events(), options={"config": {"denoise": False}}),
    "skewed_clock": lambda: _clocked(*_events(), lambda t: (1.0 + 60e-6) * t),
    "clock_jump": lambda: _clocked(*_events(), lambda t: t + 20_000.0 * (t > 0.5 * DURATION_US)),
    "rounded_events": lambda: Seen([clocked(one, lambda t: t // 1000 * 1000) for one in _events()]),
    "far_apart": lambda: Seen(_events(t_d_s=FAR_S), t_d_s=FAR_S),
    "interval_without_common_time": lambda: Seen(_events(t_d_s=FAR_S), t_d_s=FAR_S, options=APART),
    "events_at_rest": lambda: Seen(_events(REST)),
    "noise_alone": lambda: Seen([noise(WIDTH, HEIGHT, 1.0, DURATION_US // 5, k) for k in range(2)]),
    "copied": lambda: _clocked(*(2 * _events()[:1]), lambda t: t + 1000.0),
    "straight_line": lambda: Seen(_events(LINE)),
    "tiny": lambda: Seen(_events(size_m=0.06)),
    "noisy": lambda: Seen(
        [merged(one, noise(WIDTH, HEIGHT, 0.1, DURATION_US, k)) for k, one in enumerate(_events())]
    ),
    "two_drones": lambda: Seen(_crowd(4, 5), (make_scene(4),)),
    "people": lambda: Seen(_crowd(4, 5, 6, duration_s=2.0), (make_scene(4),)),
    "tracks": _tracks,
    "tracks_far_apart": lambda: _tracks(7.3),
    "tracks_in_an_interval": lambda: _tracks(config={"interval_s": (-0.5, 0.6)}),
    "rounded_tracks": lambda: Seen(
        [replace(one, times_s=np.floor(100.0 * one.times_s) / 100.0) for one in _tracks().cameras],
        (LONG,),
    ),
    "wandering_clock": _wandering,
    "tracks_of_3_s": lambda: Seen(frame_tracks(SHORT, T_D_S), (SHORT,)),
    "tracks_at_rest": lambda: Seen(frame_tracks(REST, T_D_S)),
    "frame_rate": lambda: _tracks(3.0, 0.71, config={"rates": (0.705, 0.715)}),
    "readout": lambda: _tracks(readout_s=0.03, estimate_readout=True),
    "event_camera_and_track": lambda: Seen((_events(t_d_s=0.0)[0], frame_tracks(SCENE, T_D_S)[1])),
    "three_cameras": lambda: Seen(_three(4), _round(4)),
    "three_cameras_two_drones": lambda: Seen(
        [mixed(*both)[0] for both in zip(_three(4), _three(5, 0.5), strict=True)], _round(4)
    ),
    "three_mixed": lambda: Seen(
        (*_three(4)[:2], frame_track(_round(4)[1], 2, 25.0, 0.2)), _round(4)
    ),
}
