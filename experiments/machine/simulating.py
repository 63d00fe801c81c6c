"""Poses per second of our renderers beside pyrender's, frames per second of the sensor model.

The peers' sensor simulators are on no package index that pip reaches: ESIM (esim_py), v2e, vid2e
and IEBCS all have to be built from their sources. eventify-dvs is; its core compares frames as
theirs do, in NumPy, without a memory of the last event. Where it is installed it is measured on the
same frames.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.machine.parts import Measurement, best_rate, peak_memory_mb
from sim.recording import SimConfig
from sim.render.config import RenderConfig
from sim.render.footprint import footprint, plan_views
from sim.render.gl_atlas import GLPainter
from sim.render.gl_reference import StockPyrender
from sim.render.lattice import Lattice
from sim.render.renderer import Renderer
from sim.scene.background import uniform_background
from sim.scene.flyers import quadrotor
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import SplineConfig, random_spline
from sim.sensor.events import Sensor, SensorConfig
from ssac.arrays import Array, IntArray

REPEATS = 3  # the best of as many is taken

NATIVE = "native"
LATTICES = (SimConfig().render.lattice, Lattice(8, 0), Lattice(8, 1), Lattice(4, 0))
N_POSES = 4000  # of our renderer
N_FULL_FRAMES = 24  # of pyrender's, on poses spread over the same flight

PEER = "eventify-dvs"
ESIM_FRAMES_PER_S = 6600.0  # quoted, not measured here: ESIM's C++ core (esim_py) on 346 x 260
# frames, one core of a machine like ours
N_FRAMES = 1000
OBJECT_SPEED_PX_S = 200.0
STEP_PX = 0.2  # between frames


def bench_render(by: str) -> list[Measurement]:
    """Poses per second of our crops and of pyrender's full frames, with the same samples.

    "Pyrender, our shaders" is pyrender's meshes and programs drawing the same pixels into a buffer
    of one channel; "untouched" is pyrender as it comes, which draws 8-bit colour and reads its
    depth back as well. Of the native renderer also the ratio to our own crops by OpenGL.

    Both are drawn by "native", or by an OpenGL backend.
    """
    camera, drone = two_view_rig(90.0).cameras[0], quadrotor()
    flight = random_spline(SplineConfig(), np.random.default_rng(0))
    # As dense as adaptive sampling is, for neighbours to share their tile size as they do there.
    times_s: Array = np.linspace(0.0, 5.0, N_POSES, dtype=np.float64)
    T_W_B = flight.poses(times_s)
    background = uniform_background(camera, 0.4)
    some: IntArray = np.arange(0, N_POSES, N_POSES // N_FULL_FRAMES, dtype=np.int64)
    seen = footprint(drone, camera, times_s, T_W_B)
    whole = plan_views(drone, camera, seen, some, times_s, T_W_B).of_whole_images(camera)

    def crops(renderer: Renderer) -> int:
        batches = renderer.crops(camera, times_s, T_W_B, background)
        return sum(len(batch.times_s) for batch in batches)

    def crops_per_s(config: RenderConfig) -> float:
        with Renderer(drone, config) as renderer:
            return best_rate(partial(crops, renderer), REPEATS)

    def frames(painter: GLPainter) -> int:
        for k in range(len(some)):
            painter.paint(camera, whole.chosen(slice(k, k + 1)), whole.boxes[:1, :2], background)
        return len(some)

    def untouched(stock: StockPyrender) -> int:
        for k in some:
            stock.covered(float(times_s[k]), T_W_B[k])
        return len(some)

    rows = []
    for lattice in LATTICES:
        with_gl = RenderConfig(lattice, renderer="pyrender", backend="auto" if by == NATIVE else by)
        native = replace(with_gl, renderer=NATIVE, check=False)
        ours_per_s = crops_per_s(native if by == NATIVE else with_gl)
        painter = GLPainter(drone, with_gl)
        theirs_per_s = best_rate(partial(frames, painter), REPEATS)
        painter.close()
        label = f"render, {by}, {lattice.samples_per_pixel} samples per pixel"
        rows += [
            Measurement(f"{label}: crops", ours_per_s, "poses/s"),
            Measurement(f"{label}: pyrender, our shaders", theirs_per_s, "poses/s"),
            Measurement(f"{label}: ratio", ours_per_s / theirs_per_s, "x", 50.0, True),
        ]
        if by == NATIVE:
            ratio = ours_per_s / crops_per_s(with_gl)
            rows.append(Measurement(f"{label}: ratio to OpenGL's crops", ratio, "x", 4.0, True))
        if lattice.b == 0:  # pyrender itself knows regular grids only
            stock = StockPyrender(drone, camera, lattice.a, with_gl.backend)
            untouched_per_s = best_rate(partial(untouched, stock), REPEATS)
            rows += [
                Measurement(f"{label}: pyrender untouched", untouched_per_s, "poses/s"),
                Measurement(f"{label}: ratio to it", ours_per_s / untouched_per_s, "x", 50.0, True),
            ]
        if lattice == SimConfig().render.lattice:
            rows.append(Measurement(f"{label}: peak memory", peak_memory_mb(), "MB"))
    return rows


def bench_sensor() -> list[Measurement]:
    """Frames and events per second of the sensor model, on full frames and on crops of them."""
    frames, times_s, x0, y0, crops = _moving_object()
    background = frames[0].copy()
    n_frames, n_events = len(times_s) - 1, 0

    def run(x: Any, y: Any, luminance: Any) -> int:
        nonlocal n_events
        rng = np.random.default_rng(0)
        sensor = Sensor(SensorConfig(), frames[0], float(times_s[0]), rng, background)
        sensor.feed(times_s[1:], x, y, luminance)
        n_events = len(sensor.finish(float(times_s[-1])))
        return n_frames

    zero = np.zeros(n_frames, np.int64)
    full_per_s = best_rate(partial(run, zero, zero, frames[1:]), REPEATS)
    events_per_frame = n_events / n_frames
    crops_per_s = best_rate(partial(run, x0[1:], y0[1:], crops[1:]), REPEATS)
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


def _peer_frames_per_s(frames: NDArray[np.float32], times_s: Array) -> float | None:
    """Frames per second of the peer's core; None where it is not installed."""
    try:
        compare: Callable[..., Any] = import_module("eventify.dvs").frame_to_event_tuples
    except ImportError:
        return None
    config = SensorConfig()
    thresholds = {"c_thresh": config.threshold_on, "eps": config.log_eps}
    some, times_us = frames[: N_FRAMES // 4], np.rint(1e6 * times_s).astype(np.int64).tolist()

    def run() -> int:
        for k in range(len(some) - 1):
            compare(some[k], some[k + 1], times_us[k], times_us[k + 1], **thresholds)
        return len(some) - 1

    return best_rate(run, REPEATS)


def _moving_object() -> tuple[NDArray[np.float32], Array, Any, Any, Any]:
    """Return frames of the default drone at 200 px/s, their times, and crops of them."""
    camera, n = two_view_rig(90.0).cameras[0], N_FRAMES
    step_s, depth_m = STEP_PX / OBJECT_SPEED_PX_S, 5.0
    times_s: Array = np.linspace(0.0, (n - 1) * step_s, n, dtype=np.float64)
    T_W_B = np.tile(np.eye(4), (n, 1, 1))
    T_W_B[:, 0, 3] = (np.arange(n) - n / 2) * STEP_PX * depth_m / float(camera.K[0, 0])
    background = uniform_background(camera, 0.4)
    with Renderer(quadrotor()) as renderer:
        batches = list(renderer.crops(camera, times_s, T_W_B, background))
    height, width = np.max([batch.luminance.shape[1:] for batch in batches], axis=0)
    frames = np.repeat(background[None], n, axis=0)
    x0: list[int] = []
    y0: list[int] = []
    crops: list[NDArray[np.float32]] = []
    for batch in batches:
        h, w = batch.luminance.shape[1:]
        for x, y, luminance in zip(batch.x0_px, batch.y0_px, batch.luminance, strict=True):
            frame = frames[len(crops)]
            frame[y : y + h, x : x + w] = luminance
            x0.append(min(x, camera.width - width))
            y0.append(min(y, camera.height - height))
            crops.append(frame[y0[-1] : y0[-1] + height, x0[-1] : x0[-1] + width])
    return frames, times_s, np.array(x0, np.int64), np.array(y0, np.int64), np.stack(crops)
