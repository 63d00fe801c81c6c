"""What keys depend on: each module changed in turn, and the code that a real run calls."""

import ast
import shutil
import sys
from pathlib import Path

import pytest

from experiments.lab.cache import BRIGHTNESS_CODE, DENOISED_CODE, RECORDING_CODE, Cache
from experiments.lab.code import ROOT, SourceTree, read_source
from experiments.lab.grid import Cell
from experiments.lab.scored import SCORED
from experiments.lab.task import Task, run_task
from experiments.measures.bounds import BOUNDS
from experiments.measures.refusal import REFUSALS
from sim.recording import SimConfig
from ssac.config import Config
from ssac.pipeline.registry import OURS
from tests.experiments.reported import record_flight
from tests.recorded import kalibr_with_pose

CODES = {
    "recordings": RECORDING_CODE,
    "brightness": BRIGHTNESS_CODE,
    "denoised": DENOISED_CODE,
    "runs": SCORED.code,
    "bounds": BOUNDS.code,
    "refusals": REFUSALS.code,
}

OF_ROWS = {"runs", "bounds", "refusals"}  # which come through the pipeline

OF_EVENTS = {"brightness", "denoised"}  # which do not depend on how a recording was made


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the three packages."""
    for name in ("sim", "ssac", "experiments"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def digests(root: Path) -> dict[str, str]:
    return {name: SourceTree(root).digest(*code) for name, code in CODES.items()}


def changed_by(root: Path, path: str, old: str, new: str) -> set[str]:
    """Which keys another text of one file makes new."""
    before, file = digests(root), root / path
    text = file.read_text()
    assert old in text, path
    file.write_text(text.replace(old, new))
    after = digests(root)
    file.write_text(text)
    return {name for name in CODES if before[name] != after[name]}


def test_every_module_that_an_entry_depends_on_makes_a_new_key(tree: Path) -> None:
    before, reader = digests(tree), SourceTree(tree)
    closures = {name: SourceTree().closure(*code) for name, code in CODES.items()}
    for path in sorted(tree.rglob("*.py")):
        module = ".".join(path.relative_to(tree).with_suffix("").parts)
        module = module.removesuffix(".__init__")
        text = path.read_text()
        path.write_text(f"{text}\n_CHANGED = True\n")
        reader.sources.pop(module, None)  # what it has not read before it reads now
        after = {name: reader.digest(*code) for name, code in CODES.items()}
        path.write_text(text)
        reader.sources.pop(module, None)
        for name in CODES:
            assert (before[name] != after[name]) == (module in closures[name]), (module, name)


@pytest.mark.parametrize(
    ("path", "old", "new", "changed"),
    [
        # The two faults that the cache did not see when its keys were lists made by hand.
        ("ssac/track/clean.py", "without_noise(", "(", {"denoised", *OF_ROWS}),
        ("ssac/methods/tangency.py", 'starts_from="joint"', 'starts_from="ssac"', OF_ROWS),
        ("ssac/track/observation.py", "import", "import os\nimport", set(CODES) - {"recordings"}),
        ("ssac/track/motion.py", "import numpy", "import os\nimport numpy", OF_ROWS),
        ("ssac/pipeline/api.py", "import", "import os\nimport", set()),
        ("ssac/pipeline/many.py", "import", "import os\nimport", set()),
        ("experiments/lab/score.py", "1e3", "1e6", {"runs", "refusals"}),
        ("experiments/lab/recorded.py", "config.t_d_s", "0.0", OF_ROWS),
        ("sim/sensor/kernels.py", "import", "import os\nimport", set(CODES) - OF_EVENTS),
        ("sim/render/shaders/mesh.frag", "void", "/**/ void", set(CODES) - OF_EVENTS),
        ("sim/render/gl_reference.py", "import", "import os\nimport", set()),
        ("ssac/pipeline/plots.py", "import", "import os\nimport", set()),
        ("experiments/drawing/style.py", "import", "import os\nimport", set()),
        ("experiments/studies/coverage.py", "import", "import os\nimport", set()),
        ("experiments/measures/refusal_flights.py", "0.25", "0.5", {"refusals"}),
        # Prose changes no number.
        ("sim/recording.py", "The whole chain:", "Well, all of it:", set()),
        ("ssac/camera.py", "# ", "# Well: ", set()),
    ],
)  # fmt: skip
def test_what_matters_makes_new_keys_and_nothing_else(
    tree: Path, path: str, old: str, new: str, changed: set[str]
) -> None:
    assert changed_by(tree, path, old, new) - changed == set()
    assert changed_by(tree, path, old, new) >= changed


def test_a_name_from_a_package_counts_with_the_module_that_it_comes_from(tmp_path: Path) -> None:
    package = tmp_path / "ssac"
    package.mkdir()
    (package / "__init__.py").write_text("from ssac.one import first\nfrom ssac.two import second")
    (package / "one.py").write_text("first = 1")
    (package / "two.py").write_text("second = 2")
    (package / "user.py").write_text("from ssac import first")
    (package / "lazy.py").write_text('MODULES = {"second": "ssac.two:second"}')
    (package / "dynamic.py").write_text("from ssac import third")
    (package / "folder").mkdir()
    (package / "folder" / "__init__.py").write_text("")
    (package / "folder" / "inner.py").write_text("from ssac.one import first")
    (package / "all.py").write_text('FOLDER = "ssac.folder"')
    tree = SourceTree(tmp_path)
    assert tree.closure("ssac.user") == {"ssac.user", "ssac", "ssac.one"}
    folder = {"ssac.folder", "ssac.folder.inner"}
    assert tree.closure("ssac.all") == {"ssac.all", *folder, "ssac.one"}
    assert tree.closure("ssac.lazy") == {"ssac.lazy", "ssac.two"}
    assert tree.closure("ssac.dynamic") >= {"ssac.one", "ssac.two", "ssac.lazy"}


def test_a_row_depends_on_what_its_pipeline_calls_and_on_nothing_else_of_it() -> None:
    row = SourceTree().closure(*SCORED.code)
    assert {name for name in row if name.startswith("ssac.pipeline.")} == {
        f"ssac.pipeline.{file}" for file in ("registry", "answer", "chain")
    }
    others = {name for name in row if name.startswith(("ssac.cli.", "ssac.network"))}
    assert others <= {"ssac.cli.progress"}
    assert "ssac.track.silhouette" not in row
    # Whatever method a row asks for is named in no import of it.
    methods = ("algorithms", "joint", "tangency", "albl", "correlations")
    assert {f"ssac.methods.{name}" for name in methods} <= row
    assert {"ssac.files.rigs", "ssac.files.hdf5"} <= row
    assert not row & {"ssac.files.event_files", "ssac.files.text", "ssac.files.makers"}


def test_how_an_object_moves_is_no_matter_of_what_is_left_without_noise() -> None:
    assert not {name for name in SourceTree().closure(*DENOISED_CODE) if "motion" in name}


def test_prose_does_not_count_but_code_does() -> None:
    base = read_source("def f(x):\n    return x + 1\n").digest
    assert read_source('"""A."""\ndef f(x):  # b\n    """C."""\n    return x + 1').digest == base
    assert read_source("def f(x):\n    return x + 2\n").digest != base


def test_packages_only_list_names() -> None:
    """So that what is not taken from an `__init__` need not count."""
    allowed = (ast.Import, ast.ImportFrom, ast.Assign, ast.Expr, ast.AnnAssign, ast.FunctionDef,
               ast.If)  # fmt: skip
    for package in ("sim", "ssac", "experiments"):
        for path in (ROOT / package).rglob("__init__.py"):
            body = ast.parse(path.read_text()).body
            assert all(isinstance(line, allowed) for line in body), path


def test_all_code_that_a_run_calls_is_in_its_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever way it is imported: a call that the imports do not show would be seen here."""
    folder = tmp_path / "recording"
    scene = record_flight(folder, 4.0)
    (folder / "rig_extrinsics.yaml").write_text(kalibr_with_pose(scene.R, scene.t))
    monkeypatch.setattr(Cache, "recording_folder", lambda *_: folder)
    config = Config(interval_s=(-0.1, 0.1), denoise=False)
    cells = [Cell(SimConfig(), 0, 0, 0.0, config, method.name, {}) for method in OURS]
    cells += [Cell(SimConfig(), 0, 0, 0.0, Config(interval_s=(-0.1, 0.1)), "zncc_e", {})]
    called: set[str] = set()
    sys.setprofile(lambda frame, event, _: called.add(frame.f_code.co_filename))
    try:
        done = run_task(Task(tuple(cells)), Cache(tmp_path / "cache"), SCORED)
    finally:
        sys.setprofile(None)
    assert {row["status"] for row in done.rows} <= {"ok", "skipped", "ambiguous_pose"}, done.rows
    ours = {
        ".".join(Path(file).relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for file in called
        if any(file.startswith(f"{ROOT / package}/") for package in ("sim", "ssac", "experiments"))
    }
    assert {"ssac.methods.tangency", "experiments.lab.score", "ssac.track.denoise"} <= ours
    # What names and keeps the entries is no part of them.
    keeping = {f"experiments.lab.{name}" for name in ("code", "pool", "task")}
    assert ours - keeping - SourceTree().closure(*SCORED.code) == set()
