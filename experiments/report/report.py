"""The report shows all results and one recording on an HTML page that needs no other file.

Its tables are those of `results/README.md`. The player shows a flight with camera 2's clock set
ahead by a known offset, estimated as for any recording; only the text beside it uses the truth.
"""

import base64
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from jinja2 import PackageLoader
from markupsafe import Markup, escape

from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.lab.command import CacheOption
from experiments.lab.grid import config_names, named_config
from experiments.lab.results import PROVENANCE, Results, save_text
from experiments.lab.score import Truth, scored
from experiments.lab.summary import answered, digits
from experiments.paper.comparison import VERDICTS
from experiments.paper.esim import ERRORS, esim_tables
from experiments.paper.page import page_content
from experiments.studies.figures import FLIGHT, SEED
from experiments.studies.tables import comparison, runs_of
from ssac.cli.options import named
from ssac.errors import SsacError
from ssac.pipeline import html_report
from ssac.pipeline.chain import Chain
from ssac.pipeline.plots import d_avg_px

METHOD = "tangency"
T_D_S = 0.5  # of the player's flight: large enough to be seen between the views

_FIGURES = {
    "error_vs_angle": "make figures",
    "beyond_paper": "make figures",
    "success": "make figures",
    "efficiency": "make studies",
    "fig3_preprocessing": "make figures",
    "fig4_epipolar": "make figures",
    "fig5_d_avg": "make figures",
}
"""Figures, with the command that makes each; their captions stand in the page's template."""

_SOUND_SHARE = 0.9  # least share of runs with an estimate for the best method


def report_command(
    results: Annotated[Path, named("FOLDER", "Folder with the results.")] = Path("results"),
    cache: CacheOption = DEFAULT_FOLDER,
    out: Annotated[Path, named("FILE", "HTML to write.")] = Path("out/report.html"),
) -> None:
    """Put the results, the figures and an animation on one HTML page that needs no other file."""
    if out.is_dir():
        raise SsacError(f"{out}: is a folder: name a file, such as {out / 'report.html'}")
    content = read_results(results)
    page = report_page(content, make_animation(Cache(cache).recording_folder(FLIGHT, SEED)))
    save_text(out, page)
    typer.echo(f"report: {out} ({len(page.encode()) / 1e6:.1f} MB)")


def read_results(folder: Path) -> dict[str, Any]:
    """Return the page's content from a folder; SsacError names the command for a missing file."""
    results = Results(folder)
    with _made_by("make tables"):
        runs, compared = runs_of(results), comparison(results)
        made: dict[str, list[str]] = {}  # distinct provenances, each with the names of its results
        for name in sorted(
            {
                "esim_20",
                *(one.name.removesuffix(PROVENANCE) for one in folder.glob(f"*{PROVENANCE}")),
            }
        ):
            for entry in results.provenances(name):
                made.setdefault(json.dumps(entry), []).append(name)
    figures = [(name, "", 0, _png(folder, name, command)) for name, command in _FIGURES.items()]
    for name in config_names("ablation_"):
        config = named_config(name)
        figures.append((name, config.title, config.flights, _png(folder, name, "make ablations")))
    return {
        **page_content(runs, esim_tables(runs), compared),
        "headline": headline(runs, compared),
        "figures": figures,
        "provenance": [(", ".join(names), json.loads(entry)) for entry, names in made.items()],
    }


@contextmanager
def _made_by(command: str) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError, SsacError) as error:
        raise SsacError(f"{error}: run `{command}`") from error


def _png(folder: Path, name: str, command: str) -> bytes:
    path = folder / f"{name}.png"
    with _made_by(command):
        content = path.read_bytes()
        if not content.startswith(b"\x89PNG\r\n\x1a\n"):
            raise ValueError(f"{path}: not a PNG")
    return content


def headline(runs: pd.DataFrame, compared: pd.DataFrame) -> dict[str, Any]:
    """Summarise all runs; `best` is the reliable method with a pose and the least t_d error."""
    ok = answered(runs)
    means = ok.groupby("method")[list(ERRORS)].mean()
    # With a pose, and reliable: the mean of a few lucky runs says nothing.
    shares = ok["method"].value_counts() / runs["method"].value_counts()
    sound = means[shares.reindex(means.index) >= _SOUND_SHARE].dropna()
    best = "" if sound.empty else str(sound["t_d_error_ms"].idxmin())
    of_ssac = compared[compared["quantity"] == "ssac_t_d_error_ms"]
    return {
        "best": best,
        "best_errors": list(sound.loc[best]) if best else [],
        "ours": means.loc["ssac", "t_d_error_ms"],
        "published": of_ssac["published_mean"].mean(),
        "n_good": int(compared["verdict"].isin(["agrees", "better"]).sum()),
        "n_cells": len(compared),
        "n_methods": runs["method"].nunique(),
    }


def make_animation(folder: Path) -> dict[str, Any]:
    """Return the player's data, and the estimate that it shows, by the names in the template.

    The recording has t_d = 0, and its camera 2 is set T_D_S ahead. `before_px` and `after_px` are
    d_avg with the clocks as recorded and with the estimated offset.
    """
    recorded = folder / "cam1.h5", folder / "cam2.h5"
    answer = Chain(recorded, folder / "rig.yaml").delayed(T_D_S).answer(METHOD)
    estimate = answer.estimate
    answers = {(0, 1): answer}
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    before_px, after_px = d_avg_px(answer, np.array([0.0, estimate.t_d_s])).tolist()
    return {
        "estimate": estimate,
        "errors": scored(estimate, Truth(T_D_S, np.array(truth["R"]), np.array(truth["t"]))),
        "before_px": before_px,
        "after_px": after_px,
        "player": html_report.player_of(answers, html_report.seen_by(answers), tour=True),
    }


def report_page(content: dict[str, Any], animation: dict[str, Any]) -> str:
    """Render the page of `read_results` and an animation; the same input gives the same bytes."""
    environment = html_report.environment(PackageLoader("experiments.report", "page"))
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    environment.filters["size_px"] = lambda png: np.frombuffer(png[16:24], ">u4").tolist()
    environment.filters["digits"] = digits
    environment.filters["words"] = _words
    environment.globals["json"] = partial(json.dumps, indent=1)
    return environment.get_template("results_page.html").render(
        content | animation,
        angle_deg=FLIGHT.angle_deg,
        true_ms=1e3 * T_D_S,
        method=METHOD,
        verdicts=VERDICTS,
    )


def _words(text: str) -> Markup:
    """Convert the Markdown of a table's cell to HTML."""
    coded = re.sub(r"`(.*?)`", r"<code>\1</code>", str(escape(text)))
    return Markup(re.sub(r"\*\*(.*?)\*\*", r"<b>\1</b>", coded))
