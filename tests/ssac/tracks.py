"""Two frame cameras' tracks of one flight, of our own making, and their files."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from ssac.files.track_files import save_track
from ssac.points import PointTrack
from tests.ssac.synthetic import HEIGHT, WIDTH, K, Scene, make_scene, project

NOISE_PX = 0.3  # of labels
FPS = (30.0, 25.0)


@dataclass(frozen=True)
class TrackPair:
    """Files of two cameras, and what is true of them."""

    folder: Path
    scene: Scene
    t_d_s: float

    @property
    def args(self) -> list[str]:
        """What stands on the command line for them."""
        names = ("cam1.csv", "cam2.csv", "rig.yaml")
        cam1, cam2, rig = (str(self.folder / name) for name in names)
        return [cam1, cam2, "--rig", rig]


def frame_track(
    scene: Scene,
    camera: int,
    fps: float,
    offset_s: float = 0.0,
    rate: float = 1.0,
    readout_s: float = 0.0,
    seed: int = 0,
) -> PointTrack:
    """Label each frame in which the object is in the image.

    The clock shows rate (t + offset) at the flight's time t; row y is exposed readout y / (h - 1)
    after the frame's time.
    """
    shown_s = np.arange(0.0, scene.duration_s, 1.0 / fps) + 0.37 / fps  # frames are free-running

    def seen(times_s):
        points = scene.path(times_s)
        return project(points if camera == 1 else points @ scene.R.T + scene.t)

    points = seen(shown_s)
    for _ in range(4):  # the row that it is in says when it is exposed
        points = seen(shown_s + readout_s * points[:, 1] / (HEIGHT - 1))
    points = points + np.random.default_rng(seed).normal(0.0, NOISE_PX, points.shape)
    inside = np.all((points >= 0.0) & (points <= [WIDTH - 1, HEIGHT - 1]), axis=1)
    return PointTrack((rate * (shown_s + offset_s))[inside], points[inside])


def rig_document(**keys) -> dict:
    """A camchain of two cameras alike; `keys` go to both."""
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])],
        "distortion_model": "none",
        "resolution": [WIDTH, HEIGHT],
        **keys,
    }
    return {"cam0": dict(camera), "cam1": dict(camera)}


def save_pair(
    folder: Path,
    t_d_s: float = 7.3,
    duration_s: float = 20.0,
    rate: float = 1.0,
    readout_s: float = 0.0,
    seed: int = 1,
) -> TrackPair:
    """Write two tracks and their rig."""
    scene = make_scene(seed, duration_s=duration_s)
    save_track(folder / "cam1.csv", frame_track(scene, 1, FPS[0], 0.0, 1.0, readout_s, 1))
    save_track(folder / "cam2.csv", frame_track(scene, 2, FPS[1], t_d_s, rate, 0.0, 2))
    document = rig_document()
    if readout_s:
        document["cam0"]["readout_s"] = readout_s
    (folder / "rig.yaml").write_text(yaml.safe_dump(document))
    return TrackPair(folder, scene, t_d_s)
