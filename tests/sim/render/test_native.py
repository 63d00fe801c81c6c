"""The native renderer draws what OpenGL draws; where that has no answer, what geometry says."""

from dataclasses import replace

import numpy as np
import pytest

import sim.render.renderer
import sim.scene.drone
from sim.errors import SimError
from sim.render.config import RenderConfig
from sim.render.gl_atlas import GLPainter
from sim.render.lattice import Lattice
from sim.render.native import NativePainter
from sim.render.renderer import Renderer
from sim.scene.drone import Drone
from sim.scene.flyers import quadrotor
from tests.sim.render.drawing import BOX, HALF_VGA, drawn
from tests.sim.scenes import (
    LENSES,
    Image,
    grey,
    make_camera,
    noise_image,
    painted,
    poses,
    straight,
    tumbling,
)

NO_GL = RenderConfig(check=False)


@pytest.mark.render
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


@pytest.mark.render
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


@pytest.mark.render
def test_edges_along_the_lattice_pass_the_check() -> None:
    """Rounded to the other side, they take a row of samples along in each pixel that they pass."""
    camera = make_camera()
    times_s = np.linspace(0.0, 1.0, 25)
    for start, step in (((-0.5, 0.0, 0.2), (1.0, 0.0, 0.0)), ((0.0, -2.0, 0.0), (0.0, 1.0, 0.0))):
        T_W_B = straight(times_s, start, step)
        with Renderer(BOX, RenderConfig()) as renderer:
            list(renderer.crops(camera, times_s, T_W_B, grey(camera)))
            assert renderer.check.n_instants == 25


@pytest.mark.render
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
