"""A size to a small printed model of a quadrotor: square, a third as high, of one filament."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.scene.drone import Drone, Part, check_size, join, solid
from sim.scene.shapes import hull, pose, prism

FloatArray = NDArray[np.float64]

SIZE_M = 0.03
"""Of the paper's model, 3 x 3 x 1 cm."""

HEIGHT = 1.0 / 3.0
"""Of the size, from the feet to the eye that it hangs from."""

ALBEDO = 0.08  # of dark grey filament

# In units of the size; a disc stands for a rotor, as printed blades would break.
_DISC_RADIUS, _DISC_THICKNESS, _DISC_Z = 0.165, 0.035, 0.08
_CORNER = 0.5 - _DISC_RADIUS
_ARM_WIDTH, _ARM_HEIGHT = 0.07, 0.06
_FOOT_RADIUS, _EYE_RADIUS = 0.03, 0.05


def printed(size_m: float = SIZE_M) -> Drone:
    """Build the model: body, canopy, four arms with discs and feet, and the eye on top.

    Parameters
    ----------
    size_m
        Length and width [m].

    Returns
    -------
    Drone
        One part of outward-facing closed pieces; its origin is the middle of its bounding box.

    Raises
    ------
    SimError
        When the size is not positive.
    """
    check_size(size_m)
    pieces = [_body(), _eye()]
    for x_sign, y_sign in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
        pieces += _arm(np.array([x_sign * _CORNER, y_sign * _CORNER, 0.0]))
    return Drone((join([_painted(piece) for piece in pieces], size_m),), "printed", size_m)


def _painted(piece: trimesh.Trimesh) -> Part:
    return solid(piece, ALBEDO)


def _body() -> trimesh.Trimesh:
    """Return the hull of floor, belt and roof, each a rectangle: longer in front than behind."""
    rectangles = ((-0.16, 0.18, 0.1, -0.08), (-0.2, 0.24, 0.13, 0.0), (-0.12, 0.1, 0.07, 0.11))
    return hull(
        [
            (x, side * half_width, z)
            for back, front, half_width, z in rectangles
            for x in (back, front)
            for side in (-1, 1)
        ]
    )


def _eye() -> trimesh.Trimesh:
    eye = prism(6, _EYE_RADIUS, 0.5 * HEIGHT - 0.09)
    eye.apply_translation((0.0, 0.0, 0.5 * (0.5 * HEIGHT + 0.09)))
    return eye


def _arm(corner: FloatArray) -> list[trimesh.Trimesh]:
    """Return an arm out to a corner, its disc, and the foot below that."""
    length = float(np.linalg.norm(corner))
    arm = trimesh.creation.box((length, _ARM_WIDTH, _ARM_HEIGHT))
    arm.apply_transform(pose(0.5 * corner, yaw_rad=float(np.arctan2(corner[1], corner[0]))))
    disc = prism(12, _DISC_RADIUS, _DISC_THICKNESS)
    disc.apply_translation(corner + np.array([0.0, 0.0, _DISC_Z]))
    foot = prism(4, _FOOT_RADIUS, _DISC_Z + 0.5 * HEIGHT)
    foot.apply_translation(corner + np.array([0.0, 0.0, 0.5 * (_DISC_Z - 0.5 * HEIGHT)]))
    return [arm, disc, foot]
