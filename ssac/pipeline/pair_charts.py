"""Charts of the evidence for two cameras' answer: cost, residuals, samples and clock drift.

Matplotlib draws them as SVG, with colours that follow the reader's theme.
"""

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from urllib.parse import quote

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssac.arrays import Array
from ssac.camera import Camera
from ssac.fit.covariance import NORMAL_95
from ssac.geometry.epipolar import robust_deviation
from ssac.pipeline import plots
from ssac.pipeline.answer import Answer
from ssac.pipeline.streams import Seen, densities, grid_of
from ssac.track.motion import ObjectMotion

_INK, _FAINT = "#1d232b", "#c9ccd1"
_ON_PAGE = {  # colours that replace one on a light and a dark background
    plots.BLUE: ("#2464b0", "#5fa8ee"),
    plots.YELLOW: ("#b0620f", "#f0a63c"),
    plots.RED: ("#c2185b", "#ff5c93"),
    _INK: (_INK, "#e6e8eb"),
    _FAINT: (_FAINT, "#454c56"),
}
_STYLE = {
    "axes.edgecolor": _FAINT,
    "axes.grid": True,
    "font.size": 9.0,
    "grid.color": _FAINT,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "path.simplify": False,  # simplification removes dots
    "svg.fonttype": "none",
    "svg.hashsalt": "ssac",  # the same chart gives the same text
    **dict.fromkeys(("axes.labelcolor", "text.color", "xtick.color", "ytick.color"), _INK),
}


@dataclass(frozen=True)
class Chart:
    """A chart, with a title and a description."""

    title: str
    words: str  # the description
    svg: str  # percent-encoded, for a URL
    is_wide: bool


def charts_of(answer: Answer, most: int) -> dict[str, list[Chart]]:
    """Draw the charts that an answer allows, by heading, with at most `most` dots in each."""
    fit = plots.fit_of(answer)
    return {
        "What was searched": _cost_charts(answer, fit),
        "What the fit leaves": [] if fit is None else _residual_charts(fit, answer, most),
        "The clocks": _clock_charts(answer),
    }


@contextmanager
def _chart(
    charts: list[Chart], title: str, words: str, width_in: float = 4.0, height_in: float = 2.0
) -> Iterator[Axes]:
    """Yield axes of a size [in], and append what is drawn on them to `charts`."""
    left_in, below_in, around_in = 0.75, 0.7, 0.1
    whole_in = left_in + width_in + around_in, below_in + height_in + around_in
    box = left_in / whole_in[0], below_in / whole_in[1]
    with rc_context(_STYLE):
        figure = Figure(whole_in)
        axes = figure.add_axes((*box, width_in / whole_in[0], height_in / whole_in[1]))
        yield axes
        handles, names = axes.get_legend_handles_labels()
        if handles:
            figure.legend(handles, names, loc="lower left", ncols=4, fontsize="small")
        drawn = io.StringIO()
        unsaid = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(drawn, format="svg", transparent=True, metadata=unsaid)
    # Tenths of a point are enough.
    svg = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d)\d+", r"\1", path[0]), drawn.getvalue())
    themes = ["", ""]
    for k, (color, shown) in enumerate(_ON_PAGE.items()):
        svg = svg.replace(color.lower(), f"var(--c{k})")
        themes = [theme + f"--c{k}:{one};" for theme, one in zip(themes, shown, strict=True)]
    light, dark = (f":root{{{theme}}}" for theme in themes)
    style = f"{light}@media(prefers-color-scheme:dark){{{dark}}}"
    svg = svg.replace('<style type="text/css">', f'<style type="text/css">{style}', 1)
    charts.append(Chart(title, words, quote(svg, " /;=,+"), width_in > 4.0))


def _dots(axes: Axes, points: Array, color: str, size: float, name: str = "") -> None:
    """Draw points (n, 2) as strokes of no length, whose SVG is a tenth as long as markers'."""
    places = np.repeat(points, 3, axis=0)
    places[2::3] = np.nan
    axes.plot(*places.T, color=color, lw=size, solid_capstyle="round", label=name or "_")


def _cost_charts(answer: Answer, fit: plots.Fit | None) -> list[Chart]:
    """Draw the cost over the offsets that were searched, and near the one that was found."""
    charts, t_d_s, others_s = list[Chart](), plots.best_s(answer), answer.estimate.alternatives_s
    if plots.has_costs(answer):
        words = (
            "How well the views fit at each offset that was tried: one deep, narrow minimum (of a"
            " correlation: one high peak) means one answer."
        )
        if np.isfinite(t_d_s):
            words += f" The best lies at {t_d_s:.4f} s."
        if len(others_s):
            words += f" Others fit nearly as well: {', '.join(f'{s:.3f}' for s in others_s)} s."
        with _chart(charts, "Cost over the search interval", words) as axes:
            plots.draw_costs(axes, answer)
    if plots.has_fit(answer):
        words = (
            f"The cost of the {'positions' if fit is None else fit.what} about the offset found, by"
            " the final geometry: how wide it is says how sharply the motion tells the offset."
        )
        with _chart(charts, "Near the minimum", words) as axes:
            plots.draw_minimum(axes, answer, fit)
    return charts


def _residual_charts(fit: plots.Fit, answer: Answer, most: int) -> list[Chart]:
    """Draw the residuals of the pairs over time, as a histogram, and over both images."""
    off_px, charts = fit.distances_px, list[Chart]()
    sigma_px = max(robust_deviation(off_px), 1e-12)
    thin = slice(None, None, 1 + len(off_px) // most)
    reach_px = max(6.0 * sigma_px, 1e-3)
    beyond = int(np.count_nonzero(np.abs(off_px) > reach_px))
    words = (
        f"How far the {fit.what} lie from their epipolar lines: with the right clock the cloud is"
        f" level and equally wide all along, here {sigma_px:.2f} px (1 sigma)."
    )
    if beyond:
        words += f" {beyond} of {len(off_px)} lie beyond the edges."
    of_body = answer.estimate.n_samples - len(off_px)
    if fit.is_of_tangents and of_body >= answer.config.rules.search.min_pairs:
        words += f" The answer's other pairs, about {of_body} of a body's point, are left out."
    with _chart(charts, "Residuals over time", words) as axes:
        since_s = fit.pairs.times_s - answer.paired.motions[0].span_s[0]
        _dots(axes, np.column_stack([since_s, off_px])[thin], plots.BLUE, 3.0)
        axes.set(xlabel="time since the start of camera 1 [s]", ylabel="distance [px]")
        axes.set_ylim(-reach_px, reach_px)
    words = (
        "Beside a normal distribution of the same robust width. Long tails are outliers, which"
        " count little in the fit; a second hill, or a middle beside 0, would be a wrong model."
    )
    with _chart(charts, "Residuals as a histogram", words) as axes:
        edges = np.linspace(-reach_px, reach_px, 41, dtype=np.float64)
        axes.hist(off_px, edges.tolist(), color=plots.BLUE, alpha=0.5, label="pairs")
        bell = np.exp(-0.5 * (edges / sigma_px) ** 2) / (np.sqrt(2.0 * np.pi) * sigma_px)
        share = len(off_px) * (edges[1] - edges[0])
        axes.plot(edges, share * bell, color=plots.RED, label="normal distribution")
        axes.set(xlabel="distance [px]", ylabel="pairs", xlim=(-reach_px, reach_px))
    classes = (
        (plots.BLUE, 3.0, 0.0, 1.0, "below 1 sigma"),
        (plots.YELLOW, 3.0, 1.0, 3.0, "1 to 3"),
        (plots.RED, 5.0, 3.0, np.inf, "above 3"),
    )
    shares = np.abs(off_px[thin]) / sigma_px
    words = "Large ones in one part of the image alone speak of a wrong lens or intrinsics."
    for k, points_px in enumerate((fit.pairs.p1_px, fit.pairs.p2_px)):
        camera = answer.cameras[k]
        with _image_chart(charts, f"Residuals in camera {k + 1}'s image", words, camera) as axes:
            for color, size, low, high, name in classes:
                shown = (shares >= low) & (shares < high)
                _dots(axes, points_px[thin][shown], color, size, name)
    return charts


def sample_charts(cameras: Sequence[Seen], most: int) -> list[Chart]:
    """Draw when and where cameras saw the object well, and where not."""
    start_s, charts, strips = cameras[0].span_s[0], list[Chart](), list[tuple[Array, int, str]]()
    is_common = all(seen.later_s is not None for seen in cameras)
    for k, seen in enumerate(cameras):
        times_s = np.linspace(*seen.span_s, most, dtype=np.float64)
        track, motion = seen.motion.at(times_s), seen.motion
        few, name, more = ~track.valid, "gap", "in gaps of the track"
        edge = np.zeros_like(few)
        if isinstance(motion, ObjectMotion):
            few, name = few & (track.counts < motion.n_min), "too few events"
            edge = ~track.valid & ~few
            more = (
                f"with fewer than {motion.n_min} events within {1e3 * motion.half_window_s:g} ms"
                f" and {np.count_nonzero(edge)} that touch the border or a gap"
            )
        words = (
            f"Of {most} even times {np.count_nonzero(track.valid)} are valid; rejected are"
            f" {np.count_nonzero(few)} {more}."
            f" Grey: all {'events' if seen.shown.track is None else 'points'}."
        )
        title, camera = f"Samples in camera {k + 1}'s image", seen.clean.camera
        with _image_chart(charts, title, words, camera) as axes:
            extent = *axes.get_xlim(), *axes.get_ylim()
            axes.imshow(densities(seen), extent=extent, interpolation="none")
            for which, color, label in (
                (track.valid, plots.BLUE, "valid"),
                (few, plots.RED, name),
                (edge, plots.YELLOW, "at the border, or a gap"),
            ):
                if which.any():
                    _dots(axes, track.positions_px[which], color, 3.0, label)
                since_s = times_s - start_s - (seen.later_s or 0.0)
                strips.append((np.where(which, since_s, np.nan), k, color))
    have_events = {isinstance(seen.motion, ObjectMotion) for seen in cameras}
    rejected = ["red with too few events, orange at the border or a gap"] * (True in have_events)
    rejected += ["red in a track's gap"] * (False in have_events)
    words = (
        f"Blue where a sample is valid, {', '.join(rejected)};"
        f" {'on the clock of camera 1' if is_common else 'each on its own clock'}: only what two"
        " see at one time tells anything."
    )
    over_time = list[Chart]()
    height_in = 0.3 * len(cameras)
    with _chart(over_time, "When each camera sees the object", words, 9.0, height_in) as axes:
        for since_s, k, color in strips:
            axes.plot(since_s, np.full(len(since_s), k), color=color, lw=9.0)
        names = [f"camera {k + 1}" for k in range(len(cameras))]
        axes.set_yticks(range(len(cameras)), names)
        axes.set(xlabel="time since the start of camera 1 [s]", ylim=(len(cameras) - 0.5, -0.5))
    return over_time + charts


@contextmanager
def _image_chart(charts: list[Chart], title: str, words: str, camera: Camera) -> Iterator[Axes]:
    """Yield axes over a camera's undistorted field of view."""
    grid = grid_of(camera)
    with _chart(charts, title, words, height_in=4.0 * grid.rows / grid.columns) as axes:
        right_px = grid.left_px + grid.cell_px * grid.columns
        bottom_px = grid.top_px + grid.cell_px * grid.rows
        axes.set(xlabel="x [px]", ylabel="y [px]", aspect="equal", autoscale_on=False)
        axes.set(xlim=(grid.left_px, right_px), ylim=(bottom_px, grid.top_px))
        yield axes


def _clock_charts(answer: Answer) -> list[Chart]:
    """Draw the drift of camera 2's clock; nothing where both clocks were taken to run alike."""
    estimate, charts = answer.estimate, list[Chart]()
    if not (estimate.has_offset and np.isfinite(estimate.skew_ppm)):
        return []
    begin_s, end_s = answer.paired.common_s(estimate.t_d_s)
    if not begin_s < end_s:
        return []
    start_s = answer.paired.motions[0].span_s[0]
    knots_s = estimate.knots_s[(estimate.knots_s > begin_s) & (estimate.knots_s < end_s)]
    times_s = np.sort(np.concatenate([np.linspace(begin_s, end_s, 121, dtype=np.float64), knots_s]))
    more_ms = 1e3 * estimate.clock.added_s(times_s)
    off_ms = NORMAL_95 * 1e3 * np.nan_to_num(estimate.clock_std_s(times_s))
    model = "A straight line is a constant skew"
    if len(estimate.knots_s):
        model = f"A line of pieces with {len(estimate.knots_s)} knots: the clock wanders"
    words = (
        f"What it shows more than camera 1's, less the offset. {model};"
        f" on the whole {estimate.skew_ppm:+.1f} ppm."
    )
    with _chart(charts, "Drift of camera 2's clock", words) as axes:
        ends = times_s - start_s, more_ms - off_ms, more_ms + off_ms
        axes.fill_between(*ends, color=plots.RED, alpha=0.2, lw=0.0, label="95 % interval")
        axes.plot(times_s - start_s, more_ms, color=plots.RED, label="drift found")
        if len(knots_s):
            knots_ms = 1e3 * estimate.clock.added_s(knots_s)
            axes.plot(knots_s - start_s, knots_ms, "o", color=_INK, ms=4.0, label="knots")
        axes.set(xlabel="time since the start of camera 1 [s]", ylabel="drift [ms]")
    return charts
