"""A turning body that consists of balls, and its images."""

import numpy as np
from scipy.spatial.transform import Rotation

FINE = 4  # samples across a pixel

BODY_M = np.array([
    [0.30, 0.22, 0.0, 0.06], [0.30, -0.22, 0.0, 0.06], [-0.30, 0.22, 0.0, 0.06],
    [-0.30, -0.22, 0.0, 0.06], [0.0, 0.0, 0.03, 0.09], [0.12, 0.0, 0.03, 0.06],
    [0.15, 0.11, 0.0, 0.04], [0.15, -0.11, 0.0, 0.04], [-0.15, 0.11, 0.0, 0.04],
    [-0.15, -0.11, 0.0, 0.04],
])  # fmt: skip
"""Centre and radius of each ball. The balls in the middle are above the arms, as on a drone."""

BALL_M = np.array([[0.0, 0.0, 0.0, 0.25]])


def attitudes(times_s, turning_deg_s):
    """Attitudes that oscillate in tilt and turn steadily about the vertical."""
    tilt_deg = 15.0 * np.stack([np.sin(1.3 * times_s), np.cos(0.9 * times_s)], axis=1)
    yaw_deg = 20.0 + turning_deg_s * times_s
    # y is down in the frame of the first camera.
    upright = Rotation.from_euler("x", 90.0, degrees=True)
    turns = np.column_stack([yaw_deg, tilt_deg])
    return upright * Rotation.from_euler("ZYX", turns, degrees=True)


def moments_of(balls, turns):
    """Second moments (n, 3, 3) of the balls about the origin, each weighted by its image's area."""
    weights = balls[:, 3] ** 2
    flat = (balls[:, :3] * weights[:, None]).T @ balls[:, :3] / weights.sum()
    flat += np.eye(3) * 0.2 * np.sum(weights * balls[:, 3] ** 2) / weights.sum()
    axes = turns.as_matrix()
    return axes @ flat @ axes.transpose(0, 2, 1)


def drawn_at(balls, turns, points, focal_px, width):
    """Draw the body at points (n, 3) with attitudes `turns`, both in the camera's frame.

    Return the covered share of each pixel (n, width, width), the first pixels relative to the
    principal point (n, 2), the silhouette's centroid relative to the image of the body's origin
    (n, 2), and the silhouette's central second moments xx, xy and yy (n, 3).
    """
    local = (np.arange(width * FINE) + 0.5) / FINE - 0.5
    u, v = np.meshgrid(local, local)
    there = focal_px * points[:, :2] / points[:, 2:]
    corners = np.rint(there) - width // 2
    shares = np.zeros((len(points), width, width), np.float32)
    off, spreads = np.zeros((len(points), 2)), np.zeros((len(points), 3))
    for i, (turn, point, corner) in enumerate(zip(turns, points, corners, strict=True)):
        rays = np.stack([(u + corner[0]) / focal_px, (v + corner[1]) / focal_px, 0 * u + 1], -1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        covered = np.zeros(u.shape, np.bool_)
        for centre, radius in zip(turn.apply(balls[:, :3]) + point, balls[:, 3], strict=True):
            covered |= centre @ centre - (rays @ centre) ** 2 < radius**2
        shares[i] = covered.reshape(width, FINE, width, FINE).mean(axis=(1, 3))
        off[i] = np.array([u[covered].mean(), v[covered].mean()]) + corner - there[i]
        around = np.cov(u[covered], v[covered], bias=True)
        spreads[i] = around[0, 0], around[0, 1], around[1, 1]
    return shares, corners, off, spreads
