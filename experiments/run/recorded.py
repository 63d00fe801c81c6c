"""A folder of a recording in; what its two cameras saw, and the rig with the true pose, out."""

from dataclasses import astuple, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from experiments.run.cache import Cache, Denoised
from sim.recording import SimConfig
from ssac.camera import Rig
from ssac.config import Config
from ssac.files.hdf5 import load_events_h5
from ssac.files.rigs import load_rig
from ssac.track.clutter import chosen_events, which_of
from ssac.track.denoise import Clutter
from ssac.track.observation import Observation, denoised


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


def denoised_pair(
    folder: Path, cam1: Observation, cam2: Observation, rig: Rig, config: Config, cache: Cache
) -> tuple[Observation, Observation]:
    """Both cameras of a recording of the cache as denoising leaves them, which is done once.

    A pair of which nothing is left of a camera comes back as it is: methods say what that means.
    """

    def denoise() -> Denoised:
        clean1, clean2 = denoised(cam1, cam2, rig, config)
        return Denoised(*_bits(cam1, clean1), *_bits(cam2, clean2))

    kept = cache.denoised(folder, config.n_neighbours, denoise)
    pair = _clean(cam1, *kept[:3]), _clean(cam2, *kept[3:])
    return pair if all(len(one.events) for one in pair) else (cam1, cam2)


Bits = NDArray[np.uint8]


def _bits(raw: Observation, clean: Observation) -> tuple[Bits, NDArray[np.float64], Bits]:
    """Give what `_clean` needs beside the events as recorded."""
    kept = np.packbits(which_of(raw.events, clean.events))
    assert clean.clutter is not None  # of a recording, which is not denoised yet
    clutter = np.array(astuple(clean.clutter), dtype=np.float64)
    on_line = np.empty(0, np.uint8) if clean.on_line is None else np.packbits(clean.on_line)
    return kept, clutter, on_line


def _clean(
    raw: Observation, kept: Bits, clutter: NDArray[np.float64], on_line: Bits
) -> Observation:
    is_kept = np.unpackbits(kept, count=len(raw.events)).view(np.bool_)
    events = chosen_events(raw.events, is_kept)
    pixels, masked, hz, radius_px, n_neighbours, n_min = clutter.tolist()
    found = Clutter(int(pixels), int(masked), hz, radius_px, int(n_neighbours), int(n_min))
    line = np.unpackbits(on_line, count=len(events)).view(np.bool_) if len(on_line) else None
    return replace(raw, events=events, denoised=True, clutter=found, on_line=line)


_CAMERAS = ("cam1", "cam2")
