"""Figures of an estimate, over the events that it was made from.

Fig. 4, 5 and 7 are the paper's. "Before" pairs equal readings of both clocks, "after" pairs
readings that differ by t_d. The colours are P. Tol's high-contrast set, which stays apart in grey
and for colour-blind people.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from ssac.arrays import Array
from ssac.camera import Camera, undistortion_map
from ssac.estimate import Status
from ssac.events import US_PER_S, slice_time
from ssac.files.whole_file import FIGURE_SUFFIXES, check_figures, whole_file
from ssac.fit.covariance import NORMAL_95
from ssac.fit.least_squares import Parameters, WeighedPairs
from ssac.geometry.epipolar import epipolar_distance, epipolar_lines_1, sampson_distance
from ssac.geometry.pose import rays_of
from ssac.methods.joint import sharp_pairs
from ssac.methods.tangency import for_blind, tangent_times, tangents_under
from ssac.pipeline.answer import Answer
from ssac.search.offset_search import mean_epipolar_distance
from ssac.search.two_views import PairsAt

if TYPE_CHECKING:
    from ssac.network.comparison import Comparison, InTime

Canvas = Figure | SubFigure
Draw = Callable[[Canvas, Answer], None]

BLUE, YELLOW, RED = "#004488", "#DDAA33", "#BB5566"

POLARITIES = Patch(color=YELLOW, label="brighter"), Patch(color=BLUE, label="darker")
ZOOM_S = 0.003  # half the width of the zoom around the minimum, as in the paper's Fig. 5

_WIDTH_IN, _DPI = 9.0, 150
_TRUTH = "0.75"  # grey of the reference path, a wide line beneath the estimate
_POINT: dict[str, Any] = {"marker": "X", "ms": 11, "mfc": "black", "mec": "white", "ls": "none"}


def save_figures(target: Path, answer: Answer, only: str = "") -> list[Path]:
    """Draw the figures that an estimate allows, and return the files written, if any.

    The target is a folder, made if need be, for one PNG per figure; or a file of FIGURE_SUFFIXES
    for all figures, one below the other. `only` names the one figure that is wanted.
    """
    figures = [figure for figure in figures_of(answer) if only in ("", figure[0])]
    if not figures:
        return []
    if target.suffix.lower() in FIGURE_SUFFIXES:
        pages = {target: figures}
    else:
        check_figures(target)
        target.mkdir(parents=True, exist_ok=True)
        pages = {target / f"{figure[0]}.png": [figure] for figure in figures}
    for path, shown in pages.items():
        save(_page(shown, answer), path, _DPI)
    return list(pages)


def page_of(answer: Answer) -> Figure | None:
    """Draw all figures that an estimate allows, one below the other; None where there are none."""
    figures = figures_of(answer)
    return _page(figures, answer) if figures else None


def figures_of(answer: Answer) -> list[tuple[str, float, Draw]]:
    """List the figures that an estimate allows: name, height [in] and function that draws it."""
    found = list[tuple[str, float, Draw]]()
    if has_costs(answer):
        found.append(("d_avg", 3.2, draw_search))
    if has_fit(answer):
        found.append(("epipolar", 3.6 * len(_instant_of(answer)[1]), draw_epipolar))
    return found


def _page(figures: list[tuple[str, float, Draw]], answer: Answer) -> Figure:
    heights = [height_in for _, height_in, _ in figures]
    page = Figure(figsize=(_WIDTH_IN, sum(heights)), layout="constrained")
    parts = [page] if len(figures) == 1 else page.subfigures(len(figures), height_ratios=heights)
    for (_, _, draw), part in zip(figures, parts, strict=True):
        draw(part, answer)
    return page


def save(page: Figure, path: Path, dpi: int) -> None:
    """Write a figure, in the format that the name ends in."""
    with whole_file(path) as temporary:
        page.savefig(temporary, format=path.suffix[1:].lower(), dpi=dpi)


@dataclass(frozen=True)
class Fit:
    """The n pairs of which an estimate was made, and their distances from epipolar lines."""

    pairs: WeighedPairs | PairsAt
    is_of_tangents: bool  # pairs of tangents to the outline; False: of positions
    distances_px: Array  # (n,) signed Sampson distances

    @property
    def what(self) -> str:
        """Name the kind of the pairs."""
        return "tangents to the outline" if self.is_of_tangents else "positions"


def fit_of(answer: Answer) -> Fit | None:
    """Sample again the pairs of an estimate or a refusal's best offset; None without F or pairs."""
    estimate, views, t_d_s = answer.estimate, answer.paired, best_s(answer)
    if estimate.F is None or not np.isfinite(t_d_s):
        return None
    is_refined = answer.method.name.startswith("tangency") and not answer.of_start
    of_tangents = is_refined and estimate.status == Status.OK and estimate.R is not None
    pairs: WeighedPairs | PairsAt
    if of_tangents:
        views = for_blind(views)
        parameters = Parameters(t_d_s, np.asarray(estimate.R), np.asarray(estimate.t))
        pairs, _ = tangents_under(parameters, views, tangent_times(views, t_d_s))
    elif estimate.covariance is not None or answer.method.finds_readout:
        times_s = views.sample_times(np.array([t_d_s]))[0]
        pairs, _ = sharp_pairs(views, times_s, t_d_s)
    else:
        pairs = views.pairs_at(t_d_s)
    if len(pairs.times_s) == 0:
        return None
    return Fit(pairs, of_tangents, sampson_distance(estimate.F, pairs.p1_px, pairs.p2_px))


def best_s(answer: Answer) -> float:
    """Return the offset [s]; of a refusal without one, that of least cost; else NaN."""
    estimate = answer.estimate
    if np.isfinite(estimate.t_d_s) or not np.isfinite(estimate.costs).any():
        return estimate.t_d_s
    return float(estimate.candidates_s[np.nanargmin(estimate.costs)])


def has_fit(answer: Answer) -> bool:
    """Whether there is an F and an offset, so that epipolar lines can be drawn."""
    return answer.estimate.F is not None and bool(np.isfinite(answer.estimate.t_d_s))


def has_costs(answer: Answer) -> bool:
    """Whether there is a cost at each offset: the method's own, or that of its F."""
    return has_fit(answer) or bool(np.isfinite(answer.estimate.costs).any())


def draw_search(canvas: Canvas, answer: Answer) -> None:
    """Draw the cost over the search, and near its minimum where there is an F, as in Fig. 5."""
    whole, *rest = canvas.subplots(1, 1 + has_fit(answer), squeeze=False)[0]
    draw_costs(whole, answer)
    whole.set_title("Over the search interval")
    for axes in rest:
        draw_minimum(axes, answer, fit_of(answer))
        axes.set_title("Near the offset found, with the final F")
    for axes in (whole, *rest):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="best", fontsize="small")


def draw_costs(axes: Axes, answer: Answer) -> None:
    """Draw the cost, or the correlation, at all offsets that were tried."""
    estimate, t_d_s = answer.estimate, best_s(answer)
    offsets_s, costs = estimate.candidates_s, estimate.costs
    if not np.isfinite(costs).any():  # the method kept none: take those of its F
        low_s, high_s = answer.paired.config.offsets_s
        n = int(np.clip((high_s - low_s) / 2e-3, 2, 2000))  # all pairs are in memory at once
        offsets_s = np.linspace(low_s, high_s, n, dtype=np.float64)
        costs = d_avg_px(answer, offsets_s)
    # Clocks may be years apart: without a base, ticks would look the same.
    base_s = float(round(t_d_s)) if abs(t_d_s) > 100.0 else 0.0
    if estimate.F is None and np.nanmin(costs) < 0.0:
        axes.plot(offsets_s - base_s, -costs, color=BLUE, lw=1.2)
        axes.set_ylabel("correlation")
    else:
        marker = "." if len(offsets_s) <= 300 else ""
        axes.plot(offsets_s - base_s, costs, "-", marker=marker, color=BLUE, lw=1.2, ms=3)
        # Refused after the search over all offsets, it has that search's costs.
        is_relative = estimate.F is None and answer.start is not None and answer.start.refusal
        axes.set_ylabel("distance / width of path" if is_relative else "$d_{avg}$ [px]")
        axes.set_ylim(bottom=0.0)
    for k, other_s in enumerate(estimate.alternatives_s.tolist()):
        name = "_" if k else "also possible"
        axes.axvline(other_s - base_s, color=YELLOW, lw=1.2, ls="--", label=name)
    axes.set_xlabel(f"offset $t_d$ - {base_s:.0f} s [s]" if base_s else "offset $t_d$ [s]")
    if np.isfinite(t_d_s):
        what = "" if estimate.has_offset else ", the best of all"
        _mark_offset(axes, t_d_s - base_s, f"$t_d$ = {1e3 * t_d_s:.2f} ms{what}")


def draw_minimum(axes: Axes, answer: Answer, fit: Fit | None) -> None:
    """Draw the cost of a fit's pairs around the offset found, with the estimate's F."""
    t_d_s, std_s = answer.estimate.t_d_s, answer.estimate.t_d_std_s
    reach_s = max(ZOOM_S, 4.0 * std_s) if np.isfinite(std_s) else ZOOM_S
    near_s: Array = np.linspace(-reach_s, reach_s, 121, dtype=np.float64)
    if fit is None or isinstance(fit.pairs, PairsAt):  # which have no velocities
        costs_px = d_avg_px(answer, t_d_s + near_s)
    else:
        p2_px = fit.pairs.p2_px + near_s[:, None, None] * fit.pairs.v2_px_s
        distances_px = epipolar_distance(np.asarray(answer.estimate.F), fit.pairs.p1_px, p2_px)
        costs_px = np.nanmean(distances_px, axis=1)
    axes.plot(1e3 * near_s, costs_px, color=BLUE, lw=1.2)
    if np.isfinite(std_s):
        ends_ms = NORMAL_95 * 1e3 * std_s * np.array([-1.0, 1.0])
        axes.axvspan(*ends_ms, color=RED, alpha=0.2, lw=0.0, label="95 % interval")
    _mark_offset(axes, 0.0, f"$t_d$ = {1e3 * t_d_s:.3f} ms")
    axes.set(xlabel="offset - offset found [ms]", ylabel="$d_{avg}$ [px]", ylim=(0.0, None))


def draw_epipolar(canvas: Canvas, answer: Answer) -> None:
    """Draw both cameras' events around one instant, with p1, p2, l1 and d, as in Fig. 4."""
    F, views = np.asarray(answer.estimate.F), answer.paired
    time_s, pairings = _instant_of(answer)
    at_s = np.array([time_s])
    *before_s, aligned_s = pairings  # before, both clocks read the same, whatever the skew
    shown_s = [time_s for _ in before_s] + [float(views.on_clock_2(at_s, aligned_s)[0])]
    p1_px = views.motion1.at(at_s).positions_px
    p2s_px = [views.motion2.at(np.array([at])).positions_px for at in shown_s]
    distances_px = [float(epipolar_distance(F, p1_px, p2_px)[0]) for p2_px in p2s_px]
    reach_px = float(np.clip(2.0 * max(distances_px), 40.0, 150.0))
    rows = canvas.subplots(len(pairings), 2, squeeze=False)
    parts = zip(rows, pairings.values(), shown_s, p2s_px, distances_px, strict=True)
    for (left, right), name, time_2_s, p2_px, distance_px in parts:
        _draw_events(left, answer, 0, time_s, reach_px)
        _draw_events(right, answer, 1, time_2_s, reach_px)
        (p1,), (p2,), (line_1,) = p1_px, p2_px, epipolar_lines_1(F, p2_px)
        normal = line_1[:2]
        foot = p1 - (normal @ p1 + line_1[2]) / (normal @ normal) * normal
        along = np.array([-normal[1], normal[0]]) / np.hypot(*normal)
        left.axline(foot, foot + along, color="black", lw=1.2, label="line $l_1$ of $p_2$")
        left.plot(*np.stack([p1, foot]).T, color=RED, lw=3, label="distance $d$")
        left.plot(*p1, **_POINT, label="$p_1$, $p_2$")
        right.plot(*p2, **_POINT)
        left.set_title(f"Camera 1 at {time_s:.4f} s: $d$ = {distance_px:.2f} px", fontsize="medium")
        right.set_title(f"Camera 2 at {time_2_s:.4f} s: {name}", fontsize="medium")
        for axes, centre in ((left, p1), (right, p2)):
            axes.set(xlabel="x [px]", ylabel="y [px]", aspect="equal")
            axes.set_xlim(centre[0] - reach_px, centre[0] + reach_px)
            axes.set_ylim(centre[1] + 0.75 * reach_px, centre[1] - 0.75 * reach_px)
    handles = [*left.get_legend_handles_labels()[0], *POLARITIES]
    canvas.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize="small")


def d_avg_px(answer: Answer, offsets_s: Array) -> Array:
    """Mean epipolar distance [px] (Eq. 4) at each offset, with the estimate's F."""
    F = answer.estimate.F
    if F is None:
        return np.full(len(offsets_s), np.nan)
    views = answer.paired
    return mean_epipolar_distance(F, views.pairs(offsets_s), views.config.rules.search.min_pairs)


def _instant_of(answer: Answer) -> tuple[float, dict[float, str]]:
    """Return a time [s] when the distance "before" is at its median, and the offsets' names."""
    F, t_d_s = np.asarray(answer.estimate.F), answer.estimate.t_d_s
    motion1, motion2 = answer.paired.motions
    pairs = answer.paired.pairs_at(t_d_s)
    before = motion2.at(pairs.times_s)
    if not before.valid.any() or t_d_s == 0.0:  # there is no "before"
        times_s, points_px, pairings = pairs.times_s, pairs.points_px, dict[float, str]()
    else:
        times_s = pairs.times_s[before.valid]
        points_px = motion1.at(times_s).positions_px, before.positions_px[before.valid]
        pairings = {0.0: "clocks as recorded"}
    distances_px = epipolar_distance(F, *points_px)
    time_s = times_s[np.argmin(np.abs(distances_px - np.median(distances_px)))]
    return float(time_s), pairings | {t_d_s: "clocks aligned"}


def events_around(
    answer: Answer, camera: int, time_s: float, half_length_s: float, most: int | None = None
) -> tuple[NDArray[np.void], Array]:
    """Return about `most` events of camera 0 or 1 around a time of its clock, and their points."""
    bounds_us = (round((time_s + side * half_length_s) * US_PER_S) for side in (-1, 1))
    events = slice_time(answer.cleans[camera].events, *bounds_us)
    events = events if most is None else events[:: max(1, len(events) // most)]
    return events, ideal_points(answer.cameras[camera], events)


def ideal_points(camera: Camera, events: NDArray[np.void]) -> Array:
    """Give undistorted points (n, 2) of events; NaN where the lens model has none."""
    return np.asarray(undistortion_map(camera)[events["y"], events["x"]])


def telling_stretch(answer: Answer) -> tuple[float, float]:
    """Start [s] on camera 1's clock and length [s] of where `plane_angles` vary most."""
    t_d_s = answer.estimate.t_d_s
    length_s = float(np.clip(20.0 * abs(t_d_s), 0.4, 2.0))
    pairs = answer.paired.pairs(np.array([t_d_s]))
    times_s, valid = pairs.times_s[0], pairs.valid[0]
    length_s = min(length_s, float(times_s[-1] - times_s[0]))
    angles = plane_angles(answer, 0, pairs.p1_px[0])
    scores = []
    for start_s in times_s[times_s <= times_s[-1] - length_s]:
        inside = (times_s >= start_s) & (times_s <= start_s + length_s)
        seen = inside & valid
        spread = np.ptp(angles[seen]) if seen.any() else 0.0
        scores.append(spread * (np.count_nonzero(seen) / np.count_nonzero(inside)) ** 2)
    return float(times_s[int(np.argmax(scores))]), length_s


def plane_angles(answer: Answer, camera: int, points: Array) -> Array:
    """Angles (n,) [deg] of the epipolar planes of points (n, 2); 0: of camera 1's optical axis."""
    R, t = np.asarray(answer.estimate.R), np.asarray(answer.estimate.t)
    rays = rays_of(answer.cameras[camera].K, points)
    if camera == 1:
        rays = rays @ R  # from camera 2's frame to camera 1's
    baseline = R.T @ t
    ahead = np.array([0.0, 0.0, 1.0]) - baseline[2] * baseline
    ahead /= np.linalg.norm(ahead)
    across = np.cross(ahead, baseline)
    return np.asarray(np.degrees(np.arctan2(rays @ across, rays @ ahead)))


def _mark_offset(axes: Axes, position: float, label: str) -> None:
    axes.axvline(position, color=RED, lw=1.2, ls="--", label=label, zorder=1)
    axes.locator_params("x", nbins=7)


def _draw_events(axes: Axes, answer: Answer, camera: int, time_s: float, reach_px: float) -> None:
    """Draw the events of the window around a time as pixels, the last on top."""
    events, points = events_around(answer, camera, time_s, answer.config.half_window_s)
    colors = np.where(events["p"] > 0, YELLOW, BLUE)
    width_pt = 270.0  # of one of two axes side by side
    pixel_pt = 1.15 * width_pt / (2.0 * reach_px)  # a little more, lest they leave gaps
    x, y = points.T
    axes.scatter(x, y, s=pixel_pt**2, c=colors, marker="s", linewidths=0.0, rasterized=True)


def draw_comparison(comparison: "Comparison") -> Figure:
    """Draw both paths in space, as in Fig. 7, and with times x, y, z and their differences."""
    in_time = comparison.in_time
    page = Figure(figsize=(6.0 if in_time is None else 12.0, 6.5), layout="constrained")
    if in_time is None:
        _draw_shape(page, comparison)
    else:
        left, right = page.subfigures(1, 2)
        _draw_shape(left, comparison)
        _draw_over_time(right, in_time)
    return page


def _draw_shape(canvas: Canvas, comparison: "Comparison") -> None:
    axes = canvas.add_subplot(projection="3d")
    axes.plot(*_broken(comparison.truth_m).T, color=_TRUTH, lw=4.0, label="truth")
    axes.plot(*_broken(comparison.estimate_m).T, color="black", lw=1.0, label="estimate")
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    # Smaller than the canvas, which does not count the labels of axes in space as its own.
    axes.set_box_aspect(np.maximum(np.ptp(comparison.truth_m, axis=0), 1e-9), zoom=0.8)
    axes.locator_params(nbins=4)
    axes.legend(loc="upper right", fontsize="small")
    shape_m, in_time = comparison.as_shape.rmse_m, comparison.in_time
    said = f"{shape_m:.3f} m (ICP)"
    if in_time is not None:
        said = f"{in_time.rmse_m:.3f} m at equal times, {shape_m:.3f} m by ICP"
    axes.set_title(f"RMSE {said}", fontsize="medium")


def _broken(points: Array) -> Array:
    """Points (n, 3) with NaN in each gap: a step of over four times the usual one."""
    steps_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
    usual_m = float(np.percentile(steps_m, 95.0)) if len(steps_m) else 0.0
    return np.insert(points, np.flatnonzero(steps_m > 4.0 * usual_m) + 1, np.nan, axis=0)


def _draw_over_time(canvas: Canvas, found: "InTime") -> None:
    rows = canvas.subplots(6, 1, sharex=True, gridspec_kw={"height_ratios": [2, 1] * 3})
    times_s = found.times_s - found.times_s[0]
    gaps = np.flatnonzero(np.diff(times_s) > 1.5 * np.median(np.diff(times_s))) + 1
    times_s, truth_m, estimate_m = (
        np.insert(values, gaps, np.nan, axis=0)  # a line does not cross a gap
        for values in (times_s, found.truth_m, found.estimate_m)
    )
    for k, name in enumerate("xyz"):
        path, difference = rows[2 * k], rows[2 * k + 1]
        path.plot(times_s, truth_m[:, k], color=_TRUTH, lw=4.0)
        path.plot(times_s, estimate_m[:, k], color="black", lw=1.0)
        path.set_ylabel(f"{name} [m]")
        difference.plot(times_s, 100.0 * (estimate_m - truth_m)[:, k], color=RED, lw=0.8)
        difference.axhline(0.0, color="grey", lw=0.5)
        difference.set_ylabel("off [cm]", fontsize="small")
    rows[-1].set_xlabel("time of the truth since the first common sample [s]")
