"""A size, or a mesh file, to a drone: closed triangle meshes with albedo, some of them on joints.

Body frame B: x forward, y left, z up, metres; origin within the drone.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sim.errors import SimError
from sim.scene.shapes import hexagonal_hull, pose, prism
from sim.scene.srgb import linear_from_srgb

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

DEFAULT_SIZE_M = 0.65
DEFAULT_ALBEDO = 0.25  # of a mesh file without colours: dark grey
MIN_ALBEDO = 0.01  # a black face still reflects a little
LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # of linear R, G, B (Rec. 709)


@dataclass(frozen=True)
class Joint:
    """An axis fixed in the body, about which a part spins or flaps."""

    axis_B: FloatArray  # (3,), any length but 0
    origin_B_m: FloatArray  # (3,) [m], a point on the axis
    rate_hz: float  # turns, or flaps, per second; the sign is the sense of turning
    amplitude_rad: float | None = None  # of a flap; None: the part spins
    phase_rad: float = 0.0

    def transforms(self, times_s: FloatArray) -> FloatArray:
        """Return T_B_P (n, 4, 4): the part's vertices at rest [m] to the body frame, at each time.

        The angle is `2 pi rate t + phase` when the part spins, and `amplitude sin(2 pi rate t +
        phase)` when it flaps.
        """
        cycle_rad = 2.0 * np.pi * self.rate_hz * np.asarray(times_s) + self.phase_rad
        if self.amplitude_rad is None:
            angle_rad = cycle_rad
        else:
            angle_rad = self.amplitude_rad * np.sin(cycle_rad)
        axis = self.axis_B / np.linalg.norm(self.axis_B)
        R = Rotation.from_rotvec(angle_rad[:, None] * axis).as_matrix()
        T_B_P = np.zeros((len(R), 4, 4))
        T_B_P[:, :3, :3] = R
        T_B_P[:, :3, 3] = self.origin_B_m - R @ self.origin_B_m
        T_B_P[:, 3, 3] = 1.0
        return T_B_P


@dataclass(frozen=True)
class Part:
    """A rigid piece of the drone: closed, with faces counter-clockwise seen from outside."""

    vertices_B_m: FloatArray  # (V, 3) [m], frame B, at rest
    faces: IntArray  # (F, 3), indices of vertices
    albedo: FloatArray  # (F,), in (0, 1], linear luminance (no gamma)
    joint: Joint | None = None  # None: fixed to the body


@dataclass(frozen=True)
class Drone:
    """What the cameras watch."""

    parts: tuple[Part, ...]
    name: str
    size_m: float  # largest horizontal extent, with what the joints sweep


def solid(mesh: trimesh.Trimesh, albedo: float) -> Part:
    """Return a mesh of one colour as a part."""
    return Part(np.array(mesh.vertices), np.array(mesh.faces), np.full(len(mesh.faces), albedo))


def join(parts: list[Part], scale: float = 1.0, joint: Joint | None = None) -> Part:
    """Join parts into one, scaled, on the given joint."""
    first = np.cumsum([0] + [len(part.vertices_B_m) for part in parts])
    return Part(
        vertices_B_m=np.concatenate([part.vertices_B_m for part in parts]) * scale,
        faces=np.concatenate([part.faces + n for part, n in zip(parts, first, strict=False)]),
        albedo=np.concatenate([part.albedo for part in parts]),
        joint=joint,
    )


def check_size(size_m: float) -> None:
    """Raise SimError when it is no size of a drone."""
    if not (np.isfinite(size_m) and size_m > 0):
        raise SimError(f"the drone's size must be a positive number of metres, got {size_m}")


# Proportions of quadrotors, in units of their size: 2 (MOTOR_X + ROTOR_RADIUS) = 1. They are longer
# than wide, as real ones are.
MOTOR_X, MOTOR_Y = 0.335, 0.29
ROTOR_RADIUS = 0.165
BLADE_CHORD, BLADE_THICKNESS = 0.034, 0.008
BLADE_LENGTH = ((2.0 * ROTOR_RADIUS) ** 2 - BLADE_CHORD**2) ** 0.5  # its corners on the circle
# In this order neighbours are neighbours, and turn in opposite senses.
CORNERS = ((1, 1), (1, -1), (-1, -1), (-1, 1))  # signs of x and y

# The default quadrotor's own.
ALBEDO_BLACK = 0.10  # of all of it: black plastic
BLADE_YAW_RAD = 0.5  # at rest, of the rotor at the front left; the others are its mirror images
BLADE_Z = 0.033  # on top of the motors
MOTOR_RADIUS, MOTOR_HEIGHT = 0.03, 0.06
ARM_WIDTH, ARM_HEIGHT = 0.034, 0.026
LEG_RADIUS, LEG_REACH = 0.025, 0.07  # stout: a thin leg's end makes few events


def quadrotor(size_m: float = DEFAULT_SIZE_M, rotor_hz: float = 0.0) -> Drone:
    """Build a quadrotor: shell, four level arms with motors, legs and two-blade rotors.

    It is flat, black all over, and its own mirror image from front to back and from left to right,
    blades at rest included: the mean of its events is then near the image of one point of it,
    from wherever it is seen. `sim.scene.two_tone` has one that is neither.

    Parameters
    ----------
    size_m
        Length, from the front rotors' sweep to the rear ones' [m]; the width is 9 % less.
    rotor_hz
        Turns per second of the rotors, neighbours in opposite senses. 0: they stand still, and the
        whole drone is one part; otherwise each rotor is a part on its joint.

    Returns
    -------
    Drone
        About 270 faces, in outward-facing closed pieces.

    Raises
    ------
    SimError
        When the size is not positive or the rate is not finite.
    """
    shell = hexagonal_hull(
        (
            (-0.19, 0.045, -0.018, 0.018),
            (-0.09, 0.095, -0.04, 0.04),
            (0.09, 0.095, -0.04, 0.04),
            (0.19, 0.045, -0.018, 0.018),
        )
    )
    frame, blades = [solid(shell, ALBEDO_BLACK)], []
    for x_sign, y_sign in CORNERS:
        hub = np.array([x_sign * MOTOR_X, y_sign * MOTOR_Y, BLADE_Z])
        frame += [solid(mesh, ALBEDO_BLACK) for mesh in _level_arm(hub * (1.0, 1.0, 0.0))]
        blades.append(Blades(hub, x_sign * y_sign * BLADE_YAW_RAD, ALBEDO_BLACK))
    return with_rotors("quadrotor", size_m, frame, blades, rotor_hz)


@dataclass(frozen=True)
class Blades:
    """The two blades of a rotor, in units of the drone's size."""

    hub_B: FloatArray  # (3,), frame B
    yaw_rad: float  # at rest
    albedo: float


def with_rotors(
    name: str, size_m: float, frame: list[Part], rotors: list[Blades], rotor_hz: float
) -> Drone:
    """Put four rotors on a frame.

    Parameters
    ----------
    name, size_m
        Of the drone.
    frame
        All else, in units of the size.
    rotors
        In the order of CORNERS.
    rotor_hz
        As of `quadrotor`.

    Raises
    ------
    SimError
        When the size is not positive or the rate is not finite.
    """
    check_size(size_m)
    if not np.isfinite(rotor_hz):
        raise SimError(f"the rotors' rate must be a finite number [1/s], got {rotor_hz}")
    parts = []
    for rotor, (x_sign, y_sign) in zip(rotors, CORNERS, strict=True):
        blades = trimesh.creation.box((BLADE_LENGTH, BLADE_CHORD, BLADE_THICKNESS))
        blades.apply_transform(pose(rotor.hub_B, rotor.yaw_rad))
        joint = Joint(np.array([0.0, 0.0, 1.0]), rotor.hub_B * size_m, x_sign * y_sign * rotor_hz)
        parts.append(join([solid(blades, rotor.albedo)], size_m, joint if rotor_hz else None))
    body = join(frame, size_m)
    whole = (body, *parts) if rotor_hz else (join([body, *parts]),)
    return Drone(whole, name, size_m)


def drone_from_file(path: Path, size_m: float | None = None) -> Drone:
    """Read a user's own mesh.

    Parameters
    ----------
    path
        Any format that trimesh reads; a scene's meshes are joined. x forward, y left, z up.
    size_m
        Scale the mesh so that its larger horizontal extent is this [m]; by default the file's
        units are metres.

    Returns
    -------
    Drone
        One part, with the middle of its bounding box at the origin. Albedo is the luminance of the
        file's colours (sRGB, alpha ignored), or a dark grey. The faces of a mesh that is not closed
        are doubled, one for each side, since the renderer culls back faces.

    Raises
    ------
    SimError
        When the file is missing or unreadable, has no faces, or has vertices that are missing or
        not finite, or when the size is not positive or the mesh has no horizontal extent to scale.
    """
    path = Path(path)
    if size_m is not None:
        check_size(size_m)
    mesh = join([_closed(mesh) for mesh in _load_meshes(path)])
    low, high = mesh.vertices_B_m.min(axis=0), mesh.vertices_B_m.max(axis=0)
    extent_m = float((high - low)[:2].max())
    if extent_m <= 0.0:
        raise SimError(f"{path}: the drone's mesh has no extent along x or y")
    scale = 1.0 if size_m is None else size_m / extent_m
    centred = replace(mesh, vertices_B_m=(mesh.vertices_B_m - 0.5 * (low + high)) * scale)
    return Drone((centred,), path.stem, extent_m * scale)


def _level_arm(hub: FloatArray) -> list[trimesh.Trimesh]:
    """Return the arm that ends at `hub`, the motor about its end, and the leg below it."""
    motor = prism(6, MOTOR_RADIUS, MOTOR_HEIGHT)
    motor.apply_translation(hub)
    root = 0.2 * hub  # within the shell
    length = float(np.linalg.norm(hub - root))
    arm = trimesh.creation.box((length, ARM_WIDTH, ARM_HEIGHT))
    arm.apply_transform(pose(0.5 * (hub + root), yaw_rad=float(np.arctan2(hub[1], hub[0]))))
    inside = 0.5 * MOTOR_HEIGHT - 0.01  # from the arm's middle down to the leg's upper end
    leg = prism(4, LEG_RADIUS, LEG_REACH - inside)
    leg.apply_translation(hub - (0.0, 0.0, 0.5 * (LEG_REACH + inside)))
    return [arm, motor, leg]


def _load_meshes(path: Path) -> list[trimesh.Trimesh]:
    """Read the meshes of a file, with every reason for which it cannot be used as a SimError."""
    if not path.is_file():
        raise SimError(f"the drone's mesh {path} does not exist")
    try:
        geometries = trimesh.load_scene(path, process=False).dump()
    except Exception as error:  # a reader raises whatever its format's parser does
        raise SimError(f"cannot read the drone's mesh {path}: {error}") from error
    meshes = [mesh for mesh in geometries if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not meshes:
        raise SimError(f"{path}: the drone's mesh has no faces")
    if any(mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices) for mesh in meshes):
        raise SimError(f"{path}: the drone's mesh has faces whose vertices are missing")
    if not all(np.isfinite(mesh.vertices).all() for mesh in meshes):
        raise SimError(f"{path}: the drone's mesh has vertices that are not finite")
    return meshes


def _closed(mesh: trimesh.Trimesh) -> Part:
    """Return a mesh with outward faces; one that is not closed with every face on both sides."""
    albedo = _albedo(mesh)
    mesh = mesh.copy()
    mesh.merge_vertices(merge_tex=True, merge_norm=True)  # files repeat them along every seam
    if not mesh.is_volume:
        trimesh.repair.fix_normals(mesh, multibody=True)  # type: ignore[no-untyped-call]
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    if not mesh.is_volume:
        faces = np.concatenate([faces, faces[:, ::-1]])
        albedo = np.concatenate([albedo, albedo])
    return Part(vertices, faces, albedo)


def _albedo(mesh: trimesh.Trimesh) -> FloatArray:
    """Return the linear luminance (F,) of a mesh's face colours."""
    visual = mesh.visual
    if isinstance(visual, trimesh.visual.TextureVisuals):
        # One colour per vertex, or a single one when the texture is a plain colour.
        corners = np.atleast_2d(visual.to_color().vertex_colors)  # type: ignore[no-untyped-call]
        colors = np.broadcast_to(corners, (len(mesh.vertices), 4))[mesh.faces].mean(axis=1)
    elif visual is None or visual.kind is None:
        return np.full(len(mesh.faces), DEFAULT_ALBEDO)
    else:
        colors = np.asarray(visual.face_colors)
    linear = linear_from_srgb(colors[:, :3] / 255.0)
    luminance: FloatArray = np.clip(linear @ LUMINANCE_WEIGHTS, MIN_ALBEDO, 1.0)
    return luminance
