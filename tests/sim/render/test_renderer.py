"""Tests the renderers' images against OpenGL, each other and geometry, also batch by batch."""

import ctypes.util
import os
import subprocess
import sys
from itertools import permutations
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from sim.errors import SimError
from sim.render.config import RENDERERS, RenderConfig
from sim.render.footprint import footprint, plan_views
from sim.render.gl_atlas import GLPainter
from sim.render.gl_context import BACKENDS, _open, open_context
from sim.render.lattice import Lattice
from sim.render.native import NativePainter
from sim.render.renderer import CHECKED_INSTANTS, Renderer
from sim.scene.flyers import quadrotor
from tests.sim.scenes import (
    LENSES,
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
# The visible faces of a convex hull do not hide each other, whatever the rounding of depths.
BOX = box_drone((0.7, 0.5, 0.3))
# Its parts intersect, and which part a sample sees there depends on the rounding of depths.
QUADROTOR = quadrotor(rotor_hz=7.0)
STILL = make_camera(), np.zeros(1), np.eye(4)[None], grey(make_camera())

each_renderer = pytest.mark.parametrize("renderer", RENDERERS)


def unchecked(renderer="pyrender", a=16, b=1, **light):
    return RenderConfig(Lattice(a, b), renderer=renderer, check=False, **light)


def drawn(drone, camera, times_s, T_W_B, background, config):
    with Renderer(drone, config) as renderer:
        crops = renderer.crops(camera, times_s, T_W_B, background)
        return whole_images(crops, times_s, background)


@each_renderer
@pytest.mark.parametrize("lens", ["none", "radtan"])
def test_batches_do_not_show(lens, renderer, monkeypatch):
    camera, config = make_camera(lens, HALF_VGA), unchecked(renderer, ambient=1.0)
    times_s = np.linspace(0.0, 1.0, 60)
    T_W_B = straight(times_s, (-2.9, -1.0, 0.1), (5.6, -1.2, 0.2))  # in from the left, out again
    background = noise_image(camera)
    drone = painted(QUADROTOR, 0.2)
    whole = drawn(drone, camera, times_s, T_W_B, background, config)
    parts = [
        drawn(drone, camera, times_s[some], T_W_B[some], background, config)
        for some in (slice(0, 7), slice(7, 40), slice(40, 60))
    ]
    inside = slice(8, 52)  # not cut off by the image's border
    np.testing.assert_array_equal(np.concatenate(parts)[inside], whole[inside])
    for size in (100, 333, 3000):
        monkeypatch.setattr("sim.render.gl_atlas.ATLAS_SIZE", size)
        monkeypatch.setattr("sim.render.native.BATCH", size // 30)
        monkeypatch.setattr("sim.render.native.BLOCK_SAMPLES", size // 2)
        again = drawn(drone, camera, times_s, T_W_B, background, config)
        np.testing.assert_array_equal(again[inside], whole[inside])
        assert (again != whole).sum() <= 1  # cut edges: see test_same_pixels_as_in_a_full_frame


@each_renderer
def test_memory_stays_flat(renderer):
    """Under OSMesa pyrender leaks 3 MB with every frame."""
    camera = make_camera(resolution=HALF_VGA)
    times_s = np.linspace(0.0, 1.0, 5_000)
    T_W_B = straight(times_s, (-0.5, 0.0, 0.0), (1.0, 0.0, 0.0))
    with Renderer(quadrotor(0.4), unchecked(renderer, a=2)) as painter:
        resident_mb = []
        for _ in range(5):
            for _ in painter.crops(camera, times_s, T_W_B, grey(camera)):
                pass
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            resident_mb.append(pages * os.sysconf("SC_PAGE_SIZE") / 1e6)
    # 20,000 poses after the first round; the allocator may keep the odd megabyte.
    assert resident_mb[-1] - resident_mb[0] < 4.0


@each_renderer
@pytest.mark.parametrize("lens", LENSES)
def test_a_small_drone_lies_where_the_camera_projects_it(lens, renderer):
    camera = make_camera(lens)
    drone = box_drone((0.06, 0.06, 0.06), albedo=1.0)  # 2.4 px
    T_W_B = tumbling(40, 6, (0.0, 0.0, 0.0), (3.5, 0.3, 2.5))
    times_s = np.linspace(0.0, 1.0, 40)
    config = unchecked(renderer, ambient=1.0)
    light = drawn(drone, camera, times_s, T_W_B, grey(camera, 0.0), config)
    mass = light.sum(axis=(1, 2))
    x = (light.sum(axis=1) @ np.arange(camera.width)) / mass
    y = (light.sum(axis=2) @ np.arange(camera.height)) / mass
    # Some 1,500 samples, 1/16 px apart, see the drone, and its nearer side appears larger.
    error_px = np.stack([x, y], axis=-1) - camera.project(T_W_B[:, :3, 3])
    assert np.abs(error_px).max() < 0.05
    assert np.abs(error_px.mean(axis=0)).max() < 0.005  # no constant shift


@each_renderer
def test_leaving_and_entering_are_seen_as_a_change(renderer):
    """An instant without the drone next to one with it is a crop too, of pure background."""
    camera = make_camera()
    times_s = np.arange(12.0)
    x_m = np.array([9, 9, 9, 1, 0, 9, 9, 9, 9, 1, 9, 9.0])
    T_W_B = poses(np.stack([x_m, 0 * x_m, 0 * x_m], axis=-1))
    background = noise_image(camera)
    with Renderer(BOX, unchecked(renderer)) as painter:
        crops = list(painter.crops(camera, times_s, T_W_B, background))
    times_seen = np.concatenate([crop.times_s for crop in crops])
    np.testing.assert_array_equal(times_seen, [2, 3, 4, 5, 8, 9, 10])
    shows_drone = (whole_images(crops, times_s, background) != background).any(axis=(1, 2))
    np.testing.assert_array_equal(np.flatnonzero(shows_drone), [3, 4, 9])


@each_renderer
@pytest.mark.parametrize("a", [1, 8])
@pytest.mark.parametrize("drone", [BOX, QUADROTOR], ids=["box", "quadrotor"])
def test_the_silhouette_is_all_that_the_hulls_of_its_pieces_cover(drone, a, renderer):
    camera, times_s = make_camera(), np.linspace(0.0, 1.0, 6)
    T_W_B = tumbling(6, 5, (0.0, 0.0, 0.0), (3.0, 2.0, 2.0))
    config = unchecked(renderer, a, 0, ambient=1.0)
    ours = drawn(painted(drone, 1.0), camera, times_s, T_W_B, grey(camera, 0.0), config)
    x, y = (np.arange(0.5, a * n) / a - 0.5 for n in (camera.width, camera.height))
    for image, time_s, T in zip(ours, times_s, T_W_B, strict=True):
        covered = np.zeros((len(y), len(x)), np.bool_)
        for part in drone.parts:
            T_W_P = T @ part.joint.transforms(time_s[None])[0] if part.joint else T
            for piece in trimesh.Trimesh(part.vertices_B_m, part.faces).split():  # all convex
                corners_px = camera.project(piece.vertices @ T_W_P[:3, :3].T + T_W_P[:3, 3])
                (left, top), (right, bottom) = corners_px.min(axis=0), corners_px.max(axis=0)
                at = np.ix_((y > top) & (y < bottom), (x > left) & (x < right))
                edges = ConvexHull(corners_px).equations
                inside = [u * x[at[1]] + v * y[at[0]] + w < 0.0 for u, v, w in edges]
                covered[at] |= np.all(inside, axis=0)
        shares = covered.reshape(camera.height, a, camera.width, a).mean(axis=(1, 3))
        assert shares.sum() > 20  # px
        # Corners are rounded to 1/256 of a sample: a sample beside an edge seldom changes sides.
        assert np.abs(image - shares).sum() * a**2 <= 2 + 1e-4 * covered.sum()


@each_renderer
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
def test_lambert(lens, light_W, lambert, renderer):
    camera = make_camera(lens)
    config = unchecked(renderer, light_W=light_W, ambient=0.3)
    box = box_drone((1.0, 1.0, 1.0), 0.4)
    (image,) = drawn(box, camera, np.zeros(1), np.eye(4)[None], grey(camera), config)
    face = image[120:141, 163:184]  # the one that the camera looks at squarely
    # Codes are 1/65535 apart.
    np.testing.assert_allclose(face, 0.4 * (0.3 + 0.7 * lambert), atol=1e-5)


IN_VIEW = tumbling(12, 3, (0.0, -1.0, 0.0), (1.5, 2.0, 1.0))
CORNERS_M = np.array([[x, -3.1, z] for z in (-1.2, 1.2) for x in (-1.6, 1.6)])
BESIDE = poses(np.array([[x, -3.0, z] for z in (-0.7, -0.5, 0.5, 0.7) for x in (0.0, 0.1)]))
AT_BORDERS = poses(np.concatenate([CORNERS_M * [1, 1, 0.2], CORNERS_M * [0.3, 1, 1]]), seed=2)


@pytest.mark.parametrize(
    ("lens", "a", "b"), [("none", 4, 0), ("radtan", 6, 1), ("equidistant", 9, 1)]
)
@pytest.mark.parametrize(
    ("drone", "T_W_B", "ambient"),
    [
        (BOX, IN_VIEW, 0.3),
        (painted(QUADROTOR, 0.2), IN_VIEW, 1.0),  # whose rotors spin
        # Edges across half the view, which a lens bends by 2 to 4 px beyond the hull's corners.
        (box_drone((1.5, 1.5, 0.1)), BESIDE, 0.3),
        (BOX, AT_BORDERS, 1.0),
    ],
    ids=["box", "quadrotor", "plate", "at the borders"],
)
def test_same_pixels_as_in_a_full_frame(drone, T_W_B, ambient, a, b, lens):
    camera, times_s = make_camera(lens, HALF_VGA), np.linspace(0.0, 1.0, len(T_W_B))
    background, config = noise_image(camera), unchecked(a=a, b=b, ambient=ambient)
    crops = drawn(drone, camera, times_s, T_W_B, background, config)
    assert (crops != background).any(axis=(1, 2)).all()
    painter, seen = GLPainter(drone, config), footprint(drone, camera, times_s, T_W_B)
    is_cut = ((seen.boxes[:, :2] == 0) | (seen.boxes[:, 2:] == HALF_VGA)).any(axis=1)
    assert (is_cut.sum() >= 6) == (T_W_B is AT_BORDERS)
    seen.boxes[:] = 0, 0, *HALF_VGA
    zero, each = np.zeros((1, 2), np.int64), np.arange(len(times_s))[:, None]
    views = (plan_views(drone, camera, seen, at, times_s, T_W_B) for at in each)
    whole = np.concatenate([painter.paint(camera, view, zero, background) for view in views])
    # Cutting an edge off at the tile's border makes a new corner, which the rasteriser rounds to
    # 1/256 of a sample: very seldom a sample beside the edge changes sides.
    assert (crops != whole).sum() <= (T_W_B is AT_BORDERS)


def test_the_other_backend_draws_the_same_but_for_a_few_edge_pixels():
    """Both are equally near to the native renderer, as they are one rasteriser, compiled twice."""
    (other,) = set(BACKENDS) - {open_context().backend}
    if not ctypes.util.find_library(BACKENDS[other]):
        pytest.skip(f"this machine has no {BACKENDS[other]}")
    which = ("--noconftest", __file__, "-k", "draws_what_opengl and box")
    command = (sys.executable, "-m", "pytest", *which)
    quickly = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    environment = os.environ | quickly | {"PYOPENGL_PLATFORM": other}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert "3 passed" in done.stdout, done.stdout + done.stderr


def test_one_process_one_backend(monkeypatch):
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
    monkeypatch.setattr("sim.render.gl_context._KEEP_ALIVE", [])  # nothing has been drawn
    for chosen, other in permutations(BACKENDS):
        monkeypatch.setenv("PYOPENGL_PLATFORM", chosen)  # by the user
        with pytest.raises(SimError, match=f"PYOPENGL_PLATFORM is {chosen}: unset it, or set"):
            open_context(other)


def test_osmesa_comes_first_and_egl_next(monkeypatch):
    installed = {"OSMesa", "EGL"}
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)  # nothing has been chosen yet
    monkeypatch.setattr("sim.render.gl_context._open", lambda backend: backend)
    monkeypatch.setattr(
        ctypes.util, "find_library", lambda name: f"lib{name}.so" if name in installed else None
    )
    for library, backend in (("OSMesa", "osmesa"), ("EGL", "egl")):
        assert open_context() == backend
        installed.remove(library)
    with pytest.raises(SimError, match=r"no GL library .*: install one with .*, or use --no-check"):
        open_context()
    for backend in BACKENDS:  # chosen by the user beforehand
        monkeypatch.setenv("PYOPENGL_PLATFORM", backend)
        assert open_context() == backend


BROKEN = Mock(OffscreenRenderer=Mock(side_effect=ImportError("Unable to load OpenGL library")))
UNLOADED = r"^cannot open a GL context with {} \(.*: install libosmesa6, .*use --no-check"
UNKNOWN = r"^pyrender, which .*, is not installed \(.*: install it, or use --no-check"


@pytest.mark.parametrize(
    ("backend", "pyrender", "said"),
    [*((name, BROKEN, UNLOADED.format(name)) for name in BACKENDS), ("osmesa", None, UNKNOWN)],
)
def test_what_does_not_load_is_named(backend, pyrender, said, monkeypatch):
    """A driver that is asked for by name, but missing or broken, is refused in one clear line."""
    monkeypatch.setenv("PYOPENGL_PLATFORM", backend)
    monkeypatch.setitem(sys.modules, "pyrender.offscreen", pyrender)
    with pytest.raises(SimError, match=said):
        _open.__wrapped__(backend)


@pytest.mark.parametrize(
    ("lens", "a", "b"), [("none", 8, 0), ("radtan", 6, 1), ("equidistant", 16, 1)]
)
@pytest.mark.parametrize(
    "drone", [BOX, quadrotor(rotor_hz=7.0), quadrotor(1.6)], ids=["box", "spinning", "large"]
)
def test_draws_what_opengl_draws(drone, a, b, lens):
    camera = make_camera(lens, HALF_VGA)
    T_W_B = tumbling(12, 3, (0.0, -1.0, 0.0), (3.5, 2.0, 2.5))  # some beyond the image's border
    background = noise_image(camera)
    scene = (drone, camera, np.linspace(0.0, 1.0, 12), T_W_B, background)
    ours, theirs = (drawn(*scene, unchecked(name, a, b)) for name in ("native", "pyrender"))
    difference = np.abs(ours.astype(np.float64) - theirs)
    shown = (theirs != background).sum()
    assert shown > 500
    # One renderer rounds corners from double, the other from single precision, to 1/256 of a
    # sample: with 16 samples along a pixel, some 3 in 100 pixels have a sample that changes sides.
    assert (difference > 1e-4).sum() < 0.05 * shown
    # A code is 1/65535; a pixel has few samples that change.
    assert difference.max() < 4 / (a**2 + b**2)
    # A corner that is wrong by 1/10 of a sample fails this by a factor of ten.
    assert difference.sum() < 5e-5 * shown


# An edge along the lattice that is rounded to the other side changes a row of samples in each pixel
# that it passes.
@pytest.mark.parametrize(
    ("drone", "n", "start_m", "velocity_m_s"),
    [
        (quadrotor(), 300, (-1.0, 0.0, 0.0), (2.0, 0.0, 0.3)),
        (BOX, 25, (-0.5, 0.0, 0.2), (1.0, 0.0, 0.0)),
        (BOX, 25, (0.0, -2.0, 0.0), (0.0, 1.0, 0.0)),
    ],
)
def test_the_check_compares_instants_and_says_how_far_they_were(drone, n, start_m, velocity_m_s):
    camera, times_s = make_camera(), np.linspace(0.0, 1.0, n)
    T_W_B = straight(times_s, start_m, velocity_m_s)
    with Renderer(drone, RenderConfig(), seed=5) as renderer:
        assert list(renderer.crops(camera, times_s, T_W_B, grey(camera)))
    check = renderer.check
    assert check.n_instants == CHECKED_INSTANTS
    assert check.n_pixels > 25 * 50  # a flat drone from its side, 36 px wide
    assert check.mean_difference < 1e-4
    assert check.mean_difference > 0.0 or drone is BOX  # whose edges both may round alike


def test_a_renderer_that_differs_is_refused(monkeypatch):
    paint = NativePainter.paint
    monkeypatch.setattr(NativePainter, "paint", lambda *view: np.roll(paint(*view), 1, axis=2))
    camera = make_camera()
    T_W_B = straight(np.arange(2.0), (0.0, 0.0, 0.0), (0.2, 0.0, 0.0))
    said = r"native renderer differs from pyrender by up to 0\..*report"
    with Renderer(quadrotor()) as renderer, pytest.raises(SimError, match=said):
        list(renderer.crops(camera, np.arange(2.0), T_W_B, grey(camera)))


def test_without_the_check_opengl_is_not_opened(monkeypatch):
    monkeypatch.setattr(GLPainter, "__init__", Mock(side_effect=AssertionError))
    assert drawn(BOX, *STILL, unchecked("native")).min() < 0.6


def test_a_mesh_too_large_for_memory_is_refused(monkeypatch):
    monkeypatch.setattr("sim.scene.drone.Faces", Mock(side_effect=MemoryError))
    with pytest.raises(SimError, match="mesh of 12 faces does not fit the memory: simplify it"):
        drawn(painted(BOX, 0.2), *STILL, unchecked("native"))
