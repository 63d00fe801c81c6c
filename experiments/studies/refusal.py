"""Flights that leave something open in, what each method says of them out (docs/refusal.md).

A method may refuse, in whole or in part; what it must not do is to give a confident wrong answer.
The seeds are those of no table, and no threshold was set on them.
"""

import time
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
import pandas as pd
import typer

from experiments.run.provenance import save_provenance
from experiments.run.score import score
from experiments.studies.refusal_flights import (
    KINDS_OF_FLIGHT,
    OTHER_FLIGHT,
    RefusalCase,
    flight_of,
    refusal_case,
)
from sim.render.gl_context import open_context
from ssac.estimate import Estimate
from ssac.files.whole_file import whole_file
from ssac.tool.registry import METHODS, Chain
from ssac.track.observation import prepare

METHOD_NAMES = ("ssac", "joint", "tangency", "ssac-known", "joint-known", "tangency-known")
ANGLES_DEG = (30.0, 60.0, 90.0, 120.0, 150.0)
FIRST_SEED = 1000

MAX_SIGMAS = 5.0
"""A larger error, with status "ok", is a confident wrong answer."""

MAX_ERROR_MS, MAX_ERROR_DEG = 5.0, 5.0
"""The same for methods that state no deviation."""

_LISTED_MS = 10.0  # a listed offset is the true one when it is as near


def refusal_command(
    seeds: Annotated[int, typer.Option(help="Flights of each kind.")] = 12,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 2,
    first_seed: Annotated[int, typer.Option(help="Of the flights.")] = FIRST_SEED,
    out: Annotated[Path, typer.Option(help="Folder for the tables.")] = Path("results"),
) -> None:
    """Run all methods on flights that leave offset or pose open, and count what they say."""
    start = time.perf_counter()
    flights = list(KINDS_OF_FLIGHT)
    tasks = [
        (flight, seed, ANGLES_DEG[(2 * seed + number) % len(ANGLES_DEG)])
        for seed in range(first_seed, first_seed + seeds)
        for number, flight in enumerate(flights)
    ]
    results = joblib.Parallel(n_jobs=jobs, return_as="generator")(
        joblib.delayed(refusal_rows)(*task) for task in tasks
    )
    rows: list[dict[str, Any]] = []
    for done, part in enumerate(results, 1):
        rows += part
        typer.echo(f"flight {done} of {len(tasks)}", err=True)
    runs = pd.DataFrame(rows)
    table = refusal_table(runs)
    out.mkdir(parents=True, exist_ok=True)
    command = f"ssac refusal --seeds {seeds}"
    if first_seed != FIRST_SEED:
        command += f" --first-seed {first_seed}"
    config = {"seeds": seeds, "first_seed": first_seed, "angles_deg": ANGLES_DEG}
    for name, content in (("refusal_runs.csv", runs), ("refusal.csv", table)):
        with whole_file(out / name) as temporary:
            content.to_csv(temporary, index=False, float_format="%.4g")
        wall_time_s = time.perf_counter() - start
        save_provenance(out / name, command, config, wall_time_s, open_context())
    typer.echo(table.to_string(index=False, float_format=lambda value: f"{value:.3g}"))
    typer.echo(f"{int(runs['confident_wrong'].sum())} confident wrong answers in {len(runs)} runs")


def refusal_rows(flight: str, seed: int, angle_deg: float) -> list[dict[str, Any]]:
    """Simulate one flight, and run all methods on all kinds that are made of it."""
    recording = flight_of(flight, seed, angle_deg)
    kinds = KINDS_OF_FLIGHT[flight]
    other = flight_of(flight, seed + OTHER_FLIGHT, angle_deg) if len(kinds) > 2 else None
    rows = []
    for kind in kinds:
        case = refusal_case(kind, recording, other)
        estimates = estimates_of(case)
        rows += [
            {"kind": kind, "seed": seed, "angle_deg": angle_deg, **judged(estimates[name], case)}
            for name in METHOD_NAMES
        ]
    return rows


def estimates_of(case: RefusalCase) -> dict[str, Estimate]:
    """Run the methods, those that refine another's estimate after that one."""
    cam1, cam2 = prepare(case.cam1, case.cam2, case.rig, case.config)
    chain = Chain(cam1, cam2, case.rig, case.config)
    return {name: chain.estimate(name) for name in METHOD_NAMES}


def judged(estimate: Estimate, case: RefusalCase) -> dict[str, Any]:
    """One row: what was said, its errors, and whether it is a confident wrong answer."""
    errors = score(estimate, case.t_d_s, case.R, case.t)
    t_d_std_ms = 1e3 * estimate.t_d_std_s
    gives_pose = not METHODS[estimate.method].needs_extrinsics and estimate.R is not None
    r_std_deg = estimate.r_std_deg if gives_pose else np.nan
    t_std_deg = estimate.t_std_deg if gives_pose else np.nan
    pairs = [(errors.t_d_error_ms, t_d_std_ms, MAX_ERROR_MS)]
    if gives_pose:
        pairs.append((errors.r_error_deg, r_std_deg, MAX_ERROR_DEG))
        pairs.append((errors.t_error_deg, t_std_deg, MAX_ERROR_DEG))
    sigmas = [error / std for error, std, _ in pairs if np.isfinite(std)]
    if sigmas:
        is_wrong = estimate.has_offset and not max(sigmas) <= MAX_SIGMAS
    else:
        is_wrong = estimate.status == "ok" and not all(error <= most for error, _, most in pairs)
    offsets_s = np.append(estimate.alternatives_s, estimate.t_d_s)
    listed = np.abs(offsets_s - case.t_d_s) < 1e-3 * _LISTED_MS
    return {
        "method": estimate.method,
        "status": estimate.status,
        "reason": estimate.reason,
        "offset_given": estimate.has_offset,
        "pose_given": estimate.status == "ok" and gives_pose,
        "alternatives": len(estimate.alternatives_s),
        "truth_among_offsets": bool(listed.any()),
        "t_d_error_ms": errors.t_d_error_ms,
        "r_error_deg": errors.r_error_deg if gives_pose else np.nan,
        "t_error_deg": errors.t_error_deg if gives_pose else np.nan,
        "t_d_std_ms": t_d_std_ms,
        "r_std_deg": r_std_deg,
        "t_std_deg": t_std_deg,
        "error_sigmas": max(sigmas, default=np.nan),
        "confident_wrong": bool(is_wrong),
    }


def refusal_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Count what each method says of each kind.

    Parameters
    ----------
    runs
        One row per flight, kind and method, from `refusal_rows`.

    Returns
    -------
    pd.DataFrame
        One row per kind and method, in their order: runs, `statuses` with their counts, how often
        the offset and the pose were given, how often the true offset is the one given or one of the
        alternatives, the largest error of what was given (t_d in ms, and in stated deviations of
        any of t_d, R and t), and the confident wrong answers.
    """
    rows = []
    for (kind, method), group in runs.groupby(["kind", "method"], sort=False):
        given = group[group["offset_given"]]
        counts = group["status"].value_counts()
        rows.append(
            {
                "kind": kind,
                "method": method,
                "runs": len(group),
                "statuses": " ".join(f"{status}:{count}" for status, count in counts.items()),
                "offset_given": len(given),
                "pose_given": int(group["pose_given"].sum()),
                "truth_among_offsets": int(group["truth_among_offsets"].sum()),
                "t_d_error_ms_worst": given["t_d_error_ms"].max(),
                "error_sigmas_worst": given["error_sigmas"].max(),
                "confident_wrong": int(group["confident_wrong"].sum()),
            }
        )
    table: pd.DataFrame = pd.DataFrame(rows)
    return table
