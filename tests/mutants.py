"""Runs the mutants of `mutants.toml`: errors made on purpose, each of which a test must notice.

A mutant is a line or two of a file, what takes their place, and what that means. It is killed when
one of its tests fails; they are those named with it, or those that mirror its file.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
LIST = Path(__file__).with_suffix(".toml")
TIMEOUT_S = 900.0


@dataclass(frozen=True)
class Mutant:
    """An error, and where it is made."""

    name: str
    file: str
    old: str  # occurs exactly once in the file
    new: str
    means: str
    tests: tuple[str, ...] = ()  # arguments of pytest; none: the tests that mirror the file

    def mutated(self, tree: Path) -> str:
        """Give the file's text with the error; ValueError where the list is older than it."""
        path = tree / self.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if text.count(self.old) != 1:
            raise ValueError(
                f"{self.name}: expected its text once in {self.file}, found it "
                f"{text.count(self.old)} times: bring {LIST.name} up to date\n{self.old}"
            )
        return text.replace(self.old, self.new)

    def arguments(self, tree: Path) -> tuple[str, ...]:
        """Say which tests are to notice it."""
        path = Path(self.file)
        mirrored = Path("tests") / path.parent / f"test_{path.name}"
        return self.tests or (str(mirrored if (tree / mirrored).is_file() else mirrored.parent),)


def mutants() -> list[Mutant]:
    """Read the list."""
    listed = tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]
    return [Mutant(**{**one, "tests": tuple(one.get("tests", ()))}) for one in listed]


@contextmanager
def scratch_copy() -> Iterator[Path]:
    """Check the last commit out elsewhere."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = Path(folder) / "tree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), "HEAD"], check=True)
        try:
            yield tree
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


def verdict(mutant: Mutant, tree: Path) -> str:
    """Make an error in a copy of the tree, run its tests there, and take it back."""
    path, mutated = tree / mutant.file, mutant.mutated(tree)
    text, stamp = path.read_text(encoding="utf-8"), path.stat()
    # A kernel is compiled into those that call it, whose caches do not know of its change.
    is_kernel = "njit" in text
    with tempfile.TemporaryDirectory(dir=tree.parent) as own_cache:
        cache = own_cache if is_kernel else str(tree.parent / "numba")
        settings = os.environ | {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": cache}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
        try:
            path.write_text(mutated, encoding="utf-8")
            done = subprocess.run(
                [*command, *mutant.arguments(tree)], cwd=tree, env=settings, timeout=TIMEOUT_S,
                capture_output=True, text=True, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "killed (it did not end)"
        finally:
            path.write_text(text, encoding="utf-8")
            os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    if done.returncode == 1:
        failed = [line for line in done.stdout.splitlines() if line.startswith("FAILED")]
        return f"killed {failed[0].split(' ')[1] if failed else ''}"
    return "survived" if done.returncode == 0 else f"no verdict:\n{done.stdout}{done.stderr}"


def main() -> int:
    """Run the mutants whose name, or whose file's, has the part that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-k", default="", metavar="PART", help="of a name, or of a file")
    part = parser.parse_args().k
    chosen = [one for one in mutants() if part in one.name or part in one.file]
    verdicts = []
    with scratch_copy() as tree:
        for one in chosen:
            start_s = time.monotonic()
            verdicts.append(verdict(one, tree))
            print(f"{one.name}: {verdicts[-1]} ({time.monotonic() - start_s:.0f} s)", flush=True)
    left = [one for one, found in zip(chosen, verdicts, strict=True) if found[:6] != "killed"]
    print(f"{len(chosen)} mutants, {len(chosen) - len(left)} killed")
    for one in left:
        print(f"not killed: {one.name}: {one.means} ({one.file})")
    return int(bool(left))


if __name__ == "__main__":
    sys.exit(main())
