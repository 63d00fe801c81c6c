"""How many frames of a moving drone the sensor model takes per second, and a peer's core.

The peers' simulators are on no package index that pip reaches: ESIM (esim_py), v2e, vid2e and IEBCS
all have to be built from their sources. eventify-dvs is; its core compares frames as theirs do, in
NumPy, without a memory of the last event. Where it is installed it is measured on the same frames.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.machine.measurement import Measurement, best_rate
from sim.render.renderer import Renderer
from sim.scene.background import uniform_background
from sim.scene.flyers import quadrotor
from sim.scene.rig import two_view_rig
from sim.sensor.events import Sensor, SensorConfig

PEER = "eventify-dvs"

ESIM_FRAMES_PER_S = 6600.0  # quoted, not measured here: ESIM's C++ core (esim_py) on 346 x 260
# frames, one core of a machine like ours

N_FRAMES = 1000
REPEATS = 3  # the best of as many is taken
OBJECT_SPEED_PX_S = 200.0
STEP_PX = 0.2  # between frames


def bench_sensor() -> list[Measurement]:
    """Frames and events per second of the sensor model, on full frames and on crops of them."""
    frames, times_s, x0, y0, crops = _moving_object()
    background = frames[0].copy()
    zero = np.zeros(len(times_s) - 1, np.int64)
    n_events = 0

    def run(x: Any, y: Any, luminance: Any) -> int:
        nonlocal n_events
        rng = np.random.default_rng(0)
        sensor = Sensor(SensorConfig(), frames[0], float(times_s[0]), rng, background)
        sensor.feed(times_s[1:], x, y, luminance)
        n_events = len(sensor.finish(float(times_s[-1])))
        return len(times_s) - 1

    full_per_s = best_rate(lambda: run(zero, zero, frames[1:]), REPEATS)
    events_per_frame = n_events / (len(times_s) - 1)
    crops_per_s = best_rate(lambda: run(x0[1:], y0[1:], crops[1:]), REPEATS)
    full = f"sensor, {frames.shape[2]} x {frames.shape[1]} float frames"
    return [
        Measurement(full, full_per_s, "frames/s"),
        Measurement(full, full_per_s * events_per_frame, "events/s"),
        *beside_peers(full_per_s, _peer_frames_per_s(frames, times_s)),
        Measurement("sensor, crops that follow the object", crops_per_s, "frames/s"),
        Measurement("sensor, crops: events", crops_per_s * events_per_frame, "events/s"),
        Measurement("sensor, crops / full frames", crops_per_s / full_per_s, "x"),
    ]


def beside_peers(ours_per_s: float, peer_per_s: float | None) -> list[Measurement]:
    """Compare full frames per second with a peer's core: measured, or quoted where it is None."""
    quoted = ours_per_s / ESIM_FRAMES_PER_S
    if peer_per_s is None:
        name = f"sensor over ESIM's core, quoted ({PEER} is not installed)"
        return [Measurement(name, quoted, "x", 1.0, True)]
    return [
        Measurement(f"sensor: {PEER} on the same frames", peer_per_s, "frames/s"),
        Measurement(f"sensor over {PEER}", ours_per_s / peer_per_s, "x", 1.0, True),
        Measurement("sensor over ESIM's core, quoted", quoted, "x"),
    ]


def _peer_frames_per_s(frames: NDArray[np.float32], times_s: NDArray[np.float64]) -> float | None:
    """Frames per second of the peer's core; None where it is not installed."""
    try:
        compare: Callable[..., Any] = import_module("eventify.dvs").frame_to_event_tuples
    except ImportError:
        return None
    config = SensorConfig()
    some, times_us = frames[: N_FRAMES // 4], np.rint(1e6 * times_s).astype(np.int64)

    def run() -> int:
        for k in range(len(some) - 1):
            compare(
                some[k],
                some[k + 1],
                int(times_us[k]),
                int(times_us[k + 1]),
                c_thresh=config.threshold_on,
                eps=config.log_eps,
            )
        return len(some) - 1

    return best_rate(run, REPEATS)


def _moving_object() -> tuple[NDArray[np.float32], NDArray[np.float64], Any, Any, Any]:
    """Return frames of the default drone at 200 px/s, their times, and crops of them."""
    rig = two_view_rig(90.0)
    camera, drone = rig.cameras[0], quadrotor()
    n = N_FRAMES
    step_s = STEP_PX / OBJECT_SPEED_PX_S
    times_s: NDArray[np.float64] = np.linspace(0.0, (n - 1) * step_s, n, dtype=np.float64)
    depth_m, focal_px = 5.0, float(camera.K[0, 0])
    T_W_B = np.tile(np.eye(4), (n, 1, 1))
    T_W_B[:, 0, 3] = (np.arange(n) - n / 2) * STEP_PX * depth_m / focal_px
    background = uniform_background(camera, 0.4)
    frames = np.repeat(background[None], n, axis=0)
    x0, y0 = np.zeros(n, np.int64), np.zeros(n, np.int64)
    with Renderer(drone) as renderer:
        batches = list(renderer.crops(camera, times_s, T_W_B, background))
    width = max(batch.luminance.shape[2] for batch in batches)
    height = max(batch.luminance.shape[1] for batch in batches)
    k = 0
    for batch in batches:
        h, w = batch.luminance.shape[1:]
        for x, y, luminance in zip(batch.x0_px, batch.y0_px, batch.luminance, strict=True):
            frames[k, y : y + h, x : x + w] = luminance
            x0[k], y0[k] = min(x, camera.width - width), min(y, camera.height - height)
            k += 1
    crops = np.stack([frames[k, y0[k] : y0[k] + height, x0[k] : x0[k] + width] for k in range(n)])
    return frames, times_s, x0, y0, crops
