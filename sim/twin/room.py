"""The room around the bench: its changing light, a hand's shadow, and the wire.

Their events are drawn apart from the drone's and added to them: neither occludes the other.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Float32Array, FloatArray
from sim.disturb import View, merged
from sim.errors import SimError, check_numbers
from sim.recording import Scene
from sim.scene.rig import Camera
from sim.seeds import generator
from sim.sensor.events import SensorConfig, slow_events
from sim.twin.bench import HEIGHT, SIZE_M
from sim.twin.pendulum import Hanging

FRAMES_HZ = 50.0  # rate at which slow light is sampled; linear in between
_BATCH = 25  # frames in memory
_WAVES = 5  # sines that add up to the changes of the light
_LIGHT_HZ = (0.05, 0.6)  # range of their frequencies: clouds, people who pass a window
_SHADOW_RADIUS_PX, _PENUMBRA_PX = 45.0, 18.0  # of the shadow of a hand far from the wall
# Row and column offset, above and beside the model at rest: the lamp is higher than the hand.
_SHADOW_OFF_PX = (-100.0, 60.0)
_WIRE_STEP_S = 2e-3
_WIRE_POINTS = 40  # along the wire, whose image a lens bends
_WIRE_CONTRAST = 0.8  # share of the wall's light that the wire blocks

# Branches of the seed, beside those of `sim.twin.bench`.
_LIGHT_STREAM, _SHADOW_STREAM, _WIRE_STREAM, _PHASE_STREAM = 40, 41, 42, 43


@dataclass(frozen=True)
class RoomConfig:
    """What a room does to a recording; nothing by default."""

    light_std: float = 0.0  # standard deviation of the logarithm of the slowly changing light
    shadow: float = 0.0  # share of the light that the shadow of a hand takes from the wall
    wire_m: float = 0.0  # thickness of the wire

    def __post_init__(self) -> None:
        check_numbers(self, "room: ", or_zero=("light_std", "wire_m"))
        if not 0.0 <= self.shadow < 1.0:
            raise SimError(f"room: shadow is a share, 0 to less than 1, got {self.shadow}")


def room_events(
    config: RoomConfig, scene: Scene, hanging: Hanging, sensor: SensorConfig, seed: int, index: int
) -> NDArray[Any]:
    """Draw the events that a room adds in one camera, in order of time, on the scene's clock.

    Of the sensor, thresholds, mismatch and `log_eps` count. Both cameras see the same light.
    """
    camera = scene.rig.cameras[index]
    view = View(camera.width, camera.height, scene.trajectory.duration_s)
    streams = []
    if config.light_std or config.shadow:
        frames = _frames(config, view, scene, hanging, seed, index)
        rngs = (generator(seed, _PHASE_STREAM, index, *pixels) for pixels in ((), (1,)))
        streams.append(slow_events(scene.backgrounds[index], frames, sensor, *rngs))
    if config.wire_m:
        rng = generator(seed, _WIRE_STREAM, index)
        streams.append(_wire(config, view, camera, hanging, sensor, rng))
    return merged(*streams)


def wire_contrast(config: RoomConfig, camera: Camera, depth_m: float) -> float:
    """Return the log luminance that a pixel loses where the wire, thinner than it, passes it."""
    share = min(1.0, config.wire_m * float(camera.K[0, 0]) / depth_m)
    return float(-np.log1p(-_WIRE_CONTRAST * share))


def _frames(
    config: RoomConfig, view: View, scene: Scene, hanging: Hanging, seed: int, index: int
) -> Iterator[tuple[FloatArray, Float32Array]]:
    """Yield batches of times (n,) [s] and images (n, height, width) of the lit, shadowed wall."""
    n = max(2, int(np.ceil(view.duration_s * FRAMES_HZ)))
    times_s: FloatArray = view.duration_s * np.arange(1, n + 1) / n
    gains = np.exp(_light(config.light_std, times_s, generator(seed, _LIGHT_STREAM)))
    # The hand is far out of view, where no lens model holds: project a point a wire's length below.
    first_s = np.zeros(1)
    wire_m = np.linalg.norm(scene.trajectory.position(first_s) - hanging.hand(first_s))
    held = hanging.hand(times_s) - np.array([0.0, 0.0, float(wire_m)])
    centres = scene.rig.cameras[index].project(held)
    side = generator(seed, _SHADOW_STREAM, index).choice((-1.0, 1.0))
    centres = centres + np.array([side * _SHADOW_OFF_PX[1], _SHADOW_OFF_PX[0]])
    rows, columns = np.indices((view.height, view.width), dtype=np.float32, sparse=True)
    gains, centres = gains.astype(np.float32), centres.astype(np.float32)
    wall = scene.backgrounds[index]
    for start in range(0, n, _BATCH):
        chunk = slice(start, start + _BATCH)
        u, v = (centres[chunk, k, None, None] for k in (0, 1))
        images = gains[chunk, None, None] * wall
        if config.shadow:
            far_px = np.hypot(columns - u, rows - v) - np.float32(_SHADOW_RADIUS_PX)
            edge = np.exp(far_px * np.float32(4.0 / _PENUMBRA_PX))
            images *= 1.0 - np.float32(config.shadow) / (1.0 + edge)
        yield times_s[chunk], np.clip(images, 0.0, 1.0, dtype=np.float32)


def _light(deviation: float, times_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return the logarithm (n,) of the light, a sum of slow sines that starts at 0."""
    low, high = (float(np.log(rate_hz)) for rate_hz in _LIGHT_HZ)
    rates_hz = np.exp(rng.uniform(low, high, _WAVES))
    phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    waves = np.sin(2.0 * np.pi * np.multiply.outer(times_s, rates_hz) + phases)
    changes: FloatArray = deviation * np.sqrt(2.0 / _WAVES) * (waves - np.sin(phases)).sum(axis=1)
    return changes


def _wire(
    config: RoomConfig,
    view: View,
    camera: Camera,
    hanging: Hanging,
    sensor: SensorConfig,
    rng: np.random.Generator,
) -> NDArray[Any]:
    """Draw the events of pixels that the wire enters (OFF) or leaves (ON), if contrast suffices."""
    n = max(2, int(np.ceil(view.duration_s / _WIRE_STEP_S)))
    times_s: FloatArray = np.linspace(0.0, view.duration_s, n + 1, dtype=np.float64)
    columns = wire_columns(camera, hanging, times_s, view.height)
    pixels = np.floor(columns + 0.5)
    with np.errstate(invalid="ignore"):
        k, rows = np.nonzero(np.abs(np.diff(pixels, axis=0)) > 0.0)
    first, last = columns[k, rows], columns[k + 1, rows]
    forward = last > first
    border = np.where(forward, pixels[k + 1, rows], pixels[k, rows]) - 0.5
    crossed_s = times_s[k] + (times_s[k + 1] - times_s[k]) * (border - first) / (last - first)
    middle_W = np.append(hanging.trajectory.position(times_s).mean(axis=0), 1.0)
    contrast = wire_contrast(config, camera, float((camera.T_C_W @ middle_W)[2]))
    streams = []
    for brighter, entered in ((False, pixels[k + 1, rows]), (True, pixels[k, rows])):
        threshold = sensor.threshold_on if brighter else sensor.threshold_off
        fires = rng.random(len(k)) < contrast / threshold  # from any memorised level
        streams.append(view.events(crossed_s[fires], entered[fires], rows[fires], brighter))
    return np.concatenate(streams)


def wire_columns(camera: Camera, hanging: Hanging, times_s: FloatArray, height: int) -> FloatArray:
    """Return the columns (n, height) [px] where the wire crosses each row of the view, or NaN."""
    hands = hanging.hand(times_s)
    tops = hanging.trajectory.position(times_s) - 0.5 * HEIGHT * SIZE_M * hanging.wire(times_s)
    shares = np.linspace(0.0, 1.0, _WIRE_POINTS)[:, None]
    rows = np.arange(height, dtype=np.float64)
    columns = np.full((len(times_s), height), np.nan)
    points = hands[:, None] + shares * (tops - hands)[:, None]
    images = camera.project(points.reshape(-1, 3)).reshape(*points.shape[:2], 2)
    for k, (u, v) in enumerate(images.transpose(0, 2, 1)):
        known = np.isfinite(v)
        u, v = u[known], v[known]
        if len(v) > 1 and (np.diff(v) > 0.0).all():  # downwards
            columns[k] = np.interp(rows, v, u, left=np.nan, right=np.nan)
    return columns
