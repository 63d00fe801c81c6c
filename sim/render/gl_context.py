"""The GL context that everything is drawn in: OSMesa where the system has it, EGL otherwise.

PyOpenGL binds to one platform when first imported: a process has one backend, and here one context.
"""

import ctypes.util
import os
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from sim.errors import SimError

BACKENDS = {"osmesa": "OSMesa", "egl": "EGL"}
"""The backends and their libraries, in order of preference."""

_OR_WITHOUT = "or use --no-check with --renderer native"


@dataclass(frozen=True)
class GLContext:
    """The open context, as it is written beside every result."""

    backend: str  # "osmesa" or "egl"
    renderer: str  # the driver's own name
    version: str  # of OpenGL and the driver


def check_backend(backend: str) -> None:
    """Raise SimError unless a backend is "auto" or has one of the names of `BACKENDS`."""
    if backend not in ("auto", *BACKENDS):
        raise SimError(f"GL backend: expected auto, osmesa or egl, got {backend!r}")


def open_context(backend: str = "auto") -> GLContext:
    """Open the GL context of this process, or return the one that is open.

    SimError without a usable GL library, or when this process draws with the other backend.
    """
    check_backend(backend)
    bound = os.environ.get("PYOPENGL_PLATFORM")  # set below, or by the user
    chosen = bound if bound in BACKENDS else _first_available() if backend == "auto" else backend
    if backend not in ("auto", chosen):
        raise SimError(
            f"GL backend {backend}: this process already draws with {chosen}; "
            "use the other backend in a process of its own"
            if _KEEP_ALIVE
            else f"GL backend {backend}: PYOPENGL_PLATFORM is {chosen}: unset it, or set {backend}"
        )
    return _open(chosen)


def context_or_none() -> GLContext | None:
    """Open the GL context of this process; None if it cannot be opened."""
    try:
        return open_context()
    except SimError:
        return None


def _first_available() -> str:
    for backend, library in BACKENDS.items():
        if ctypes.util.find_library(library):
            return backend
    raise SimError(
        "no GL library on this machine: install one with "
        "`apt-get install libosmesa6` or `apt-get install libegl1 libgl1 libegl-mesa0`, "
        + _OR_WITHOUT
    )


@cache
def _open(backend: str) -> GLContext:
    os.environ["PYOPENGL_PLATFORM"] = backend
    os.environ.setdefault("PYGLET_HEADLESS", "1")  # pyglet 2 otherwise looks for a display
    # Mesa's rasteriser threads do not scale; processes do, and each should keep to its core.
    os.environ.setdefault("LP_NUM_THREADS", "0")
    np.infty = np.inf  # type: ignore[attr-defined]  # noqa: NPY201  # pyrender predates NumPy 2
    try:
        import OpenGL.contextdata
        from OpenGL import GL
        from pyrender.offscreen import OffscreenRenderer

        # pyrender's shader cache keys on this; under OSMesa it is a new pointer at each call, so
        # that every frame compiles its shaders anew and leaks them.
        OpenGL.contextdata.getContext = lambda context=None: 1
        _KEEP_ALIVE.append(OffscreenRenderer(1, 1))
        about = (GL.glGetString(of).decode() for of in (GL.GL_RENDERER, GL.GL_VERSION))
        return GLContext(backend, *about)
    except ModuleNotFoundError as error:
        raise SimError(
            f"pyrender, which draws with OpenGL, is not installed ({error}): install it, "
            + _OR_WITHOUT
        ) from error
    except Exception as error:  # whatever the driver, PyOpenGL or ctypes raise
        raise SimError(
            f"cannot open a GL context with {backend} ({type(error).__name__}: {error}): "
            "install libosmesa6, or libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri, " + _OR_WITHOUT
        ) from error


_KEEP_ALIVE: list[Any] = []
