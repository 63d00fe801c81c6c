"""A drone, drawn by the renderer that a test asks for, and by OpenGL a whole frame at a time."""

from dataclasses import replace
from typing import Any

import numpy as np

from sim.render.config import RenderConfig
from sim.render.footprint import footprint, plan_views
from sim.render.gl_atlas import GLPainter
from sim.render.renderer import Renderer
from sim.scene.flyers import quadrotor
from tests.sim.scenes import Image, box_drone, whole_images

HALF_VGA = (173, 130)  # a quarter of the default number of pixels, for speed
BRIGHT = RenderConfig(ambient=1.0)
# A hull seen from outside hides nothing of itself, whatever the depth buffer's rounding.
BOX = box_drone((0.7, 0.5, 0.3))
# Its parts cut into each other: which one a sample sees there depends on the rounding of depths.
QUADROTOR = quadrotor(rotor_hz=7.0)

DRAWN_BY = {"renderer": "pyrender"}  # of `rendered`


def drawn_by(config: RenderConfig) -> RenderConfig:
    return replace(config, renderer=DRAWN_BY["renderer"], check=False)


def drawn(*scene: Any) -> Image:
    """Draw whole images of a drone, a camera, times, poses and a background, by a config."""
    drone, camera, times_s, T_W_B, background, config = scene
    with Renderer(drone, config) as renderer:
        crops = renderer.crops(camera, times_s, T_W_B, background)
        return whole_images(crops, times_s, background)


def rendered(*scene: Any) -> Image:
    """Draw the same by the renderer that is asked for, unchecked."""
    return drawn(*scene[:-1], drawn_by(scene[-1]))


def full_frames(*scene: Any) -> Image:
    """Draw the same by OpenGL, a whole frame at a time."""
    drone, camera, times_s, T_W_B, background, config = scene
    painter, every = GLPainter(drone, config), np.arange(len(times_s))
    seen = footprint(drone, camera, times_s, T_W_B)
    whole = plan_views(drone, camera, seen, every, times_s, T_W_B)._replace(
        boxes=np.tile([0, 0, camera.width, camera.height], (len(every), 1))
    )
    each = (whole.chosen(slice(k, k + 1)) for k in every)
    zero = np.zeros((1, 2), np.int64)
    return np.concatenate([painter.paint(camera, view, zero, background) for view in each])
