"""Quantities: their columns are the runs', and their labels say the unit."""

from experiments.lab.score import Score
from experiments.paper.esim import RUN_COLUMNS
from experiments.paper.quantities import ERRORS, split_quantity


def test_every_error_is_a_column_of_the_runs_and_a_field_of_the_score() -> None:
    assert set(ERRORS) <= set(RUN_COLUMNS)
    assert set(ERRORS) == set(Score.__annotations__) - {"pose"}


def test_labels_say_what_and_in_which_unit() -> None:
    assert [error.label for error in ERRORS.values()] == [
        "error of $t_d$ [ms]",
        "error of R [deg]",
        "error of t [deg]",
    ]
    assert [error.heading for error in ERRORS.values()] == ["t_d [ms]", "R [deg]", "t [deg]"]


def test_a_quantity_is_a_method_and_an_error() -> None:
    assert split_quantity("ssac-known_t_d_error_ms") == ("ssac-known", "t_d_error_ms")
    assert split_quantity("zncc_e_r_error_deg") == ("zncc_e", "r_error_deg")
    assert split_quantity("speed") == ("speed", "")
