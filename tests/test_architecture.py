"""The arrows between modules: every import of sim, ssac and experiments, against the rules."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# The order in which data flow through each package. A module imports only from those before it in
# its own package, so a new module has to be given its place here. A folder counts as one.
STAGES = {
    "sim": (
        "errors",
        "trajectory",
        "shapes",
        "drone",
        "flyers",
        "rig",
        "background",
        "lattice",
        "footprint",
        "gl_context",
        "gl_atlas",
        "render",
        "gl_reference",
        "sampling",
        "sensor_kernels",
        "sensor",
        "frames",
        "recording",
        "storage",
    ),
    "ssac": (
        "errors",
        "whole_file",
        "events",
        "camera",
        "rig_files",
        "hdf5_files",
        "text_files",
        "io",
        "denoise",
        "tracks",
        "epipolar",
        "fundamental",
        "extrinsics",
        "robust",
        "bound",
        "offset_search",
        "observability",
        "interface",
        "straight_path",
        "estimate",
        "possible_poses",
        "ambiguity",
        "covariance",
        "refinement",
        "pencil",
        "outline_kernels",
        "outline",
        "tangency",
        "uncertainty",
        "baselines",
    ),
    "experiments": (
        "measurement",
        "provenance",
        "bridge",
        "score",
        "methods",
        "load",
        "plot_data",
        "plots",
        "sync",
        "scene",
        "simulate",
        "demo",
        "fidelity",
        "grid",
        "cache",
        "run",
        "schedule",
        "tables",
        "comparison",
        "markdown",
        "results_page",
        "results",
        "check_files",
        "check",
        "figure_style",
        "figure_events",
        "figure_errors",
        "figure_beyond",
        "figure_efficiency",
        "figure_ablations",
        "figures",
        "animation",
        "animation_page",
        "report_data",
        "report_tables",
        "report_chart",
        "report",
        "sweep",
        "recording_bound",
        "efficiency",
        "ablation",
        "coverage",
        "reproduce",
        "zncc_study",
        "tangency_study",
        "refusal_flights",
        "refusal",
        "warm_up",
        "bench_sync",
        "bench_tables",
        "bench",
        "cli",
    ),
}

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
    package, stage = module.split(".")[:2]
    for line, target in imports(source):
        if target.startswith(".") or target.endswith(".*"):
            yield f"{module}:{line} imports {target}: neither relative nor star imports"
            continue
        root, _, inner = target.partition(".")
        target_stage = inner.split(".")[0]
        if root in OPENGL:
            if package != "sim" or not (stage == "render" or stage.startswith("gl_")):
                yield f"{module}:{line} imports {root}: only sim.render and sim.gl_* open OpenGL"
        elif root == package:
            if not flows(package, target_stage, stage):
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


def flows(package: str, origin: str, to: str) -> bool:
    """Return whether data flow from stage `origin` to stage `to`; `__init__` is the last of all."""
    stages = STAGES[package]
    if origin not in stages:  # a name out of the package's own __init__
        return False
    if to not in stages:  # __init__, or a module that test_every_module_has_its_place complains of
        return True
    in_same_folder = origin == to and (ROOT / package / to).is_dir()
    return in_same_folder or stages.index(origin) < stages.index(to)


def test_every_module_has_its_place() -> None:
    listed = {(package, stage) for package, stages in STAGES.items() for stage in stages}
    found = {tuple(name.split(".")[:2]) for name in module_files()}
    unlisted = {place for place in found - listed if place[1] != "__init__"}
    assert not unlisted, f"give these a place in STAGES of {Path(__file__).name}: {unlisted}"


@pytest.mark.parametrize("module", module_files())
def test_imports(module: str) -> None:
    found = list(violations(module, module_files()[module].read_text(encoding="utf-8")))
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("module", "source", "reason"),
    [
        ("sim.sensor", "import ssac", "sim does not know ssac"),
        ("sim.sensor", "from ssac.events import EVENT_DTYPE", "sim does not know ssac"),
        ("sim.sensor", "from experiments import run", "sim does not know experiments"),
        ("ssac.tracks", "import sim.rig as rig", "ssac does not know sim"),
        ("ssac.baselines.zncc", "import experiments.score", "ssac does not know experiments"),
        ("ssac.tracks", "def f():\n    from sim import rig", "ssac does not know sim"),
        ("sim.sensor", "import pyrender", "only sim.render"),
        ("sim.sensor", "from OpenGL.GL import glClear", "only sim.render"),
        ("experiments.bench", "import pyrender", "only sim.render"),
        ("sim.sensor", "from .errors import SimError", "neither relative"),
        ("sim.sensor", "from . import errors", "neither relative"),
        ("sim.sensor", "from numpy import *", "nor star"),
        ("sim.trajectory", "from sim.render import Renderer", "not to the left"),
        ("sim.trajectory", "from sim import render", "not to the left"),
        ("sim.trajectory", "import sim.trajectory", "not to the left"),
        ("sim.trajectory", "from sim import simulate", "not to the left"),
        ("ssac.estimate", "from ssac.baselines import zncc", "not to the left"),
        ("ssac.estimate", "import ssac", "not to the left"),
    ],
)
def test_a_wrong_import_is_found(module: str, source: str, reason: str) -> None:
    (found,) = violations(module, source)
    assert reason in found


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("sim.render", "import pyrender\nfrom OpenGL import GL\nimport numpy as np"),
        ("sim.gl_atlas", "import OpenGL.GL"),
        ("sim.recording", "from sim.sensor import EVENT_DTYPE\nfrom sim import rig"),
        ("sim.__init__", "from sim.recording import simulate"),
        ("ssac.baselines.zncc", "from ssac.baselines.signals import rate\nimport ssac.tracks"),
        (
            "experiments.run",
            "import sim.recording\nfrom ssac.estimate import estimate",
        ),
    ],
)
def test_a_right_import_passes(module: str, source: str) -> None:
    assert not list(violations(module, source))


def test_both_sides_have_the_same_events() -> None:
    from sim.sensor import EVENT_DTYPE as SIMULATED
    from ssac.events import EVENT_DTYPE as READ

    assert SIMULATED == READ
