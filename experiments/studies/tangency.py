"""Variants of the tangents of `tangency`, and what limits the method (docs/tangency.md).

All variants start from the joint refinement, and end before a body joins. To see what limits the
method, the truth replaces parts of its estimate in turn: the tangents to the outline, their
velocities, the point of the body, and the pose; or the method is told that the clocks have no
relative skew, as is true.

All see the same flights, 100 to 105 of 10 s at each angle, which are in no table, so that nothing
is tuned on what is reported there.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import pandas as pd

from experiments.drawing.style import ACCENT, Figure, legend_outside, method_looks, panels
from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure, RunRow
from experiments.lab.recorded import Pair, recorded_pair
from experiments.lab.score import Truth, kept, scored
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, by_group, made_of, shown_table
from experiments.paper.esim import ANGLES_DEG, ERRORS, T_D_ERROR, drawn
from sim.recording import Scene, SimConfig
from sim.sensor.frames import FrameConfig
from ssac.arrays import Array
from ssac.camera import Camera, Rig, known_pose
from ssac.config import Config
from ssac.estimate import Estimate
from ssac.geometry.pose import Pencil
from ssac.methods import tangency
from ssac.methods.rigid_body import body_points
from ssac.methods.tangency import refine_tangents
from ssac.points import PointTrack
from ssac.rules import OutlineRules, PointRules, TangencyRules
from ssac.search.two_views import TwoViews
from ssac.track.motion import PointMotion, point_motion
from ssac.track.outline import Tangents, tangents

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
"""The flights, as provenance states them."""

JOINT = "joint"  # row of the refinement from which all variants start
_WORST = f"{T_D_ERROR.column}_worst"


def _outline(**changes: Any) -> TangencyRules:
    return TangencyRules(outline=OutlineRules(**changes))


AS_IT_IS = "as it is"

VARIANTS = {
    AS_IT_IS: TangencyRules(),
    "midway between the tangents": TangencyRules(apart=False),
    "loss of 95 % efficiency": TangencyRules(cauchy=2.385, wider_cauchy=2.385),
    "loss turns at 1": TangencyRules(cauchy=1.0),
    "all pairs weigh alike": TangencyRules(sharp_px=100.0),
    "sharpest pairs err by 0.15 px": TangencyRules(sharp_px=0.15),
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
    "a sample every 10 ms": TangencyRules(step_s=0.010),
    "a sample every 40 ms": TangencyRules(step_s=0.040, outline=OutlineRules(smoothing_s=0.080)),
}

STARTED: dict[str, TangencyRules | None] = {JOINT: None, **VARIANTS}
"""The joint refinement, and all that start from it."""


@dataclass(frozen=True)
class VariantCell(FlightCell):
    """A variant on a flight with an offset."""

    variant: str
    config: TangencyRules | None  # None: the joint refinement, from which the others start


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
    normalised: float = np.nan  # this error over its stated deviation


def flights() -> Iterator[tuple[SimConfig, int, int]]:
    """Yield the configuration, the number and the seed of each flight."""
    spline = replace(SimConfig().spline, duration_s=DURATION_S)
    base = SimConfig(t_d_s=T_D_S, spline=spline, frames=FrameConfig(rate_hz=0.0))
    for sim in (replace(base, angle_deg=angle_deg) for angle_deg in ANGLES_DEG):
        for flight, seed in drawn(sim, range(FIRST_FLIGHT, FIRST_FLIGHT + N_FLIGHTS)):
            yield sim, flight, seed


def load_started(cells: Sequence[VariantCell], cache: Cache) -> tuple[Estimate, TwoViews, Rig]:
    """Run the joint refinement on a flight, from which all variants start."""
    pair = recorded_pair(cache, cells[0].sim, cells[0].seed)
    answer = pair.chain().answer("joint")
    return answer.estimate, answer.views, pair.rig


def variant_row(cell: VariantCell, started: tuple[Estimate, TwoViews, Rig]) -> VariantRow:
    """Run one variant."""
    estimate, views, rig = started
    if cell.config is not None:
        estimate = refine_tangents(estimate, views.by(tangency=cell.config))
    columns = kept(VariantRow, scored(estimate, Truth(cell.sim.t_d_s, *known_pose(rig))))
    signed_ms = 1e3 * (estimate.t_d_s - cell.sim.t_d_s)
    normalised = signed_ms / (1e3 * estimate.t_d_std_s)
    return VariantRow(**columns, t_d_bias_ms=signed_ms, normalised=normalised)


def mean_errors(group: pd.DataFrame) -> dict[str, Any]:
    """Return the mean errors of the runs that are "ok", and how many are not."""
    good = answered(group)
    return {"runs": len(group), "failed": len(group) - len(good), **good[list(ERRORS)].mean()}


@by_group("variant")
def variant_means(group: pd.DataFrame) -> dict[str, Any]:
    """Mean errors of each variant, over all angles, and t_d's at the worst angle."""
    good = answered(group)
    return {
        **mean_errors(group),
        _WORST: good.groupby("angle_deg")[T_D_ERROR.column].mean().max(),
        "t_d_bias_ms": good["t_d_bias_ms"].mean(),
        "normalised_rms": float(np.sqrt(np.mean(np.square(good["normalised"])))),
    }


def study_figure(means: pd.DataFrame) -> Figure:
    """Draw mean errors of the variants; the method is black, t_d at the worst angle a tick."""
    variants = means[means["variant"] != JOINT]
    own = method_looks(["tangency"])["tangency"].color
    colors = np.where(variants["variant"] == AS_IT_IS, own, "0.65")
    height_in = 1.4 + 0.22 * len(variants)
    figure = error_bars("Variants of the tangents alone", height_in, variants, "variant", colors)
    figure.axes[0].plot(
        variants[_WORST], np.arange(len(variants)), "|", color=ACCENT, ms=9, mew=1.5,
        label="$t_d$ at the worst angle",
    )  # fmt: skip
    figure.axes[0].set_ylim(len(variants) - 0.4, -0.6)
    legend_outside(figure, 2)
    return figure


def error_bars(title: str, height_in: float, means: pd.DataFrame, of: str, color: Any) -> Figure:
    """Draw mean errors as bars, labelled by a column; lines show those as it is."""
    title = f"{title}: mean errors of {means['runs'].max()} flights"
    figure, (axes,) = panels(title, height_in, columns=len(ERRORS), sharey=True)
    lines = np.arange(len(means))
    for ax, error in zip(axes, ERRORS.values(), strict=True):
        ax.grid(visible=False)
        ax.barh(lines, means[error.column], color=color, height=0.7)
        own = float(means.loc[means[of] == AS_IT_IS, error.column].iloc[0])
        ax.axvline(own, color="0.3", lw=0.8, ls=":", label=AS_IT_IS)
        ax.set_xlabel(error.label, fontsize=9)
    axes[0].set_yticks(lines, means[of], fontsize=8)
    return figure


# --- What limits it ---

TANGENTS, VELOCITIES, BODY = "true tangents", "true velocities", "true point of the body"
BOTH, POSE, CLOCKS = "true tangents and point", "true pose", "clocks alike"
CAUSES = (AS_IT_IS, TANGENTS, VELOCITIES, BODY, BOTH, POSE, CLOCKS)

_STEP_S = 0.01  # of the images of the body's point


@dataclass(frozen=True)
class CauseCell(FlightCell):
    """A flight, and the part of the estimate that the truth replaces."""

    cause: str


@dataclass(frozen=True, eq=False)
class Filmed:
    """The true scene, and one of the cameras that film it."""

    scene: Scene
    camera: int  # from 0 on
    as_stated: Camera
    later_s: float  # by which the camera's clock is ahead of the scene's

    def images(self, times_s: Array, points_B_m: Array) -> Array:
        """Project body-frame points (m, 3) at times (n,) of the camera's clock: (n, m, 2) [px]."""
        flight = self.scene.trajectory
        poses = flight.poses(np.clip(times_s - self.later_s, 0.0, flight.duration_s))
        points_W_m = points_B_m @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
        images_px = self.scene.rig.cameras[self.camera].project(points_W_m)
        return np.asarray(images_px, np.float64)

    def tangents(self, pencil: Pencil, times_s: Array) -> list[tuple[Array, Array]]:
        """Return points of contact and velocities (n, 2) of the upper and the lower tangent."""
        vertices = np.concatenate([part.vertices_B_m for part in self.scene.drone.parts])
        images = self.images(times_s, vertices)
        angles = pencil.angles(images.reshape(-1, 2)).reshape(images.shape[:2])
        # The angles are unwrapped from vertex to vertex, and over time.
        angles = np.asarray(np.unwrap(angles, axis=1), np.float64)
        angles += (np.unwrap(angles[:, 0]) - angles[:, 0])[:, None]
        found, every = [], np.arange(len(times_s))
        for furthest in (np.argmax(angles, axis=1), np.argmin(angles, axis=1)):
            points = images[every, furthest]
            gradients = pencil.gradients(points)
            slopes = np.gradient(angles[every, furthest], times_s) / np.sum(gradients**2, axis=1)
            found.append((points, slopes[:, None] * gradients))
        return found

    def point(self) -> PointMotion:
        """Return the motion of the image of the drone's origin."""
        lasting_s = self.scene.trajectory.duration_s
        times_s = self.later_s + np.arange(0.0, lasting_s, _STEP_S, dtype=np.float64)
        points_px = self.images(times_s, np.zeros((1, 3)))[:, 0]
        camera = self.scene.rig.cameras[self.camera]
        seen = np.all((points_px > 0.0) & (points_px < [camera.width, camera.height]), axis=1)
        track = PointTrack(times_s[seen], points_px[seen], np.ones(int(seen.sum())))
        return point_motion(track, self.as_stated, PointRules())


class FilmedPair(NamedTuple):
    """Two cameras' recordings, and what they filmed."""

    pair: Pair
    filmed: tuple[Filmed, Filmed]

    def instead(self, cause: str) -> dict[str, Any]:
        """Return replacements of functions of `ssac.methods.tangency`, by name."""
        turns = cycle(self.filmed)  # `tangents` is called for camera 1, then for camera 2

        def right(*found_of: Any) -> list[Tangents]:
            _, _, pencil, times_s, _ = found_of
            of_truth, is_kept = next(turns).tangents(pencil, times_s), cause == VELOCITIES
            return [
                replace(one, points_px=one.points_px if is_kept else points, velocities_px_s=moved)
                for one, (points, moved) in zip(tangents(*found_of), of_truth, strict=True)
            ]

        def bodies(*_: Any) -> tuple[PointMotion, PointMotion]:
            return self.filmed[0].point(), self.filmed[1].point()

        return {
            "tangents": right if cause in (TANGENTS, VELOCITIES, BOTH) else tangents,
            "body_points": bodies if cause in (BODY, BOTH) else body_points,
        }


def load_filmed(cells: Sequence[CauseCell], cache: Cache) -> FilmedPair:
    """Load a recording, and rebuild its scene."""
    sim, seed = cells[0].sim, cells[0].seed
    pair, scene = recorded_pair(cache, sim, seed), sim.scene(seed)
    one, other = Filmed(scene, 0, pair.rig.cam1, 0.0), Filmed(scene, 1, pair.rig.cam2, sim.t_d_s)
    return FilmedPair(pair, (one, other))


def cause_row(cell: CauseCell, filmed_pair: FilmedPair) -> ErrorRow:
    """Run `tangency` with the truth in place of a part, and score its estimate."""
    pair, cause = filmed_pair.pair, cell.cause
    config = Config(skew_prior_ppm=0.0) if cause == CLOCKS else Config()
    method = "tangency-known" if cause == POSE else "tangency"
    with patch.multiple(tangency, **filmed_pair.instead(cause)):
        estimate = pair.chain(config).estimate(method)
    truth = Truth(cell.sim.t_d_s, *known_pose(pair.rig))
    return ErrorRow(**kept(ErrorRow, scored(estimate, truth)))


def cause_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Sum up the remaining errors, and the share of t_d's error that each truth removes."""
    table = by_group("cause")(mean_errors)(runs)
    whole_ms = float(table.loc[table["cause"] == AS_IT_IS, T_D_ERROR.column].iloc[0])
    return table.assign(share_of_t_d=1.0 - table[T_D_ERROR.column] / whole_ms)


def cause_figure(table: pd.DataFrame) -> Figure:
    """Draw the remaining mean errors, and those of the method as it is as a line."""
    figure = error_bars("What is left of tangency's errors", 3.6, table, "cause", "0.65")
    figure.axes[0].invert_yaxis()
    for axes in figure.axes:  # some are too small for a bar to be seen
        bars: Any = axes.containers[0]
        axes.bar_label(bars, fmt="{:.2g}", fontsize=7, padding=2)
        axes.margins(x=0.25)
    legend_outside(figure, 1)
    return figure


_LEFT = {error.heading: f"{{{error.column}:.3f}}" for error in ERRORS.values()}

STUDIES = (
    Study(
        "tangency",
        "Variants of the tangents of the method tangency, without a body",
        lambda: [VariantCell(*one, *of) for one in flights() for of in STARTED.items()],
        Measure(load_started, variant_row, VariantRow),
        Runs("tangency_runs.csv", ("angle_deg", "flight", "variant")),
        (made_of("tangency.csv", variant_means, "tangency_runs"),
         made_of("tangency.png", study_figure, "tangency")),
        config=FLOWN,
    ),
    Study(
        "oracle",
        "What limits the method tangency: the error with parts of the truth",
        lambda: [CauseCell(*one, cause) for one in flights() for cause in CAUSES],
        Measure(load_filmed, cause_row, ErrorRow),
        Runs("oracle_runs.csv", ("angle_deg", "flight", "cause")),
        (made_of("oracle.csv", cause_table, "oracle_runs"),
         made_of("oracle.png", cause_figure, "oracle")),
        config=FLOWN,
        numbers={"table.oracle": lambda of: shown_table(of.table("oracle"),
                                                        {"put right": "{cause}", **_LEFT})},
    ),
)  # fmt: skip
