"""All studies: their names, keys, flights and checks. `make verify` compares committed rows."""

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pandas as pd
import pytest

from experiments.lab.cell import CRASHED, Flight
from experiments.lab.grid import Cell, config_names, flight_seed, named_config
from experiments.lab.provenance import provenance_file
from experiments.lab.results import Results, csv_text
from experiments.lab.study import How
from experiments.lab.verify import cells_of, study_findings
from experiments.machine import measured_cells
from experiments.paper.esim import table_cells
from experiments.studies import all_studies, figures, physical
from experiments.studies.ablations import ABLATIONS
from experiments.studies.fidelity import renderer_cells
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from tests.experiments.reported import RESULTS

STUDIES = all_studies()

WITH_CELLS = [
    name
    for name, study in STUDIES.items()
    if study.runs.file and study.runs.table is None and study.how is not How.GIVEN
]

OWN_FLIGHTS = ("coverage", "refusal", "imperfect", "marks", "tangency", "fidelity", "mini_10",
               "mini_20", "error_budget", "light_latency")  # fmt: skip
"""Studies none of whose flights is one of the tables or of another study."""


def test_every_grid_of_the_project_is_a_table_or_a_study() -> None:
    assert {*config_names("")} - {*STUDIES} == {"esim_10", "esim_20"}
    assert [study.name for study in ABLATIONS.values()] == config_names("ablation_")
    assert all(name == study.name for name, study in STUDIES.items())


@pytest.mark.parametrize("name", WITH_CELLS)
def test_keys_tell_all_cells_apart_and_seeds_follow_from_the_columns(name: str) -> None:
    cells = cells_of(STUDIES[name])
    table = pd.DataFrame([cell.columns for cell in cells])
    assert not table[list(STUDIES[name].runs.keys)].astype(str).duplicated().any()
    for cell in cells[:: max(1, len(cells) // 50)]:
        if name.startswith(("network", "outdoor", "mini", "error", "light")):
            continue  # scenes of their own, with other seeds
        sim, seed = cell.recordings[0]
        number, base = cell.columns["flight"], cell.columns.get("base", 0)
        expected = flight_seed(sim.spline.duration_s, sim.angle_deg, number, base)
        assert seed == cell.columns["seed"] == expected


@pytest.mark.parametrize("name", STUDIES)
def test_the_provenance_of_every_file_can_be_written(name: str) -> None:
    for file, config in STUDIES[name].provenances.items():
        provenance_file(file, {"config": config})


RUN = "method == 'ssac' and t_d_ms == 500 and status == 'ok'"
OF_CORRELATION = RUN.replace("ssac", "zncc_e")


@pytest.mark.parametrize(
    ("name", "table", "where", "changed", "fault"),
    [
        ("tables", "runs", RUN, {}, None),
        ("tables", "runs", RUN, {"status": CRASHED}, "no run crashed"),
        *(("tables", "runs", RUN, change, "errors are possible ones") for change in (
            {"t_d_error_ms": -1.0}, {"t_d_error_ms": np.nan}, {"t_d_estimate_ms": np.nan})),
        ("tables", "runs", RUN, {"r_error_deg": 181.0}, "angles are angles"),
        ("tables", "runs", RUN, {"t_error_deg": -0.1}, "angles are angles"),
        ("tables", "runs", RUN, {"t_d_estimate_ms": 77.0}, "errors are those of the estimates"),
        ("tables", "runs", RUN, {"r_error_deg": np.nan}, "a method gives a pose always or never"),
        *(("tables", "runs", RUN, {one: 7}, "all runs on a flight saw the same events")
          for one in ("n_events_cam1", "n_events_cam2", "seed")),
        # The search around 500 ms ends at 1500 ms.
        ("tables", "runs", OF_CORRELATION, {"t_d_error_ms": 1.5e3, "t_d_estimate_ms": -1e3},
         "errors are possible ones"),
        # The CSV has six digits of 1412.345 ms; the rounding is no fault.
        ("tables", "runs", OF_CORRELATION, {"t_d_error_ms": 912.345, "t_d_estimate_ms": 1412.345},
         None),
        ("bench", "bench", "value > 0", {}, None),
        ("bench", "bench", "verdict == 'meets'", {"verdict": "misses"}, "it is a benchmark"),
        ("bench", "bench", "value > 0", {"value": 0.0}, "it is a benchmark"),
        ("bench", "bench_growth", "sensor == '1280 x 720'", {"peak_mb": 1e6}, "it is a benchmark"),
        ("bench_growth", "bench_growth", "status == 'ok'", {}, None),
        *(("bench_growth", "bench_growth", "status == 'ok'", change, "every step was measured")
          for change in ({"status": "no_match"}, {"cpu_s": np.nan})),
    ],
)  # fmt: skip
def test_an_impossible_number_is_found(name, table, where, changed, fault) -> None:
    """The first matching committed row is changed. `test_real.py` tests the checks of `real`."""
    rows = Results(RESULTS).table(table)
    for column, value in changed.items():
        rows.loc[rows.query(where).index[0], column] = value
    results = Results(RESULTS, {f"{table}.csv": csv_text(rows)})
    found = [what for what, check in STUDIES[name].checks if list(check(results))]
    assert (fault in found) if fault else not found


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({}, None),
        ({"status": "wrong"}, "row 0: its status is unknown"),
        ({"status": CRASHED}, "row 0: no reason"),
        ({"t_d_estimate_ms": np.nan}, "row 0: ok without an estimate"),
        ({"t_d_std_ms": -1.0}, "row 0: t_d_std_ms is negative"),
    ],
)
def test_a_run_that_makes_no_sense_is_found_in_any_study(changed, fault) -> None:
    study = replace(STUDIES["ablation_focal"], makes=(), checks=())
    runs = Results(RESULTS).table("ablation_focal_runs")
    for column, value in changed.items():
        runs.loc[0, column] = value
    findings = study_findings(study, Results(RESULTS, {study.runs.file: csv_text(runs)}))
    (found,) = (one.faults for one in findings if "known statuses" in one.what)
    assert any(fault in one for one in found) if fault else not found


def test_flights_of_studies_are_their_own() -> None:
    seeds: dict[str, set[int]] = defaultdict(set)
    seeds["tables"] = {cell.seed for cell in table_cells()}
    for name in OWN_FLIGHTS:
        cells = cells_of(STUDIES[name])
        seeds[name] = {cell.columns["seed"] for cell in cells}
        assert not seeds[name] & {getattr(cell, "other_seed", None) for cell in cells}, name
    for (name, mine), (other, theirs) in combinations(seeds.items(), 2):
        assert not mine & theirs, (name, other)


def flights(cells: Iterable[Cell]) -> set[Flight]:
    """Return the recordings of cells; these do not depend on the time offset."""
    return {(replace(cell.sim, t_d_s=0.0), cell.seed) for cell in cells}


def test_what_stands_beside_the_tables_is_of_their_flights() -> None:
    of_tables, measured = flights(table_cells()), flights(measured_cells())
    of_estimator = ("window", "n_min", "samples", "angle")
    ablations = [flights(named_config(f"ablation_{name}").cells()) for name in of_estimator]
    plain = {(figures.FLIGHT, figures.SEED)}
    assert of_tables.issuperset(plain.union(measured, flights(renderer_cells()), *ablations))
    assert Counter(sim.spline.duration_s for sim, _ in measured) == {10.0: 4, 20.0: 4}
    grid = named_config("ablation_davis346")
    noisy = {"frames": FrameConfig(rate_hz=0.0), "sensor": PRESETS["davis346"]}
    few = [replace(cell, sim=replace(cell.sim, **noisy)) for cell in table_cells()
           if cell.flight < grid.flights]  # fmt: skip
    assert flights(grid.cells()) == flights(few)
    assert (figures.NOISY_FLIGHT, figures.NOISY_SEED) in flights(few)


def test_tables_of_the_bench_share_recordings_and_a_trial_run_says_that_it_has_fewer() -> None:
    cells = physical.cells(10.0)
    assert len({cell.recordings for cell in cells}) == len({cell.seed for cell in cells}) == 4 * 10
    assert len({cell.sim.setup_seed for cell in cells}) == 4
    for study in physical.STUDIES:
        of_places = {(cell.sim.angle_deg, cell.seed) for cell in study.cells(recordings=1)}
        assert len(of_places) == len(dict(of_places))
        assert study.command_line({"recordings": None}) == "ssac physical"
        assert study.command_line({"recordings": 1}) == "ssac physical --recordings 1"
    line = STUDIES["by_hand"].command_line({"first": 9, "every": True})
    assert line == "ssac by-hand --first 9 --every"


def test_a_ratio_and_its_inverse_are_the_same_cameras_with_their_lights_swapped() -> None:
    effects = [cell.sim.effects for cell in physical.light_cells(1)]
    lights = {(one.illuminance_lux, one.illuminance_lux * one.camera2_light) for one in effects}
    rounded = {(round(first, 6), round(second, 6)) for first, second in lights}
    assert {(second, first) for first, second in rounded} == rounded
