import math
from pathlib import Path

import pytest

from experiments.bench.bench import PARTS, _in_own_process, bench_command
from experiments.bench.measurement import Measurement
from experiments.bench.sensor import ESIM_FRAMES_PER_S, bench_sensor, beside_peers
from experiments.bench.sync import MARKS_S, bench_sync
from experiments.bench.tables import measured_cells
from experiments.paper.grids import n_recordings, table_cells
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig
from ssac.errors import SsacError
from ssac.pipeline.registry import OURS


@pytest.mark.parametrize(
    ("value", "mark", "higher", "verdict"),
    [
        (9.0, 10.0, False, "meets"),
        (11.0, 10.0, False, "misses"),
        (11.0, 10.0, True, "meets"),
        (9.0, 10.0, True, "misses"),
        (math.nan, 10.0, True, "misses"),
        (math.nan, 10.0, False, "misses"),
        (5.0, None, False, ""),
    ],
)
def test_verdict(value: float, mark: float | None, higher: bool, verdict: str) -> None:
    assert Measurement("m", value, "s", mark, higher).verdict == verdict


def test_a_part_that_cannot_be_measured_is_a_row_and_not_a_gap() -> None:
    (row,) = _in_own_process("no-such-part")
    assert "no-such-part: not measured" in row.name
    assert "No module named" not in row.name  # the part is unknown, not the benchmark
    assert math.isnan(row.value)


def test_both_backends_are_measured() -> None:
    assert {
        "render-osmesa",
        "render-egl",
        "sensor",
        "recording",
        "sync",
        "reading",
        "tables",
    } <= set(PARTS)


@pytest.mark.render
def test_the_sensor_is_timed_on_events(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.bench.sensor.N_FRAMES", 20)
    monkeypatch.setattr("experiments.bench.sensor.REPEATS", 1)
    rows = {(row.name, row.unit): row.value for row in bench_sensor()}
    assert all(value > 0 for value in rows.values())


def test_a_peer_that_is_not_installed_is_quoted_and_the_row_says_so() -> None:
    (quoted,) = beside_peers(ESIM_FRAMES_PER_S, None)
    assert quoted.name.endswith("quoted (eventify-dvs is not installed)")
    assert (quoted.value, quoted.verdict) == (1.0, "meets")
    peer, ratio, quoted = beside_peers(100.0, 50.0)
    assert (peer.value, ratio.value, ratio.verdict) == (50.0, 2.0, "meets")
    assert quoted.verdict == ""  # what is measured here is what counts


@pytest.mark.render
def test_every_stage_and_every_method_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.bench.sync.REPEATS", 1)
    rows = bench_sync(SimConfig(spline=SplineConfig(duration_s=5.0)))
    names = {row.name for row in rows}
    assert {f"sync, {method.name}: all but reading" for method in OURS} <= names
    assert {name.partition(": ")[2] for name in names if name.startswith("sync, stage")} == {
        *("reading", "checks and denoising", "tracks", "search over +-1 s", "joint refinement"),
        *("outlines and tangents", "tangents alone", "tangency refinement"),
    }
    assert sum(row.mark is not None for row in rows) == len(MARKS_S)
    assert all(
        row.value > 0.0 for row in rows if row.name != "sync, stage: outlines"
    )  # a difference


def test_the_measured_recordings_are_some_of_the_tables() -> None:
    cells = measured_cells()
    recordings = {(cell.sim, cell.seed) for cell in cells}
    assert recordings < {(cell.sim, cell.seed) for cell in table_cells()}
    durations_s = [sim.spline.duration_s for sim, _ in recordings]
    assert durations_s.count(10.0) == durations_s.count(20.0) == 4
    assert len(recordings) < n_recordings()


def test_a_target_that_is_a_folder_is_refused_before_anything_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = []
    monkeypatch.setattr("experiments.bench.bench._in_own_process", measured.append)
    with pytest.raises(SsacError, match="not a file in a folder that exists"):
        bench_command(tmp_path)
    assert not measured
