"""The names that `from ssac import ...` gives, each imported when it is first asked for."""

import ast
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import ssac


@pytest.mark.parametrize("name", ssac.__all__)
def test_a_public_name_is_what_its_module_defines(name: str) -> None:
    value = getattr(ssac, name)
    assert getattr(value, "__name__", name) == name
    assert name in dir(ssac)


def test_types_are_checked_against_the_same_modules() -> None:
    tree = ast.parse(Path(str(ssac.__file__)).read_text(encoding="utf-8"))
    typed = {
        alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    homes = {name: home for home, names in ssac._HOMES.items() for name in names.split()}
    assert typed == homes
    assert sorted(homes) == sorted([*ssac.__all__, "ssac"])


def test_the_name_of_the_module_is_left_alone() -> None:
    """The paper's method has the module's name, and is asked for as `ssac.ssac`."""
    names: dict[str, object] = {}
    exec("import ssac\nfrom ssac import *", names)
    assert names["ssac"] is ssac
    assert callable(ssac.ssac)


def test_the_version_is_that_of_the_distribution() -> None:
    assert ssac.__version__ == version("ssac-suite")


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'jiont'"):
        ssac.jiont  # noqa: B018


def test_the_package_alone_imports_no_compiler_and_no_solver() -> None:
    code = "import sys, ssac; print(*{name.partition('.')[0] for name in sys.modules})"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numba", "scipy", "cv2", "pandas", "matplotlib"} & set(shown.stdout.split())
