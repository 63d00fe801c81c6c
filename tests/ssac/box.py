"""Events that the corners of a flying, turning box make in two views."""

import numpy as np
from scipy.spatial.transform import Rotation

from ssac import Estimate
from tests.ssac.methods.flights import T_D_S
from tests.ssac.synthetic import HEIGHT, WIDTH, angle_deg, events_at, project, rotation_angle_deg

TURN = np.array([0.3, 0.9, 0.5])  # of the box [rad/s]
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def corners_m(scene, times_s, size_m):
    """The box's corners (n, 8, 3) [m] in camera 1's frame; the box turns about a skew axis."""
    # The last corner sticks out, so that the box has no centre of symmetry.
    shape = 0.5 * size_m * CORNERS * [1.0, 0.4, 0.7]
    shape[-1] *= 1.6
    turns = Rotation.from_rotvec(np.outer(times_s, TURN)).as_matrix()
    return scene.path(times_s)[:, None] + np.einsum("nij,cj->nci", turns, shape)


def in_view(points_m, scene, view):
    return points_m @ scene.R.T + scene.t if view else points_m


def box_events(scene, seed, size_m=0.8, lopsided=0.0, scale=1):
    """Events of both cameras at the corners' pixels.

    `lopsided`: share by which corners on one side of the box make more events, the side of positive
    x in camera 1 and of positive y in camera 2. `scale`: pixels per pixel of the ordinary camera.
    """
    rng = np.random.default_rng((seed, 3))
    streams = []
    for view, offset_s in enumerate((0.0, T_D_S)):
        n = int(20_000 * scene.duration_s)
        times_s = np.sort(rng.uniform(0.0, scene.duration_s, n))
        odds = 1.0 + lopsided * (CORNERS[:, view] > 0)
        chosen = rng.choice(8, n, p=odds / odds.sum())
        points = in_view(corners_m(scene, times_s, size_m)[np.arange(n), chosen], scene, view)
        in_front = points[:, 2] > 0.1
        points_px, size = scale * project(points[in_front]), (scale * WIDTH, scale * HEIGHT)
        streams.append(events_at(times_s[in_front] + offset_s, points_px, size))
    return streams


def unit(v):
    return v / np.linalg.norm(v)


def errors(estimate, scene):
    """Errors of t_d [ms], R [deg] and t [deg]."""
    turned_deg = rotation_angle_deg(estimate.R, scene.R)
    return np.array([abs(estimate.t_d_s - T_D_S) * 1e3, turned_deg, angle_deg(estimate.t, scene.t)])


def off_the_truth(scene):
    """An estimate 2 ms, 1.5 deg and 1.3 deg off."""
    turn = Rotation.from_rotvec([0.01, -0.02, 0.015]).as_matrix()
    t = unit(unit(scene.t) + np.array([0.0, 0.02, 0.01]))
    return Estimate("tangency", t_d_s=T_D_S + 0.002, R=turn @ scene.R, t=t)
