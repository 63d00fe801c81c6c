"""A few seconds of two event streams before and after synchronisation, to be animated.

Camera 2's clock is set ahead by a known offset; the offset and F are estimated as for any
recording. What is kept: thinned events, the object's positions, d_avg over offsets.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.lab.score import Score, score
from sim.errors import SimError
from ssac.config import Config
from ssac.events import US_PER_S, slice_time
from ssac.geometry.epipolar import epipolar_distance
from ssac.pipeline.api import chain_of
from ssac.pipeline.plots import Material, d_avg_px

Array = NDArray[np.float64]
Events = NDArray[np.void]

METHOD = "tangency"
T_D_S = 0.5  # large enough that both views are plainly apart
LENGTH_S = 5.0  # of the stretch shown, on camera 1's clock
HALF_WINDOW_S = Config.half_window_s  # of the events whose mean is the position
TRAIL_S = 0.35  # of events before these, fading
TRACK_STEP_S = 0.01  # between the object's positions

_OFFSET_STEP_S = 0.005
_MAX_EVENTS = 150_000  # per camera: 0.8 MB of the page
_MOMENT_S = 0.01
_FAR_PX = 60.0  # farther off the line than this tells no more
_END_S = 1e-6  # makes a range include its end


@dataclass(frozen=True)
class View:
    """One camera's part: its own clock, in seconds since the start of the stretch."""

    times_s: Array  # (n,) of events, ascending
    x_px: NDArray[np.uint16]  # (n,)
    y_px: NDArray[np.uint16]
    brighter: NDArray[np.bool_]
    track_px: Array  # (m, 2) object's position every `TRACK_STEP_S`; NaN where invalid


@dataclass(frozen=True)
class Plan:
    """The scene from above: x to camera 1's right, y along its line of sight [m]."""

    cameras_m: Array  # (2, 2)
    sights: Array  # (2, 2) unit vectors along the lines of sight
    path_m: Array  # (m, 2) drone every `TRACK_STEP_S`, until the last time that camera 2 shows


@dataclass(frozen=True)
class Animation:
    """All that is drawn, and the estimate behind it."""

    width: int  # [px]
    height: int
    start_s: float  # of the stretch, camera 1's clock
    t_d_s: float  # estimated; the true one is T_D_S
    F: Array  # (3, 3)
    errors: Score
    n_samples: int
    d_avg_px: float
    offsets_s: Array  # (k,) from 0 to twice the offset
    curve_px: Array  # (k,) d_avg at these offsets with this F
    views: tuple[View, View]
    plan: Plan

    def at(self, time_s: float, offset_s: float) -> tuple[Array, Array]:
        """Positions p1(t) and p2(t + offset), (2,) each [px]; NaN where there is none."""
        first, second = (view.track_px for view in self.views)
        return _interpolated(first, time_s), _interpolated(second, time_s + offset_s)

    def distance_px(self, time_s: float, offset_s: float) -> float:
        """Distance d of the paper's Fig. 4 in camera 1's image; NaN where a position is missing."""
        return float(epipolar_distance(self.F, *self.at(time_s, offset_s)))

    def mean_distance_px(self, offset_s: float) -> float:
        """d_avg [px] at an offset, off the curve."""
        return float(np.interp(offset_s, self.offsets_s, self.curve_px))

    @property
    def telling_time_s(self) -> float:
        """An instant at which the drone, before, is well off the line in the middle of the view."""
        times_s = np.arange(TRAIL_S, LENGTH_S, TRACK_STEP_S)
        scores = []
        for time_s in times_s.tolist():
            points = [*self.at(time_s, 0.0), *self.at(time_s, self.t_d_s)]
            margin_px = np.min([[x, self.width - x, y, self.height - y] for x, y in points])
            far_px = min(self.distance_px(time_s, 0.0), _FAR_PX)
            scores.append(far_px if margin_px > 0.12 * self.height else 0.0)
        return float(times_s[int(np.argmax(np.nan_to_num(scores)))])


def make_animation(folder: Path) -> Animation:
    """Estimate the offset of a recording with t_d = 0 whose camera 2 is set T_D_S ahead.

    SimError when it gives no estimate, or is shorter than the stretch.
    """
    files = folder / "cam1.h5", folder / "cam2.h5"
    chain = chain_of(files, folder / "rig.yaml").delayed(T_D_S)
    answer = chain.answer(METHOD)
    estimate, (one, other) = answer.estimate, answer.cleans
    if estimate.status != "ok" or estimate.F is None:
        raise SimError(
            f"{folder}: expected a recording that {METHOD} can synchronise, got {estimate.status} "
            f"({estimate.reason}): simulate one of 20 s at 90 deg"
        )
    offsets_s: Array = np.arange(0.0, 2.0 * T_D_S + _END_S, _OFFSET_STEP_S, dtype=np.float64)
    offsets_s = np.sort(np.append(offsets_s, estimate.t_d_s))
    material = Material(estimate, (one.events, other.events), answer.views)
    start_s = _telling_start(material)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    longer_s = LENGTH_S + 2.0 * T_D_S
    views = []
    lengths_s = LENGTH_S, longer_s
    cameras = chain.recorded(0), chain.recorded(1)
    for camera, motion, length_s in zip(cameras, material.motions, lengths_s, strict=True):
        track = motion.at(start_s + _steps(length_s))
        track_px = np.where(track.valid[:, None], track.positions_px, np.nan)
        views.append(_view(camera.events, start_s, length_s, track_px))
    return Animation(
        one.camera.width,
        one.camera.height,
        start_s,
        estimate.t_d_s,
        estimate.F,
        score(estimate, T_D_S, np.array(truth["R"]), np.array(truth["t"])),
        estimate.n_samples,
        estimate.d_avg_px,
        offsets_s,
        d_avg_px(material, offsets_s),
        (views[0], views[1]),
        _plan(truth, start_s - T_D_S, longer_s),
    )


def _telling_start(material: Material) -> float:
    """Start [s] of the stretch in which most is seen: before, the drone is far off the line."""
    motion1, motion2 = material.motions
    t_d_s, F = material.estimate.t_d_s, np.asarray(material.estimate.F)
    first_s, last_s = np.ceil(motion1.span_s[0]), motion1.span_s[1]
    starts_s = np.arange(first_s, last_s - LENGTH_S - T_D_S, 10.0 * TRACK_STEP_S)
    if len(starts_s) == 0:
        raise SimError(
            f"the recording has {last_s - first_s:.1f} s, the animation needs "
            f"{LENGTH_S + T_D_S:g}: simulate a longer one"
        )
    times_s = first_s + _steps(last_s - first_s)
    one, before, after = motion1.at(times_s), motion2.at(times_s), motion2.at(times_s + t_d_s)
    distances = epipolar_distance(F, one.positions_px, before.positions_px)
    seen = one.valid & before.valid & after.valid
    worth = np.where(seen, np.minimum(distances, _FAR_PX), 0.0)
    total = np.append(0.0, np.cumsum(worth))
    first, last = (np.searchsorted(times_s, starts_s + end_s) for end_s in (0.0, LENGTH_S))
    return float(starts_s[int(np.argmax(total[last] - total[first]))])


def _view(events: Events, start_s: float, length_s: float, track_px: Array) -> View:
    """Take the events of a stretch with its trail and windows, thinned to what an eye can tell."""
    ends_s = start_s - TRAIL_S, start_s + length_s + HALF_WINDOW_S
    stretch = slice_time(events, *(round(end_s * US_PER_S) for end_s in ends_s))
    # The last event of each pixel in each short time: an edge that passes makes several at once.
    moments = stretch["t"] // round(_MOMENT_S * US_PER_S)
    keys = (moments << 32) + (stretch["y"].astype(np.int64) << 16) + stretch["x"]
    _, last = np.unique(keys[::-1], return_index=True)
    stretch = stretch[np.sort(len(keys) - 1 - last)]
    stretch = stretch[:: 1 + len(stretch) // _MAX_EVENTS]
    return View(
        stretch["t"] / US_PER_S - start_s, stretch["x"], stretch["y"], stretch["p"] > 0, track_px
    )


def _plan(truth: dict[str, Any], start_s: float, length_s: float) -> Plan:
    """Look at the scene from above, for the drawing only: the estimate never sees the truth."""
    poses = [np.array(camera["T_C_W"]) for camera in truth["cameras"].values()][:2]
    seen_from_above = poses[0][[0, 2], :3]  # right of camera 1, and along its line of sight
    centres = [-pose[:3, :3].T @ pose[:3, 3] for pose in poses]
    times_s = start_s + _steps(length_s)
    positions = np.array(truth["drone_position_W_m"]) @ seen_from_above.T
    path = [np.interp(times_s, truth["times_s"], column) for column in positions.T]
    return Plan(
        np.array(centres) @ seen_from_above.T,
        np.array([pose[2, :3] for pose in poses]) @ seen_from_above.T,
        np.stack(path, axis=1),
    )


def _steps(length_s: float) -> Array:
    """Return the times of the object's positions, from 0 to the length, both included."""
    return np.arange(0.0, length_s + _END_S, TRACK_STEP_S, dtype=np.float64)


def _interpolated(track_px: Array, time_s: float) -> Array:
    """Position (2,) between the two samples around a time; NaN next to an invalid sample."""
    place = np.clip(time_s / TRACK_STEP_S, 0.0, len(track_px) - 1.0)
    before = min(int(place), len(track_px) - 2)
    part = place - before
    return np.asarray((1.0 - part) * track_px[before] + part * track_px[before + 1])
