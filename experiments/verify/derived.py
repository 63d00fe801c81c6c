"""A folder of results in; whether all that follows from its runs is there as it follows, out."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from experiments.drawing.figures import drawings
from experiments.drawing.growth import growth_figure
from experiments.lab.cache import Cache
from experiments.lab.files import csv_text, png_bytes, read_table
from experiments.lab.finding import Finding, found, text_difference
from experiments.lab.grid import Cell
from experiments.lab.provenance import versions
from experiments.lab.scored import SCORED
from experiments.lab.study import Study, summary_text
from experiments.lab.task import CRASHED
from experiments.paper.comparison import PUBLISHED
from experiments.paper.esim import KEY, describe, ordered_runs, runs_from_csv
from experiments.paper.grids import TABLES, offset_ms, table_cells
from experiments.paper.quantities import POSE_ERRORS
from experiments.paper.results import (
    COMPARISON_FILE,
    PAGE_FILE,
    RUNS_FILE,
    SUMMARY_FILE,
    derived,
)
from experiments.physical.mini import COMPARISON_FILE as PHYSICAL_COMPARISON
from experiments.physical.mini import comparison_text
from experiments.studies.fidelity import DIFFERENCES, RENDERER_TOLERANCE_MS, RENDERERS_STUDY
from experiments.verify.files import read_provenance, read_text
from experiments.verify.manifest import (
    FIGURES_PROVENANCE,
    GROWTH_FIGURE,
    GROWTH_FILE,
    Manifest,
    provenance_name,
)
from ssac.errors import SsacError
from ssac.pipeline.registry import METHODS, OURS

_SEARCH_MS = 1000.0 + 20.0  # on each side of the truth, and a unit of the coarsest method
_ROUNDING_MS = 1e-2  # six digits of an estimate beyond 1000 ms: 5e-3; of its error, less
_DRAWN_BY = ("matplotlib", "pillow", "numpy")  # packages that a figure's bytes depend on


def table_findings(results: Path) -> list[Finding]:
    """Check the runs of the tables, and that tables, comparison and page follow from them."""

    @cache
    def text() -> str:
        return read_text(results / RUNS_FILE)

    @cache
    def runs() -> pd.DataFrame:
        return runs_from_csv(text())

    @cache
    def made() -> dict[str, str]:
        (made_with,) = read_provenance((results / RUNS_FILE).with_suffix(".provenance.json"))
        return derived(text(), made_with, results / PUBLISHED.name)

    def follows(name: str) -> tuple[str, ...]:
        return text_difference(read_text(results / name), made()[name])

    whole = found(f"{RUNS_FILE} has every run of the tables", lambda: _missing(runs()))
    findings = [
        whole,
        found(
            f"{RUNS_FILE} is in its order, and rounded",
            lambda: text_difference(text(), csv_text(ordered_runs(runs()))),
        ),
    ]
    names = (*(f"{table}.csv" for table in TABLES), COMPARISON_FILE, SUMMARY_FILE, PAGE_FILE)
    findings += [found(f"{n} follows from {RUNS_FILE}", partial(follows, n)) for n in names]
    return findings if whole.faults else findings + sanity_findings(runs())


def study_findings(results: Path, studies: Mapping[str, Study]) -> list[Finding]:
    """Check that each study has all its runs, and that its summary follows from them."""
    findings = []
    for study in studies.values():
        what = f"{study.summary_file} follows from all runs of {study.name}"
        findings.append(found(what, partial(_other_summary, results, study)))
        what = f"{study.runs_file} is rounded as it is written"
        findings.append(found(what, partial(_not_as_written, results / study.runs_file)))
        if study.measure is SCORED:
            what = f"{study.runs_file} has the rows of {RUNS_FILE} where the runs are the same"
            findings.append(found(what, partial(_unlike_the_tables, results, study)))
    return findings


def renderer_findings(results: Path, studies: Mapping[str, Study]) -> list[Finding]:
    """Check that the tables by either renderer agree within the tolerance."""
    if RENDERERS_STUDY.name not in studies:
        return []
    what = f"the renderers' mean difference of t_d is at most {RENDERER_TOLERANCE_MS:g} ms"
    return [found(what, partial(_unlike_by_renderer, results))]


def physical_findings(results: Path, manifest: Manifest) -> list[Finding]:
    """Check that the comparison of the physical tables follows from them, where it must be."""
    if PHYSICAL_COMPARISON not in manifest.files:
        return []
    path = results / PHYSICAL_COMPARISON
    what = f"{path.name} follows from the physical tables"
    return [found(what, lambda: text_difference(read_text(path), comparison_text(results)))]


def figure_findings(results: Path, studies: Mapping[str, Study]) -> list[Finding]:
    """Draw again what is drawn from CSVs alone; where the packages are others it is left out."""
    findings = []
    for name, drawing in drawings().items():
        if drawing.csv:
            draw = partial(drawing.draw, results, Cache())  # which it does not look at
            check = partial(_other_picture, results, f"{name}.png", FIGURES_PROVENANCE, draw)
            findings.append(found(f"{name}.png is drawn from {drawing.csv}", check))
    beside = provenance_name(GROWTH_FILE)
    check = partial(_other_picture, results, GROWTH_FIGURE, beside, partial(_grown, results))
    findings.append(found(f"{GROWTH_FIGURE} is drawn from {GROWTH_FILE}", check))
    for study in studies.values():
        if study.draw is not None:
            name, beside = study.figure_file, provenance_name(study.summary_file)
            draw = partial(_drawn, results, study)
            check = partial(_other_picture, results, name, beside, draw)
            findings.append(found(f"{name} is drawn from its CSVs", check))
    return findings


def sanity_findings(runs: pd.DataFrame) -> list[Finding]:
    """Check what must hold of any runs, whatever the methods find."""
    ok = runs[runs["status"] == "ok"]
    error_ms = ok["t_d_error_ms"]
    off = (ok["t_d_estimate_ms"] - ok["t_d_ms"]).abs() - error_ms
    impossible = (error_ms < 0.0) | (error_ms > _SEARCH_MS)
    for name in POSE_ERRORS:
        impossible |= (ok[name] < 0.0) | (ok[name] > 180.0)
    failed = runs[runs["status"] != "ok"]
    poses = ok[list(POSE_ERRORS)].notna().groupby(ok["method"]).mean()
    sometimes = ((poses > 0.0) & (poses < 1.0)).any(axis=1)
    counts = runs[runs["status"] != CRASHED].groupby(["duration_s", "angle_deg", "flight"])
    several = (counts[["seed", "n_events_cam1", "n_events_cam2"]].nunique() > 1).any(axis=1)
    return [
        Finding("no run crashed", _described(runs[runs["status"] == CRASHED])),
        Finding("every failed run has a reason", _described(failed[failed["reason"] == ""])),
        Finding("errors are those of the estimates", _described(ok[~(off.abs() <= _ROUNDING_MS)])),
        Finding("errors are possible ones", _described(ok[impossible])),
        Finding("a method gives a pose always or never", tuple(poses.index[sometimes])),
        Finding(
            "all methods and offsets saw the same recording",
            tuple(
                f"{duration_s:g} s, {angle_deg:g} deg, flight {flight:g}: other numbers of events"
                for duration_s, angle_deg, flight in several.index[several]
            ),
        ),
    ]


def table_key(cell: Cell) -> tuple[float, float, float, int, str]:
    """Say which run of the tables a cell is: KEY."""
    sim = cell.sim
    return sim.spline.duration_s, sim.angle_deg, offset_ms(cell), cell.flight, cell.method


def _missing(runs: pd.DataFrame, cells: Sequence[Cell] | None = None) -> tuple[str, ...]:
    """List runs of the grids that are not there just once, and runs that no grid has."""
    cells = table_cells() if cells is None else cells
    ours = {method.name for method in OURS}
    seeds = {table_key(cell): cell.seed for cell in cells}
    flights = {key[:-1]: seed for key, seed in seeds.items()}
    there = list(runs[KEY].itertuples(index=False, name=None))
    known = set(there)
    faults = [("is missing", key) for key in seeds if key[-1] in ours and key not in known]
    faults += [("is there twice", key) for key, count in Counter(there).items() if count > 1]
    faults += [
        ("is in no grid", key)
        for key in there
        if key[:-1] not in flights or key[-1] not in METHODS  # another package may add a method
    ]
    faults += [
        (f"has the seed {seed:.0f}, expected {flights[key[:-1]]}", key)
        for key, seed in zip(there, runs["seed"], strict=True)
        if key[:-1] in flights and seed != flights[key[:-1]]
    ]
    return tuple(
        f"{describe(dict(zip(KEY, key, strict=True)))} {what}" for what, key in sorted(faults)
    )


def _unlike_the_tables(results: Path, study: Study) -> tuple[str, ...]:
    """Compare runs of a study with the same runs in the tables, number by number."""
    tables = pd.read_csv(results / RUNS_FILE, dtype=str, keep_default_na=False)
    numbers = tables[KEY[:-1]].astype(float).itertuples(index=False, name=None)
    rows = dict(zip(zip(numbers, tables["method"], strict=True), tables.index, strict=True))
    places = {
        (cell.sim, cell.seed, cell.t_d_s, cell.estimator, cell.method): table_key(cell)
        for cell in table_cells()
    }
    runs = pd.read_csv(results / study.runs_file, dtype=str, keep_default_na=False)
    columns = [str(name) for name in tables if name in runs and name not in KEY]
    ours, theirs = (table[columns].to_numpy() for table in (runs, tables))
    faults = []
    for number, cell in enumerate(study.cells()):
        assert isinstance(cell, Cell)
        key = places.get((cell.sim, cell.seed, cell.t_d_s, cell.estimator, cell.method))
        if key is None:
            continue
        pairs = zip(columns, ours[number], theirs[rows[key[:-1], key[-1]]], strict=True)
        other = [f"{name} is {mine}, there {there}" for name, mine, there in pairs if mine != there]
        if other:
            faults.append(f"{describe(dict(zip(KEY, key, strict=True)))}: {other[0]}")
    return tuple(faults)


def _other_summary(results: Path, study: Study) -> tuple[str, ...]:
    made = summary_text(study, read_text(results / study.runs_file), results)
    return text_difference(read_text(results / study.summary_file), made)


def _unlike_by_renderer(results: Path) -> tuple[str, ...]:
    table = read_table(read_text(results / RENDERERS_STUDY.summary_file))
    return tuple(
        f"{row['duration_s']:g} s: {name} is {row[name]:g}"
        for row in table.to_dict("records")
        for name in DIFFERENCES
        if not row[name] <= RENDERER_TOLERANCE_MS
    )


def _not_as_written(path: Path) -> tuple[str, ...]:
    text = read_text(path)
    return text_difference(text, csv_text(read_table(text)))


def _drawn(results: Path, study: Study) -> Figure:
    if study.draw is None:
        raise SsacError(f"{study.name} has no figure")
    texts = (read_text(results / name) for name in (study.summary_file, study.runs_file))
    return study.draw(*(read_table(text) for text in texts))


def _grown(results: Path) -> Figure:
    return growth_figure(read_table(read_text(results / GROWTH_FILE)))


def _other_picture(
    results: Path, name: str, provenance: str, draw: Callable[[], Figure]
) -> tuple[str, ...]:
    made_with = [one.get("versions", {}) for one in read_provenance(results / provenance)]
    here = versions()
    if any(one.get(key) != here[key] for one in made_with for key in _DRAWN_BY):
        return ()  # drawn by another version: the checksum has to do
    same = (results / name).read_bytes() == png_bytes(draw())
    return () if same else ("it is another picture",)


def _described(runs: pd.DataFrame) -> tuple[str, ...]:
    return tuple(describe(row) for row in runs.to_dict("records"))
