from pathlib import Path

import cv2
import numpy as np
import pytest

from sim.errors import SimError
from sim.scene.background import load_background, uniform_background
from tests.sim.scenes import make_camera, noise_image

CAMERA = make_camera(resolution=(64, 48))


def test_even_sky() -> None:
    sky = uniform_background(CAMERA, 0.6)
    assert sky.shape == (48, 64)
    assert sky.dtype == np.float32
    assert (sky == np.float32(0.6)).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_images_are_srgb(tmp_path: Path, dtype: type) -> None:
    full = np.iinfo(dtype).max
    srgb = np.linspace(0, full, 48 * 64).astype(dtype).reshape(48, 64)
    cv2.imwrite(str(tmp_path / "wall.png"), srgb)
    light = load_background(tmp_path / "wall.png", CAMERA)
    assert light.dtype == np.float32
    assert light[0, 0] == 0.0
    assert light[-1, -1] == 1.0
    middle = np.abs(srgb / full - 0.5).argmin()
    # sRGB 0.5 is linear 0.214; steps of 1/255, of slope 0.9 there.
    assert light.flat[middle] == pytest.approx(0.2140, abs=2e-3)
    steps = np.diff(light.ravel())
    assert (steps >= 0).all()
    # The line near black and the power meet: nowhere steeper than at white, where it is 2.28.
    assert steps.max() <= 2.3 * np.diff(srgb.ravel().astype(float)).max() / full


def test_arrays_are_linear(tmp_path: Path) -> None:
    image = noise_image(CAMERA)
    np.save(tmp_path / "wall.npy", image.astype(np.float64))
    np.testing.assert_array_equal(load_background(tmp_path / "wall.npy", CAMERA), image)


@pytest.mark.parametrize("shape", [(48, 63), (64, 48), (48, 64, 3)])
def test_an_image_of_the_wrong_size_is_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "wall.npy", np.zeros(shape))
    with pytest.raises(SimError, match=r"wall\.npy: expected 64 x 48 pixels .* resize"):
        load_background(tmp_path / "wall.npy", CAMERA)


@pytest.mark.parametrize("value", [-0.1, 1.1, np.nan, np.inf])
def test_luminance_out_of_range_is_refused(tmp_path: Path, value: float) -> None:
    image = np.full((48, 64), 0.5)
    image[3, 4] = value
    np.save(tmp_path / "wall.npy", image)
    with pytest.raises(SimError, match=r"wall\.npy: expected linear luminance in \[0, 1\]"):
        load_background(tmp_path / "wall.npy", CAMERA)


@pytest.mark.parametrize(
    "name", ["missing.png", "missing.npy", "text.png", "text.npy", "empty.npy", "folder.png"]
)
def test_what_cannot_be_read_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "text.png").write_text("not an image")
    (tmp_path / "text.npy").write_text("not an array")
    (tmp_path / "empty.npy").touch()
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(SimError, match=f"cannot read the background .*{name}"):
        load_background(tmp_path / name, CAMERA)


@pytest.mark.parametrize("content", [np.array(["a"] * 4), np.array([None])])
def test_an_array_that_is_not_of_numbers_is_refused(tmp_path: Path, content: np.ndarray) -> None:
    np.save(tmp_path / "wall.npy", content)
    with pytest.raises(SimError, match=r"wall\.npy"):
        load_background(tmp_path / "wall.npy", CAMERA)


def test_an_archive_of_arrays_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "wall.npy").open("wb") as file:
        np.savez(file, image=np.zeros((48, 64)))
    with pytest.raises(SimError, match=r"wall\.npy"):
        load_background(tmp_path / "wall.npy", CAMERA)


def test_images_of_floating_point_are_linear(tmp_path: Path) -> None:
    image = noise_image(CAMERA)
    cv2.imwrite(str(tmp_path / "wall.tiff"), image)
    np.testing.assert_array_equal(load_background(tmp_path / "wall.tiff", CAMERA), image)
