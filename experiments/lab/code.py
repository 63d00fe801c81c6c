"""Digests of the code that makes a recording or a row, with all code that it depends on.

Nobody keeps a list that could miss a file: dependencies are found by following imports and names
from the code that measures. Of `sim` and `ssac` whole modules count. Of `experiments` only the
top-level definitions that are reached by name count, so that measure, summary and drawing of a
study may share a file, and a change of a lock or a checksum makes no row invalid.

Modules and definitions that a string names, as lazy imports do, count like imports. So do the data
files beside a module (shaders, tables). Comments, docstrings and annotations of functions do not
count: better prose changes no number.
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

# Third-party packages whose version may change a recording or an estimate.
SSAC_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless")
SIM_PACKAGES = (*SSAC_PACKAGES, "pyrender", "PyOpenGL", "trimesh", "manifold3d")

Use = tuple[str, str]  # a module, and the name that is imported from it; "" for all of it

_ALWAYS = ""  # key of statements that count as soon as anything of their module does, or of it all
_NO_DATA = {".py", ".pyc", ".pyi", ".typed", ".nbc", ".nbi"}  # suffixes of files that are no data
_HARMLESS = {
    "dataclass",
    "njit",
    "cache",
    "lru_cache",
    "contextmanager",
    "with_options",
    "by_group",
}
"""Decorators that register nothing elsewhere."""

_DEFINING = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


@dataclass(frozen=True)
class Code:
    """A module, or a statement at its top level: a digest without prose, and what it uses."""

    digest: str
    words: frozenset[str]  # names and string constants in it; a string may name code too
    imports: frozenset[tuple[str, Use]]  # from PACKAGES: (local name, use)


@dataclass(frozen=True)
class Source:
    """One file of code: of a module that counts as a whole, all of it is one definition."""

    imports: dict[str, Use]  # at the top level
    definitions: dict[str, list[Code]]  # by name bound


@dataclass
class SourceTree:
    """The packages under one folder; each file is read once."""

    root: Path = ROOT
    sources: dict[str, Source] = field(default_factory=dict)  # read so far, by module
    paths: dict[str, Path | None] = field(default_factory=dict)  # looked up so far; None: no module

    def digest(self, *starts: str) -> str:
        """Return a digest of code ("module" or "module:definition") and all that it depends on."""
        parts, data = [], set[Path]()
        for name in sorted(self.closure(*starts)):
            module, _, definition = name.partition(":")
            codes = self._source(module).definitions[definition]
            parts.append(" ".join([name, *(code.digest for code in codes)]))
            data |= set(self._data_beside(module))
        for path in sorted(data):
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            parts.append(f"{path.relative_to(self.root).as_posix()} {content}")
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]

    def closure(self, *starts: str) -> set[str]:
        """Name this code and all that it depends on, as "module" or "module:definition"."""
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
        """Add the code that a use (module, name) refers to; return the uses of that code."""
        if name and self._path(f"{module}.{name}"):
            return [(f"{module}.{name}", "")]
        source = self._source(module)
        if name in source.imports:
            return [source.imports[name]]
        chosen = {name, _ALWAYS} & set(source.definitions)
        if not name or name not in chosen:
            chosen = set(source.definitions)
        found |= {module if _is_whole(module) else f"{module}:{one}" for one in chosen}
        codes = [code for one in chosen for code in source.definitions[one]]
        return [use for code in codes for use in self._uses_of(module, source, code)]

    def _uses_of(self, module: str, source: Source, code: Code) -> Iterator[Use]:
        """Yield what a definition uses from its own module and from others."""
        yield from (use for _, use in code.imports)
        yield from self._named(code.words)
        for mentioned in code.words:
            if mentioned in source.definitions and mentioned != _ALWAYS:
                yield module, mentioned
            elif mentioned in source.imports:
                yield source.imports[mentioned]

    def _named(self, words: Iterable[str]) -> Iterator[Use]:
        """Yield the modules that strings "a.b.c" or "a.b.c:name" name: for a package, all in it."""
        for name in {text.partition(":")[0] for text in words if "." in text}:
            path = self._path(name)
            if path is not None:
                for one in path.parent.rglob("*.py") if path.name == "__init__.py" else (path,):
                    parts = one.relative_to(self.root).with_suffix("").parts
                    yield ".".join(parts).removesuffix(".__init__"), ""

    def _path(self, module: str) -> Path | None:
        """Return the file of a module of PACKAGES; None where there is none."""
        if module not in self.paths:
            parts = module.split(".")
            is_ours = parts[0] in PACKAGES and all(part.isidentifier() for part in parts)
            base = self.root.joinpath(*parts)
            files = [base.with_suffix(".py"), base / "__init__.py"] if is_ours else []
            self.paths[module] = next((path for path in files if path.is_file()), None)
        return self.paths[module]

    def _data_beside(self, module: str) -> Iterator[Path]:
        """Yield the data files in a module's folder and in its subfolders without modules."""
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
            self.sources[module] = read_source(path.read_text(encoding="utf-8"), _is_whole(module))
        return self.sources[module]


@cache
def read_source(text: str, is_whole: bool) -> Source:
    """Parse a source text into its code without prose, imports from PACKAGES and definitions."""
    tree = ast.parse(text)
    for node in list(ast.walk(tree)):
        if isinstance(node, (*_DEFINING, ast.Module)):
            node.body = [line for line in node.body if not _is_prose(line)]
    if is_whole:
        return Source({}, {_ALWAYS: [_code(tree)]})
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
    return Source(imports, definitions)


def _is_whole(module: str) -> bool:
    """Whether all of a module and its data count: not of `experiments`, whose data are configs."""
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
    """Return the names that a statement binds, with _ALWAYS if it may have side effects too."""
    if isinstance(line, _DEFINING):
        called = (ast.unparse(one).partition("(")[0] for one in line.decorator_list)
        may_register = {name.rpartition(".")[2] for name in called} - _HARMLESS
        return {line.name} | ({_ALWAYS} if may_register else set())
    inside = list(ast.walk(line))
    loops = [one.target for one in inside if isinstance(one, ast.comprehension)]
    hidden = {id(one) for target in loops for one in ast.walk(target)}  # bound inside alone
    names = (one for one in inside if isinstance(one, ast.Name) and id(one) not in hidden)
    stored = {one.id for one in names if isinstance(one.ctx, ast.Store)}
    found = stored | {one.name for one in inside if isinstance(one, _DEFINING)}
    if isinstance(line, (ast.Assign, ast.AnnAssign)):
        return found or {_ALWAYS}
    return found | {_ALWAYS}  # a loop, say, which may change what others bind


def _is_prose(line: ast.stmt) -> bool:
    """Whether a statement is a string alone, the docstring of a module, definition or name."""
    value = line.value if isinstance(line, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def code_of(*things: Any) -> tuple[str, ...]:
    """Name the code of functions and classes in the form that `code_digest` takes."""
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
    """Return a digest of code of PACKAGES, as it is on disk, and all that it depends on."""
    return _TREE.digest(*starts)


@cache
def package_versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Return versions, or "not installed": `pip install .` leaves out pyrender and its OpenGL."""
    versions = dict.fromkeys(packages, "not installed")
    for name in packages:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions
