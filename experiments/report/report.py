"""Results and one recording in, one HTML page that needs no other file out: `ssac report`."""

import base64
import json
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Annotated, Any

import numpy as np
import typer

from experiments.figures.figures import FLIGHT, SEED
from experiments.lab.cache import DEFAULT_FOLDER, Cache
from experiments.paper.quantities import ERRORS
from experiments.report.animation import METHOD, T_D_S, Animation, make_animation
from experiments.report.animation_page import curve_points, player_json, stills_html
from experiments.report.chart import chart_html
from experiments.report.data import ReportFigure, Results, load_results
from experiments.report.tables import comparison_html, failures_html, methods_html, number
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
    sections = (
        ("numbers", "", _headline_html(results)),
        ("methods", "Every method in every cell", _METHODS_LEAD + chart_html(results)),
        ("paper", "Beside the paper", comparison_html(results)),
        ("tables", "All numbers", _TABLES_LEAD + methods_html(results)),
        ("figures", "Figures", "".join(map(_figure_html, results.figures))),
        ("failures", "Runs without an estimate", failures_html(results)),
        ("provenance", "How these results were made", _provenance_html(results.provenance)),
    )
    body = "\n".join(
        f'<section id="{name}">{f"<h2>{title}</h2>" if title else ""}\n{content}\n</section>'
        for name, title, content in sections
    )
    offset_end_s = animation.offsets_s[-1]
    return Template(_PAGE.joinpath("report.html").read_text(encoding="utf-8")).substitute(
        style=_PAGE.joinpath("report.css").read_text(encoding="utf-8").strip(),
        script=_PAGE.joinpath("player.js").read_text(encoding="utf-8").strip(),
        player_json=player_json(animation),
        stills=stills_html(animation),
        player_note=_note(animation),
        curve_points=curve_points(animation),
        shape=f"{animation.width} / {animation.height}",
        found_ms=f"{1e3 * animation.t_d_s:.1f}",
        found_percent=f"{100.0 * animation.t_d_s / offset_end_s:.2f}",
        offset_end_ms=f"{1e3 * offset_end_s:.0f}",
        body=body,
    )


_METHODS_LEAD = """<p>A dot is the mean error at one angle, offset and duration, pale for
flights of 10 s, full for 20 s. In each row the angle between the cameras grows downwards, from
30&deg; to 150&deg;. A stroke is the paper&rsquo;s mean; the number on the right is the mean of the
dots. The scale is logarithmic: left is better.</p>"""

_TABLES_LEAD = """<p>Mean &plusmn; standard deviation over the flights of a cell; the bars are
logarithmic.</p>"""


def _note(animation: Animation) -> str:
    """Say what the player shows, and how well the offset was found."""
    errors = animation.errors
    distances = [animation.mean_distance_px(offset_s) for offset_s in (0.0, animation.t_d_s)]
    return (
        f"A simulated flight, the cameras {FLIGHT.angle_deg:g}&deg; apart, played slowly. Camera "
        f"2&rsquo;s clock was set {1e3 * T_D_S:g} ms ahead, so much that it can be seen. "
        f"<code>{METHOD}</code> was given nothing but the events and the intrinsics. "
        f"From {animation.n_samples} sample times it found {1e3 * animation.t_d_s:.2f} ms, which "
        f"is {errors.t_d_error_ms:.2f} ms off, and the cameras&rsquo; relative pose, "
        f"{errors.r_error_deg:.2f}&deg; off in rotation and {errors.t_error_deg:.2f}&deg; in the "
        f"direction of translation. "
        f"With the clocks as recorded the drone is {distances[0]:.0f} px from its epipolar line on "
        f"average over the flight, synchronised {distances[1]:.2f} px."
    )


def _headline_html(results: Results) -> str:
    """Sum up all runs in four numbers."""
    runs, comparison = results.runs, results.comparison
    ok = runs[runs["status"] == "ok"]
    means = ok.groupby("method")[list(ERRORS)].mean()
    cards = []
    # With a pose, and reliable: the mean of a few lucky runs says nothing.
    shares = ok["method"].value_counts() / runs["method"].value_counts()
    sound = means[shares.reindex(means.index) >= _SOUND_SHARE].dropna()
    if not sound.empty:
        best = str(sound["t_d_error_ms"].idxmin())
        error_ms, r_deg, t_deg = map(float, np.asarray(sound.loc[best]))
        cards.append((
            f"{number(error_ms)} ms", f"mean offset error of <code>{escape(best)}</code>, the best "
            f"method that is not given the pose; rotation {number(r_deg)}&deg;, translation "
            f"{number(t_deg)}&deg;",
        ))  # fmt: skip
    of_ssac = comparison[comparison["quantity"] == "ssac_t_d_error_ms"]
    if "ssac" in means.index and not of_ssac.empty:
        cards.append((
            f"{number(means['t_d_error_ms'].to_dict()['ssac'])} ms",
            "mean offset error of <code>ssac</code>, the paper&rsquo;s method; the paper has "
            f"{number(float(of_ssac['published_mean'].mean()))} ms",
        ))  # fmt: skip
    good = int(np.count_nonzero(comparison["verdict"].isin(["agrees", "better"])))
    cards.append((
        f"{good} of {len(comparison)}",
        "published numbers that ours agree with or are better than",
    ))  # fmt: skip
    cards.append((
        f"{len(runs):,}".replace(",", "&thinsp;"),
        f"runs of {len(results.methods)} methods, of which {len(runs) - len(ok)} gave no estimate",
    ))  # fmt: skip
    items = "".join(f"<li><b>{value}</b><span>{text}</span></li>" for value, text in cards)
    return f'<ul class="cards">{items}</ul>'


def _figure_html(figure: ReportFigure) -> str:
    width, height = figure.size_px
    data = base64.b64encode(figure.png).decode("ascii")
    title, caption = escape(figure.title), escape(figure.caption)
    return (
        f'<figure class="picture"><img src="data:image/png;base64,{data}" width="{width}" '
        f'height="{height}" alt="{title}">'
        f"<figcaption><b>{title}.</b> {caption}</figcaption></figure>"
    )


def _provenance_html(provenance: dict[str, dict[str, Any]]) -> str:
    """One collapsible entry for each way that results were made."""
    groups: dict[str, list[str]] = {}
    for name, entry in provenance.items():
        groups.setdefault(json.dumps(entry), []).append(name)
    parts = []
    for content, names in groups.items():
        entry, facts = json.loads(content), []
        for key, value in entry.items():
            if isinstance(value, (dict, list)):
                shown = f"<pre>{escape(json.dumps(value, indent=1))}</pre>"
            else:
                shown = f"<code>{escape(str(value))}</code>"
            facts.append(f"<dt>{escape(key.replace('_', ' '))}</dt><dd>{shown}</dd>")
        command = escape(str(entry.get("command", "")))
        parts.append(
            f"<details><summary><b>{escape(', '.join(names))}</b> <code>{command}</code></summary>"
            f"<dl>{''.join(facts)}</dl></details>"
        )
    return "".join(parts)
