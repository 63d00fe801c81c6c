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
from sim.render.gl_context import BACKENDS, open_context
from sim.render.lattice import Lattice
from sim.scene.drone import Drone
from tests.sim.render.drawing import BOX, BRIGHT, HALF_VGA, QUADROTOR, full_frames, rendered
from tests.sim.render.stock_pyrender import StockPyrender
from tests.sim.scenes import LENSES, Image, grey, make_camera, noise_image, painted, poses, tumbling


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("lattice", [Lattice(4, 0), Lattice(6, 1), Lattice(9, 1)], ids=repr)
@pytest.mark.parametrize("drone", [BOX, painted(QUADROTOR, 0.2)], ids=["box", "quadrotor"])
@pytest.mark.render
def test_same_pixels_as_in_a_full_frame(drone: Drone, lattice: Lattice, lens: str) -> None:
    camera = make_camera(lens, HALF_VGA)
    times_s = np.linspace(0.0, 1.0, 12)
    T_W_B = tumbling(12, 3, (0.0, -1.0, 0.0), (1.5, 2.0, 1.0))
    # The box is shaded; the quadrotor's rotors spin.
    config = RenderConfig(lattice, ambient=0.3 if drone is BOX else 1.0)
    background = noise_image(camera)
    scene = (drone, camera, times_s, T_W_B, background, config)
    crops = rendered(*scene)
    np.testing.assert_array_equal(crops, full_frames(*scene))
    assert (crops != background).any(axis=(1, 2)).all()


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("lattice", [Lattice(4, 0), Lattice(6, 1)], ids=repr)
@pytest.mark.render
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
    scene = (BOX, camera, times_s, T_W_B, background, replace(BRIGHT, lattice=lattice))
    differences = rendered(*scene) != full_frames(*scene)
    # Cutting an edge off at the tile's border makes a new corner, which the rasteriser rounds to
    # 1/256 of a sample: very seldom a sample beside the edge changes sides.
    assert differences.sum() <= 1


@pytest.mark.parametrize("a", [1, 8])
@pytest.mark.render
def test_silhouette_of_pyrenders_own_shaders(a: int) -> None:
    """No line of the stock renderer's projection or scene is ours."""
    camera = make_camera()
    drone = painted(QUADROTOR, 1.0)
    config = RenderConfig(Lattice(a, 0), ambient=1.0)
    T_W_B = tumbling(6, 5, (0.0, 0.0, 0.0), (3.0, 2.0, 2.0))
    times_s = np.linspace(0.0, 1.0, 6)
    nothing = grey(camera, 0.0)
    ours = rendered(drone, camera, times_s, T_W_B, nothing, config)
    reference = StockPyrender(drone, camera, a)
    stock = np.stack([reference.covered(t, T) for t, T in zip(times_s, T_W_B, strict=True)])
    coverage = stock.reshape(6, camera.height, a, camera.width, a).mean(axis=(2, 4))
    assert coverage.sum() > 300  # px
    differing_samples = np.rint(np.abs(ours - coverage) * a**2).sum()
    # Projections in another order of operations: float32 rounds the odd edge to the other side.
    assert differing_samples <= 2 + 1e-4 * stock.sum()


OTHER_BACKEND = """
import sys
import numpy as np
from tests.sim.render.test_definition import images_to_compare
from sim.render.gl_context import open_context
assert open_context(sys.argv[1]).backend == sys.argv[1]
np.save(sys.argv[2], images_to_compare())
"""


def images_to_compare() -> Image:
    camera = make_camera("radtan", HALF_VGA)
    T_W_B = tumbling(20, 7, (0.0, -1.0, 0.0), (2.5, 2.0, 1.5))
    times_s = np.linspace(0.0, 1.0, 20)
    config = RenderConfig(Lattice(6, 1))
    return rendered(QUADROTOR, camera, times_s, T_W_B, noise_image(camera), config)


def other_backend() -> str:
    used = open_context().backend
    other, library = {"osmesa": ("egl", "EGL"), "egl": ("osmesa", "OSMesa")}[used]
    if not ctypes.util.find_library(library):
        pytest.skip(f"this machine has no {library}")
    return other


def run_with(backend: str, *arguments: str) -> str:
    """What Python prints in a process of its own; without a backend, none has been chosen."""
    environment = {k: v for k, v in os.environ.items() if k != "PYOPENGL_PLATFORM"}
    if backend:
        environment["PYOPENGL_PLATFORM"] = backend
    command = [sys.executable, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.strip()


@pytest.mark.render
def test_both_backends_agree_but_for_a_few_edge_pixels(tmp_path: Path) -> None:
    backend = other_backend()
    path = tmp_path / "images.npy"
    run_with(backend, "-c", OTHER_BACKEND, backend, str(path))
    ours, theirs = images_to_compare(), np.load(path)
    # The same rasteriser, compiled for another framebuffer: a sample in some 10^4 may differ.
    assert np.count_nonzero(ours != theirs) <= 5
    assert np.abs(ours - theirs).max() <= 2 / 37


@pytest.mark.render
def test_one_process_one_backend() -> None:
    """Which may have been chosen beforehand, by the user."""
    context = open_context()
    assert context.backend in BACKENDS
    assert context.renderer
    assert context.version
    assert open_context() is context
    assert open_context(context.backend) is context
    (other,) = set(BACKENDS) - {context.backend}
    reason = f"GL backend {other}: this process already draws with {context.backend}"
    with pytest.raises(SimError, match=reason):
        open_context(other)
    asked = "from sim.render.gl_context import open_context; print(open_context().backend)"
    assert run_with(context.backend, "-c", asked) == context.backend


def test_osmesa_comes_first_and_egl_next(monkeypatch: pytest.MonkeyPatch) -> None:
    installed = {"OSMesa", "EGL"}
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)  # nothing has been chosen yet
    monkeypatch.setattr(sim.render.gl_context, "_open", lambda backend: backend)
    monkeypatch.setattr(
        ctypes.util, "find_library", lambda name: f"lib{name}.so" if name in installed else None
    )
    for library, backend in (("OSMesa", "osmesa"), ("EGL", "egl")):
        assert open_context() == backend
        installed.remove(library)
    with pytest.raises(SimError, match="no GL library on this machine: install one with"):
        open_context()


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_library_that_does_not_load(backend: str) -> None:
    """A driver that is asked for by name and missing, or broken, is one clear line."""
    code = (
        "import ctypes, ctypes.util\n"
        "from sim.render.gl_context import open_context\n"
        "ctypes.util.find_library = lambda name: None\n"
        "load = ctypes.CDLL.__init__\n"
        "def fail(self, name, *arguments, **options):\n"
        "    if name and ('GL' in str(name) or 'Mesa' in str(name)):\n"
        "        raise OSError(f'{name}: cannot open shared object file')\n"
        "    load(self, name, *arguments, **options)\n"
        "ctypes.CDLL.__init__ = fail\n"
        "from sim.errors import SimError\n"
        f"try:\n    open_context({backend!r})\n"
        "except SimError as error:\n    print(error)\n"
    )
    said = run_with("", "-c", code)
    assert said.startswith(f"cannot open a GL context with {backend} (")
    assert "install libosmesa6, or libegl1" in said
    assert "\n" not in said
