"""Imperfect recordings in, what each method says of them and how far it is off out.

The flights are simulated and kept as any others; what spoils them is added when they are loaded.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.recorded import Pair, recorded_pair
from experiments.lab.score import score
from experiments.measures.imperfect_kinds import KINDS, T_D_S, Kind
from sim.disturb import View, clutter, merged, thinned, wrong_intrinsics
from sim.recorded import Drift
from ssac.camera import Camera, Rig, known_pose
from ssac.estimate import Estimate
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import METHODS
from ssac.track.observation import Observation


@dataclass(frozen=True)
class ImperfectCell(FlightCell):
    """A method on a kind of recording that is made of a flight."""

    kind: str  # of KINDS
    other_seed: int  # of the flight of the second object, where the kind has one
    method: str

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is."""
        return {"kind": self.kind, **self.flown, "method": self.method}

    @property
    def inputs(self) -> tuple[Any, ...]:
        """What the row depends on beside the recording and the code."""
        return self.kind, self.other_seed, self.method, METHODS[self.method].version

    @property
    def needs_other(self) -> bool:
        """Whether a second object is in the kind's recordings."""
        return KINDS[self.kind].disturb.second_object > 0.0


@dataclass(frozen=True)
class ImperfectRow:
    """What was said, and its errors over their stated deviations; NaN for what is not given."""

    status: str
    reason: str = ""
    offset_given: bool = False
    pose_given: bool = False
    t_d_error_ms: float = np.nan
    r_error_deg: float = np.nan
    t_error_deg: float = np.nan
    skew_error_ppm: float = np.nan
    t_d_std_ms: float = np.nan
    r_std_deg: float = np.nan
    t_std_deg: float = np.nan
    skew_std_ppm: float = np.nan
    t_d_normalised: float = np.nan  # of an offset that is given; the skew's likewise
    skew_normalised: float = np.nan
    r_mahalanobis: float = np.nan  # of a pose that is given, as in `score.PoseScore`
    t_mahalanobis: float = np.nan
    true_skew_ppm: float = np.nan
    n_samples: int = 0
    n_events_cam1: int = 0  # as recorded, clutter included
    n_events_cam2: int = 0


@dataclass(frozen=True)
class FlownImperfect:
    """A flight, and the kind that was made of it last."""

    flight: Pair  # whose clocks show the same
    other: Pair | None
    spoilt: dict[str, Chain] = field(default_factory=dict)


def load_imperfect(cells: Sequence[ImperfectCell], cache: Cache) -> FlownImperfect:
    """Load the flight, and that of the second object where a kind has one."""
    sim, other = replace(cells[0].sim, t_d_s=0.0), None
    if any(cell.needs_other for cell in cells):
        other = recorded_pair(cache, sim, cells[0].other_seed)
    return FlownImperfect(recorded_pair(cache, sim, cells[0].seed), other)


def imperfect_row(cell: ImperfectCell, flown: FlownImperfect) -> ImperfectRow:
    """Run one method on one kind, and score what it says."""
    kind = KINDS[cell.kind]
    if cell.kind not in flown.spoilt:
        flown.spoilt.clear()  # the cells of a kind follow each other
        other = flown.other if cell.needs_other else None
        pair = spoilt_pair(flown.flight, other, kind, cell.seed, cell.sim.spline.duration_s)
        flown.spoilt[cell.kind] = Chain((pair.cam1, pair.cam2), pair.rig)
    chain = flown.spoilt[cell.kind]
    row = scored(
        chain.estimate(cell.method),
        flown.flight.rig,
        kind.skew_ppm(cell.seed),
        0.5 * cell.sim.spline.duration_s,
    )
    n_cam1, n_cam2 = (chain.clean(k).n_recorded for k in range(2))
    return replace(row, n_events_cam1=n_cam1, n_events_cam2=n_cam2)


IMPERFECT_RUNS = Measure(load_imperfect, imperfect_row, ImperfectRow)


def spoilt_pair(flight: Pair, other: Pair | None, kind: Kind, seed: int, duration_s: float) -> Pair:
    """Make of a flight what two imperfect cameras record of it.

    Parameters
    ----------
    flight, other
        Pairs whose clocks show the same; of the other one a share of the events is added.
    kind
    seed
        Of the flight.
    duration_s
        Of both.

    Returns
    -------
    Pair
        Camera 2's clock shows `T_D_S` and the kind's skew; the rig is as wrong as it says, but for
        its pose, which is the true one.
    """
    cameras, models = [], []
    for index, model in enumerate((flight.rig.cam1, flight.rig.cam2)):
        view = View(model.width, model.height, duration_s)
        streams = [flight[:2][index].events, clutter(kind.disturb, view, seed, index)]
        if other is not None:
            events = other[:2][index].events
            streams.append(thinned(events, kind.disturb.second_object, seed, index))
        cameras.append(merged(*streams))
        models.append(_wrong(model, kind, seed, index))
    drift = Drift(kind.skew_ppm(seed), 0.5 * duration_s)
    cameras[1]["t"] += drift.added_us(cameras[1]["t"])
    rig = Rig(models[0], models[1], flight.rig.T_2_1)
    return Pair(Observation(cameras[0]), Observation(cameras[1]).delayed(T_D_S), rig)


def scored(estimate: Estimate, true: Rig, skew_ppm: float, t_mid_s: float) -> ImperfectRow:
    """Score what was said.

    Parameters
    ----------
    estimate
    true
        Rig with the true pose.
    skew_ppm
        The true one.
    t_mid_s
        Where the true offset is `T_D_S`, camera 1's clock.
    """
    since_s = estimate.t_ref_s - t_mid_s if np.isfinite(estimate.t_ref_s) else 0.0
    t_d_s = T_D_S + 1e-6 * skew_ppm * since_s  # where the estimate's holds
    errors = score(estimate, t_d_s, *known_pose(true))
    row = ImperfectRow(
        str(estimate.status), estimate.reason, true_skew_ppm=skew_ppm, n_samples=estimate.n_samples
    )
    if estimate.has_offset:
        skew_error_ppm = estimate.skew_ppm - skew_ppm
        skew_std_ppm = estimate.skew_std_ppm or np.nan  # 0: it was not looked for
        row = replace(
            row,
            offset_given=True,
            t_d_error_ms=errors.t_d_error_ms,
            t_d_std_ms=1e3 * estimate.t_d_std_s,
            t_d_normalised=(estimate.t_d_s - t_d_s) / estimate.t_d_std_s,
            skew_error_ppm=abs(skew_error_ppm),
            skew_std_ppm=skew_std_ppm,
            skew_normalised=skew_error_ppm / skew_std_ppm,
        )
    if estimate.status == "ok" and not METHODS[estimate.method].needs_extrinsics:
        row = replace(
            row,
            pose_given=True,
            r_error_deg=errors.r_error_deg,
            t_error_deg=errors.t_error_deg,
            r_std_deg=estimate.r_std_deg,
            t_std_deg=estimate.t_std_deg,
            r_mahalanobis=errors.pose.r_mahalanobis,
            t_mahalanobis=errors.pose.t_mahalanobis,
        )
    return row


def _wrong(camera: Camera, kind: Kind, seed: int, index: int) -> Camera:
    """Give a camera the intrinsics that a calibration of the kind's deviations finds."""
    K, deviations_px = wrong_intrinsics(camera.K, kind.disturb, seed, index)
    return replace(camera, K=K, intrinsics_std_px=tuple(deviations_px.tolist()))
