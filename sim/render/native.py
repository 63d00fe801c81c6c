"""The renderer without OpenGL, whose loops are in `sim.render.native_kernels`.

It draws what `sim.render.gl_atlas` draws, at the same samples.
"""

import numpy as np

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.render.config import DISTORTION_MODELS, RenderConfig
from sim.render.footprint import Views
from sim.render.lattice import runs_of_tile
from sim.render.native_kernels import paint_crops
from sim.scene.drone import Drone, in_memory, part_faces, piece_size_m
from sim.scene.rig import Camera

BATCH = 256  # instants, at most
BATCH_PIXELS = 1 << 21  # of all their crops, at most: 8 MB
# Samples each way that a block of pixels has, at most: its keys stay in the processor's cache.
BLOCK_SAMPLES = 384


_Mesh = tuple[FloatArray, IntArray, IntArray, FloatArray, FloatArray, IntArray]
"""Vertices, the first of each part, faces, normals, albedo, and the first face of each part."""


class NativePainter:
    """Draws one drone."""

    def __init__(self, drone: Drone, config: RenderConfig) -> None:
        self._drone, self._config = drone, config
        self._meshes: dict[float | None, _Mesh] = {}  # by the size of their pieces

    def room(self, width_px: int, height_px: int) -> int:
        """Return how many instants of this size may be drawn at a time."""
        return int(min(BATCH, max(1, BATCH_PIXELS // (width_px * height_px))))

    def paint(
        self, camera: Camera, views: Views, corner_px: IntArray, background: Float32Array
    ) -> Float32Array:
        """Draw crops (n, height, width), whose first pixels are at `corner_px` (n, 2)."""
        lattice = self._config.lattice
        width, height = views.crop_size()
        largest = max(1, BLOCK_SAMPLES // lattice.a)
        block_px = tuple(-(-size // -(-size // largest)) for size in (width, height))
        tile = lattice.tile_size(*block_px)
        piece_m = piece_size_m(self._drone, camera)
        if piece_m not in self._meshes:
            self._meshes[piece_m] = _mesh(self._drone, piece_m)
        K = camera.K
        luminance = np.empty((len(views.times_s), height, width), np.float32)
        paint_crops(  # type: ignore[no-untyped-call]
            *self._meshes[piece_m], views.T_C_P.astype(np.float64), views.visible,
            (K[0, 0], K[1, 1], K[0, 2], K[1, 2]), DISTORTION_MODELS[camera.distortion_model],
            tuple(camera.distortion_coeffs) or (0.0, 0.0, 0.0, 0.0), (lattice.a, lattice.b),
            tuple(lattice.centre),
            lattice.tile_origin(corner_px[:, 0], corner_px[:, 1], block_px[1]),
            block_px, tile, tuple(self._config.light_in(camera)), self._config.ambient,
            runs_of_tile(lattice, block_px), lattice.samples_per_pixel,
            corner_px[:, 0], corner_px[:, 1], background, luminance,
        )  # fmt: skip
        return luminance


def _mesh(drone: Drone, piece_m: float | None) -> _Mesh:
    """Put all parts into one list of faces, in double precision."""
    parts = [part_faces(part, piece_m) for part in drone.parts]
    vertices, faces, n_vertices = [], [], [0]
    with in_memory(sum(len(part.albedo) for part in parts)):
        for part in parts:
            corners = part.corners_m.reshape(-1, 3)
            unique, index = np.unique(corners, axis=0, return_inverse=True)
            faces.append(index.reshape(-1, 3) + n_vertices[-1])
            vertices.append(unique)
            n_vertices.append(n_vertices[-1] + len(unique))
        return (
            np.concatenate(vertices).astype(np.float64),
            np.array(n_vertices),
            np.concatenate(faces),
            np.concatenate([part.normals for part in parts]).astype(np.float64),
            np.concatenate([part.albedo for part in parts]).astype(np.float64),
            np.cumsum([0] + [len(part.albedo) for part in parts]),
        )
