"""Tables, figures and studies in; every file that the results must have, and no other, out.

The list follows from the configurations and the code, never from what lies in the folder, so that
a file that is gone leaves a gap in it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from experiments.bench.growth import COMMITTED, bench_command_line, bench_config
from experiments.damage.reliability import COMMAND as DAMAGE_COMMAND
from experiments.damage.reliability import COMMITTED as DAMAGE
from experiments.damage.reliability import CSV_FILE as RELIABILITY_FILE
from experiments.drawing.figures import drawings, figures_config
from experiments.lab.provenance import plain
from experiments.lab.study import Study
from experiments.network.four import COMMAND as NETWORK_COMMAND
from experiments.network.long_flights import growth_config
from experiments.network.network_command import GROWTH_FILE as NETWORK_GROWTH_FILE
from experiments.outdoor.outdoor_command import COMMAND as OUTDOOR_COMMAND
from experiments.outdoor.outdoor_command import (
    FIGURE_FILE,
    ORACLE_FILE,
    outdoor_settings,
)
from experiments.outdoor.outdoor_command import RUNS_FILE as OUTDOOR_FILE
from experiments.paper.grids import TABLES
from experiments.paper.results import COMPARISON_FILE, PAGE_FILE, RUNS_FILE, SUMMARY_FILE
from experiments.paper.tables import tables_config
from experiments.physical.mini import COMMAND as PHYSICAL_COMMAND
from experiments.physical.mini import COMPARISON_FILE as PHYSICAL_COMPARISON
from experiments.physical.mini import mini_config
from experiments.real.data_sets import COMMAND, DATA_SETS, real_config
from experiments.real.drawing import OFFSETS_FIGURE
from experiments.real.pairs import PAIRS_FILE, STRAYS_FILE, TRIPLES_FILE
from experiments.real.paths import PATH_FIGURE, PATHS_FILE

PUBLISHED_SHA256 = {
    "published/esim_10.csv": "e4fc65f27fe6e67e162c81d89ccf66debf49f560e766675ead3288fc09b21cd7",
    "published/esim_20.csv": "e1f7cc80787b7a1d7baaae7ac3e6586780f6fdcef967e381a0861c41c390cdb7",
}
"""Digests of the paper's tables as they were copied."""

BENCH_FILE, GROWTH_FILE, GROWTH_FIGURE = "bench.csv", "bench_growth.csv", "bench_growth.png"
FIGURES_PROVENANCE = "figures.provenance.json"


@dataclass(frozen=True)
class Provenance:
    """What a file of provenance must say."""

    name: str
    command: str  # that wrote what it stands beside
    config: Any  # as JSON holds it
    is_drawn: bool = True  # by OpenGL, at least in part


@dataclass(frozen=True)
class Manifest:
    """What a folder of results must hold."""

    files: tuple[str, ...]  # all of them, without the checksums' own
    provenances: tuple[Provenance, ...]  # of them


def campaigns() -> tuple[Manifest, ...]:
    """List what other commands leave, one by one: of outdoors, damage, the bench and networks."""
    return _outdoor(), _reliability(), _physical(), _network_growth()


def manifest_of(studies: Mapping[str, Study], others: Iterable[Manifest] = ()) -> Manifest:
    """List what tables, figures, the benchmark, real data, these studies and others leave."""
    tables = (RUNS_FILE, COMPARISON_FILE, SUMMARY_FILE, *(f"{name}.csv" for name in TABLES))
    made = [_beside(name, "ssac tables", tables_config()) for name in tables]
    figures = drawings()
    made.append(Provenance(FIGURES_PROVENANCE, "ssac figures", plain(figures_config(figures))))
    measured = (BENCH_FILE, GROWTH_FILE)
    line = bench_command_line(COMMITTED)
    made += [_beside(name, line, bench_config(COMMITTED)) for name in measured]
    files = [
        *PUBLISHED_SHA256,
        *tables,
        PAGE_FILE,
        *measured,
        GROWTH_FIGURE,
        *(f"{name}.png" for name in figures),
    ]
    for study in studies.values():
        names = (study.runs_file, study.summary_file)
        config = {"study": study.name, **study.config}
        made += [_beside(name, study.command_line, config) for name in names]
        files += [*names, *([study.figure_file] if study.draw else [])]
    files += [one.name for one in made]
    for more in (of_real_data(), *others):
        files += more.files
        made += more.provenances
    return Manifest(tuple(files), tuple(made))


def of_real_data() -> Manifest:
    """List what public data leave that are not ours to ship: who has them may make it again."""
    tables = PAIRS_FILE, TRIPLES_FILE, STRAYS_FILE, PATHS_FILE
    figures = [OFFSETS_FIGURE, *(PATH_FIGURE.format(number) for number in DATA_SETS)]
    config = plain(real_config())
    made = tuple(Provenance(provenance_name(name), COMMAND, config, False) for name in tables)
    return Manifest((*tables, *figures, *(one.name for one in made)), made)


def _outdoor() -> Manifest:
    """List what the outdoor twin leaves."""
    tables = OUTDOOR_FILE, ORACLE_FILE
    config = plain(outdoor_settings())
    made = tuple(
        Provenance(provenance_name(name), OUTDOOR_COMMAND, config, False) for name in tables
    )
    return Manifest((*tables, FIGURE_FILE, *(one.name for one in made)), made)


def _reliability() -> Manifest:
    """List what damaged inputs and disturbed sweeps leave, which a change of anything may move."""
    beside = provenance_name(RELIABILITY_FILE)
    made = Provenance(beside, DAMAGE_COMMAND, plain(DAMAGE), False)
    return Manifest((RELIABILITY_FILE, beside), (made,))


def _physical() -> Manifest:
    """List how the physical twin's tables compare; its studies have files of their own."""
    made = _beside(PHYSICAL_COMPARISON, PHYSICAL_COMMAND, mini_config())
    return Manifest((PHYSICAL_COMPARISON, made.name), (made,))


def _network_growth() -> Manifest:
    """List what the growth with eight cameras leaves, all of which is time and memory."""
    beside = provenance_name(NETWORK_GROWTH_FILE)
    made = Provenance(beside, NETWORK_COMMAND, plain(growth_config()), False)
    return Manifest((NETWORK_GROWTH_FILE, beside), (made,))


def _beside(name: str, command: str, config: Any) -> Provenance:
    return Provenance(provenance_name(name), command, plain(config))


def provenance_name(name: str) -> str:
    """Name of the provenance beside a CSV."""
    return name.removesuffix(".csv") + ".provenance.json"
