"""Where `sim` meets `ssac`: a simulated recording in, what an estimator is given out."""

import numpy as np

from sim.recording import CameraRecording, Flight, Recording
from sim.scene.rig import Camera as SimCamera
from ssac.camera import Camera, Rig
from ssac.track.observation import Observation


def observations(recording: Recording) -> tuple[Observation, Observation]:
    """Return what the first two cameras recorded, and nothing of the truth."""
    first, second = (_observation(camera) for camera in recording.cameras[:2])
    return first, second


def rig_of(recording: Recording | Flight, with_extrinsics: bool = False) -> Rig:
    """Return the intrinsics, and the true extrinsics only when asked for."""
    cam1, cam2 = (_camera(camera) for camera in recording.rig.cameras[:2])
    T_2_1 = recording.rig.relative_pose(0, 1) if with_extrinsics else None
    return Rig(cam1, cam2, T_2_1)


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
