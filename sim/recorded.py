"""What a recording is: the cameras' events and frames, the truth, and what takes them meanwhile.

`sim.recording` makes them, `sim.storage` has their files.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim.clock import Drift
from sim.render.gl_context import GLContext
from sim.render.renderer import RenderCheck
from sim.scene.camera import Camera
from sim.scene.rig import Rig
from sim.scene.trajectory import Trajectory
from sim.sensor.buffer import EVENT_DTYPE
from sim.sensor.frames import Frames, Images

FloatArray = NDArray[np.float64]

TRUTH_HZ = 200.0  # rate at which the truth lists poses: smooth enough to interpolate


@dataclass(frozen=True)
class CameraRecording:
    """What one camera recorded, on its own clock."""

    camera: Camera
    events: NDArray[Any]  # sim.sensor.EVENT_DTYPE, sorted by t
    frames: Frames


@dataclass(frozen=True)
class Truth:
    """What an estimator is to find, and what it is scored against."""

    t_d_s: float  # t_cam2 = t_cam1 + t_d
    R: FloatArray  # (3, 3), x2 = R x1 + t
    t: FloatArray  # (3,), unit length
    baseline_m: float
    times_s: FloatArray  # (n,) [s], of the scene, which is camera 1's clock
    T_W_B: FloatArray  # (n, 4, 4), pose of the drone
    centres_px: FloatArray  # (cameras, n, 2), image of the drone's origin; NaN behind the camera
    drift: Drift = field(default_factory=Drift)  # of camera 2's clock, beside t_d


@dataclass(frozen=True)
class Flight:
    """All of a recording but what its cameras recorded."""

    rig: Rig
    truth: Truth
    n_instants: int  # chosen, over all cameras
    gl: GLContext | None  # None: nothing was drawn with OpenGL
    check: RenderCheck  # of the native renderer against it


@dataclass(frozen=True)
class Recording:
    """A simulated recording of one flight."""

    cameras: tuple[CameraRecording, ...]
    rig: Rig
    truth: Truth
    n_instants: int  # chosen, over all cameras
    gl: GLContext | None  # None: nothing was drawn with OpenGL
    check: RenderCheck  # of the native renderer against it

    @property
    def flight(self) -> Flight:
        """The same without what the cameras recorded."""
        return Flight(self.rig, self.truth, self.n_instants, self.gl, self.check)


class Sink(Protocol):
    """Takes what one camera records, as it records it, on the camera's clock."""

    @property
    def images(self) -> Images:
        """Takes each frame when its exposure closes."""

    def add(self, events: NDArray[Any], /) -> None:
        """Take the next events, of EVENT_DTYPE, all in order of time."""

    def close(self) -> None:
        """Know that the camera has recorded all."""


OpenSink = Callable[[Camera, NDArray[np.int64], float], Sink]
"""Opens the sink of a camera, given the times of its frames (n,) [us] and their exposure [s]."""


class InMemory:
    """A sink that keeps all."""

    def __init__(self, camera: Camera, times_us: NDArray[np.int64], exposure_s: float) -> None:
        self.camera = camera
        self.images = np.empty((len(times_us), camera.height, camera.width), np.uint8)
        self._frames = Frames(times_us, self.images, exposure_s)
        self._events: list[NDArray[Any]] = []

    def add(self, events: NDArray[Any]) -> None:
        """Keep events."""
        self._events.append(events)

    def close(self) -> None:
        """Join the events."""
        self._events = [np.concatenate([np.empty(0, EVENT_DTYPE), *self._events])]

    def recording(self) -> CameraRecording:
        """Return all that was recorded."""
        return CameraRecording(self.camera, self._events[0], self._frames)


def truth_of(rig: Rig, trajectory: Trajectory, t_d_s: float, drift: Drift) -> Truth:
    """Say what an estimator is to find in a flight before a rig."""
    R, t, baseline_m = rig.extrinsics()
    n = max(2, int(np.ceil(trajectory.duration_s * TRUTH_HZ)) + 1)
    times_s: FloatArray = np.linspace(0.0, trajectory.duration_s, n, dtype=np.float64)
    T_W_B = trajectory.poses(times_s)
    centres_px = np.stack([camera.project(T_W_B[:, :3, 3]) for camera in rig.cameras])
    return Truth(t_d_s, R, t, baseline_m, times_s, T_W_B, centres_px, drift)
