"""Numbers of disturbances of each kind in; whether the sweeps that met them are right, out.

A small sweep is run undisturbed. A disturbed one, run again where it must be, must leave the same
bytes.
"""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from pathlib import Path

import numpy as np

from experiments.lab.cache import Cache, run_key
from experiments.torture.case import outcome
from experiments.torture.dask_workers import has_dask, two_workers
from experiments.torture.disk import make_room, small_disk
from experiments.torture.mutations import OF_TEXT
from experiments.torture.reliability import (
    DASK,
    FULL,
    KILLED,
    MESH,
    TOGETHER,
    WORKER,
    Case,
    Extent,
)
from experiments.torture.sweeps import (
    CSV,
    MAX_SWEEP_S,
    Command,
    Undisturbed,
    begin,
    gone_on,
    judged,
    undisturbed,
    write_grid,
)
from experiments.torture.victims import save_mesh
from ssac.cli.exits import BAD_INPUT, DONE
from ssac.errors import SsacError

Rng = np.random.Generator
Compare = Callable[[], Undisturbed]
Disturb = Callable[[int, Rng, Path, Compare], Case]

_CODE = ("experiments.torture.faults",)


def disturbances(extent: Extent, folder: Path, store: Cache) -> Iterator[Case]:
    """Disturb sweeps in all ways; what is finished is kept in the cache.

    Raises
    ------
    SsacError
        If full disks are asked for and this process may not mount a file system, or Dask is and is
        not installed.
    """
    if extent.others and not has_dask():
        raise SsacError(
            "Dask's workers cannot be killed where it is not: .venv/bin/pip install "
            '"dask[distributed]", or --others 0'
        )
    compare = cache(partial(undisturbed, folder))
    for kind, disturb in _DISTURBANCES.items():
        for number in range(extent.counts()[kind]):
            key = run_key((), ("torture", extent.seed, kind, number), _CODE)
            row = store.load_run(key)
            if row is None:
                rng = np.random.default_rng([extent.seed, *kind.encode(), number])
                at = folder / kind.replace(" ", "-") / str(number)
                at.mkdir(parents=True)
                row = {"case": disturb(number, rng, at, compare)}
                store.save_run(key, row)
            yield Case(*row["case"])


def _killed(number: int, rng: Rng, at: Path, compare: Compare) -> Case:
    """Kill a sweep at a random time.

    Of the commands every other one is killed with its workers, as by a machine that goes down, and
    every other one alone, which its workers must follow.
    """
    grid, is_forked = write_grid(at), number % 4 < 3
    took_s = compare().took_s(is_forked)
    sweep = begin(grid, at, is_forked)
    share = rng.uniform(0.1, 1.0)
    time.sleep(share * took_s)
    with suppress(ProcessLookupError):  # it was done before
        (os.killpg if number % 8 == 3 else os.kill)(sweep.pid, signal.SIGKILL)
    ended = sweep.ended(MAX_SWEEP_S)
    damage = f"killed at {share:.2f} of its time"
    if ended.is_late:
        return Case(KILLED, damage, number, "hang", "its workers live on")
    return gone_on(KILLED, damage, number, grid, at, compare().csv)


def _full(number: int, rng: Rng, at: Path, compare: Compare) -> Case:
    """Run a sweep on a disk that becomes full; then it gets room."""
    grid = write_grid(at)
    n_bytes = int(2 ** rng.uniform(16.0, 23.0))
    damage = f"{n_bytes} bytes"
    with small_disk(at / "disk", n_bytes) as disk:
        ended = begin(grid, disk, is_forked=number % 4 < 3).ended(MAX_SWEEP_S)
        lines = [line for line in ended.stderr.splitlines() if line.startswith("error")]
        is_clear = len(lines) == 1 and str(disk) in lines[0]
        if ended.code != DONE and not (ended.code == BAD_INPUT and is_clear):
            found = "hang" if ended.is_late else "abort" if ended.code < 0 else "unclear"
            return Case(FULL, damage, number, found, ended.stderr[-500:])
        make_room(disk)
        return gone_on(FULL, damage, number, grid, disk, compare().csv)


def _together(number: int, rng: Rng, at: Path, compare: Compare) -> Case:
    """Run two sweeps on one cache, the second somewhat later."""
    grid = write_grid(at)
    later_s = rng.uniform(0.0, 1.0) * compare().forked_s
    names = (CSV, f"other_{CSV}")
    sweeps = []
    for name in names:
        sweeps.append(begin(grid, at, is_forked=True, csv=name))
        time.sleep(later_s if name == CSV else 0.0)
    ended = [sweep.ended(MAX_SWEEP_S) for sweep in sweeps]
    csvs = [at / name for name in names]
    damage = f"{later_s:.1f} s apart"
    return judged(TOGETHER, damage, number, ended, at, csvs, compare().csv)


def _dead_worker(number: int, rng: Rng, at: Path, compare: Compare) -> Case:
    """Kill one of two workers; the sweep itself must make up for it."""
    sweep = begin(write_grid(at), at, is_forked=False)
    share = rng.uniform(0.3, 1.0)
    time.sleep(share * compare().command_s)
    for worker in _workers_of(sweep.pid)[:1]:
        with suppress(ProcessLookupError):
            os.kill(worker, signal.SIGKILL)
    ended = [sweep.ended(MAX_SWEEP_S)]
    damage = f"killed at {share:.2f} of the sweep's time"
    return judged(WORKER, damage, number, ended, at, [at / CSV], compare().csv)


def _dead_dask_worker(number: int, rng: Rng, at: Path, compare: Compare) -> Case:
    """Kill one of a Dask scheduler's two workers."""
    grid = write_grid(at)
    (at / "dask").mkdir()
    store = at / "store"
    store.mkdir()
    with two_workers(at / "dask") as scheduler:
        sweep = Command(grid, store, "--scheduler", scheduler.address)
        share = rng.uniform(0.3, 1.0)
        time.sleep(share * compare().command_s)
        os.kill(scheduler.workers[0], signal.SIGKILL)
        ended = [sweep.ended(MAX_SWEEP_S)]
    damage = f"killed at {share:.2f} of the sweep's time"
    return judged(DASK, damage, number, ended, store, [store / CSV], compare().csv)


def _damaged_mesh(number: int, rng: Rng, at: Path, compare: Compare) -> Case:
    """Run a grid that names a damaged mesh: its rows say what is wrong, or an error does."""
    del compare
    mesh = at / "drone.obj"
    save_mesh(mesh)
    name = list(OF_TEXT)[int(rng.integers(len(OF_TEXT)))]
    mesh.write_bytes(OF_TEXT[name](mesh.read_bytes(), rng))
    grid = write_grid(at, f"sim.drone_file = {str(mesh)!r}\n")
    ended = begin(grid, at, is_forked=True).ended(MAX_SWEEP_S)
    errors = [line for line in ended.stderr.splitlines() if line.startswith("error")]
    said = ended._replace(stderr="\n".join(errors))  # not what it says of its work
    found = outcome(said, "", DONE)  # it need not name the mesh: it may be read, and too large
    return Case(MESH, name, number, found, ended.stderr[-500:])


def _workers_of(process: int) -> list[int]:
    """List the processes that do a sweep's work, by what the system says of its children."""
    found = []
    children = Path(f"/proc/{process}/task/{process}/children")
    with suppress(OSError):  # it has ended
        for child in map(int, children.read_text(encoding="ascii").split()):
            with suppress(OSError):
                if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                    found.append(child)
    return found


_DISTURBANCES: dict[str, Disturb] = {
    KILLED: _killed,
    FULL: _full,
    TOGETHER: _together,
    WORKER: _dead_worker,
    DASK: _dead_dask_worker,
    MESH: _damaged_mesh,
}
