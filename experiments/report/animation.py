"""A few seconds of two event streams before and after synchronisation, to be animated.

Camera 2's clock is set ahead by a known offset; the offset and F are estimated as for any
recording. What is kept: thinned events, the object's positions, d_avg over offsets. The player
needs JavaScript; still pictures, before and after, take its place without, and in print.
"""

import base64
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from experiments.lab.score import Score, score
from sim.errors import SimError
from ssac.config import Config
from ssac.events import US_PER_S, slice_time
from ssac.geometry.epipolar import epipolar_distance, epipolar_lines_1
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

# Of camera 1 and camera 2 (brighter, darker): legible on light and dark ground, apart in grey and
# for colour-blind people. The page's style and the player use the same two hues.
CAMERA_RGB = (((74, 151, 224), (36, 100, 176)), ((242, 166, 60), (198, 112, 20)))

_OFFSET_STEP_S = 0.005
_MAX_EVENTS = 150_000  # per camera: 0.8 MB of the page
_MOMENT_S = 0.01
_FAR_PX = 60.0  # farther off the line than this tells no more
_END_S = 1e-6  # makes a range include its end
_FADED, _FADE_S = 0.42, 0.13  # opacity of an event past its window, and when it falls to 1/e
_TIME_BITS, _POLARITY_BIT, _Y_BIT = 13, 18, 9  # of an event's 32 bits: time, polarity, y (9), x (9)


@dataclass(frozen=True)
class View:
    """One camera's part: its own clock, in seconds since the start of the stretch."""

    times_s: Array  # (n,) of events, ascending
    events: Events  # (n,)
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
    def top_px(self) -> float:
        """d_avg [px] at the upper edge of the curve's box."""
        return float(1.08 * np.nanmax(self.curve_px))

    @property
    def curve_points(self) -> str:
        """The d_avg curve as points of an SVG polyline in a box of 1000 x 1000."""
        x = 1000.0 * self.offsets_s / self.offsets_s[-1]
        y = 1000.0 * (1.0 - self.curve_px / self.top_px)
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True) if np.isfinite(b))

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
    lengths_s = LENGTH_S, LENGTH_S + 2.0 * T_D_S
    views = []
    for k, (motion, length_s) in enumerate(zip(material.motions, lengths_s, strict=True)):
        track = motion.at(start_s + _steps(length_s))
        track_px = np.where(track.valid[:, None], track.positions_px, np.nan)
        views.append(_view(chain.recorded(k).events, start_s, length_s, track_px))
    return Animation(
        one.camera.width,
        one.camera.height,
        start_s,
        estimate.t_d_s,
        estimate.F,
        score(estimate, T_D_S, np.array(truth["R"]), np.array(truth["t"])),
        estimate.n_samples,
        offsets_s,
        d_avg_px(material, offsets_s),
        (views[0], views[1]),
        _plan(truth, start_s - T_D_S, lengths_s[1]),
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
    return View(stretch["t"] / US_PER_S - start_s, stretch, track_px)


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


def player_json(animation: Animation) -> str:
    """All that the player draws, as JSON that is safe inside a script element."""
    if max(animation.width, animation.height) > 1 << _Y_BIT:
        raise SimError(
            f"the animation takes images of at most {1 << _Y_BIT} px, got "
            f"{animation.width} x {animation.height}: simulate a smaller one"
        )
    plan = animation.plan
    content = {
        "width": animation.width,
        "height": animation.height,
        "start": round(animation.start_s, 6),
        "length": LENGTH_S,
        "trail": TRAIL_S,
        "window": HALF_WINDOW_S,
        "faded": _FADED,
        "fade": _FADE_S,
        "step": TRACK_STEP_S,
        "still": animation.telling_time_s,
        "found": round(animation.t_d_s, 6),
        "true": T_D_S,
        "F": [[float(f"{value:.9g}") for value in row] for row in animation.F],
        "offsets": _rounded(animation.offsets_s, 6),
        "top": round(animation.top_px, 3),
        "curve": _rounded(animation.curve_px, 3),
        "views": [
            {
                "end": TRACK_STEP_S * (len(view.track_px) - 1),
                "track": _rounded(view.track_px, 2),
                "events": base64.b64encode(packed_events(view)).decode("ascii"),
            }
            for view in animation.views
        ],
        "plan": {
            "cameras": _rounded(plan.cameras_m, 3),
            "sights": _rounded(plan.sights, 4),
            "path": _rounded(plan.path_m, 3),
        },
        "colors": CAMERA_RGB,
    }
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def packed_events(view: View) -> bytes:
    """Pack a view's events to 32 bits each, little-endian: 13 of time, 1 of polarity, 9 of y and x.

    The time counts 1 / 8192 of the view's length, from the start of its first trail to the end of
    its last window.
    """
    end_s = TRACK_STEP_S * (len(view.track_px) - 1)
    share = (view.times_s + TRAIL_S) / (TRAIL_S + end_s + HALF_WINDOW_S)
    # An event on either end may be beyond it by a rounding.
    ticks = np.clip(np.floor(share * (1 << _TIME_BITS)), 0, (1 << _TIME_BITS) - 1).astype(np.uint32)
    packed = (
        ticks << np.uint32(_POLARITY_BIT + 1)
        | (view.events["p"] > 0).astype(np.uint32) << np.uint32(_POLARITY_BIT)
        | view.events["y"].astype(np.uint32) << np.uint32(_Y_BIT)
        | view.events["x"].astype(np.uint32)
    )
    return bytes(packed.astype("<u4"))


def stills(animation: Animation) -> list[dict[str, Any]]:
    """Both views at one instant, before and after: with each offset between the clocks."""
    time_s = animation.telling_time_s
    return [
        {
            "name": name,
            "time_s": animation.start_s + time_s,  # camera 1's clock
            "offset_s": offset_s,
            "distance_px": animation.distance_px(time_s, offset_s),
            "views": [still_view(animation, camera, time_s, offset_s) for camera in (0, 1)],
        }
        for name, offset_s in (("Clocks as recorded", 0.0), ("Synchronised", animation.t_d_s))
    ]


def still_view(
    animation: Animation, camera: int, time_s: float, offset_s: float
) -> tuple[bytes, Array, Array]:
    """One camera's view at an instant of camera 1's clock.

    Its events as a PNG; ends of the epipolar line, and of the gap from the object's position to the
    line, (4,) each: x1 y1 x2 y2 [px].
    """
    points = animation.at(time_s, offset_s)
    line = epipolar_lines_1(animation.F.T if camera else animation.F, points[1 - camera])
    point = points[camera]
    foot = point - (line[:2] @ point + line[2]) / (line[:2] @ line[:2]) * line[:2]
    along = np.array([-line[1], line[0]]) / np.hypot(*line[:2]) * 2.0 * animation.width
    png = cv2.imencode(".png", event_image(animation, camera, time_s + camera * offset_s))[1]
    gap = np.concatenate([point, foot])
    return png.tobytes(), np.concatenate([foot - along, foot + along]), gap


def event_image(animation: Animation, camera: int, time_s: float) -> NDArray[np.uint8]:
    """Draw one camera's newest event of each pixel, BGRA (height, width, 4), older ones fainter."""
    view = animation.views[camera]
    shown = slice(*np.searchsorted(view.times_s, [time_s - TRAIL_S, time_s + HALF_WINDOW_S]))
    events = view.events[shown]
    past_s = time_s - HALF_WINDOW_S - view.times_s[shown]  # since the event left the window
    opacity = np.where(past_s <= 0.0, 1.0, _FADED * np.exp(-past_s / _FADE_S))
    brighter, darker = (np.array(color[::-1]) for color in CAMERA_RGB[camera])
    colors = np.where(events["p"][:, None] > 0, brighter, darker)
    image = np.zeros((animation.height, animation.width, 4), np.uint8)
    # Ascending in time, so that the last event of a pixel is the one that stays.
    for y, x, color, alpha in zip(events["y"], events["x"], colors, opacity, strict=True):
        image[y, x] = (*color, round(255.0 * alpha))
    return image


def _rounded(values: Array, digits: int) -> list[Any]:
    """Nested lists of rounded numbers, with null where there is none."""
    rounded = np.round(values, digits).astype(object)
    rounded[~np.isfinite(values)] = None
    result: list[Any] = rounded.tolist()
    return result
