"""Variants of the method `tangency`, which all start from one refinement (docs/tangency.md).

All see the same flights, 100 to 105 of 10 s at each angle, which are of no table, so that nothing
is tuned on what is reported there.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from experiments.drawing.style import ACCENT, Figure, legend_outside, method_looks, panels
from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure, RunRow
from experiments.lab.recorded import recorded_pair
from experiments.lab.score import Truth, kept, scored
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, by_group, made_of
from experiments.paper.esim import ANGLES_DEG, ERRORS, T_D_ERROR, drawn
from sim.recording import SimConfig
from sim.sensor.frames import FrameConfig
from ssac.camera import Rig, known_pose
from ssac.estimate import Estimate
from ssac.methods.tangency import TangencyConfig, refine_tangents
from ssac.pipeline.chain import Chain
from ssac.search.two_views import TwoViews
from ssac.track.outline import OutlineConfig

FIRST_FLIGHT, N_FLIGHTS = 100, 6
DURATION_S = 10.0
T_D_S = 0.05
FLOWN = {
    "n_flights": N_FLIGHTS,
    "first_flight": FIRST_FLIGHT,
    "duration_s": DURATION_S,
    "angles_deg": ANGLES_DEG,
    "t_d_s": T_D_S,
}
"""Which flights these are, as provenance says it."""

JOINT = "joint"  # the refinement from which all variants start, beside them
_WORST = f"{T_D_ERROR.column}_worst"


def _outline(**changes: Any) -> TangencyConfig:
    return TangencyConfig(outline=OutlineConfig(**changes))


AS_IT_IS = "as it is"

VARIANTS = {
    AS_IT_IS: TangencyConfig(),
    "midway between the tangents": TangencyConfig(apart=False),
    "loss of 95 % efficiency": TangencyConfig(cauchy=2.385, wider_cauchy=2.385),
    "loss turns at 1": TangencyConfig(cauchy=1.0),
    "all pairs weigh alike": TangencyConfig(sharp_px=100.0),
    "sharpest pairs err by 0.15 px": TangencyConfig(sharp_px=0.15),
    "not moved outward": _outline(outward=0.0),
    "moved outward by 1": _outline(outward=1.0),
    "edges not ahead": _outline(ahead_px=0.0),
    "edges ahead by 0.1 px": _outline(ahead_px=0.1),
    "extreme event itself": _outline(rank=0, deeper_rank=4),
    "ranks 1 and 6": _outline(rank=1, deeper_rank=6),
    "ranks 4 and 16": _outline(rank=4, deeper_rank=16),
    "ranks 30 and 60": _outline(rank=30, deeper_rank=60),
    "moved by the track only": _outline(passes=0),
    "one pass": _outline(passes=1),
    "half-window 10 ms": _outline(half_window_s=0.010),
    "half-window 10 ms, ranks 1 and 6": _outline(half_window_s=0.010, rank=1, deeper_rank=6),
    "half-window 40 ms": _outline(half_window_s=0.040),
    "half-window 60 ms": _outline(half_window_s=0.060),
    "smoothed over 60 ms": _outline(smoothing_s=0.060),
    "a sample every 10 ms": TangencyConfig(step_s=0.010),
    "a sample every 40 ms": TangencyConfig(step_s=0.040, outline=OutlineConfig(smoothing_s=0.080)),
}


@dataclass(frozen=True)
class VariantCell(FlightCell):
    """A variant on a flight with an offset."""

    variant: str
    config: TangencyConfig | None  # None: the joint refinement, from which the others start


@dataclass(frozen=True)
class ErrorRow(RunRow):
    """Errors on a flight."""

    t_d_error_ms: float = np.nan
    r_error_deg: float = np.nan
    t_error_deg: float = np.nan


@dataclass(frozen=True)
class VariantRow(ErrorRow):
    """Errors of a variant."""

    t_d_bias_ms: float = np.nan  # the error with its sign
    normalised: float = np.nan  # that over its stated deviation


def flights() -> Iterator[tuple[SimConfig, int, int]]:
    """Give what is simulated, the flight's number and its seed, of each flight."""
    spline = replace(SimConfig().spline, duration_s=DURATION_S)
    base = SimConfig(t_d_s=T_D_S, spline=spline, frames=FrameConfig(rate_hz=0.0))
    for sim in (replace(base, angle_deg=angle_deg) for angle_deg in ANGLES_DEG):
        for flight, seed in drawn(sim, range(FIRST_FLIGHT, FIRST_FLIGHT + N_FLIGHTS)):
            yield sim, flight, seed


def variant_cells() -> list[VariantCell]:
    """List the joint refinement and every variant on each flight."""
    variants: dict[str, TangencyConfig | None] = {JOINT: None, **VARIANTS}
    return [VariantCell(*one, *variant) for one in flights() for variant in variants.items()]


def load_started(cells: Sequence[VariantCell], cache: Cache) -> tuple[Estimate, TwoViews, Rig]:
    """Run the joint refinement on a flight: where the variants part."""
    cam1, cam2, rig = recorded_pair(cache, cells[0].sim, cells[0].seed)
    answer = Chain((cam1, cam2), rig).answer("joint")
    return answer.estimate, answer.views, rig


def variant_row(cell: VariantCell, started: tuple[Estimate, TwoViews, Rig]) -> VariantRow:
    """Run one variant."""
    estimate, views, rig = started
    if cell.config is not None:
        estimate = refine_tangents(estimate, views.by(tangency=cell.config))
    columns = kept(VariantRow, scored(estimate, Truth(cell.sim.t_d_s, *known_pose(rig))))
    signed_ms = 1e3 * (estimate.t_d_s - cell.sim.t_d_s)
    normalised = signed_ms / (1e3 * estimate.t_d_std_s)
    return VariantRow(**columns, t_d_bias_ms=signed_ms, normalised=normalised)


def variant_means(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean errors of each variant, over all angles, and t_d's at the worst angle."""

    def row(group: pd.DataFrame) -> dict[str, Any]:
        good = answered(group)
        return {
            "runs": len(group),
            "failed": len(group) - len(good),
            **good[list(ERRORS)].mean(),
            _WORST: good.groupby("angle_deg")[T_D_ERROR.column].mean().max(),
            "t_d_bias_ms": good["t_d_bias_ms"].mean(),
            "normalised_rms": float(np.sqrt(np.mean(np.square(good["normalised"])))),
        }

    return by_group(runs, ("variant",), row)


def study_figure(means: pd.DataFrame) -> Figure:
    """Draw the variants' mean errors: t_d's at the worst angle as a tick, the method's in black."""
    variants = means[means["variant"] != JOINT]
    own = method_looks(["tangency"])["tangency"].color
    colors = np.where(variants["variant"] == AS_IT_IS, own, "0.65")
    height_in = 1.4 + 0.22 * len(variants)
    figure = error_bars("Variants of tangency", height_in, variants, "variant", colors)
    figure.axes[0].plot(
        variants[_WORST], np.arange(len(variants)), "|", color=ACCENT, ms=9, mew=1.5,
        label="$t_d$ at the worst angle",
    )  # fmt: skip
    figure.axes[0].set_ylim(len(variants) - 0.4, -0.6)
    legend_outside(figure, 2)
    return figure


def error_bars(title: str, height_in: float, means: pd.DataFrame, of: str, color: Any) -> Figure:
    """Draw mean errors as bars, named by a column, those of the method as it is as a line."""
    title = f"{title}: mean errors of {means['runs'].max()} flights"
    figure, (axes,) = panels(title, height_in, columns=len(ERRORS), sharey=True)
    lines = np.arange(len(means))
    for ax, error in zip(axes, ERRORS.values(), strict=True):
        ax.grid(visible=False)
        ax.barh(lines, means[error.column], color=color, height=0.7)
        own = float(means.loc[means[of] == AS_IT_IS, error.column].iloc[0])
        ax.axvline(own, color="0.3", lw=0.8, ls=":", label="the method as it is")
        ax.set_xlabel(error.label, fontsize=9)
    axes[0].set_yticks(lines, means[of], fontsize=8)
    return figure


STUDIES = (
    Study(
        "tangency",
        "Variants of the method tangency",
        variant_cells,
        Measure(load_started, variant_row, VariantRow),
        Runs("tangency_runs.csv", ("angle_deg", "flight", "variant")),
        (made_of("tangency.csv", variant_means, "tangency_runs"),
         made_of("tangency.png", study_figure, "tangency")),
        config=FLOWN,
    ),
)  # fmt: skip
