"""The studies of the bench: their recordings, and what is made of their rows."""

from pathlib import Path

from experiments.lab.files import csv_text
from experiments.lab.results import Results
from experiments.studies import physical


def test_tables_share_recordings_and_set_ups_and_a_trial_run_says_that_it_has_fewer() -> None:
    cells = physical.cells(10.0)
    assert len({cell.recordings for cell in cells}) == len({cell.seed for cell in cells}) == 4 * 10
    assert len({cell.sim.setup_seed for cell in cells}) == 4
    for study in physical.STUDIES:
        cells = study.cells(recordings=1)
        per_place = {(cell.sim.angle_deg, cell.seed) for cell in cells}
        assert len(per_place) == len({cell.sim.angle_deg for cell in cells})
        assert study.command_line({"recordings": None}) == "ssac physical"
        assert study.command_line({"recordings": 1}) == "ssac physical --recordings 1"


def test_the_papers_own_tables_agree_with_themselves(tmp_path: Path) -> None:
    names = {"ssac": "ssac_t_d", "r": "ssac_r", "t": "ssac_t"}
    for duration_s, table in physical.published_tables().items():
        ours = table.assign(n_runs=10, ssac_failed=0).rename(
            columns={f"{theirs}_error_{unit}_{part}": f"{name}_error_{unit}_{part}"
                     for theirs, name in names.items() for unit in ("ms", "deg")
                     for part in ("mean", "std")}
        )  # fmt: skip
        (tmp_path / f"mini_{duration_s:g}.csv").write_text(csv_text(ours))
    comparison = physical.comparison(Results(tmp_path))
    assert len(comparison) == len(physical.DURATIONS_S) * 12 * 3
    assert (comparison["verdict"] == "agrees").all()


def test_a_ratio_and_its_inverse_are_the_same_cameras_with_their_lights_swapped() -> None:
    effects = [cell.sim.effects for cell in physical.light_cells(1)]
    lights = {(one.illuminance_lux, one.illuminance_lux * one.camera2_light) for one in effects}
    rounded = {(round(first, 6), round(second, 6)) for first, second in lights}
    assert {(second, first) for first, second in rounded} == rounded
