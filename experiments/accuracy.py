"""Methods on simulated flights in, their mean errors by angle out: `ssac accuracy`."""

import time
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
import pandas as pd
import typer

from experiments.bridge import observations, rig_of
from experiments.methods import METHODS
from experiments.provenance import save_provenance
from experiments.score import score
from sim.frames import FrameConfig
from sim.gl_context import open_context
from sim.recording import SimConfig, simulate
from ssac.interface import Config, prepare
from ssac.whole_file import whole_file

ANGLES_DEG = (30.0, 60.0, 90.0, 120.0, 150.0)
COMPARED = ("ssac", "joint", "ssac-known", "joint-known", "albl", "zncc_e", "event_rate")
ERRORS = ("t_d_error_ms", "r_error_deg", "t_error_deg")


@dataclass(frozen=True)
class Mark:
    """A mean error to stay below, at every angle."""

    method: str
    error: str
    bound: float | str  # in the error's unit, or the method whose mean is to be undercut


MARKS = (
    Mark("ssac", "t_d_error_ms", 0.6),
    Mark("ssac", "r_error_deg", 0.8),
    Mark("ssac", "t_error_deg", 0.6),
    Mark("joint", "r_error_deg", "ssac"),
    Mark("joint", "t_error_deg", "ssac"),
)


def accuracy_command(
    seeds: Annotated[int, typer.Option(help="Flights at each angle.")] = 10,
    duration: Annotated[float, typer.Option(help="Of a flight [s].")] = 20.0,
    t_d: Annotated[float, typer.Option(help="Offset: t_cam2 = t_cam1 + t_d [s].")] = 0.05,
    angle: Annotated[
        list[float] | None,
        typer.Option(help="Between the lines of sight [deg]; may be repeated.  [default: all]"),
    ] = None,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 2,
    out: Annotated[
        Path, typer.Option(help="CSV of means to write; one row per run goes to <name>_runs.csv.")
    ] = Path("results/accuracy.csv"),
) -> None:
    """Run all methods for event cameras on simulated flights, and print their mean errors."""
    start = time.perf_counter()
    angles = tuple(angle or ANGLES_DEG)
    config = SimConfig(
        t_d_s=t_d,
        spline=replace(SimConfig().spline, duration_s=duration),
        frames=FrameConfig(rate_hz=0.0),
    )
    cells = list(product(angles, range(seeds)))
    results = joblib.Parallel(n_jobs=jobs, return_as="generator")(
        joblib.delayed(accuracy_rows)(replace(config, angle_deg=angle_deg), seed)
        for angle_deg, seed in cells
    )
    rows: list[dict[str, Any]] = []
    for (angle_deg, seed), cell in zip(cells, results, strict=True):
        rows += cell
        typer.echo(f"{angle_deg:g} deg, flight {seed + 1} of {seeds}", err=True)
    runs = pd.DataFrame(rows)
    means = mean_errors(runs)
    out.parent.mkdir(parents=True, exist_ok=True)
    runs_file = out.with_name(f"{out.stem}_runs{out.suffix}")
    for path, table in ((runs_file, runs), (out, means)):
        with whole_file(path) as temporary:
            table.to_csv(temporary, index=False, float_format="%.6g")
    command = f"ssac accuracy --seeds {seeds} --duration {duration:g} --t-d {t_d:g}"
    command += "".join(f" --angle {value:g}" for value in angle or ())
    save_provenance(out, command, config, time.perf_counter() - start, open_context())
    typer.echo(markdown_table(means))
    typer.echo("\n" + "\n".join(verdicts(means)))


def accuracy_rows(config: SimConfig, seed: int) -> list[dict[str, Any]]:
    """Simulate one flight, and run each method on its events, prepared once for all of them."""
    recording = simulate(config, seed)
    truth = recording.truth
    cam1, cam2 = prepare(*observations(recording), rig_of(recording), Config())
    rows = []
    for name in COMPARED:
        method = METHODS[name]
        rig = rig_of(recording, with_extrinsics=method.needs_extrinsics)
        estimate = method.estimate(cam1, cam2, rig, Config())
        errors = score(estimate, truth.t_d_s, truth.R, truth.t)
        rows.append(
            {
                "angle_deg": config.angle_deg,
                "seed": seed,
                "method": name,
                "status": estimate.status,
                "t_d_error_ms": errors.t_d_error_ms,
                # A pose that was given has no error to speak of.
                "r_error_deg": np.nan if method.needs_extrinsics else errors.r_error_deg,
                "t_error_deg": np.nan if method.needs_extrinsics else errors.t_error_deg,
                "t_d_ms": 1e3 * estimate.t_d_s,
                "t_d_std_ms": 1e3 * estimate.t_d_std_s,
                "n_samples": estimate.n_samples,
                "d_avg_px": estimate.d_avg_px,
            }
        )
    return rows


def mean_errors(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean and standard deviation of each error by angle and method, and how many runs failed.

    A run fails when its status is not "ok"; its errors do not enter the means.
    """
    rows = []
    for (angle_deg, method), group in runs.groupby(["angle_deg", "method"], sort=False):
        row: dict[str, Any] = {"angle_deg": angle_deg, "method": method, "runs": len(group)}
        row["failures"] = int((group["status"] != "ok").sum())
        usable = group[group["status"] == "ok"]
        for error in ERRORS:
            row[error] = usable[error].mean()
            row[f"{error}_std"] = usable[error].std(ddof=0)
        rows.append(row)
    means: pd.DataFrame = pd.DataFrame(rows)
    return means


def markdown_table(means: pd.DataFrame) -> str:
    """Lay the mean errors out for the README, methods down and angles across."""
    angles = list(dict.fromkeys(means["angle_deg"]))
    lines = [
        "| t_d [ms] / R [deg] / t [deg] | " + " | ".join(f"{a:g} deg" for a in angles) + " |",
        "|---" * (len(angles) + 1) + "|",
    ]
    for method in dict.fromkeys(means["method"]):
        cells = [_cell(_row(means, angle_deg, method)) for angle_deg in angles]
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def verdicts(means: pd.DataFrame) -> list[str]:
    """Say of each mark whether it is met at every angle."""
    lines = []
    for mark in MARKS:
        missed = []
        for angle_deg in dict.fromkeys(means["angle_deg"]):
            value = float(_row(means, angle_deg, mark.method)[mark.error])
            bound = mark.bound
            if isinstance(bound, str):
                bound = float(_row(means, angle_deg, bound)[mark.error])
            if not value <= bound:
                missed.append(f"{value:.2f} instead of {bound:.2f} at {angle_deg:g} deg")
        lines.append(
            f"{mark.method}: {mark.error} below {mark.bound}: "
            + (f"misses: {', '.join(missed)}" if missed else "meets")
        )
    return lines


def _row(means: pd.DataFrame, angle_deg: float, method: str) -> dict[str, Any]:
    """Return the only row of an angle and a method."""
    chosen = means[(means["angle_deg"] == angle_deg) & (means["method"] == method)]
    return {str(key): value for key, value in chosen.iloc[0].items()}


def _cell(row: dict[str, Any]) -> str:
    """Show the errors that a method gives, and its failures."""
    errors = [f"{row[error]:.3g}" for error in ERRORS if np.isfinite(row[error])]
    failed = f" ({row['failures']} of {row['runs']} failed)" if row["failures"] else ""
    return (" / ".join(errors) or "-") + failed
