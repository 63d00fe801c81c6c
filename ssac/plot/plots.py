"""An estimate and the events that it was made from in, pictures of it out.

    search      d_avg over the search interval and near its minimum, as the paper's Fig. 5
    epipolar    p1, p2, the line l1 and the distance d, as the paper's Fig. 4, before and after
    alignment   what both cameras see over time, before and after the clocks are aligned

"Before" pairs equal readings of both clocks, "after" pairs readings that differ by t_d.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch

from ssac.files.whole_file import whole_file
from ssac.plot.plot_data import (
    Array,
    Material,
    clocks,
    d_avg_px,
    epipolar_rows,
    has_curve,
    has_fit,
    has_pose,
    plane_angles,
    points_in_time,
    search_curve,
    telling_stretch,
    undistorted,
    window,
)
from ssac.plot.style import BLUE, FILE_SUFFIXES, RED, YELLOW

Canvas = Figure | SubFigure

ZOOM_S = 0.003
"""Half the width of the zoom around the minimum, as in the paper's Fig. 5."""

_WIDTH_IN, _DPI = 9.0, 150
_ZOOM_STEP_S = 50e-6
_MAX_MARKERS = 300
_AXES_WIDTH_PT = 270.0  # of one of two axes side by side


def save_figures(target: Path, material: Material) -> list[Path]:
    """Draw what an estimate allows.

    Parameters
    ----------
    target
        A folder, made if need be, for one PNG per figure; or a file of FILE_SUFFIXES for all
        figures, one below the other.
    material
        Of any method and status; a figure that it lacks the data for is left out.

    Returns
    -------
    list[Path]
        The files written; none when there is nothing to draw.
    """
    if target.suffix.lower() in FILE_SUFFIXES:
        page = page_of(material)
        if page is None:
            return []
        _save(page, target)
        return [target]
    figures = [figure for figure in _FIGURES if figure.can_draw(material)]
    if figures:
        target.mkdir(parents=True, exist_ok=True)
    written = []
    for figure in figures:
        page = Figure(figsize=(_WIDTH_IN, figure.height_in(material)), layout="constrained")
        figure.draw(page, material)
        written.append(target / f"{figure.name}.png")
        _save(page, written[-1])
    return written


def page_of(material: Material) -> Figure | None:
    """Draw all figures that an estimate allows, one below the other; None where there are none."""
    figures = [figure for figure in _FIGURES if figure.can_draw(material)]
    if not figures:
        return None
    heights = [figure.height_in(material) for figure in figures]
    page = Figure(figsize=(_WIDTH_IN, sum(heights)), layout="constrained")
    parts = page.subfigures(len(figures), 1, height_ratios=heights, squeeze=False)[:, 0]
    for figure, part in zip(figures, parts, strict=True):
        figure.draw(part, material)
    return page


def draw_search(canvas: Canvas, material: Material) -> None:
    """Draw the cost over the search interval, and near its minimum where the method has an F."""
    estimate, t_d_s = material.estimate, material.estimate.t_d_s
    F = estimate.F if np.isfinite(t_d_s) else None
    whole, *rest = canvas.subplots(1, 1 if F is None else 2, squeeze=False)[0]
    offsets_s, costs = search_curve(material)
    if estimate.F is None and np.nanmin(costs) < 0.0:
        whole.plot(offsets_s, -costs, color=BLUE, lw=1)
        whole.set(ylabel="correlation", title="Correlation over the search interval")
    else:
        marker = "." if len(offsets_s) <= _MAX_MARKERS else ""
        whole.plot(offsets_s, costs, "-", marker=marker, color=BLUE, lw=1, ms=3)
        whole.set(ylabel="$d_{avg}$ [px]", title="$d_{avg}$ over the search interval")
        whole.set_ylim(bottom=0.0)
    whole.set_xlabel("offset $t_d$ [s]")
    if np.isfinite(t_d_s):
        _mark_offset(whole, t_d_s, f"$t_d$ = {1e3 * t_d_s:.2f} ms")
    for zoom in rest:
        steps = np.arange(-round(ZOOM_S / _ZOOM_STEP_S), round(ZOOM_S / _ZOOM_STEP_S) + 1)
        near_s: Array = t_d_s + _ZOOM_STEP_S * steps.astype(np.float64)
        zoom.plot(1e3 * near_s, d_avg_px(material, near_s), color=BLUE, lw=1)
        _mark_offset(zoom, 1e3 * t_d_s, f"$t_d$ = {1e3 * t_d_s:.3f} ms")
        zoom.ticklabel_format(useOffset=False)
        zoom.set(
            xlabel="offset $t_d$ [ms]",
            ylabel="$d_{avg}$ [px]",
            title="Near the offset found, with the final F",
        )


def draw_epipolar(canvas: Canvas, material: Material) -> None:
    """Draw both cameras' events around one instant, with p1, p2, l1 and d."""
    rows = epipolar_rows(material)
    reach_px = float(np.clip(2.0 * max(row.distance_px for row in rows), 40.0, 150.0))
    for (left, right), row in zip(canvas.subplots(len(rows), 2, squeeze=False), rows, strict=True):
        _draw_events(left, material, 0, row.time_s, reach_px)
        _draw_events(right, material, 1, row.time_s + row.offset_s, reach_px)
        foot = _foot(row.line_1, row.p1)
        along = np.array([-row.line_1[1], row.line_1[0]]) / np.hypot(*row.line_1[:2])
        left.axline(foot, foot + along, color="black", lw=1.2, label="line $l_1$ of $p_2$")
        left.plot(*np.stack([row.p1, foot]).T, color=RED, lw=3, label="distance $d$")
        left.plot(*row.p1, **_POINT, label="$p_1$, $p_2$")
        right.plot(*row.p2, **_POINT)
        left.set_title(f"Camera 1 at {row.time_s:.4f} s: $d$ = {row.distance_px:.2f} px")
        right.set_title(f"Camera 2 at {row.time_s + row.offset_s:.4f} s: {row.name}")
        for axes, centre in ((left, row.p1), (right, row.p2)):
            axes.set(xlabel="x [px]", ylabel="y [px]", aspect="equal")
            axes.set_xlim(centre[0] - reach_px, centre[0] + reach_px)
            axes.set_ylim(centre[1] + 0.75 * reach_px, centre[1] - 0.75 * reach_px)
    handles = [*left.get_legend_handles_labels()[0], *POLARITIES]
    canvas.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize="small")


def draw_alignment(canvas: Canvas, material: Material) -> None:
    """Draw both event clouds in x-y-t, and the angle of their epipolar planes over time.

    The plane through both cameras and a point has one angle about the baseline, the same for both
    views whatever the point: only what is seen at one instant has equal angles.
    """
    t_d_s = material.estimate.t_d_s
    start_s, length_s = telling_stretch(material)
    clouds = [
        points_in_time(material, camera, start_s + offset_s, length_s)
        for camera, offset_s in ((0, 0.0), (1, t_d_s))
    ]
    for column, (name, offset_s) in enumerate(clocks(t_d_s)):
        axes = canvas.add_subplot(2, 2, 1 + column, projection="3d")
        for camera, (times_s, points) in enumerate(clouds):
            shown_s = times_s - camera * offset_s
            label = f"camera {camera + 1}"
            color = _CAMERA_COLORS[camera]
            axes.scatter(shown_s, points[:, 0], points[:, 1], s=0.4, color=color, label=label)
        axes.set(xlabel="time [s]", ylabel="x [px]", zlabel="y [px]")
        axes.invert_zaxis()
        axes.set_title(f"Events of both cameras, {name}", pad=-10)
        axes.set_box_aspect((1.6, 1.0, 1.0), zoom=0.95)
        axes.locator_params(nbins=4)
        axes.xaxis.labelpad = 10
        axes.legend(loc="upper right", fontsize="small", markerscale=12)
    for column, (name, offset_s) in enumerate(clocks(t_d_s)):
        axes = canvas.add_subplot(2, 2, 3 + column)
        _draw_angles(axes, material, offset_s, start_s, length_s)
        axes.set(
            xlabel="time, camera 1's clock [s]",
            ylabel="angle of epipolar plane [deg]",
            xlim=(start_s, start_s + length_s),
            title=f"Both cameras, {name}",
        )


@dataclass(frozen=True)
class _Figure:
    """One figure: how tall it is, when there are the data for it, and who draws it."""

    name: str
    height_in: Callable[[Material], float]
    can_draw: Callable[[Material], bool]
    draw: Callable[[Canvas, Material], None]


_POINT: dict[str, Any] = {
    "marker": "X",
    "markersize": 11,
    "markerfacecolor": "black",
    "markeredgecolor": "white",
    "linestyle": "none",
}
_CAMERA_COLORS = (BLUE, YELLOW)
POLARITIES = (Patch(color=YELLOW, label="brighter"), Patch(color=BLUE, label="darker"))


def _mark_offset(axes: Axes, position: float, label: str) -> None:
    axes.axvline(position, color=RED, lw=1.2, ls="--", label=label, zorder=1)
    axes.locator_params("x", nbins=7)
    axes.legend(loc="best", fontsize="small")


def _draw_events(
    axes: Axes, material: Material, camera: int, time_s: float, reach_px: float
) -> None:
    """Draw the events of the window around a time as pixels, the last on top."""
    events = window(material, camera, time_s, material.config.half_window_s)
    points = undistorted(events, (material.rig.cam1, material.rig.cam2)[camera])
    colors = np.where(events["p"] > 0, YELLOW, BLUE)
    pixel_pt = 1.15 * _AXES_WIDTH_PT / (2.0 * reach_px)  # a little more, lest they leave gaps
    x, y = points.T
    axes.scatter(x, y, s=pixel_pt**2, c=colors, marker="s", linewidths=0.0, rasterized=True)


def _foot(line: Array, point: Array) -> Array:
    """Foot (2,) of the perpendicular from the point to the line (a, b, c)."""
    normal = line[:2]
    return np.asarray(point - (normal @ point + line[2]) / (normal @ normal) * normal)


def _draw_angles(
    axes: Axes, material: Material, offset_s: float, start_s: float, length_s: float
) -> None:
    """Draw the angles of both cameras' events and tracks; camera 2's moved by the offset."""
    events, colors = [], []
    for camera, shift_s in ((0, 0.0), (1, offset_s)):
        times_s, points = points_in_time(material, camera, start_s + shift_s, length_s)
        events.append(np.column_stack([times_s - shift_s, plane_angles(material, camera, points)]))
        colors += [_CAMERA_COLORS[camera]] * len(times_s)
    # In random order, lest one camera cover the other.
    order = np.random.default_rng(0).permutation(len(colors))
    times_s, angles = np.concatenate(events)[order].T
    axes.scatter(times_s, angles, s=0.8, c=np.array(colors)[order], alpha=0.5)
    grid_s: Array = np.linspace(start_s, start_s + length_s, 400, dtype=np.float64)
    for camera, shift_s, style in ((0, 0.0, "-"), (1, offset_s, "--")):
        track = material.motions[camera].at(grid_s + shift_s)
        angles = np.where(track.valid, plane_angles(material, camera, track.positions_px), np.nan)
        color, label = _CAMERA_COLORS[camera], f"camera {camera + 1}"
        axes.plot(grid_s, angles, "-", color="white", lw=4, zorder=3)
        axes.plot(grid_s, angles, style, color=color, lw=2, zorder=4, label=label)
    axes.legend(loc="best", fontsize="small")


def _save(page: Figure, path: Path) -> None:
    with whole_file(path) as temporary:
        page.savefig(temporary, format=path.suffix[1:].lower(), dpi=_DPI)


_FIGURES = (
    _Figure("d_avg", lambda _: 3.2, has_curve, draw_search),
    _Figure(
        "epipolar", lambda material: 3.6 * len(epipolar_rows(material)), has_fit, draw_epipolar
    ),
    _Figure("alignment", lambda _: 7.0, has_pose, draw_alignment),
)
