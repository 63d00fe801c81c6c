"""What the report's player draws, packed as JSON, and still pictures of the same.

The player needs JavaScript; the stills, before and after, take its place without, and in print.
"""

import base64
import json
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from experiments.report.animation import (
    HALF_WINDOW_S,
    LENGTH_S,
    T_D_S,
    TRACK_STEP_S,
    TRAIL_S,
    Animation,
    View,
)
from sim.errors import SimError
from ssac.geometry.epipolar import epipolar_lines_1

Array = NDArray[np.float64]

# Of camera 1 and camera 2 (brighter, darker): legible on light and dark ground, apart in grey and
# for colour-blind people. The page's style and the player use the same two hues.
CAMERA_RGB = (((74, 151, 224), (36, 100, 176)), ((242, 166, 60), (198, 112, 20)))

_FADED, _FADE_S = 0.42, 0.13  # opacity of an event past its window, and when it falls to 1/e
_TIME_BITS, _POLARITY_BIT, _Y_BIT = 13, 18, 9  # of an event's 32 bits: time, polarity, y (9), x (9)


def player_json(animation: Animation) -> str:
    """All that the player draws, as JSON that is safe inside a script element."""
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
        "top": round(curve_top_px(animation), 3),
        "curve": _rounded(animation.curve_px, 3),
        "views": [_packed_view(animation, view) for view in animation.views],
        "plan": {
            "cameras": _rounded(plan.cameras_m, 3),
            "sights": _rounded(plan.sights, 4),
            "path": _rounded(plan.path_m, 3),
        },
        "colors": CAMERA_RGB,
    }
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def packed_events(view: View, end_s: float) -> bytes:
    """Pack a view's events to 32 bits each, little-endian: 13 of time, 1 of polarity, 9 of y and x.

    The time counts 1 / 8192 of the view's length, from the start of its first trail to the end of
    its last window.
    """
    share = (view.times_s + TRAIL_S) / (TRAIL_S + end_s + HALF_WINDOW_S)
    # An event on either end may be beyond it by a rounding.
    ticks = np.clip(np.floor(share * (1 << _TIME_BITS)), 0, (1 << _TIME_BITS) - 1).astype(np.uint32)
    packed = (
        ticks << np.uint32(_POLARITY_BIT + 1)
        | view.brighter.astype(np.uint32) << np.uint32(_POLARITY_BIT)
        | view.y_px.astype(np.uint32) << np.uint32(_Y_BIT)
        | view.x_px.astype(np.uint32)
    )
    return bytes(packed.astype("<u4"))


class StillView(NamedTuple):
    """One camera's view at an instant, as SVG draws it."""

    png: bytes  # its events
    line: Array  # (4,) ends of the epipolar line, x1 y1 x2 y2 [px]
    gap: Array  # (4,) from the object's position to the line [px]


class Still(NamedTuple):
    """Both views at one instant, with one offset between the clocks."""

    name: str
    time_s: float  # camera 1's clock
    offset_s: float
    distance_px: float  # of the drone off its epipolar line in camera 1
    views: tuple[StillView, ...]


def stills(animation: Animation) -> list[Still]:
    """Both views at one instant, before and after."""
    time_s = animation.telling_time_s
    return [
        Still(
            name,
            animation.start_s + time_s,
            offset_s,
            animation.distance_px(time_s, offset_s),
            (
                still_view(animation, 0, time_s, offset_s),
                still_view(animation, 1, time_s, offset_s),
            ),
        )
        for name, offset_s in (("Clocks as recorded", 0.0), ("Synchronised", animation.t_d_s))
    ]


def still_view(animation: Animation, camera: int, time_s: float, offset_s: float) -> StillView:
    """One camera's view at an instant of camera 1's clock: events, the line, and the distance."""
    points = animation.at(time_s, offset_s)
    F = animation.F if camera == 0 else animation.F.T
    line = epipolar_lines_1(F, points[1 - camera])
    point = points[camera]
    foot = point - (line[:2] @ point + line[2]) / (line[:2] @ line[:2]) * line[:2]
    along = np.array([-line[1], line[0]]) / np.hypot(*line[:2]) * 2.0 * animation.width
    png = cv2.imencode(".png", event_image(animation, camera, time_s + camera * offset_s))[1]
    ends = np.concatenate([foot - along, foot + along])
    return StillView(png.tobytes(), ends, np.concatenate([point, foot]))


def event_image(animation: Animation, camera: int, time_s: float) -> NDArray[np.uint8]:
    """Draw one camera's newest event of each pixel, BGRA (height, width, 4), older ones fainter."""
    view = animation.views[camera]
    first, last = np.searchsorted(view.times_s, [time_s - TRAIL_S, time_s + HALF_WINDOW_S])
    past_s = time_s - HALF_WINDOW_S - view.times_s[first:last]  # since the event left the window
    opacity = np.where(past_s <= 0.0, 1.0, _FADED * np.exp(-past_s / _FADE_S))
    brighter, darker = (np.array(color[::-1]) for color in CAMERA_RGB[camera])
    colors = np.where(view.brighter[first:last, None], brighter, darker)
    image = np.zeros((animation.height, animation.width, 4), np.uint8)
    # Ascending in time, so that the last event of a pixel is the one that stays.
    for y, x, color, alpha in zip(
        view.y_px[first:last], view.x_px[first:last], colors, opacity, strict=True
    ):
        image[y, x] = (*color, round(255.0 * alpha))
    return image


def curve_points(animation: Animation) -> str:
    """Return the d_avg curve as points of an SVG polyline in a box of 1000 x 1000."""
    x = 1000.0 * animation.offsets_s / animation.offsets_s[-1]
    y = 1000.0 * (1.0 - animation.curve_px / curve_top_px(animation))
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True) if np.isfinite(b))


def curve_top_px(animation: Animation) -> float:
    """Return d_avg [px] at the upper edge of the curve's box."""
    return float(1.08 * np.nanmax(animation.curve_px))


def _packed_view(animation: Animation, view: View) -> dict[str, Any]:
    end_s = TRACK_STEP_S * (len(view.track_px) - 1)
    if max(animation.width, animation.height) > 1 << _Y_BIT:
        raise SimError(
            f"the animation takes images of at most {1 << _Y_BIT} px, got "
            f"{animation.width} x {animation.height}: simulate a smaller one"
        )
    return {
        "end": end_s,
        "track": _rounded(view.track_px, 2),
        "events": base64.b64encode(packed_events(view, end_s)).decode("ascii"),
    }


def _rounded(values: Array, digits: int) -> list[Any]:
    """Nested lists of rounded numbers, with null where there is none."""
    rounded = np.round(values, digits).astype(object)
    rounded[~np.isfinite(values)] = None
    result: list[Any] = rounded.tolist()
    return result
