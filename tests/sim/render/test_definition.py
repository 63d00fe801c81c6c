import ctypes.util
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sim.render.gl_context
from sim.errors import SimError
from sim.render.config import RenderConfig
from sim.render.footprint import footprint
from sim.render.gl_reference import PyrenderFullFrame
from sim.render.lattice import Lattice
from sim.scene.drone import Drone
from tests.sim.render.drawing import BOX, BRIGHT, HALF_VGA, QUADROTOR, full_frames, rendered
from tests.sim.scenes import LENSES, Image, grey, make_camera, noise_image, painted, poses, tumbling

pytestmark = pytest.mark.render

# --- The same pixels as pyrender ---------------------------------------------------------------


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("lattice", [Lattice(4, 0), Lattice(6, 1), Lattice(9, 1)], ids=repr)
@pytest.mark.parametrize("drone", [BOX, painted(QUADROTOR, 0.2)], ids=["box", "quadrotor"])
def test_same_pixels_as_pyrenders_full_frame(drone: Drone, lattice: Lattice, lens: str) -> None:
    camera = make_camera(lens, HALF_VGA)
    n = 12
    times_s = np.linspace(0.0, 1.0, n)
    T_W_B = tumbling(n, 3, (0.0, -1.0, 0.0), (1.5, 2.0, 1.0))
    # The box is shaded; the quadrotor's rotors spin.
    config = RenderConfig(lattice, ambient=0.3 if drone is BOX else 1.0)
    background = noise_image(camera)
    crops = rendered(drone, camera, times_s, T_W_B, background, config)
    np.testing.assert_array_equal(
        crops, full_frames(drone, camera, times_s, T_W_B, background, config)
    )
    assert (crops != background).any(axis=(1, 2)).all()


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("lattice", [Lattice(4, 0), Lattice(6, 1)], ids=repr)
def test_same_pixels_where_the_image_ends(lattice: Lattice, lens: str) -> None:
    camera = make_camera(lens, HALF_VGA)
    side = np.array([-1.0, 1.0])
    x_m, z_m = np.meshgrid(1.6 * side, 1.2 * side)
    centres_m = np.stack([x_m.ravel(), np.full(4, -3.1), z_m.ravel()], axis=-1)
    T_W_B = poses(np.concatenate([centres_m * [1, 1, 0.2], centres_m * [0.3, 1, 1]]), seed=2)
    times_s = np.arange(8.0)
    seen = footprint(BOX, camera, times_s, T_W_B)
    edge = np.array(HALF_VGA) - 0.5
    assert ((seen.low_px < -0.5) | (seen.high_px > edge)).any(axis=1).sum() >= 6
    background = noise_image(camera)
    config = replace(BRIGHT, lattice=lattice)
    crops = rendered(BOX, camera, times_s, T_W_B, background, config)
    differences = crops != full_frames(BOX, camera, times_s, T_W_B, background, config)
    # Cutting an edge off at the tile's border makes a new corner, which the rasteriser rounds to
    # 1/256 of a sample: very seldom a sample beside the edge changes sides.
    assert differences.sum() <= 1


def test_parts_that_cut_into_each_other_differ_in_a_few_samples() -> None:
    camera = make_camera(resolution=HALF_VGA)
    times_s = np.linspace(0.0, 1.0, 30)
    T_W_B = tumbling(30, 4, (0.0, -2.0, 0.0), (0.7, 1.0, 0.7))
    background = grey(camera)
    config = RenderConfig(Lattice(8, 1))
    crops = rendered(QUADROTOR, camera, times_s, T_W_B, background, config)
    difference = np.abs(crops - full_frames(QUADROTOR, camera, times_s, T_W_B, background, config))
    # Depths are rounded to 24 bits: where surfaces cross, a sample in some 10^5 sees the other one.
    assert (difference > 0).sum() <= 3
    assert difference.max() <= 0.42 / 65 * 2  # two samples from the brightest part to black


@pytest.mark.parametrize("a", [1, 4, 8])
def test_silhouette_of_pyrenders_own_shaders(a: int) -> None:
    """No line of the stock renderer's projection or scene is ours."""
    camera = make_camera()
    drone = painted(QUADROTOR, 1.0)
    config = RenderConfig(Lattice(a, 0), ambient=1.0)
    reference = PyrenderFullFrame(drone, camera, config)
    T_W_B = tumbling(6, 5, (0.0, 0.0, 0.0), (3.0, 2.0, 2.0))
    times_s = np.linspace(0.0, 1.0, 6)
    nothing = grey(camera, 0.0)
    ours = rendered(drone, camera, times_s, T_W_B, nothing, config)
    stock = np.stack([reference.stock(t, T) for t, T in zip(times_s, T_W_B, strict=True)])
    coverage = stock.reshape(6, camera.height, a, camera.width, a).mean(axis=(2, 4))
    assert coverage.sum() > 300  # px
    differing_samples = np.rint(np.abs(ours - coverage) * a**2).sum()
    # Projections in another order of operations: float32 rounds the odd edge to the other side.
    assert differing_samples <= 2 + 1e-4 * stock.sum()


def test_the_stock_renderer_knows_neither_lenses_nor_turned_lattices() -> None:
    reference = PyrenderFullFrame(BOX, make_camera("radtan"), RenderConfig(Lattice(4, 0)))
    with pytest.raises(SimError, match="undistorted images on a regular grid only"):
        reference.stock(0.0, np.eye(4))


# --- The other backend -------------------------------------------------------------------------

COMPARED = (Lattice(6, 1), "radtan")
OTHER_BACKEND = """
import sys
import numpy as np
from tests.sim.render.test_definition import images_to_compare
from sim.render.gl_context import open_context
assert open_context(sys.argv[1]).backend == sys.argv[1]
np.save(sys.argv[2], images_to_compare())
"""


def images_to_compare() -> Image:
    lattice, lens = COMPARED
    camera = make_camera(lens, HALF_VGA)
    T_W_B = tumbling(20, 7, (0.0, -1.0, 0.0), (2.5, 2.0, 1.5))
    times_s = np.linspace(0.0, 1.0, 20)
    return rendered(QUADROTOR, camera, times_s, T_W_B, noise_image(camera), RenderConfig(lattice))


def other_backend() -> str:
    used = sim.render.gl_context.open_context().backend
    other, library = {"osmesa": ("egl", "EGL"), "egl": ("osmesa", "OSMesa")}[used]
    if not ctypes.util.find_library(library):
        pytest.skip(f"this machine has no {library}")
    return other


def run_with(backend: str, *arguments: str) -> None:
    environment = os.environ | {"PYOPENGL_PLATFORM": backend}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_both_backends_agree_but_for_a_few_edge_pixels(tmp_path: Path) -> None:
    backend = other_backend()
    path = tmp_path / "images.npy"
    run_with(backend, "-c", OTHER_BACKEND, backend, str(path))
    ours, theirs = images_to_compare(), np.load(path)
    # The same rasteriser, compiled for another framebuffer: a sample in some 10^4 may differ.
    assert np.count_nonzero(ours != theirs) <= 5
    assert np.abs(ours - theirs).max() <= 2 / 37


def test_the_other_backend_keeps_the_same_laws() -> None:
    chosen = "same_pixels or silhouette"
    run_with(
        other_backend(), "-m", "pytest", "-q", "-p", "no:cacheprovider", __file__, "-k", chosen
    )
