"""The frame and the scale of a network, as given by positions of cameras or an RTK path."""

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ssac.arrays import Array
from ssac.errors import SsacError
from ssac.files.damage import check_is_file, readable
from ssac.network.align import Similarity, similarity
from ssac.network.comparison import compare, without_lever_arm
from ssac.network.solve import CameraAnswer, NetworkAnswer, path_of
from ssac.network.tum import read_path
from ssac.rules import GroundRules

POSITION_COLUMNS = ("camera", "x_m", "y_m", "z_m")


@dataclass(frozen=True, eq=False)
class Ground:
    """A known frame, relative to that of the network."""

    similarity: Similarity  # from the first camera's frame to the known one
    said: str  # how well it fits, for people


def ground_of_positions(answer: NetworkAnswer, file: Path, rules: GroundRules) -> Ground:
    """Fit at least three cameras to their given positions; SsacError if these contradict poses."""
    said = load_positions(file)
    placed = {k: one.centre for k, one in enumerate(answer.cameras, 1) if one.group == 1}
    here, there = (np.array([of[k] for k in said if k in placed]) for of in (placed, said))
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
    return Ground(found, f"cameras stand within {rms_m:.3f} m of their given positions")


def ground_of_rtk(
    answer: NetworkAnswer,
    file: Path,
    rules: GroundRules,
    lever_arm_m: tuple[float, float, float] | None = None,
) -> Ground:
    """Align the path of a network with one by RTK, whose clock is unknown.

    With a lever arm, the antenna's position in the body (forward, left, up), the file must have the
    attitude, and the path is of the body's origin. SsacError if the file is of another flight.
    """
    path, rtk = answer.paths[0].path, read_path(file)
    std_ppm = rules.rtk_rate_std_ppm
    found = compare(path, rtk, rate_std_ppm=std_ppm, lever_arm_m=lever_arm_m).in_time
    if found is None or found.explained < rules.least_explained:
        share = 0.0 if found is None else found.explained
        raise SsacError(
            f"{file}: at the best of all shifts the path explains {100.0 * share:.0f} % of its "
            "motion only: check that it is of this flight"
        )
    clock = found.clock
    return Ground(
        found.similarity,
        f"RTK is {found.rmse_m:.3f} m off rms at {len(found.distances_m)} samples; its clock shows "
        f"{clock.t_d_s:.3f} s more at {clock.t_ref_s:.2f} s, and runs {clock.skew_ppm:+.1f} ppm",
    )


def check_positions(file: Path, rules: GroundRules) -> None:
    """Raise SsacError unless a file's positions may set a frame, whichever cameras are placed."""
    _check_places(file, np.array([*load_positions(file).values()]), rules)


def _check_places(file: Path, places: Array, rules: GroundRules) -> None:
    """Raise SsacError unless cameras at places (n, 3) [m] tell how their frame is turned."""
    if len(places) < 3:
        raise SsacError(
            f"{file}: positions of at least 3 cameras of the network are needed, got {len(places)}:"
            " add some, or give --distance"
        )
    spreads_m = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) / np.sqrt(len(places))
    # Errors that pass for small turn the frame about a line at will.
    if spreads_m[1] <= rules.max_off_share * spreads_m[0]:
        raise SsacError(
            f"{file}: the cameras stand nearly on a line, {spreads_m[1]:.2g} m off it rms over "
            f"{spreads_m[0]:.2g} m, which leaves open how the frame is turned about it: add one "
            "that stands aside, or give --rtk or --distance"
        )


def check_rtk(file: Path, lever_arm_m: tuple[float, float, float] | None = None) -> None:
    """Raise SsacError unless a file has a path in metres, times, and attitudes for a lever arm."""
    rtk = read_path(file)
    if lever_arm_m is not None:
        without_lever_arm(rtk, lever_arm_m)


def in_frame(answer: NetworkAnswer, ground: Ground) -> NetworkAnswer:
    """Express cameras and path of the first group in a known frame; other groups stay."""
    frame, cameras = ground.similarity, list[CameraAnswer]()
    for camera in answer.cameras:
        R, t, t_std = camera.R, camera.t, camera.t_std
        if camera.group == 1 and R is not None and t is not None and t_std is not None:
            covariance = np.asarray(camera.centre_covariance)
            covariance = frame.scale**2 * frame.R @ covariance @ frame.R.T
            R = R @ frame.R.T  # x_k = R X + t in metres, X in the known frame
            t = frame.scale * t - R @ frame.t
            camera = replace(
                camera, R=R, t=t, t_std=frame.scale * t_std, centre_covariance=covariance
            )
        cameras.append(camera)
    paths = [path_of(answer.built[0], frame), *answer.paths[1:]]
    return replace(answer, cameras=cameras, paths=paths)


def load_positions(file: Path) -> dict[int, Array]:
    """Read positions of cameras: `camera,x_m,y_m,z_m`, cameras by number from 1 on."""
    check_is_file(file)
    with (
        readable(file, "a text file of positions"),
        file.open(encoding="utf-8-sig", newline="") as lines,
    ):
        rows = [[word.strip() for word in row] for row in csv.reader(lines) if row]
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
