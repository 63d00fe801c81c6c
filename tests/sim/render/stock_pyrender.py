"""Pyrender as it comes, whose silhouette is a check that shares no code, nor shader, with ours."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.arrays import FloatArray
from sim.render.gl_context import _KEEP_ALIVE, open_context
from sim.scene.drone import Drone
from sim.scene.rig import Camera

# OpenGL's camera looks along its -z with y up, ours along z with y down.
T_GL_C = np.diag([1.0, -1.0, -1.0, 1.0])


class StockPyrender:
    """Draws one drone in one camera without distortion, at a x a samples in each pixel."""

    def __init__(self, drone: Drone, camera: Camera, a: int, backend: str = "auto") -> None:
        open_context(backend)
        import pyrender
        import trimesh

        self._drone, self._camera, self._size = drone, camera, (camera.width * a, camera.height * a)
        K, self._scene = camera.K, pyrender.Scene()
        centre = (a * (K[0, 2] + 0.5), a * (K[1, 2] + 0.5))
        self._scene.add(pyrender.IntrinsicsCamera(a * K[0, 0], a * K[1, 1], *centre))
        meshes = (trimesh.Trimesh(p.vertices_B_m, p.faces, process=False) for p in drone.parts)
        self._nodes = [
            self._scene.add(pyrender.Mesh.from_trimesh(mesh, smooth=False)) for mesh in meshes
        ]

    def covered(self, time_s: float, T_W_B: FloatArray) -> NDArray[np.bool_]:
        """Draw one instant: which samples see the drone, (height * a, width * a)."""
        from pyrender.constants import RenderFlags

        for node, part in zip(self._nodes, self._drone.parts, strict=True):
            T_B_P = part.joint.transforms(np.array([time_s]))[0] if part.joint else np.eye(4)
            self._scene.set_pose(node, T_GL_C @ self._camera.T_C_W @ T_W_B @ T_B_P)
        renderer = _offscreen(*self._size)
        try:
            colour, _ = renderer.render(
                self._scene, RenderFlags.SEG, dict.fromkeys(self._nodes, 255)
            )
        finally:
            for one in _KEEP_ALIVE:  # back from the context of pyrender's own
                one._platform.make_current()
        return np.asarray(colour[..., 0] > 0)


@cache
def _offscreen(width: int, height: int) -> Any:
    """Return pyrender's own off-screen renderer, with a context of its own."""
    # It lives as long as the process: deleting it on EGL would end every context on the display.
    from pyrender import OffscreenRenderer

    return OffscreenRenderer(width, height)
