"""A folder of a recording in; what its two cameras saw, and the rig with the true pose, out."""

from pathlib import Path
from typing import NamedTuple

from experiments.run.cache import Cache
from sim.recording import SimConfig
from ssac.camera import Rig
from ssac.files.hdf5 import load_events_h5
from ssac.files.rigs import load_rig
from ssac.track.observation import Observation


class Pair(NamedTuple):
    """The events of two cameras whose clocks agree; no frames."""

    cam1: Observation
    cam2: Observation
    rig: Rig  # with the true extrinsics


def load_pair(folder: Path) -> Pair:
    """Load the events of a recording that `sim.storage` wrote."""
    cam1, cam2 = (Observation(load_events_h5(folder / f"{name}.h5").events) for name in _CAMERAS)
    return Pair(cam1, cam2, load_rig(folder / "rig_extrinsics.yaml"))


def recorded_pair(cache: Cache, config: SimConfig, seed: int) -> Pair:
    """Load a recording of the cache, with the config's offset between the clocks."""
    cam1, cam2, rig = load_pair(cache.recording_folder(config, seed))
    return Pair(cam1, cam2.delayed(config.t_d_s), rig)


_CAMERAS = ("cam1", "cam2")
