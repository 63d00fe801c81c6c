"""What a recording or a row depends on: the digest of the code that makes it.

Nobody keeps a list that could miss a file: what code depends on is read off its imports and names,
and theirs, and so on. Of `sim` and `ssac` whole modules count. Of `experiments` only the top-level
definitions count that are reached by name from those that measure, so that measure, summary and
drawing of a study may share a file, and a change of a lock or a checksum makes no row anew.

Beside imports count modules and definitions that are named in a string, as lazy imports name them,
and the data files that lie beside a module (shaders, tables). Comments, docstrings and annotations
of functions do not count: better prose changes no number.
"""

import ast
import hashlib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

PACKAGES = ("sim", "ssac", "experiments")

# Packages of others whose version may change a recording, or an estimate.
SIM_PACKAGES = ("numpy", "scipy", "numba", "pyrender", "PyOpenGL", "trimesh", "manifold3d")
SSAC_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless")

Use = tuple[str, str]
"""A module, and the name that is taken from it; "" for all of it."""

_ALWAYS = ""  # name of definitions that count as soon as any of their module does
_NO_DATA = {".py", ".pyc", ".pyi", ".typed", ".nbc", ".nbi"}  # suffixes of files beside a module
_HARMLESS = {"dataclass", "njit", "cache", "lru_cache", "contextmanager"}
"""Decorators that register nothing elsewhere."""

_DEFINING = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


@dataclass(frozen=True)
class Code:
    """A module, or one statement at its top level: what it does without its prose, and uses."""

    digest: str
    words: frozenset[str]  # names that it mentions, and strings, which may name code as well
    imports: frozenset[tuple[str, Use]]  # of our packages, with the name that each has here


@dataclass(frozen=True)
class Source:
    """One file of code."""

    whole: Code
    imports: dict[str, Use]  # at the top level
    definitions: dict[str, list[Code]]  # by the names that they bind


@dataclass
class SourceTree:
    """The packages under one folder; each file is read once."""

    root: Path = ROOT
    sources: dict[str, Source] = field(default_factory=dict)  # that were read, by module
    paths: dict[str, Path | None] = field(default_factory=dict)  # that were looked for

    def digest(self, *starts: str) -> str:
        """Digest of code ("module", or "module:definition") and of all that it depends on."""
        parts, data = [], set[Path]()
        for name in sorted(self.closure(*starts)):
            module, is_definition, definition = name.partition(":")
            source = self._source(module)
            codes = source.definitions[definition] if is_definition else [source.whole]
            parts.append(" ".join([name, *(code.digest for code in codes)]))
            data |= set(self._data_beside(module))
        for path in sorted(data):
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            parts.append(f"{path.relative_to(self.root).as_posix()} {content}")
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]

    def closure(self, *starts: str) -> set[str]:
        """Names of this code and of all that it depends on: "module", or "module:definition"."""
        found: set[str] = set()
        done: set[Use] = set()
        left = [(module, name) for module, _, name in (start.partition(":") for start in starts)]
        while left:
            use = left.pop()
            if use not in done:
                done.add(use)
                left += self._follow(*use, found)
        return found

    def _follow(self, module: str, name: str, found: set[str]) -> Iterable[Use]:
        """Add what a use of a module (or of a name of it) brings in; return its own uses."""
        if name and self._path(f"{module}.{name}"):
            return [(f"{module}.{name}", "")]
        source = self._source(module)
        if _is_whole(module):
            found.add(module)
            return [use for _, use in source.whole.imports] + [*self._named(source.whole.words)]
        if name in source.imports:
            return [source.imports[name]]
        chosen = {name, _ALWAYS} & set(source.definitions)
        if not name or name not in chosen:
            chosen = set(source.definitions)
        found |= {f"{module}:{one}" for one in chosen}
        codes = [code for one in chosen for code in source.definitions[one]]
        return [use for code in codes for use in self._uses_of(module, source, code)]

    def _uses_of(self, module: str, source: Source, code: Code) -> Iterator[Use]:
        """Yield what a definition uses, of its own module or of others."""
        yield from (use for _, use in code.imports)
        yield from self._named(code.words)
        for mentioned in code.words:
            if mentioned in source.definitions and mentioned != _ALWAYS:
                yield module, mentioned
            elif mentioned in source.imports:
                yield source.imports[mentioned]

    def _named(self, words: Iterable[str]) -> Iterator[Use]:
        """Modules that a string names, "a.b.c" or "a.b.c:name"; of a folder all that are in it."""
        for name in {text.partition(":")[0] for text in words if "." in text}:
            path = self._path(name)
            if path is not None:
                for one in path.parent.rglob("*.py") if path.name == "__init__.py" else (path,):
                    parts = one.relative_to(self.root).with_suffix("").parts
                    yield ".".join(parts).removesuffix(".__init__"), ""

    def _path(self, module: str) -> Path | None:
        """File of a module of ours, None where there is none."""
        if module not in self.paths:
            parts = module.split(".")
            is_ours = parts[0] in PACKAGES and all(part.isidentifier() for part in parts)
            base = self.root.joinpath(*parts)
            files = [base.with_suffix(".py"), base / "__init__.py"] if is_ours else []
            self.paths[module] = next((path for path in files if path.is_file()), None)
        return self.paths[module]

    def _data_beside(self, module: str) -> Iterator[Path]:
        """Files that are no code, in a module's folder and in folders there without modules."""
        path = self._path(module)
        if path is None or not _is_whole(module):
            return
        for other in path.parent.iterdir():
            if other.is_dir() and other.name != "__pycache__" and not any(other.rglob("*.py")):
                yield from (file for file in other.rglob("*") if file.is_file())
            elif other.is_file() and other.suffix not in _NO_DATA:
                yield other

    def _source(self, module: str) -> Source:
        if module not in self.sources:
            path = self._path(module)
            if path is None:
                raise FileNotFoundError(f"no module {module} under {self.root}")
            self.sources[module] = read_source(path.read_text(encoding="utf-8"))
        return self.sources[module]


@cache
def read_source(text: str) -> Source:
    """Read code: what it does, what it uses of our packages, and its definitions."""
    tree = ast.parse(text)
    for node in list(ast.walk(tree)):
        if isinstance(node, (*_DEFINING, ast.Module)):
            node.body = [line for line in node.body if not _is_prose(line)]
    whole = _code(tree)
    imports: dict[str, Use] = {}
    definitions: dict[str, list[Code]] = {}
    for line in tree.body:
        if isinstance(line, ast.If) and getattr(line.test, "id", "") == "TYPE_CHECKING":
            continue  # never run
        for node in ast.walk(line):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                node.returns = None
            elif isinstance(node, ast.arg):
                node.annotation = None
        code = _code(line)
        imports.update(code.imports)
        if not isinstance(line, (ast.Import, ast.ImportFrom)):
            for name in _bound(line):
                definitions.setdefault(name, []).append(code)
    return Source(whole, imports, definitions)


def _is_whole(module: str) -> bool:
    """Whether all of a module counts, and data beside it; those of `experiments` are configs."""
    return module.partition(".")[0] != "experiments"


def _code(tree: ast.AST) -> Code:
    imports: set[tuple[str, Use]] = set()
    words: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            words.add(node.id)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            words.add(node.value)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                imports.add((alias.asname or alias.name.partition(".")[0], (alias.name, "")))
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                imports.add((alias.asname or alias.name, (str(node.module), alias.name)))
    ours = frozenset(one for one in imports if one[1][0].partition(".")[0] in PACKAGES)
    digest = hashlib.sha256(ast.dump(tree).encode()).hexdigest()
    return Code(digest, frozenset(words), ours)


def _bound(line: ast.stmt) -> set[str]:
    """Names that a statement binds; _ALWAYS among them where it may do something else too."""
    if isinstance(line, _DEFINING):
        called = (ast.unparse(one).partition("(")[0] for one in line.decorator_list)
        may_register = {name.rpartition(".")[2] for name in called} - _HARMLESS
        return {line.name} | ({_ALWAYS} if may_register else set())
    inside = list(ast.walk(line))
    stored = {
        one.id for one in inside if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
    }
    return stored | {one.name for one in inside if isinstance(one, _DEFINING)} or {_ALWAYS}


def _is_prose(line: ast.stmt) -> bool:
    """Return whether a statement is a string and nothing else: a docstring, or one of a name."""
    value = line.value if isinstance(line, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def code_of(*things: Any) -> tuple[str, ...]:
    """Name the code of functions and classes as `code_digest` takes it."""
    names = {
        thing.__module__
        if "." in thing.__qualname__ or "<" in thing.__qualname__
        else f"{thing.__module__}:{thing.__qualname__}"
        for thing in things
    }
    return tuple(sorted(names))


_TREE = SourceTree()


@cache
def code_digest(*starts: str) -> str:
    """Digest of code of ours, as it is on disk, and of all it depends on."""
    return _TREE.digest(*starts)


@cache
def package_versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Versions of packages of others; `pip install .` leaves out pyrender and its OpenGL."""
    versions = dict.fromkeys(packages, "not installed")
    for name in packages:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions
