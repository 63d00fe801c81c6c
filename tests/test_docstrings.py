"""One dialect of docstrings: NumPy's sections, types in the signature alone."""

import ast
import re
from collections.abc import Iterator

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


def test_parameters_are_named_without_their_types() -> None:
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    typed = [
        f"{module}: {line}"
        for module, path in module_files().items()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, documented)
        for line in parameter_lines(ast.get_docstring(node) or "")
        if TYPED.fullmatch(line)
    ]
    assert not typed, "the signature has the types already"


def test_a_typed_parameter_is_found() -> None:
    doc = "Sum up.\n\nParameters\n----------\na, b : int\n    Numbers.\nc\n    One more : it.\n"
    assert [line for line in parameter_lines(doc) if TYPED.fullmatch(line)] == ["a, b : int"]
