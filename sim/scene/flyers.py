"""A name and a size to a drone that is built in code: two quadrotors, a bird or a plane.

What the paper's method takes for granted, that the mean of an object's events is the image of one
of its points, holds for a small or symmetric object. The bird and the plane are neither: their
greys differ from part to part and from left to right, and the body's origin is not in the middle.
"""

from functools import lru_cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.errors import SimError
from sim.scene.drone import DEFAULT_SIZE_M, Drone, Joint, Part, check_size, join, quadrotor, solid
from sim.scene.shapes import beam, hexagonal_hull, panel, pose, prism
from sim.scene.two_tone import two_tone

QUADROTORS = {"quadrotor": quadrotor, "two-tone": two_tone}
DRONES = (*QUADROTORS, "bird", "plane")

# Lengths below are in units of the wing span, which is the size.
SHOULDER = np.array([0.03, 0.035, 0.025])  # about which the left wing flaps
FLAP_RAD = 0.6  # to either side of level
FLAP_HZ = 4.0  # of a gull or a crow

ALBEDO_BODY, ALBEDO_HEAD, ALBEDO_BEAK, ALBEDO_TAIL = 0.2, 0.07, 0.5, 0.11
ALBEDO_WINGS = ((0.3, 0.12), (0.16, 0.05))  # left, right: inner half, outer half

ALBEDO_FUSELAGE, ALBEDO_CANOPY, ALBEDO_PROPELLER = 0.24, 0.06, 0.42
ALBEDO_LEFT_WING, ALBEDO_RIGHT_WING = 0.3, 0.14
ALBEDO_TAILPLANE, ALBEDO_FIN, ALBEDO_POD, ALBEDO_WHEEL = 0.12, 0.45, 0.08, 0.05


@lru_cache(maxsize=8)
def built_in_drone(
    name: str, size_m: float | None = None, rotor_hz: float = 0.0, flap_hz: float = FLAP_HZ
) -> Drone:
    """Build one of `DRONES`.

    Parameters
    ----------
    name
    size_m
        Largest horizontal extent [m]; by default 0.65.
    rotor_hz
        Turns per second of a quadrotor's rotors.
    flap_hz
        Wing beats per second of the bird.

    Raises
    ------
    SimError
        For an unknown name, a size or rate that makes no sense, or rotors on what has none.
    """
    check_drone_name(name)
    if rotor_hz and name not in QUADROTORS:
        raise SimError(
            f"rotors spin on the built-in quadrotors only ({', '.join(QUADROTORS)}), not on a "
            f"{name}: leave out rotor_hz"
        )
    size_m = DEFAULT_SIZE_M if size_m is None else size_m
    if name in QUADROTORS:
        return QUADROTORS[name](size_m, rotor_hz)
    return bird(size_m, flap_hz) if name == "bird" else plane(size_m)


def check_drone_name(name: str) -> None:
    """Raise SimError when no drone is built in under this name."""
    if name not in DRONES:
        raise SimError(f"drone: expected one of {', '.join(DRONES)}, got {name!r}")


def bird(size_m: float = DEFAULT_SIZE_M, flap_hz: float = FLAP_HZ) -> Drone:
    """Build a bird: body, head, beak, fanned tail, and two wings that flap from the shoulder.

    Parameters
    ----------
    size_m
        Wing span with the wings level [m].
    flap_hz
        Wing beats per second, to 34 deg above and below level. 0: it glides, as one part.

    Returns
    -------
    Drone
        140 faces, in outward-facing closed pieces.

    Raises
    ------
    SimError
        When the size is not positive or the rate is not finite.
    """
    check_size(size_m)
    if not np.isfinite(flap_hz):
        raise SimError(f"the wings' rate must be a finite number [1/s], got {flap_hz}")
    wings = []
    for side, albedos in zip((1, -1), ALBEDO_WINGS, strict=True):
        mirror = np.array([1.0, side, 1.0])
        # About +x the left wing rises with the angle, about -x the right one.
        joint = Joint(
            np.array([float(side), 0.0, 0.0]), mirror * SHOULDER * size_m, flap_hz, FLAP_RAD
        )
        wings.append(join(_wing(side, albedos), size_m, joint if flap_hz else None))
    body = join(_bird_body(), size_m)
    parts = (body, *wings) if flap_hz else (join([body, *wings]),)
    return Drone(parts, "bird", size_m)


def plane(size_m: float = DEFAULT_SIZE_M) -> Drone:
    """Build a small plane with a fixed wing, its origin within the wing, ahead of the middle.

    It carries a pod under the left wing only.

    Parameters
    ----------
    size_m
        Wing span [m]; the length is 26 % less.

    Returns
    -------
    Drone
        One part of 160 faces, in outward-facing closed pieces.

    Raises
    ------
    SimError
        When the size is not positive.
    """
    check_size(size_m)
    return Drone(
        (join([*_plane_body(), *_plane_wings(), *_plane_tail()], size_m),), "plane", size_m
    )


def _bird_body() -> list[Part]:
    body = hexagonal_hull(
        (
            (-0.17, 0.018, -0.008, 0.016),
            (-0.06, 0.05, -0.04, 0.038),
            (0.07, 0.055, -0.052, 0.042),
            (0.16, 0.03, -0.012, 0.04),
        )
    )
    head = hexagonal_hull(
        ((0.13, 0.026, 0.004, 0.05), (0.175, 0.036, 0.0, 0.064), (0.225, 0.018, 0.012, 0.046))
    )
    beak = hexagonal_hull(((0.21, 0.012, 0.018, 0.038), (0.275, 0.002, 0.012, 0.016)))
    tail = panel(
        (
            (-0.14, 0.016, 0.002, 0.01),
            (-0.14, -0.016, 0.002, 0.01),
            (-0.31, -0.085, -0.004, 0.004),
            (-0.335, 0.0, -0.005, 0.004),
            (-0.31, 0.085, -0.004, 0.004),
        )
    )
    return [
        solid(body, ALBEDO_BODY),
        solid(head, ALBEDO_HEAD),
        solid(beak, ALBEDO_BEAK),
        solid(tail, ALBEDO_TAIL),
    ]


def _wing(side: int, albedos: tuple[float, float]) -> list[Part]:
    """Return the inner and the outer half of a bird's wing; side is 1 for the left one."""
    z = SHOULDER[2]
    inner = (
        (0.1, side * 0.02, z, 0.016),
        (-0.08, side * 0.02, z, 0.016),
        (-0.07, side * 0.26, z, 0.009),
        (0.13, side * 0.26, z, 0.009),
    )
    outer = (
        (0.13, side * 0.26, z, 0.009),
        (-0.07, side * 0.26, z, 0.009),
        (-0.075, side * 0.5, z, 0.003),
        (-0.04, side * 0.5, z, 0.003),
    )
    halves = zip((inner, outer), albedos, strict=True)
    return [solid(panel(outline), albedo) for outline, albedo in halves]


def _plane_body() -> list[Part]:
    """Return fuselage, canopy, propeller (which stands still) and nose wheel."""
    fuselage = hexagonal_hull(
        (
            (-0.44, 0.012, -0.01, 0.016),
            (-0.1, 0.042, -0.05, 0.04),
            (0.12, 0.048, -0.055, 0.04),
            (0.27, 0.022, -0.03, 0.015),
        )
    )
    canopy = hexagonal_hull(
        ((-0.04, 0.02, 0.02, 0.05), (0.05, 0.032, 0.0, 0.078), (0.15, 0.018, 0.0, 0.042))
    )
    propeller = trimesh.creation.box((0.012, 0.2, 0.022))
    propeller.apply_transform(_rolled(0.6))
    propeller.apply_translation((0.28, 0.0, -0.006))
    wheel = prism(6, radius=0.03, length=0.018)
    wheel.apply_transform(pose((0.17, 0.0, -0.125), yaw_rad=np.pi / 2, pitch_rad=np.pi / 2))
    return [
        solid(fuselage, ALBEDO_FUSELAGE),
        solid(canopy, ALBEDO_CANOPY),
        solid(propeller, ALBEDO_PROPELLER),
        solid(beam((0.16, 0.0, -0.03), (0.17, 0.0, -0.12), 0.016), ALBEDO_WHEEL),
        solid(wheel, ALBEDO_WHEEL),
    ]


def _plane_wings() -> list[Part]:
    """Return both wings and the pod under the left one."""
    wings = []
    for side, albedo in ((1, ALBEDO_LEFT_WING), (-1, ALBEDO_RIGHT_WING)):
        outline = (
            (0.1, side * 0.02, 0.015, 0.024),
            (-0.07, side * 0.02, 0.015, 0.024),
            (-0.045, side * 0.5, 0.05, 0.008),
            (0.035, side * 0.5, 0.05, 0.008),
        )
        wings.append(solid(panel(outline), albedo))
    pod = beam((-0.07, 0.24, -0.015), (0.11, 0.24, -0.015), 0.05)
    return [*wings, solid(pod, ALBEDO_POD)]


def _plane_tail() -> list[Part]:
    tailplane = panel(
        (
            (-0.36, 0.16, 0.006, 0.008),
            (-0.34, -0.16, 0.006, 0.008),
            (-0.43, -0.16, 0.006, 0.008),
            (-0.44, 0.16, 0.006, 0.008),
        )
    )
    fin = panel(
        (
            (-0.31, 0.0, 0.0, 0.01),
            (-0.44, 0.0, 0.0, 0.01),
            (-0.45, 0.16, 0.0, 0.006),
            (-0.4, 0.16, 0.0, 0.006),
        )
    )
    fin.apply_transform(_rolled(np.pi / 2))  # y becomes z
    return [solid(tailplane, ALBEDO_TAILPLANE), solid(fin, ALBEDO_FIN)]


def _rolled(angle_rad: float) -> NDArray[np.float64]:
    """Return the (4, 4) transform that turns about x."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    T = np.eye(4)
    T[1:3, 1:3] = [[cos, -sin], [sin, cos]]
    return T
