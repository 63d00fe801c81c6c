"""The cameras and the object's path in space, as the page draws them, with their deviations."""

from typing import Any

import numpy as np

from ssac.arrays import Array
from ssac.estimate import Status
from ssac.geometry.epipolar import cross_matrix, robust_deviation, sampson_distance
from ssac.geometry.pose import depths, rays_of, tangent_basis
from ssac.network.solve import NetworkAnswer
from ssac.pipeline.answer import Answer
from ssac.track.moments import image_by_place

_MOST_POINTS = 1500  # of the path
_CROSSES = 60  # of deviations along it
_LARGER = tuple(m * 10**k for k in range(6) for m in (1, 2, 5))  # how deviations are drawn


def scene_of_two(answer: Answer) -> dict[str, Any] | None:
    """Lay out two cameras, the first of which is the frame, and where both rays to the object meet.

    Deviations of the path are those of its positions' noise; the pose's are at camera 2. None where
    there is no reliable pose.
    """
    estimate, views = answer.estimate, answer.paired
    R, t, F = estimate.R, estimate.t, estimate.F
    if estimate.status != Status.OK or R is None or t is None or F is None:
        return None
    times_s = np.linspace(*views.common_s(estimate.t_d_s), _MOST_POINTS, dtype=np.float64)
    one, other = views.sharp_at(times_s, estimate.t_d_s)
    seen = one.valid & other.valid
    times_s, p1, p2 = times_s[seen], one.positions_px[seen], other.positions_px[seen]
    rays = [rays_of(camera.K, p) for camera, p in zip(answer.cameras, (p1, p2), strict=True)]
    depths_1, depths_2 = depths(R, t, *rays)
    ahead = (depths_1 > 0.0) & (depths_2 > 0.0)
    if not ahead.any():
        return None
    points: Array = 0.5 * (depths_1[:, None] * rays[0] + (depths_2[:, None] * rays[1] - t) @ R)
    some = np.flatnonzero(ahead)[:: 1 + np.count_nonzero(ahead) // _CROSSES]
    information: Array = np.zeros((len(some), 3, 3))
    for K, turn, shift in (
        (answer.cameras[0].K, np.eye(3), np.zeros(3)),
        (answer.cameras[1].K, R, t),
    ):
        by = image_by_place(turn, np.diag(K)[:2], points[some] @ turn.T + shift)
        information += np.swapaxes(by, 1, 2) @ by
    sigma_px = robust_deviation(sampson_distance(F, p1, p2))
    axes_2: Array = np.zeros((3, 3))
    if estimate.covariance is not None:
        # The centre is -R' t: a turn w of R moves it by -R' (t x w), a change dt of t by -R' dt.
        by_pose = -R.T @ np.hstack([cross_matrix(t), tangent_basis(t).T])
        axes_2 = _axes(by_pose @ estimate.covariance[1:, 1:] @ by_pose.T)
    cameras = [
        _camera(0, np.eye(3), np.zeros(3), np.zeros((3, 3)), 0.0),
        _camera(1, R, -R.T @ t, axes_2, estimate.t_d_s),
    ]
    crosses = _axes(np.asarray(sigma_px**2 * np.linalg.pinv(information, hermitian=True)))
    return _laid_out(cameras, times_s[ahead], points[ahead], points[some], crosses)


def scene_of_network(network: NetworkAnswer) -> dict[str, Any] | None:
    """Lay out the cameras of the first group and the path that they saw; None without a group."""
    if not network.paths or not len(network.paths[0].path):
        return None
    path, cameras = network.paths[0].path, list[dict[str, Any]]()
    for k, camera in enumerate(network.cameras):
        if camera.group == 1 and camera.R is not None and camera.centre is not None:
            stds = np.zeros(3) if camera.t_std is None else camera.t_std
            cameras.append(
                _camera(k, camera.R, camera.centre, np.diag(stds) @ camera.R, camera.t_d_s)
            )
    thin = slice(None, None, 1 + len(path) // _MOST_POINTS)
    some = slice(None, None, 1 + len(path) // _CROSSES)
    stds_m = np.zeros((len(path), 3)) if path.deviations_m is None else path.deviations_m
    crosses = stds_m[some, :, None] * np.eye(3)
    points = path.positions_m
    return _laid_out(cameras, path.times_s[thin], points[thin], points[some], crosses)


def _camera(k: int, R: Array, centre: Array, axes: Array, later_s: float) -> dict[str, Any]:
    return {"k": k, "R": R, "centre": centre, "axes": axes, "later": later_s}


def _axes(covariances: Array) -> Array:
    """Give the three axes (..., 3, 3), in rows, of one deviation of covariances (..., 3, 3)."""
    values, vectors = np.linalg.eigh(covariances)
    return np.asarray(np.swapaxes(vectors * np.sqrt(values.clip(0.0))[..., None, :], -1, -2))


def _laid_out(
    cameras: list[dict[str, Any]], times_s: Array, points: Array, places: Array, crosses: Array
) -> dict[str, Any]:
    """Give all of it as lists, and how much larger deviations must be drawn to be seen."""
    every = np.vstack([points, [camera["centre"] for camera in cameras]])
    extent = float(np.linalg.norm(np.ptp(every, axis=0)))
    lengths = [float(np.median(np.linalg.norm(crosses, axis=2).max(axis=1)))]
    lengths += [float(np.max(np.linalg.norm(camera["axes"], axis=1))) for camera in cameras]
    larger = next((n for n in _LARGER[::-1] if 0.0 < n * max(lengths) < 0.04 * extent), 1)
    steps_s = np.diff(times_s)
    usual_s = float(np.median(steps_s)) if len(steps_s) else np.inf
    return {
        "cameras": [
            {name: np.round(value, 6).tolist() for name, value in camera.items()}
            for camera in cameras
        ],
        "path": np.round(points, 5).tolist(),
        "times": np.round(times_s, 4).tolist(),
        "ends": np.flatnonzero(steps_s > 4.0 * usual_s).tolist(),  # last points before gaps
        "crosses": [np.round(places, 5).tolist(), np.round(crosses, 7).tolist()],
        "larger": larger,
    }
