import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import typer
from typer.testing import CliRunner

from experiments.bench.bench import bench_command
from experiments.bench.growth import (
    COLUMNS,
    POINTS,
    STEPS,
    Extent,
    Point,
    bench_config,
    exponent,
    growth_rows,
    measure_growth,
    points_of,
)
from experiments.drawing.growth import growth_figure
from experiments.lab.files import png_bytes, read_checksums, read_table
from tests.experiments.grown import made_up_growth


def test_a_short_run_leaves_the_largest_points_out() -> None:
    short, full = points_of(Extent.SHORT), points_of(Extent.FULL)
    assert set(short) < set(full)
    assert {one.sensor for one in short} == {"346 x 260", "1280 x 720"}
    assert [one.duration_s for one in full] == 2 * [5.0, 20.0, 60.0, 120.0]


def test_an_exponent_is_that_of_the_power() -> None:
    events = pd.Series([1e5, 1e6, 3e7])
    for power in (0.5, 1.0, 2.0):
        assert exponent(events, 7.0 * events**power) == pytest.approx(power, abs=1e-12)  # rounding


def test_what_is_linear_meets_the_marks_and_what_is_not_misses_them() -> None:
    name = "growth, 1280 x 720: synchronise, {} over events"
    linear = {row.name: row for row in growth_rows(made_up_growth())}
    assert {row.verdict for row in linear.values() if row.mark} == {"meets"}
    assert linear["growth, 1280 x 720: synchronise, memory of an event"].value == pytest.approx(45)
    table = made_up_growth()
    for column in ("wall_s", "cpu_s", "peak_mb"):
        table[column] *= table["events_per_camera"] / 5e6
    steep = {row.name: row for row in growth_rows(table)}
    assert steep[name.format("time")].verdict == steep[name.format("memory")].verdict == "misses"
    assert steep["growth, largest pair: synchronise"].verdict == "misses"


def test_a_pair_too_small_for_the_marks_is_not_held_against_them() -> None:
    short = [one.duration_s for one in points_of(Extent.SHORT) if one.sensor == "1280 x 720"]
    table = made_up_growth()
    table = table[(table["sensor"] == "346 x 260") | table["duration_s"].isin(short)]
    marked = [row.name for row in growth_rows(table) if row.mark and "largest" in row.name]
    assert not marked


def test_a_point_that_was_not_measured_is_a_row_and_left_out_elsewhere() -> None:
    table = made_up_growth()
    numbers = ["events_per_camera", "wall_s", "cpu_s", "peak_mb", "t_d_error_ms"]
    table.loc[15, numbers] = np.nan
    table.loc[15, "status"] = "not measured (MemoryError)"
    first, *others = growth_rows(table)
    assert first.name == "growth, 1280 x 720, 120 s, synchronise: not measured (MemoryError)"
    assert np.isnan(first.value)
    assert np.isfinite([row.value for row in others]).all()
    assert png_bytes(growth_figure(table)) != png_bytes(growth_figure(made_up_growth()))


def test_nothing_measured_is_drawn_and_summed_up_as_nothing() -> None:
    table = made_up_growth()
    table[["wall_s", "peak_mb"]] = np.nan
    table["status"] = "not measured (killed)"
    assert all(np.isnan(row.value) for row in growth_rows(table))
    assert png_bytes(growth_figure(table))


@pytest.mark.render
def test_each_step_of_a_point_is_measured_in_a_process_of_its_own() -> None:
    point = Point(96, 72, 60.0, 0.5, 1e4)
    said: list[str] = []
    table = measure_growth((point,), said.append)
    assert tuple(table) == COLUMNS
    assert list(table["step"]) == list(STEPS)
    assert len(said) == 2
    assert (table[["wall_s", "cpu_s", "peak_mb"]] > 0.0).all(axis=None)
    assert table["status"][0] == "ok"
    assert table["status"][1] not in ("ok", "")  # half a second tells no offset
    assert len(set(table["events_per_camera"])) == 1


def test_a_step_that_fails_says_why() -> None:
    point = Point(0, 0, 60.0, 0.5, 1e4)
    table = measure_growth((point,), lambda line: None)
    assert table["status"].str.startswith("not measured (").all()
    assert table["wall_s"].isna().all()


def test_every_point_is_listed_once() -> None:
    assert len({(one.sensor, one.duration_s) for one in POINTS}) == len(POINTS) == 8


@pytest.mark.parametrize(("extent", "command"), [("short", ""), ("full", " --growth full")])
def test_the_command_writes_numbers_figure_and_what_they_were_made_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, extent: str, command: str
) -> None:
    monkeypatch.setattr("experiments.bench.bench.PARTS", {})
    monkeypatch.setattr("experiments.bench.bench.measure_growth", lambda *_: made_up_growth())
    app = typer.Typer()
    app.command()(bench_command)
    arguments = ["--out", str(tmp_path / "bench.csv"), "--growth", extent]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert "growth, largest pair: synchronise, peak memory" in result.stdout
    names = {"bench.csv", "bench_growth.csv", "bench_growth.png"}
    for name in ("bench", "bench_growth"):
        provenance = json.loads((tmp_path / f"{name}.provenance.json").read_text())
        names.add(f"{name}.provenance.json")
        assert provenance["command"] == f"ssac bench{command}"
        assert provenance["config"] == bench_config(Extent(extent))
    assert (
        set(read_checksums(tmp_path))
        == names
        == {p.name for p in tmp_path.iterdir()} - {"SHA256SUMS"}
    )
    table = read_table((tmp_path / "bench_growth.csv").read_text())
    assert (tmp_path / "bench_growth.png").read_bytes() == png_bytes(growth_figure(table))
