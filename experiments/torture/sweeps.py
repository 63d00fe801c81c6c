"""A folder in, a small sweep begun in it out, and whether what it leaves is right.

Half of them run in one process that is forked from this one, so that what befalls them befalls
their work; half as a user's command, with workers, most of whose time is the imports'.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from experiments.lab.cache import Cache
from experiments.lab.command import run_studies
from experiments.lab.grid import load_config
from experiments.lab.schedule import Workers
from experiments.studies.sweep import sweep_study
from experiments.torture.case import Ended, Forked
from experiments.torture.reliability import Case
from ssac.cli.exits import DONE
from ssac.errors import SsacError

CSV = "sweep.csv"
MAX_SWEEP_S = 600.0

GRID = """\
flights = 2
methods = ["event_rate"]
[fixed]
sim.spline.duration_s = 0.5
sim.render.check = false
[grid]
sim.angle_deg = [60, 120]
"""


class Sweep(Protocol):
    """A sweep that was begun, the leader of a group of processes."""

    pid: int

    def ended(self, within_s: float) -> Ended:
        """Wait for its end, or bring it about when it takes longer."""


class Command:
    """A sweep as a user begins it."""

    def __init__(self, grid: Path, store: Path, *options: str) -> None:
        command = [sys.executable, "-m", "experiments", "sweep", str(grid)]
        command += ["--out", str(store / CSV), "--cache", str(store / "cache"), *options]
        self._process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.pid = self._process.pid

    def ended(self, within_s: float) -> Ended:
        """Wait until it and all its workers have ended, or end them."""
        is_late = False
        try:
            _, said = self._process.communicate(timeout=within_s)
        except subprocess.TimeoutExpired:
            is_late = True
            os.killpg(self.pid, signal.SIGKILL)
            _, said = self._process.communicate()
        return Ended(self._process.returncode, said, None, is_late)


@dataclass(frozen=True)
class Undisturbed:
    """What a sweep leaves that nobody disturbs, and how long it takes."""

    csv: bytes
    forked_s: float
    command_s: float

    def took_s(self, is_forked: bool) -> float:
        """Tell how long a sweep takes that is begun so."""
        return self.forked_s if is_forked else self.command_s


def begin(grid: Path, store: Path, is_forked: bool, csv: str = CSV) -> Sweep:
    """Begin a sweep: forked from this process, or a command with two workers."""
    if not is_forked:
        return Command(grid, store, "--workers", "2")
    work = partial(_sweep, grid, store / csv, store / "cache")
    return Forked(work, grid.parent)


def undisturbed(folder: Path) -> Undisturbed:
    """Run a sweep in both ways, which must leave the same.

    Raises
    ------
    SsacError
        If they do not.
    """
    took_s, found = [], []
    for is_forked in (False, True):
        grid = write_grid(folder / f"undisturbed{is_forked:d}")
        start_s = time.monotonic()
        ended = begin(grid, grid.parent, is_forked).ended(MAX_SWEEP_S)
        if ended.code != DONE:
            raise SsacError(f"the undisturbed sweep failed: {ended.stderr[-500:]}")
        took_s.append(time.monotonic() - start_s)
        found.append((grid.parent / CSV).read_bytes())
    if found[0] != found[1]:
        raise SsacError("two undisturbed sweeps differ: nothing can be held against them")
    return Undisturbed(found[0], forked_s=took_s[1], command_s=took_s[0])


def write_grid(folder: Path, more: str = "") -> Path:
    """Write a grid into a folder, which is made; `more` is of its table `fixed`."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "sweep.toml"
    path.write_text(GRID.replace("[grid]", f"{more}[grid]"), encoding="utf-8")
    return path


def gone_on(kind: str, damage: str, number: int, grid: Path, store: Path, csv: bytes) -> Case:
    """Run a disturbed sweep to its end: it must leave what an undisturbed one does."""
    ended = begin(grid, store, is_forked=True).ended(MAX_SWEEP_S)
    return judged(kind, damage, number, [ended], store, [store / CSV], csv)


def judged(
    kind: str,
    damage: str,
    number: int,
    sweeps: Sequence[Ended],
    store: Path,
    csvs: Sequence[Path],
    expected: bytes,
) -> Case:
    """Hold what sweeps left against what an undisturbed one leaves."""
    said = " ".join(one.stderr[-500:] for one in sweeps)
    left = sorted(path.name for path in store.rglob(".*"))
    if any(one.is_late for one in sweeps):
        outcome = "hang"
    elif any(one.code != DONE for one in sweeps):
        outcome = "traceback" if "Traceback" in said else "unclear"
    elif any(path.read_bytes() != expected for path in csvs) or left:
        outcome = "wrong"
    else:
        outcome = "right"
    return Case(kind, damage, number, outcome, f"{said} {left or ''}".strip())


def _sweep(grid: Path, out: Path, cache: Path) -> int:
    study = sweep_study(load_config(grid), out.name, f"{out.stem}_cells", f"ssac sweep {grid}")
    run_studies([study], out.parent, Cache(cache), Workers(1))
    return DONE
