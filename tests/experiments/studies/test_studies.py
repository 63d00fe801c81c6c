"""All studies: their names, keys and flights, and that committed files follow from their rows."""

from collections import defaultdict
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.lab.grid import config_names, flight_seed, named_config
from experiments.lab.results import Results
from experiments.lab.study import How
from experiments.lab.verify import study_findings
from experiments.studies import all_studies
from experiments.studies.ablations import ABLATIONS
from experiments.studies.fidelity import (
    DIFFERENCES,
    RENDERER_FLIGHTS,
    fidelity_table,
    renderer_cells,
)

STUDIES = all_studies()
RESULTS = Path(__file__).resolve().parents[3] / "results"

WITH_CELLS = [
    name
    for name, study in STUDIES.items()
    if study.runs is not None and study.runs.table is None and study.how is not How.GIVEN
]

OWN_FLIGHTS = (
    *("coverage", "refusal", "imperfect", "marks", "tangency", "zncc", "fidelity"),
    *("mini_10", "mini_20", "error_budget", "light_latency"),
)
"""Studies whose flights are those of no table."""


def test_every_grid_of_the_project_is_a_table_or_a_study() -> None:
    tables = {"esim_10", "esim_20"}
    assert {name for name in config_names("") if name not in STUDIES} == tables
    assert [study.name for study in ABLATIONS.values()] == config_names("ablation_")
    assert all(name == study.name for name, study in STUDIES.items())


@pytest.mark.parametrize("name", WITH_CELLS)
def test_keys_tell_all_cells_apart_and_seeds_follow_from_the_columns(name: str) -> None:
    study = STUDIES[name]
    cells = study.cells()
    table = pd.DataFrame([cell.columns for cell in cells])
    keys = table[list(study.runs.keys)].astype(str)
    assert not keys.duplicated().any()
    for cell in cells[:: max(1, len(cells) // 50)]:
        if name.startswith(("network", "outdoor", "mini", "error", "light")):
            continue  # scenes of their own, whose seeds are counted
        sim, seed = cell.recordings[0]
        expected = flight_seed(sim.spline.duration_s, sim.angle_deg, cell.columns["flight"])
        assert seed == cell.columns["seed"] == expected


def test_flights_of_studies_are_their_own() -> None:
    seeds: dict[str, set[int]] = defaultdict(set)
    for table in ("esim_10", "esim_20"):
        seeds["tables"] |= {cell.seed for cell in named_config(table).cells()}
    for name in OWN_FLIGHTS:
        cells = STUDIES[name].cells()
        seeds[name] = {cell.columns["seed"] for cell in cells}
        others = {cell.other_seed for cell in cells if hasattr(cell, "other_seed")}
        assert not seeds[name] & others, name
    for (name, mine), (other, theirs) in combinations(seeds.items(), 2):
        assert not mine & theirs, (name, other)


@pytest.mark.parametrize("name", [name for name, study in STUDIES.items() if study.is_committed])
def test_what_is_committed_follows_from_its_rows(name: str) -> None:
    """Rows are those of the cells; tables, pages and figures come out byte for byte."""
    findings = study_findings(STUDIES[name], Results(RESULTS))
    assert not {one.what: one.faults for one in findings if one.faults}


def test_fidelity_has_means_with_their_standard_errors_and_the_largest() -> None:
    sizes = np.array([0.01, 0.03, 0.02, 0.06])
    values = dict.fromkeys(DIFFERENCES, sizes * [1, -1, 1, -1])
    runs = pd.DataFrame({"duration_s": 20.0, "status": "ok", "n_reference": 5, "median_us": 1.0,
                         "p95_us": 2.0, "spurious": 0.0, "missing": 0.0, **values})  # fmt: skip
    crashed = runs.iloc[:1].assign(status="crashed", median_us=99.0)
    (row,) = fidelity_table(pd.concat([runs, crashed])).to_dict("records")
    assert (row["n_runs"], row["failed"], row["n_reference"], row["median_us"]) == (5, 1, 20, 1.0)
    for name in DIFFERENCES:
        start = name.removesuffix("_ms")
        assert row[name] == pytest.approx(0.03)
        assert row[f"{start}_se_ms"] == pytest.approx(sizes.std(ddof=1) / 2)
        assert row[f"{start}_max_ms"] == 0.06
    (alone,) = fidelity_table(runs.iloc[:1]).to_dict("records")
    assert np.isnan(alone["ssac_t_d_difference_se_ms"])  # one flight does not tell


def test_the_renderers_are_compared_on_flights_of_the_tables() -> None:
    cells = renderer_cells()
    assert len(cells) == 2 * 5 * RENDERER_FLIGHTS
    of_tables = {(c.sim, c.seed) for t in ("esim_10", "esim_20") for c in named_config(t).cells()}
    for cell in cells:
        assert (replace(cell.sim, t_d_s=0.0), cell.seed) in of_tables
        render = cell.reference.render
        assert render == replace(cell.sim.render, renderer="pyrender") != cell.sim.render
