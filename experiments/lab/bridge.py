"""Where `sim` meets `ssac`: what an estimator is given of a simulated recording."""

import warnings
from pathlib import Path

import numpy as np

from sim.errors import SimError
from sim.recorded import CameraRecording, Flight, Recording
from sim.scene.drone import drone_from_file
from ssac.camera import Camera, Rig
from ssac.errors import SsacError
from ssac.files.readable import readable
from ssac.track.observation import Observation


def observations(recording: Recording) -> tuple[Observation, Observation]:
    """Return what the first two cameras recorded, and nothing of the truth."""
    first, second = (_observation(camera) for camera in recording.cameras[:2])
    return first, second


def rig_of(recording: Recording | Flight, with_extrinsics: bool = False) -> Rig:
    """Return the intrinsics, and the true extrinsics only when asked for."""
    cam1, cam2 = (
        Camera(one.K, one.width, one.height, one.distortion_model, one.distortion_coeffs)
        for one in recording.rig.cameras[:2]
    )
    T_2_1 = recording.rig.relative_pose(0, 1) if with_extrinsics else None
    return Rig(cam1, cam2, T_2_1)


def check_mesh(path: Path) -> None:
    """Raise SsacError, before any work is done, for a drone's mesh that cannot be used."""
    with readable(path, "the mesh of a drone"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error says it
        try:
            drone_from_file(path)
        except SimError as error:
            raise SsacError(str(error)) from error


def _observation(recording: CameraRecording) -> Observation:
    frames = recording.frames
    if not len(frames.images):
        return Observation(recording.events)
    return Observation(recording.events, frames.images, frames.times_us.astype(np.float64) * 1e-6)
