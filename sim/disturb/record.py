"""A configuration, disturbances and a seed in; a spoilt recording as a folder on disk out.

The folder is that of `sim.storage`. truth.json has the disturbances and the true intrinsics within
its provenance; the rig files have the intrinsics that were drawn, and their deviations.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import yaml

from sim.disturb.clutter import clutter, merged, second_seed, thinned, wrong_intrinsics
from sim.disturb.config import DisturbConfig
from sim.disturb.pixels import View
from sim.errors import SimError
from sim.recorded import CameraRecording, Recording
from sim.recording import SimConfig, simulate
from sim.sensor.frames import FrameConfig
from sim.storage import Recorded, check_out_dir, save_recording, true_rig_files

Progress = Callable[[float], None]


def record_disturbed(
    config: SimConfig,
    disturb: DisturbConfig,
    seed: int,
    out_dir: Path,
    provenance: dict[str, Any],
    text: bool = False,
    progress: Progress | None = None,
) -> Recorded:
    """Simulate one flight, spoil it and write it as a folder; unlike `record`, all in memory.

    Parameters
    ----------
    config, seed, out_dir, provenance, text, progress
        As for `sim.storage.record`.
    disturb

    Returns
    -------
    Recorded

    Raises
    ------
    SimError
        As `record` does, when a disturbance does not fit into the view, or when the trajectory of
        a second object is a file's.
    """
    check_out_dir(out_dir)
    if disturb.second_object and config.trajectory_file is not None:
        raise SimError(
            "the second object flies at random, but the trajectory is a file's, which both would "
            "fly: leave out one of them"
        )
    n_flights = 2 if disturb.second_object else 1

    def flight(index: int, of_config: SimConfig, of_seed: int) -> Recording:
        if progress is None:
            return simulate(of_config, of_seed)
        return simulate(of_config, of_seed, lambda share: progress((index + share) / n_flights))

    recording, second = flight(0, config, seed), None
    if disturb.second_object:
        without_frames = replace(config, frames=FrameConfig(rate_hz=0.0))
        second = flight(1, without_frames, second_seed(seed))
    recording = disturbed(recording, disturb, seed, second)
    true = {camera.name: camera.K.tolist() for camera in recording.rig.cameras}
    spoilt = {"disturbances": asdict(disturb), "true_K": true}
    wrong = _wrong_rig_files(recording, disturb, seed) if any(disturb.intrinsics_error) else None
    save_recording(recording, out_dir, provenance | spoilt, text, wrong)
    n_events = tuple(len(camera.events) for camera in recording.cameras)
    n_frames = tuple(len(camera.frames.images) for camera in recording.cameras)
    return Recorded(recording.flight, n_events, n_frames)


def disturbed(
    recording: Recording, disturb: DisturbConfig, seed: int, second: Recording | None = None
) -> Recording:
    """Add clutter to what the cameras recorded; frames, rig and truth stay.

    Parameters
    ----------
    recording
    disturb
    seed
        Of the recording.
    second
        Another flight of the same configuration, of whose events a share is added. The two objects
        do not hide each other.
    """
    truth = recording.truth
    cameras = []
    for index, camera in enumerate(recording.cameras):
        model = camera.camera
        view = View(model.width, model.height, float(truth.times_s[-1]))
        added = clutter(disturb, view, seed, index)
        if index == 1:
            added["t"] += truth.drift.added_us(added["t"])
        added["t"] += round(1e6 * model.time_offset_s)
        streams = [camera.events, added]
        if second is not None:
            others = second.cameras[index].events
            streams.append(thinned(others, disturb.second_object, seed, index))
        cameras.append(CameraRecording(model, merged(*streams), camera.frames))
    return replace(recording, cameras=tuple(cameras))


def _wrong_rig_files(recording: Recording, disturb: DisturbConfig, seed: int) -> dict[str, str]:
    """Give rig files with the intrinsics that were drawn in the place of the true ones."""
    texts = {}
    for name, text in true_rig_files(recording.rig).items():
        chain = yaml.safe_load(text)
        for index, camera in enumerate(recording.rig.cameras):
            K, deviations_px = wrong_intrinsics(camera.K, disturb, seed, index)
            entry = chain[f"cam{index}"]
            entry["intrinsics"] = [float(k) for k in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])]
            entry["intrinsics_std"] = deviations_px.tolist()
        texts[name] = yaml.safe_dump(chain, default_flow_style=None, sort_keys=False)
    return texts
