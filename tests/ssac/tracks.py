"""Synthetic tracks of one flight by two frame cameras, and their files."""

import numpy as np
import yaml

from ssac import PointTrack
from ssac.files.track_files import save_track
from tests.ssac.synthetic import HEIGHT, WIDTH, K, project

NOISE_PX = 0.3  # of labels
FPS = (30.0, 25.0)


def frame_track(scene, camera, fps, offset_s=0.0, rate=1.0, readout_s=0.0, seed=0):
    """Label each frame in which the object is in the image.

    The clock shows rate (t + offset) at the flight's time t; row y is exposed readout y / (h - 1)
    after the frame's time, for an image of height h.
    """
    shown_s = np.arange(0.0, scene.duration_s, 1.0 / fps) + 0.37 / fps  # frames are free-running

    def seen(times_s):
        points = scene.path(times_s)
        return project(points if camera == 1 else points @ scene.R.T + scene.t)

    points = seen(shown_s)
    for _ in range(4):  # the object's row decides when it is exposed
        points = seen(shown_s + readout_s * points[:, 1] / (HEIGHT - 1))
    points = points + np.random.default_rng(seed).normal(0.0, NOISE_PX, points.shape)
    inside = np.all((points >= 0.0) & (points <= [WIDTH - 1, HEIGHT - 1]), axis=1)
    return PointTrack((rate * (shown_s + offset_s))[inside], points[inside])


def frame_tracks(scene, t_d_s, rate=1.0, readouts_s=(0.0, 0.0), seeds=(1, 2)):
    """Two cameras' tracks of one flight; camera 2's clock shows rate (t + t_d)."""
    one, other = readouts_s
    return [
        frame_track(scene, 1, FPS[0], 0.0, 1.0, one, seeds[0]),
        frame_track(scene, 2, FPS[1], t_d_s, rate, other, seeds[1]),
    ]


def rig_document(**keys):
    """A camchain of two cameras alike; `keys` go to both."""
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])],
        "distortion_model": "none",
        "resolution": [WIDTH, HEIGHT],
        **keys,
    }
    return {"cam0": dict(camera), "cam1": dict(camera)}


def save_pair(folder, scene, t_d_s, readout_s=0.0):
    for k, track in enumerate(frame_tracks(scene, t_d_s, readouts_s=(readout_s, 0.0)), start=1):
        save_track(folder / f"cam{k}.csv", track)
    document = rig_document()
    if readout_s:
        document["cam0"]["readout_s"] = readout_s
    (folder / "rig.yaml").write_text(yaml.safe_dump(document))
    return folder
