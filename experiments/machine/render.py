"""Poses per second of our renderers, beside pyrender's full frames of the same poses."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from experiments.machine.measurement import Measurement, best_rate, peak_memory_mb
from sim.recording import SimConfig
from sim.render.config import RenderConfig
from sim.render.gl_reference import PyrenderFullFrame
from sim.render.lattice import Lattice
from sim.render.renderer import Renderer
from sim.scene.background import uniform_background
from sim.scene.flyers import quadrotor
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import SplineConfig, random_spline

NATIVE = "native"
LATTICES = (SimConfig().render.lattice, Lattice(8, 0), Lattice(8, 1), Lattice(4, 0))
REPEATS = 3  # the best of as many is taken
N_POSES = 4000  # of our renderer
N_FULL_FRAMES = 24  # of pyrender's, on poses spread over the same flight


def bench_render(by: str) -> list[Measurement]:
    """Poses per second of our crops and of pyrender's full frames, with the same samples.

    "Pyrender, our shaders" is pyrender's renderer drawing the same pixels into a framebuffer of one
    channel; "untouched" is pyrender as it comes, which draws 8-bit colour and reads its depth back
    as well. Of the native renderer also the ratio to our own crops by OpenGL.

    Both are drawn by "native", or by an OpenGL backend.
    """
    rig = two_view_rig(90.0)
    camera, drone = rig.cameras[0], quadrotor()
    flight = random_spline(SplineConfig(), np.random.default_rng(0))
    # As dense as adaptive sampling is, for neighbours to share their tile size as they do there.
    times_s: NDArray[np.float64] = np.linspace(0.0, 5.0, N_POSES, dtype=np.float64)
    T_W_B = flight.poses(times_s)
    background = uniform_background(camera, 0.4)
    some = range(0, N_POSES, N_POSES // N_FULL_FRAMES)

    def crops_per_s(config: RenderConfig) -> float:
        with Renderer(drone, config) as renderer:

            def crops() -> int:
                batches = renderer.crops(camera, times_s, T_W_B, background)
                return sum(len(batch.times_s) for batch in batches)

            return best_rate(crops, REPEATS)

    rows = []
    for lattice in LATTICES:
        with_gl = RenderConfig(lattice, renderer="pyrender", backend="auto" if by == NATIVE else by)
        native = replace(with_gl, renderer=NATIVE, check=False)
        ours_per_s = crops_per_s(native if by == NATIVE else with_gl)
        reference = PyrenderFullFrame(drone, camera, with_gl)

        def theirs(reference: PyrenderFullFrame = reference) -> int:
            for k in some:
                reference.render(float(times_s[k]), T_W_B[k], background)
            return len(some)

        def untouched(reference: PyrenderFullFrame = reference) -> int:
            for k in some:
                reference.stock(float(times_s[k]), T_W_B[k])
            return len(some)

        theirs_per_s = best_rate(theirs, REPEATS)
        label = f"render, {by}, {lattice.samples_per_pixel} samples per pixel"
        is_default = lattice == SimConfig().render.lattice
        rows += [
            Measurement(f"{label}: crops", ours_per_s, "poses/s"),
            Measurement(f"{label}: pyrender, our shaders", theirs_per_s, "poses/s"),
            Measurement(f"{label}: ratio", ours_per_s / theirs_per_s, "x", 50.0, True),
        ]
        if by == NATIVE:
            ratio = ours_per_s / crops_per_s(with_gl)
            rows.append(Measurement(f"{label}: ratio to OpenGL's crops", ratio, "x", 4.0, True))
        if lattice.b == 0:  # pyrender itself knows regular grids only
            untouched_per_s = best_rate(untouched, REPEATS)
            rows += [
                Measurement(f"{label}: pyrender untouched", untouched_per_s, "poses/s"),
                Measurement(f"{label}: ratio to it", ours_per_s / untouched_per_s, "x", 50.0, True),
            ]
        if is_default:
            rows.append(Measurement(f"{label}: peak memory", peak_memory_mb(), "MB"))
    return rows
