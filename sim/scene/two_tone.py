"""A size to a quadrotor of two tones, pale in front and dark behind, that stands on skids.

It was the default once. What its parts do to the mean of its events is in docs/simulate.md.
"""

import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.scene.drone import (
    CORNERS,
    DEFAULT_SIZE_M,
    MOTOR_X,
    MOTOR_Y,
    Blades,
    Drone,
    Part,
    solid,
    with_rotors,
)
from sim.scene.shapes import beam, hexagonal_hull, pose, prism

FloatArray = NDArray[np.float64]

ROTOR_Z = 0.075
ALBEDO_SHELL, ALBEDO_NOSE, ALBEDO_TAIL = 0.22, 0.38, 0.12
ALBEDO_ARM, ALBEDO_MOTOR, ALBEDO_LEG = 0.16, 0.10, 0.14
ALBEDO_FRONT_ROTOR, ALBEDO_REAR_ROTOR = 0.42, 0.08


def two_tone(size_m: float = DEFAULT_SIZE_M, rotor_hz: float = 0.0) -> Drone:
    """Build a quadrotor: shell, gimbal, four arms with motors and two-blade rotors, two skids.

    Its front is brighter than its back and its nose and tail differ, so that, as with many a real
    drone, the mean of its events is not the image of any fixed point of it.

    Parameters
    ----------
    size_m, rotor_hz
        As of `sim.scene.drone.quadrotor`.

    Returns
    -------
    Drone
        About 280 faces, in outward-facing closed pieces.

    Raises
    ------
    SimError
        When the size is not positive or the rate is not finite.
    """
    frame = _fuselage()
    rotors: list[Blades] = []
    for x_sign, y_sign in CORNERS:
        hub = np.array([x_sign * MOTOR_X, y_sign * MOTOR_Y, ROTOR_Z])
        frame += _arm(hub)
        albedo = ALBEDO_FRONT_ROTOR if x_sign > 0 else ALBEDO_REAR_ROTOR
        # No two blades stand alike when at rest.
        rotors.append(Blades(hub, 0.5 + 0.9 * len(rotors), albedo))
    return with_rotors("two-tone", size_m, frame, rotors, rotor_hz)


def _fuselage() -> list[Part]:
    """Return shell, nose, tail and the two landing skids."""
    # The shell is the hull of four hexagonal cross sections: x, half width, bottom, top.
    sections = (
        (-0.2, 0.055, -0.02, 0.03),
        (-0.09, 0.1, -0.055, 0.065),
        (0.1, 0.095, -0.055, 0.055),
        (0.21, 0.04, -0.025, 0.015),
    )
    shell = hexagonal_hull(sections)
    gimbal = prism(6, radius=0.04, length=0.07)
    gimbal.apply_transform(pose((0.17, 0.0, -0.075), pitch_rad=np.pi / 2))
    battery = trimesh.creation.box((0.13, 0.11, 0.05))
    battery.apply_translation((-0.14, 0.0, 0.05))
    pieces = [
        solid(shell, ALBEDO_SHELL),
        solid(gimbal, ALBEDO_NOSE),
        solid(battery, ALBEDO_TAIL),
    ]
    for side in (1, -1):
        foot_y, foot_z = side * 0.17, -0.19
        skid = beam((-0.15, foot_y, foot_z), (0.17, foot_y, foot_z), 0.016)
        struts = [beam((x, side * 0.06, -0.04), (x, foot_y, foot_z), 0.018) for x in (-0.08, 0.1)]
        pieces += [solid(leg, ALBEDO_LEG) for leg in (skid, *struts)]
    return pieces


def _arm(hub: FloatArray) -> list[Part]:
    """Return the arm that carries the rotor at `hub`, and its motor."""
    motor = prism(5, radius=0.033, length=0.075)
    motor.apply_translation(hub - (0.0, 0.0, 0.04))
    root = np.array([0.3, 0.2, 0.0]) * hub
    arm = beam(root, hub - (0.0, 0.0, 0.055), 0.036)
    return [solid(arm, ALBEDO_ARM), solid(motor, ALBEDO_MOTOR)]
