"""One dialect of docstrings: NumPy's sections, types in the signature alone."""

import ast
import re
from collections.abc import Iterator

import pytest

from tests.test_architecture import module_files

TYPED = re.compile(r"\*{0,2}\w+(, \*{0,2}\w+)* : .+")


def parameter_lines(doc: str) -> Iterator[str]:
    """Yield the lines of a docstring's Parameters that name one."""
    lines = doc.split("\n")
    inside = False
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        if re.fullmatch(r"-{3,}", following):
            inside = line == "Parameters"
        elif inside and line and not line.startswith((" ", "---")):
            yield line


@pytest.mark.parametrize("module", module_files())
def test_parameters_are_named_without_their_types(module: str) -> None:
    tree = ast.parse(module_files()[module].read_text(encoding="utf-8"))
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docs = (ast.get_docstring(node) for node in ast.walk(tree) if isinstance(node, documented))
    typed = [line for doc in docs if doc for line in parameter_lines(doc) if TYPED.fullmatch(line)]
    assert not typed, f"{module}: the signature has the types already: {typed}"


def test_a_typed_parameter_is_found() -> None:
    doc = "Sum up.\n\nParameters\n----------\na, b : int\n    Numbers.\nc\n    One more : it.\n"
    assert [line for line in parameter_lines(doc) if TYPED.fullmatch(line)] == ["a, b : int"]
