"""Small drones, cameras, poses, pictures and videos that several tests share."""

from dataclasses import replace

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from sim.recording import SimConfig
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.lattice import Lattice
from sim.scene.drone import Drone, Part
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import SplineConfig
from sim.sensor.frames import FrameConfig

LENSES = {
    "none": (),
    "radtan": (-0.25, 0.06, 0.002, -0.001),
    "equidistant": (0.05, -0.02, 0.003, 0.001),
}


# A coarse recording of one second, which takes 60 ms to simulate.
QUICK = SimConfig(
    spline=SplineConfig(duration_s=1.0),
    sampling=SamplingConfig(max_step_px=1.0),
    render=RenderConfig(Lattice(3, 1)),
    background_luminance=0.5,
)

# For flights of several seconds, without frames.
COARSE = SimConfig(
    sampling=SamplingConfig(max_step_px=1.0),
    render=RenderConfig(Lattice(4, 1), check=False),
    frames=FrameConfig(rate_hz=0.0),
)


def rng(seed=0):
    return np.random.default_rng(seed)


def lens(model, *coeffs):
    return {"distortion_model": model, "distortion_coeffs": coeffs or LENSES[model]}


def make_camera(model="none", resolution=(346, 260), number=0):
    """Camera 1 at (0, -5, 0), looking along +y, or another one of the rig."""
    width, height = resolution
    scaled = {"focal_px": 200.0 * width / 346, "principal_point": (width / 2, height / 2)}
    rig = two_view_rig(90.0, resolution=resolution, **scaled, **lens(model))
    return rig.cameras[number]


def box_drone(size_m, albedo=0.2):
    box = trimesh.creation.box(size_m)
    faces = np.array(box.faces)
    part = Part(np.array(box.vertices), faces, np.full(len(faces), albedo))
    return Drone((part,), max(size_m[:2]))


def painted(drone, albedo):
    """The drone in one colour, so that it does not matter which of two intersecting parts shows."""
    parts = (replace(part, albedo=np.full(len(part.faces), albedo)) for part in drone.parts)
    return replace(drone, parts=tuple(parts))


def poses(positions_m, seed=None):
    """T_W_B (n, 4, 4) at these positions (n, 3), level or with random attitudes."""
    T_W_B = np.tile(np.eye(4), (len(positions_m), 1, 1))
    if seed is not None:
        T_W_B[:, :3, :3] = Rotation.random(len(positions_m), random_state=seed).as_matrix()
    T_W_B[:, :3, 3] = positions_m
    return T_W_B


def tumbling(n, seed, centre_m, spread_m):
    """Random poses, uniform in a box."""
    return poses(centre_m + rng(seed).uniform(-1.0, 1.0, (n, 3)) * spread_m, seed)


def straight(times_s, start_m, velocity_m_s):
    return poses(np.asarray(start_m) + np.outer(times_s, velocity_m_s))


def grey(camera, luminance=0.6):
    return np.full((camera.height, camera.width), luminance, np.float32)


def noise_image(camera):
    return rng().random((camera.height, camera.width)).astype(np.float32)


def whole_images(crops, times_s, background):
    """Images (n, height, width) at all instants: the crops pasted over the background."""
    images = np.repeat(background[None], len(times_s), axis=0)
    for crop in crops:
        height, width = crop.luminance.shape[1:]
        for k, i in enumerate(np.searchsorted(times_s, crop.times_s)):
            x0, y0 = crop.x0_px[k], crop.y0_px[k]
            images[i, y0 : y0 + height, x0 : x0 + width] = crop.luminance[k]
    return images


def smooth_video(n, height, width):
    """Blobs that drift over each other: every pixel brightens and darkens by many thresholds."""
    y, x = np.mgrid[:height, :width]
    t = np.arange(n)[:, None, None] / n
    phase = rng().uniform(0, 2 * np.pi, 3)
    waves = np.sin(0.31 * x + 9 * t + phase[0]) + np.sin(0.23 * y - 7 * t + phase[1])
    waves += np.sin(0.11 * (x + y) + 13 * t + phase[2])
    return (0.5 + 0.1666 * waves).astype(np.float32)


def reference_levels(events, thresholds_on, thresholds_off, shape):
    """Return the change of log intensity to which the events of each pixel add up."""
    change = np.zeros(shape)
    x, y = events["x"], events["y"]
    on, off = (np.broadcast_to(each, shape)[y, x] for each in (thresholds_on, thresholds_off))
    np.add.at(change, (y, x), np.where(events["p"] == 1, on, -off))
    return change


def counts(events, shape):
    """Count the events of each pixel, row by row."""
    pixels = np.ravel_multi_index((events["y"], events["x"]), shape)
    return np.bincount(pixels, minlength=np.prod(shape))
