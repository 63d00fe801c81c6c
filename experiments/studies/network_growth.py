"""How time and memory grow with the flight that eight frame cameras see, solved all at once.

The cameras' tracks are projections of a random spline with noise: no events, and nothing is drawn.
Each flight is solved as `ssac sync` of its files does it, in a process of its own on one core,
after a short one that loads the kernels.
"""

import resource
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from experiments.lab.cell import Measure, PlainCell, RunRow, load_nothing
from experiments.lab.study import How, Runs, Study
from experiments.lab.verify import between, one_of
from sim.scene.rig import Rig, kalibr_yaml, look_at_rig
from sim.scene.trajectory import SplineConfig, random_spline
from ssac.arrays import Array
from ssac.clock import Clock
from ssac.estimate import Status
from ssac.files.track_files import save_track
from ssac.pipeline.api import sync
from ssac.pipeline.many import NetworkResult
from ssac.points import PointTrack

COMMAND = "ssac network"
N_CAMERAS = 8
FRAMES_HZ = 60.0
DURATIONS_S = (150.0, 300.0, 600.0)
NOISE_PX = 0.5
_DISTANCE_M, _FOCAL_PX = 35.0, 900.0
MARK_S, MARK_MB = 600.0, 4096.0  # of the longest flight
_SEED = 74_000
_SHORT_S = 20.0
_OFFSETS_S, _SKEWS_PPM = 20.0, 20.0  # of the clocks, at most and as a deviation
_SPLINE = SplineConfig(
    sampling_hz=1.0,
    segments_per_s=1.0,
    smoothing=2.0,  # s^3: turns within some seconds, at 5 m/s or so
    multiplier_xyz_m=(24.0, 24.0, 10.0),
    max_radius_m=20.0,
)


@dataclass(frozen=True)
class GrowthCell(PlainCell):
    """One flight."""

    duration_s: float
    cameras: int = N_CAMERAS


@dataclass(frozen=True)
class GrowthRow(RunRow):
    """What a flight took, the largest error of a clock, and the path's."""

    points: float = np.nan
    wall_s: float = np.nan
    cpu_s: float = np.nan
    pairs_s: float = np.nan
    network_s: float = np.nan
    peak_mb: float = np.nan
    t_d_error_ms: float = np.nan
    path_rmse_m: float = np.nan


def cells() -> list[GrowthCell]:
    """List the flights."""
    return [GrowthCell(duration_s) for duration_s in DURATIONS_S]


def growth_row(cell: GrowthCell, _: object) -> GrowthRow:
    """Solve a flight in this process."""
    with TemporaryDirectory() as name:
        short, whole = Path(name) / "short", Path(name) / "whole"
        for folder in (short, whole):
            folder.mkdir()
        files, clocks = write_tracks(whole, cell.duration_s)
        sync(write_tracks(short, _SHORT_S)[0][:3], short / "rig.yaml")
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        found = sync(files, whole / "rig.yaml")
        wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    parts, status = found.seconds, found.network.status
    row = GrowthRow(
        str(status),
        found.network.reason if status != Status.OK else "",
        sum(camera.n_seen for camera in found.network.cameras),
        *(wall_s, cpu_s, sum(seconds for part, seconds in parts.items() if part != "network")),
        *(parts["network"], peak_mb),
    )
    return replace(row, **_errors(found, clocks, cell.duration_s)) if status == Status.OK else row


def write_tracks(folder: Path, duration_s: float) -> tuple[list[Path], list[Clock]]:
    """Write the rig and a track for each camera of a flight; give their files and true clocks."""
    rng = np.random.default_rng([_SEED, 1])
    rig = _rig()
    flight = random_spline(replace(_SPLINE, duration_s=duration_s), np.random.default_rng(_SEED))
    offsets_s = np.append(0.0, rng.uniform(-_OFFSETS_S, _OFFSETS_S, N_CAMERAS - 1))
    skews_ppm = np.append(0.0, rng.normal(0.0, _SKEWS_PPM, N_CAMERAS - 1))
    clocks = [
        Clock(float(offset_s), float(skew_ppm), 0.5 * duration_s)
        for offset_s, skew_ppm in zip(offsets_s, skews_ppm, strict=True)
    ]
    files = []
    for k, (camera, clock) in enumerate(zip(rig.cameras, clocks, strict=True)):
        first_s = rng.uniform(0.0, 1.0 / FRAMES_HZ)
        times_s: Array = first_s + np.arange(int(FRAMES_HZ * duration_s) - 1) / FRAMES_HZ
        points_px: Array = camera.project(flight.poses(times_s)[:, :3, 3])
        points_px = points_px + rng.normal(0.0, NOISE_PX, points_px.shape)
        inside = np.all((points_px >= 0) & (points_px <= (camera.width - 1, camera.height - 1)), 1)
        files.append(folder / f"cam{k + 1}.csv")
        shown_s = clock.cam2_from_cam1(times_s)
        save_track(files[-1], PointTrack(shown_s[inside], points_px[inside]))
    chain = yaml.safe_load(kalibr_yaml(rig, with_extrinsics=False))
    for entry in chain.values():
        entry["readout_s"] = 0.0  # global shutters
    (folder / "rig.yaml").write_text(yaml.safe_dump(chain), encoding="utf-8")
    return files, clocks


def _rig() -> Rig:
    return look_at_rig(
        [*np.linspace(0.0, 315.0, N_CAMERAS)],
        distance_m=_DISTANCE_M,
        focal_px=_FOCAL_PX,
        resolution=(1280, 720),
        principal_point=(640.0, 360.0),
    )


def _errors(found: NetworkResult, clocks: list[Clock], duration_s: float) -> dict[str, Any]:
    """Give the largest error of a clock, and the path's in the first camera's frame."""
    errors_s = [
        camera.t_d_s - (float(clock.cam2_from_cam1(camera.t_ref_s)) - camera.t_ref_s)
        for camera, clock in zip(found.network.cameras, clocks, strict=True)
    ]
    rig = _rig()
    T_1_W = rig.cameras[0].T_C_W
    flight = random_spline(replace(_SPLINE, duration_s=duration_s), np.random.default_rng(_SEED))
    path = found.network.paths[0].path
    true_m = (
        flight.poses(np.clip(path.times_s, 0.0, duration_s))[:, :3, 3] @ T_1_W[:3, :3].T
        + T_1_W[:3, 3]
    )
    baseline_m = float(np.linalg.norm(rig.relative_pose(0, 1)[:3, 3]))
    off_m = np.linalg.norm(baseline_m * path.positions_m - true_m, axis=1)
    return {
        "t_d_error_ms": 1e3 * float(np.max(np.abs(errors_s))),
        "path_rmse_m": float(np.sqrt(np.mean(off_m**2))),
    }


STUDIES = (
    Study(
        "network_growth",
        "How time and memory grow with the flight of eight frame cameras",
        cells,
        Measure(load_nothing, growth_row, GrowthRow),
        Runs(
            "network_growth.csv",
            ("duration_s",),
            columns=("duration_s", "cameras", "points", "wall_s", "cpu_s", "pairs_s",
                     "network_s", "peak_mb", "status", "t_d_error_ms", "path_rmse_m"),
            numbered=False,
            took=("wall_s", "cpu_s", "pairs_s", "network_s", "peak_mb"),
        ),
        checks=(
            ("all flights are solved", one_of("network_growth", "status", "ok")),
            ("within the mark of time", between("network_growth", "wall_s", 0.0, MARK_S)),
            ("the path errs by less than a point's noise",
             between("network_growth", "path_rmse_m", 0.0, NOISE_PX * _DISTANCE_M / _FOCAL_PX)),
            ("within the mark of memory", between("network_growth", "peak_mb", 0.0, MARK_MB)),
        ),
        config={"durations_s": DURATIONS_S, "cameras": N_CAMERAS, "frames_hz": FRAMES_HZ,
                "noise_px": NOISE_PX, "seed": _SEED, "spline": _SPLINE},
        command=COMMAND,
        how=How.ALONE,
    ),
)  # fmt: skip
