"""`ssac figures`: the list of figures, and the same bytes each time that one is drawn."""

from pathlib import Path

import pytest

from experiments.lab.results import Results, csv_text, read_checksums
from experiments.lab.study import Made
from experiments.studies import figures
from ssac.errors import SsacError
from tests.experiments.command import run
from tests.experiments.reported import RESULTS, made_up_runs


def test_all_figures_are_drawn_when_none_is_named() -> None:
    papers = ["fig3_preprocessing", "fig4_epipolar", "fig5_d_avg", "alignment"]
    all_of_them = list(figures.drawings())
    assert all_of_them[:6] == [*papers, "error_vs_angle", "beyond_paper"]
    # It draws every picture of results/ but those of paths, which need the recordings.
    left = {path.stem for path in RESULTS.glob("*.png")} - {*all_of_them, "outdoor"}
    assert all(name.startswith("real_path") for name in left)


def test_the_readme_shows_an_animation_that_loads_at_once() -> None:
    path = RESULTS / "alignment.png"
    assert b"acTL" in path.read_bytes()[:1000]  # an animated PNG's chunk
    assert path.stat().st_size < 2e6


def test_a_figure_that_is_drawn_anew_leaves_the_provenance_of_all(tmp_path, monkeypatch) -> None:
    every = {name: Made(f"{name}.png", lambda _: b"", lambda: ()) for name in ("one", "two")}
    monkeypatch.setattr(figures, "_OF_RECORDINGS", tuple(every.values()))
    monkeypatch.setattr(figures, "drawings", lambda: every)
    written = set()
    for names in (None, ["one"]):
        figures.figures_command(names, tmp_path, tmp_path)
        written.add((tmp_path / "figures.provenance.json").read_text())
    assert len(written) == 1


def test_a_figure_is_drawn_from_the_table_beside_it_the_same_every_time(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text(csv_text(made_up_runs(("ssac", "tangency"), 2)))
    path = tmp_path / "beyond_paper.png"
    assert run("figures", path.stem, "--out", tmp_path) == f"written to {path}\n"
    assert path.read_bytes() == figures.drawings()[path.stem].bytes_of(Results(tmp_path))
    assert path.stat().st_size < 200_000
    # The table has a provenance; a figure has none, as it is no new run.
    assert set(read_checksums(tmp_path)) == {path.name}
    assert {one.name for one in tmp_path.iterdir()} == {path.name, "runs.csv", "SHA256SUMS"}
    (tmp_path / "runs.csv").write_text("a,b\n1,2\n")
    for out in (tmp_path, tmp_path / "none"):
        with pytest.raises(SsacError, match=r"error_vs_angle.png: .*runs.csv"):
            run("figures", "error_vs_angle", "--out", out)
