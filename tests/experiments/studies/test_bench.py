"""The benchmark: its parts, the tables of their measurements, the growth of time and memory."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments import machine
from experiments.lab.cache import Cache
from experiments.lab.results import Results, csv_text, png_bytes
from experiments.lab.schedule import Workers, run_cells, run_task
from experiments.machine import PART, POINTS, STEP, STEPS, PartCell, Point, StepCell
from experiments.studies import bench
from experiments.studies.bench import GROWTH, bench_table, growth_rows, growth_table
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig
from ssac.estimate import Estimate
from ssac.pipeline.registry import METHODS


def made_up_growth() -> pd.DataFrame:
    rows = []
    for point in POINTS:
        n = point.events_per_s * point.duration_s
        for step, s, bytes_, base_mb, error_ms in (
            ("simulate", 7e-6, 26.0, 400.0, np.nan),
            ("synchronise", 6e-7, 90.0, 300.0, 0.01),
        ):
            took_s, mb = 0.1 + s * n, base_mb + bytes_ * n / 2**20
            of_point = (point.sensor, point.duration_s, step, n)
            rows.append((*of_point, took_s, took_s, mb, "ok", error_ms))
    return pd.DataFrame(rows, columns=list(GROWTH.runs.columns))


def test_a_part_that_cannot_be_measured_is_a_row_and_not_a_gap(tmp_path: Path) -> None:
    results = Results(tmp_path, {"bench_growth.csv": csv_text(made_up_growth())})
    done = run_task((PartCell("no-such-part"),), Cache(tmp_path), PART)
    ok = {"part": "a", "status": "ok", "reason": "", "measurements": []}
    table = bench_table(pd.DataFrame([ok, {"part": "no-such-part", **done.rows[0]}]), results)
    assert table["name"][0].startswith("no-such-part: not measured (no-such-part: KeyError")
    assert np.isnan(table["value"][0])
    assert table["name"].tolist()[1:] == [row.name for row in growth_rows(made_up_growth())]


@pytest.mark.render
def test_renderers_and_methods_are_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "N_POSES", 20)
    monkeypatch.setattr(machine, "REPEATS", 1)
    monkeypatch.setattr(machine, "OURS", [METHODS["joint"], METHODS["zncc_f"]])
    short = SimConfig(spline=SplineConfig(duration_s=3.0))
    rows = [*machine.bench_rendering(), *machine.bench_sync(short)]
    names = [f"sync, {name}: all but reading" for name in ("joint", "zncc_f")]
    assert [row.name for row in rows[2:]] == names
    assert [np.isfinite(row.mark) for row in rows] == [False, True, False, False]
    assert all(row.value > 0.0 for row in rows)


def test_what_is_linear_meets_the_marks_and_what_is_not_misses_them() -> None:
    name = "growth, 1280 x 720: synchronise, {} over events"
    linear = {row.name: row for row in growth_rows(made_up_growth())}
    assert {row.verdict for row in linear.values()} == {"meets", ""}
    table = made_up_growth()
    for column in ("wall_s", "cpu_s", "peak_mb"):
        table[column] *= table["events_per_camera"] / 5e6
    steep = {row.name: row for row in growth_rows(table)}
    assert steep[name.format("time")].verdict == steep[name.format("memory")].verdict == "misses"
    assert steep["growth, largest pair: synchronise, peak memory"].verdict == "misses"
    short = table[table["events_per_camera"] <= bench.SHORT_EVENTS]  # too small for these marks
    assert 0 < len(short) < len(table)
    assert not [row.name for row in growth_rows(short) if row.verdict and "largest" in row.name]


def test_a_point_that_was_not_measured_is_a_row_and_left_out_elsewhere() -> None:
    table, numbers = made_up_growth(), [*GROWTH.runs.columns[3:7], "t_d_error_ms"]
    table.loc[15, numbers] = np.nan
    table.loc[15, "status"] = "not measured (MemoryError)"
    first, *others = growth_rows(table)
    assert first.name == "growth, 1280 x 720, 120 s, synchronise: not measured (MemoryError)"
    assert np.isnan(first.value)
    assert np.isfinite([row.value for row in others]).all()
    whole = png_bytes(bench.growth_figure(made_up_growth()))
    assert png_bytes(bench.growth_figure(table)) != whole
    table.loc[:, numbers], table["status"] = np.nan, "not measured (killed)"
    assert all(np.isnan(row.value) for row in growth_rows(table))
    assert png_bytes(bench.growth_figure(table)) != whole  # it is empty


@pytest.mark.render
def test_steps_of_a_point_are_measured_or_say_why_not(tmp_path, monkeypatch) -> None:
    def synced(*files: Path) -> SimpleNamespace:
        assert all(file.exists() for file in files)
        return SimpleNamespace(estimate=Estimate("tangency", t_d_s=machine.T_D_S + 1e-3))

    tiny, none = Point(96, 72, 60.0, 0.5, 1e4), Point(0, 0, 60.0, 0.5, 1e4)
    monkeypatch.setattr(machine, "POINTS", (tiny,))
    monkeypatch.setattr(machine, "sync", synced)
    cells = [*(StepCell(tiny, step) for step in STEPS), StepCell(none, STEPS[0])]
    runs = run_cells(cells, Cache(tmp_path), Workers(1), measure=STEP).runs
    table = growth_table(runs, Results(Path()))
    assert (table.loc[:1, ["wall_s", "cpu_s", "peak_mb"]] > 0.0).all(axis=None)
    assert list(table["status"][:2]) == ["ok", "ok"]
    assert table["t_d_error_ms"][1] == pytest.approx(1.0)
    assert len(set(table["events_per_camera"])) == 1
    assert table["status"][2].startswith("not measured (")
    assert np.isnan(table["wall_s"][2])
