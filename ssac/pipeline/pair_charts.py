"""Charts of what two cameras' answer rests on: cost, residuals, samples, and the clock's drift."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssac.arrays import Array, Mask
from ssac.camera import Camera
from ssac.estimate import Status
from ssac.fit.covariance import NORMAL_95
from ssac.fit.least_squares import Parameters
from ssac.geometry.epipolar import robust_deviation, sampson_distance
from ssac.methods.joint import sharp_pairs
from ssac.methods.tangency import for_blind, tangent_times, tangents_under
from ssac.pipeline.answer import Answer
from ssac.pipeline.charts import Chart, spread
from ssac.pipeline.plots import ZOOM_S, Material, d_avg_px, search_curve
from ssac.pipeline.streams import Seen, density_png, grid_of
from ssac.track.motion import ObjectMotion


@dataclass(frozen=True)
class Fit:
    """The pairs (n,) of which an estimate was made, and how far they are from their lines."""

    what: str  # they are
    times_s: Array  # (n,) camera 1's clock
    points_px: tuple[Array, Array]  # (n, 2) each
    distances_px: Array  # (n,) signed Sampson distances

    @property
    def sigma_px(self) -> float:
        """Their robust deviation."""
        return robust_deviation(self.distances_px)


def charts_of(answer: Answer, material: Material, most: int) -> dict[str, list[Chart]]:
    """Draw all that an answer allows, by what it is of, with so many dots in a chart at most."""
    fit = _fit_of(answer, material)
    return {
        "cost": _cost_charts(material),
        "residuals": [] if fit is None else _residual_charts(fit, material, most),
        "clock": _clock_charts(material),
    }


def _fit_of(answer: Answer, material: Material) -> Fit | None:
    """Sample the pairs of an estimate again; None without F."""
    estimate, views = answer.estimate, material.views
    if estimate.F is None or not np.isfinite(estimate.t_d_s):
        return None
    of_tangents = answer.method.name.startswith("tangency") and not answer.is_start
    if of_tangents and estimate.status == Status.OK and estimate.R is not None:
        views = for_blind(views)
        parameters = Parameters(estimate.t_d_s, estimate.R, np.asarray(estimate.t))
        pairs, _ = tangents_under(parameters, views, tangent_times(views, estimate.t_d_s))
        what, times_s, points = "tangents to the outline", pairs.times_s, (pairs.p1_px, pairs.p2_px)
    elif estimate.covariance is not None or answer.method.finds_readout:
        times_s = views.sample_times(np.array([estimate.t_d_s]))[0]
        sharp, _ = sharp_pairs(*views.sharp_at(times_s, estimate.t_d_s), estimate.t_d_s)
        what, times_s, points = "positions", sharp.times_s, (sharp.p1_px, sharp.p2_px)
    else:
        plain = views.pairs_at(estimate.t_d_s)
        what, times_s, points = "positions", plain.times_s, plain.points_px
    if len(times_s) == 0:
        return None
    return Fit(what, times_s, points, sampson_distance(estimate.F, *points))


def _cost_charts(material: Material) -> list[Chart]:
    """Draw the cost over the offsets that were searched, and near the one that was found."""
    estimate = material.estimate
    t_d_s, charts = estimate.t_d_s, list[Chart]()
    if np.isfinite(estimate.costs).any() or (estimate.F is not None and np.isfinite(t_d_s)):
        offsets_s, costs = search_curve(material)
        of_correlation = estimate.F is None and np.nanmin(costs) < 0.0
        costs = -costs if of_correlation else costs
        what = "Correlation" if of_correlation else "Mean distance from the epipolar lines"
        # Clocks may be years apart, and ticks must tell them from each other.
        base_s = float(round(t_d_s)) if abs(t_d_s) > 100.0 else 0.0
        top = spread(costs)[1]
        found = f" The best lies at {t_d_s:.4f} s." if np.isfinite(t_d_s) else ""
        others = ", ".join(f"{one_s:.3f}" for one_s in estimate.alternatives_s)
        more = f" Others that fit nearly as well: {others} s." if others else ""
        chart = Chart(
            "Cost over the search interval",
            f"{what} at each offset that was tried: one deep, narrow minimum means one answer."
            + found + more,
            f"offset - {base_s:.0f} s [s]" if base_s else "offset [s]",
            "correlation" if of_correlation else "distance [px]",
            spread(offsets_s - base_s, 0.0),
            (min(0.0, float(np.nanmin(costs))), top),
        )  # fmt: skip
        chart.line("soft", offsets_s - base_s, costs)
        if np.isfinite(t_d_s):
            chart.upright(
                "found", t_d_s - base_s, "offset found" if estimate.has_offset else "best of all"
            )
        for k, other_s in enumerate(estimate.alternatives_s.tolist()):
            chart.upright("other", other_s - base_s, "" if k else "also possible")
        charts.append(chart)
    if estimate.F is not None and np.isfinite(t_d_s):
        half_s, ends_s = ZOOM_S, NORMAL_95 * estimate.t_d_std_s * np.array([-1.0, 1.0])
        if np.isfinite(estimate.t_d_std_s):
            half_s = max(half_s, 2.0 * float(ends_s[1]))
        near_s = np.linspace(-half_s, half_s, 121, dtype=np.float64)
        costs_px = d_avg_px(material, t_d_s + near_s)
        chart = Chart(
            "Near the minimum",
            "The same about the offset found, with the final geometry: how wide it is says how"
            " sharply the motion tells the offset.",
            "offset - offset found [ms]",
            "distance [px]",
            (-1e3 * half_s, 1e3 * half_s),
            (0.0, spread(costs_px)[1]),
        )
        if np.isfinite(estimate.t_d_std_s):
            chart.band("sure", 1e3 * ends_s, np.zeros(2), np.full(2, chart.y[1]), "95 % interval")
        chart.line("soft", 1e3 * near_s, costs_px)
        chart.upright("found", 0.0, "offset found")
        charts.append(chart)
    return charts


def _residual_charts(fit: Fit, material: Material, most: int) -> list[Chart]:
    """Draw what is left of the pairs over time, as a histogram, and over both images."""
    sigma_px, off_px = fit.sigma_px, fit.distances_px
    thin = slice(None, None, 1 + len(off_px) // most)
    reach_px = float(np.clip(6.0 * sigma_px, 1e-3, None))
    beyond = int(np.count_nonzero(np.abs(off_px) > reach_px))
    start_s = material.motions[0].span_s[0]
    since_s = fit.times_s - start_s
    out = f" {beyond} of {len(off_px)} lie beyond the edges." if beyond else ""
    over_time = Chart(
        "Residuals over time",
        f"How far the {fit.what} lie from their epipolar lines: with the right clock the cloud is"
        f" level and equally wide all along, here {sigma_px:.2f} px (1 sigma).{out}",
        "time since the start of camera 1 [s]",
        "distance [px]",
        spread(since_s, 0.01),
        (-reach_px, reach_px),
    )
    over_time.line("faint", np.array(over_time.x), np.zeros(2))
    over_time.dots("near", since_s[thin], off_px[thin])
    edges = np.linspace(-reach_px, reach_px, 41, dtype=np.float64)
    heights = np.histogram(off_px, edges)[0].astype(np.float64)
    middles = 0.5 * (edges[1:] + edges[:-1])
    bell = np.exp(-0.5 * (middles / sigma_px) ** 2) if sigma_px > 0.0 else np.zeros(40)
    bell *= len(off_px) * (edges[1] - edges[0]) / (np.sqrt(2.0 * np.pi) * max(sigma_px, 1e-12))
    histogram = Chart(
        "Residuals as a histogram",
        "Beside a normal distribution of the same robust width. Long tails are outliers, which"
        " count little in the fit; a second hill, or a middle beside 0, would be a wrong model.",
        "distance [px]",
        "pairs",
        (-reach_px, reach_px),
        (0.0, 1.08 * max(float(heights.max()), float(bell.max()), 1.0)),
    )
    histogram.bars("near", edges, heights, "pairs")
    histogram.line("found", middles, bell, "normal distribution")
    charts = [over_time, histogram]
    classes = (
        ("small", 0.0, 1.0, "below 1 sigma"),
        ("medium", 1.0, 3.0, "1 to 3"),
        ("large", 3.0, np.inf, "above 3"),
    )
    shares = np.abs(off_px) / max(sigma_px, 1e-12)
    for k, camera in enumerate(material.cameras):
        chart = _image_chart(
            f"Residuals in camera {k + 1}'s image",
            "Large ones in one part of the image alone speak of a wrong lens or intrinsics.",
            camera,
        )
        x, y = fit.points_px[k].T
        for look, low, high, name in classes:
            shown = (shares[thin] >= low) & (shares[thin] < high)
            chart.dots(look, x[thin][shown], y[thin][shown], name)
        charts.append(chart)
    return charts


def sample_charts(cameras: Sequence[Seen], most: int) -> list[Chart]:
    """Draw when and where cameras saw the object well, and where not."""
    start_s = cameras[0].span_s[0]
    is_common = all(seen.later_s is not None for seen in cameras)
    over_time = Chart(
        "When each camera sees the object",
        "Blue where a sample is valid, "
        f"{'on the clock of camera 1' if is_common else 'each on its own clock'}: only what two see"
        " at one time tells anything.",
        "time since the start of camera 1 [s]",
        "",
        spread(
            [end_s - start_s - (seen.later_s or 0.0) for seen in cameras for end_s in seen.span_s]
        ),
        (float(len(cameras)), 0.0),
        rows=tuple(f"camera {k}" for k, _ in enumerate(cameras, start=1)),
    )
    charts = [over_time]
    for k, seen in enumerate(cameras):
        times_s = np.linspace(*seen.span_s, most, dtype=np.float64)
        track, motion, grid = seen.motion.at(times_s), seen.motion, grid_of(seen.clean.camera)
        few, why, of_events = ~track.valid, "in gaps of the track", False
        if isinstance(motion, ObjectMotion):
            of_events = True
            few = few & (track.counts < motion.n_min)
            why = f"with fewer than {motion.n_min} events within {1e3 * motion.half_window_s:g} ms"
        edge = ~track.valid & ~few
        chart = _image_chart(
            f"Samples in camera {k + 1}'s image",
            f"Of {most} even times {np.count_nonzero(track.valid)} are valid; rejected are"
            f" {np.count_nonzero(few)} {why} and {np.count_nonzero(edge)} that touch the border or"
            " a gap. Grey: all events.",
            seen.clean.camera,
            png=density_png(seen, grid),
        )
        for look, which, name in (
            ("good", track.valid, "valid"),
            ("few", few, "too few events" if of_events else "gap"),
            ("edge", edge, "at the border, or a gap"),
        ):
            x, y = track.positions_px[which].T
            chart.dots(look, x, y, name if which.any() else "")
            since_s = times_s - start_s - (seen.later_s or 0.0)
            over_time.line(f"strip {look}", *_runs(since_s, which, k + 0.5))
        charts.append(chart)
    return charts


def _runs(times_s: Array, which: Mask, y: float) -> tuple[Array, Array]:
    """Give a level line (m,) over the times (n,) that are meant, broken elsewhere."""
    if len(times_s) < 2 or not which.any():
        return np.empty(0), np.empty(0)
    half_s = 0.5 * (times_s[1] - times_s[0])
    edges = np.diff(np.concatenate([[0], which.astype(int), [0]]))
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    x = np.column_stack(
        [times_s[first] - half_s, times_s[last] + half_s, np.full(len(first), np.nan)]
    )
    return x.ravel(), np.full(x.size, y)


def _image_chart(title: str, words: str, camera: Camera, png: str = "") -> Chart:
    grid = grid_of(camera)
    right_px = grid.left_px + grid.cell_px * grid.columns
    bottom_px = grid.top_px + grid.cell_px * grid.rows
    edges = (grid.left_px, right_px), (bottom_px, grid.top_px)
    return Chart(title, words, "x [px]", "y [px]", *edges, f"{grid.columns} / {grid.rows}", png=png)


def _clock_charts(material: Material) -> list[Chart]:
    """Draw how camera 2's clock drifts; nothing where it was taken to run as camera 1's."""
    estimate = material.estimate
    if not (estimate.has_offset and np.isfinite(estimate.skew_ppm)):
        return []
    begin_s, end_s = material.views.common_s(estimate.t_d_s)
    if not begin_s < end_s:
        return []
    knots_s = estimate.knots_s[(estimate.knots_s > begin_s) & (estimate.knots_s < end_s)]
    times_s = np.sort(np.concatenate([np.linspace(begin_s, end_s, 121, dtype=np.float64), knots_s]))
    more_ms = 1e3 * estimate.clock.added_s(times_s)
    off_ms = NORMAL_95 * 1e3 * np.nan_to_num(estimate.clock_std_s(times_s))
    since_s = times_s - material.motions[0].span_s[0]
    words = "A straight line is a constant skew"
    if len(estimate.knots_s):
        words = f"A line of pieces with {len(estimate.knots_s)} knots: the clock wanders"
    chart = Chart(
        "Drift of camera 2's clock",
        f"What it shows more than camera 1's, less the offset. {words};"
        f" on the whole {estimate.skew_ppm:+.1f} ppm.",
        "time since the start of camera 1 [s]",
        "drift [ms]",
        (float(since_s[0]), float(since_s[-1])),
        spread(np.concatenate([more_ms - off_ms, more_ms + off_ms])),
    )
    chart.band("sure", since_s, more_ms - off_ms, more_ms + off_ms, "95 % interval")
    chart.line("found", since_s, more_ms, "drift found")
    if len(knots_s):
        at_ms = 1e3 * estimate.clock.added_s(knots_s)
        chart.dots("knots", knots_s - material.motions[0].span_s[0], at_ms, "knots")
    return [chart]
