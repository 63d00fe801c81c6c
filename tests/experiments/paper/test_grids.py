"""The tables' grids: their axes are the paper's."""

from experiments.lab.grid import named_config
from experiments.paper.comparison import load_published
from experiments.paper.grids import table_axes, table_cells, table_grids


def test_the_axes_are_those_of_the_published_tables() -> None:
    axes, published = table_axes(), load_published()
    assert axes.durations_s == tuple(published) == (10.0, 20.0)
    for table in published.values():
        assert axes.angles_deg == tuple(sorted(set(table["angle_deg"])))
        assert axes.t_ds_ms == tuple(sorted(set(table["t_d_ms"]))) == (5.0, 50.0, 500.0)


def test_the_cells_are_those_of_both_grids_in_their_order() -> None:
    assert [grid.name for grid in table_grids()] == ["esim_10", "esim_20"]
    ten, twenty = (named_config(name).cells() for name in ("esim_10", "esim_20"))
    assert list(table_cells()) == ten + twenty
