"""What commands that run cells share."""

from pathlib import Path

import pandas as pd
import pytest
import typer

from experiments.lab.cache import Cache
from experiments.lab.cell import CRASHED
from experiments.lab.command import chosen_parts, drawn_by, finish, other_than_default
from experiments.lab.schedule import Outcome
from experiments.paper.grids import table_cells
from sim.errors import SimError
from sim.render.config import RENDERERS
from ssac.cli.exits import BUG
from ssac.errors import SsacError


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


def test_parts_are_done_in_the_order_in_which_they_were_named_and_all_without_a_name() -> None:
    parts = {"four": 1, "growth": 2}
    assert chosen_parts(None, parts) == chosen_parts([], parts) == ["four", "growth"]
    assert chosen_parts(["growth", "four"], parts) == ["growth", "four"]
    with pytest.raises(SsacError, match="unknown part 'five': use one of four, growth"):
        chosen_parts(["four", "five"], parts)


def test_what_cannot_be_simulated_is_the_inputs_fault_and_what_crashed_is_ours(
    tmp_path: Path,
) -> None:
    not_simulated, crashed = "recording: SimError: a.obj has no faces", "ssac: KeyError: 3"
    runs = pd.DataFrame({"status": ["ok", CRASHED], "reason": ["", not_simulated]})
    with pytest.raises(SsacError, match=r"1 runs have no recording, the first .*: a\.obj has no"):
        finish(Outcome(runs, 1, 0, 0.0), Cache(tmp_path))
    runs = pd.DataFrame({"status": [CRASHED, CRASHED], "reason": [crashed, not_simulated]})
    with pytest.raises(typer.Exit) as ended:
        finish(Outcome(runs, 1, 0, 0.0), Cache(tmp_path))
    assert ended.value.exit_code == BUG


@pytest.mark.parametrize(
    ("reasons", "whose"),
    [
        (["mine: PluginError: p 1.0"], "other packages' methods"),
        (["mine: PluginError: p 1.0", "ssac: KeyError: 3"], "this program"),
    ],
)
def test_whose_bug_it_is_is_said(tmp_path: Path, capsys, reasons, whose) -> None:
    runs = pd.DataFrame({"status": CRASHED, "reason": reasons})
    with pytest.raises(typer.Exit) as ended:
        finish(Outcome(runs, 1, 0, 0.0), Cache(tmp_path))
    assert ended.value.exit_code == BUG
    assert f"error: a bug in {whose}: {len(reasons)} runs crashed" in capsys.readouterr().err
