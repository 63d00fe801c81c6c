"""The arrows between modules: every import of sim, ssac and experiments, against the rules."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.stages import STAGES

ROOT = Path(__file__).resolve().parents[1]

# What each package may import of the other two.
MAY_IMPORT = {"sim": set(), "ssac": set(), "experiments": {"sim", "ssac"}}

OPENGL = {"pyrender", "OpenGL", "pyglet"}


def module_files() -> dict[str, Path]:
    """Return every module of the three packages by its dotted name, `__init__` included."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): path
        for package in STAGES
        for path in sorted((ROOT / package).rglob("*.py"))
    }


def violations(module: str, source: str) -> Iterator[str]:
    """Yield one line for each import in `source` that `module` (a dotted name) may not make."""
    package = module.split(".")[0]
    for line, target in imports(source):
        if target.startswith(".") or target.endswith(".*"):
            yield f"{module}:{line} imports {target}: neither relative nor star imports"
            continue
        root = target.split(".")[0]
        if root in OPENGL:
            if not module.startswith("sim.render."):
                yield f"{module}:{line} imports {root}: only sim.render opens OpenGL"
        elif root == package:
            if not flows(target, module):
                yield f"{module}:{line} imports {target}, which is not to the left of it in STAGES"
        elif root in STAGES and root not in MAY_IMPORT[package]:
            yield f"{module}:{line} imports {target}: {package} does not know {root}"


def imports(source: str) -> Iterator[tuple[int, str]]:
    """Yield (line, dotted target) of every import, those within functions included."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            origin = "." * node.level + (node.module or "")
            for alias in node.names:
                yield node.lineno, f"{origin}.{alias.name}"


def flows(origin: str, to: str) -> bool:
    """Return whether data flow from a dotted import target to a module.

    A package's or folder's own `__init__` is the last of it, as it lists what the others define.
    """
    package = to.split(".")[0]
    floors = list(STAGES[package])
    (floor, file), (to_floor, to_file) = place(origin), place(to)
    if floor not in floors:  # a name out of the package's own __init__
        return False
    if to_floor == "__init__":
        return True
    if floor != to_floor:
        return to_floor not in floors or floors.index(floor) < floors.index(to_floor)
    files = STAGES[package][floor]
    if file not in files:  # a name out of the folder's own __init__
        return False
    return to_file not in files or files.index(file) < files.index(to_file)


def place(name: str) -> tuple[str, str]:
    """Floor and file of a dotted name; empty where it names none."""
    parts = [*name.split("."), "", ""]
    return parts[1], parts[2]


def test_every_module_has_its_place_and_every_place_a_module() -> None:
    listed = {
        f"{package}.{floor}" + (f".{file}" if file else "")
        for package, floors in STAGES.items()
        for floor, files in floors.items()
        for file in files or ("",)
    }
    found = {name for name in module_files() if not name.endswith("__init__")}
    here = "STAGES of tests/stages.py"
    assert not found - listed, f"give these a place in {here}: {sorted(found - listed)}"
    assert not listed - found, f"these are in {here} and nowhere else: {sorted(listed - found)}"


def test_folders_are_two_levels() -> None:
    deeper = [name for name in module_files() if name.count(".") > 2]
    assert not deeper, f"folders have two levels: {deeper}"


@pytest.mark.parametrize("module", module_files())
def test_imports(module: str) -> None:
    found = list(violations(module, module_files()[module].read_text(encoding="utf-8")))
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("module", "source", "reason"),
    [
        ("sim.sensor.events", "import ssac", "sim does not know ssac"),
        ("sim.sensor.events", "from ssac.events import EVENT_DTYPE", "sim does not know ssac"),
        ("sim.sensor.events", "from experiments import run", "sim does not know experiments"),
        ("ssac.track.motion", "import sim.scene.rig as rig", "ssac does not know sim"),
        ("ssac.pipeline.api", "from sim.recording import simulate", "ssac does not know sim"),
        ("ssac.pipeline.api", "import experiments.run.score", "ssac does not know experiments"),
        ("ssac.track.motion", "def f():\n    from sim import scene", "ssac does not know sim"),
        ("sim.sensor.events", "import pyrender", "only sim.render"),
        ("sim.sensor.events", "from OpenGL.GL import glClear", "only sim.render"),
        ("experiments.bench.bench", "import pyrender", "only sim.render"),
        ("sim.sensor.events", "from .kernels import follow", "neither relative"),
        ("sim.sensor.events", "from . import kernels", "neither relative"),
        ("sim.sensor.events", "from numpy import *", "nor star"),
        ("sim.scene.trajectory", "from sim.render.renderer import Renderer", "not to the left"),
        ("sim.scene.trajectory", "from sim import render", "not to the left"),
        ("sim.scene.trajectory", "import sim.scene.trajectory", "not to the left"),
        ("sim.scene.trajectory", "import sim.scene.drone", "not to the left"),
        ("sim.scene.drone", "from sim.scene import Drone", "not to the left"),
        ("sim.scene.trajectory", "from sim import simulate", "not to the left"),
        ("ssac.methods.joint", "from ssac.pipeline import chain", "not to the left"),
        ("ssac.methods.joint", "from ssac.methods.tangency import tangency", "not to the left"),
        ("ssac.methods.joint", "from ssac.pipeline.registry import METHODS", "not to the left"),
        ("ssac.estimate", "import ssac", "not to the left"),
    ],
)
def test_a_wrong_import_is_found(module: str, source: str, reason: str) -> None:
    (found,) = violations(module, source)
    assert reason in found


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("sim.render.renderer", "import pyrender\nfrom OpenGL import GL\nimport numpy as np"),
        ("sim.render.gl_atlas", "import OpenGL.GL"),
        ("sim.recording", "from sim.sensor.events import EVENT_DTYPE\nfrom sim.scene import rig"),
        ("sim.__init__", "from sim.recording import simulate"),
        ("sim.sensor.__init__", "from sim.sensor.events import Sensor"),
        ("ssac.methods.zncc_e", "from ssac.methods.event_rate import rate"),
        (
            "experiments.run.task",
            "import sim.recording\nfrom ssac.methods.algorithms import algorithm_1",
        ),
    ],
)
def test_a_right_import_passes(module: str, source: str) -> None:
    assert not list(violations(module, source))


def test_both_sides_have_the_same_events() -> None:
    from sim.sensor.kernels import EVENT_DTYPE as SIMULATED
    from ssac.events import EVENT_DTYPE as READ

    assert SIMULATED == READ
