"""How the drone is drawn, and how often."""

from dataclasses import dataclass, field

import numpy as np

from sim.arrays import FloatArray
from sim.errors import SimError, check_numbers
from sim.render.gl_context import check_backend
from sim.render.lattice import Lattice
from sim.scene.rig import Camera

RENDERERS = ("native", "pyrender")
DISTORTION_MODELS = {"none": 0, "radtan": 1, "equidistant": 2}
"""The number of each model in shaders and kernels."""


@dataclass(frozen=True)
class RenderConfig:
    """How the drone is drawn, and by what."""

    lattice: Lattice = field(default_factory=lambda: Lattice(16, 1))
    light_W: tuple[float, float, float] = (0.35, -0.4, 0.85)  # towards the light, any length
    ambient: float = 0.35  # share of the light that comes from everywhere
    renderer: str = "native"  # "native": compiled Python; "pyrender": OpenGL, the reference
    check: bool = True  # compare "native" with "pyrender" at some instants
    backend: str = "auto"  # of OpenGL: "auto", "osmesa" or "egl"

    def __post_init__(self) -> None:
        if self.renderer not in RENDERERS:
            raise SimError(f"unknown renderer {self.renderer!r}: use one of {', '.join(RENDERERS)}")
        check_backend(self.backend)
        if not 0.0 <= self.ambient <= 1.0:
            raise SimError(f"ambient light: expected 0 to 1, got {self.ambient}")
        if not (np.isfinite(self.light_W).all() and np.any(self.light_W)):
            raise SimError(f"light_W: expected a finite direction, got {self.light_W}")

    def light_in(self, camera: Camera) -> FloatArray:
        """Return the unit vector (3,) towards the light, in the camera's frame."""
        light_W = np.asarray(self.light_W)
        light_C: FloatArray = camera.T_C_W[:3, :3] @ (light_W / np.linalg.norm(light_W))
        return light_C


@dataclass(frozen=True)
class SamplingConfig:
    """Adaptive sampling after ESIM (Rebecq et al., CoRL 2018, section 3.1), in pixels moved."""

    max_step_px: float = 0.25  # largest image displacement between two instants
    min_rate_hz: float = 100.0  # also when nothing moves or the drone is out of view

    def __post_init__(self) -> None:
        check_numbers(self, "sampling: ", ("max_step_px", "min_rate_hz"))
