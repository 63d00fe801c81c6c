"""Scenes and angles in, what the signals of two views share out: why ZNCC errs (docs/zncc.md).

Rendered flights give the real event rates and frames; a model of the event rate, which follows from
the trajectory alone, gives hundreds of flights, and its factors one by one.
"""

import time
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray

from experiments.run.bridge import observations, rig_of
from experiments.run.provenance import save_provenance
from experiments.scenes.scene import scene_figures
from sim.recording import SimConfig, simulate
from sim.render.gl_context import open_context
from sim.render.instants import SamplingConfig
from sim.scene.rig import Camera, look_at_rig
from sim.scene.trajectory import SplineConfig, Trajectory, random_spline
from ssac import Config, Estimate, Observation, SsacError, zncc_e, zncc_f
from ssac.baselines.correlation import Signal, binned, lags_of, zncc
from ssac.baselines.zncc_e import BIN_S
from ssac.baselines.zncc_f import FRAME_S
from ssac.files.whole_file import whole_file
from ssac.track.observation import prepare

Array = NDArray[np.float64]

ANGLES_DEG = (30.0, 60.0, 90.0, 120.0, 150.0)

_DEFAULT = SplineConfig()
SCENES = {
    "default": _DEFAULT,
    "flatter": replace(_DEFAULT, multiplier_xyz_m=(3.4, 3.4, 3.0)),
    "no turning": replace(_DEFAULT, multiplier_rot_rad=(0.0, 0.0, 0.0)),
    **{
        f"vertical {metres:g} m": replace(_DEFAULT, multiplier_xyz_m=(3.2, 3.2, metres))
        for metres in (3.0, 2.4, 1.8, 1.2)
    },
}
RENDERED = {"default": ANGLES_DEG, "flatter": ANGLES_DEG, "no turning": (90.0,)}
THRICE = ("default", 90.0)  # with twice as many flights besides: where ten tell too little
MODELLED = [scene for scene in SCENES if scene != "no turning"]  # the model does not turn either
RENDERED_S = 20.0
MODELLED_S = (10.0, 20.0)

BINS_S = (0.005, 0.020, 0.050)  # of the event rate, beside the 10 ms of ZNCC_E
GROSS_MS = 100.0  # a larger error is another peak of the correlation, not the true one read badly
ELSEWHERE_S = 0.2  # further from the true lag than this, the true peak has fallen off
DRONE_SIZE_M = 0.65
MAX_STEP_PX = 1.0  # four times the default: a third of the time, correlations within 0.02 the same


@dataclass(frozen=True)
class Agreement:
    """How two signals correlate, the true lag being zero."""

    error_ms: float  # of the lag with the highest correlation
    at_truth: float  # correlation at the true lag
    elsewhere: float  # highest correlation at other lags


def zncc_study_command(
    flights: Annotated[int, typer.Option(help="Rendered at each scene and angle.")] = 10,
    modelled: Annotated[int, typer.Option(help="Flights of the model, at each scene.")] = 100,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 2,
    out: Annotated[Path, typer.Option(help="CSV to write.")] = Path("results/zncc_study.csv"),
) -> None:
    """Measure what event rates and frames of two views share, by angle, scene and factor."""
    start = time.perf_counter()
    parallel = joblib.Parallel(n_jobs=jobs, return_as="generator")
    cells = [
        (scene, angle_deg, seed)
        for scene, angles_deg in RENDERED.items()
        for angle_deg in angles_deg
        for seed in range(3 * flights if (scene, angle_deg) == THRICE else flights)
    ]
    rows: list[dict[str, Any]] = []
    rendered = parallel(joblib.delayed(rendered_rows)(*cell) for cell in cells)
    for done, ((_, _, seed), part) in enumerate(zip(cells, rendered, strict=True), 1):
        source = "rendered" if seed < flights else "rendered, further flights"
        rows += [{**row, "source": source} for row in part]
        typer.echo(f"flight {done} of {len(cells)}", err=True)
    flown = product(MODELLED, MODELLED_S, range(modelled))
    for part in parallel(joblib.delayed(modelled_rows)(*cell) for cell in flown):
        rows += part
    table = means(rows)
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as temporary:
        table.to_csv(temporary, index=False, float_format="%.4g")
    command = f"ssac zncc-study --flights {flights} --modelled {modelled}"
    save_provenance(out, command, SCENES, time.perf_counter() - start, open_context())
    typer.echo(overview(table))


def overview(table: pd.DataFrame) -> str:
    """Lay the mean errors [ms] out, angles across, with the correlation at the true lag."""
    cells = [
        f"{error_ms:.0f} ({correlation:+.2f})"
        for error_ms, correlation in zip(table["error_ms_mean"], table["at_truth"], strict=True)
    ]
    names = ["source", "duration_s", "scene", "signal"]
    wide = table.assign(cell=cells).pivot(index=names, columns="angle_deg", values="cell")
    return str(wide.fillna("").to_string())


def rendered_rows(scene: str, angle_deg: float, seed: int) -> list[dict[str, Any]]:
    """Simulate a flight and correlate what its two cameras recorded, in several ways."""
    config = SimConfig(
        angle_deg=angle_deg,
        spline=replace(SCENES[scene], duration_s=RENDERED_S),
        sampling=SamplingConfig(max_step_px=MAX_STEP_PX),
    )
    recording = simulate(config, seed)
    raw, rig = observations(recording), rig_of(recording)
    cam1, cam2 = prepare(*raw, rig)
    found = {
        "zncc_e": of_estimate(zncc_e(cam1, cam2, rig, Config())),
        "zncc_f": of_estimate(zncc_f(cam1, cam2, rig, Config())),
        "zncc_e, raw events": of_estimate(zncc_e(*raw, rig, Config(denoise=False))),
    }
    changes = [_frame_changes(camera) for camera in raw]
    found["frame changes"] = agreement(changes[0], changes[1], FRAME_S)
    for bin_s in BINS_S:
        rates = [binned(camera.events["t"] * 1e-6, None, bin_s) for camera in (cam1, cam2)]
        found[f"zncc_e, bins of {1e3 * bin_s:g} ms"] = agreement(rates[0], rates[1], bin_s)
    rows = [
        _row("rendered", scene, RENDERED_S, signal, angle_deg, values)
        for signal, values in found.items()
    ]
    model = modelled_signals(_flight(scene, RENDERED_S, seed), recording.rig.cameras[1])
    rate = binned(cam2.events["t"] * 1e-6, None, BIN_S)
    rows[0]["model_fit"] = zncc(rate, model["rate"], np.zeros(1, np.int64))[0]
    if angle_deg == SimConfig.angle_deg:  # at which the authors' sample is known
        figures = scene_figures(recording)
        rows[0]["speed_px_s"], rows[0]["n_valid"] = figures.speed_px_s, figures.n_valid
        rows[0]["slope_px"] = figures.slope_px
    return rows


def modelled_rows(scene: str, duration_s: float, seed: int) -> list[dict[str, Any]]:
    """Correlate the modelled event rate, and its factors, of one flight at all angles."""
    trajectory = _flight(scene, duration_s, seed)
    first, *others = (
        modelled_signals(trajectory, camera) for camera in look_at_rig((0.0, *ANGLES_DEG)).cameras
    )
    return [
        _row("modelled", scene, duration_s, signal, angle_deg,
             agreement(first[signal], other[signal], BIN_S))
        for angle_deg, other in zip(ANGLES_DEG, others, strict=True)
        for signal in first
        if signal == "rate" or scene == "default"
    ]  # fmt: skip


def modelled_signals(trajectory: Trajectory, camera: Camera) -> dict[str, Signal]:
    """Model a camera's event rate: the drone's outline sweeps over pixels.

    Returns
    -------
    dict of Signal
        In bins of `BIN_S`, each in a unit of its own: "rate", the drone's image speed times its
        image's width times the share of it in the image; and two factors that make up the rate,
        "speed", of the drone across the line of sight, and "distance", one over its square.
    """
    n = int(trajectory.duration_s / BIN_S)
    times_s = BIN_S * (np.arange(n, dtype=np.float64) + 0.5)
    points = trajectory.position(times_s)
    velocity: Array = np.gradient(points, BIN_S, axis=0)
    to_drone = points - np.linalg.inv(camera.T_C_W)[:3, 3]
    distance_m = np.linalg.norm(to_drone, axis=1)
    closing = np.sum(velocity * to_drone, axis=1) / distance_m
    pixels = camera.project(points)
    width_px = camera.K[0, 0] * DRONE_SIZE_M / distance_m
    inside = np.ones(n)
    for position, size in zip(pixels.T, (camera.width, camera.height), strict=True):
        low, high = position - width_px / 2, position + width_px / 2
        inside *= np.clip((np.minimum(high, size) - np.maximum(low, 0.0)) / width_px, 0.0, 1.0)
    image_speed = np.linalg.norm(np.gradient(pixels, BIN_S, axis=0), axis=1)
    return {
        "rate": Signal(0, np.nan_to_num(image_speed * width_px * inside)),
        "speed": Signal(0, np.sqrt(np.maximum(np.sum(velocity**2, axis=1) - closing**2, 0.0))),
        "distance": Signal(0, distance_m**-2),
    }


def agreement(signal1: Signal, signal2: Signal, bin_s: float) -> Agreement:
    """Correlate two signals over lags of +-1 s."""
    lags = lags_of(Config(), bin_s)
    return _agreement(bin_s * lags.astype(np.float64), zncc(signal1, signal2, lags))


def of_estimate(estimate: Estimate) -> Agreement:
    """Read the correlation at the true lag, and beside it, off a method's cost curve."""
    return _agreement(estimate.candidates_s, -estimate.costs)


def means(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """Mean over the flights; `gross_share` is that of errors above GROSS_MS."""
    runs = pd.DataFrame(rows)
    runs["gross_share"] = (runs["error_ms"] > GROSS_MS).astype(float)
    groups = runs.groupby(["source", "scene", "duration_s", "signal", "angle_deg"], sort=False)
    table = groups.mean(numeric_only=True)
    table.insert(0, "flights", groups.size())
    table.insert(2, "error_ms_std", groups["error_ms"].std(ddof=0))
    result: pd.DataFrame = table.rename(columns={"error_ms": "error_ms_mean"}).reset_index()
    return result


def _flight(scene: str, duration_s: float, seed: int) -> Trajectory:
    """Draw the trajectory that `simulate` flies with this seed."""
    stream = np.random.SeedSequence(seed, spawn_key=(0,))
    return random_spline(
        replace(SCENES[scene], duration_s=duration_s), np.random.default_rng(stream)
    )


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


def _row(
    source: str, scene: str, duration_s: float, signal: str, angle_deg: float, found: Agreement
) -> dict[str, Any]:
    return {
        "source": source, "scene": scene, "duration_s": duration_s, "signal": signal,
        "angle_deg": angle_deg, **vars(found),
    }  # fmt: skip
