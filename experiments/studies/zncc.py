"""Why ZNCC errs: what the signals of two views share (docs/zncc.md).

Rendered flights give the real event rates and frames; a model of the event rate follows from the
trajectory alone, so that hundreds of flights cost nothing, and its factors can be seen one by one.
Flights 300, 301, ... of each duration and angle, the same ones in all scenes and in the model; they
are of no table.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.markdown import markdown_table
from experiments.lab.recorded import Pair, load_pair
from experiments.lab.results import Results
from experiments.lab.study import Made, Runs, Study
from experiments.paper.grids import ANGLES_DEG, drawn
from experiments.scenes.scene import SceneFigures, pair_figures
from sim.recording import TRAJECTORY_STREAM, SimConfig
from sim.render.config import SamplingConfig
from sim.scene.rig import Camera, look_at_rig
from sim.scene.trajectory import SplineConfig, Trajectory, random_spline
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
    curve = zncc(signal1, signal2, lags, _SIGNALS.min_overlap)
    return _agreement(bin_s * lags.astype(np.float64), curve)


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


DEFAULT = "default"

_DEFAULT = SplineConfig()
SCENES = {
    DEFAULT: _DEFAULT,
    "flatter": replace(_DEFAULT, multiplier_xyz_m=(3.4, 3.4, 3.0)),
    "no turning": replace(_DEFAULT, multiplier_rot_rad=(0.0, 0.0, 0.0)),
    **{
        f"vertical {metres:g} m": replace(_DEFAULT, multiplier_xyz_m=(3.2, 3.2, metres))
        for metres in (3.0, 2.4, 1.8, 1.2)
    },
}
RENDERED_AT = {DEFAULT: ANGLES_DEG, "flatter": ANGLES_DEG, "no turning": (90.0,)}
"""Angles at which a scene is rendered."""

MODELLED_SCENES = [scene for scene in SCENES if scene != "no turning"]
"""The model does not turn either."""

RENDERED_S, MODELLED_S = 20.0, (10.0, 20.0)
FIRST_FLIGHT = 300
N_RENDERED, N_MODELLED = 10, 100
"""Flights at each scene, duration and angle."""

N_MORE = {(DEFAULT, 90.0): 20}
"""Rendered flights where ten tell too little."""

GROSS_MS = 100.0  # a larger error is another peak of the correlation, not the true one read badly
MAX_STEP_PX = 1.0  # four times the default: a third of the time, correlations within 0.02 the same


def signal_cells() -> list[SignalCell]:
    """List every signal of the rendered flights, then of the modelled ones."""
    return [*_rendered(), *_modelled()]


def _rendered() -> Iterator[SignalCell]:
    for scene, angles_deg in RENDERED_AT.items():
        for angle_deg in angles_deg:
            sim = SimConfig(
                angle_deg=angle_deg,
                spline=replace(SCENES[scene], duration_s=RENDERED_S),
                sampling=SamplingConfig(max_step_px=MAX_STEP_PX),
            )
            n_flights = N_MORE.get((scene, angle_deg), N_RENDERED)
            for flight, seed in drawn(sim, range(FIRST_FLIGHT, FIRST_FLIGHT + n_flights)):
                for signal in RENDERED_SIGNALS:
                    yield SignalCell(sim, flight, seed, RENDERED, scene, signal)


def _modelled() -> Iterator[SignalCell]:
    """Yield modelled signals: the factors of the event rate in the default scene alone."""
    for scene in MODELLED_SCENES:
        for duration_s in MODELLED_S:
            for angle_deg in ANGLES_DEG:
                spline = replace(SCENES[scene], duration_s=duration_s)
                sim = SimConfig(angle_deg=angle_deg, spline=spline)
                for flight, seed in drawn(sim, range(FIRST_FLIGHT, FIRST_FLIGHT + N_MODELLED)):
                    for signal in MODELLED_SIGNALS if scene == DEFAULT else (RATE,):
                        yield SignalCell(sim, flight, seed, MODELLED, scene, signal)


def signal_means(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean over the flights; `gross_share` is that of errors above GROSS_MS."""
    runs = runs[runs["status"] == "ok"]
    measured = runs.drop(columns=["cell", "status", "reason", "flight", "seed"], errors="ignore")
    measured["gross_share"] = (runs["error_ms"] > GROSS_MS).astype(float)
    groups = measured.groupby(["source", "scene", "duration_s", "signal", "angle_deg"], sort=False)
    table = groups.mean(numeric_only=True)
    table.insert(0, "flights", groups.size())
    table.insert(2, "error_ms_std", groups["error_ms"].std(ddof=0))
    result: pd.DataFrame = table.rename(columns={"error_ms": "error_ms_mean"}).reset_index()
    return result


_ANGLE_HEADER = [f"{angle:g} deg" for angle in ANGLES_DEG]


def correlation_table(results: Results) -> str:
    """Correlation of the two views at the true lag, default scene, 20 s."""

    def row(words: str, source: str, signal: str, column: str = "at_truth") -> list[str]:
        return [words, *_by_angle(results, source, signal, column, "{:.2f}")]

    rows = [
        row("speed across the line of sight (model)", MODELLED, "speed"),
        row("1 / distance squared (model)", MODELLED, "distance"),
        row("event rate (model)", MODELLED, RATE),
        row("event rate, rendered: `zncc_e`", RENDERED, ZNCC_E),
        row("mean brightness of a frame: `zncc_f`", RENDERED, ZNCC_F),
        row("change from frame to frame", RENDERED, CHANGES),
        row("highest value elsewhere (event rate, model)", MODELLED, RATE, "elsewhere"),
    ]
    return markdown_table(["", *_ANGLE_HEADER], rows)


def frames_table(results: Results) -> str:
    """Lay out errors and their deviations of what ZNCC_F may take of a frame, over 20 s."""
    of = {"quantity": "zncc_f_t_d_error_ms", "duration_s": RENDERED_S}
    published = (
        [
            f"{results.column('comparison', f'published_{part}', angle_deg=angle, **of).mean():.0f}"
            for angle in ANGLES_DEG
        ]
        for part in ("mean", "std")
    )
    rows = [["paper, ZNCC_F", *_with_deviations(*published)]]
    for words, source, signal in (
        ("1 / distance squared (model)", MODELLED, "distance"),
        ("mean brightness: `zncc_f`", RENDERED, ZNCC_F),
        ("change from frame to frame", RENDERED, CHANGES),
    ):
        both = (
            _by_angle(results, source, signal, f"error_ms_{part}", "{:.0f}")
            for part in ("mean", "std")
        )
        rows.append([words, *_with_deviations(*both)])
    return markdown_table(["mean error (deviation) [ms]", *_ANGLE_HEADER], rows)


def _by_angle(results: Results, source: str, signal: str, column: str, form: str) -> list[str]:
    of = {"source": source, "signal": signal, "scene": DEFAULT, "duration_s": RENDERED_S}
    return [
        form.format(results.value("zncc", column, angle_deg=angle, **of)) for angle in ANGLES_DEG
    ]


def _with_deviations(means: Sequence[str], deviations: Sequence[str]) -> list[str]:
    return [f"{mean} ({std})" for mean, std in zip(means, deviations, strict=True)]


STUDIES = (
    Study(
        "zncc",
        "What the signals of two views share",
        signal_cells,
        Measure(load_flight, signal_row, SignalRow),
        Runs("zncc_runs.csv", ("source", "scene", "duration_s", "angle_deg", "flight", "signal")),
        (Made("zncc.csv", lambda results: signal_means(results.table("zncc_runs"))),),
        numbers={
            "table.zncc.correlation": correlation_table,
            "table.zncc.frames": frames_table,
        },
        config={
            "scenes": SCENES,
            "first_flight": FIRST_FLIGHT,
            "n_rendered": N_RENDERED,
            "n_modelled": N_MODELLED,
        },
    ),
)
