"""Instants and footprints in, what drawing them needs out: which pixels, and where each part is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.render.footprint import Footprint
from sim.scene.camera import Camera
from sim.scene.drone import Drone, Part
from sim.scene.trajectory import PosesAt

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# How far the image may lie beyond the projected hull: the rasteriser's rounding without distortion,
# and with it the bend of an edge between two corners.
MARGIN_PX = {"none": 0.01, "radtan": 1.0, "equidistant": 1.0}


@dataclass(frozen=True)
class Views:
    """What drawing n instants of one camera needs."""

    times_s: FloatArray  # (n,) [s]
    visible: NDArray[np.bool_]  # (n,)
    low_px: FloatArray  # (n, 2) least column and row that the image may touch
    high_px: FloatArray  # (n, 2) greatest
    depth_m: FloatArray  # (n, 2) least and greatest depth
    boxes: IntArray  # (n, 4) x0, y0, x1, y1 (exclusive) of the whole pixels touched in the image
    T_C_P: list[NDArray[np.float32]]  # of each part (n, 4, 4); the last row is for the tile

    def chosen(self, which: slice | IntArray) -> "Views":
        """Return some of the instants."""
        return Views(
            self.times_s[which],
            self.visible[which],
            self.low_px[which],
            self.high_px[which],
            self.depth_m[which],
            self.boxes[which],
            [matrices[which] for matrices in self.T_C_P],
        )


def plan_views(
    drone: Drone,
    camera: Camera,
    seen: Footprint,
    chosen: IntArray,
    times_s: FloatArray,
    T_W_B: FloatArray | PosesAt,
) -> Views:
    """Prepare the chosen instants for drawing."""
    visible = seen.visible[chosen]
    margin = MARGIN_PX[camera.distortion_model]
    low = np.where(visible[:, None], seen.low_px[chosen] - margin, 0.0)
    high = np.where(visible[:, None], seen.high_px[chosen] + margin, 0.0)
    last = np.array([camera.width - 1, camera.height - 1])
    first_px = np.clip(np.floor(low + 0.5), 0, last)
    last_px = np.clip(np.floor(high + 0.5), 0, last)
    boxes: IntArray = np.concatenate([first_px, last_px + 1], axis=1).astype(np.int64)
    poses = T_W_B[chosen]
    T_C_P = [_placed(camera, part, times_s[chosen], poses, visible) for part in drone.parts]
    return Views(times_s[chosen], visible, low, high, seen.depth_m[chosen], boxes, T_C_P)


def crop_size(boxes: IntArray) -> tuple[int, int]:
    """Width and height [px] of the smallest crop that is large enough for every box."""
    size = (boxes[:, 2:] - boxes[:, :2]).max(axis=0)
    return int(size[0]), int(size[1])


def _placed(
    camera: Camera,
    part: Part,
    times_s: FloatArray,
    T_W_B: FloatArray,
    visible: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """Return T_C_P (n, 4, 4) of a part; out of view it shrinks to a point and covers no sample."""
    T_W_P = T_W_B if part.joint is None else T_W_B @ part.joint.transforms(times_s)
    matrices = camera.T_C_W @ T_W_P
    matrices[~visible] = np.diag([0.0, 0.0, 0.0, 1.0])
    matrices[~visible, 2, 3] = 1.0  # on the axis, in front of the camera
    return matrices.astype(np.float32)
