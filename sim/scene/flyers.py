"""The drones that are built in code: two quadrotors, a bird and a plane.

The paper's method assumes that the mean of an object's events is the image of one of its points.
This holds for a small or symmetric object, such as the default quadrotor. The others are neither:
their greys differ from part to part; those of the bird and the plane also from left to right, and
the origin of their bodies is not in the middle.
"""

from functools import lru_cache

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix

from sim.arrays import FloatArray
from sim.errors import SimError
from sim.scene.drone import (
    DEFAULT_SIZE_M,
    Drone,
    Joint,
    Part,
    beam,
    check_size,
    hexagonal_hull,
    join,
    moved,
    panel,
    prism,
    solid,
)

# Proportions of quadrotors, in units of their size: 2 (MOTOR_X + ROTOR_RADIUS) = 1. They are longer
# than wide, as real ones are.
MOTOR_X, MOTOR_Y = 0.335, 0.29
ROTOR_RADIUS = 0.165
BLADE_CHORD, BLADE_THICKNESS = 0.034, 0.008
BLADE_LENGTH = ((2.0 * ROTOR_RADIUS) ** 2 - BLADE_CHORD**2) ** 0.5  # corners on the rotor's circle
# In order around the body: consecutive rotors are neighbours and turn in opposite senses.
CORNERS = ((1, 1), (1, -1), (-1, -1), (-1, 1))  # signs of x and y

# Only of the default quadrotor.
ALBEDO_BLACK = 0.10  # of all of it: black plastic
BLADE_YAW_RAD = 0.5  # at rest, of the rotor at the front left; the others are its mirror images
BLADE_Z = 0.033  # on top of the motors
MOTOR_RADIUS, MOTOR_HEIGHT = 0.03, 0.06
ARM_WIDTH, ARM_HEIGHT = 0.034, 0.026
LEG_RADIUS, LEG_REACH = 0.025, 0.07  # stout: a thin leg's end makes few events

Blades = tuple[FloatArray, float, float]
"""The two blades of a rotor: hub (3,) in units of the size, frame B; yaw at rest [rad]; albedo."""


def quadrotor(size_m: float = DEFAULT_SIZE_M, rotor_hz: float = 0.0) -> Drone:
    """Build a quadrotor: shell, four level arms with motors, legs and two-blade rotors.

    It is flat, black all over, and its own mirror image from front to back and from left to right,
    blades at rest included. Its size is its length, from the front rotors' sweep to the rear ones'
    [m]; the width is 9 % less. Rotors that turn are parts on joints, neighbours in opposite senses;
    at 0 Hz the whole drone is one part.
    """
    nose, middle = (0.19, 0.045, -0.018, 0.018), (0.09, 0.095, -0.04, 0.04)
    tail, behind = (-0.19, *nose[1:]), (-0.09, *middle[1:])
    meshes, blades = [hexagonal_hull((tail, behind, middle, nose))], []
    for x_sign, y_sign in CORNERS:
        hub = np.array([x_sign * MOTOR_X, y_sign * MOTOR_Y, BLADE_Z])
        meshes += _level_arm(hub * (1.0, 1.0, 0.0))
        blades.append((hub, x_sign * y_sign * BLADE_YAW_RAD, ALBEDO_BLACK))
    frame = [solid(mesh, ALBEDO_BLACK) for mesh in meshes]
    return _with_rotors(size_m, frame, blades, rotor_hz)


def _with_rotors(size_m: float, frame: list[Part], rotors: list[Blades], rotor_hz: float) -> Drone:
    """Put four rotors, in the order of CORNERS, on a frame in units of the size."""
    if not np.isfinite(rotor_hz):
        raise SimError(f"the rotors' rate must be a finite number [1/s], got {rotor_hz}")
    spinning = []
    for (hub, yaw_rad, albedo), (x_sign, y_sign) in zip(rotors, CORNERS, strict=True):
        box = trimesh.creation.box((BLADE_LENGTH, BLADE_CHORD, BLADE_THICKNESS))
        blades = solid(moved(box, hub, yaw_rad), albedo)
        joint = Joint(np.array([0.0, 0.0, 1.0]), hub * size_m, x_sign * y_sign * rotor_hz)
        spinning.append(join([blades], size_m, joint if rotor_hz else None))
    return _whole(size_m, join(frame, size_m), spinning)


def _whole(size_m: float, body: Part, others: list[Part]) -> Drone:
    """Make a drone of its parts, which are joined into a single one if none of them moves."""
    moves = any(part.joint for part in others)
    return Drone((body, *others) if moves else (join([body, *others]),), size_m)


def _level_arm(hub: FloatArray) -> list[trimesh.Trimesh]:
    """Return the arm that ends at `hub`, the motor about its end, and the leg below it."""
    root = 0.2 * hub  # within the shell
    length = float(np.linalg.norm(hub - root))
    box = trimesh.creation.box((length, ARM_WIDTH, ARM_HEIGHT))
    arm = moved(box, 0.5 * (hub + root), yaw_rad=float(np.arctan2(hub[1], hub[0])))
    inside = 0.5 * MOTOR_HEIGHT - 0.01  # from the arm's middle down to the leg's upper end
    leg = prism(4, LEG_RADIUS, LEG_REACH - inside)
    motor = prism(6, MOTOR_RADIUS, MOTOR_HEIGHT)
    return [arm, moved(motor, hub), moved(leg, hub - (0.0, 0.0, 0.5 * (LEG_REACH + inside)))]


ROTOR_Z = 0.075
ALBEDO_FRONT_ROTOR, ALBEDO_REAR_ROTOR = 0.42, 0.08


def two_tone(size_m: float = DEFAULT_SIZE_M, rotor_hz: float = 0.0) -> Drone:
    """Build a quadrotor: shell, gimbal, four arms with motors and two-blade rotors, two skids.

    Its front is brighter than its back, so that the mean of its events is no fixed point's image.
    """
    gimbal = moved(prism(6, 0.04, 0.07), (0.17, 0.0, -0.075), pitch_rad=np.pi / 2)
    frame = [
        solid(hexagonal_hull(TWO_TONE_SHELL), 0.22),
        solid(gimbal, 0.38),
        solid(moved(trimesh.creation.box((0.13, 0.11, 0.05)), (-0.14, 0.0, 0.05)), 0.12),  # battery
    ]
    for side in (1, -1):
        foot_y, foot_z = side * 0.17, -0.19
        skid = beam((-0.15, foot_y, foot_z), (0.17, foot_y, foot_z), 0.016)
        struts = [beam((x, side * 0.06, -0.04), (x, foot_y, foot_z), 0.018) for x in (-0.08, 0.1)]
        frame += [solid(leg, 0.14) for leg in (skid, *struts)]
    rotors: list[Blades] = []
    for x_sign, y_sign in CORNERS:
        hub = np.array([x_sign * MOTOR_X, y_sign * MOTOR_Y, ROTOR_Z])
        arm = beam(np.array([0.3, 0.2, 0.0]) * hub, hub - (0.0, 0.0, 0.055), 0.036)
        motor = moved(prism(5, radius=0.033, length=0.075), hub - (0.0, 0.0, 0.04))
        frame += [solid(arm, 0.16), solid(motor, 0.10)]
        albedo = ALBEDO_FRONT_ROTOR if x_sign > 0 else ALBEDO_REAR_ROTOR
        # No two rotors have the same yaw at rest.
        rotors.append((hub, 0.5 + 0.9 * len(rotors), albedo))
    return _with_rotors(size_m, frame, rotors, rotor_hz)


# Hexagonal cross sections, from back to front: x, half width, bottom, top.
TWO_TONE_SHELL = (
    (-0.2, 0.055, -0.02, 0.03),
    (-0.09, 0.1, -0.055, 0.065),
    (0.1, 0.095, -0.055, 0.055),
    (0.21, 0.04, -0.025, 0.015),
)
# The bird and the plane are in units of their wing span, which is their size.
BIRD_BODY = (
    (-0.17, 0.018, -0.008, 0.016),
    (-0.06, 0.05, -0.04, 0.038),
    (0.07, 0.055, -0.052, 0.042),
    (0.16, 0.03, -0.012, 0.04),
)
BIRD_HEAD = ((0.13, 0.026, 0.004, 0.05), (0.175, 0.036, 0.0, 0.064), (0.225, 0.018, 0.012, 0.046))
BIRD_BEAK = ((0.21, 0.012, 0.018, 0.038), (0.275, 0.002, 0.012, 0.016))
FUSELAGE = (
    (-0.44, 0.012, -0.01, 0.016),
    (-0.1, 0.042, -0.05, 0.04),
    (0.12, 0.048, -0.055, 0.04),
    (0.27, 0.022, -0.03, 0.015),
)
CANOPY = ((-0.04, 0.02, 0.02, 0.05), (0.05, 0.032, 0.0, 0.078), (0.15, 0.018, 0.0, 0.042))

# Corners of panels: x, y, z, thickness.
BIRD_TAIL = (
    (-0.14, 0.016, 0.002, 0.01),
    (-0.14, -0.016, 0.002, 0.01),
    (-0.31, -0.085, -0.004, 0.004),
    (-0.335, 0.0, -0.005, 0.004),
    (-0.31, 0.085, -0.004, 0.004),
)
TAILPLANE = (
    (-0.36, 0.16, 0.006, 0.008),
    (-0.34, -0.16, 0.006, 0.008),
    (-0.43, -0.16, 0.006, 0.008),
    (-0.44, 0.16, 0.006, 0.008),
)
FIN = (
    (-0.31, 0.0, 0.0, 0.01),
    (-0.44, 0.0, 0.0, 0.01),
    (-0.45, 0.16, 0.0, 0.006),
    (-0.4, 0.16, 0.0, 0.006),
)  # before the turn about x that takes y to z

SHOULDER = np.array([0.03, 0.035, 0.025])  # about which the left wing flaps
FLAP_RAD = 0.6  # to either side of level
FLAP_HZ = 4.0  # of a gull or a crow
ALBEDO_WINGS = ((0.3, 0.12), (0.16, 0.05))  # left, right: inner half, outer half


def bird(size_m: float = DEFAULT_SIZE_M, flap_hz: float = FLAP_HZ) -> Drone:
    """Build a bird: body, head, beak, fanned tail, and two wings that flap from the shoulder.

    Its size is the wing span with the wings level [m]. They beat to 34 deg above and below level;
    at 0 Hz it glides, as one part.
    """
    if not np.isfinite(flap_hz):
        raise SimError(f"the wings' rate must be a finite number [1/s], got {flap_hz}")
    hulls = ((BIRD_BODY, 0.2), (BIRD_HEAD, 0.07), (BIRD_BEAK, 0.5))
    body = [solid(hexagonal_hull(sections), albedo) for sections, albedo in hulls]
    body.append(solid(panel(BIRD_TAIL), 0.11))
    wings = []
    for side, albedos in zip((1, -1), ALBEDO_WINGS, strict=True):
        # About +x the left wing rises with the angle, about -x the right one.
        axis, shoulder = np.array([float(side), 0.0, 0.0]), np.array([1.0, side, 1.0]) * SHOULDER
        joint = Joint(axis, shoulder * size_m, flap_hz, FLAP_RAD)
        wings.append(join(_wing(side, albedos), size_m, joint if flap_hz else None))
    return _whole(size_m, join(body, size_m), wings)


def _wing(side: int, albedos: tuple[float, float]) -> list[Part]:
    """Return the inner and the outer half of a bird's wing; side is 1 for the left one."""
    z = SHOULDER[2]
    root = [(0.1, side * 0.02, z, 0.016), (-0.08, side * 0.02, z, 0.016)]
    elbow = [(-0.07, side * 0.26, z, 0.009), (0.13, side * 0.26, z, 0.009)]
    tip = [(-0.075, side * 0.5, z, 0.003), (-0.04, side * 0.5, z, 0.003)]
    halves = ([*root, *elbow], [*elbow[::-1], *tip])
    return [solid(panel(half), albedo) for half, albedo in zip(halves, albedos, strict=True)]


def plane(size_m: float = DEFAULT_SIZE_M) -> Drone:
    """Build a small plane with a fixed wing, its origin within the wing, ahead of the middle.

    It carries a pod under the left wing only. Its size is the wing span [m], 1.36 times its length.
    """
    propeller = trimesh.creation.box((0.012, 0.2, 0.022))
    propeller.apply_transform(rotation_matrix(0.6, (1, 0, 0)))  # type: ignore[no-untyped-call]
    wheel = moved(prism(6, 0.03, 0.018), (0.17, 0.0, -0.125), np.pi / 2, pitch_rad=np.pi / 2)
    wings = []
    for side in (1, -1):
        root = [(0.1, side * 0.02, 0.015, 0.024), (-0.07, side * 0.02, 0.015, 0.024)]
        tip = [(-0.045, side * 0.5, 0.05, 0.008), (0.035, side * 0.5, 0.05, 0.008)]
        wings.append(panel([*root, *tip]))
    fin = panel(FIN)
    fin.apply_transform(rotation_matrix(np.pi / 2, (1, 0, 0)))  # type: ignore[no-untyped-call]
    pieces = (
        (hexagonal_hull(FUSELAGE), 0.24),
        (hexagonal_hull(CANOPY), 0.06),
        (moved(propeller, (0.28, 0.0, -0.006)), 0.42),
        (beam((0.16, 0.0, -0.03), (0.17, 0.0, -0.12), 0.016), 0.05),  # leg of the nose wheel
        (wheel, 0.05),
        (wings[0], 0.3),
        (wings[1], 0.14),
        (beam((-0.07, 0.24, -0.015), (0.11, 0.24, -0.015), 0.05), 0.08),  # pod
        (panel(TAILPLANE), 0.12),
        (fin, 0.45),
    )
    return Drone((join([solid(*piece) for piece in pieces], size_m),), size_m)


QUADROTORS = {"quadrotor": quadrotor, "two-tone": two_tone}
DRONES = (*QUADROTORS, "bird", "plane")


@lru_cache(maxsize=8)
def built_in_drone(
    name: str, size_m: float | None = None, rotor_hz: float = 0.0, flap_hz: float = FLAP_HZ
) -> Drone:
    """Build one of `DRONES`, by default of 0.65 m; SimError for an invalid size or rate."""
    size_m = DEFAULT_SIZE_M if size_m is None else size_m
    check_size(size_m)
    if name in QUADROTORS:
        return QUADROTORS[name](size_m, rotor_hz)
    if rotor_hz:
        raise SimError(
            f"rotors spin on the built-in quadrotors only ({', '.join(QUADROTORS)}), not on a "
            f"{name}: leave out rotor_hz"
        )
    return bird(size_m, flap_hz) if name == "bird" else plane(size_m)
