"""What commands that run cells share."""

import pytest

from experiments.paper.grids import table_cells
from experiments.run.command import drawn_by, other_than_default
from sim.errors import SimError
from sim.render.config import RENDERERS


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("check", [True, False])
def test_the_renderer_changes_what_draws_and_nothing_else(renderer: str, check: bool) -> None:
    cells = table_cells()[:7]
    drawn = drawn_by(cells, renderer, check)
    for after in drawn:
        assert (after.sim.render.renderer, after.sim.render.check) == (renderer, check)
    assert drawn_by(drawn, RENDERERS[0], True) == list(cells)


def test_an_unknown_renderer_is_refused() -> None:
    with pytest.raises(SimError, match="unknown renderer 'blender'"):
        drawn_by(table_cells()[:1], "blender", True)


def test_a_provenance_names_only_what_is_not_the_default() -> None:
    assert other_than_default("native", True) == []
    assert other_than_default("pyrender", False) == ["--renderer", "pyrender", "--no-check"]
