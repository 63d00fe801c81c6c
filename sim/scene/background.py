"""The luminance of the empty scene: an even sky, or an image."""

from pathlib import Path

import cv2
import numpy as np

from sim.arrays import Float32Array, FloatArray
from sim.errors import SimError
from sim.scene.rig import Camera

LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # of linear R, G, B (Rec. 709)


def linear_from_srgb(srgb: FloatArray) -> FloatArray:
    """Undo the transfer function of IEC 61966-2-1; both values and light are 0 to 1."""
    linear: FloatArray = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return linear


def uniform_background(camera: Camera, luminance: float) -> Float32Array:
    """Return an even sky, (height, width); SimError when its luminance is not in [0, 1]."""
    if not 0.0 <= luminance <= 1.0:
        raise SimError(f"background luminance: expected 0 to 1, got {luminance}")
    return np.full((camera.height, camera.width), luminance, np.float32)


def load_background(path: Path, camera: Camera) -> Float32Array:
    """Read the linear luminance (height, width) of a static image that fills the camera's view.

    An integer image that OpenCV reads is taken as sRGB; a `.npy` file or a floating-point image
    holds linear light in [0, 1]. SimError when it cannot be read, has another size than the
    camera, or values outside [0, 1].
    """
    luminance = _load_array(path) if path.suffix == ".npy" else _load_image(path)
    wanted = (camera.height, camera.width)
    if luminance.shape != wanted:
        size = " x ".join(str(n) for n in luminance.shape[::-1])
        raise SimError(
            f"background {path}: expected {camera.width} x {camera.height} pixels as the camera "
            f"{camera.name} has, got {size}: resize the image"
        )
    if not (luminance.min() >= 0.0 and luminance.max() <= 1.0):  # NaN fails too
        raise SimError(
            f"background {path}: expected linear luminance in [0, 1], got "
            f"{luminance.min()} to {luminance.max()}"
        )
    return luminance


def _load_array(path: Path) -> Float32Array:
    try:
        luminance: Float32Array = np.asarray(np.load(path)).astype(np.float32, casting="same_kind")
        return np.ascontiguousarray(luminance)
    except (OSError, ValueError, TypeError, EOFError) as error:
        # NumPy raises TypeError for records and complex numbers, EOFError for an empty file.
        raise SimError(f"cannot read the background {path}: {error}") from error


def _load_image(path: Path) -> Float32Array:
    if not path.is_file():
        raise SimError(f"cannot read the background {path}: there is no such file")
    try:
        image = cv2.imread(str(path), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error as error:  # too many pixels for OpenCV
        raise SimError(f"cannot read the background {path}: {error.err}") from error
    if image is None:
        raise SimError(f"cannot read the background {path}: it is not an image")
    if image.ndim == 3 and (image == image[..., :1]).all():  # a grey one that is stored as colours
        image = image[..., 0]
    light = image.astype(np.float64)
    if image.dtype.kind != "f":  # HDR formats hold linear light
        light = linear_from_srgb(light / (255 if image.dtype == np.uint8 else 65535))
    if light.ndim == 3:
        light = light[..., ::-1] @ LUMINANCE_WEIGHTS  # OpenCV's order is B, G, R
    return np.ascontiguousarray(light, np.float32)
