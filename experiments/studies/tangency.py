"""Variants of the method `tangency` on flights in, their errors and a figure of them out.

docs/tangency.md reads them.
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
from matplotlib.figure import Figure

from experiments.figures.style import WIDTH_IN, method_looks, quiet_axes, save_png
from experiments.run.bridge import observations, rig_of
from experiments.run.provenance import save_provenance
from experiments.run.score import score
from sim.recording import SimConfig, Truth, simulate
from sim.render.gl_context import open_context
from sim.sensor.frames import FrameConfig
from ssac import Estimate, prepare
from ssac.files.whole_file import whole_file
from ssac.methods.algorithms import algorithm_2
from ssac.methods.joint import joint_from
from ssac.methods.tangency import TangencyConfig, refine_tangents
from ssac.search.two_views import two_views
from ssac.track.outline import OutlineConfig

ANGLES_DEG = (30.0, 60.0, 90.0, 120.0, 150.0)
FIRST_SEED = 100
T_D_S = 0.05


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


def tangency_study_command(
    seeds: Annotated[int, typer.Option(help="Flights at each angle.")] = 6,
    duration: Annotated[float, typer.Option(help="Of a flight [s].")] = 10.0,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 2,
    out: Annotated[Path, typer.Option(help="CSV to write.")] = Path("results/tangency_study.csv"),
    figure: Annotated[Path, typer.Option(help="PNG to write.")] = Path(
        "results/tangency_study.png"
    ),
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
    figure.parent.mkdir(parents=True, exist_ok=True)
    save_png(study_figure(table), figure)
    typer.echo(table.to_string(index=False, float_format=lambda value: f"{value:.3g}"))


def variant_rows(config: SimConfig, seed: int) -> list[dict[str, Any]]:
    """Simulate one flight, and run the joint refinement and all variants on its events."""
    recording = simulate(config, seed)
    rig, truth = rig_of(recording), recording.truth
    cam1, cam2 = prepare(*observations(recording), rig)
    views = two_views(cam1, cam2, rig)
    start = joint_from(algorithm_2(views), views)
    rows = [_row("joint", config.angle_deg, start, truth, 0.0)]
    for name, variant in VARIANTS.items():
        started = time.process_time()
        estimate = refine_tangents(start, views, variant)
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


def study_figure(means: pd.DataFrame) -> Figure:
    """Draw the variants' errors of t_d and R, from `variant_means`, one line each.

    A bar is the mean over all flights, a tick t_d's mean at the worst angle; the method as it is
    comes first, in black, and its mean is the dotted line. `joint` is left out: it is far off.
    """
    variants = means[means["variant"] != "joint"]
    as_it_is = variants["variant"] == AS_IT_IS
    colors = [method_looks(["tangency"])["tangency"].color if it else "0.65" for it in as_it_is]
    lines = np.arange(len(variants))
    figure = Figure(figsize=(WIDTH_IN, 0.8 + 0.22 * len(variants)), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    labels = {"t_d_error_ms": "error of $t_d$ [ms]", "r_error_deg": "error of R [deg]"}
    for ax, (column, label) in zip(axes, labels.items(), strict=True):
        quiet_axes(ax)
        ax.grid(visible=False)
        ax.barh(lines, variants[column], color=colors, height=0.7)
        ax.axvline(float(variants.loc[as_it_is, column].iloc[0]), color="0.3", lw=0.8, ls=":")
        ax.set_xlabel(label, fontsize=9)
    axes[0].plot(variants["t_d_error_ms_worst"], lines, "|", color="#D55E00", ms=9, mew=1.5)
    axes[0].set_yticks(lines, variants["variant"], fontsize=8)
    axes[0].invert_yaxis()
    return figure
