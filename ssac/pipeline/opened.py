"""Opens what users give as recordings and rigs: files, arrays, tracks, and the known scale.

The messages here name files; faults of a recording itself are reported where it is cleaned.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from numbers import Integral
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Array, Events
from ssac.camera import Camera, Cameras, Rig, check_cameras
from ssac.errors import SsacError
from ssac.events import US_PER_S, EventFile, check_event_array, check_events, events_of_array
from ssac.files.damage import STRICT, Reading, check_is_file, note_unit, within
from ssac.files.rigs import load_rig
from ssac.files.ros_bags import bag_of, topic_of
from ssac.files.track_files import is_track_file, load_track
from ssac.points import PointTrack, check_track
from ssac.track.clean import Clean
from ssac.track.motion import check_readout
from ssac.track.observation import Observation, tracked

CameraInput = Path | str | Events | Observation | EventFile | PointTrack
"""A file of events or of a track, events as a structured array, or either as it was loaded."""

RigInput = Path | str | Rig | Cameras | Sequence[Camera]
"""A rig file, a rig, or its cameras, whose poses are then not known."""


@dataclass(frozen=True)
class Known:
    """What is known of the scale and the frame: at most one of distance, positions and RTK."""

    distance_m: float | None = None  # between the first two cameras
    positions: Path | None = None  # file of the cameras' positions
    rtk: Path | None = None  # file of the object's own path, on a clock of its own
    lever_arm_m: tuple[float, float, float] | None = None  # of the RTK antenna in the body

    def __post_init__(self) -> None:
        if self.distance_m is not None and not (
            isinstance(self.distance_m, (int, float)) and 0.0 < self.distance_m < np.inf
        ):
            raise SsacError(f"distance_m must be positive and finite, got {self.distance_m!r}")
        if sum(one is not None for one in (self.distance_m, self.positions, self.rtk)) > 1:
            raise SsacError("distance_m, positions, rtk: each sets the scale: give the best alone")
        for name in ("positions", "rtk"):
            if isinstance(getattr(self, name), str):
                object.__setattr__(self, name, Path(getattr(self, name)))


NOTHING = Known()

DISTANCE_SHARE = 0.02
"""Share of a rig's baseline by which a stated distance may differ: a tape between housings, whose
centres of projection are not seen, errs by a centimetre or two of a metre."""

MEANS, IMAGES = "means", "images"
"""What a method takes of each intensity frame: its mean, or all of its pixels."""


@dataclass(frozen=True)
class Recording:
    """A file with one camera's recording, which is read only when it is needed."""

    path: Path
    camera: Camera
    camera_name: str  # for messages: "camera 1 of rig.yaml"
    reading: Reading = STRICT

    @property
    def name(self) -> str:
        """The file's path."""
        return str(self.path)

    @cached_property
    def has_track(self) -> bool:
        """Whether it is a track file."""
        return is_track_file(self.path)

    def read(self, frames: str = "") -> Observation:
        """Read and check the file, with MEANS or IMAGES of its frames where it has any."""
        what = f"{self.path} with {self.camera_name}"
        if self.has_track:
            track = load_track(self.path)
            check_track(track, self.camera.width, self.camera.height, what)
            check_readout(track.times_s, self.camera.readout_s or 0.0, what)
            step_s = float(np.median(np.diff(track.times_s))) if len(track) > 1 else 0.0
            if step_s > 0.9:  # times that count frames are 1 apart
                warnings.warn(
                    f"{self.path}: its points are {step_s:.3g} s apart, which tells little of a"
                    " motion: if t_s is in milliseconds or counts frames, give seconds",
                    stacklevel=2,
                )
            return tracked(track, self.name)
        from ssac.files.event_files import load_events

        file = load_events(self.path, self.reading)
        seen = _of_file(file, self.camera, self.camera_name, self.name, self.reading)
        if not frames:
            return seen
        from ssac.files.hdf5 import load_frames
        from ssac.methods.correlations import frame_means

        def pixels(images: NDArray[np.uint8]) -> Array:  # as images of one pixel
            return frame_means(images)[:, None, None]

        found = load_frames(self.path, pixels if frames == MEANS else None)
        if found is None:
            return seen
        times_us, images = found
        return replace(seen, frames=images, frame_times_s=times_us / US_PER_S)


Source = Observation | Recording
"""One camera's recording: in memory, or in a file that is read when it is needed."""


def opened_rig(rig: RigInput, n: int, numbers: tuple[int, int] | None = None) -> Cameras:
    """Open a rig of n cameras in any form; `numbers` (from 1) select two cameras of a file."""
    if numbers is not None and not (
        isinstance(numbers, (tuple, list))
        and len(numbers) == 2
        and all(isinstance(one, Integral) and one >= 1 for one in numbers)
    ):
        raise SsacError(
            f"cameras: expected the numbers of two cameras of the rig, from 1 on, got {numbers!r}"
        )
    if isinstance(rig, (str, Path)):
        path, (first, second) = Path(rig), numbers or (1, 2)
        pairs = [(first, second)] if n == 2 else [(k, k + 1) for k in range(1, n)]
        rigs = [load_rig(path, pair) for pair in pairs]
        cameras = rigs[0].cam1, *(one.cam2 for one in rigs)
        in_metres = all(one.in_metres for one in rigs)
        return Cameras(cameras, tuple(one.T_2_1 for one in rigs), str(path), in_metres)
    if numbers is not None and tuple(numbers) != (1, 2):
        raise SsacError(
            f"cameras: {numbers} are of a rig file, and none was given: give the rig of those two"
        )
    found = cameras_of(rig, "a rig file, a ssac.Rig or the ssac.Camera of each recording")
    if len(found) != n:
        raise SsacError(
            f"rig: it has {len(found)} cameras, and there are {n} recordings: give one camera each"
        )
    return found


def opened(
    seen: Sequence[CameraInput | Source],
    rig: Cameras,
    numbers: Sequence[int] | None = None,
    reading: Reading = STRICT,
) -> tuple[Source, ...]:
    """Open each camera's recording, without reading files; `numbers` are those in the rig."""
    numbers = numbers or range(1, len(seen) + 1)
    for (a, one), (b, other) in combinations(zip(numbers, seen, strict=True), 2):
        if a == b:
            raise SsacError(f"camera {a} of {rig.name} is given for both: name two cameras")
        if _same_file(one, other):
            what = one if isinstance(one, (str, Path)) else "one recording"
            if isinstance(one, (str, Path)) and bag_of(Path(one)) is not None:
                topic_of(Path(one))  # of several topics, it raises an error that lists them
            whose = "both cameras" if len(seen) == 2 else f"cameras {a} and {b}"
            raise SsacError(f"{what}: given for {whose}: give each camera's own file")
    return tuple(
        _opened(one, camera, number, rig.name, reading)
        for one, camera, number in zip(seen, rig.cameras, numbers, strict=True)
    )


def cameras_of(rig: object, forms: str = "a ssac.Rig or ssac.Cameras") -> Cameras:
    """Convert a rig of any form to `Cameras`, and check them."""
    if isinstance(rig, Rig):
        rig = Cameras((rig.cam1, rig.cam2), (rig.T_2_1,), in_metres=rig.in_metres)
    elif isinstance(rig, (list, tuple)) and all(isinstance(one, Camera) for one in rig):
        rig = Cameras(tuple(rig))
    if not isinstance(rig, Cameras):
        raise SsacError(f"rig: expected {forms}, got {kind_of(rig)}")
    check_cameras(rig)
    return rig


def kind_of(value: object) -> str:
    """Name the type of an unexpected value, with the value itself where it is short."""
    text = repr(value)
    return f"{type(value).__name__} {text if len(text) < 40 else ''}".strip()


def check_two(name1: str, name2: str, one: Clean, other: Clean) -> None:
    """Raise SsacError if two cameras hold the same points: without a baseline anything fits."""
    if one.track is not None and other.track is not None:
        same = np.array_equal(one.track.points_px, other.track.points_px)
    else:
        same = 0 < len(one.events) == len(other.events) and all(
            np.array_equal(one.events[field], other.events[field]) for field in "xy"
        )
    if same:
        raise SsacError(
            f"{name1} and {name2} hold the same points: one is a copy of the other, and there is no"
            " baseline between a camera and itself: give what each camera recorded"
        )


def check_distance(distance_m: float, rig: Cameras) -> None:
    """Raise SsacError unless a stated distance is that of the rig's pose, where it has metres."""
    T_2_1 = rig.pair(0, 1).T_2_1
    if T_2_1 is None or not rig.in_metres:
        return
    baseline_m = float(np.linalg.norm(T_2_1[:3, 3]))
    if abs(distance_m - baseline_m) > DISTANCE_SHARE * baseline_m:
        raise SsacError(
            f"--distance: cameras 1 and 2 are {baseline_m:.4g} m apart in {rig.name}, whose pose is"
            f" taken as known, and {distance_m:g} m were stated: correct the one that is wrong, or"
            " leave it out"
        )


def _opened(
    seen: CameraInput | Source, camera: Camera, number: int, rig_name: str, reading: Reading
) -> Source:
    if isinstance(seen, (str, Path)):
        path = Path(seen)
        if bag_of(path) is None and not path.is_dir():  # bags and folders are checked by the reader
            check_is_file(path)
        return Recording(path, camera, f"camera {number} of {rig_name}", reading)
    if isinstance(seen, Source):
        return seen
    name = f"camera {number}"
    if isinstance(seen, EventFile):
        return _of_file(seen, camera, f"{name} of {rig_name}", name, reading)
    if isinstance(seen, PointTrack):
        return tracked(seen, "")
    if isinstance(seen, np.ndarray):
        events = events_of_array(seen, name)
        check_event_array(events, name)
        note_unit(events, name, "microseconds")
        return Observation(events)
    raise SsacError(
        f"{name}: expected a file, a structured array of events with the fields t, x, y and p, a"
        f" ssac.Observation, or what load_events or load_track gave, got {kind_of(seen)}"
    )


def _of_file(
    file: EventFile, camera: Camera, camera_name: str, name: str, reading: Reading
) -> Observation:
    events, (width, height) = file.events, (file.width, file.height)
    check_event_array(events, name)
    if width not in (None, camera.width) or height not in (None, camera.height):
        raise SsacError(
            f"{camera_name} is calibrated at {camera.width} x {camera.height} px, but {name} was"
            f" recorded at {width} x {height} px: give the rig of this recording"
        )
    if width is None or height is None:
        events = within(events, (camera.width, camera.height), name, reading)
        check_events(events, camera.width, camera.height, f"{name} with {camera_name}")
    return Observation(events, name=name)


def _same_file(one: object, other: object) -> bool:
    if not (isinstance(one, (str, Path)) and isinstance(other, (str, Path))):
        return one is other
    first, second = Path(one), Path(other)
    if first == second and bag_of(first) is not None:  # and perhaps a topic in it
        return True
    return first.exists() and second.exists() and first.samefile(second)
