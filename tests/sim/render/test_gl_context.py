import ctypes.util
import os
import subprocess
import sys

import pytest

from sim.errors import SimError
from sim.render import gl_context
from sim.render.gl_context import BACKENDS, open_context


@pytest.fixture
def no_context(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that has not chosen a backend yet."""
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)


def opened_elsewhere(code: str, **environment: str) -> str:
    """Run code in a process of its own and return what it prints."""
    settings = {k: v for k, v in os.environ.items() if k != "PYOPENGL_PLATFORM"} | environment
    command = [sys.executable, "-c", "from sim.render.gl_context import open_context\n" + code]
    done = subprocess.run(command, env=settings, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.render
def test_the_context_says_what_it_is() -> None:
    context = open_context()
    assert context.backend in BACKENDS
    assert context.renderer
    assert context.version
    assert open_context() is context
    assert open_context(context.backend) is context


@pytest.mark.render
def test_one_process_one_backend() -> None:
    used = open_context().backend
    (other,) = set(BACKENDS) - {used}
    with pytest.raises(
        SimError, match=f"GL backend {other}: this process already draws with {used}"
    ):
        open_context(other)


@pytest.mark.render
def test_the_user_may_have_chosen_beforehand() -> None:
    used = open_context().backend
    code = "print(open_context().backend)"
    assert opened_elsewhere(code, PYOPENGL_PLATFORM=used) == used


@pytest.mark.usefixtures("no_context")
def test_osmesa_comes_first_and_egl_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl_context, "_open", lambda backend: backend)
    installed = {"OSMesa", "EGL"}
    monkeypatch.setattr(
        ctypes.util, "find_library", lambda name: f"lib{name}.so" if name in installed else None
    )
    assert open_context() == "osmesa"
    installed.remove("OSMesa")
    assert open_context() == "egl"


@pytest.mark.usefixtures("no_context")
def test_a_machine_without_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    with pytest.raises(SimError, match="no GL library on this machine: install one with"):
        open_context()


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_library_that_does_not_load(backend: str) -> None:
    """A driver that is asked for by name and missing, or broken, is one clear line."""
    code = (
        "import ctypes, ctypes.util\n"
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
    said = opened_elsewhere(code)
    assert said.startswith(f"cannot open a GL context with {backend} (")
    assert "install libosmesa6, or libegl1" in said
    assert "\n" not in said
