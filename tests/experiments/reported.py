"""Inputs for tests of the report: results with made-up numbers, a recording without OpenGL."""

import json
from functools import cache
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from experiments.lab.code import ROOT
from experiments.lab.grid import config_names, flight_seed
from experiments.lab.recorded import FlightTruth, Pair
from experiments.lab.results import csv_text
from experiments.paper.comparison import comparison_table, load_published
from experiments.paper.esim import KEY, esim_tables, ordered_runs
from sim.recording import Scene as SimScene
from ssac.arrays import Array
from ssac.clock import Clock
from ssac.estimate import Estimate
from ssac.pipeline.registry import OURS
from ssac.track.observation import Observation
from tests.recorded import record
from tests.ssac.synthetic import Scene, make_events, make_scene

RESULTS = ROOT / "results"  # as committed
METHODS = tuple(method.name for method in OURS)
FIGURES = ("fig3_preprocessing", "fig4_epipolar", "fig5_d_avg", "error_vs_angle", "beyond_paper",
           "success", "efficiency")  # fmt: skip
PROVENANCE = {
    "command": "ssac tables", "config": {"title": "made up"}, "wall_time_s": 12.5,
    "commit": "0123456789ab", "versions": {"numpy": "2.2.6"}, "recordings_simulated": 3,
    "gl": {"backend": "osmesa", "renderer": "llvmpipe", "version": "4.5"},
}  # fmt: skip


def made_up_runs(methods: tuple[str, ...] = METHODS, flights: int = 10) -> pd.DataFrame:
    """Return one row per run of both tables: errors grow with the angle, a few runs fail."""
    rng = np.random.default_rng(0)
    angles_deg, t_ds_ms = (30.0, 60.0, 90.0, 120.0, 150.0), (5.0, 50.0, 500.0)
    runs = pd.DataFrame(product((10.0, 20.0), angles_deg, t_ds_ms, range(flights), methods),
                        columns=KEY)  # fmt: skip
    n, by_rates = len(runs), runs["method"].str.startswith(("zncc", "event"))
    failed = runs["method"].isin(["albl", "zncc_f"]) & (rng.random(n) < 0.06)
    has_pose = ~failed & ~by_rates & ~runs["method"].str.endswith("-known")
    of_tracks = np.where(runs["duration_s"] < 15.0, 0.3, 0.15)
    scale = np.where(by_rates, 10.0 + (runs["angle_deg"] / 20.0) ** 3, of_tracks)
    error_ms = np.where(failed, np.nan, scale * rng.gamma(2.0, 0.5, n))
    flown = zip(runs["duration_s"], runs["angle_deg"], runs["flight"], strict=True)
    made_up = runs.assign(
        seed=[flight_seed(*one) for one in flown],
        status=np.where(failed, "search_bound", "ok"),
        reason=np.where(failed, "the best offset bounds the search", ""),
        t_d_estimate_ms=runs["t_d_ms"] + error_ms,
        t_d_error_ms=error_ms,
        r_error_deg=np.where(has_pose, rng.gamma(2.0, 0.15, n), np.nan),
        t_error_deg=np.where(has_pose, rng.gamma(2.0, 0.1, n), np.nan),
        n_samples=350, d_avg_px=0.4, n_events_cam1=1_000_000, n_events_cam2=1_100_000,
    )  # fmt: skip
    return ordered_runs(made_up)


def write_results(folder: Path, runs: pd.DataFrame) -> None:
    tables = esim_tables(runs)
    written = {f"esim_{duration_s:g}": table for duration_s, table in tables.items()}
    written |= {"runs": runs, "comparison": comparison_table(tables, load_published())}
    for name, table in written.items():
        (folder / f"{name}.csv").write_text(csv_text(table))
    for name in (*FIGURES, *config_names("ablation_")):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((30, 60, 3), 200, np.uint8))
    (folder / "esim_20.provenance.json").write_text(json.dumps(PROVENANCE))


def record_flight(folder: Path, duration_s: float = 10.0) -> None:
    """Write a recording as `sim.storage` does, without an offset."""
    scene = record(folder, duration_s, t_d_s=0.0, has_frames=False).scene
    write_truth(folder / "truth.json", scene)


def write_truth(path: Path, scene: Scene, n_times: int = 2001) -> None:
    """Write the truth without an offset, in camera 1's frame, and without the drone's images."""
    times_s = np.linspace(0.0, scene.duration_s, n_times)
    unseen, poses = [[None, None]] * n_times, {"cam1": np.eye(4), "cam2": scene.rig.T_2_1}
    truth = {
        "R": scene.R, "t": scene.t / np.linalg.norm(scene.t), "times_s": times_s,
        "cameras": {name: {"T_C_W": pose, "drone_px": unseen} for name, pose in poses.items()},
        "drone_position_W_m": scene.path(times_s),
        "drone_quaternion_W_B_xyzw": [[0.0, 0.0, 0.0, 1.0]] * n_times,
        **{"baseline_m": 1.0, "t_d_s": 0.0, "skew_ppm": 0.0, "t_ref_s": 0.0},
    }  # fmt: skip
    path.write_text(json.dumps(truth, default=np.ndarray.tolist))


def true_flight(scene: SimScene, times_s: Array, clock: Clock) -> FlightTruth:
    """Return the truth of a scene as it would be read of its recording, which is not simulated."""
    poses, cameras = scene.trajectory.poses(times_s), scene.rig.cameras
    return FlightTruth(
        times_s, poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat(),
        tuple(camera.project(poses[:, :3, 3]) for camera in cameras),
        tuple(camera.T_C_W for camera in cameras), *scene.rig.extrinsics(), clock,
    )  # fmt: skip


DURATION_S = 6.0
SCENE = make_scene(0, duration_s=DURATION_S)
T = SCENE.t / np.linalg.norm(SCENE.t)


def joint_estimate(error_s: float = 0.0, **values: object) -> Estimate:
    """Return a made-up estimate of `joint` for `SCENE`, where the true offset is 50 ms."""
    fields = {"t_d_std_s": 1e-3, "R": SCENE.R, "t": T, "covariance": np.diag([1e-6] + 5 * [1e-4])}
    return Estimate("joint", t_d_s=0.05 + error_s, **fields | values)


@cache
def flown(seed: int = 0) -> Pair:
    """Return a synthetic pair with a time offset of 0, and only the events during the flight."""
    both = make_events(make_scene(seed, duration_s=DURATION_S), seed, size_m=0.4)
    within = (one[(one["t"] >= 0) & (one["t"] < 1e6 * DURATION_S)] for one in both)
    return Pair(*map(Observation, within), SCENE.rig)
