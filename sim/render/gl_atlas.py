"""Rendering with OpenGL: the drone's parts, drawn at many instants into one atlas of samples.

Meshes, buffers and shaders are pyrender's objects; the framebuffer and the draw call are ours,
since pyrender draws one frame at a time, in 8-bit colour, and reads its depth back as well.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sim.arrays import Float32Array, IntArray
from sim.errors import SimError
from sim.render.config import DISTORTION_MODELS, RenderConfig
from sim.render.footprint import Views, crop_size
from sim.render.gl_context import open_context
from sim.render.lattice import average_tiles
from sim.scene.drone import Drone, Part, part_faces, piece_size_m
from sim.scene.rig import Camera

SHADERS = Path(__file__).parent / "shaders"
MAX_INSTANCES = 1024  # of one draw call
ATLAS_SIZE = 1024  # samples each way: small enough for the processor's cache


class GLPainter:
    """Draws one drone with OpenGL: what pyrender's own full frame shows, crop by crop.

    One draw call renders many instants: each is an instance of the mesh in its own tile of an
    atlas. The vertex shader applies the camera model and rounds to the rasteriser's grid, so an
    instant has the same pixels wherever its tile lies. SimError without a suitable GL context.
    """

    def __init__(self, drone: Drone, config: RenderConfig) -> None:
        self.context = open_context(config.backend)
        from OpenGL import GL
        from pyrender.shader_program import ShaderProgramCache

        self._GL, self._drone, self._config = GL, drone, config
        self._meshes: dict[float, list[Any]] = {}  # by the size of their pieces
        self._program = ShaderProgramCache(str(SHADERS)).get_program("mesh.vert", "mesh.frag")
        self._program._add_to_context()
        self._framebuffer = GL.glGenFramebuffers(1)
        self._buffers = GL.glGenRenderbuffers(2)
        self._words = np.empty((0, 0), np.uint32)

    def room(self, width_px: int, height_px: int) -> int:
        """Return how many crops of this size may be drawn at a time."""
        tile = self._config.lattice.tile_size(width_px, height_px)
        return min(MAX_INSTANCES, max(1, (ATLAS_SIZE // tile[0]) * (ATLAS_SIZE // tile[1])))

    def close(self) -> None:
        """Free the painter's GL objects."""
        for primitives in self._meshes.values():
            for primitive in primitives:
                primitive._remove_from_context()
        self._meshes = {}
        self._program.delete()
        self._GL.glDeleteFramebuffers(1, [self._framebuffer])
        self._GL.glDeleteRenderbuffers(2, self._buffers)

    def paint(
        self, camera: Camera, views: Views, corner_px: IntArray, background: Float32Array
    ) -> Float32Array:
        """Draw crops, as `sim.render.native.NativePainter.paint` does."""
        lattice, size_px = self._config.lattice, crop_size(views.boxes)
        tile = lattice.tile_size(*size_px)
        # Tiles stand in rows; `corners` are the column and row at which each starts.
        row, column = np.divmod(np.arange(len(views.times_s)), max(1, ATLAS_SIZE // tile[0]))
        corners: IntArray = np.stack([column * tile[0], row * tile[1]], axis=-1)
        # The last row of a matrix holds the tile's shift from the lattice, and its corner.
        matrices = views.T_C_P.copy()
        origins = lattice.tile_origin(corner_px, size_px[1])
        matrices[:, :, 3, :2] = (corners - origins)[:, None]
        matrices[:, :, 3, 2:] = corners[:, None]
        width, height = corners.max(axis=0) + tile
        self._bind_framebuffer(int(width), int(height))
        self._program._bind()
        self._set_uniforms(camera, views, tile)
        self._draw(self._mesh(camera), matrices)
        return average_tiles(self._words, lattice, corners, corner_px, size_px, background)

    def _draw(self, primitives: list[Any], matrices: Float32Array) -> None:
        """Draw every instance of every part, matrices (n, parts, 4, 4), and read the words."""
        GL, (height, width) = self._GL, self._words.shape
        for plane in range(4):  # clip outlines at the border of their tile
            GL.glEnable(GL.GL_CLIP_DISTANCE0 + plane)
        GL.glViewport(0, 0, width, height)
        GL.glClearBufferuiv(GL.GL_COLOR, 0, np.zeros(4, np.uint32))  # words of the background
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        for primitive, columns in zip(primitives, matrices.transpose(1, 0, 3, 2), strict=True):
            # pyrender's buffers, in the order in which it makes them: vertices, instances, indices.
            GL.glBindBuffer(GL.GL_ARRAY_BUFFER, primitive._buffers[1])
            GL.glBufferSubData(GL.GL_ARRAY_BUFFER, 0, columns.nbytes, np.ascontiguousarray(columns))
            primitive._bind()
            GL.glDrawElementsInstanced(
                GL.GL_TRIANGLES, primitive.indices.size, GL.GL_UNSIGNED_INT, None, len(columns)
            )
        GL.glReadPixels(0, 0, width, height, GL.GL_RED_INTEGER, GL.GL_UNSIGNED_INT, self._words)

    def _set_uniforms(self, camera: Camera, views: Views, tile: tuple[int, int]) -> None:
        """Set the uniforms of `mesh.vert`; the size of a tile is in samples."""
        depth = views.depth_m[views.visible]
        depth_range_m = (0.9 * depth.min(), 1.1 * depth.max()) if len(depth) else (0.5, 1.0)
        GL, lattice, K = self._GL, self._config.lattice, camera.K
        locate = partial(GL.glGetUniformLocation, self._program._program_id)
        GL.glUniform4f(locate("intrinsics"), K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        GL.glUniform4f(locate("distortion"), *(camera.distortion_coeffs or (0.0,) * 4))
        GL.glUniform1i(locate("distortion_model"), DISTORTION_MODELS[camera.distortion_model])
        GL.glUniformMatrix2fv(locate("lattice"), 1, GL.GL_TRUE, lattice.A.astype(np.float32))
        GL.glUniform2f(locate("pixel_centre"), *lattice.centre)
        GL.glUniform3f(locate("light"), *self._config.light_in(camera))
        GL.glUniform1f(locate("ambient"), self._config.ambient)
        GL.glUniform2f(locate("viewport"), *self._words.shape[::-1])
        GL.glUniform2f(locate("tile_size"), *tile)
        GL.glUniform2f(locate("depth_range"), *depth_range_m)

    def _mesh(self, camera: Camera) -> list[Any]:
        piece_m = piece_size_m(self._drone, camera)
        if piece_m not in self._meshes:
            primitives = [_primitive(part, piece_m) for part in self._drone.parts]
            for primitive in primitives:
                primitive._add_to_context()
            self._meshes[piece_m] = primitives
        return self._meshes[piece_m]

    def _bind_framebuffer(self, width: int, height: int) -> None:
        """Bind the off-screen buffer, of exactly this size, as drivers clear all of it."""
        GL = self._GL
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glEnable(GL.GL_CULL_FACE)
        GL.glDisable(GL.GL_BLEND)
        GL.glDisable(GL.GL_MULTISAMPLE)
        if self._words.shape == (height, width):
            return
        limit = GL.glGetIntegerv(GL.GL_MAX_RENDERBUFFER_SIZE)
        if max(width, height) > limit:
            raise SimError(
                f"the drone's image needs {width} x {height} samples, this GL driver draws at most "
                f"{limit} each way: use a coarser lattice or a smaller image"
            )
        kinds = (GL.GL_R32UI, GL.GL_DEPTH_COMPONENT24)
        attachments = (GL.GL_COLOR_ATTACHMENT0, GL.GL_DEPTH_ATTACHMENT)
        for buffer, kind, attachment in zip(self._buffers, kinds, attachments, strict=True):
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, kind, width, height)
            about = (GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)
            GL.glFramebufferRenderbuffer(*about)
        if GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER) != GL.GL_FRAMEBUFFER_COMPLETE:
            raise SimError(
                "this GL driver cannot draw into a buffer of 32-bit integers: use Mesa's software "
                "driver (libosmesa6, or libegl1 with libgl1-mesa-dri)"
            )
        self._words = np.empty((height, width), np.uint32)


def _primitive(part: Part, piece_m: float) -> Any:
    """Turn a part into a pyrender.Primitive with one normal and albedo per face."""
    from pyrender.primitive import Primitive

    faces = part_faces(part, piece_m)
    per_face = np.concatenate([faces.normals, faces.albedo[:, None]], axis=1)
    # The image has y down, GL has y up: reversed corners make outward faces GL's front faces.
    rows = np.concatenate(
        [faces.corners_m[:, ::-1], np.repeat(per_face[:, None], 3, axis=1)], axis=2
    ).reshape(-1, 7)
    unique, indices = np.unique(rows, axis=0, return_inverse=True)
    return Primitive(
        unique[:, :3],
        normals=unique[:, 3:6],
        color_0=unique[:, [6, 6, 6, 6]],  # the shader reads the first value
        indices=indices.reshape(-1, 3),
        poses=np.tile(np.eye(4), (MAX_INSTANCES, 1, 1)),
    )
