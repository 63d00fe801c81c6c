"""The report: all results and one recording on an HTML page that needs no other file."""

import base64
import json
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from jinja2 import Environment, PackageLoader, StrictUndefined

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.paper.comparison import PUBLISHED_RUNS, RULE
from experiments.paper.quantities import ERRORS
from experiments.report.animation import METHOD, T_D_S, Animation, make_animation
from experiments.report.data import Results, load_results
from experiments.report.player import curve_points, player_json, stills
from experiments.report.tables import (
    VERDICTS,
    charts,
    compared_tables,
    failures,
    method_tables,
    notes,
    number,
)
from experiments.studies.figures import FLIGHT, SEED
from ssac.errors import SsacError
from ssac.files.whole_file import whole_file

_SOUND_SHARE = 0.9  # of a method's runs give an estimate, or it cannot be called the best
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
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as temporary:
        temporary.write_text(page, encoding="utf-8")
    typer.echo(f"report: {out} ({len(page.encode()) / 1e6:.1f} MB)")


def report_page(results: Results, animation: Animation) -> str:
    """Lay out the page: the same input gives the same bytes."""
    environment = Environment(
        loader=PackageLoader("experiments.report", "page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    environment.globals["json"] = partial(json.dumps, indent=1)
    # The style, the script and the player's data are put in as they are: all three are ours.
    return environment.get_template("report.html").render(
        style=_PAGE.joinpath("report.css").read_text(encoding="utf-8").strip(),
        script=_PAGE.joinpath("player.js").read_text(encoding="utf-8").strip(),
        player_json=player_json(animation),
        animation=animation,
        stills=stills(animation),
        curve_points=curve_points(animation),
        angle_deg=FLIGHT.angle_deg,
        true_ms=1e3 * T_D_S,
        method=METHOD,
        results=results,
        headline=headline(results),
        charts=charts(results),
        compared=compared_tables(results),
        verdicts=[(word, sign, _count(results, word)) for word, sign in VERDICTS.items()],
        signs=VERDICTS,
        notes=notes(results.comparison),
        rule=RULE[0].upper() + RULE[1:],
        published_runs=PUBLISHED_RUNS,
        tables=method_tables(results),
        failures=failures(results.runs),
        provenance=_provenance(results.provenance),
    )


class Headline(NamedTuple):
    """All runs in four numbers."""

    best: str  # method that is not given the pose; "" where none is good enough
    best_errors: list[str]  # offset, rotation, translation
    ours: str  # offset error of the paper's method, ours
    published: str
    n_good: int  # published numbers that ours agree with or are better than
    n_failed: int


def headline(results: Results) -> Headline:
    """Sum up all runs."""
    runs, comparison = results.runs, results.comparison
    ok = runs[runs["status"] == "ok"]
    means = ok.groupby("method")[list(ERRORS)].mean()
    # With a pose, and reliable: the mean of a few lucky runs says nothing.
    shares = ok["method"].value_counts() / runs["method"].value_counts()
    sound = means[shares.reindex(means.index) >= _SOUND_SHARE].dropna()
    best, errors = "", []
    if not sound.empty:
        best = str(sound["t_d_error_ms"].idxmin())
        errors = [number(error) for error in np.asarray(sound.loc[best])]
    of_ssac = comparison[comparison["quantity"] == "ssac_t_d_error_ms"]
    ours = published = ""
    if "ssac" in means.index and not of_ssac.empty:
        ours = number(means["t_d_error_ms"].to_dict()["ssac"])
        published = number(float(of_ssac["published_mean"].mean()))
    n_good = _count(results, "agrees") + _count(results, "better")
    return Headline(best, errors, ours, published, n_good, len(runs) - len(ok))


def _count(results: Results, verdict: str) -> int:
    return int(np.count_nonzero(results.comparison["verdict"] == verdict))


def _provenance(provenance: dict[str, dict[str, Any]]) -> list[tuple[str, dict[str, Any]]]:
    """Give each way that results were made once, with their names."""
    groups: dict[str, list[str]] = {}
    for name, entry in provenance.items():
        groups.setdefault(json.dumps(entry), []).append(name)
    return [(", ".join(names), json.loads(entry)) for entry, names in groups.items()]
