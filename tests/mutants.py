"""Runs the mutants of `mutants.toml`: errors made on purpose, each of which a test must notice.

A mutant is a line or two of a file, what takes their place, and what that means. It is killed when
one of its tests fails, and does not fail without it; they are those named with it, or those that
mirror its file.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
LIST = Path(__file__).with_suffix(".toml")
TIMEOUT_S, NO_END = 900.0, -1
PACKAGES = ("sim", "ssac", "experiments", "tests")


@dataclass(frozen=True)
class Mutant:
    name: str
    file: str
    old: str  # occurs exactly once in the file
    new: str
    means: str
    tests: tuple[str, ...] = ()  # arguments of pytest; none: the tests that mirror the file

    def mutated(self, tree: Path) -> str:
        """Return the file's text with the error; ValueError if `old` does not occur once in it."""
        path = tree / self.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if text.count(self.old) != 1:
            raise ValueError(
                f"{self.name}: expected its text once in {self.file}, found it "
                f"{text.count(self.old)} times: bring {LIST.name} up to date\n{self.old}"
            )
        return text.replace(self.old, self.new)

    def arguments(self, tree: Path) -> tuple[str, ...]:
        """Return the arguments of pytest for the tests that must notice the mutant."""
        path = Path(self.file)
        mirrored = Path("tests") / path.parent / f"test_{path.name}"
        return self.tests or (str(mirrored if (tree / mirrored).is_file() else mirrored.parent),)


def mutants() -> list[Mutant]:
    listed = tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]
    return [Mutant(**{**one, "tests": tuple(one.get("tests", ()))}) for one in listed]


def scratch_copy(tree: Path) -> Path:
    """Clone the last commit, with the kernels already compiled."""
    subprocess.run(["git", "clone", "--quiet", "--shared", str(ROOT), str(tree)], check=True)
    for theirs in (path for package in PACKAGES for path in (tree / package).rglob("*.py")):
        ours, kernels = ROOT / theirs.relative_to(tree), theirs.parent / "__pycache__"
        if ours.is_file() and ours.read_bytes() == theirs.read_bytes():
            shutil.copystat(ours, theirs)  # by the module's time numba knows its kernels
            for kernel in (ours.parent / "__pycache__").glob(f"{ours.stem}.*.nb[ci]"):
                kernels.mkdir(exist_ok=True)
                shutil.copy2(kernel, kernels)
    return tree


def verdict(mutant: Mutant, tree: Path) -> str:
    """Apply a mutant to a copy of the tree, run its tests there, and undo it."""
    path, mutated = tree / mutant.file, mutant.mutated(tree)
    text, stamp = path.read_text(encoding="utf-8"), path.stat()
    # A cached kernel does not notice that a kernel it calls has changed.
    cache = {"NUMBA_CACHE_DIR": str(tree.parent / mutant.name)} if "njit" in text else {}
    try:
        path.write_text(mutated, encoding="utf-8")
        code, said = _tested(tree, mutant.arguments(tree), cache)
    finally:
        path.write_text(text, encoding="utf-8")
        os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    failed = [line[7:].split(" - ")[0] for line in said.splitlines() if line.startswith("FAILED ")]
    if code != NO_END and (code != 1 or not failed):
        return "survived" if code == 0 else f"no verdict:\n{said}"
    noticed = failed[0] if failed else "as they do not end"
    without, _ = _tested(tree, failed[:1] or mutant.arguments(tree), {})
    return f"killed {noticed}" if without == 0 else f"no verdict: {noticed}, without it too"


def _tested(tree: Path, arguments: Sequence[str], cache: dict[str, str]) -> tuple[int, str]:
    """Run tests up to the first failure; return pytest's exit code or NO_END, and its output."""
    settings = os.environ | {"PYTHONPATH": str(tree)} | cache
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *arguments]
    try:
        done = subprocess.run(
            command, cwd=tree, env=settings, timeout=TIMEOUT_S, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return NO_END, ""
    return done.returncode, done.stdout + done.stderr


def main() -> int:
    """Run the mutants whose name or file contains the text of option -k."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-k", default="", metavar="PART", help="of a name, or of a file")
    part = parser.parse_args().k
    chosen = [one for one in mutants() if part in one.name or part in one.file]
    n_trees = os.cpu_count() or 1
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        trees = [scratch_copy(Path(folder) / str(k)) for k in range(n_trees)]

        def timed(one: Mutant) -> str:
            tree, start_s = trees.pop(), time.monotonic()
            found = verdict(one, tree)
            trees.append(tree)
            print(f"{one.name}: {found} ({time.monotonic() - start_s:.0f} s)", flush=True)
            return found

        with ThreadPoolExecutor(n_trees) as pool:
            verdicts = list(pool.map(timed, chosen))
    left = [one for one, found in zip(chosen, verdicts, strict=True) if found[:6] != "killed"]
    print(f"{len(chosen)} mutants, {len(chosen) - len(left)} killed")
    for one in left:
        print(f"not killed: {one.name}: {one.means} ({one.file})")
    return int(bool(left))


if __name__ == "__main__":
    sys.exit(main())
