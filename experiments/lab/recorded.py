"""Conversion of recordings of `sim` to inputs of `ssac`, with the ground truth apart from them."""

import json
import warnings
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from experiments.lab.cache import Cache
from sim.errors import SimError
from sim.recorded import Recording
from sim.recording import SimConfig
from sim.scene.drone import drone_from_file
from ssac.arrays import Array
from ssac.camera import Camera, Rig
from ssac.clock import Clock
from ssac.config import Config
from ssac.errors import SsacError
from ssac.files.damage import readable
from ssac.files.rigs import load_rig
from ssac.pipeline.chain import Chain
from ssac.pipeline.opened import cameras_of, opened
from ssac.track.observation import Observation

RIG_FILE = "rig_extrinsics.yaml"
_CAMERAS = ("cam1", "cam2")

Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class FlightTruth:
    """The ground truth of a recorded flight."""

    times_s: Array  # (n,) on camera 1's clock
    positions_m: Array  # (n, 3) of the drone's origin in the world frame
    quaternions: Array  # (n, 4) body to world
    centres_px: tuple[Array, ...]  # by camera (n, 2): images of the origin, or NaN
    T_C_W: tuple[Array, ...]  # by camera (4, 4)
    R: Array  # (3, 3) x2 = R x1 + t, of the first two cameras
    t: Array  # (3,) of length 1
    baseline_m: float
    clock: Clock  # camera 2's

    def pose(self, k: int) -> Array:
        """T_k_1 (4, 4): from the first camera's frame to that of the k-th."""
        return np.asarray(self.T_C_W[k] @ np.linalg.inv(self.T_C_W[0]))


def load_truth(folder: Path, t_d_s: float | None = None) -> FlightTruth:
    """Read a recording's ground truth; `t_d_s`, if given, replaces the recorded clock offset."""
    path = folder / "truth.json"
    with readable(path, "the truth of a recording"):
        content = json.loads(path.read_text(encoding="utf-8"))
        cameras = [content["cameras"][f"cam{k + 1}"] for k in range(len(content["cameras"]))]
        names = "times_s", "drone_position_W_m", "drone_quaternion_W_B_xyzw"
        times_s, positions_m, quaternions = (np.array(content[of], np.float64) for of in names)
        centres_px = tuple(np.array(camera["drone_px"], np.float64) for camera in cameras)
        T_C_W = tuple(np.array(camera["T_C_W"], np.float64) for camera in cameras)
        n = len(times_s)
        shapes = [one.shape for one in (times_s, positions_m, quaternions, *centres_px, *T_C_W)]
        if shapes != [(n,), (n, 3), (n, 4), *[(n, 2)] * len(cameras), *[(4, 4)] * len(cameras)]:
            raise ValueError("its lists are not of one length, or no poses of cameras")
        offset_s = content["t_d_s"] if t_d_s is None else t_d_s
        return FlightTruth(
            times_s,
            positions_m,
            quaternions,
            centres_px,
            T_C_W,
            np.array(content["R"], np.float64),
            np.array(content["t"], np.float64),
            float(content["baseline_m"]),
            Clock(offset_s, content["skew_ppm"], content["t_ref_s"]),
        )


class Pair(NamedTuple):
    """The recordings of two cameras, and their rig."""

    cam1: Observation
    cam2: Observation
    rig: Rig  # with the true extrinsics

    def chain(self, config: Config | None = None) -> Chain:
        """Give all as the input of methods."""
        return Chain((self.cam1, self.cam2), self.rig, config)


def load_pair(folder: Path, frames: str = "") -> Pair:
    """Load a recording that `sim.storage` wrote, with MEANS or IMAGES of frames if asked for."""
    rig = load_rig(folder / RIG_FILE)
    files = opened([folder / f"{name}.h5" for name in _CAMERAS], cameras_of(rig))
    cam1, cam2 = (replace(one.read(frames), name="") for one in files)  # messages number them
    return Pair(cam1, cam2, rig)


def recorded_pair(cache: Cache, config: SimConfig, seed: int) -> Pair:
    """Load a recording of the cache, with the config's offset between the clocks."""
    cam1, cam2, rig = load_pair(cache.recording_folder(config, seed))
    return Pair(cam1, cam2.delayed(config.t_d_s), rig)


@dataclass
class Flown:
    """Two flights, each loaded on first use, and the last result computed from them."""

    load: Callable[[int], Pair]  # takes a seed
    seed: int
    other_seed: int = 0
    _made: dict[Hashable, Any] = field(default_factory=dict)

    @cached_property
    def flight(self) -> Pair:
        """The flight with `seed`."""
        return self.load(self.seed)

    @cached_property
    def other(self) -> Pair:
        """The flight with `other_seed`."""
        return self.load(self.other_seed)

    def made(self, name: Hashable, make: Callable[[], Made]) -> Made:
        """Return the last result if of this name, else make it; cells sharing it are adjacent."""
        if name not in self._made:
            self._made = {name: make()}
        made: Made = self._made[name]
        return made


def observations(recording: Recording) -> tuple[Observation, Observation]:
    """Return what the first two cameras recorded, without any ground truth."""
    first, second = (
        Observation(one.events, one.frames.images, one.frames.times_us.astype(np.float64) * 1e-6)
        if len(one.frames.images)
        else Observation(one.events)
        for one in recording.cameras[:2]
    )
    return first, second


def rig_of(recording: Recording) -> Rig:
    """Return the rig of the first two cameras, with the true extrinsics."""
    cam1, cam2 = (
        Camera(one.K, one.width, one.height, one.distortion_model, one.distortion_coeffs)
        for one in recording.rig.cameras[:2]
    )
    return Rig(cam1, cam2, recording.rig.relative_pose(0, 1))


def check_mesh(path: Path) -> None:
    """Raise SsacError, before any work is done, for a drone's mesh that cannot be used."""
    with readable(path, "the mesh of a drone"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error says the same
        try:
            drone_from_file(path)
        except SimError as error:
            raise SsacError(str(error)) from error
