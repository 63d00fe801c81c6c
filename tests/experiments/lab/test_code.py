"""The code in cache keys: which edits change which keys, and which code a real run calls."""

import ast
import shutil
import sys
from pathlib import Path

import pytest

from experiments.lab.cache import RECORDING_CODE, Cache
from experiments.lab.code import ROOT, SourceTree, code_of
from experiments.lab.grid import Cell
from experiments.lab.results import save_text
from experiments.lab.schedule import run_task
from experiments.lab.scored import SCORED
from experiments.studies import all_studies
from sim.recording import SimConfig
from ssac.config import Config
from ssac.pipeline.registry import OURS
from tests.experiments.reported import record_flight


def code_of_study(name):
    study = all_studies()[name]
    measure = study.measure
    return code_of(measure.load, measure.row, measure.row_type, type(study.cells()[0]))


CODES = {
    "recordings": RECORDING_CODE,
    "runs": code_of_study("tables"),
    "bounds": code_of_study("efficiency"),
    "refusals": code_of_study("refusal"),
}

OF_ROWS = {"runs", "bounds", "refusals"}  # keys of rows, which the pipeline computes


def digests(root):
    tree = SourceTree(root)
    return {name: tree.digest(*code) for name, code in CODES.items()}


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """Return a copy of the three packages and its digests; tests undo their edits of the copy."""
    root = tmp_path_factory.mktemp("tree")
    for name in ("sim", "ssac", "experiments"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    return root, digests(root)


@pytest.mark.parametrize(
    ("path", "old", "new", "changed"),
    [
        # Two edits that keys from hand-made lists of modules would miss.
        ("ssac/track/clean.py", "without_noise(", "(", OF_ROWS),
        ("ssac/methods/tangency.py", 'starts_from="joint"', 'starts_from="ssac"', OF_ROWS),
        ("ssac/track/observation.py", "import", "import os\nimport", OF_ROWS),
        ("ssac/pipeline/api.py", "import", "import os\nimport", set()),
        ("sim/sensor/kernels.py", "import", "import os\nimport", set(CODES)),
        ("sim/render/shaders/mesh.frag", "void", "/**/ void", set(CODES)),
        ("experiments/lab/score.py", "1e3", "1e6", {"runs"}),
        ("experiments/lab/recorded.py", 'name=""', 'name="a"', OF_ROWS),
        # Edits of the cache, checksums, the schedule or a summary change no number.
        ("experiments/lab/cache.py", "while not", "while 1 and not", set()),
        ("experiments/lab/results.py", "DPI = 220", "DPI = 240", set()),
        ("experiments/lab/schedule.py", "MAX_DEATHS = 2", "MAX_DEATHS = 3", set()),
        ("experiments/studies/efficiency.py", '"n_runs"', '"runs"', set()),
    ],
)  # fmt: skip
def test_what_matters_makes_new_keys_and_nothing_else(tree, path, old, new, changed):
    root, before = tree
    text = (root / path).read_text()
    assert old in text
    (root / path).write_text(text.replace(old, new))
    after = digests(root)
    (root / path).write_text(text)
    found = {name for name in CODES if before[name] != after[name]}
    # Rows of other studies may use the same code as "runs".
    assert changed <= found <= (OF_ROWS if changed == {"runs"} else changed)


STUDY = '''
"""A study."""
from dataclasses import dataclass
from ssac.one import first, second

N = 3
FEW = 4
LOOKS = {"a": 1}

@dataclass(frozen=True)
class Row:
    status: str

def load(cells, cache: "Cache"):
    return helper(N)

def helper(n: int = FEW) -> "Unknown":
    return first(n)

def row(cell, loaded):
    return Row(LOOKS[cell])

def table(runs):
    return second(runs)

SHOWN = [cell for cell in "ab"]

LOOKS.update(b=2)
SIZE = 5
for one in "cd":
    LOOKS[one] = SIZE

@register
def other():
    return 0

@with_options({})
def command():
    return 1
'''


@pytest.mark.parametrize(
    ("old", "new", "counts"),
    [
        ("N = 3", "N = 30", True),
        ("FEW = 4", "FEW = 40", True),  # a default of a function that is reached
        ('"a": 1', '"a": 10', True),
        ("first(n)", "first(n + 1)", True),
        ("status: str", "status: bytes", True),
        ("b=2", "b=20", True),  # binds no name: it always counts
        ("SIZE = 5", "SIZE = 50", True),  # so does a loop
        ("return 0", "return 2", True),  # and what a decorator may register ...
        ("return 1", "return 2", False),  # ... but one of options does not
        ("second(runs)", "second(2 * runs)", False),
        ('"ab"', '"abc"', False),  # a comprehension's own variable, named as an argument is
        ('cache: "Cache"', "cache: object", False),
        ('"""A study."""', '"""Another study."""\n# Well:', False),
    ],
)
def test_of_a_study_the_definitions_count_that_measure_reaches(tmp_path, old, new, counts):
    assert old in STUDY
    starts = [f"experiments.study:{name}" for name in ("load", "row", "Row")]
    found = set()
    for text in (STUDY, STUDY.replace(old, new)):
        save_text(tmp_path / "ssac" / "one.py", "first = 1\nsecond = 2\n")
        save_text(tmp_path / "experiments" / "study.py", text)
        found.add(SourceTree(tmp_path).digest(*starts))
    assert (len(found) == 2) == counts


def test_a_package_counts_with_all_that_it_imports_and_a_named_folder_with_all_in_it(tmp_path):
    package = {
        "__init__.py": "from ssac.one import first\nfrom ssac.two import second",
        "one.py": "first = 1",
        "two.py": "second = 2",
        "user.py": "from ssac import first",
        "lazy.py": 'MODULES = {"second": "ssac.two:second"}',
        "folder/__init__.py": "",
        "folder/inner.py": "from ssac.one import first",
        "all.py": 'FOLDER = "ssac.folder"',
    }
    for name, text in package.items():
        save_text(tmp_path / "ssac" / name, text)
    reached = SourceTree(tmp_path).closure
    assert reached("ssac.user") == {"ssac.user", "ssac", "ssac.one", "ssac.two"}
    assert reached("ssac.all") == {"ssac.all", "ssac.folder", "ssac.folder.inner", "ssac.one"}
    assert reached("ssac.lazy") == {"ssac.lazy", "ssac.two"}


def test_packages_only_list_names():
    """So an `__init__` need not count where no name is imported from it."""
    allowed = (ast.Import, ast.ImportFrom, ast.Assign, ast.Expr, ast.AnnAssign, ast.FunctionDef,
               ast.If)  # fmt: skip
    for package in ("sim", "ssac", "experiments"):
        for path in (ROOT / package).rglob("__init__.py"):
            body = ast.parse(path.read_text()).body
            assert all(isinstance(line, allowed) for line in body), path


def test_no_measure_reaches_a_drawing_and_that_of_the_tables_no_network_plot_or_command():
    """So an edit of a drawing makes no row new."""
    names = [name for name, study in all_studies().items()
             if study.runs.file and not study.options and study.cells()]  # fmt: skip
    reached = SourceTree().closure(*(code for name in names for code in code_of_study(name)))
    assert not {one for one in reached if one.startswith("experiments.drawing")}
    row = SourceTree().closure(*CODES["runs"])
    assert not {name for name in row if set(name.split(".")) & {"network", "plots", "cli"}}


def test_all_code_that_a_run_calls_is_in_its_key(tmp_path, monkeypatch):
    """The test would also find a call of code that no import statement shows."""
    folder = tmp_path / "recording"
    record_flight(folder, 4.0)
    monkeypatch.setattr(Cache, "recording_folder", lambda *_: folder)
    config = Config(interval_s=(-0.1, 0.1), denoise=False)
    cells = [Cell(SimConfig(), 0, 0, 0.0, config, method.name, {}) for method in OURS]
    cells += [Cell(SimConfig(), 0, 0, 0.0, Config(interval_s=(-0.1, 0.1)), "zncc_e", {})]
    called = set()

    def note(frame, event, _):
        called.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

    sys.setprofile(note)
    try:
        done = run_task(tuple(cells), Cache(tmp_path / "cache"), SCORED)
    finally:
        sys.setprofile(None)
    assert {row["status"] for row in done.rows} <= {"ok", "skipped", "ambiguous_pose"}, done.rows
    packages = tuple(f"{ROOT / name}/" for name in ("sim", "ssac", "experiments"))
    ours = {defined_at(Path(file), line) for file, line in called if file.startswith(packages)}
    assert {"ssac.methods.tangency", "ssac.track.denoise"} <= ours
    assert "experiments.lab.score:pose_score" in ours
    # The code that names, runs and stores the entries does not affect their content.
    keeping = tuple(f"experiments.lab.{file}:" for file in ("cache", "code", "results", "schedule"))
    missed = ours - SourceTree().closure(*CODES["runs"])
    assert not {name for name in missed if not name.startswith(keeping)}


def defined_at(path, line):
    """Name the module of a line; within `experiments`, also the top-level definition around it."""
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    if not module.startswith("experiments"):
        return module
    for node in ast.parse(path.read_text()).body:
        first = min([node.lineno, *(one.lineno for one in getattr(node, "decorator_list", []))])
        if first <= line <= (node.end_lineno or 0):
            return f"{module}:{node.name}"
    return module
