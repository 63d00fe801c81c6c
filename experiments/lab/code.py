"""Names of modules in; the digest of all code of ours that they depend on, out.

What a module depends on is read off its imports, and theirs, and so on: nobody keeps a list that
could miss a file. Beside imports count modules that are named in a string, as lazy imports name
them, and the data files that lie beside a module (shaders, tables). Comments and docstrings do not
count: better prose changes no number.
"""

import ast
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

PACKAGES = ("sim", "ssac", "experiments")

# Packages of others whose version may change a recording, or an estimate.
SIM_PACKAGES = ("numpy", "scipy", "numba", "pyrender", "PyOpenGL", "trimesh", "manifold3d")
SSAC_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless")

_NO_DATA = {".py", ".pyc", ".pyi", ".typed", ".nbc", ".nbi"}  # suffixes of files beside a module
_TREES = ("sim", "ssac")  # where data files belong to the code; those of `experiments` are configs


@dataclass(frozen=True)
class Source:
    """One file of code."""

    digest: str  # of the code without its prose
    uses: frozenset[tuple[str, str]]  # (module, name taken from it; "" for the module itself)
    strings: frozenset[str]  # that may name a module


@dataclass
class SourceTree:
    """The packages under one folder; each file is read once."""

    root: Path = ROOT
    sources: dict[str, Source] = field(default_factory=dict)  # that were read, by module
    paths: dict[str, Path | None] = field(default_factory=dict)  # that were looked for

    def digest(self, *modules: str) -> str:
        """Digest of the code of some modules, and of all that they depend on."""
        names = sorted(self.closure(*modules))
        parts = [f"{name} {self._source(name).digest}" for name in names]
        for path in sorted({path for name in names for path in self._data_beside(name)}):
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            parts.append(f"{path.relative_to(self.root).as_posix()} {content}")
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]

    def closure(self, *modules: str) -> set[str]:
        """Names of these modules and of all that they depend on.

        A package's `__init__` counts where a name is taken from it, with the module that the name
        comes from; where that cannot be read off its imports, all that it imports and all modules
        of the package count.
        """
        found: set[str] = set()
        left = [(name, "") for name in modules]
        done: set[tuple[str, str]] = set()
        while left:
            use = left.pop()
            if use in done:
                continue
            done.add(use)
            left += self._follow(*use, found)
        return found

    def _follow(self, module: str, name: str, found: set[str]) -> list[tuple[str, str]]:
        """Add what a use of a module (or of a name of it) brings in; return its own uses."""
        if name and self._path(f"{module}.{name}"):
            return [(f"{module}.{name}", "")]
        path = self._path(module)
        if path is None:
            raise FileNotFoundError(f"no module {module} under {self.root}")
        found.add(module)
        source = self._source(module)
        if path.name != "__init__.py":
            return [*source.uses, *self._named(source)]
        origins = [use for use in source.uses if use[1] == name]
        if name and len(origins) == 1:
            return origins
        if not name:
            return list(source.uses)
        inside = [(other, "") for other in self._modules() if other.startswith(f"{module}.")]
        return [*source.uses, *inside]

    def _named(self, source: Source) -> list[tuple[str, str]]:
        """Modules that a string names, "a.b.c" or "a.b.c:name"; of a folder all that are in it."""
        names = {text.partition(":")[0] for text in source.strings}
        folders = tuple(f"{name}." for name in names if self._path(f"{name}.__init__"))
        inside = [name for name in self._modules() if name.startswith(folders)] if folders else []
        return [(name, "") for name in [*names, *inside] if self._path(name)]

    def _modules(self) -> Iterator[str]:
        for package in PACKAGES:
            for path in (self.root / package).rglob("*.py"):
                if path.name != "__init__.py":
                    yield ".".join(path.relative_to(self.root).with_suffix("").parts)

    def _path(self, module: str) -> Path | None:
        """File of a module of ours, None where there is none."""
        if module not in self.paths:
            self.paths[module] = self._found(module)
        return self.paths[module]

    def _found(self, module: str) -> Path | None:
        parts = module.split(".")
        if parts[0] not in PACKAGES or not all(part.isidentifier() for part in parts):
            return None
        base = self.root.joinpath(*parts)
        candidates = (base.with_suffix(".py"), base / "__init__.py")
        return next((path for path in candidates if path.is_file()), None)

    def _data_beside(self, module: str) -> Iterator[Path]:
        """Files that are no code, in a module's folder and in folders there without modules."""
        path = self._path(module)
        if path is None or module.partition(".")[0] not in _TREES:
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
    """Read code: what it does, and what it uses of our packages."""
    tree = ast.parse(text)
    for node in list(ast.walk(tree)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Module)):
            node.body = [line for line in node.body if not _is_prose(line)]
    uses: set[tuple[str, str]] = set()
    strings: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            uses |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            uses |= {(node.module, alias.name) for alias in node.names}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value:
            strings.add(node.value)
    ours = frozenset(use for use in uses if use[0].partition(".")[0] in PACKAGES)
    digest = hashlib.sha256(ast.dump(tree).encode()).hexdigest()
    return Source(digest, ours, frozenset(strings))


def _is_prose(line: ast.stmt) -> bool:
    """Return whether a statement is a string and nothing else: a docstring, or one of a name."""
    return (
        isinstance(line, ast.Expr)
        and isinstance(line.value, ast.Constant)
        and isinstance(line.value.value, str)
    )


@cache
def code_digest(*modules: str) -> str:
    """Digest of the code of modules of ours, as it is on disk, and of all they depend on."""
    return _tree().digest(*modules)


@cache
def _tree() -> SourceTree:
    return SourceTree()


@cache
def package_versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Versions of the packages of others that are installed."""
    return {name: version(name) for name in packages}
