"""The code that the marks were stated for in; how many times slower this machine is, out.

The marks of speed are those of one machine. Their code stands in the project's history, beside
what it took there. It is run again here, by today's packages on one core, so that what is measured
on any machine can be held against the marks.
"""

import io
import json
import subprocess
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from experiments.bench.measurement import Measurement
from experiments.bench.process import in_own_process
from experiments.lab.code import ROOT
from ssac.errors import SsacError

REVISION = "9828abb4ffad"
"""Of the code that the marks of speed were stated for."""

STATED_IN = "results/bench.csv"  # of that code: what it took on the machine of the marks

TIMED = {
    "tangency: all, unknown extrinsics": "`tangency` on a pair of 20 s",
    "sync: all, unknown extrinsics, refined": "`joint` on a sparse pair of 20 s",
    "simulate a 20 s pair, frames included": "a pair of 20 s simulated",
}
"""Rows of its benchmark that are measured again, and what each is the time of."""

_COMPILED = tuple(TIMED)[:2]
"""Those that tell the machine's speed: compiled loops and NumPy, as all is that has a mark today.

The third draws by OpenGL in software, which suffers more from a slow machine: counting it would
flatter all that is measured here.
"""

FACTOR = "machine: times as slow as that of the marks"
AS_THERE = "as on the machine of the marks"

# Run among that code. It simulates as that code's benchmark does, whose module needs packages that
# nothing needs any more.
_DRIVER = """
import json
import time
from dataclasses import asdict

from experiments.bench_sync import bench_estimate, bench_tangency
from experiments.measurement import Measurement
from sim.recording import SimConfig, simulate
from sim.trajectory import SplineConfig

rows = bench_tangency() + bench_estimate()
simulate(SimConfig(spline=SplineConfig(duration_s=1.0)), 0)  # compiles the kernels
start = time.perf_counter()
simulate(SimConfig(), 0)
seconds = time.perf_counter() - start
rows.append(Measurement("simulate a 20 s pair, frames included", seconds, "s"))
print(json.dumps([asdict(row) for row in rows]))
"""


def bench_machine(root: Path = ROOT, revision: str = REVISION) -> list[Measurement]:
    """Measure the code that the marks were stated for, and compare with what it took there.

    Raises
    ------
    SsacError
        Without that code: outside the project's repository, or in one without its history.
    """
    stated = _stated(root, revision)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _unpack(root, revision, folder)
        (folder / "driver.py").write_text(_DRIVER, encoding="utf-8")
        here = {row["name"]: row["value"] for row in in_own_process("driver", folder=folder)}
    rows = []
    for row, what in TIMED.items():
        rows += [
            Measurement(f"machine, {what}: stated", stated[row], "s"),
            Measurement(f"machine, {what}: here", here[row], "s"),
            Measurement(f"machine, {what}: times as slow", here[row] / stated[row], "x"),
        ]
    least = min(here[row] / stated[row] for row in _COMPILED)
    return [*rows, Measurement(FACTOR, least, "x")]


def as_there(rows: Sequence[Measurement]) -> list[Measurement]:
    """Give every time that has a mark as it would be on the machine that the mark is of.

    Nothing, where that machine's code could not be measured.
    """
    factors = [row.value for row in rows if row.name == FACTOR]
    return [
        Measurement(f"{row.name}, {AS_THERE}", row.value / factor, row.unit, row.mark)
        for factor in factors
        for row in rows
        if row.mark is not None and row.unit == "s"
    ]


def _stated(root: Path, revision: str) -> dict[str, float]:
    table = pd.read_csv(io.BytesIO(_git(root, "show", f"{revision}:{STATED_IN}")))
    return dict(zip(table["name"], table["value"], strict=True))


def _unpack(root: Path, revision: str, folder: Path) -> None:
    packed = _git(root, "archive", "--format=zip", revision, "sim", "ssac", "experiments")
    with zipfile.ZipFile(io.BytesIO(packed)) as code:
        code.extractall(folder)


def _git(root: Path, *arguments: str) -> bytes:
    try:
        return subprocess.run(["git", *arguments], cwd=root, capture_output=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        said = getattr(error, "stderr", None) or str(error).encode()
        raise SsacError(
            f"the code that the marks were stated for is not at hand: {said.decode().strip()}; "
            f"run the benchmark in a clone of the project with its history"
        ) from error


if __name__ == "__main__":
    print(json.dumps([asdict(row) for row in bench_machine()]))
