"""All studies: their names, keys and flights."""

import ast
from collections import defaultdict
from pathlib import Path

import pandas as pd
import pytest

from experiments.measures import recording_bound
from experiments.run.code import ROOT
from experiments.run.grid import config_names, flight_seed, named_config
from experiments.studies.catalogue import ABLATIONS, STUDIES
from experiments.studies.fidelity import fidelity_cells, fidelity_table

OWN_FLIGHTS = ("coverage", "refusal", "tangency", "zncc", "fidelity")
"""Studies whose flights are those of no table."""


def test_every_grid_of_the_project_is_a_table_or_a_study() -> None:
    tables = {"esim_10", "esim_20"}
    assert {name for name in config_names("") if name not in STUDIES} == tables
    assert [study.name for study in ABLATIONS.values()] == config_names("ablation_")
    assert all(name == study.name for name, study in STUDIES.items())


@pytest.mark.parametrize("name", STUDIES)
def test_keys_tell_all_cells_apart_and_seeds_follow_from_the_columns(name: str) -> None:
    study = STUDIES[name]
    cells = study.cells()
    table = pd.DataFrame([cell.columns for cell in cells])
    keys = table[list(study.keys)].astype(str)
    assert not keys.duplicated().any()
    for cell in cells[:: max(1, len(cells) // 50)]:
        sim, seed = cell.recordings[0]
        expected = flight_seed(sim.spline.duration_s, sim.angle_deg, cell.columns["flight"])
        assert seed == cell.columns["seed"] == expected


def test_flights_of_studies_are_of_no_table() -> None:
    seeds: dict[str, set[int]] = defaultdict(set)
    for table in ("esim_10", "esim_20"):
        seeds["tables"] |= {cell.seed for cell in named_config(table).cells()}
    for name in OWN_FLIGHTS:
        seeds[name] = {cell.columns["seed"] for cell in STUDIES[name].cells()}
    names = list(seeds)
    for at, name in enumerate(names):
        for other in names[at + 1 :]:
            assert not seeds[name] & seeds[other], (name, other)


def test_what_measures_draws_nothing() -> None:
    """So that another drawing makes no row new."""
    folder = Path(recording_bound.__file__).parent
    for path in [*folder.glob("*.py"), ROOT / "experiments/run/scored.py"]:
        for node in ast.walk(ast.parse(path.read_text())):
            module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
            assert not module.startswith(("matplotlib", "experiments.figures")), path


def test_fidelity_sums_up_each_duration() -> None:
    assert len(fidelity_cells({10.0: 2, 20.0: 1})) == 3
    rows = [
        {"duration_s": 10.0, "status": "ok", "n_reference": 10, "median_us": 40.0,
         "joint_t_d_difference_ms": sign * 0.02}
        for sign in (1.0, -1.0)
    ]  # fmt: skip
    rows.append({**rows[0], "status": "crashed", "median_us": 99.0})
    names = ("p95_us", "spurious", "missing", "ssac_t_d_difference_ms",
             "ssac_known_t_d_difference_ms", "tangency_t_d_difference_ms")  # fmt: skip
    (row,) = fidelity_table(pd.DataFrame(rows).assign(**dict.fromkeys(names, 0.5))).to_dict(
        "records"
    )
    assert (row["n_runs"], row["failed"], row["n_reference"], row["median_us"]) == (3, 1, 10, 40.0)
    assert row["joint_t_d_difference_ms"] == 0.02
