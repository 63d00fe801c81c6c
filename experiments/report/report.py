"""The report: all results and one recording on an HTML page that needs no other file."""

import base64
import json
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import typer
from jinja2 import PackageLoader

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.files import save_text
from experiments.paper.comparison import PUBLISHED_RUNS, RULE
from experiments.report import tables
from experiments.report.animation import METHOD, T_D_S, Animation, make_animation
from experiments.report.data import Results, load_results
from experiments.studies.figures import FLIGHT, SEED
from ssac.errors import SsacError
from ssac.pipeline import html_report

_PAGE = files("experiments.report") / "page"


def report_command(
    results: Annotated[
        Path,
        typer.Option(
            help="Folder with the results, as `ssac tables` writes them.", metavar="FOLDER"
        ),
    ] = Path("results"),
    cache: Annotated[
        Path, typer.Option(help="Folder of cached recordings.", metavar="FOLDER")
    ] = DEFAULT_FOLDER,
    out: Annotated[Path, typer.Option(help="HTML to write.", metavar="FILE")] = Path(
        "out/report.html"
    ),
) -> None:
    """Put the results, the figures and an animation on one HTML page that needs no other file."""
    if out.is_dir():
        raise SsacError(f"{out}: is a folder: name a file, such as {out / 'report.html'}")
    content = load_results(results)
    page = report_page(content, make_animation(Cache(cache).recording_folder(FLIGHT, SEED)))
    save_text(out, page)
    typer.echo(f"report: {out} ({len(page.encode()) / 1e6:.1f} MB)")


def report_page(results: Results, animation: Animation) -> str:
    """Lay out the page: the same input gives the same bytes."""
    environment = html_report.environment(PackageLoader("experiments.report", "page"))
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    environment.filters["number"] = tables.number
    environment.globals["json"] = partial(json.dumps, indent=1)
    return environment.get_template("results_page.html").render(
        style=_PAGE.joinpath("report.css").read_text(encoding="utf-8").strip(),
        animation=animation,
        player=animation.player,
        angle_deg=FLIGHT.angle_deg,
        true_ms=1e3 * T_D_S,
        method=METHOD,
        results=results,
        headline=tables.headline(results),
        charts=tables.charts(results),
        compared=tables.compared_tables(results.comparison),
        verdicts=tables.VERDICTS,
        counts=results.comparison["verdict"].value_counts(),
        notes=tables.notes(results.comparison),
        rule=RULE[0].upper() + RULE[1:],
        published_runs=PUBLISHED_RUNS,
        tables=tables.method_tables(results),
        failures=tables.failures(results.runs),
        provenance=_provenance(results.provenance),
    )


def _provenance(provenance: dict[str, dict[str, Any]]) -> list[tuple[str, dict[str, Any]]]:
    """Give each way that results were made once, with their names."""
    groups: dict[str, list[str]] = {}
    for name, entry in provenance.items():
        groups.setdefault(json.dumps(entry), []).append(name)
    return [(", ".join(names), json.loads(entry)) for entry, names in groups.items()]
