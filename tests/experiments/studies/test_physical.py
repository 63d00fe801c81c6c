"""The studies of the bench: their recordings and their light."""

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


def test_a_ratio_and_its_inverse_are_the_same_cameras_with_their_lights_swapped() -> None:
    effects = [cell.sim.effects for cell in physical.light_cells(1)]
    lights = {(one.illuminance_lux, one.illuminance_lux * one.camera2_light) for one in effects}
    rounded = {(round(first, 6), round(second, 6)) for first, second in lights}
    assert {(second, first) for first, second in rounded} == rounded
