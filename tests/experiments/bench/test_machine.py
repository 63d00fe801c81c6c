"""Code with a benchmark of its own in a repository's history, measured again and compared."""

import subprocess
from pathlib import Path

import pytest

from experiments.bench.machine import AS_THERE, FACTOR, TIMED, as_there, bench_machine
from experiments.bench.measurement import Measurement
from ssac.errors import SsacError

TANGENCY, JOINT, DRAWN = TIMED

BENCHMARK = f'''
from experiments.measurement import Measurement

def bench_tangency():
    return [Measurement("{TANGENCY}", 1.5, "s")]

def bench_estimate():
    return [Measurement("{JOINT}", 0.4, "s")]
'''
MEASUREMENT = """
from dataclasses import dataclass

@dataclass
class Measurement:
    name: str
    value: float
    unit: str
"""
RECORDING = """
from dataclasses import dataclass

@dataclass
class SimConfig:
    spline: object = None

def simulate(config, seed):
    pass
"""
TRAJECTORY = """
from dataclasses import dataclass

@dataclass
class SplineConfig:
    duration_s: float
"""


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository whose code took half of 1.5 s, and a quarter of 0.4 s, on another machine."""
    root = tmp_path / "repository"
    stated = f'name,value\n"{TANGENCY}",0.75\n"{JOINT}",0.1\n"{DRAWN}",8.0\n'
    for name, text in {
        "experiments/__init__.py": "",
        "experiments/bench_sync.py": BENCHMARK,
        "experiments/measurement.py": MEASUREMENT,
        "sim/__init__.py": "",
        "sim/recording.py": RECORDING,
        "sim/trajectory.py": TRAJECTORY,
        "ssac/__init__.py": "",
        "results/bench.csv": stated,
    }.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    author = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for command in (["init", "-q"], ["add", "."], [*author, "commit", "-q", "-m", "Begin"]):
        subprocess.run(["git", *command], cwd=root, check=True)
    return root


def test_a_machine_is_as_slow_as_the_least_of_what_is_compiled_says(repository: Path) -> None:
    rows = {row.name: row.value for row in bench_machine(repository, "HEAD")}
    slower = {row: rows[f"machine, {what}: times as slow"] for row, what in TIMED.items()}
    assert slower[TANGENCY] == pytest.approx(2.0)
    assert slower[JOINT] == pytest.approx(4.0)
    assert slower[DRAWN] < 1.0  # nothing is drawn there; it does not count
    assert rows[FACTOR] == slower[TANGENCY]


def test_times_with_a_mark_are_held_against_it_as_on_its_machine() -> None:
    rows = [
        Measurement("a", 3.0, "s", 2.0),
        Measurement("b", 3.0, "s"),
        Measurement("c", 3.0, "MB", 2.0),
        Measurement("d", 9.0, "s", 2.0),
        Measurement(FACTOR, 2.0, "x"),
    ]
    assert [(row.name, row.value, row.mark, row.verdict) for row in as_there(rows)] == [
        (f"a, {AS_THERE}", 1.5, 2.0, "meets"),
        (f"d, {AS_THERE}", 4.5, 2.0, "misses"),
    ]
    assert as_there(rows[:-1]) == []  # its code could not be measured


@pytest.mark.parametrize("revision", ["HEAD", "0123456789ab"])
def test_without_that_code_one_line_says_what_to_do(tmp_path: Path, revision: str) -> None:
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    with pytest.raises(SsacError, match="in a clone of the project with its history"):
        bench_machine(tmp_path, revision)
