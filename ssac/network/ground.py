"""The frame and the scale of a network, as given by positions of cameras or an RTK path."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ssac.arrays import Array
from ssac.errors import SsacError
from ssac.files.damage import check_is_file
from ssac.fit.covariance import PRIOR, correlated_covariance, student_factor
from ssac.geometry.epipolar import cross_matrix
from ssac.network.align import RULES, Similarity, by_similarity, similarity
from ssac.network.comparison import check_moves, compare, without_lever_arm
from ssac.network.solve import CameraAnswer, NetworkAnswer, path_of
from ssac.network.tum import read_path, rows_of
from ssac.rules import FitRules, GroundRules

POSITION_COLUMNS = ("camera", "x_m", "y_m", "z_m")


class PlacesError(SsacError):
    """Places of cameras that leave their frame open: too few, or nearly on a line."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A known frame, relative to that of the network."""

    similarity: Similarity  # from the first camera's frame to the known one
    said: str  # how well it fits, for people
    middle_m: Array  # (3,) of the points it was fitted to
    covariance: Array  # (7, 7) of turn about the middle [rad], shift [m] and log of scale

    def added(self, points_m: Array) -> Array:
        """Covariances (..., 3, 3) [m^2] that the frame's own errors give points (..., 3) [m]."""
        by_frame = by_similarity(points_m - self.middle_m)
        return np.asarray(by_frame @ self.covariance @ np.swapaxes(by_frame, -1, -2))


def ground_of_positions(answer: NetworkAnswer, file: Path, rules: GroundRules) -> Ground:
    """Fit at least three cameras to their given positions; SsacError if these contradict poses.

    PlacesError if the positions of those that are placed leave the frame open.
    """
    stated = load_positions(file)
    placed = {k: one.centre for k, one in enumerate(answer.cameras, 1) if one.group == 1}
    here, there = (np.array([of[k] for k in stated if k in placed]) for of in (placed, stated))
    _check_places(file, there, rules)
    found = similarity(here, there)
    off_m = np.linalg.norm(found.apply(here) - there, axis=1)
    spread_m = np.linalg.norm(there - np.mean(there, axis=0), axis=1)
    rms_m, extent_m = float(np.sqrt(np.mean(off_m**2))), float(np.sqrt(np.mean(spread_m**2)))
    if rms_m > rules.max_off_share * extent_m:
        raise SsacError(
            f"{file}: the cameras' poses contradict these positions, by {rms_m:.2f} m over "
            f"{extent_m:.2f} m: check which camera is which, and the order x y z"
        )
    middle_m = np.asarray(np.mean(there, axis=0))
    freedom = 3 * len(there) - 7
    J = by_similarity(there - middle_m).reshape(-1, 7)
    deviation_m = student_factor(freedom) * float(np.sqrt(np.sum(off_m**2) / freedom))
    covariance = np.asarray(deviation_m**2 * np.linalg.inv(J.T @ J), np.float64)
    said = f"cameras stand within {rms_m:.3f} m of their given positions"
    return Ground(found, said, middle_m, covariance)


def ground_of_rtk(
    answer: NetworkAnswer,
    file: Path,
    rules: GroundRules,
    fit: FitRules,
    lever_arm_m: tuple[float, float, float] | None = None,
) -> Ground:
    """Align the path of a network with one by RTK, whose clock is unknown.

    With a lever arm, the antenna's position in the body (forward, left, up), the file must have the
    attitude, and the path is of the body's origin. SsacError if the file is of another flight.
    """
    path, rtk = answer.paths[0].path, read_path(file)
    std_ppm = rules.rtk_rate_std_ppm
    with _as_truth(file):
        found = compare(path, rtk, rate_std_ppm=std_ppm, lever_arm_m=lever_arm_m).in_time
    if found is None or found.explained < rules.least_explained:
        share = 0.0 if found is None else found.explained
        raise SsacError(
            f"{file}: at the best of all shifts the path explains {100.0 * share:.0f} % of its "
            "motion only: check that it is of this flight"
        )
    clock = found.clock
    said = (
        f"RTK is {found.rmse_m:.3f} m off rms at {len(found.distances_m)} samples; its clock shows "
        f"{clock.t_d_s:.3f} s more at {clock.t_ref_s:.2f} s, and runs {clock.skew_ppm:+.1f} ppm"
    )
    laid_m, times_s = found.estimate_m, found.times_s
    middle_m = np.mean(laid_m, axis=0)
    moving_m_s = np.gradient(laid_m, times_s, axis=0)[..., None]  # its clock is fitted as well
    by_clock = [moving_m_s, moving_m_s * (times_s - np.mean(times_s))[:, None, None]]
    J = np.concatenate([by_similarity(laid_m - middle_m), *by_clock], axis=2)
    n, p = len(J), J.shape[2]
    covariance = correlated_covariance(
        np.tile(times_s, 3),
        J.transpose(1, 0, 2).reshape(-1, p),
        (found.truth_m - laid_m).T.ravel(),
        np.ones(3 * n),
        fit,
        np.full(p, PRIOR),
        np.full(p, np.nan),
        np.empty(0, np.intp),
        cautious=True,
    )
    return Ground(found.similarity, said, middle_m, covariance[:7, :7])


def check_positions(file: Path, rules: GroundRules) -> None:
    """Raise SsacError unless a file's positions may set a frame, whichever cameras are placed."""
    _check_places(file, np.array([*load_positions(file).values()]), rules)


def _check_places(file: Path, places: Array, rules: GroundRules) -> None:
    """Raise PlacesError unless cameras at places (n, 3) [m] tell how their frame is turned."""
    if len(places) < 3:
        raise PlacesError(
            f"{file}: positions of at least 3 cameras of the network are needed, got {len(places)}:"
            " add some, or give --distance"
        )
    spreads_m = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) / np.sqrt(len(places))
    # Errors that pass for small turn the frame about a line at will.
    if spreads_m[1] <= rules.max_off_share * spreads_m[0]:
        raise PlacesError(
            f"{file}: the cameras stand nearly on a line, {spreads_m[1]:.2g} m off it rms over "
            f"{spreads_m[0]:.2g} m, which leaves open how the frame is turned about it: add one "
            "that stands aside, or give --rtk or --distance"
        )


def check_rtk(file: Path, lever_arm_m: tuple[float, float, float] | None = None) -> None:
    """Raise SsacError unless a file has a path that moves, with attitudes for a lever arm."""
    rtk = read_path(file)
    with _as_truth(file):
        if lever_arm_m is not None:
            without_lever_arm(rtk, lever_arm_m)
        check_moves("the truth", rtk, RULES.least_samples)


@contextmanager
def _as_truth(file: Path) -> Iterator[None]:
    """Name the file in errors of a comparison with it."""
    try:
        yield
    except SsacError as error:
        raise SsacError(f"{file}, taken for the truth: {error}") from error


def in_frame(answer: NetworkAnswer, ground: Ground) -> NetworkAnswer:
    """Express cameras and path of the first group in a known frame; other groups stay."""
    frame, cameras = ground.similarity, list[CameraAnswer]()
    for camera in answer.cameras:
        R, t, covariance = camera.R, camera.t, camera.pose_covariance
        if camera.group == 1 and R is not None and t is not None and covariance is not None:
            R = R @ frame.R.T  # x_k = R X + t in metres, X in the known frame
            moved_m = -R @ frame.t
            t = frame.scale * t + moved_m
            # t is the place of the frame's origin, as the camera sees it: a turn swings it round.
            by_pose = np.zeros((6, 6))
            by_pose[:3, :3], by_pose[3:, :3] = np.eye(3), -cross_matrix(moved_m)
            by_pose[3:, 3:] = frame.scale * np.eye(3)
            by_frame = np.zeros((6, 7))
            by_frame[:3, :3] = -R
            by_frame[3:] = -R @ by_similarity(-ground.middle_m)
            by_frame[3:, 6] += t
            covariance = by_pose @ covariance @ by_pose.T
            covariance += by_frame @ ground.covariance @ by_frame.T
            camera = replace(camera, R=R, t=t, pose_covariance=covariance)
        cameras.append(camera)
    held = path_of(answer.built[0], frame)
    added = np.diagonal(ground.added(held.path.positions_m), axis1=1, axis2=2)
    deviations_m = np.sqrt(np.asarray(held.path.deviations_m) ** 2 + added)
    first = replace(held, path=replace(held.path, deviations_m=deviations_m))
    return replace(answer, cameras=cameras, paths=[first, *answer.paths[1:]])


def load_positions(file: Path) -> dict[int, Array]:
    """Read positions of cameras: `camera,x_m,y_m,z_m`, cameras by number from 1 on."""
    check_is_file(file)
    rows = rows_of(file, "a text file of positions")
    if not rows or tuple(rows[0]) != POSITION_COLUMNS:
        raise SsacError(f"{file}: the first line must be {','.join(POSITION_COLUMNS)}: add it")
    found = {}
    for row in rows[1:]:
        try:
            number, position = int(row[0]), np.array(row[1:], dtype=np.float64)
        except ValueError:
            number, position = 0, np.empty(0)
        if number < 1 or position.shape != (3,) or not np.isfinite(position).all():
            raise SsacError(
                f"{file}: expected a camera's number and three coordinates, got "
                f"{','.join(row)[:60]!r}: correct the row"
            )
        if number in found:
            raise SsacError(f"{file}: camera {number} is there twice: leave one out")
        found[number] = position
    return found
