"""Pyrender's own full frame of one pose, which the atlas is compared with and timed against.

`PyrenderFullFrame.render` is pyrender's renderer (its scene graph, meshes, uniforms and draw calls)
with our shaders, so it has the same samples as the atlas. `PyrenderFullFrame.stock` is pyrender
untouched, shaders and all, so its silhouette is a check that shares no code with ours.
"""

from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Float32Array, FloatArray
from sim.errors import SimError
from sim.render.config import RenderConfig
from sim.render.gl_atlas import (
    BACKGROUND,
    SHADERS,
    attach_renderbuffers,
    make_primitive,
    set_uniforms,
)
from sim.render.gl_context import make_current, open_context
from sim.render.lattice import average_tiles
from sim.scene.drone import Drone, Part, piece_size_m
from sim.scene.rig import Camera

# OpenGL's camera looks along its -z with y up, ours along z with y down.
T_GL_C = np.diag([1.0, -1.0, -1.0, 1.0])


class PyrenderFullFrame:
    """Draws one drone in one camera, a pose at a time."""

    def __init__(self, drone: Drone, camera: Camera, config: RenderConfig | None = None) -> None:
        self.config = config or RenderConfig()
        open_context(self.config.backend)
        import pyrender
        from pyrender.constants import ProgramFlags, RenderFlags
        from pyrender.shader_program import ShaderProgramCache

        self._drone, self._camera = drone, camera
        lattice = self.config.lattice
        self._size = lattice.tile_size(camera.width, camera.height)
        # The whole image is one tile, which starts at the corner of the buffer.
        tile, zero = np.eye(4), np.array(0)
        tile[3, :2] = -lattice.tile_origin(zero, zero, camera.height)
        tile[3, 3] = 0.0
        self._scene = pyrender.Scene(bg_color=np.zeros(4))
        self._nodes = []
        for part in drone.parts:
            primitive = make_primitive(part, piece_size_m(drone, camera), None)
            primitive.poses = tile
            self._nodes.append(self._scene.add(pyrender.Mesh([primitive])))
        self._scene.add(pyrender.IntrinsicsCamera(1.0, 1.0, 0.0, 0.0))  # the shader has its own
        self._renderer = _words_renderer(self._size)
        self._renderer._program_cache = ShaderProgramCache(str(SHADERS))
        self._program = self._renderer._get_primitive_program(
            primitive, RenderFlags.NONE, ProgramFlags.USE_MATERIAL
        )

    def render(self, time_s: float, T_W_B: FloatArray, background: Float32Array) -> Float32Array:
        """Draw the luminance (height, width) of the whole image at one instant."""
        from OpenGL import GL
        from pyrender.constants import RenderFlags

        camera, size = self._camera, self._size
        depths_m = []
        for node, part in zip(self._nodes, self._drone.parts, strict=True):
            T_C_P = camera.T_C_W @ _placed(part, time_s, T_W_B)
            self._scene.set_pose(node, T_C_P)
            depths_m.append(part.vertices_B_m @ T_C_P[2, :3] + T_C_P[2, 3])
        range_m = (0.9 * min(map(np.min, depths_m)), 1.1 * max(map(np.max, depths_m)))
        self._program._bind()
        set_uniforms(self._program._program_id, camera, self.config, size, size, range_m)
        self._renderer.render(self._scene, RenderFlags.NONE)
        words, corner = np.empty(size[::-1], np.uint32), np.zeros((1, 2), np.int64)
        GL.glReadPixels(0, 0, *size, GL.GL_RED_INTEGER, GL.GL_UNSIGNED_INT, words)
        about = (corner, corner, (camera.width, camera.height), background)
        image: Float32Array = average_tiles(words, self.config.lattice, *about)[0]
        return image

    def stock(self, time_s: float, T_W_B: FloatArray) -> NDArray[np.bool_]:
        """Draw one instant with pyrender as it is: which samples see the drone.

        There are a x a samples in each pixel, (height * a, width * a).
        """
        from pyrender.constants import RenderFlags

        if self._camera.distortion_model != "none" or self.config.lattice.b != 0:
            raise SimError(
                "pyrender itself draws undistorted images on a regular grid only: use b = 0"
            )
        scene, nodes = self._stock_scene
        for node, part in zip(nodes, self._drone.parts, strict=True):
            scene.set_pose(node, T_GL_C @ self._camera.T_C_W @ _placed(part, time_s, T_W_B))
        a = self.config.lattice.a
        renderer = _stock_renderer(self._camera.width * a, self._camera.height * a)
        try:
            colour, _ = renderer.render(scene, RenderFlags.SEG, dict.fromkeys(nodes, 255))
        finally:
            make_current()
        covered: NDArray[np.bool_] = colour[..., 0] > 0
        return covered

    @cached_property
    def _stock_scene(self) -> tuple[Any, list[Any]]:
        """Build the scene from the parts alone, without our primitives."""
        import pyrender
        import trimesh

        a, K = self.config.lattice.a, self._camera.K
        camera = pyrender.IntrinsicsCamera(
            a * K[0, 0], a * K[1, 1], a * (K[0, 2] + 0.5), a * (K[1, 2] + 0.5)
        )
        scene = pyrender.Scene()
        scene.add(camera)
        nodes = []
        for part in self._drone.parts:
            mesh = trimesh.Trimesh(part.vertices_B_m, part.faces, process=False)
            nodes.append(scene.add(pyrender.Mesh.from_trimesh(mesh, smooth=False)))
        return scene, nodes


def _placed(part: Part, time_s: float, T_W_B: FloatArray) -> FloatArray:
    """Return T_W_P (4, 4) of a part at one instant."""
    return T_W_B if part.joint is None else T_W_B @ part.joint.transforms(np.array([time_s]))[0]


def _words_renderer(size: tuple[int, int]) -> Any:
    """Return a pyrender.Renderer that draws into a framebuffer of sample words."""
    from OpenGL import GL
    from pyrender.renderer import Renderer

    class WordsRenderer(Renderer):  # type: ignore[misc]
        """Differs from pyrender's only in what it draws into."""

        def __init__(self) -> None:
            super().__init__(*size)
            self._framebuffer = GL.glGenFramebuffers(1)
            self._buffers = GL.glGenRenderbuffers(2)
            GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
            attach_renderbuffers(self._buffers, size)

        def _configure_forward_pass_viewport(self, flags: int) -> None:
            GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
            GL.glViewport(0, 0, *size)
            GL.glEnable(GL.GL_DEPTH_TEST)
            for plane in range(4):
                GL.glDisable(GL.GL_CLIP_DISTANCE0 + plane)

        def _get_camera_matrices(self, scene: Any) -> Any:
            # pyrender has just cleared colour and depth, but clears integers to no defined value.
            GL.glClearBufferuiv(GL.GL_COLOR, 0, BACKGROUND)
            return super()._get_camera_matrices(scene)

        def delete(self) -> None:
            """Free all OpenGL resources."""
            super().delete()
            GL.glDeleteFramebuffers(1, [self._framebuffer])
            GL.glDeleteRenderbuffers(2, self._buffers)

    return WordsRenderer()


@cache
def _stock_renderer(width: int, height: int) -> Any:
    """Return pyrender's own off-screen renderer, with a context of its own."""
    # It lives as long as the process: deleting it on EGL would end every context on the display.
    from pyrender import OffscreenRenderer

    return OffscreenRenderer(width, height)
