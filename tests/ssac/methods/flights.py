"""Flights that leave offset or pose open, seen by two cameras 90 degrees apart."""

from dataclasses import replace
from functools import cache, partial

import numpy as np

from ssac import Chain, Config, Observation
from tests.ssac.synthetic import DISTANCE_M, make_events, make_scene

T_D_S = 0.05
CLEAN = Config(denoise=False)  # the synthetic events have no noise
DURATION_S = 8.0
MIDDLE = np.array([0.0, 0.0, DISTANCE_M])
AXES = np.linalg.qr(np.array([[1.0, 0.3, 0.5], [0.2, 1.0, -0.4], [-0.3, 0.1, 1.0]]))[0].T


def scene_of(path):
    """Return a scene whose path maps times (n,) [s] to positions (n, 3) [m] in camera 1's frame."""
    return replace(make_scene(0, duration_s=DURATION_S), path=path)


def seen(scene, seed=0, t_d_s=T_D_S):
    return [Observation(events) for events in make_events(scene, seed, t_d_s, size_m=0.4)]


@cache
def flown(path):
    """Return the chain of a path's recording; the methods share its cached stages."""
    scene = scene_of(PATHS.get(path, path))
    return Chain(seen(scene), scene.rig)


def found(path, method, **fields):
    return flown(path).under(replace(CLEAN, **fields)).estimate(method)


def on_a_line(along_m):
    return MIDDLE + along_m[..., None] * AXES[0]


def straight(times_s):
    """Go to and fro along a line without repeating."""
    flight = make_scene(3, duration_s=DURATION_S).path
    return on_a_line(0.75 * (flight(times_s)[..., 0] - MIDDLE[0]))


def circle(times_s, axes=AXES, rise_m_s=0.0):
    turn = 2.0 * np.pi * times_s[..., None] / 2.7
    height = rise_m_s * (times_s[..., None] - DURATION_S / 2)
    around = np.cos(turn) * axes[0] + np.sin(turn) * axes[1]
    return MIDDLE + 1.2 * around + height * axes[2]


def planar(times_s):
    flight = make_scene(5, duration_s=DURATION_S).path(times_s) - MIDDLE
    return MIDDLE + 0.8 * flight[..., :2] @ AXES[:2]


def periodic(times_s):
    turn = 2.0 * np.pi * times_s[..., None] / 0.8
    return (
        MIDDLE
        + (np.cos(turn) + 0.4 * np.sin(2 * turn)) * AXES[0]
        + (0.8 * np.sin(turn) + 0.3 * np.cos(3 * turn)) * AXES[1]
        + 0.7 * np.cos(2 * turn + 1.0) * AXES[2]
    )


PATHS = {
    "free": make_scene(0, duration_s=DURATION_S).path,
    "at rest": lambda times_s: np.broadcast_to(MIDDLE, (*times_s.shape, 3)),
    "straight": straight,
    "uniform": lambda times_s: on_a_line(0.4 * (times_s - DURATION_S / 2)),
    # To and fro along a line several times a second.
    "brisk": lambda t_s: on_a_line(0.5 * np.sin(13.0 * t_s) + 0.25 * np.sin(21.0 * t_s + 1.0)),
    "circle": circle,
    "helix": partial(circle, rise_m_s=0.25),
    # In the plane in which both cameras lie, so that both see a line.
    "edge on": partial(circle, axes=np.eye(3)[[0, 2, 1]]),
    "planar": planar,
    "periodic": periodic,
}
