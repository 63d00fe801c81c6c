"""Rendering with OpenGL: the drone's parts, drawn at many instants into one atlas of samples.

Meshes, buffers and shaders are pyrender's objects; the framebuffer and the draw call are ours,
since pyrender draws one frame at a time, in 8-bit colour, and reads its depth back as well.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.errors import SimError
from sim.render.config import DISTORTION_MODELS, RenderConfig
from sim.render.footprint import Views, crop_size
from sim.render.gl_context import open_context
from sim.render.lattice import Lattice, average_pixels
from sim.scene.drone import Drone, Part, part_faces, piece_size_m
from sim.scene.rig import Camera

SHADERS = Path(__file__).parent / "shaders"
MAX_INSTANCES = 1024  # of one draw call
ATLAS_SIZE = 1024  # samples each way: small enough for the processor's cache
_BACKGROUND = np.zeros(4, np.uint32)


class GLPainter:
    """Draws one drone with OpenGL: what pyrender's own full frame shows, crop by crop.

    One draw call renders many instants: each is an instance of the mesh, put into its own tile of
    an atlas. The vertex shader is the camera (it projects, distorts and rounds to the rasteriser's
    grid), so an instant has the same pixels wherever its tile lies, and the same as in a full
    frame. SimError where no GL context can be opened, or it lacks what is needed.
    """

    def __init__(self, drone: Drone, config: RenderConfig) -> None:
        self._config = config
        self.context = open_context(config.backend)
        self._atlas = Atlas(drone)

    def room(self, width_px: int, height_px: int) -> int:
        """Return how many instants of this size may be drawn at a time."""
        tile = self._config.lattice.tile_size(width_px, height_px)
        return min(MAX_INSTANCES, max(1, (ATLAS_SIZE // tile[0]) * (ATLAS_SIZE // tile[1])))

    def close(self) -> None:
        """Free what it holds on the GL side."""
        self._atlas.delete()

    def paint(
        self, camera: Camera, views: Views, corner_px: IntArray, background: Float32Array
    ) -> Float32Array:
        """Draw crops, as `sim.render.native.NativePainter.paint` does."""
        config, lattice = self._config, self._config.lattice
        width, height = crop_size(views.boxes)
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
        self._atlas.use_camera(camera, lattice, config.light_in(camera), config.ambient)
        words = self._atlas.draw(
            views.T_C_P,
            tile,
            (int(used[0]), int(used[1])),
            depth_range,
            clip=bool(beyond[views.visible].any()),
        )
        return average_pixels(words, lattice, corners, x0, y0, (width, height), background)


def _arrange(tile: tuple[int, int], n: int) -> IntArray:
    """Place n tiles in rows: the column and row at which each starts, (n, 2)."""
    per_row = max(1, ATLAS_SIZE // tile[0])
    k = np.arange(n)
    return np.stack([k % per_row * tile[0], k // per_row * tile[1]], axis=-1)


@dataclass(frozen=True)
class _Mesh:
    """One part on the GL side."""

    primitive: Any  # pyrender.Primitive
    n_indices: int
    instance_buffer: int


class Atlas:
    """An off-screen buffer of sample words, and the drone's parts; the GL context must be open."""

    def __init__(self, drone: Drone) -> None:
        from OpenGL import GL
        from pyrender.shader_program import ShaderProgramCache

        self._GL = GL
        self._drone = drone
        self._meshes: dict[bool, list[_Mesh]] = {}  # by whether edges may bend
        self._bends = False
        self._camera: Camera | None = None  # whose uniforms are set
        self._program = ShaderProgramCache(str(SHADERS)).get_program("mesh.vert", "mesh.frag")
        self._program._add_to_context()
        self._framebuffer = GL.glGenFramebuffers(1)
        self._words_buffer, self._depth_buffer = GL.glGenRenderbuffers(2)
        self._size = (0, 0)
        self._words = np.empty((0, 0), np.uint32)

    def delete(self) -> None:
        """Free the GL objects."""
        GL = self._GL
        for meshes in self._meshes.values():
            for mesh in meshes:
                mesh.primitive._remove_from_context()
        self._meshes = {}
        self._program.delete()
        GL.glDeleteFramebuffers(1, [self._framebuffer])
        GL.glDeleteRenderbuffers(2, [self._words_buffer, self._depth_buffer])

    def use_camera(
        self, camera: Camera, lattice: Lattice, light_C: FloatArray, ambient: float
    ) -> None:
        """Make this the camera of the draw calls to come; lattice and light are always the same."""
        self._program._bind()
        if camera is self._camera:
            return
        self._camera = camera
        self._bends = camera.distortion_model != "none"
        if self._bends not in self._meshes:
            piece_m = piece_size_m(self._drone, camera)
            self._meshes[self._bends] = [_upload(part, piece_m) for part in self._drone.parts]
        set_camera_uniforms(self._program._program_id, camera, lattice, light_C, ambient)

    def draw(
        self,
        T_C_P: list[Float32Array],
        tile: tuple[int, int],
        size: tuple[int, int],
        depth_range_m: tuple[float, float],
        clip: bool,
    ) -> NDArray[np.uint32]:
        """Draw every instance of every part; the sample words stay valid until the next call.

        Parameters
        ----------
        T_C_P
            For each part, its instances' matrices (n, 4, 4): part to camera [m], and in the last
            row the shift from lattice to atlas coordinates and the corner of the tile.
        tile, size
            Width and height of a tile and of the part of the atlas in use [samples].
        depth_range_m
            Depths between which everything lies [m].
        clip
            Cut each instance off at the border of its tile.
        """
        GL = self._GL
        width, height = size
        self._bind_framebuffer(width, height)
        self._program._bind()
        set_tile_uniforms(self._program._program_id, size, tile, depth_range_m)
        for plane in range(4):
            (GL.glEnable if clip else GL.glDisable)(GL.GL_CLIP_DISTANCE0 + plane)
        GL.glViewport(0, 0, width, height)
        GL.glClearBufferuiv(GL.GL_COLOR, 0, _BACKGROUND)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        for mesh, matrices in zip(self._meshes[self._bends], T_C_P, strict=True):
            columns = np.ascontiguousarray(matrices.transpose(0, 2, 1))
            GL.glBindBuffer(GL.GL_ARRAY_BUFFER, mesh.instance_buffer)
            GL.glBufferSubData(GL.GL_ARRAY_BUFFER, 0, columns.nbytes, columns)
            mesh.primitive._bind()
            GL.glDrawElementsInstanced(
                GL.GL_TRIANGLES, mesh.n_indices, GL.GL_UNSIGNED_INT, None, len(matrices)
            )
        GL.glReadPixels(0, 0, width, height, GL.GL_RED_INTEGER, GL.GL_UNSIGNED_INT, self._words)
        return self._words

    def _bind_framebuffer(self, width: int, height: int) -> None:
        """Bind the off-screen buffer, of just this size: drivers clear all of it, used or not."""
        GL = self._GL
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glEnable(GL.GL_CULL_FACE)
        GL.glDisable(GL.GL_BLEND)
        GL.glDisable(GL.GL_MULTISAMPLE)
        if (width, height) == self._size:
            return
        limit = GL.glGetIntegerv(GL.GL_MAX_RENDERBUFFER_SIZE)
        if max(width, height) > limit:
            raise SimError(
                f"the drone's image needs {width} x {height} samples, this GL driver draws at most "
                f"{limit} each way: use a coarser lattice or a smaller image"
            )
        self._size = (width, height)
        attach_renderbuffers(self._words_buffer, self._depth_buffer, self._size)
        self._words = np.empty((height, width), np.uint32)


def attach_renderbuffers(words_buffer: int, depth_buffer: int, size: tuple[int, int]) -> None:
    """Give the bound framebuffer 32-bit sample words and a 24-bit depth buffer of this size."""
    from OpenGL import GL

    for buffer, kind, attachment in (
        (words_buffer, GL.GL_R32UI, GL.GL_COLOR_ATTACHMENT0),
        (depth_buffer, GL.GL_DEPTH_COMPONENT24, GL.GL_DEPTH_ATTACHMENT),
    ):
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
        GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, kind, *size)
        GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)
    if GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER) != GL.GL_FRAMEBUFFER_COMPLETE:
        raise SimError(
            "this GL driver cannot draw into a buffer of 32-bit integers: use Mesa's software "
            "driver (libosmesa6, or libegl1 with libgl1-mesa-dri)"
        )


def set_camera_uniforms(
    program_id: int, camera: Camera, lattice: Lattice, light_C: FloatArray, ambient: float
) -> None:
    """Set what the shaders of `mesh.vert` need of a camera, in the program in use."""
    from OpenGL import GL

    locate = partial(GL.glGetUniformLocation, program_id)
    K = camera.K
    coeffs = camera.distortion_coeffs or (0.0, 0.0, 0.0, 0.0)
    GL.glUniformMatrix4fv(locate("M"), 1, GL.GL_TRUE, np.eye(4, dtype=np.float32))
    GL.glUniform4f(locate("intrinsics"), K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    GL.glUniform4f(locate("distortion"), *coeffs)
    GL.glUniform1i(locate("distortion_model"), DISTORTION_MODELS[camera.distortion_model])
    GL.glUniformMatrix2fv(locate("lattice"), 1, GL.GL_TRUE, lattice.A.astype(np.float32))
    GL.glUniform2f(locate("pixel_centre"), *lattice.centre)
    GL.glUniform3f(locate("light"), *light_C)
    GL.glUniform1f(locate("ambient"), ambient)


def set_tile_uniforms(
    program_id: int,
    size: tuple[int, int],
    tile: tuple[int, int],
    depth_range_m: tuple[float, float],
) -> None:
    """Set the sizes of viewport and tile [samples], and the depths between which all lies."""
    from OpenGL import GL

    locate = partial(GL.glGetUniformLocation, program_id)
    GL.glUniform2f(locate("viewport"), *size)
    GL.glUniform2f(locate("tile_size"), *tile)
    GL.glUniform2f(locate("depth_range"), *depth_range_m)


def make_primitive(part: Part, piece_m: float | None, n_instances: int | None) -> Any:
    """Turn a part into a pyrender.Primitive with one normal and albedo per face.

    No edge is longer than `piece_m`; there is room for `n_instances`, or pyrender's single one.
    """
    from pyrender.primitive import Primitive

    faces = part_faces(part, piece_m)
    per_face = np.concatenate([faces.normals, faces.albedo[:, None]], axis=1)
    # The image has y down where GL has it up, so what GL must see as the front is the inside.
    rows = np.concatenate(
        [faces.corners_m[:, ::-1], np.repeat(per_face[:, None], 3, axis=1)], axis=2
    ).reshape(-1, 7)
    unique, indices = np.unique(rows, axis=0, return_inverse=True)
    colours = np.zeros((len(unique), 4), np.float32)
    colours[:, 0] = unique[:, 6]
    colours[:, 3] = 1.0
    return Primitive(
        unique[:, :3],
        normals=unique[:, 3:6],
        color_0=colours,
        indices=indices.reshape(-1, 3),
        poses=None if n_instances is None else np.tile(np.eye(4), (n_instances, 1, 1)),
    )


def _upload(part: Part, piece_m: float | None) -> _Mesh:
    primitive = make_primitive(part, piece_m, MAX_INSTANCES)
    primitive._add_to_context()
    # pyrender's buffers, in the order in which it makes them: vertices, instances, indices.
    return _Mesh(primitive, primitive.indices.size, primitive._buffers[1])
