"""Why ZNCC errs: what the signals of two views share (docs/zncc.md).

Rendered flights give the real event rates and frames; a model of the event rate follows from the
trajectory alone, so that hundreds of flights cost nothing, and its factors can be seen one by one.
Flights 300, 301, ... of each duration and angle, the same ones in all scenes and in the model; they
are of no table.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure, RunRow
from experiments.lab.recorded import Pair, load_pair
from experiments.lab.results import Results
from experiments.lab.study import Runs, Study
from experiments.lab.summary import answered, made_of, markdown_table
from experiments.paper.esim import ANGLES_DEG, drawn
from experiments.scenes.scene import pair_figures
from sim.recording import TRAJECTORY_STREAM, SimConfig
from sim.render.config import SamplingConfig
from sim.scene.rig import Camera, look_at_rig
from sim.scene.trajectory import SplineConfig, Trajectory, random_spline
from sim.seeds import generator
from ssac.arrays import Array
from ssac.config import Config
from ssac.errors import SsacError
from ssac.events import US_PER_S
from ssac.files.hdf5 import load_frames
from ssac.methods.correlations import Signal, binned, counted, lags_of, zncc
from ssac.pipeline.chain import Chain
from ssac.rules import SignalRules
from ssac.track.observation import Observation

_SIGNALS = SignalRules()
ZNCC_BIN_S, FRAME_S = _SIGNALS.zncc_bin_s, _SIGNALS.frame_s

RENDERED, MODELLED = "rendered", "modelled"  # where a signal comes from
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
        of_signal = {"source": self.source, "scene": self.scene}
        return {**of_signal, **self.flown, "signal": self.signal}


@dataclass(frozen=True)
class SignalRow(RunRow):
    """How a signal of two views agrees; what is measured once a flight stands with ZNCC_E."""

    error_ms: float = np.nan  # of the lag with the highest correlation, the true one being zero
    at_truth: float = np.nan  # correlation at the true lag
    elsewhere: float = np.nan  # highest correlation at lags far from the true one
    model_fit: float = np.nan  # correlation of camera 2's event rate with the model's
    speed_px_s: float = np.nan  # this and those below as in `scene.SceneFigures`
    n_valid: float = np.nan
    slope_px: float = np.nan


@dataclass
class SignalFlight:
    """A flight, of which only what a signal needs is loaded."""

    sim: SimConfig
    seed: int
    cache: Cache

    @cached_property
    def raw(self) -> Pair:
        """What both cameras recorded, with frames."""
        folder = self.cache.recording_folder(self.sim, self.seed)
        cam1, cam2, rig = load_pair(folder)
        return Pair(
            _with_frames(cam1, folder / "cam1.h5"), _with_frames(cam2, folder / "cam2.h5"), rig
        )

    @cached_property
    def chain(self) -> Chain:
        """Methods on the same."""
        return Chain(self.raw[:2], self.raw.rig)

    @cached_property
    def modelled(self) -> tuple[dict[str, Signal], dict[str, Signal]]:
        """The modelled signals of both cameras."""
        # That which `simulate` flies.
        trajectory = random_spline(self.sim.spline, generator(self.seed, TRAJECTORY_STREAM))
        cameras = look_at_rig((0.0, self.sim.angle_deg)).cameras
        first, second = (modelled_signals(trajectory, camera) for camera in cameras)
        return first, second


def load_flight(cells: Sequence[SignalCell], cache: Cache) -> SignalFlight:
    """Name a flight; it is loaded when a signal is asked for."""
    return SignalFlight(cells[0].sim, cells[0].seed, cache)


def signal_row(cell: SignalCell, flight: SignalFlight) -> SignalRow:
    """Correlate one signal of both views."""
    if cell.source == MODELLED:
        first, second = (signals[cell.signal] for signals in flight.modelled)
        return SignalRow("ok", **agreement(first, second, ZNCC_BIN_S))
    row = SignalRow("ok", **rendered_agreement(cell.signal, flight))
    if cell.signal != ZNCC_E:
        return row
    rate, model = _rates(flight, ZNCC_BIN_S)[1], flight.modelled[1][RATE]
    fit = zncc(rate, model, np.zeros(1, np.int64), _SIGNALS.min_overlap)[0]
    row = replace(row, model_fit=float(fit))
    if flight.sim.angle_deg != SimConfig.angle_deg:  # the authors' sample is of another angle
        return row
    seen = pair_figures(*flight.raw, t_d_s=0.0)
    if seen is None:
        return row
    return replace(
        row, speed_px_s=seen.speed_px_s, n_valid=float(seen.n_valid), slope_px=seen.slope_px
    )


def rendered_agreement(signal: str, flight: SignalFlight) -> dict[str, Any]:
    """Correlate what both cameras recorded, as one of RENDERED_SIGNALS."""
    if signal in (RAW, ZNCC_E, ZNCC_F):
        chain = flight.chain.under(Config(denoise=False)) if signal == RAW else flight.chain
        estimate = chain.estimate(ZNCC_E if signal == RAW else signal)
        return _agreement(estimate.candidates_s, -estimate.costs)
    if signal == CHANGES:
        first, second = (_frame_changes(camera) for camera in flight.raw[:2])
        return agreement(first, second, FRAME_S)
    return agreement(*_rates(flight, BINS_S[signal]), BINS_S[signal])


def _rates(flight: SignalFlight, bin_s: float) -> tuple[Signal, Signal]:
    """Event rates of both cameras, without noise."""
    first, second = (
        counted(flight.chain.clean(k).events["t"], round(bin_s * US_PER_S)) for k in range(2)
    )
    return first, second


def modelled_signals(trajectory: Trajectory, camera: Camera) -> dict[str, Signal]:
    """Model a camera's event rate: the drone's outline sweeps over pixels.

    In bins of `ZNCC_BIN_S`, each in a unit of its own: "rate", the drone's image speed times its
    image's width times the share of it in the image; and two factors that make up the rate,
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


def agreement(signal1: Signal, signal2: Signal, bin_s: float) -> dict[str, Any]:
    """Correlate two signals over lags of +-1 s."""
    lags = lags_of(Config(), bin_s)
    curve = zncc(signal1, signal2, lags, _SIGNALS.min_overlap)
    return _agreement(bin_s * lags.astype(np.float64), curve)


def _frame_changes(camera: Observation) -> Signal:
    """Mean absolute difference of each frame from the one before."""
    if camera.frames is None or camera.frame_times_s is None:
        raise SsacError("the study needs intensity frames, but the recording has none")
    changes = [
        np.mean(np.abs(after.astype(np.float64) - before.astype(np.float64)))
        for before, after in pairwise(camera.frames)
    ]
    return binned(camera.frame_times_s[1:], np.array(changes), FRAME_S)


def _agreement(lags_s: Array, curve: Array) -> dict[str, Any]:
    return {
        "error_ms": 1e3 * abs(float(lags_s[np.nanargmax(curve)])),
        "at_truth": float(curve[np.argmin(np.abs(lags_s))]),
        "elsewhere": float(np.nanmax(curve[np.abs(lags_s) > ELSEWHERE_S])),
    }


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
N_RENDERED, N_MODELLED = 10, 100  # flights at each scene, duration and angle
N_MORE = {(DEFAULT, 90.0): 20}  # rendered flights where ten tell too little
GROSS_MS = 100.0  # a larger error is another peak of the correlation, not the true one read badly
MAX_STEP_PX = 1.0  # four times the default: a third of the time, correlations within 0.02 the same


def signal_cells() -> list[SignalCell]:
    """List every signal of the rendered flights, then of the modelled ones."""
    cells: list[SignalCell] = []
    for scene, angles_deg in RENDERED_AT.items():
        spline = replace(SCENES[scene], duration_s=RENDERED_S)
        for angle_deg in angles_deg:
            sampling = SamplingConfig(max_step_px=MAX_STEP_PX)
            sim = SimConfig(angle_deg=angle_deg, spline=spline, sampling=sampling)
            n_flights = N_MORE.get((scene, angle_deg), N_RENDERED)
            cells += _of_flights(sim, n_flights, RENDERED, scene, RENDERED_SIGNALS)
    for scene, duration_s, angle_deg in product(MODELLED_SCENES, MODELLED_S, ANGLES_DEG):
        spline = replace(SCENES[scene], duration_s=duration_s)
        sim = SimConfig(angle_deg=angle_deg, spline=spline)
        signals = MODELLED_SIGNALS if scene == DEFAULT else (RATE,)
        cells += _of_flights(sim, N_MODELLED, MODELLED, scene, signals)
    return cells


def _of_flights(
    sim: SimConfig, n_flights: int, source: str, scene: str, signals: Sequence[str]
) -> list[SignalCell]:
    return [
        SignalCell(sim, flight, seed, source, scene, signal)
        for flight, seed in drawn(sim, range(FIRST_FLIGHT, FIRST_FLIGHT + n_flights))
        for signal in signals
    ]


def signal_means(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean over the flights; `gross_share` is that of errors above GROSS_MS."""
    runs = answered(runs)
    measured = runs.drop(columns=["cell", "status", "reason", "flight", "seed"], errors="ignore")
    measured["gross_share"] = (runs["error_ms"] > GROSS_MS).astype(float)
    groups = measured.groupby(["source", "scene", "duration_s", "signal", "angle_deg"], sort=False)
    table = groups.mean(numeric_only=True).rename(columns={"error_ms": "error_ms_mean"})
    table.insert(0, "flights", groups.size())
    table.insert(2, "error_ms_std", groups["error_ms"].std(ddof=0))
    return table.reset_index()


_CORRELATIONS = (
    ("speed across the line of sight (model)", MODELLED, "speed", "at_truth"),
    ("1 / distance squared (model)", MODELLED, "distance", "at_truth"),
    ("event rate (model)", MODELLED, RATE, "at_truth"),
    ("event rate, rendered: `zncc_e`", RENDERED, ZNCC_E, "at_truth"),
    ("mean brightness of a frame: `zncc_f`", RENDERED, ZNCC_F, "at_truth"),
    ("change from frame to frame", RENDERED, CHANGES, "at_truth"),
    ("highest value elsewhere (event rate, model)", MODELLED, RATE, "elsewhere"),
)
_ANGLE_HEADER = [f"{angle:g} deg" for angle in ANGLES_DEG]


def correlation_table(results: Results) -> str:
    """Correlation of the two views at the true lag, default scene, 20 s."""
    rows = [
        [words, *(f"{value:.2f}" for value in _by_angle(results, source, signal, column))]
        for words, source, signal, column in _CORRELATIONS
    ]
    return markdown_table(["", *_ANGLE_HEADER], rows)


def frames_table(results: Results) -> str:
    """Lay out errors and their deviations of what ZNCC_F may take of a frame, over 20 s."""
    of = results.rows("comparison", quantity="zncc_f_t_d_error_ms", duration_s=RENDERED_S)
    published = of.groupby("angle_deg")[["published_mean", "published_std"]].mean()
    found: dict[str, Iterable[Any]] = {"paper, ZNCC_F": published.itertuples(index=False)}
    for words, source, signal in (
        ("1 / distance squared (model)", MODELLED, "distance"),
        ("mean brightness: `zncc_f`", RENDERED, ZNCC_F),
        ("change from frame to frame", RENDERED, CHANGES),
    ):
        columns = ("error_ms_mean", "error_ms_std")
        found[words] = zip(*(_by_angle(results, source, signal, c) for c in columns), strict=True)
    rows = [
        [words, *(f"{mean:.0f} ({std:.0f})" for mean, std in errors)]
        for words, errors in found.items()
    ]
    return markdown_table(["mean error (deviation) [ms]", *_ANGLE_HEADER], rows)


def _by_angle(results: Results, source: str, signal: str, column: str) -> Array:
    of = {"source": source, "signal": signal, "scene": DEFAULT, "duration_s": RENDERED_S}
    return results.column("zncc", column, **of)


STUDIES = (
    Study(
        "zncc",
        "What the signals of two views share",
        signal_cells,
        Measure(load_flight, signal_row, SignalRow),
        Runs("zncc_runs.csv", ("source", "scene", "duration_s", "angle_deg", "flight", "signal")),
        (made_of("zncc.csv", signal_means, "zncc_runs"),),
        numbers={"table.zncc.correlation": correlation_table, "table.zncc.frames": frames_table},
        config={"scenes": SCENES, "first_flight": FIRST_FLIGHT, "n_rendered": N_RENDERED,
                "n_modelled": N_MODELLED},
    ),
)  # fmt: skip
