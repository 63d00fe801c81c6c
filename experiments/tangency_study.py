"""Variants of the method `tangency` on simulated flights in, their errors out (docs/tangency.md).

All variants see the same flights and start from the same joint refinement. The seeds are not those
of the tables, so that nothing is tuned on what is reported there.
"""

import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
import pandas as pd
import typer

from experiments.bridge import observations, rig_of
from experiments.provenance import save_provenance
from experiments.score import score
from sim.frames import FrameConfig
from sim.gl_context import open_context
from sim.recording import SimConfig, Truth, simulate
from ssac import Estimate, prepare
from ssac.estimate import ssac
from ssac.interface import Config, object_motions
from ssac.outline import OutlineConfig
from ssac.refinement import joint_from
from ssac.tangency import TangencyConfig, refine_tangents
from ssac.whole_file import whole_file

ANGLES_DEG = (30.0, 60.0, 90.0, 120.0, 150.0)
FIRST_SEED = 100
T_D_S = 0.05


def _outline(**changes: Any) -> TangencyConfig:
    return TangencyConfig(outline=OutlineConfig(**changes))


VARIANTS = {
    "as it is": TangencyConfig(),
    "midway between the tangents": TangencyConfig(apart=False),
    "loss of 95 % efficiency": TangencyConfig(cauchy=2.385, wider_cauchy=2.385),
    "loss turns at 1": TangencyConfig(cauchy=1.0),
    "all pairs weigh alike": TangencyConfig(sharp_px=100.0),
    "not moved outward": _outline(outward=0.0),
    "moved outward by 0.8": _outline(outward=0.8),
    "extreme event itself": _outline(rank=0, outward=0.2),
    "rank 30": _outline(rank=30, deeper_rank=60),
    "moved by the track only, 20 ms": _outline(passes=0, rough_half_window_s=0.020),
    "moved by the track only, 10 ms": _outline(passes=0),
    "one pass": _outline(passes=1),
    "half-window 20 ms": _outline(half_window_s=0.020),
    "half-window 60 ms": _outline(half_window_s=0.060),
    "smoothed over 20 ms": _outline(smoothing_s=0.020),
    "smoothed over 60 ms": _outline(smoothing_s=0.060),
    "a sample every 5 ms": TangencyConfig(step_s=0.005),
    "a sample every 20 ms": TangencyConfig(step_s=0.020),
}


def tangency_study_command(
    seeds: Annotated[int, typer.Option(help="Flights at each angle.")] = 6,
    duration: Annotated[float, typer.Option(help="Of a flight [s].")] = 10.0,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 2,
    out: Annotated[Path, typer.Option(help="CSV to write.")] = Path("results/tangency_study.csv"),
) -> None:
    """Compare variants of the method `tangency` on flights that no table uses."""
    start = time.perf_counter()
    config = SimConfig(
        t_d_s=T_D_S,
        spline=replace(SimConfig().spline, duration_s=duration),
        frames=FrameConfig(rate_hz=0.0),
    )
    cells = list(product(range(FIRST_SEED, FIRST_SEED + seeds), ANGLES_DEG))
    results = joblib.Parallel(n_jobs=jobs, return_as="generator")(
        joblib.delayed(variant_rows)(replace(config, angle_deg=angle_deg), seed)
        for seed, angle_deg in cells
    )
    rows: list[dict[str, Any]] = []
    for done, part in enumerate(results, 1):
        rows += part
        typer.echo(f"flight {done} of {len(cells)}", err=True)
    table = variant_means(pd.DataFrame(rows))
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as temporary:
        table.to_csv(temporary, index=False, float_format="%.4g")
    command = f"ssac tangency-study --seeds {seeds} --duration {duration:g}"
    save_provenance(out, command, config, time.perf_counter() - start, open_context())
    typer.echo(table.to_string(index=False, float_format=lambda value: f"{value:.3g}"))


def variant_rows(config: SimConfig, seed: int) -> list[dict[str, Any]]:
    """Simulate one flight, and run the joint refinement and all variants on its events."""
    recording = simulate(config, seed)
    rig, truth = rig_of(recording), recording.truth
    cam1, cam2 = prepare(*observations(recording), rig)
    start = joint_from(ssac(cam1, cam2, rig), cam1, cam2, rig)
    motions = object_motions(cam1, cam2, rig, Config())
    rows = [_row("joint", config.angle_deg, start, truth, 0.0)]
    for name, variant in VARIANTS.items():
        started = time.process_time()
        estimate = refine_tangents(start, *motions, rig, config=variant)
        seconds = time.process_time() - started
        rows.append(_row(name, config.angle_deg, estimate, truth, seconds))
    return rows


def _row(
    variant: str, angle_deg: float, estimate: Estimate, truth: Truth, seconds: float
) -> dict[str, Any]:
    errors = score(estimate, truth.t_d_s, truth.R, truth.t)
    signed_ms = 1e3 * (estimate.t_d_s - truth.t_d_s)
    return {
        "variant": variant,
        "angle_deg": angle_deg,
        "failed": estimate.status != "ok",
        "t_d_error_ms": errors.t_d_error_ms,
        "r_error_deg": errors.r_error_deg,
        "t_error_deg": errors.t_error_deg,
        "t_d_bias_ms": signed_ms,
        "normalised": signed_ms / (1e3 * estimate.t_d_std_s),
        "seconds": seconds,
    }


def variant_means(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean errors of each variant, over all angles and with t_d's at the worst angle.

    Parameters
    ----------
    runs
        One row per flight and variant, from `variant_rows`.

    Returns
    -------
    pd.DataFrame
        One row per variant in their order: runs, failed, mean errors, `t_d_error_ms_worst` of
        the angles' means, `t_d_bias_ms`, the root mean square of t_d's error over its stated
        deviation, and the median processor time [s].
    """
    rows = []
    for variant, group in runs.groupby("variant", sort=False):
        good = group[~group["failed"]]
        rows.append(
            {
                "variant": variant,
                "runs": len(group),
                "failed": int(group["failed"].sum()),
                **good[["t_d_error_ms", "r_error_deg", "t_error_deg"]].mean(),
                "t_d_error_ms_worst": good.groupby("angle_deg")["t_d_error_ms"].mean().max(),
                "t_d_bias_ms": good["t_d_bias_ms"].mean(),
                "normalised_rms": float(np.sqrt(np.mean(np.square(good["normalised"])))),
                "seconds": good["seconds"].median(),
            }
        )
    means: pd.DataFrame = pd.DataFrame(rows)
    return means
