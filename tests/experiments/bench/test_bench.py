import math

import pytest

from experiments.bench.bench import PARTS, _in_own_process, bench_sensor
from experiments.bench.measurement import Measurement


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
    assert {"render-osmesa", "render-egl", "sensor", "recording", "sync", "tables"} <= set(PARTS)


@pytest.mark.render
def test_the_sensor_is_timed_on_events(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.bench.bench.N_SENSOR_FRAMES", 20)
    monkeypatch.setattr("experiments.bench.bench.REPEATS", 1)
    rows = {(row.name, row.unit): row.value for row in bench_sensor()}
    assert all(value > 0 for value in rows.values())
