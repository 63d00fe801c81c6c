"""A flight and a signal in, how the signals of two views agree out.

Rendered flights give the real event rates and frames; a model of the event rate follows from the
trajectory alone, so that hundreds of flights cost nothing, and its factors can be seen one by one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.recorded import Pair, load_pair
from experiments.scenes.scene import SceneFigures, pair_figures
from sim.recording import TRAJECTORY_STREAM, SimConfig
from sim.scene.rig import Camera, look_at_rig
from sim.scene.trajectory import Trajectory, random_spline
from sim.seeds import generator
from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.events import US_PER_S
from ssac.files.hdf5 import load_frames
from ssac.methods.correlations import Signal, binned, counted, lags_of, zncc
from ssac.pipeline.chain import Chain
from ssac.rules import SignalRules
from ssac.track.observation import Observation

Array = NDArray[np.float64]

_SIGNALS = SignalRules()
ZNCC_BIN_S, FRAME_S = _SIGNALS.zncc_bin_s, _SIGNALS.frame_s

RENDERED, MODELLED = "rendered", "modelled"
"""Where a signal comes from."""

BINS_S = {f"zncc_e, bins of {1e3 * bin_s:g} ms": bin_s for bin_s in (0.005, 0.020, 0.050)}
"""Signals that are the event rate in other bins than the 10 ms of ZNCC_E."""

ZNCC_E, ZNCC_F, RAW, CHANGES = "zncc_e", "zncc_f", "zncc_e, raw events", "frame changes"
RENDERED_SIGNALS = (ZNCC_E, ZNCC_F, RAW, CHANGES, *BINS_S)
RATE = "rate"
MODELLED_SIGNALS = (RATE, "speed", "distance")

ELSEWHERE_S = 0.2  # further from the true lag than this, the true peak has fallen off
DRONE_SIZE_M = 0.65


@dataclass(frozen=True)
class SignalCell(FlightCell):
    """A signal of both views of a flight, which is simulated only if it is to be rendered."""

    source: str  # RENDERED or MODELLED
    scene: str
    signal: str

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is."""
        return {
            "source": self.source, "scene": self.scene, **self.flown, "signal": self.signal,
        }  # fmt: skip

    @property
    def inputs(self) -> tuple[str, str]:
        """What the row depends on beside the flight."""
        return self.source, self.signal


@dataclass(frozen=True)
class SignalRow:
    """How a signal of two views agrees; what is measured once a flight stands with ZNCC_E."""

    status: str
    reason: str = ""
    error_ms: float = np.nan  # of the lag with the highest correlation, the true one being zero
    at_truth: float = np.nan  # correlation at the true lag
    elsewhere: float = np.nan  # highest correlation at lags far from the true one
    model_fit: float = np.nan  # correlation of camera 2's event rate with the model's
    speed_px_s: float = np.nan  # this and those below as in `scene.SceneFigures`
    n_valid: float = np.nan
    slope_px: float = np.nan


@dataclass(frozen=True)
class Agreement:
    """How two signals correlate, the true lag being zero."""

    error_ms: float  # of the lag with the highest correlation
    at_truth: float  # correlation at the true lag
    elsewhere: float  # highest correlation at other lags


@dataclass
class SignalFlight:
    """A flight, of which only what a signal needs is loaded."""

    sim: SimConfig
    seed: int
    cache: Cache

    @cached_property
    def folder(self) -> Path:
        """Of the recording."""
        return self.cache.recording_folder(self.sim, self.seed)

    @cached_property
    def raw(self) -> Pair:
        """What both cameras recorded, with frames."""
        cam1, cam2, rig = load_pair(self.folder)
        first, second = (
            _with_frames(camera, self.folder / f"{name}.h5")
            for name, camera in (("cam1", cam1), ("cam2", cam2))
        )
        return Pair(first, second, rig)

    @cached_property
    def chain(self) -> Chain:
        """Methods on the same."""
        return Chain(self.raw[:2], self.raw.rig)

    @cached_property
    def modelled(self) -> tuple[dict[str, Signal], dict[str, Signal]]:
        """The modelled signals of both cameras."""
        trajectory = flown(self.sim, self.seed)
        cameras = look_at_rig((0.0, self.sim.angle_deg)).cameras
        first, second = (modelled_signals(trajectory, camera) for camera in cameras)
        return first, second


def load_flight(cells: Sequence[SignalCell], cache: Cache) -> SignalFlight:
    """Name a flight; it is loaded when a signal is asked for."""
    return SignalFlight(cells[0].sim, cells[0].seed, cache)


def signal_row(cell: SignalCell, flight: SignalFlight) -> SignalRow:
    """Correlate one signal of both views."""
    if cell.source == MODELLED:
        first, second = flight.modelled
        return SignalRow(
            "ok", **vars(agreement(first[cell.signal], second[cell.signal], ZNCC_BIN_S))
        )
    found = rendered_agreement(cell.signal, flight)
    if cell.signal != ZNCC_E:
        return SignalRow("ok", **vars(found))
    rate = counted(flight.chain.clean(1).events["t"], round(ZNCC_BIN_S * US_PER_S))
    model = flight.modelled[1][RATE]
    figures = _figures(flight)
    return SignalRow(
        "ok",
        **vars(found),
        model_fit=float(zncc(rate, model, np.zeros(1, np.int64), _SIGNALS.min_overlap)[0]),
        speed_px_s=figures.speed_px_s if figures else np.nan,
        n_valid=float(figures.n_valid) if figures else np.nan,
        slope_px=figures.slope_px if figures else np.nan,
    )


SIGNALS = Measure(load_flight, signal_row, SignalRow)


def rendered_agreement(signal: str, flight: SignalFlight) -> Agreement:
    """Correlate what both cameras recorded, as one of RENDERED_SIGNALS."""
    if signal == RAW:
        return of_estimate(flight.chain.under(Config(denoise=False)).estimate(ZNCC_E))
    if signal in (ZNCC_E, ZNCC_F):
        return of_estimate(flight.chain.estimate(signal))
    if signal == CHANGES:
        changes = [_frame_changes(camera) for camera in (flight.raw.cam1, flight.raw.cam2)]
        return agreement(changes[0], changes[1], FRAME_S)
    bin_s = BINS_S[signal]
    bin_us = round(bin_s * US_PER_S)
    rates = [counted(flight.chain.clean(k).events["t"], bin_us) for k in range(2)]
    return agreement(rates[0], rates[1], bin_s)


def flown(sim: SimConfig, seed: int) -> Trajectory:
    """Draw the trajectory that `simulate` flies."""
    return random_spline(sim.spline, generator(seed, TRAJECTORY_STREAM))


def modelled_signals(trajectory: Trajectory, camera: Camera) -> dict[str, Signal]:
    """Model a camera's event rate: the drone's outline sweeps over pixels.

    Returns
    -------
    dict of Signal
        In bins of `ZNCC_BIN_S`, each in a unit of its own: "rate", the drone's image speed times
        its image's width times the share of it in the image; and two factors that make up the rate,
        "speed", of the drone across the line of sight, and "distance", one over its square.
    """
    n = int(trajectory.duration_s / ZNCC_BIN_S)
    times_s = ZNCC_BIN_S * (np.arange(n, dtype=np.float64) + 0.5)
    points = trajectory.position(times_s)
    velocity: Array = np.gradient(points, ZNCC_BIN_S, axis=0)
    to_drone = points - np.linalg.inv(camera.T_C_W)[:3, 3]
    distance_m = np.linalg.norm(to_drone, axis=1)
    closing = np.sum(velocity * to_drone, axis=1) / distance_m
    pixels = camera.project(points)
    width_px = camera.K[0, 0] * DRONE_SIZE_M / distance_m
    inside = np.ones(n)
    for position, size in zip(pixels.T, (camera.width, camera.height), strict=True):
        low, high = position - width_px / 2, position + width_px / 2
        inside *= np.clip((np.minimum(high, size) - np.maximum(low, 0.0)) / width_px, 0.0, 1.0)
    image_speed = np.linalg.norm(np.gradient(pixels, ZNCC_BIN_S, axis=0), axis=1)
    return {
        "rate": Signal(0, np.nan_to_num(image_speed * width_px * inside)),
        "speed": Signal(0, np.sqrt(np.maximum(np.sum(velocity**2, axis=1) - closing**2, 0.0))),
        "distance": Signal(0, distance_m**-2),
    }


def agreement(signal1: Signal, signal2: Signal, bin_s: float) -> Agreement:
    """Correlate two signals over lags of +-1 s."""
    lags = lags_of(Config(), bin_s)
    return _agreement(
        bin_s * lags.astype(np.float64), zncc(signal1, signal2, lags, _SIGNALS.min_overlap)
    )


def of_estimate(estimate: Estimate) -> Agreement:
    """Read the correlation at the true lag, and beside it, off a method's cost curve."""
    return _agreement(estimate.candidates_s, -estimate.costs)


def _frame_changes(camera: Observation) -> Signal:
    """Mean absolute difference of each frame from the one before."""
    if camera.frames is None or camera.frame_times_s is None:
        raise SsacError("the study needs intensity frames, but the recording has none")
    changes = [
        np.mean(np.abs(after.astype(np.float64) - before.astype(np.float64)))
        for before, after in pairwise(camera.frames)
    ]
    return binned(camera.frame_times_s[1:], np.array(changes), FRAME_S)


def _agreement(lags_s: Array, curve: Array) -> Agreement:
    return Agreement(
        error_ms=1e3 * abs(float(lags_s[np.nanargmax(curve)])),
        at_truth=float(curve[np.argmin(np.abs(lags_s))]),
        elsewhere=float(np.nanmax(curve[np.abs(lags_s) > ELSEWHERE_S])),
    )


def _figures(flight: SignalFlight) -> SceneFigures | None:
    """How the scene looks, at the angle at which the authors' sample is known."""
    if flight.sim.angle_deg != SimConfig.angle_deg:
        return None
    return pair_figures(*flight.raw, t_d_s=0.0)


def _with_frames(camera: Observation, path: Path) -> Observation:
    frames = load_frames(path)
    if frames is None:
        return camera
    times_us, images = frames
    return Observation(camera.events, images, times_us / US_PER_S)
