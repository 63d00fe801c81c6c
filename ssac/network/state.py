"""One camera of a network: where it saw the object, and its clock, pose and intrinsics.

The network's time is that of its first camera's clock, strays apart. A sighting at time T of a
camera's clock, in the share y of the image's rows, has the network's time

    t = T + readout y - delay - rate (T - T_mid) - stray(T),

which is linear in all unknowns. Strays are linear between knots, without offset or slope.

Events come once an edge has moved on by some share of a pixel: the object appears behind its true
position by a length along its motion in the image, not by a time, which is longer where it is slow.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from ssac.arrays import Array, IntArray, Mask
from ssac.camera import Camera, distort_points, undistort_points
from ssac.fit.intrinsics import moves_of
from ssac.rules import PointRules
from ssac.search.object_track import ShapedTrack
from ssac.track.motion import PointMotion, point_motion
from ssac.track.silhouette import Images


@dataclass(frozen=True, eq=False)
class Sightings:
    """Where one camera saw the object, on its own clock."""

    name: str
    camera: Camera
    times_s: Array  # (n,) ascending; of each point's own row, if the rig states the readout
    points_px: Array  # (n, 2) undistorted
    rows: Array  # (n,) 0 at the image's first row, 1 at its last
    sigmas_px: Array  # (n,) of each coordinate
    motion: PointMotion  # the points as a function of time
    has_frames: bool  # frames, perhaps of a rolling shutter; False: events
    spreads_px2: Array | None = None
    """(n, 3) second moments of the silhouettes whose centroids the points are; NaN where a point is
    another one of the object; None where all are."""
    images: Images | None = None  # the silhouettes, not undistorted

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and the last sighting [s]."""
        return float(self.times_s[0]), float(self.times_s[-1])

    @property
    def middle_s(self) -> float:
        """Middle of the recording [s]."""
        return 0.5 * (self.span_s[0] + self.span_s[1])

    @property
    def interval_s(self) -> float:
        """Median time between sightings [s]."""
        return float(np.median(np.diff(self.times_s)))

    @property
    def shares(self) -> Array:
        """Deviation of each sighting (n,) relative to their median."""
        return np.asarray(self.sigmas_px / np.median(self.sigmas_px))


def sightings(
    shaped: ShapedTrack, camera: Camera, name: str, has_frames: bool, rules: PointRules
) -> Sightings:
    """Prepare the track of one camera, with what silhouettes tell of its points."""
    motion = point_motion(shaped.track, camera, rules, name=name)
    known = np.isfinite(undistort_points(camera, shaped.track.points_px)[:, 0])
    spreads = None if shaped.spreads_px2 is None else shaped.spreads_px2[known]
    points = motion.points_px, motion.rows, motion.sigmas_px
    images = None if shaped.images is None else shaped.images.of(known)
    return Sightings(name, camera, motion.times_s, *points, motion, has_frames, spreads, images)


def is_near(times_s: Array, seen_s: Array, reach_s: float) -> Mask:
    """Whether any of a camera's sightings, at times (m,), is within reach of times (n,)."""
    ordered = np.concatenate([[-np.inf], np.sort(seen_s), [np.inf]])
    after = np.searchsorted(ordered, times_s)
    off_s = np.minimum(times_s - ordered[after - 1], ordered[after] - times_s)
    return np.asarray(off_s <= reach_s)


DELAY, RATE, READOUT = 0, 1, 2
ROTATION, TRANSLATION, FOCAL, CENTRE = slice(3, 6), slice(6, 9), slice(9, 11), slice(11, 13)
BEHIND = 13
STRAYS = 14  # the first of them
"""Places of a camera's parameters."""

_ZEROS, _NONE = partial(np.zeros, 2), partial(np.empty, 0)


@dataclass(frozen=True, eq=False)
class CameraState:
    """Clock, pose and intrinsics of one camera; by default it is at the network's origin."""

    delay_s: float = 0.0
    rate: float = 0.0  # by which share of its own time its clock is fast
    middle_s: float = 0.0  # T_mid, its own clock
    readout_s: float = 0.0  # in addition to the rig's
    R: Array = field(default_factory=partial(np.eye, 3))  # x = R X + t, X in the network's frame
    t: Array = field(default_factory=partial(np.zeros, 3))
    focal: Array = field(default_factory=_ZEROS)  # (2,) change of fu and fv, as a share
    centre_px: Array = field(default_factory=_ZEROS)  # (2,) change of pu and pv
    behind_px: float = 0.0  # by which the object appears behind, along its motion
    knots_s: Array = field(default_factory=_NONE)  # (k,) its own clock; empty: its clock is affine
    strays_s: Array = field(default_factory=_NONE)  # (k,)

    @property
    def size(self) -> int:
        """Number of its parameters."""
        return STRAYS + len(self.strays_s)

    @property
    def centre(self) -> Array:
        """Projection centre (3,) in the network's frame."""
        return np.asarray(-self.R.T @ self.t)

    def network_from_own(self, times_s: Array) -> Array:
        """Convert times (n,) [s] of its clock to the network's, for the image's first row."""
        passed_s = times_s - self.delay_s - self.rate * (times_s - self.middle_s)
        if len(self.knots_s):
            passed_s = passed_s - np.interp(times_s, self.knots_s, self.strays_s)
        return np.asarray(passed_s)

    def own_from_network(self, times_s: Array) -> Array:
        """Convert the network's times (n,) [s] to those of its clock."""
        affine_s = times_s + self.delay_s - self.rate * self.middle_s
        own_s = affine_s / (1.0 - self.rate)
        for _ in range(3 if len(self.knots_s) else 0):  # strays change slowly
            strays_s = np.interp(own_s, self.knots_s, self.strays_s)
            own_s = (affine_s + strays_s) / (1.0 - self.rate)
        return np.asarray(own_s)

    def moved(self, step: Array) -> "CameraState":
        """Apply a change (size,) of the parameters."""
        return replace(
            self,
            delay_s=self.delay_s + float(step[DELAY]),
            rate=self.rate + float(step[RATE]),
            readout_s=self.readout_s + float(step[READOUT]),
            R=Rotation.from_rotvec(step[ROTATION]).as_matrix() @ self.R,
            t=self.t + step[TRANSLATION],
            focal=self.focal + step[FOCAL],
            centre_px=self.centre_px + step[CENTRE],
            behind_px=self.behind_px + float(step[BEHIND]),
            strays_s=self.strays_s + step[STRAYS:],
        )


def with_strays(state: CameraState, seen: Sightings, piece_s: float, most: int) -> CameraState:
    """Add strays to a camera's clock, with knots about `piece_s` apart over its recording."""
    start_s, end_s = seen.span_s
    n = int(np.clip(np.rint((end_s - start_s) / piece_s), 0, most))
    if n < 2:
        return state
    knots_s = np.linspace(start_s, end_s, n + 1, dtype=np.float64)
    return replace(state, knots_s=knots_s, strays_s=np.zeros(n + 1))


def network_times(state: CameraState, seen: Sightings) -> Array:
    """Give the network's time (n,) [s] of each sighting."""
    return state.network_from_own(seen.times_s) + state.readout_s * seen.rows


def projected(
    state: CameraState, seen: Sightings, points: Array, velocities: Array
) -> tuple[Array, Mask, Array, Array, IntArray]:
    """Project the path's points (n, 3), one for each sighting, with velocities (n, 3) there.

    Returns the projections (n, 2) [px], which of them are in front of the camera (n,), their
    derivatives by the points (n, 2, 3) and by the camera's parameters (n, 2, p), and the places
    (n, p) of the latter.
    """
    K, n, k = seen.camera.K, len(points), len(state.knots_s)
    turned = points @ state.R.T
    local = turned + state.t
    in_front = local[:, 2] > 1e-6  # in the path's unit
    safe = np.where(in_front, local[:, 2], 1.0)
    x = local[:, :2] / safe[:, None]
    lengths_px = np.array([K[0, 0], K[1, 1]]) * (1.0 + state.focal)
    by_local = np.zeros((n, 2, 3))
    by_local[:, 0, 0], by_local[:, 1, 1] = lengths_px[0] / safe, lengths_px[1] / safe
    by_local[:, :, 2] = -lengths_px * x / safe[:, None]
    by_point = by_local @ state.R
    by_time = np.einsum("nij,nj->ni", by_point, velocities)
    p = STRAYS + (2 if k else 0)
    by_camera = np.zeros((n, 2, p))
    by_camera[:, :, DELAY] = -by_time
    by_camera[:, :, RATE] = -by_time * (seen.times_s - state.middle_s)[:, None]
    by_camera[:, :, READOUT] = by_time * seen.rows[:, None]
    by_camera[:, :, ROTATION] = np.cross(by_local, turned[:, None, :], axis=2) * -1.0
    by_camera[:, :, TRANSLATION] = by_local
    away = -moves_of(seen.camera, np.diag(K)[:2] * x + K[:2, 2])
    by_camera[:, :, FOCAL] = np.moveaxis(away[:2], 0, 2)
    by_camera[:, :, CENTRE] = np.moveaxis(away[2:], 0, 2) / np.diag(K)[:2]
    # Below about 1 px/s in the image there is no direction in which events could lag.
    speeds = np.sqrt(np.sum(by_time**2, axis=1) + 1.0)
    by_camera[:, :, BEHIND] = -by_time / speeds[:, None]  # the change of direction is negligible
    columns = np.tile(np.arange(p), (n, 1))
    if k:
        piece = np.clip(np.searchsorted(state.knots_s, seen.times_s, "right") - 1, 0, k - 2)
        low, high = state.knots_s[piece], state.knots_s[piece + 1]
        share = np.clip((seen.times_s - low) / (high - low), 0.0, 1.0)
        by_camera[:, :, STRAYS] = -by_time * (1.0 - share)[:, None]
        by_camera[:, :, STRAYS + 1] = -by_time * share[:, None]
        columns[:, STRAYS], columns[:, STRAYS + 1] = STRAYS + piece, STRAYS + piece + 1
    behind_px = state.behind_px * by_camera[:, :, BEHIND]
    points_px = _seen_px(state, seen.camera, x) + behind_px
    return points_px, in_front, by_point, by_camera, columns.astype(np.int64)


def _seen_px(state: CameraState, camera: Camera, x: Array) -> Array:
    """Give what rays x (n, 2) seen with a state's intrinsics are by the rig's, undistorted [px]."""
    lengths_px, centre_px = np.diag(camera.K)[:2], camera.K[:2, 2]
    if camera.distortion_model == "none":
        return np.asarray(lengths_px * (1.0 + state.focal) * x + centre_px + state.centre_px)
    ideal_px = lengths_px * x + centre_px
    if not (state.focal.any() or state.centre_px.any()):
        return np.asarray(ideal_px)
    away_px = distort_points(camera, ideal_px) - centre_px
    seen_px = undistort_points(camera, away_px * (1.0 + state.focal) + centre_px + state.centre_px)
    return np.where(np.isfinite(seen_px), seen_px, ideal_px)


@dataclass(frozen=True)
class Priors:
    """Prior deviations of a camera's parameters; 0: exact."""

    rate: float
    readout_s: float
    focal: tuple[float, float]
    centre_px: tuple[float, float]
    roughness: float  # change of the rate from one piece of its clock to the next
    expected_rate: float = 0.0
    pose_is_known: bool = False  # it is held where the pairs place it
    is_suspect: bool = False  # pairs contradict its intrinsics
    in_doubt: bool = False  # its intrinsics' deviations are wider than the rig's

    def pulls(self, state: CameraState) -> Array:
        """By how many deviations (2,) focal lengths, and the principal point, are off the rig's."""
        both = np.array([[state.focal, state.centre_px], [self.focal, self.centre_px]])
        shares = np.abs(both[0]) / np.where(both[1] > 0.0, both[1], np.inf)
        return np.asarray(shares.max(axis=1))

    def less_certain(self, of_focal: float, of_centre: float) -> "Priors":
        """Widen the intrinsics' deviations by these factors."""
        (fu, fv), (pu_px, pv_px) = self.focal, self.centre_px
        focal, centre_px = (of_focal * fu, of_focal * fv), (of_centre * pu_px, of_centre * pv_px)
        return replace(self, focal=focal, centre_px=centre_px, in_doubt=True)
