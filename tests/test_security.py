"""Tests the code for what docs/security.md says: nothing in a data file is ever executed."""

import re
import subprocess
import sys

import pytest

from ssac.files.rigs import load_rig
from tests.test_architecture import ROOT, module_files

RULES = "TID251,S102,S307,S506,S602,S604,S605"
BANNED = (
    "pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "runpy", "os.popen",
    "yaml.load_all", "yaml.unsafe_load", "yaml.full_load", "yaml.UnsafeLoader", "yaml.FullLoader",
)  # fmt: skip
OTHERS = re.compile(r"(?<![.\w])(?:compile|__import__)\(|allow_pickle=(?!False)")


def faults(*arguments, source=""):
    banned = ", ".join(f'"{name}" = {{ msg = "unsafe" }}' for name in BANNED)
    config = f"lint.flake8-tidy-imports.banned-api = {{ {banned} }}"
    command = [sys.executable, "-m", "ruff", "check", "--quiet", "--select", RULES]
    done = subprocess.run(
        [*command, "--config", config, *arguments], cwd=ROOT, input=source, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout + "".join(OTHERS.findall(source))


def test_no_module_runs_what_stands_in_a_file():
    assert faults("sim", "ssac", "experiments") == ""
    paths = module_files().values()
    assert not [path for path in paths if OTHERS.search(path.read_text(encoding="utf-8"))]


@pytest.mark.parametrize(
    "line",
    [
        "import pickle",
        "from joblib import load",
        "eval(text)",
        "compile(text, '', 'exec')",
        "import yaml; yaml.load(text)",
        "np.load(path, allow_pickle=True)",
        "import subprocess; subprocess.run(text, shell=True)",
        "import os; os.system(text)",
    ],
)
def test_it_would_be_seen(line):
    assert faults("--stdin-filename", "ssac/new.py", "-", source=line)


def test_a_rig_constructs_no_objects(tmp_path):
    made = tmp_path / "made"
    (tmp_path / "rig.yaml").write_text(f"cam0: !!python/object/apply:os.mkdir ['{made}']\n")
    with pytest.raises(ValueError, match=r"rig\.yaml: not a readable YAML file"):
        load_rig(tmp_path / "rig.yaml")
    assert not made.exists()


def test_a_rig_that_grows_without_end_is_one_short_error(tmp_path):
    levels = "".join(f"a{k}: &a{k} [{', '.join(9 * [f'*a{k - 1}'])}]\n" for k in range(1, 12))
    text = f"a0: &a0 [1]\n{levels}cam0: &cam\n  camera_model: pinhole\n  intrinsics: *a11\n"
    text += "  distortion_model: none\n  resolution: [346, 260]\ncam1: *cam\n"
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(ValueError, match="cam0, intrinsics: expected 4 finite") as raised:
        load_rig(tmp_path / "rig.yaml")
    assert len(str(raised.value)) < 1000
