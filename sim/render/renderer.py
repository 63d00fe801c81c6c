"""Poses in, linear luminance of crops that follow the drone out.

One draw call renders many instants: each is an instance of the mesh, put into its own tile of an
atlas. The vertex shader is the camera (it projects, distorts and rounds to the rasteriser's grid),
so an instant has the same pixels wherever its tile lies, and the same as in a full frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from sim.errors import SimError
from sim.render.footprint import Footprint, footprint
from sim.render.gl_atlas import MAX_INSTANCES, Atlas
from sim.render.gl_context import GLContext, open_context
from sim.render.lattice import Lattice, average_pixels
from sim.scene.drone import Drone, Part
from sim.scene.rig import Camera
from sim.scene.trajectory import PosesAt

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ATLAS_SIZE = 1024  # samples each way: small enough for the processor's cache
PLANNED_AT_ONCE = 4 * MAX_INSTANCES  # instants
# How far the image may lie beyond the projected hull: the rasteriser's rounding without distortion,
# and with it the bend of an edge between two corners.
MARGIN_PX = {"none": 0.01, "radtan": 1.0, "equidistant": 1.0}


@dataclass(frozen=True)
class RenderConfig:
    """How the drone is drawn."""

    lattice: Lattice = field(default_factory=lambda: Lattice(8, 0))
    light_W: tuple[float, float, float] = (0.35, -0.4, 0.85)  # towards the light, any length
    ambient: float = 0.35  # share of the light that comes from everywhere
    backend: str = "auto"  # "auto", "osmesa" or "egl"


@dataclass(frozen=True)
class Crops:
    """Luminance of rectangles of the image, one for each of n consecutive instants of one camera.

    Outside its rectangle the image shows the background.
    """

    times_s: FloatArray  # (n,) [s]
    x0_px: IntArray  # (n,) column of the first pixel
    y0_px: IntArray  # (n,) row of the first pixel
    luminance: NDArray[np.float32]  # (n, height, width), linear, background included

    def since(self, k: int) -> "Crops":
        """Return the crops from the k-th on."""
        return Crops(self.times_s[k:], self.x0_px[k:], self.y0_px[k:], self.luminance[k:])


class Renderer:
    """Draws one drone; use as a context manager, or call `close`.

    Parameters
    ----------
    drone
    config

    Raises
    ------
    SimError
        No GL context can be opened, or it lacks what is needed.
    """

    def __init__(self, drone: Drone, config: RenderConfig | None = None) -> None:
        self.drone = drone
        self.config = config or RenderConfig()
        if not 0.0 <= self.config.ambient <= 1.0:
            raise SimError(f"ambient light: expected 0 to 1, got {self.config.ambient}")
        self.context: GLContext = open_context(self.config.backend)
        self._gl = Atlas(drone)

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free what this renderer holds on the GL side."""
        self._gl.delete()

    def crops(
        self,
        camera: Camera,
        times_s: FloatArray,
        T_W_B: FloatArray | PosesAt,
        background: NDArray[np.float32],
    ) -> Iterator[Crops]:
        """Render the instants at which the drone is in view, and those next to them.

        Parameters
        ----------
        camera
        times_s
            Increasing instants, shape (n,) [s].
        T_W_B
            Pose of the drone's body at each, shape (n, 4, 4).
        background
            Luminance of the empty scene, shape (height, width).

        Yields
        ------
        Crops
            In order of time. Instants missing from all of them show the background, and so do the
            instants before and after them.
        """
        seen = footprint(self.drone, camera, times_s, T_W_B)
        # One more instant on each side, so that leaving and entering the view are seen as a change.
        near_view = seen.visible.copy()
        near_view[1:] |= seen.visible[:-1]
        near_view[:-1] |= seen.visible[1:]
        chosen = np.flatnonzero(near_view)
        while len(chosen):
            # Not all at once, as the matrices take memory; those that more instants could still
            # join for a batch are planned again with these.
            views = _plan(self.drone, camera, seen, chosen[:PLANNED_AT_ONCE], times_s, T_W_B)
            left_over = MAX_INSTANCES if len(chosen) > PLANNED_AT_ONCE else 0
            start = 0
            while start < len(views.times_s) - left_over:
                stop = self._end_of_batch(views.boxes, start)
                yield self._draw(camera, views.between(start, stop), background)
                start = stop
            chosen = chosen[start:]

    def _light_in_camera(self, camera: Camera) -> FloatArray:
        light_W = np.asarray(self.config.light_W)
        light_C: FloatArray = camera.T_C_W[:3, :3] @ (light_W / np.linalg.norm(light_W))
        return light_C

    def _end_of_batch(self, boxes: IntArray, start: int) -> int:
        """Find how many of the coming instants fit the atlas in tiles of one size."""
        stop = min(start + MAX_INSTANCES, len(boxes))
        while True:
            width, height = _crop_size(boxes[start:stop])
            tile = self.config.lattice.tile_size(width, height)
            room = max(1, (ATLAS_SIZE // tile[0]) * (ATLAS_SIZE // tile[1]))
            if stop - start <= room:
                return stop
            stop = start + room

    def _draw(self, camera: Camera, views: "_Views", background: NDArray[np.float32]) -> Crops:
        lattice = self.config.lattice
        width, height = _crop_size(views.boxes)
        corner_px = np.minimum(views.boxes[:, :2], [camera.width - width, camera.height - height])
        x0, y0 = corner_px[:, 0], corner_px[:, 1]
        tile = lattice.tile_size(width, height)
        corners = _arrange(tile, len(views.times_s))
        shift = corners - lattice.tile_origin(x0, y0, height)
        for matrices in views.T_C_P:
            matrices[:, 3, :2] = shift
            matrices[:, 3, 2:] = corners
        # Where the outline leaves its crop, the tile must cut it off.
        edge = corner_px + np.array([width, height]) - 0.5
        beyond = (views.low_px < corner_px - 0.5) | (views.high_px > edge)
        depth = views.depth_m[views.visible]
        depth_range = (0.9 * depth.min(), 1.1 * depth.max()) if len(depth) else (0.5, 1.0)
        used = corners.max(axis=0) + tile
        self._gl.use_camera(camera, lattice, self._light_in_camera(camera), self.config.ambient)
        words = self._gl.draw(
            views.T_C_P,
            tile,
            (int(used[0]), int(used[1])),
            depth_range,
            clip=bool(beyond[views.visible].any()),
        )
        luminance = average_pixels(words, lattice, corners, x0, y0, (width, height), background)
        return Crops(views.times_s, x0, y0, luminance)


@dataclass(frozen=True)
class _Views:
    """What drawing n instants of one camera needs."""

    times_s: FloatArray  # (n,) [s]
    visible: NDArray[np.bool_]  # (n,)
    low_px: FloatArray  # (n, 2) least column and row that the image may touch
    high_px: FloatArray  # (n, 2) greatest
    depth_m: FloatArray  # (n, 2) least and greatest depth
    boxes: IntArray  # (n, 4) x0, y0, x1, y1 (exclusive) of the whole pixels touched in the image
    T_C_P: list[NDArray[np.float32]]  # of each part (n, 4, 4); the last row is for the tile

    def between(self, start: int, stop: int) -> "_Views":
        """Return the instants from start up to stop."""
        k = slice(start, stop)
        return _Views(
            self.times_s[k],
            self.visible[k],
            self.low_px[k],
            self.high_px[k],
            self.depth_m[k],
            self.boxes[k],
            [matrices[k] for matrices in self.T_C_P],
        )


def _plan(
    drone: Drone,
    camera: Camera,
    seen: Footprint,
    chosen: IntArray,
    times_s: FloatArray,
    T_W_B: FloatArray | PosesAt,
) -> _Views:
    """Prepare the chosen instants for drawing."""
    visible = seen.visible[chosen]
    margin = MARGIN_PX[camera.distortion_model]
    low = np.where(visible[:, None], seen.low_px[chosen] - margin, 0.0)
    high = np.where(visible[:, None], seen.high_px[chosen] + margin, 0.0)
    last = np.array([camera.width - 1, camera.height - 1])
    first_px = np.clip(np.floor(low + 0.5), 0, last)
    last_px = np.clip(np.floor(high + 0.5), 0, last)
    boxes: IntArray = np.concatenate([first_px, last_px + 1], axis=1).astype(np.int64)
    T_C_P = [_placed(camera, part, times_s[chosen], T_W_B[chosen], visible) for part in drone.parts]
    return _Views(times_s[chosen], visible, low, high, seen.depth_m[chosen], boxes, T_C_P)


def _arrange(tile: tuple[int, int], n: int) -> IntArray:
    """Place n tiles in rows: the column and row at which each starts, (n, 2)."""
    per_row = max(1, ATLAS_SIZE // tile[0])
    k = np.arange(n)
    return np.stack([k % per_row * tile[0], k // per_row * tile[1]], axis=-1)


def _crop_size(boxes: IntArray) -> tuple[int, int]:
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
