"""Sweeps that are killed, or whose disk is full, in; whether what they leave is right, out.

A small sweep is run once undisturbed. Every disturbed one, run again until it ends, must leave the
same bytes.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from experiments.torture.case import Case
from ssac.console.exits import BAD_INPUT, DONE
from ssac.errors import SsacError

_GRID = """\
flights = 3
methods = ["event_rate"]
[fixed]
sim.spline.duration_s = 1.0
sim.render.check = false
[grid]
sim.angle_deg = [60, 120]
"""

_CSV = "sweep.csv"


def killed_sweeps(n_kills: int, seed: int, folder: Path) -> Iterator[Case]:
    """Kill sweeps at random times; each kill is a case, of which the last run's bytes decide.

    Of two kills one is of the whole group of processes, as by a machine that goes down, and one of
    the parent alone, which its workers must follow.
    """
    if not n_kills:
        return
    rng = np.random.default_rng(seed)
    expected, took_s = _undisturbed(folder)
    for number in range(n_kills):
        at = folder / f"kill{number}"
        _write_grid(at)
        process = _sweep(at, at)
        time.sleep(rng.uniform(0.1, 1.0) * took_s)
        if number % 2:
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        process.communicate()
        yield _compared("killed sweep", "kill", number, at, at, expected)


def full_disks(n_disks: int, seed: int, folder: Path) -> Iterator[Case]:
    """Run sweeps on disks that become full, then give them room.

    Raises
    ------
    SsacError
        If this process may not mount a file system in memory.
    """
    if not n_disks:
        return
    rng = np.random.default_rng(seed)
    expected, _ = _undisturbed(folder)
    for number in range(n_disks):
        at = folder / f"disk{number}"
        _write_grid(at)
        n_bytes = int(2 ** rng.uniform(16.0, 23.0))
        with _small_disk(at / "disk", n_bytes) as disk:
            process = _sweep(at, disk)
            _, said = process.communicate()
            lines = [line for line in said.splitlines() if line.startswith("error")]
            is_clear = process.returncode == DONE or (
                process.returncode == BAD_INPUT and len(lines) == 1 and str(disk) in lines[0]
            )
            if not is_clear:
                code = process.returncode
                outcome = "abort" if code < 0 else "unclear"
                yield Case("full disk", f"{n_bytes} bytes", number, outcome, said[-500:])
                continue
            _mount("remount,size=1g", disk)
            yield _compared("full disk", f"{n_bytes} bytes", number, at, disk, expected)


def _compared(kind: str, damage: str, number: int, at: Path, store: Path, expected: bytes) -> Case:
    """Run a sweep to its end: it must say nothing of errors, and leave the same bytes."""
    process = _sweep(at, store)
    _, said = process.communicate()
    left = [path.name for path in store.rglob(".*") if path.suffix in (".part", ".partial")]
    if process.returncode != DONE:
        outcome = "unclear"
    elif (store / _CSV).read_bytes() != expected or left:
        outcome = "wrong"
    else:
        outcome = "right"
    return Case(kind, damage, number, outcome, f"{said[-500:]} {left or ''}".strip())


def _undisturbed(folder: Path) -> tuple[bytes, float]:
    at = folder / "undisturbed"
    _write_grid(at)
    start_s = time.monotonic()
    process = _sweep(at, at)
    _, said = process.communicate()
    if process.returncode != DONE:
        raise SsacError(f"the undisturbed sweep failed: {said[-500:]}")
    return (at / _CSV).read_bytes(), time.monotonic() - start_s


def _write_grid(at: Path) -> None:
    at.mkdir(parents=True, exist_ok=True)
    (at / "sweep.toml").write_text(_GRID, encoding="utf-8")


def _sweep(at: Path, store: Path) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "experiments", "sweep", str(at / "sweep.toml")]
    command += ["--out", str(store / _CSV), "--cache", str(store / "cache"), "--workers", "2"]
    return subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


@contextmanager
def _small_disk(at: Path, n_bytes: int) -> Iterator[Path]:
    at.mkdir(parents=True)
    _mount(f"size={n_bytes}", at)
    try:
        yield at
    finally:
        subprocess.run(["umount", str(at)], check=False, capture_output=True)


def _mount(options: str, at: Path) -> None:
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(at)]
    made = subprocess.run(command, check=False, capture_output=True, text=True)
    if made.returncode:
        raise SsacError(
            f"{at}: a file system in memory cannot be mounted ({made.stderr.strip()}): run as "
            "root, or with --full-disks 0"
        )
