"""What a recording holds: the cameras' events and frames, their clocks, and the truth.

Camera 1's clock is the scene's. Camera 2's shows t + t_d + skew (t - t_ref), with t_ref the middle
of the recording, plus the size of a clock jump from the time of the jump on.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim.arrays import FloatArray, IntArray
from sim.errors import SimError
from sim.render.gl_context import GLContext
from sim.render.renderer import RenderCheck
from sim.scene.rig import Camera, Rig
from sim.scene.trajectory import Trajectory
from sim.sensor.frames import Frames

MAX_SKEW_PPM = 100_000.0  # either way: a tenth, far beyond any oscillator

Jump = tuple[float, float]
"""The time at which a clock jumps [s, scene clock], and the size of the jump [s]."""


@dataclass(frozen=True)
class Drift:
    """How camera 2's clock strays from a constant offset; by default it does not."""

    skew_ppm: float = 0.0  # by which the clock runs fast
    t_ref_s: float = 0.0  # scene time at which the skew adds nothing
    jump: Jump | None = None

    def added_us(self, times_us: IntArray) -> IntArray:
        """Return what skew and jump add to the clock (n,) [us] at scene times (n,) [us].

        It is rounded without t_d: recordings that differ in t_d alone differ by a constant.
        """
        since_us = times_us - 1e6 * self.t_ref_s
        added_us: IntArray = np.rint(1e-6 * self.skew_ppm * since_us).astype(np.int64)
        if self.jump is not None:
            at_s, size_s = self.jump
            added_us[times_us >= round(1e6 * at_s)] += round(1e6 * size_s)
        return added_us


def drift_of(skew_ppm: float, jump: Jump | None, duration_s: float) -> Drift:
    """Return the drift of camera 2's clock; SimError when the skew or the jump is out of range."""
    if not abs(skew_ppm) <= MAX_SKEW_PPM:
        raise SimError(
            f"clock skew: expected -{MAX_SKEW_PPM:g} to {MAX_SKEW_PPM:g} ppm, got {skew_ppm:g}"
        )
    if jump is not None:
        at_s, size_s = jump
        if not 0.0 < at_s < duration_s:
            raise SimError(
                f"clock jump: expected a time within the flight, 0 to {duration_s:g} s,"
                f" got {at_s:g}"
            )
        if not 0.0 < size_s < np.inf:
            raise SimError(
                f"clock jump: expected a size above 0 s, got {size_s:g}: stamps of a clock that is"
                " set back are out of order; a jump forwards with the cameras swapped is the same"
            )
    return Drift(skew_ppm, duration_s / 2.0, jump)


@dataclass(frozen=True)
class CameraRecording:
    """What one camera recorded, on its own clock."""

    camera: Camera
    events: NDArray[Any]  # sim.sensor.EVENT_DTYPE, sorted by t
    frames: Frames


@dataclass(frozen=True)
class Truth:
    """The ground truth: what an estimator is to find, and what it is scored against."""

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
    """A recording without the cameras' events and frames."""

    rig: Rig
    truth: Truth
    n_instants: int  # chosen for sampling, summed over the cameras
    gl: GLContext | None  # None: nothing was drawn with OpenGL
    check: RenderCheck  # of the native renderer against OpenGL


@dataclass(frozen=True)
class Recording(Flight):
    """A simulated recording of one flight."""

    cameras: tuple[CameraRecording, ...]


class Sink(Protocol):
    """Takes one camera's frames and events as they are recorded, on the camera's clock."""

    def take_frame(self, k: int, image: NDArray[np.uint8], /) -> None:
        """Take frame k when its exposure closes; the caller reuses the array afterwards."""

    def add(self, events: NDArray[Any], /) -> None:
        """Take the next events, of EVENT_DTYPE; all calls together are in order of time."""

    def close(self) -> None:
        """Finish: the camera records nothing more."""


OpenSink = Callable[[Camera, IntArray, float], Sink]
"""Opens the sink of a camera, given the times of its frames (n,) [us] and their exposure [s]."""


TRUTH_HZ = 200.0  # rate at which the truth lists poses: smooth enough to interpolate


def truth_of(rig: Rig, trajectory: Trajectory, t_d_s: float, drift: Drift) -> Truth:
    """Return the ground truth of a flight that a rig films."""
    R, t, baseline_m = rig.extrinsics()
    n = max(2, int(np.ceil(trajectory.duration_s * TRUTH_HZ)) + 1)
    times_s: FloatArray = np.linspace(0.0, trajectory.duration_s, n, dtype=np.float64)
    T_W_B = trajectory.poses(times_s)
    centres_px = np.stack([camera.project(T_W_B[:, :3, 3]) for camera in rig.cameras])
    return Truth(t_d_s, R, t, baseline_m, times_s, T_W_B, centres_px, drift)
