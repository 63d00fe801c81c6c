"""What limits `tangency`: parts of what it finds are put right in turn, and the error that is left.

The flights are those of the study `tangency`. Truth takes the place of the outline's tangents that
the events tell, of how fast these move, of the body's point, and of the pose; and both clocks are
said to run alike, as they do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import pandas as pd

from experiments.drawing.style import Figure, legend_outside
from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.recorded import Pair, recorded_pair
from experiments.lab.results import Results
from experiments.lab.score import Truth, kept, scored
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, by_group, made_of, shown_table
from experiments.paper.esim import ERRORS, T_D_ERROR
from experiments.studies.tangency import AS_IT_IS, FLOWN, ErrorRow, error_bars, flights
from sim.recording import Scene
from ssac.arrays import Array
from ssac.camera import Camera, known_pose
from ssac.config import Config
from ssac.geometry.pose import Pencil
from ssac.methods import tangency
from ssac.methods.rigid_body import body_points
from ssac.pipeline.chain import Chain
from ssac.points import PointTrack
from ssac.rules import PointRules
from ssac.track.motion import PointMotion, point_motion
from ssac.track.outline import Tangents, tangents

TANGENTS, VELOCITIES, BODY = "true tangents", "true velocities", "true point of the body"
BOTH, POSE, CLOCKS = "true tangents and point", "true pose", "clocks alike"
CAUSES = (AS_IT_IS, TANGENTS, VELOCITIES, BODY, BOTH, POSE, CLOCKS)

_STEP_S = 0.01  # of the images of the body's point


@dataclass(frozen=True)
class CauseCell(FlightCell):
    """A flight, and what is put right of what is found in it."""

    cause: str


@dataclass(frozen=True, eq=False)
class Filmed:
    """What was filmed, as one of its cameras has it."""

    scene: Scene
    camera: int  # from 0 on
    as_stated: Camera
    later_s: float  # what its clock shows more than the scene's

    def images(self, times_s: Array, points_B_m: Array) -> Array:
        """Project points (m, 3) of the drone at rest at times (n,) of the own clock: (n, m, 2)."""
        flight = self.scene.trajectory
        poses = flight.poses(np.clip(times_s - self.later_s, 0.0, flight.duration_s))
        points_W_m = points_B_m @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
        images_px = self.scene.rig.cameras[self.camera].project(points_W_m)
        return np.asarray(images_px, np.float64)

    def tangents(self, pencil: Pencil, times_s: Array) -> list[tuple[Array, Array]]:
        """Give where the upper and the lower tangent touch, and how fast each moves: (n, 2)."""
        vertices = np.concatenate([part.vertices_B_m for part in self.scene.drone.parts])
        images = self.images(times_s, vertices)
        angles = pencil.angles(images.reshape(-1, 2)).reshape(images.shape[:2])
        # Without jumps, from vertex to vertex and from time to time.
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
        """Follow the image of the drone's origin."""
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
        """Give what stands in the place of functions of `ssac.methods.tangency`, by their names."""
        turns = cycle(self.filmed)  # camera 1 is asked about first, then camera 2

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


def cause_cells() -> list[CauseCell]:
    """List all that is put right, on each flight."""
    return [CauseCell(*one, cause) for one in flights() for cause in CAUSES]


def load_filmed(cells: Sequence[CauseCell], cache: Cache) -> FilmedPair:
    """Load a recording, and build anew what was filmed."""
    sim, seed = cells[0].sim, cells[0].seed
    pair, scene = recorded_pair(cache, sim, seed), sim.scene(seed)
    one, other = Filmed(scene, 0, pair.rig.cam1, 0.0), Filmed(scene, 1, pair.rig.cam2, sim.t_d_s)
    return FilmedPair(pair, (one, other))


def cause_row(cell: CauseCell, filmed_pair: FilmedPair) -> ErrorRow:
    """Run `tangency` with some truth, and score what it gives."""
    (cam1, cam2, rig), cause = filmed_pair.pair, cell.cause
    config = Config(skew_prior_ppm=0.0) if cause == CLOCKS else Config()
    method = "tangency-known" if cause == POSE else "tangency"
    with patch.multiple(tangency, **filmed_pair.instead(cause)):
        estimate = Chain((cam1, cam2), rig, config).estimate(method)
    return ErrorRow(**kept(ErrorRow, scored(estimate, Truth(cell.sim.t_d_s, *known_pose(rig)))))


def cause_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Sum up the errors that are left, and by which share of t_d's each truth lessens it."""

    def row(group: pd.DataFrame) -> dict[str, Any]:
        good = answered(group)
        return {"runs": len(group), "failed": len(group) - len(good), **good[list(ERRORS)].mean()}

    table = by_group(runs, ("cause",), row)
    whole_ms = float(table.loc[table["cause"] == AS_IT_IS, T_D_ERROR.column].iloc[0])
    return table.assign(share_of_t_d=1.0 - table[T_D_ERROR.column] / whole_ms)


def cause_figure(table: pd.DataFrame) -> Figure:
    """Draw the mean errors that are left, those of the method as it is as a line."""
    figure = error_bars("What is left of tangency's errors", 3.6, table, "cause", "0.65")
    figure.axes[0].invert_yaxis()
    for axes in figure.axes:  # some are too small for a bar to be seen
        bars: Any = axes.containers[0]
        axes.bar_label(bars, fmt="{:.2g}", fontsize=7, padding=2)
        axes.margins(x=0.25)
    legend_outside(figure, 1)
    return figure


def left_table(results: Results) -> str:
    """Lay out what is left of the errors."""
    columns = {"put right": "{cause}"} | {
        f"{error.symbol} [{error.unit}]": f"{{{error.column}:.3f}}" for error in ERRORS.values()
    }
    return shown_table(results.rows("oracle"), columns)


STUDIES = (
    Study(
        "oracle",
        "What limits the method tangency: the error with parts of the truth",
        cause_cells,
        Measure(load_filmed, cause_row, ErrorRow),
        Runs("oracle_runs.csv", ("angle_deg", "flight", "cause")),
        (made_of("oracle.csv", cause_table, "oracle_runs"),
         made_of("oracle.png", cause_figure, "oracle")),
        config=FLOWN,
        numbers={"table.oracle": left_table},
    ),
)  # fmt: skip
