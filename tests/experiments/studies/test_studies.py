"""All studies: their names, keys and flights. `make verify` holds committed files to their rows."""

from collections import defaultdict
from itertools import combinations
from pathlib import Path

import pandas as pd
import pytest

from experiments.lab.grid import config_names, flight_seed, named_config
from experiments.lab.provenance import write_provenance
from experiments.lab.study import How
from experiments.lab.verify import cells_of
from experiments.studies import all_studies
from experiments.studies.ablations import ABLATIONS

STUDIES = all_studies()

WITH_CELLS = [
    name
    for name, study in STUDIES.items()
    if study.runs is not None and study.runs.table is None and study.how is not How.GIVEN
]

OWN_FLIGHTS = (
    *("coverage", "refusal", "imperfect", "marks", "tangency", "fidelity"),
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
    cells = cells_of(STUDIES[name])
    table = pd.DataFrame([cell.columns for cell in cells])
    keys = table[list(STUDIES[name].runs.keys)].astype(str)
    assert not keys.duplicated().any()
    for cell in cells[:: max(1, len(cells) // 50)]:
        if name.startswith(("network", "outdoor", "mini", "error", "light")):
            continue  # scenes of their own, whose seeds are counted
        sim, seed = cell.recordings[0]
        number, base = cell.columns["flight"], cell.columns.get("base", 0)
        expected = flight_seed(sim.spline.duration_s, sim.angle_deg, number, base)
        assert seed == cell.columns["seed"] == expected


@pytest.mark.parametrize("name", STUDIES)
def test_the_provenance_of_every_file_can_be_written(name: str, tmp_path: Path) -> None:
    for file, config in STUDIES[name].provenances.items():
        write_provenance(tmp_path / file, {"config": config})


def test_flights_of_studies_are_their_own() -> None:
    seeds: dict[str, set[int]] = defaultdict(set)
    for table in ("esim_10", "esim_20"):
        seeds["tables"] |= {cell.seed for cell in named_config(table).cells()}
    for name in OWN_FLIGHTS:
        cells = cells_of(STUDIES[name])
        seeds[name] = {cell.columns["seed"] for cell in cells}
        others = {cell.other_seed for cell in cells if hasattr(cell, "other_seed")}
        assert not seeds[name] & others, name
    for (name, mine), (other, theirs) in combinations(seeds.items(), 2):
        assert not mine & theirs, (name, other)
