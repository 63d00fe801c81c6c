"""Crops of linear luminance that follow the drone, drawn by one of two painters.

The painter `native`, in compiled Python, draws the same samples as the painter `pyrender`, with
OpenGL, which is the reference. The two are compared at some instants of each recording.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.errors import SimError
from sim.render.config import RenderConfig
from sim.render.footprint import Views, crop_size, footprint, plan_views
from sim.render.gl_atlas import MAX_INSTANCES, GLPainter
from sim.render.gl_context import GLContext
from sim.render.native import NativePainter
from sim.scene.drone import Drone
from sim.scene.rig import Camera
from sim.scene.trajectory import PosesAt

CHECKED_INSTANTS = 25  # of each camera, drawn by both painters
# By how much the two may differ. Corners are rounded to 1/256 of a sample from double precision in
# `native` and from single precision in OpenGL, which resolves the depth of intersecting surfaces to
# 24 bits. So single samples beside an edge change sides, or a row or a column of a pixel at once if
# the edge runs along the lattice. A corner or face that is wrong changes many more.
MAX_ROWS_OF_PIXEL = 2  # of `Lattice.a` samples
MAX_SAMPLES_PER_PIXEL = 0.02  # in the mean over all pixels of a recording that show the drone
MIN_SHOWN = 10_000  # pixels: in the mean of fewer, a row or two weigh too much


class Crops(NamedTuple):
    """Luminance of rectangles of the image, one for each of n consecutive instants of one camera.

    Outside its rectangle the image shows the background.
    """

    times_s: FloatArray  # (n,) [s]
    x0_px: IntArray  # (n,) column of the first pixel
    y0_px: IntArray  # (n,) row of the first pixel
    luminance: Float32Array  # (n, height, width), linear, background included


@dataclass
class RenderCheck:
    """How far the native renderer's pixels are from OpenGL's at the instants that both drew."""

    n_instants: int = 0
    n_pixels: int = 0  # that show the drone
    max_difference: float = 0.0  # of linear luminance
    sum_difference: float = 0.0

    @property
    def mean_difference(self) -> float:
        """Mean over the pixels that show the drone."""
        return self.sum_difference / max(self.n_pixels, 1)


class Renderer:
    """Draws one drone; use as a context manager.

    The seed chooses the instants that are checked. SimError where no suitable GL context can be
    opened; "native" with `check=False` needs none.
    """

    def __init__(self, drone: Drone, config: RenderConfig | None = None, seed: int = 0) -> None:
        self.drone = drone
        self.config = config or RenderConfig()
        self.check = RenderCheck()
        self.context: GLContext | None = None  # None: nothing was drawn with OpenGL
        self._seed = seed
        self._reference: GLPainter | None = None
        self._painter: NativePainter | GLPainter
        if self.config.renderer == "pyrender":
            self._painter = self._reference = GLPainter(drone, self.config)
        else:
            self._painter = NativePainter(drone, self.config)
            if self.config.check:
                self._reference = GLPainter(drone, self.config)
        if self._reference is not None:
            self.context = self._reference.context

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *_: object) -> None:
        if self._reference is not None:
            self._reference.close()

    def crops(
        self,
        camera: Camera,
        times_s: FloatArray,
        T_W_B: FloatArray | PosesAt,
        background: Float32Array,
    ) -> Iterator[Crops]:
        """Render, in order, the instants at which the drone is in view, and those next to them.

        `times_s` (n,) are increasing, `T_W_B` (n, 4, 4) the body's poses. An instant missing from
        all crops shows the background (height, width), as do its two neighbours. SimError when
        the two painters differ by more than rounding explains.
        """
        seen = footprint(self.drone, camera, times_s, T_W_B)
        checked = self._checked(np.flatnonzero(seen.visible))
        # One more instant on each side, so that leaving and entering the view are seen as a change.
        chosen = np.flatnonzero(binary_dilation(seen.visible))
        while len(chosen):
            size = self._size_of_batch(seen.boxes[chosen[:MAX_INSTANCES]])  # no batch is larger
            batch, chosen = chosen[:size], chosen[size:]
            views = plan_views(self.drone, camera, seen, batch, times_s, T_W_B)
            width, height = crop_size(views.boxes)
            last_px = [camera.width - width, camera.height - height]
            corner_px = np.minimum(views.boxes[:, :2], last_px)
            luminance = self._painter.paint(camera, views, corner_px, background)
            here = np.flatnonzero(np.isin(batch, checked))
            if len(here):
                self._compare(camera, views, here, corner_px, background, luminance)
            x0_px, y0_px = np.ascontiguousarray(corner_px.T)  # else kernels are compiled twice
            yield Crops(views.times_s, x0_px, y0_px, luminance)

    def _size_of_batch(self, boxes: IntArray) -> int:
        """Return how many of the next instants to paint at a time, in crops of one size."""
        # The crop grows with the batch, so the first one's room bounds that of all.
        size = min(len(boxes), self._painter.room(*crop_size(boxes[:1])))
        while (room := self._painter.room(*crop_size(boxes[:size]))) < size:
            size = room
        return size

    def _checked(self, visible: IntArray) -> IntArray:
        """Choose instants to check: a random one from each of equal shares of those in view."""
        if self._reference is None or self._painter is self._reference or not len(visible):
            return np.empty(0, np.int64)
        n = min(CHECKED_INSTANTS, len(visible))
        within = np.random.default_rng(self._seed).random(n)
        return visible[((np.arange(n) + within) * len(visible) / n).astype(np.int64)]

    def _compare(
        self,
        camera: Camera,
        batch: Views,
        here: IntArray,
        corner_px: IntArray,
        background: Float32Array,
        luminance: Float32Array,
    ) -> None:
        """Draw some instants of a batch with OpenGL too, and add up the differences."""
        assert self._reference is not None
        albedo = np.concatenate([part.albedo for part in self.drone.parts])
        contrast = max(float(albedo.max()), float(background.max()))
        lattice = self.config.lattice
        at_most = MAX_ROWS_OF_PIXEL * (lattice.a + lattice.b) * contrast / lattice.samples_per_pixel
        for k in here:
            alone = Views._make(values[[k]] for values in batch)
            width, height = crop_size(alone.boxes)
            x0, y0 = alone.boxes[0, :2]
            wanted = self._reference.paint(camera, alone, alone.boxes[:, :2], background)[0]
            drawn = luminance[k, y0 - corner_px[k, 1] :, x0 - corner_px[k, 0] :][:height, :width]
            difference = np.abs(drawn.astype(np.float64) - wanted)
            behind = background[y0 : y0 + height, x0 : x0 + width]
            shown = int(np.count_nonzero((wanted != behind) | (drawn != behind)))
            if difference.max() > at_most:
                raise SimError(
                    f"{camera.name}: at {alone.times_s[0]:.6f} s the native renderer differs from "
                    f"pyrender by up to {difference.max():.2g} of luminance (expected at most "
                    f"{at_most:.2g}): use --renderer pyrender, and report the scene"
                )
            self.check.n_instants += 1
            self.check.n_pixels += shown
            self.check.max_difference = max(self.check.max_difference, float(difference.max()))
            self.check.sum_difference += float(difference.sum())
        in_the_mean = MAX_SAMPLES_PER_PIXEL * contrast / lattice.samples_per_pixel
        if self.check.sum_difference > in_the_mean * max(self.check.n_pixels, MIN_SHOWN):
            raise SimError(
                f"{camera.name}: up to {batch.times_s[-1]:.6f} s the native renderer differs from "
                f"pyrender by {self.check.mean_difference:.2g} of luminance in the mean (expected "
                f"at most {in_the_mean:.2g}): use --renderer pyrender, and report the scene"
            )
