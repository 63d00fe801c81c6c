"""What docs/security.md says, read off the code: nothing in a data file is ever run, or a path."""

import ast
from pathlib import Path

import pytest

from ssac.files.rigs import load_rig
from tests.test_architecture import ROOT, module_files

UNSAFE_MODULES = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "runpy"}
UNSAFE_CALLS = {"eval", "exec", "compile", "__import__"}
UNSAFE_YAML = {"load", "load_all", "unsafe_load", "full_load", "UnsafeLoader", "FullLoader"}


def faults(source: str):
    """Yield what of a module could run what stands in a file."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.split(".")[0] in UNSAFE_MODULES)
        elif isinstance(node, ast.ImportFrom):
            if (node.module or "").split(".")[0] in UNSAFE_MODULES:
                yield node.module
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id in UNSAFE_CALLS:
                yield node.func.id
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.value.id == "yaml" and node.attr in UNSAFE_YAML:
                yield f"yaml.{node.attr}"
            if node.value.id == "os" and node.attr in {"system", "popen"}:
                yield f"os.{node.attr}"
        elif isinstance(node, ast.keyword) and (
            node.arg in {"allow_pickle", "shell"}
            and not (isinstance(node.value, ast.Constant) and node.value.value is False)
        ):
            yield node.arg


def test_no_module_runs_what_stands_in_a_file() -> None:
    sources = {name: path.read_text(encoding="utf-8") for name, path in module_files().items()}
    assert not {name: found for name, source in sources.items() if (found := [*faults(source)])}


@pytest.mark.parametrize(
    "line",
    [
        "import pickle",
        "from joblib import load",
        "eval(text)",
        "yaml.load(text)",
        "np.load(path, allow_pickle=True)",
        "subprocess.run(text, shell=True)",
        "os.system(text)",
    ],
)
def test_it_would_be_seen(line: str) -> None:
    assert list(faults(line))


def test_a_rig_constructs_no_objects(tmp_path: Path) -> None:
    made = tmp_path / "made"
    (tmp_path / "rig.yaml").write_text(f"cam0: !!python/object/apply:os.mkdir ['{made}']\n")
    with pytest.raises(ValueError, match=r"rig\.yaml: not a readable YAML file"):
        load_rig(tmp_path / "rig.yaml")
    assert not made.exists()


def test_a_rig_that_grows_without_end_is_one_short_error(tmp_path: Path) -> None:
    levels = "".join(f"a{k}: &a{k} [{', '.join(9 * [f'*a{k - 1}'])}]\n" for k in range(1, 12))
    text = f"a0: &a0 [1]\n{levels}cam0: &cam\n  camera_model: pinhole\n  intrinsics: *a11\n"
    text += "  distortion_model: none\n  resolution: [346, 260]\ncam1: *cam\n"
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(ValueError, match="cam0, intrinsics: expected 4 finite") as raised:
        load_rig(tmp_path / "rig.yaml")
    assert len(str(raised.value)) < 1000


def test_the_page_names_what_is_read() -> None:
    text = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
    for suffix in (".h5", ".raw", ".dat", ".es", ".aedat4", ".csv", ".yaml", ".toml"):
        assert suffix in text
