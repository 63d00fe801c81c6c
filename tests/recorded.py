"""Recordings of two synthetic cameras as files, for tests that need paths; without OpenGL."""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import yaml

from ssac.files.hdf5 import save_events_h5
from tests.ssac.synthetic import HEIGHT, WIDTH, Scene, make_events, make_scene
from tests.ssac.tracks import rig_document

T_D_S = 0.05
FRAME_S = 0.02
DURATION_S = 8.0

KALIBR = yaml.safe_dump(rig_document(distortion_coeffs=[]))


def kalibr_with_pose(scene: Scene) -> str:
    return f"{KALIBR}  T_cn_cnm1: {scene.rig.T_2_1.tolist()}\n"


@dataclass(frozen=True)
class Recorded:
    """A folder with cam1.h5, cam2.h5 (events and frames) and two rigs."""

    folder: Path
    scene: Scene

    def __truediv__(self, name: str) -> Path:
        return self.folder / name

    @property
    def pair(self) -> tuple[str, str]:
        return str(self / "cam1.h5"), str(self / "cam2.h5")


def record(
    folder: Path, duration_s: float = DURATION_S, t_d_s: float = T_D_S, has_frames: bool = True
) -> Recorded:
    """Record a flight at 90 deg; camera 2's clock reads t_d_s more than camera 1's."""
    folder.mkdir(exist_ok=True)
    scene = make_scene(seed=0, duration_s=duration_s)
    # The events are as dense as a real object's, so that denoising keeps them.
    streams = make_events(scene, seed=0, t_d_s=t_d_s, size_m=0.4)
    for name, events, offset_s in zip(("cam1", "cam2"), streams, (0.0, t_d_s), strict=True):
        save_events_h5(folder / f"{name}.h5", events, WIDTH, HEIGHT)
        if has_frames:
            add_frames(folder / f"{name}.h5", offset_s)
    (folder / "rig.yaml").write_text(KALIBR)
    (folder / "rig_extrinsics.yaml").write_text(kalibr_with_pose(scene))
    return Recorded(folder, scene)


def add_frames(path: Path, offset_s: float) -> None:
    """Add frames at 50 Hz, whose brightness both cameras share, at times moved by the offset."""
    rng = np.random.default_rng(7)
    n = round(DURATION_S / FRAME_S)
    grey = np.cumsum(rng.integers(-9, 10, n)) % 256
    images = np.broadcast_to(grey[:, None, None], (n, 4, 4)).astype(np.uint8)
    times_us = np.rint((FRAME_S * (np.arange(n) + 0.5) + offset_s) * 1e6).astype(np.int64)
    with h5py.File(path, "a") as file:
        file["frames/t"], file["frames/images"] = times_us, images
