import os
from pathlib import Path

import numpy as np
import pytest

import sim.render.gl_atlas
import sim.render.native
import sim.render.renderer
from sim.render.config import RENDERERS, RenderConfig
from sim.render.lattice import Lattice
from sim.render.renderer import Renderer
from sim.scene.flyers import quadrotor
from sim.scene.trajectory import PosesAt, SplineConfig, random_spline
from tests.sim.render.drawing import (
    BOX,
    BRIGHT,
    DRAWN_BY,
    HALF_VGA,
    QUADROTOR,
    drawn_by,
    full_frames,
    rendered,
)
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


def test_planning_a_part_at_a_time_gives_the_same_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """And poses may be worked out as they are asked for."""
    camera = make_camera("none", HALF_VGA)
    trajectory = random_spline(SplineConfig(duration_s=2.0), np.random.default_rng(3))
    times_s = np.linspace(0.0, 2.0, 500)
    background = grey(camera)
    monkeypatch.setattr(sim.render.renderer, "MAX_INSTANCES", 20)
    monkeypatch.setattr(sim.render.native, "BATCH", 20)
    with Renderer(QUADROTOR, RenderConfig(Lattice(2, 1), check=False)) as renderer:
        T_W_B = trajectory.poses(times_s)
        at_once = list(renderer.crops(camera, times_s, T_W_B, background))
        for n in (21, 27, 64, 499):
            monkeypatch.setattr(sim.render.renderer, "PLANNED_AT_ONCE", n)
            poses = PosesAt(trajectory, times_s)
            in_parts = list(renderer.crops(camera, times_s, poses, background))
            for one, other in zip(at_once, in_parts, strict=True):
                np.testing.assert_array_equal(one.times_s, other.times_s)
                np.testing.assert_array_equal(one.luminance, other.luminance)
    assert len(at_once) >= 25


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
