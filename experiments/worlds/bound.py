"""The Cramer-Rao bound of a recording: the least errors that an unbiased estimate can have.

It is that of positions with independent Gaussian noise, of one standard deviation in all four
coordinates of a pair. The object's unknown positions are eliminated: a pair tells of offset and
pose only by how far it is from p2' F p1 = 0, in units of the gradient of that product, so the
information is the sum of J_i J_i' / noise_i^2, J_i being the derivative of the Sampson distance.

The positions are those of the true track of the drone's origin at the sample times that are valid
in the recording; for tangents it stands for the points where they touch, whose bound is 1 to 6 %
lower. Sigma is the robust standard deviation (1.4826 times the median absolute value) of the
weighed Sampson distances of the method's own samples under the true offset and pose, and the noise
of a sample is sigma over its weight, whose median is 1.

An efficiency below one has three causes: neighbouring samples' errors, mostly a bias that turns
with the object, correlate by 0.7 to 0.85, and the bound takes them as independent; errors far
beyond the median count little in a robust deviation; and a loss that bears these turns early. One
above one is chance: over ten flights a root mean square is uncertain by a fifth.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ssac.arrays import Array
from ssac.camera import Rig, known_pose
from ssac.files.readable import readable
from ssac.fit.least_squares import Parameters
from ssac.geometry.epipolar import (
    fundamental_from_pose,
    robust_deviation,
    sampson_derivative,
    sampson_distance,
)
from ssac.geometry.pose import pose_jacobian
from ssac.methods.joint import sharp_pairs
from ssac.methods.tangency import tangent_times, tangents_under
from ssac.search.two_views import TwoViews

_MAX_CONDITION = 1e14  # of the information; beyond it a parameter is not seen at all


@dataclass(frozen=True)
class Bound:
    """Least root mean square errors; infinite for what the motion does not tell."""

    t_d_s: float
    R_rad: float  # of the angle of R_est' R_true; 0 when the pose is known
    t_rad: float  # of the angle between the translation directions; 0 when the pose is known


def cramer_rao_bound(information: Array) -> Bound:
    """Bound when offset and pose are unknown, of an information (6, 6)."""
    if not np.linalg.cond(information) < _MAX_CONDITION:
        return Bound(np.inf, np.inf, np.inf)
    variances = np.diag(np.linalg.inv(information))
    R_rad, t_rad = np.sqrt(np.sum(variances[1:4])), np.sqrt(np.sum(variances[4:]))
    return Bound(float(np.sqrt(variances[0])), float(R_rad), float(t_rad))


def known_pose_bound(information: Array) -> Bound:
    """Bound of the offset when the pose is known."""
    with np.errstate(divide="ignore"):
        return Bound(float(1.0 / np.sqrt(information[0, 0])), 0.0, 0.0)


def fisher_information(
    p1_px: Array,
    p2_px: Array,
    v2_px_s: Array,
    R: Array,
    t: Array,
    rig: Rig,
    noise_px: float | Array,
) -> Array:
    """Sum up what n pairs tell of t_d [s] and the five small changes [rad] of the pose: (6, 6).

    Pairs (n, 2) are true positions, undistorted, at the same instants, with the true image velocity
    of p2, and x2 = R x1 + t with |t| = 1; of the rig only the intrinsics count. The noise of each
    coordinate is one for all pairs, or (n,).
    """
    K1, K2 = rig.cam1.K, rig.cam2.K
    F = fundamental_from_pose(K1, K2, R, t)
    by_t_d = sampson_derivative(F, p1_px, p2_px, v2_px_s)
    J = np.column_stack([by_t_d, pose_jacobian(R, t, K1, K2, p1_px, p2_px)])
    J = J / np.broadcast_to(noise_px, len(J))[:, None]
    return np.asarray(J.T @ J)


@dataclass(frozen=True)
class Samples:
    """A method's own pairs at the true offset."""

    times_s: Array  # (n,) camera 1's clock
    p1_px: Array  # (n, 2)
    p2_px: Array  # (n, 2)
    weights: Array  # (n,) that the method gives them, with a median of 1


@dataclass(frozen=True)
class TrueMotion:
    """The drone's flight, and where the cameras are."""

    times_s: Array  # (m,) camera 1's clock
    positions_W_m: Array  # (m, 3) of the drone's origin
    T_C_W: Array  # (2, 4, 4)

    def seen(self, camera: int, K: Array, times_s: Array) -> tuple[Array, Array]:
        """Undistorted image positions [px] and velocities [px/s] of the drone's origin: (n, 2)."""
        T_C_W = self.T_C_W[camera]
        to_image = K @ T_C_W[:3, :3]
        flight = CubicSpline(self.times_s, self.positions_W_m)
        points = flight(times_s) @ to_image.T + K @ T_C_W[:3, 3]
        rates = flight(times_s, 1) @ to_image.T
        p_px = points[:, :2] / points[:, 2:]
        return p_px, (rates[:, :2] - p_px * rates[:, 2:]) / points[:, 2:]


@dataclass(frozen=True)
class MethodBound:
    """What a method could reach at best on one recording."""

    sigma_px: float  # measured noise of a sample of median weight
    n_samples: int
    bound: Bound


def load_truth(folder: Path) -> TrueMotion:
    """Read the flight off the truth.json of a recording."""
    path = folder / "truth.json"
    with readable(path, "the truth of a recording"):
        truth = json.loads(path.read_text(encoding="utf-8"))
        T_C_W = [camera["T_C_W"] for camera in truth["cameras"].values()][:2]
        arrays = (truth["times_s"], truth["drone_position_W_m"], T_C_W)
        times_s, positions_m, poses = (np.array(values, dtype=np.float64) for values in arrays)
        n = len(times_s)
        if (positions_m.shape, poses.shape) != ((n, 3), (2, 4, 4)) or times_s.ndim != 1:
            raise ValueError("its lists are not of one length, or no poses of two cameras")
    return TrueMotion(times_s, positions_m, poses)


def method_bound(
    method: str, views: TwoViews, truth: TrueMotion, t_d_s: float = 0.0
) -> MethodBound:
    """Give the bound of a method of SAMPLES on views whose rig has the true extrinsics."""
    rig, samples = views.rig, SAMPLES[method](views, t_d_s)
    R, t = known_pose(rig)
    F = fundamental_from_pose(rig.cam1.K, rig.cam2.K, R, t)
    distances_px = sampson_distance(F, samples.p1_px, samples.p2_px)
    sigma_px = robust_deviation(samples.weights * distances_px)
    p1_px, _ = truth.seen(0, rig.cam1.K, samples.times_s)
    p2_px, v2_px_s = truth.seen(1, rig.cam2.K, samples.times_s)
    noise_px = sigma_px / samples.weights
    information = fisher_information(p1_px, p2_px, v2_px_s, R, t, rig, noise_px)
    least = known_pose_bound if method in KNOWN_POSE else cramer_rao_bound
    return MethodBound(sigma_px, len(samples.times_s), least(information))


def mean_samples(views: TwoViews, t_d_s: float) -> Samples:
    """Sample as Algorithms 1 and 2 do, to which all samples are alike."""
    pairs = views.pairs_at(t_d_s)
    return Samples(pairs.times_s, *pairs.points_px, np.ones(len(pairs)))


def sharp_samples(views: TwoViews, t_d_s: float) -> Samples:
    """Sample as the joint refinement does."""
    times_s = views.sample_times(np.array([t_d_s]))[0]
    pairs, _ = sharp_pairs(*views.sharp_at(times_s, t_d_s), t_d_s)
    return Samples(pairs.times_s, pairs.p1_px, pairs.p2_px, pairs.weights)


def tangent_samples(views: TwoViews, t_d_s: float) -> Samples:
    """Sample as `tangency` does in its last round, if it has found the truth."""
    R, t = known_pose(views.rig)
    times_s = tangent_times(views, t_d_s)
    pairs, _ = tangents_under(Parameters(t_d_s, R, t), views, times_s)
    return Samples(pairs.times_s, pairs.p1_px, pairs.p2_px, pairs.weights)


SAMPLES: Mapping[str, Callable[[TwoViews, float], Samples]] = {
    "ssac": mean_samples,
    "ssac-known": mean_samples,
    "joint": sharp_samples,
    "joint-known": sharp_samples,
    "tangency": tangent_samples,
    "tangency-known": tangent_samples,
}
"""Of each method that has a bound. The others do not look at positions, or do not use F."""

KNOWN_POSE = tuple(method for method in SAMPLES if method.endswith("-known"))
