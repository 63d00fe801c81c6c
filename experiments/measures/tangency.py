"""Flights and variants of the method `tangency` in, their errors out.

All variants of a flight start from the same joint refinement.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.recorded import recorded_pair
from experiments.lab.score import score
from ssac.camera import Rig, known_pose
from ssac.estimate import Estimate
from ssac.methods.tangency import TangencyConfig, refine_tangents
from ssac.pipeline.chain import Chain
from ssac.search.two_views import TwoViews


@dataclass(frozen=True)
class VariantCell(FlightCell):
    """A variant on a flight with an offset."""

    variant: str
    config: TangencyConfig | None  # None: the joint refinement, from which the others start

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is."""
        return {**self.flown, "variant": self.variant}

    @property
    def inputs(self) -> tuple[Any, ...]:
        """What the row depends on beside the recording, which knows no offset."""
        return self.sim.t_d_s, self.config


@dataclass(frozen=True)
class VariantRow:
    """Errors of a variant on a flight."""

    status: str
    reason: str = ""
    t_d_error_ms: float = np.nan
    r_error_deg: float = np.nan
    t_error_deg: float = np.nan
    t_d_bias_ms: float = np.nan  # the error with its sign
    normalised: float = np.nan  # that over its stated deviation


@dataclass(frozen=True)
class Started:
    """A flight up to where the variants part."""

    start: Estimate
    views: TwoViews
    rig: Rig  # with the true extrinsics


def load_started(cells: Sequence[VariantCell], cache: Cache) -> Started:
    """Run the joint refinement on a flight."""
    cam1, cam2, rig = recorded_pair(cache, cells[0].sim, cells[0].seed)
    answer = Chain((cam1, cam2), rig).answer("joint")
    return Started(answer.estimate, answer.views, rig)


def variant_row(cell: VariantCell, started: Started) -> VariantRow:
    """Run one variant."""
    estimate = started.start
    if cell.config is not None:
        estimate = refine_tangents(estimate, started.views, cell.config)
    errors = score(estimate, cell.sim.t_d_s, *known_pose(started.rig))
    signed_ms = 1e3 * (estimate.t_d_s - cell.sim.t_d_s)
    return VariantRow(
        str(estimate.status),
        estimate.reason,
        errors.t_d_error_ms,
        errors.r_error_deg,
        errors.t_error_deg,
        signed_ms,
        signed_ms / (1e3 * estimate.t_d_std_s),
    )


VARIANT = Measure(load_started, variant_row, VariantRow)
