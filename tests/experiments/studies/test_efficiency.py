from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

from experiments.figures.efficiency import efficiency_figure, pooled
from experiments.paper.esim import csv_text
from experiments.run.cache import Cache
from experiments.studies.bound import Bound
from experiments.studies.efficiency import (
    bounded_runs,
    efficiency_command,
    efficiency_table,
    flight_bounds,
    runs_beside_bounds,
    table_flights,
)
from experiments.studies.recording_bound import KNOWN_POSE, SAMPLES, MethodBound
from ssac.errors import SsacError
from tests.experiments.reported import RIG, made_up_runs, record_flight

METHODS = ("ssac", "ssac-known", "joint", "joint-known", "tangency", "tangency-known", "zncc_e")
BOUNDED = METHODS[:-1]
T_DS_MS = (5.0, 50.0, 500.0)


def made_up_bound(duration_s: float, angle_deg: float, seed: int, method: str) -> MethodBound:
    t_d_s = 1e-6 * (angle_deg + seed) / np.sqrt(duration_s)
    known = method in KNOWN_POSE
    return MethodBound(0.3, 340, Bound(t_d_s, 0.0 if known else 1e-3, 0.0 if known else 5e-4))


def beside_bounds(methods: tuple[str, ...] = METHODS, flights: int = 3) -> pd.DataFrame:
    runs = made_up_runs(methods, flights)
    runs = runs[runs["method"].isin(SAMPLES)]
    bounds = {
        flight: {method: made_up_bound(*flight, method) for method in SAMPLES}
        for flight in product((10.0, 20.0), (30.0, 60.0, 90.0, 120.0, 150.0), range(flights))
    }
    return runs_beside_bounds(runs, bounds)


def test_every_run_stands_beside_the_bound_of_its_recording() -> None:
    beside = beside_bounds()
    assert len(beside) == 2 * 5 * 3 * 3 * len(BOUNDED)
    for row in beside.to_dict("records"):
        bound = made_up_bound(row["duration_s"], row["angle_deg"], row["flight"], row["method"])
        assert row["t_d_bound_ms"] == pytest.approx(1e3 * bound.bound.t_d_s)
        given = row["method"] in KNOWN_POSE
        assert np.isnan(row["r_bound_deg"]) == np.isnan(row["t_error_deg"]) == given
        if not given:
            assert row["t_bound_deg"] == pytest.approx(np.rad2deg(5e-4))


def test_efficiency_is_the_ratio_of_root_mean_squares() -> None:
    beside = beside_bounds()
    cells = efficiency_table(beside)
    assert len(cells) == 2 * 5 * 3 * len(BOUNDED)
    cell = cells[(cells["method"] == "joint") & (cells["t_d_ms"] == 50.0)].iloc[0]
    same = (beside["method"] == "joint") & (beside["t_d_ms"] == 50.0)
    same &= beside["duration_s"] == cell["duration_s"]
    same &= beside["angle_deg"] == cell["angle_deg"]
    own = beside[same]
    assert cell["n_runs"] == len(own) == 3
    assert cell["t_d_bound_ms"] ** 2 == pytest.approx((own["t_d_bound_ms"] ** 2).mean())
    assert cell["t_d_rms_ms"] ** 2 == pytest.approx((own["t_d_error_ms"] ** 2).mean())
    for parameter, unit in (("t_d", "ms"), ("r", "deg"), ("t", "deg")):
        ratio = cell[f"{parameter}_bound_{unit}"] / cell[f"{parameter}_rms_{unit}"]
        assert cell[f"{parameter}_efficiency"] == pytest.approx(ratio)


def test_errors_as_large_as_the_bound_lets_expect_have_efficiency_one() -> None:
    beside = pd.concat([beside_bounds(("joint",), 30)] * 10, ignore_index=True)
    noise = np.random.default_rng(0).standard_normal(len(beside))
    beside["t_d_error_ms"] = np.abs(noise) * beside["t_d_bound_ms"]
    efficiencies = efficiency_table(beside)["t_d_efficiency"]
    # 300 errors in each of 30 cells: deviations of 1 / sqrt(600), four of which are 0.16.
    assert np.all(np.abs(efficiencies - 1.0) < 0.16)
    assert efficiencies.mean() == pytest.approx(1.0, abs=0.03)


def test_a_method_that_is_given_the_pose_has_no_errors_of_it() -> None:
    cells = efficiency_table(beside_bounds())
    known = cells["method"].isin(KNOWN_POSE)
    columns = [f"{name}_{kind}" for name in "rt" for kind in ("bound_deg", "rms_deg", "efficiency")]
    assert cells.loc[known, columns].isna().all(axis=None)
    assert cells.loc[~known, columns].notna().all(axis=None)


def test_runs_that_failed_have_no_error_to_compare() -> None:
    runs = made_up_runs(("joint",), 2)
    runs.loc[0, ["status", "t_d_error_ms"]] = ["too_few_samples", np.nan]
    bounds = {flight: {"joint": made_up_bound(*flight, "joint")} for flight in table_flights()}
    cells = efficiency_table(runs_beside_bounds(runs, bounds))
    assert sorted(cells["n_runs"].unique()) == [1, 2]
    assert cells["t_d_efficiency"].notna().all()


def test_methods_without_runs_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "runs.csv"
    path.write_text(csv_text(made_up_runs(METHODS[2:], 1)))
    kept = bounded_runs(path)
    assert set(kept["method"]) == set(BOUNDED[2:])
    assert "has no runs of ssac, ssac-known: left out" in capsys.readouterr().err
    path.write_text(csv_text(made_up_runs(("zncc_e",), 1)))
    with pytest.raises(SsacError, match=r"runs.csv: expected runs of ssac, .*got none"):
        bounded_runs(path)
    with pytest.raises(SsacError, match=r"nothing.csv: .*run `ssac tables` first"):
        bounded_runs(tmp_path / "nothing.csv")


def test_a_flight_that_no_table_has_is_an_error(tmp_path: Path) -> None:
    runs = made_up_runs(("joint",), 1).assign(flight=12345)
    with pytest.raises(SsacError, match=r"flight 12345: in neither of esim_10 and esim_20"):
        flight_bounds(runs, Cache(tmp_path), 1)


def test_the_tables_have_a_hundred_recordings() -> None:
    assert len(table_flights()) == 2 * 5 * 10


def test_the_figure_shows_bound_and_error_of_each_method_and_angle() -> None:
    cells = efficiency_table(beside_bounds())
    figure = efficiency_figure(cells)
    assert len(figure.axes) == 6
    for number, axes in enumerate(figure.axes):
        drawn = [line for line in axes.lines if len(line.get_xdata()) == 5]
        n_methods = len(BOUNDED) if number < 2 else 3  # three give a pose
        assert len(drawn) == 2 * n_methods
        assert len(axes.collections) == n_methods
        x = np.sort(np.concatenate([line.get_xdata() for line in drawn[::2]]))
        assert np.all(np.abs(x - 30.0 * np.rint(x / 30.0)) < 15.0)  # beside its own angle
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [*BOUNDED, "root mean square error", "its Cramer-Rao bound"]


def test_offsets_are_pooled_as_many_runs_as_each_has() -> None:
    cells = pd.DataFrame(
        {"angle_deg": [30.0, 30.0, 60.0], "n_runs": [1, 3, 2], "t_d_rms_ms": [2.0, 1.0, 5.0]}
    )
    found = pooled(cells, ["t_d_rms_ms"])["t_d_rms_ms"]
    assert list(found) == pytest.approx([np.sqrt((4.0 + 3.0) / 4.0), 5.0])


@pytest.mark.render
def test_the_command_goes_from_runs_to_tables_and_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "recording"
    scene = record_flight(folder)
    T_2_1 = np.eye(4)
    T_2_1[:3, :3], T_2_1[:3, 3] = scene.R, scene.t
    rig = RIG.replace("cam1: *camera", "cam1:\n  <<: *camera")
    (folder / "rig_extrinsics.yaml").write_text(f"{rig}  T_cn_cnm1: {T_2_1.tolist()}\n")
    monkeypatch.setattr(Cache, "recording_folder", lambda *_: folder)
    runs = made_up_runs(("joint", "ssac", "ssac-known", "zncc_e"), 1)
    (tmp_path / "runs.csv").write_text(csv_text(runs[runs["angle_deg"] == 90.0]))
    app = typer.Typer()
    app.command()(efficiency_command)
    options = ["--results", tmp_path, "--cache", tmp_path / "cache", "--out", tmp_path]
    arguments = [str(one) for one in (*options, "--workers", 1)]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    cells = pd.read_csv(tmp_path / "efficiency.csv")
    assert list(cells)[:7] == [
        "duration_s", "angle_deg", "t_d_ms", "method", "n_runs", "sigma_px", "n_samples",
    ]  # fmt: skip
    assert len(cells) == 2 * len(T_DS_MS) * 3
    assert len(pd.read_csv(tmp_path / "efficiency_runs.csv")) == len(cells)
    assert (cells["t_d_efficiency"] > 0.0).all()
    for name in ("efficiency", "efficiency_runs"):
        assert (tmp_path / f"{name}.provenance.json").is_file()
    with Image.open(tmp_path / "efficiency.png") as image:
        assert len(image.convert("RGB").getcolors(1 << 16) or ()) > 10  # not blank
