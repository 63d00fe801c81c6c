"""Where `sim` meets `ssac`: what an estimator is given of a simulated recording."""

import warnings
from pathlib import Path

import numpy as np

from sim.errors import SimError
from sim.recorded import CameraRecording, Flight, Recording
from sim.recording import SimConfig
from sim.scene.drone import drone_from_file
from sim.scene.rig import Camera as SimCamera
from ssac.camera import Camera, Rig
from ssac.errors import SsacError
from ssac.files.readable import readable
from ssac.track.observation import Observation

_SHARE_OF_FRAMES = 0.1  # what the codec leaves of them
_EVENT_BYTES_PER_S = 200_000.0  # of 60,000 events a second and camera, at 3 bytes each
_TRUTH_BYTES_PER_S = 100_000.0


def observations(recording: Recording) -> tuple[Observation, Observation]:
    """Return what the first two cameras recorded, and nothing of the truth."""
    first, second = (_observation(camera) for camera in recording.cameras[:2])
    return first, second


def rig_of(recording: Recording | Flight, with_extrinsics: bool = False) -> Rig:
    """Return the intrinsics, and the true extrinsics only when asked for."""
    cam1, cam2 = (_camera(camera) for camera in recording.rig.cameras[:2])
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


def recording_bytes(config: SimConfig) -> int:
    """Space that a recording takes at most, both cameras and truth: a rough bound.

    A disk that runs full while HDF5 writes ends the process, so that it must not come to this.
    """
    frames = config.frames.rate_hz * config.resolution[0] * config.resolution[1]
    per_s = 2.0 * (_SHARE_OF_FRAMES * frames + _EVENT_BYTES_PER_S) + _TRUTH_BYTES_PER_S
    return round(config.spline.duration_s * per_s)


def _observation(recording: CameraRecording) -> Observation:
    frames = recording.frames
    if not len(frames.images):
        return Observation(recording.events)
    return Observation(recording.events, frames.images, frames.times_us.astype(np.float64) * 1e-6)


def _camera(camera: SimCamera) -> Camera:
    return Camera(
        K=camera.K,
        width=camera.width,
        height=camera.height,
        distortion_model=camera.distortion_model,
        distortion_coeffs=camera.distortion_coeffs,
    )
