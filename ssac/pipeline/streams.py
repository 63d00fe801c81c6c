"""Data for the player on an HTML page: each camera's events, how two cameras fit, and the scene.

Events are put into short frames, of which only the pixels with an event are kept: what an eye can
tell, at about a byte an event. With them go the object's positions, so that the player can draw
epipolar lines at any time and with any offset; and the cameras and the object's path in space, with
their deviations.
"""

import base64
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ssac.arrays import Array, IntArray, Mask
from ssac.camera import Camera, undistort_points
from ssac.estimate import Status
from ssac.events import US_PER_S, slice_time
from ssac.geometry.epipolar import epipolar_distance, robust_deviation, sampson_distance
from ssac.geometry.pose import centre_covariance, depths, rays_of
from ssac.network.graph import Pair
from ssac.network.solve import NetworkAnswer
from ssac.pipeline.answer import Answer
from ssac.pipeline.plots import best_s, d_avg_px, ideal_points
from ssac.track.clean import Clean
from ssac.track.moments import image_by_place
from ssac.track.motion import Motion

# Bounds of a page's size and of what an eye can tell; nothing is decided by them.
_LONGEST_S = 120.0
_MOST_EVENTS = 1_200_000  # of all cameras: 1 MB of the page, or 2.4 MB if they are noise
_MOST_FRAMES, _LEAST_FRAME_S = 6000, 0.01
_MOST_COLUMNS = 400  # of a frame
_REACH_S = 1.0  # by which the player can move the offset, where none was found
_REACHES_S = 0.1, 3.0  # least and largest reach around an offset that was found
_FAR_PX = 60.0  # from the epipolar line; larger distances count as this
_INVALID = -32768
_MOST_POINTS = 1500  # of the path
_CROSSES = 60  # of deviations along the path
_LARGER = tuple(m * 10**k for k in range(6) for m in (1, 2, 5))  # scales to draw deviations at


@dataclass(frozen=True, eq=False)
class Seen:
    """One camera, as the page shows it."""

    clean: Clean  # as methods saw it
    shown: Clean  # as drawn: of a refused recording with all of its events
    motion: Motion  # of the object
    later_s: float | None  # what its clock shows more than the first camera's; None: not known

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time [s] on the camera's clock; (0, 0) without events."""
        first_s, last_s = self.shown.span_s
        return (first_s, last_s) if first_s <= last_s else (0.0, 0.0)

    def points(self, span_s: tuple[float, float], most: int) -> tuple[Array, Array, Mask]:
        """Return times (n,) [s], undistorted points (n, 2), and a mask (n,) of the brighter ones.

        They are about `most` events between two times of its clock, or all points of its track.
        """
        camera, track = self.shown.camera, self.shown.track
        if track is not None:
            inside = (track.times_s >= span_s[0]) & (track.times_s <= span_s[1])
            points = undistort_points(camera, track.points_px[inside])
            return track.times_s[inside], points, np.ones(len(points), np.bool_)
        # One microsecond more, as the end is not within a slice.
        start_us, end_us = (round(side_s * US_PER_S) for side_s in span_s)
        events = slice_time(self.shown.events, start_us, end_us + 1)
        events = events[:: 1 + len(events) // most]
        return events["t"] / US_PER_S, ideal_points(camera, events), events["p"] > 0


@dataclass(frozen=True)
class Grid:
    """A grid of cells over a camera's undistorted image."""

    left_px: float
    top_px: float
    cell_px: float
    columns: int
    rows: int

    def cells(self, points_px: Array) -> tuple[IntArray, Mask]:
        """Return the cells (n,), row by row, of points (n, 2), and a mask (n,) of those inside."""
        with np.errstate(invalid="ignore"):
            places = np.floor((points_px - (self.left_px, self.top_px)) / self.cell_px)
            inside = np.all((places >= 0) & (places < (self.columns, self.rows)), axis=1)
        x, y = np.where(inside[:, None], places, 0).astype(np.int64).T
        return y * self.columns + x, inside


def grid_of(camera: Camera) -> Grid:
    """Return a grid over a camera's undistorted field of view."""
    size = np.array([camera.width, camera.height], np.float64)
    sides = (np.linspace(-0.5, side - 0.5, 33, dtype=np.float64) for side in size)
    ideal = undistort_points(camera, np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2))
    ends = np.nanmin(ideal, axis=0), np.nanmax(ideal, axis=0)
    # The corners of a strong lens lie far out, and all else would be small beside them.
    (left, top), (right, bottom) = np.clip(ends, -0.5 * size, 1.5 * size).tolist()
    cell = max(1.0, (right - left) / _MOST_COLUMNS)
    columns, rows = (
        max(1, int(np.ceil(side / cell - 1e-9))) for side in (right - left, bottom - top)
    )
    return Grid(left, top, cell, columns, rows)


def as_recorded(clean: Clean) -> Clean:
    """Return a recording with all of its events, noise too; as it is where none were removed."""
    if clean.n_recorded == len(clean.events):  # also for a track, which has no events
        return clean
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the warnings were given when it was read for the estimate
        events = clean.all_events()
    return clean if events is None else replace(clean, events=events, track=None)


def streams(answers: Mapping[Pair, Answer], cameras: list[Seen]) -> dict[str, Any]:
    """Return what the player draws of cameras and pairs: lists, numbers and base64 for JSON."""
    laters_s = [
        seen.span_s[0] - cameras[0].span_s[0] if seen.later_s is None else seen.later_s
        for seen in cameras
    ]
    begin_s, end_s = _stretch(cameras, laters_s)
    views = []
    for k, (seen, later_s) in enumerate(zip(cameras, laters_s, strict=True)):
        first_s, last_s = seen.span_s
        reach_s = max(_reach_s(best_s(one)) for pair, one in answers.items() if k in pair)
        span_s = max(first_s, begin_s + later_s - reach_s), min(last_s, end_s + later_s + reach_s)
        views.append(_view(seen, span_s, _MOST_EVENTS // len(cameras)))
    pairs = [_pair(pair, answer, views) for pair, answer in answers.items()]
    return {"views": views, "pairs": pairs}


def _stretch(cameras: list[Seen], laters_s: list[float]) -> tuple[float, float]:
    """Return start and end [s] on camera 1's clock of the part in which all see the most."""
    first_s, last_s = cameras[0].span_s
    if last_s - first_s <= _LONGEST_S:
        return first_s, last_s
    times_s = np.linspace(first_s, last_s, _MOST_FRAMES, dtype=np.float64)
    views = zip(cameras, laters_s, strict=True)
    n_seeing = np.sum([seen.motion.at(times_s + by_s).valid for seen, by_s in views], axis=0)
    before = np.append(0, np.cumsum(n_seeing))
    many = before[np.searchsorted(times_s, times_s + _LONGEST_S)] - before[:-1]
    start_s = float(times_s[np.argmax(np.where(n_seeing > 0, many, -1))])
    return start_s, min(start_s + _LONGEST_S, last_s)


def _reach_s(t_d_s: float) -> float:
    is_known = np.isfinite(t_d_s)
    return float(np.clip(1.25 * abs(t_d_s), *_REACHES_S)) if is_known else _REACH_S


def _view(seen: Seen, span_s: tuple[float, float], most: int) -> dict[str, Any]:
    """Lay out one camera's frames and the object's positions between two times of its clock."""
    start_s, length_s = span_s[0], max(span_s[1] - span_s[0], _LEAST_FRAME_S)
    frame_s = max(_LEAST_FRAME_S, length_s / _MOST_FRAMES)
    n_frames, grid = int(np.ceil(length_s / frame_s)), grid_of(seen.clean.camera)
    times_s, points_px, brighter = seen.points(span_s, 3 * most)
    cells, inside = grid.cells(points_px)
    n_cells = grid.rows * grid.columns
    frames = ((times_s - start_s) / frame_s).astype(np.int64).clip(0, n_frames - 1)
    # Reversed, so that the last event of a pixel in a frame is the one that stays.
    keys, last = np.unique((frames * n_cells + cells)[inside][::-1], return_index=True)
    kept = np.random.default_rng(0).random(len(keys)) < most / max(len(keys), 1)  # no pattern
    keys, signs = keys[kept], brighter[inside][::-1][last][kept]
    frames, cells = np.divmod(keys, n_cells)
    steps = np.where(np.diff(frames, prepend=-1) > 0, cells, np.diff(cells, prepend=0))
    ends_s: Array = start_s + frame_s * np.arange(n_frames + 1, dtype=np.float64)
    track = seen.motion.at(ends_s)
    unit_px = grid.cell_px * max(grid.columns, grid.rows) / 30_000
    places = (track.positions_px - (grid.left_px, grid.top_px)) / unit_px
    return {
        "start": round(start_s, 6),
        "begin": round(seen.span_s[0], 6),  # of the recording
        "frame": frame_s,
        "n_frames": n_frames,
        "columns": grid.columns,
        "rows": grid.rows,
        "cell": grid.cell_px,
        "left": grid.left_px,
        "top": grid.top_px,
        "counts": packed(np.bincount(frames, minlength=n_frames), "<u4"),
        "events": packed(2 * steps + signs, "<u4"),
        "unit": unit_px,
        "track": packed(
            np.where(track.valid[:, None], places, _INVALID).clip(_INVALID, 32767), "<i2"
        ),
    }


def densities(seen: Seen) -> NDArray[np.uint8]:
    """Draw the density of events as RGBA (rows, columns, 4): grey, the denser the more opaque."""
    grid = grid_of(seen.clean.camera)
    _, points_px, _ = seen.points(seen.span_s, 3 * _MOST_EVENTS)
    cells, inside = grid.cells(points_px)
    counts = np.bincount(cells[inside], minlength=grid.rows * grid.columns)
    shades = np.log1p(counts) / np.log1p(max(1.0, float(np.percentile(counts, 99.9))))
    image = np.full((grid.rows, grid.columns, 4), 128, np.uint8)
    image[..., 3] = 20 * (8.0 * shades.clip(0.0, 1.0)).astype(np.uint8).reshape(grid.rows, -1)
    return image


def packed(values: NDArray[Any], dtype: DTypeLike) -> str:
    """Deflate numbers (n,) or (n, 2), bytes of equal significance side by side, to base64."""
    numbers = np.ascontiguousarray(values.astype(dtype)).ravel()
    planes = numbers.view(np.uint8).reshape(-1, numbers.itemsize).T
    return base64.b64encode(zlib.compress(planes.tobytes())).decode("ascii")


def _pair(pair: Pair, answer: Answer, views: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how two cameras fit: F, the clock, and the cost over offsets that can be tried."""
    estimate, clock = answer.estimate, answer.estimate.clock
    middle_s = best_s(answer)
    is_known, reach_s = bool(np.isfinite(middle_s)), _reach_s(middle_s)
    if not is_known:  # equal clocks; or equal starts, where these are far apart
        apart_s = views[pair[1]]["start"] - views[pair[0]]["start"]
        middle_s = 0.0 if abs(apart_s) < _LONGEST_S else apart_s
    before_s = float(np.clip(0.0, middle_s - reach_s, middle_s + reach_s))
    curve_px = d_avg_px(
        answer, np.linspace(middle_s - reach_s, middle_s + reach_s, 301, dtype=np.float64)
    )
    return {
        "cameras": pair,
        "found": middle_s if is_known else None,
        "holds": estimate.has_offset,
        "before": before_s,
        "low": middle_s - reach_s,
        "high": middle_s + reach_s,
        "F": None if estimate.F is None else estimate.F.tolist(),
        "skew": 1e-6 * clock.skew_ppm,
        "t_ref": clock.t_ref_s,
        "knots": clock.knots_s.tolist(),
        "strays": clock.strays_s.tolist(),
        "curve": [round(px, 3) if np.isfinite(px) else None for px in curve_px.tolist()],
        "still": _telling_time_s(answer, views[pair[0]], before_s),
    }


def _telling_time_s(answer: Answer, view: dict[str, Any], before_s: float) -> float:
    """Return a time at which the object is far off its epipolar line before synchronisation."""
    views, F, t_d_s = answer.paired, answer.estimate.F, best_s(answer)
    times_s: Array = view["start"] + view["frame"] * np.arange(view["n_frames"], dtype=np.float64)
    one = views.motion1.at(times_s)
    seen, worth = one.valid, -np.abs(times_s - np.mean(times_s))
    if F is not None and np.isfinite(t_d_s):
        before, after = (
            views.motion2.at(views.on_clock_2(times_s, offset_s)) for offset_s in (before_s, t_d_s)
        )
        off_px = epipolar_distance(F, one.positions_px, before.positions_px)
        seen, worth = seen & after.valid, np.where(before.valid, np.minimum(off_px, _FAR_PX), 0.0)
    return float(times_s[np.argmax(np.where(seen, worth, -np.inf) if seen.any() else worth)])


def scene_of_two(answer: Answer) -> dict[str, Any] | None:
    """Return the scene of two cameras in the first one's frame, with the triangulated path.

    The path's deviations are those of its positions' noise; the pose's are drawn at camera 2. None
    where there is no reliable pose.
    """
    estimate, views = answer.estimate, answer.paired
    R, t, F = estimate.R, estimate.t, estimate.F
    if estimate.status != Status.OK or R is None or t is None or F is None:
        return None
    times_s = np.linspace(*views.common_s(estimate.t_d_s), _MOST_POINTS, dtype=np.float64)
    one, other = views.sharp_at(times_s, estimate.t_d_s)
    times_s, p1, p2 = one.times_s, one.positions_px, other.positions_px
    rays = [rays_of(camera.K, p) for camera, p in zip(answer.cameras, (p1, p2), strict=True)]
    depths_1, depths_2 = depths(R, t, *rays)
    ahead = (depths_1 > 0.0) & (depths_2 > 0.0)
    if not ahead.any():
        return None
    points: Array = 0.5 * (depths_1[:, None] * rays[0] + (depths_2[:, None] * rays[1] - t) @ R)
    some = np.flatnonzero(ahead)[:: 1 + np.count_nonzero(ahead) // _CROSSES]
    information: Array = np.zeros((len(some), 3, 3))
    poses = (np.eye(3), np.zeros(3)), (R, t)
    for camera, (turn, shift) in zip(answer.cameras, poses, strict=True):
        by = image_by_place(turn, np.diag(camera.K)[:2], points[some] @ turn.T + shift)
        information += np.swapaxes(by, 1, 2) @ by
    sigma_px = robust_deviation(sampson_distance(F, p1, p2))
    axes_2: Array = np.zeros((3, 3))
    if estimate.covariance is not None:
        axes_2 = _axes(centre_covariance(R, t, estimate.covariance[1:, 1:]))
    cameras = [
        _camera(0, np.eye(3), np.zeros(3), np.zeros((3, 3)), 0.0),
        _camera(1, R, -R.T @ t, axes_2, estimate.t_d_s),
    ]
    crosses = _axes(np.asarray(sigma_px**2 * np.linalg.pinv(information, hermitian=True)))
    return _laid_out(cameras, times_s[ahead], points[ahead], points[some], crosses)


def scene_of_network(network: NetworkAnswer) -> dict[str, Any] | None:
    """Return the scene of the first group's cameras and the object's path; None without a path."""
    if not network.paths or not len(network.paths[0].path):
        return None
    path, cameras = network.paths[0].path, list[dict[str, Any]]()
    for k, camera in enumerate(network.cameras):
        if camera.group == 1 and camera.R is not None and camera.centre is not None:
            axes = _axes(np.asarray(camera.centre_covariance))
            cameras.append(_camera(k, camera.R, camera.centre, axes, camera.t_d_s))
    thin = slice(None, None, 1 + len(path) // _MOST_POINTS)
    some = slice(None, None, 1 + len(path) // _CROSSES)
    stds_m = np.zeros((len(path), 3)) if path.deviations_m is None else path.deviations_m
    crosses = stds_m[some, :, None] * np.eye(3)
    points = path.positions_m
    return _laid_out(cameras, path.times_s[thin], points[thin], points[some], crosses)


def _camera(k: int, R: Array, centre: Array, axes: Array, later_s: float) -> dict[str, Any]:
    return {"k": k, "R": R, "centre": centre, "axes": axes, "later": later_s}


def _axes(covariances: Array) -> Array:
    """Return the 1-sigma axes (..., 3, 3), in rows, of covariances (..., 3, 3)."""
    values, vectors = np.linalg.eigh(covariances)
    return np.asarray(np.swapaxes(vectors * np.sqrt(values.clip(0.0))[..., None, :], -1, -2))


def _laid_out(
    cameras: list[dict[str, Any]], times_s: Array, points: Array, places: Array, crosses: Array
) -> dict[str, Any]:
    """Return the scene as lists, with the scale at which its deviations can be seen."""
    every = np.vstack([points, [camera["centre"] for camera in cameras]])
    extent = float(np.linalg.norm(np.ptp(every, axis=0)))
    longest = np.linalg.norm(crosses, axis=2).max(axis=1)
    lengths = [float(np.percentile(longest, 95.0)), 0.2 * float(longest.max())]
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
