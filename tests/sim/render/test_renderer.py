"""What a renderer draws is what OpenGL, the other renderer and geometry say, batch by batch."""

import ctypes.util
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import sim.render.gl_atlas
import sim.render.gl_context
import sim.render.native
import sim.render.renderer
import sim.scene.drone
from sim.errors import SimError
from sim.render.config import RENDERERS, RenderConfig
from sim.render.footprint import footprint, plan_views
from sim.render.gl_atlas import GLPainter
from sim.render.gl_context import BACKENDS, open_context
from sim.render.lattice import Lattice
from sim.render.native import NativePainter
from sim.render.renderer import Renderer
from sim.scene.drone import Drone
from sim.scene.flyers import quadrotor
from tests.sim.render.stock_pyrender import StockPyrender
from tests.sim.scenes import (
    LENSES,
    Image,
    box_drone,
    grey,
    make_camera,
    noise_image,
    painted,
    poses,
    straight,
    tumbling,
    whole_images,
)

pytestmark = pytest.mark.render

HALF_VGA = (173, 130)  # a quarter of the default number of pixels, for speed
BRIGHT = RenderConfig(ambient=1.0)
# A hull seen from outside hides nothing of itself, whatever the depth buffer's rounding.
BOX = box_drone((0.7, 0.5, 0.3))
# Its parts cut into each other: which one a sample sees there depends on the rounding of depths.
QUADROTOR = quadrotor(rotor_hz=7.0)

DRAWN_BY = {"renderer": "pyrender"}  # of `rendered`


def drawn_by(config: RenderConfig) -> RenderConfig:
    return replace(config, renderer=DRAWN_BY["renderer"], check=False)


def drawn(*scene: Any) -> Image:
    """Draw whole images of a drone, a camera, times, poses and a background, by a config."""
    drone, camera, times_s, T_W_B, background, config = scene
    with Renderer(drone, config) as renderer:
        crops = renderer.crops(camera, times_s, T_W_B, background)
        return whole_images(crops, times_s, background)


def rendered(*scene: Any) -> Image:
    """Draw the same by the renderer that is asked for, unchecked."""
    return drawn(*scene[:-1], drawn_by(scene[-1]))


def full_frames(*scene: Any) -> Image:
    """Draw the same by OpenGL, a whole frame at a time."""
    drone, camera, times_s, T_W_B, background, config = scene
    painter, seen = GLPainter(drone, config), footprint(drone, camera, times_s, T_W_B)
    seen.boxes[:] = 0, 0, camera.width, camera.height
    each = (
        plan_views(drone, camera, seen, np.array([k]), times_s, T_W_B) for k in range(len(times_s))
    )
    zero = np.zeros((1, 2), np.int64)
    return np.concatenate([painter.paint(camera, view, zero, background) for view in each])


@pytest.fixture(params=RENDERERS)
def each_renderer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Let `rendered` draw by either."""
    monkeypatch.setitem(DRAWN_BY, "renderer", request.param)
    return str(request.param)


# --- One instant, one picture ------------------------------------------------------------------


@pytest.mark.usefixtures("each_renderer")
@pytest.mark.parametrize("lens", ["none", "radtan"])
def test_batches_do_not_show(lens: str, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = make_camera(lens, HALF_VGA)
    times_s = np.linspace(0.0, 1.0, 60)
    T_W_B = straight(times_s, (-2.9, -1.0, 0.1), (5.6, -1.2, 0.2))  # in from the left, out again
    background = noise_image(camera)
    drone = painted(QUADROTOR, 0.2)
    whole = rendered(drone, camera, times_s, T_W_B, background, BRIGHT)
    parts = [
        rendered(drone, camera, times_s[some], T_W_B[some], background, BRIGHT)
        for some in (slice(0, 7), slice(7, 40), slice(40, 60))
    ]
    inside = slice(8, 52)  # not cut off by the image's border
    np.testing.assert_array_equal(np.concatenate(parts)[inside], whole[inside])
    for size in (100, 333, 3000):
        monkeypatch.setattr(sim.render.gl_atlas, "ATLAS_SIZE", size)
        monkeypatch.setattr(sim.render.native, "BATCH", size // 30)
        monkeypatch.setattr(sim.render.native, "BLOCK_SAMPLES", size // 2)
        again = rendered(drone, camera, times_s, T_W_B, background, BRIGHT)
        np.testing.assert_array_equal(again[inside], whole[inside])
        assert (again != whole).sum() <= 1  # cut edges: see test_same_pixels_where_the_image_ends


@pytest.mark.usefixtures("each_renderer")
def test_memory_stays_flat() -> None:
    """Under OSMesa pyrender loses 3 MB with every frame."""
    camera = make_camera(resolution=HALF_VGA)
    n = 5_000
    times_s = np.linspace(0.0, 1.0, n)
    T_W_B = straight(times_s, (-0.5, 0.0, 0.0), (1.0, 0.0, 0.0))
    background = grey(camera)
    with Renderer(quadrotor(0.4), drawn_by(RenderConfig(Lattice(2, 1)))) as renderer:
        resident_mb = []
        for _ in range(5):
            for _ in renderer.crops(camera, times_s, T_W_B, background):
                pass
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            resident_mb.append(pages * os.sysconf("SC_PAGE_SIZE") / 1e6)
    # 20,000 poses after the first round; the allocator may keep the odd megabyte.
    assert resident_mb[-1] - resident_mb[0] < 4.0


# --- Where the drone is ------------------------------------------------------------------------


@pytest.mark.usefixtures("each_renderer")
@pytest.mark.parametrize("lens", LENSES)
def test_a_small_drone_lies_where_the_camera_projects_it(lens: str) -> None:
    camera = make_camera(lens)
    drone = box_drone((0.06, 0.06, 0.06), albedo=1.0)  # 2.4 px
    T_W_B = tumbling(40, 6, (0.0, 0.0, 0.0), (3.5, 0.3, 2.5))
    times_s = np.linspace(0.0, 1.0, 40)
    config = RenderConfig(Lattice(16, 1), ambient=1.0)
    light = rendered(drone, camera, times_s, T_W_B, grey(camera, 0.0), config)
    mass = light.sum(axis=(1, 2))
    x = (light.sum(axis=1) @ np.arange(camera.width)) / mass
    y = (light.sum(axis=2) @ np.arange(camera.height)) / mass
    # Some 1,500 samples, 1/16 px apart, see it; and near one side of a cube is larger than the far.
    error_px = np.stack([x, y], axis=-1) - camera.project(T_W_B[:, :3, 3])
    assert np.abs(error_px).max() < 0.05
    assert np.abs(error_px.mean(axis=0)).max() < 0.005  # no constant shift


@pytest.mark.usefixtures("each_renderer")
def test_leaving_and_entering_are_seen_as_a_change() -> None:
    """The instants without the drone next to those with it are crops too, of pure background."""
    camera = make_camera()
    times_s = np.arange(12.0)
    x_m = np.array([9, 9, 9, 1, 0, 9, 9, 9, 9, 1, 9, 9.0])
    T_W_B = poses(np.stack([x_m, 0 * x_m, 0 * x_m], axis=-1))
    background = noise_image(camera)
    with Renderer(BOX, drawn_by(RenderConfig())) as renderer:
        crops = list(renderer.crops(camera, times_s, T_W_B, background))
    times_seen = np.concatenate([crop.times_s for crop in crops])
    np.testing.assert_array_equal(times_seen, [2, 3, 4, 5, 8, 9, 10])
    images = whole_images(crops, times_s, background)
    shows_drone = (images != background).any(axis=(1, 2))
    np.testing.assert_array_equal(np.flatnonzero(shows_drone), [3, 4, 9])


@pytest.mark.parametrize("lens", ["radtan", "equidistant"])
@pytest.mark.parametrize("z_m", [-0.8, -0.6, 0.6, 0.8])
def test_crops_hold_edges_that_the_lens_bends(lens: str, z_m: float) -> None:
    """An edge across half the view bows by 10 px beyond the corners of the drone's hull."""
    camera = make_camera(lens)
    plate = box_drone((1.5, 1.5, 0.1))
    T_W_B = poses(np.array([[0.0, -3.0, z_m], [0.1, -3.0, z_m]]))
    scene = (plate, camera, np.arange(2.0), T_W_B, grey(camera), RenderConfig(Lattice(4, 0)))
    np.testing.assert_array_equal(rendered(*scene), full_frames(*scene))


@pytest.mark.usefixtures("each_renderer")
@pytest.mark.parametrize("a", [1, 8])
def test_the_silhouette_of_a_box_is_the_hull_of_its_corners(a: int) -> None:
    camera, drone = make_camera(), painted(BOX, 1.0)
    T_W_B = tumbling(6, 5, (0.0, 0.0, 0.0), (3.0, 2.0, 2.0))
    config = RenderConfig(Lattice(a, 0), ambient=1.0)
    ours = rendered(drone, camera, np.arange(6.0), T_W_B, grey(camera, 0.0), config)
    x, y = (np.arange(0.5, a * n) / a - 0.5 for n in (camera.width, camera.height))
    for image, T in zip(ours, T_W_B, strict=True):
        corners_px = camera.project(drone.parts[0].vertices_B_m @ T[:3, :3].T + T[:3, 3])
        edges = ConvexHull(corners_px).equations
        covered = np.all([u * x + (v * y + w)[:, None] < 0.0 for u, v, w in edges], axis=0)
        shares = covered.reshape(camera.height, a, camera.width, a).mean(axis=(1, 3))
        assert shares.sum() > 50  # px
        # Corners are rounded to 1/256 of a sample: seldom one beside an edge changes sides.
        assert np.abs(image - shares).sum() * a**2 <= 2 + 1e-4 * covered.sum()


@pytest.mark.parametrize("a", [1, 8])
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


# --- Light -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("each_renderer")
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize(
    ("light_W", "lambert"),
    [
        ((0.0, -3.0, 0.0), 1.0),  # from the camera
        ((0.0, -1.0, 3.0**0.5), 0.5),  # from 60 deg above
        ((1.0, -1.0, 0.0), 0.5**0.5),  # from 45 deg aside
        ((0.0, 1.0, 0.0), 0.0),  # from behind
    ],
)
def test_lambert(lens: str, light_W: tuple[float, float, float], lambert: float) -> None:
    camera = make_camera(lens)
    config = RenderConfig(light_W=light_W, ambient=0.3)
    box = box_drone((1.0, 1.0, 1.0), 0.4)
    (image,) = rendered(box, camera, np.zeros(1), np.eye(4)[None], grey(camera), config)
    face = image[120:141, 163:184]  # the one that the camera looks at squarely
    # Codes are 1/65535 apart.
    np.testing.assert_allclose(face, 0.4 * (0.3 + 0.7 * lambert), atol=1e-5)


# --- Against OpenGL, a whole frame at a time ----------------------------------------------------


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("lattice", [Lattice(4, 0), Lattice(6, 1), Lattice(9, 1)], ids=repr)
@pytest.mark.parametrize("drone", [BOX, painted(QUADROTOR, 0.2)], ids=["box", "quadrotor"])
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
def test_same_pixels_where_the_image_ends(lattice: Lattice, lens: str) -> None:
    camera = make_camera(lens, HALF_VGA)
    side = np.array([-1.0, 1.0])
    x_m, z_m = np.meshgrid(1.6 * side, 1.2 * side)
    centres_m = np.stack([x_m.ravel(), np.full(4, -3.1), z_m.ravel()], axis=-1)
    T_W_B = poses(np.concatenate([centres_m * [1, 1, 0.2], centres_m * [0.3, 1, 1]]), seed=2)
    times_s = np.arange(8.0)
    boxes = footprint(BOX, camera, times_s, T_W_B).boxes
    assert ((boxes[:, :2] == 0) | (boxes[:, 2:] == HALF_VGA)).any(axis=1).sum() >= 6
    background = noise_image(camera)
    scene = (BOX, camera, times_s, T_W_B, background, replace(BRIGHT, lattice=lattice))
    differences = rendered(*scene) != full_frames(*scene)
    # Cutting an edge off at the tile's border makes a new corner, which the rasteriser rounds to
    # 1/256 of a sample: very seldom a sample beside the edge changes sides.
    assert differences.sum() <= 1


OTHER_BACKEND = """
import sys
import numpy as np
from tests.sim.render.test_renderer import images_to_compare
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


def test_both_backends_agree_but_for_a_few_edge_pixels(tmp_path: Path) -> None:
    backend = other_backend()
    path = tmp_path / "images.npy"
    run_with(backend, "-c", OTHER_BACKEND, backend, str(path))
    ours, theirs = images_to_compare(), np.load(path)
    # The same rasteriser, compiled for another framebuffer: a sample in some 10^4 may differ.
    assert np.count_nonzero(ours != theirs) <= 5
    assert np.abs(ours - theirs).max() <= 2 / 37


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


# --- The native renderer ------------------------------------------------------------------------


NO_GL = RenderConfig(check=False)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("lattice", [Lattice(8, 0), Lattice(6, 1), Lattice(16, 1)], ids=repr)
@pytest.mark.parametrize(
    "drone", [BOX, quadrotor(rotor_hz=7.0), quadrotor(1.6)], ids=["box", "spinning", "large"]
)
def test_draws_what_opengl_draws(drone: Drone, lattice: Lattice, lens: str) -> None:
    camera = make_camera(lens, HALF_VGA)
    times_s = np.linspace(0.0, 1.0, 12)
    T_W_B = tumbling(12, 3, (0.0, -1.0, 0.0), (3.5, 2.0, 2.5))  # some beyond the image's border
    background = noise_image(camera)
    config = RenderConfig(lattice, check=False)
    ours = drawn(drone, camera, times_s, T_W_B, background, config)
    theirs = drawn(drone, camera, times_s, T_W_B, background, replace(config, renderer="pyrender"))
    difference = np.abs(ours.astype(np.float64) - theirs)
    shown = (theirs != background).sum()
    assert shown > 500
    # Corners rounded from double or from single precision to 1/256 of a sample: with 16 samples
    # along a pixel, some 3 in 100 pixels have a sample that changes sides.
    assert (difference > 1e-4).sum() < 0.05 * shown
    # A code is 1/65535; a pixel has few samples that change.
    assert difference.max() < 4 / lattice.samples_per_pixel
    # A corner that is wrong by 1/10 of a sample fails this by a factor of ten.
    assert difference.sum() < 5e-5 * shown


def test_the_check_compares_instants_and_says_how_far_they_were() -> None:
    camera = make_camera()
    times_s = np.linspace(0.0, 1.0, 300)
    T_W_B = straight(times_s, (-1.0, 0.0, 0.0), (2.0, 0.0, 0.3))
    with Renderer(quadrotor(), RenderConfig(), seed=5) as renderer:
        assert list(renderer.crops(camera, times_s, T_W_B, grey(camera)))
        check = renderer.check
    assert check.n_instants == sim.render.renderer.CHECKED_INSTANTS
    assert check.n_pixels > 25 * 50  # a flat drone from its side, 36 px wide
    assert 0.0 < check.mean_difference < 1e-4


def test_edges_along_the_lattice_pass_the_check() -> None:
    """Rounded to the other side, they take a row of samples along in each pixel that they pass."""
    camera = make_camera()
    times_s = np.linspace(0.0, 1.0, 25)
    for start, step in (((-0.5, 0.0, 0.2), (1.0, 0.0, 0.0)), ((0.0, -2.0, 0.0), (0.0, 1.0, 0.0))):
        T_W_B = straight(times_s, start, step)
        with Renderer(BOX, RenderConfig()) as renderer:
            list(renderer.crops(camera, times_s, T_W_B, grey(camera)))
            assert renderer.check.n_instants == 25


def test_a_renderer_that_differs_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    paint = NativePainter.paint

    def shifted(*arguments: object) -> Image:
        return np.roll(paint(*arguments), 1, axis=2)  # type: ignore[arg-type]

    monkeypatch.setattr(NativePainter, "paint", shifted)
    camera = make_camera()
    T_W_B = straight(np.arange(2.0), (0.0, 0.0, 0.0), (0.2, 0.0, 0.0))
    said = r"native renderer differs from pyrender by up to 0\..*report"
    with Renderer(quadrotor()) as renderer, pytest.raises(SimError, match=said):
        list(renderer.crops(camera, np.arange(2.0), T_W_B, grey(camera)))


def test_without_the_check_opengl_is_not_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(GLPainter, "__init__", refuse)
    camera = make_camera()
    assert drawn(BOX, camera, np.zeros(1), np.eye(4)[None], grey(camera), NO_GL).min() < 0.6


def test_a_mesh_too_large_for_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(sim.scene.drone, "Faces", full)
    camera = make_camera()
    with pytest.raises(SimError, match="mesh of 12 faces does not fit the memory: simplify it"):
        drawn(painted(BOX, 0.2), camera, np.zeros(1), poses(np.zeros((1, 3))), grey(camera), NO_GL)
