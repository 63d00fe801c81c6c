"""Figures of one recording: the paper's Fig. 3, 4 and 5, and the alignment of two cameras."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from experiments.drawing.style import WIDTH_IN, method_looks, quiet_axes
from ssac.arrays import Array
from ssac.camera import Camera, known_pose
from ssac.config import N_MIN, Config
from ssac.errors import SsacError
from ssac.events import US_PER_S, slice_time
from ssac.geometry.epipolar import epipolar_distance, epipolar_lines_1, fundamental_from_pose
from ssac.geometry.fundamental import lmeds_fundamental
from ssac.pipeline.answer import Answer
from ssac.pipeline.chain import Chain
from ssac.pipeline.plots import (
    BLUE,
    POLARITIES,
    YELLOW,
    ZOOM_S,
    d_avg_px,
    draw_epipolar,
    events_around,
    plane_angles,
    telling_stretch,
)
from ssac.search.offset_search import mean_epipolar_distance
from ssac.search.two_views import TwoViews

STRETCH_S = (0.2, 2.2)
"""Part of the noisy flight, chosen by eye: a moment with too few events, then two sweeps."""

SEARCH_S = 1.0  # half the width of Fig. 5 (a)

PICTURES = 12, 30, 20
"""Numbers of pictures of the animation before the offset moves, while it does, and after."""

PICTURE_MS = 80

CAMERAS, GAP = ("#5fa8ee", "#f0a63c"), "#ff5c93"
DARK: dict[str, Any] = {
    "figure.facecolor": "#0d1117",
    "axes.facecolor": "#0d1117",
    "axes.edgecolor": "#454c56",
    "axes.labelcolor": "#9aa3ae",
    "xtick.color": "#9aa3ae",
    "ytick.color": "#9aa3ae",
    "text.color": "#e6e8eb",
    "font.size": 13.0,
    "image.interpolation": "nearest",
}
"""Colours of the report's player on a dark ground, which suits a light page and a dark one."""

_PALETTE_SIZE = 48
_ANIMATION_DPI = 150  # 1.5 times that of a page; the file has less than 2 MB
_CLOUD = 1500  # events of each camera
_SHAPE = 0.75  # height of a view over its width
_MARGIN_PX = 30.0  # between the object's path and the edge of a view
_TRACK_STEP_S = 0.004
_MAX_EVENTS = 15000  # drawn of the raw stretch: more would only blot the picture
_SEARCH_STEP_S, _ZOOM_STEP_S = 5e-3, 50e-6


def load_recording(folder: Path, t_d_s: float = 0.0) -> Chain:
    """Read a simulated recording, with an offset added to camera 2's clock."""
    files = folder / "cam1.h5", folder / "cam2.h5"
    return Chain(files, folder / "rig_extrinsics.yaml").delayed(t_d_s)


def preprocessing_figure(chain: Chain) -> Figure:
    """Draw Fig. 3: STRETCH_S of camera 1's events, raw and denoised, and the positions p(t).

    The same share of the raw and of the denoised events is drawn.
    """
    motion = chain.views().motion1
    edges_us = [round(edge_s * US_PER_S) for edge_s in STRETCH_S]
    raw, kept = (slice_time(one.events, *edges_us) for one in (chain.recorded(0), chain.clean(0)))
    one_in = max(1, len(raw) // _MAX_EVENTS)
    times_s: Array = np.arange(*STRETCH_S, _TRACK_STEP_S, dtype=np.float64)
    track = motion.at(times_s)
    p = np.where(track.valid[:, None], track.positions_px, np.nan)

    figure = Figure(figsize=(WIDTH_IN, 3.15))
    n_raw, n_kept = (f"{len(events):,}".replace(",", " ") for events in (raw, kept))
    titles = (
        f"(a) Raw events\n{n_raw}, one in {one_in} drawn",
        f"(b) After denoising\n{n_kept}, one in {one_in} drawn",
        "(c) Position p(t) of the object\n"
        f"none where {2e3 * Config.half_window_s:g} ms hold fewer than {N_MIN} events",
    )
    for number, title in enumerate(titles, start=1):
        box = (0.325 * (number - 1) - 0.02, 0.04, 0.31, 0.86)
        axes: Any = figure.add_axes(box, projection="3d")
        _x_y_t_axes(axes, chain.rig.cameras[0])
        axes.set_title(title, fontsize=9, y=1.02)
        if number < 3:
            events = (raw, kept)[number - 1][::one_in]
            colors = np.where(events["p"] > 0, YELLOW, BLUE)
            points = events["t"] / US_PER_S, events["x"], events["y"]
            axes.scatter(*points, s=1.0, c=colors, linewidths=0.0, clip_on=False)
        else:
            axes.plot(times_s, *p.T, color="black", lw=1.8, clip_on=False)
    figure.legend(handles=POLARITIES, loc="lower center", ncols=2, fontsize=9, frameon=False)
    return figure


def epipolar_figure(chain: Chain) -> Figure:
    """Draw Fig. 4 with the offset and the F that `ssac` finds."""
    figure = Figure(figsize=(WIDTH_IN, 7.2), layout="constrained")
    draw_epipolar(figure, _estimated(chain, "ssac"))
    return figure


def alignment_animation(chain: Chain) -> bytes:
    """Draw the alignment of both cameras' views under `tangency`'s estimate, as an animated PNG.

    Time runs through an informative part. Camera 2 is shown an offset later, which is zero at
    first, then moves to the estimate, and stays there. Without animation the last picture shows.
    """
    answer = _estimated(chain, "tangency")
    n_before, n_moving, n_after = PICTURES
    eased = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, n_moving))
    shares = np.concatenate([np.zeros(n_before), eased, np.ones(n_after)])
    with rc_context(DARK):
        scene = _Scene(answer)
        pictures = [
            scene.picture(float(time_s), float(share) * answer.estimate.t_d_s)
            for time_s, share in zip(np.linspace(*scene.span_s, len(shares)), shares, strict=True)
        ]
    palette = pictures[0].quantize(_PALETTE_SIZE, Image.Quantize.MAXCOVERAGE)
    shown = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures]
    whole = io.BytesIO()
    shown[-1].save(
        whole, "PNG", save_all=True, append_images=shown, default_image=True,
        duration=PICTURE_MS, loop=0, optimize=True,
    )  # fmt: skip
    return whole.getvalue()


class _Scene:
    """The figure of the animation: two views over two charts, a few parts of which move."""

    def __init__(self, answer: Answer) -> None:
        start_s, length_s = telling_stretch(answer)
        t_d_s = answer.estimate.t_d_s
        self.span_s = start_s, start_s + length_s
        self._answer, self._half_s = answer, answer.config.half_window_s
        self._F = np.asarray(answer.estimate.F)
        self._figure = Figure(figsize=(WIDTH_IN, 6.4), dpi=_ANIMATION_DPI)
        self._figure.set_layout_engine("constrained", h_pad=0.08, w_pad=0.08)
        self._canvas: Any = FigureCanvasAgg(self._figure)
        views, (clouds, curve) = self._figure.subplots(2, 2, height_ratios=(1.6, 1.0))
        self._title = self._figure.suptitle("", weight="bold")

        ends_s = [(start_s, start_s + length_s + shift_s) for shift_s in (0.0, t_d_s)]
        middles_px, reach_px = self._area(ends_s)
        self._views, self._clouds = [], []
        for k, (axes, size) in enumerate(zip(views, (4.5, 2.0), strict=True)):
            self._views.append(self._view(axes, k, middles_px[k], reach_px))
            half_s = 0.5 * (ends_s[k][1] - start_s)
            events, points = events_around(answer, k, start_s + half_s, half_s, most=_CLOUD)
            cloud = events["t"] / US_PER_S, plane_angles(answer, k, points)
            (dots,) = clouds.plot(*cloud, ".", ms=size, mew=0.0, color=CAMERAS[k])
            self._clouds.append((dots, cloud[0]))
        grey = DARK["xtick.color"]
        self._now = clouds.axvline(start_s, color=grey, lw=1.0)
        clouds.set(xlim=self.span_s, xlabel="time [s]", ylabel="[deg]")
        clouds.set_title("Epipolar plane of each event")

        offsets_s = t_d_s * np.linspace(-0.4, 2.0, 481, dtype=np.float64)
        curve.plot(1e3 * offsets_s, d_avg_px(answer, offsets_s), color=grey, lw=2.0)
        (self._at,) = curve.plot([], [], "o", ms=12, color=GAP, zorder=4)
        curve.set(xlabel="offset $t_d$ [ms]", ylabel="[px]", ylim=(0.0, None))
        curve.set_title("Mean distance from the lines", color=GAP)

    def _area(self, ends_s: list[tuple[float, float]]) -> tuple[list[Array], float]:
        """Give the middle of each view's area [px], and the half width of both."""
        middles, reaches = [], []
        for motion, ends in zip(self._answer.paired.motions, ends_s, strict=True):
            times_s: Array = np.linspace(*ends, 200, dtype=np.float64)
            track = motion.at(times_s)
            points = track.positions_px[track.valid]
            middles.append(0.5 * (points.min(axis=0) + points.max(axis=0)))
            reaches.append(0.5 * np.ptp(points, axis=0) * (1.0, 1.0 / _SHAPE))
        return middles, float(np.max(reaches)) + _MARGIN_PX

    def _view(self, axes: Any, camera: int, middle_px: Array, reach_px: float) -> tuple[Any, ...]:
        """Prepare a camera's view: its events, the other's epipolar line, and the distance."""
        image = axes.imshow([[np.nan]], cmap=ListedColormap([CAMERAS[camera]]), zorder=3)
        (line,) = axes.plot([], [], color=CAMERAS[1 - camera], lw=2.2)
        (gap,) = axes.plot([], [], color=GAP, lw=4.0, solid_capstyle="butt", zorder=4)
        (x, y), reach_y_px = middle_px, _SHAPE * reach_px
        axes.set(xlim=(x - reach_px, x + reach_px), ylim=(y + reach_y_px, y - reach_y_px))
        axes.set(xticks=[], yticks=[])
        axes.set_title(f"Camera {camera + 1}", color=CAMERAS[camera], weight="bold")
        return image, line, gap

    def picture(self, time_s: float, offset_s: float) -> Image.Image:
        """Draw the picture at a time of camera 1's clock; camera 2 is shown an offset later."""
        answer, at_s = self._answer, (time_s, time_s + offset_s)
        p1, p2 = (answer.paired.motions[k].at(np.array([at_s[k]])).positions_px[0] for k in (0, 1))
        lines = epipolar_lines_1(self._F, p2), epipolar_lines_1(self._F.T, p1)
        for k, ((image, line, gap), p, abc) in enumerate(
            zip(self._views, (p1, p2), lines, strict=True)
        ):
            shape = answer.cameras[k]
            events, _ = events_around(answer, k, at_s[k], self._half_s)
            pixels = np.full((shape.height, shape.width), np.nan)
            pixels[events["y"], events["x"]] = 1.0
            image.set(data=pixels, extent=(-0.5, shape.width - 0.5, shape.height - 0.5, -0.5))
            a, b, c = abc / np.hypot(*abc[:2])
            foot = p - (a * p[0] + b * p[1] + c) * np.array([a, b])
            line.set_data(*(foot + 1e3 * np.outer([-1.0, 1.0], [-b, a])).T)
            gap.set_data(*np.stack([p, foot]).T)
        for (dots, times_s), shift_s in zip(self._clouds, (0.0, offset_s), strict=True):
            dots.set_xdata(times_s - shift_s)
        self._now.set_xdata([time_s, time_s])
        d_px = float(d_avg_px(answer, np.array([offset_s]))[0])
        self._at.set_data([1e3 * offset_s], [d_px])
        how = "found" if offset_s == answer.estimate.t_d_s else "tried"
        self._title.set_text(f"Offset {how}: {1e3 * offset_s:.0f} ms, {d_px:.1f} px from the lines")
        self._canvas.draw()
        return Image.fromarray(np.asarray(self._canvas.buffer_rgba())).convert("RGB")


def _estimated(chain: Chain, method: str) -> Answer:
    """Return the answer of a method; SsacError if its status is not "ok"."""
    answer = chain.answer(method)
    estimate = answer.estimate
    if estimate.status != "ok":
        raise SsacError(f"no epipolar lines: {estimate.status}: {estimate.reason}: take another")
    return answer


def d_avg_figure(chain: Chain) -> Figure:
    """Draw Fig. 5: d_avg over the offset, for known and unknown pose, of a pair of equal clocks."""
    views, rig = chain.views(), chain.rig.pair(0, 1)
    F = fundamental_from_pose(rig.cam1.K, rig.cam2.K, *known_pose(rig))
    figure = Figure(figsize=(WIDTH_IN, 3.3), layout="constrained")
    whole, zoom = figure.subplots(1, 2)
    for axes, reach_s, step_s, per_s, unit, title in (
        (whole, SEARCH_S, _SEARCH_STEP_S, 1.0, "s", "(a) From -1 s to 1 s"),
        (zoom, ZOOM_S, _ZOOM_STEP_S, 1e3, "ms", "(b) From -3 ms to 3 ms"),
    ):
        n_steps = round(reach_s / step_s)
        offsets_s = step_s * np.arange(-n_steps, n_steps + 1, dtype=np.float64)
        curves, looks = d_avg_curves(views, F, offsets_s), method_looks(["ssac-known", "ssac"])
        for (label, d_px), look in zip(curves.items(), looks.values(), strict=True):
            dashes = "--" if look.is_known else "-"
            axes.plot(per_s * offsets_s, d_px, color=look.color, ls=dashes, lw=1.4, label=label)
            best = np.nanargmin(d_px)
            place = float(per_s * offsets_s[best]), float(d_px[best])
            axes.plot(*place, mec="black", ms=5, zorder=4, **look.style)
        axes.axvline(0.0, color="black", lw=0.9, ls=":", label="true offset", zorder=1)
        axes.set_xlim(-per_s * reach_s, per_s * reach_s)
        quiet_axes(axes)
        axes.set(xlabel=f"offset $t_d$ [{unit}]", ylabel="$d_{avg}$ [px]")
        axes.set_title(title, fontsize=10)
    whole.set_ylim(bottom=0.0)
    whole.locator_params("x", nbins=5)
    least = Line2D([], [], color="white", marker="o", mec="black", ms=5, label="least $d_{avg}$")
    handles, _ = whole.get_legend_handles_labels()
    figure.legend(handles=[*handles, least], loc="outside lower center", ncols=4, fontsize=9,
                  frameon=False)  # fmt: skip
    return figure


def d_avg_curves(views: TwoViews, F: Array, offsets_s: Array) -> dict[str, Array]:
    """Compute d_avg [px] with the given F (Algorithm 1), and with F fitted at each offset (2)."""
    config, pairs = views.config, views.pairs(offsets_s)
    min_pairs = config.rules.search.min_pairs
    fitted = np.full(len(offsets_s), np.nan)
    for m in range(len(offsets_s)):
        p1, p2 = pairs.valid_positions(m)
        if len(p1) >= min_pairs:
            F_m = lmeds_fundamental(p1, p2, config.trials, config.seed)
            fitted[m] = np.mean(epipolar_distance(F_m, p1, p2))
    known = mean_epipolar_distance(F, pairs, min_pairs)
    return {"pose known (Algorithm 1)": known, "pose unknown (Algorithm 2)": fitted}


def _x_y_t_axes(axes: Any, camera: Camera) -> None:
    """Show the whole image over time; y points down, as in the image."""
    axes.set(xlim=STRETCH_S, ylim=(0, camera.width), zlim=(camera.height, 0))
    axes.set_box_aspect((1.6, 1.1, 0.9), zoom=0.92)
    axes.view_init(elev=24, azim=-62)
    axes.set_proj_type("ortho")
    axes.patch.set_visible(False)
    axes.locator_params(nbins=4)
    axes.tick_params(labelsize=7, pad=-2)
    axes.set_xlabel("t [s]", fontsize=8, labelpad=-6)
    axes.set_ylabel("x [px]", fontsize=8, labelpad=-6)
    axes.set_zlabel("y [px]", fontsize=8, labelpad=-6)
