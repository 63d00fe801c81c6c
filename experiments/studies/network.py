"""Many cameras round one flight, all solved at once: errors of four, and growth with eight.

The four cameras of a flight share one solution for each kind. Kinds are `as_recorded`, and
`true_tracks`: the images of the drone's origin in place of the events, which shows the errors that
the tracks cause. The flights are in no other table, and `ssac.network` was tuned on none of them.

The growth of time and memory is measured on tracks of ever longer flights before eight frame
cameras. Each is solved as `ssac sync` of its files does, in a process of its own on one core.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import pandas as pd
import yaml
from scipy.spatial.transform import Rotation

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure, PlainCell, RunRow, load_nothing
from experiments.lab.command import command_of
from experiments.lab.provenance import plain
from experiments.lab.recorded import FlightTruth, load_truth
from experiments.lab.results import Results
from experiments.lab.schedule import timed
from experiments.lab.score import mahalanobis
from experiments.lab.study import How, Runs, Study
from experiments.lab.summary import answered, by_group, digits, made_of, shown_table, statistics
from experiments.lab.verify import no_row
from experiments.scenes.simulate import ManyCameras
from experiments.studies.imperfect import HELD, held
from experiments.studies.outdoor import CALM, PlacedRow, placed_errors, true_track
from sim.scene.rig import Rig, kalibr_yaml, look_at_rig
from sim.scene.trajectory import Trajectory, random_spline
from sim.sensor.frames import FrameConfig
from ssac.arrays import Array
from ssac.cli.options import number
from ssac.clock import Clock
from ssac.estimate import Status
from ssac.files.event_files import load_events, write_synced
from ssac.files.track_files import save_track
from ssac.fit.covariance import NORMAL_95
from ssac.geometry.pose import tangent_basis
from ssac.network.adjustment import border_offsets
from ssac.network.align import similarity
from ssac.network.solve import NetworkAnswer
from ssac.network.state import ROTATION, TRANSLATION
from ssac.network.tum import Path as SpacePath
from ssac.pipeline.api import sync
from ssac.pipeline.many import NetworkResult
from ssac.points import PointTrack

COMMAND = "ssac network"

T_D_S = (0.0, 0.05, -0.23, 0.41)
"""Offset of each clock from the first, added when events or tracks are written."""

N_CAMERAS = len(T_D_S)
ANGLE_DEG = 60.0  # from each camera to the next, on a half circle
FOUR_CAMERAS = ManyCameras(
    angle_deg=ANGLE_DEG, frames=FrameConfig(rate_hz=0.0), n_cameras=N_CAMERAS
)
"""The default flight and drone, before four cameras with ideal sensors and equal clocks."""

N_FLIGHTS = 4
FIRST_SEED = 78_000  # those from 73,000 to 77,003 were looked at
AS_RECORDED, TRUE_TRACKS = "as_recorded", "true_tracks"
KINDS = (AS_RECORDED, TRUE_TRACKS)

_ARM_ROUNDS = 40  # in which similarity and lever arm are fitted in turn

_HELD = {name.lower(): quantity for name, quantity in HELD.items()}
"""Quantities whose regions of 95 % are counted."""

_WORST = ("t_d_error_ms", "r_error_deg", "t_error_deg", "path_rmse_mm")

Flights = Annotated[int, number("Flights seen by four cameras.", 1, 1000, metavar="COUNT")]


@dataclass(frozen=True)
class CameraCell(FlightCell):
    """One camera of a flight; the row of the first, the reference, is about the path."""

    kind: str  # of KINDS
    camera: int  # from 1 on


@dataclass(frozen=True)
class CameraRow(PlacedRow):
    """Errors and stated deviations of a camera's clock and pose, or, for the first, of the path."""

    t_d_normalised: float = np.nan
    skew_normalised: float = np.nan
    r_mahalanobis: float = np.nan
    t_mahalanobis: float = np.nan
    path_rmse_mm: float = np.nan  # of the drone's origin, after alignment by similarity
    path_median_mm: float = np.nan
    path_max_mm: float = np.nan
    path_point_rmse_mm: float = np.nan  # likewise, of the point fixed in the body that fits best
    path_std_mm: float = np.nan  # stated deviation, root mean square
    path_held: float = np.nan  # share of the coordinates' intervals of 95 % that hold the truth
    path_seen: float = np.nan  # share of the flight that the path covers


@dataclass(frozen=True)
class Flown:
    """A flight's files and truth, and the answers of the kinds that are solved so far."""

    folder: Path
    truth: FlightTruth
    found: dict[str, NetworkAnswer] = field(default_factory=dict)


def cells(flights: Flights = N_FLIGHTS) -> list[CameraCell]:
    """List every camera of each flight and kind."""
    every = product(range(flights), KINDS, range(1, N_CAMERAS + 1))
    return [CameraCell(FOUR_CAMERAS, n, FIRST_SEED + n, kind, camera) for n, kind, camera in every]


def load_flight(cells: Sequence[CameraCell], cache: Cache) -> Flown:
    """Load a flight, which is simulated if it is not there yet."""
    folder = cache.recording_folder(cells[0].sim, cells[0].seed)
    return Flown(folder, load_truth(folder))


def camera_row(cell: CameraCell, flown: Flown) -> CameraRow:
    """Compare one camera with the truth."""
    if cell.kind not in flown.found:
        flown.found[cell.kind] = solved(cell.kind, flown)
    answer, k = flown.found[cell.kind], cell.camera - 1
    camera = answer.cameras[k]
    if camera.status != Status.OK or camera.group != 1 or answer.cameras[0].group != 1:
        return CameraRow(str(camera.status), camera.reason)
    figures = _pose_figures(answer, k, flown.truth) if k else _path_figures(answer, flown.truth)
    return CameraRow(str(camera.status), **figures)


def solved(kind: str, flown: Flown) -> NetworkAnswer:
    """Synchronise every pair and solve all, as `ssac sync` of four files does."""
    with TemporaryDirectory() as name:
        files = [_written(Path(name), kind, k, flown) for k in range(N_CAMERAS)]
        return sync(files, flown.folder / "rig.yaml").network


def _written(work: Path, kind: str, k: int, flown: Flown) -> Path:
    """Write a camera's events or true track on its own clock; return the file."""
    clock = Clock(T_D_S[k])
    if kind == TRUE_TRACKS:
        file = work / f"cam{k + 1}.csv"
        times_s, centres_px = flown.truth.times_s, flown.truth.centres_px[k]
        save_track(file, true_track(times_s, centres_px, clock, FOUR_CAMERAS.resolution, 2))
        return file
    file = work / f"cam{k + 1}.h5"
    write_synced(file, load_events(flown.folder / file.name), clock.inverse())
    return file


def _pose_figures(answer: NetworkAnswer, k: int, truth: FlightTruth) -> dict[str, Any]:
    """Compare the clock and the pose of the k-th camera."""
    camera, built, T_k_1 = answer.cameras[k], answer.built[0], truth.pose(k)
    assert camera.R is not None  # the network has it
    assert camera.t is not None
    at = int(border_offsets(built.network)[built.members.index(k)])
    part = (built.solved.border_covariance() * built.network.lasting)[at:, at:]
    turned = Rotation.from_matrix(T_k_1[:3, :3] @ camera.R.T).as_rotvec()
    length = float(np.linalg.norm(camera.t))
    direction = T_k_1[:3, 3] / np.linalg.norm(T_k_1[:3, 3])
    across = tangent_basis(camera.t / length)
    t_d_error_ms = 1e3 * (camera.t_d_s - T_D_S[k])
    return placed_errors(camera, T_D_S[k], 0.0, T_k_1[:3, :3], direction) | {
        "r_error_deg": float(np.rad2deg(np.linalg.norm(turned))),
        "t_d_normalised": t_d_error_ms / (1e3 * camera.t_d_std_s),
        "skew_normalised": camera.skew_ppm / camera.skew_std_ppm,
        "r_mahalanobis": mahalanobis(turned, part[ROTATION, ROTATION]),
        "t_mahalanobis": mahalanobis(
            across @ direction * length, across @ part[TRANSLATION, TRANSLATION] @ across.T
        ),
    }


def _path_figures(answer: NetworkAnswer, truth: FlightTruth) -> dict[str, Any]:
    """Compare the path with the truth at equal times, aligned by a similarity."""
    path = answer.paths[0].path
    true_m = np.column_stack(
        [np.interp(path.times_s, truth.times_s, axis) for axis in truth.positions_m.T]
    )
    frame = similarity(path.positions_m, true_m)
    off_m = frame.apply(path.positions_m) - true_m
    distances_mm = 1e3 * np.linalg.norm(off_m, axis=1)
    deviations_m = path.deviations_m
    assert deviations_m is not None  # the network states them
    own = off_m @ frame.R / frame.scale  # along the axes of the deviations
    std_mm = 1e3 * frame.scale * np.linalg.norm(deviations_m, axis=1)
    return {
        "path_rmse_mm": float(np.sqrt(np.mean(distances_mm**2))),
        "path_median_mm": float(np.median(distances_mm)),
        "path_max_mm": float(distances_mm.max()),
        "path_point_rmse_mm": 1e3 * path_off_best_point_m(path, true_m, truth),
        "path_std_mm": float(np.sqrt(np.mean(std_mm**2))),
        "path_held": float(np.mean(np.abs(own) <= NORMAL_95 * deviations_m)),
        "path_seen": float((len(path) - 1) * np.median(np.diff(path.times_s)) / truth.times_s[-1]),
    }


def path_off_best_point_m(path: SpacePath, true_m: Array, truth: FlightTruth) -> float:
    """Return the rms distance [m] of the path from the body-fixed point that it fits best."""
    nearest = np.minimum(np.searchsorted(truth.times_s, path.times_s), len(truth.times_s) - 1)
    turns = Rotation.from_quat(truth.quaternions[nearest])
    arm_m, off_m = np.zeros(3), np.zeros_like(true_m)
    for _ in range(_ARM_ROUNDS):
        target = true_m + turns.apply(arm_m)
        laid = similarity(path.positions_m, target).apply(path.positions_m)
        off_m = laid - target
        arm_m = arm_m + turns.inv().apply(off_m).mean(axis=0)
    return float(np.sqrt(np.mean(np.sum(off_m**2, axis=1))))


@by_group("kind")
def camera_table(group: pd.DataFrame) -> dict[str, Any]:
    """Sum up the flights by kind: means of all that was measured, and the largest of the errors.

    `told` counts the answered cameras but the first, `_held` how many of their regions hold.
    """
    good = answered(group)
    others = good[good["camera"] > 1]
    measured = [one.name for one in fields(CameraRow)[2:]]
    summed = {one.column for one in _HELD.values()}
    row: dict[str, Any] = {"cameras": len(group), "answered": len(good)}
    row |= {name: good[name].mean() for name in measured if name not in summed}
    row |= statistics(good, _WORST, "most") | {"told": len(others)}
    counts, _ = held(others, _HELD)
    return row | {name: n for name, n in counts.items() if name.endswith("_held")}


def page_table(results: Results) -> str:
    """Lay out mean errors (the largest), and how many of the stated regions of 95 % hold."""
    table = results.table("network")
    kinds, nearest = table["kind"].str.replace("_", " "), table["path_point_rmse_mm"].map(digits)
    shown = table.assign(kind=kinds, nearest=nearest, path_held=100 * table["path_held"])
    return shown_table(shown, {
        "tracks": "{kind}",
        "t_d [ms]": "{t_d_error_ms:.3f} ({t_d_error_ms_most:.3f})",
        "R [deg]": "{r_error_deg:.3f} ({r_error_deg_most:.3f})",
        "t [deg]": "{t_error_deg:.3f} ({t_error_deg_most:.3f})",
        f"held of {table['told'].iloc[-1]}": "{t_d_held}, {skew_held}, {r_held}, {t_held}",
        "path [mm]": "{path_rmse_mm:.1f} ({path_rmse_mm_most:.1f})",
        "nearest": "{nearest}",
        "held [%]": "{path_held:.0f}",
    })  # fmt: skip


# --- How time and memory grow ---


N_FRAME_CAMERAS = 8
FRAMES_HZ = 60.0
DURATIONS_S = (150.0, 300.0, 600.0)
NOISE_PX = 0.5
_DISTANCE_M, _FOCAL_PX = 35.0, 900.0
_NOISE_M = NOISE_PX * _DISTANCE_M / _FOCAL_PX
MARK_S, MARK_MB = 600.0, 4096.0  # of the longest flight
_SEED = 74_000
_SHORT_S = 20.0
_TOOK = ("wall_s", "cpu_s", "pairs_s", "network_s", "peak_mb")
_GROWN_ERRORS = ("t_d_error_ms", "path_rmse_m")
_OFFSETS_S, _SKEWS_PPM = 20.0, 20.0  # of the clocks: largest offset, deviation of skews
_SPLINE = replace(CALM, multiplier_xyz_m=(24.0, 24.0, 10.0), max_radius_m=20.0)


@dataclass(frozen=True)
class GrowthCell(PlainCell):
    """One flight."""

    duration_s: float
    cameras: int = N_FRAME_CAMERAS


@dataclass(frozen=True)
class GrowthRow(RunRow):
    """Time and memory for a flight, the largest error of a clock, and the error of the path."""

    points: float = np.nan
    wall_s: float = np.nan
    cpu_s: float = np.nan
    pairs_s: float = np.nan
    network_s: float = np.nan
    peak_mb: float = np.nan
    t_d_error_ms: float = np.nan
    path_rmse_m: float = np.nan


def growth_row(cell: GrowthCell, _: object) -> GrowthRow:
    """Solve a flight in this process, after a short one that loads the kernels."""
    with TemporaryDirectory() as name:
        short, whole = Path(name) / "short", Path(name) / "whole"
        files, clocks = write_tracks(whole, cell.duration_s)
        sync(write_tracks(short, _SHORT_S)[0][:3], short / "rig.yaml")
        found, wall_s, cpu_s, peak_mb = timed(partial(sync, files, whole / "rig.yaml"))
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
    """Write the rig and noisy tracks of a flight; return the tracks' files and true clocks."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng([_SEED, 1])
    rig, flight = _rig(), _flight(duration_s)
    offsets_s = np.append(0.0, rng.uniform(-_OFFSETS_S, _OFFSETS_S, N_FRAME_CAMERAS - 1))
    skews_ppm = np.append(0.0, rng.normal(0.0, _SKEWS_PPM, N_FRAME_CAMERAS - 1))
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


def _flight(duration_s: float) -> Trajectory:
    return random_spline(replace(_SPLINE, duration_s=duration_s), np.random.default_rng(_SEED))


def _rig() -> Rig:
    return look_at_rig(
        [*np.linspace(0.0, 315.0, N_FRAME_CAMERAS)],
        distance_m=_DISTANCE_M,
        focal_px=_FOCAL_PX,
        resolution=(1280, 720),
        principal_point=(640.0, 360.0),
    )


def _errors(found: NetworkResult, clocks: list[Clock], duration_s: float) -> dict[str, Any]:
    """Return the largest error of a clock, and the path's rms error in camera 1's frame."""
    errors_s = [
        camera.t_d_s - (float(clock.cam2_from_cam1(camera.t_ref_s)) - camera.t_ref_s)
        for camera, clock in zip(found.network.cameras, clocks, strict=True)
    ]
    rig, path = _rig(), found.network.paths[0].path
    T_1_W = rig.cameras[0].T_C_W
    positions_W_m = _flight(duration_s).poses(np.clip(path.times_s, 0.0, duration_s))[:, :3, 3]
    true_m = positions_W_m @ T_1_W[:3, :3].T + T_1_W[:3, 3]
    baseline_m = float(np.linalg.norm(rig.relative_pose(0, 1)[:3, 3]))
    off_m = np.linalg.norm(baseline_m * path.positions_m - true_m, axis=1)
    return {
        "t_d_error_ms": 1e3 * float(np.max(np.abs(errors_s))),
        "path_rmse_m": float(np.sqrt(np.mean(off_m**2))),
    }


FOUR = (
    Study(
        "network",
        "Clocks, poses and path of four event cameras",
        cells,
        Measure(load_flight, camera_row, CameraRow),
        Runs("network_runs.csv", ("flight", "kind", "camera")),
        (made_of("network.csv", camera_table, "network_runs"),),
        numbers={"table.network": page_table},
        checks=(
            ("shares are shares", no_row(
                "network_runs",
                "path_held < 0 or path_held > 1 or path_seen < 0 or path_seen > 1",
            )),
            ("errors are their deviations times what is normalised", no_row(
                "network_runs", "abs(abs(t_d_normalised) * t_d_std_ms - t_d_error_ms) > 1e-6")),
            ("and so are those of skews", no_row(
                "network_runs",
                "abs(abs(skew_normalised) * skew_std_ppm - skew_error_ppm) > 1e-4")),
        ),
        config={"n_flights": N_FLIGHTS, "first_seed": FIRST_SEED, "angle_deg": ANGLE_DEG,
                "t_d_s": T_D_S, "kinds": KINDS,
                "sim": {name: value for name, value in plain(FOUR_CAMERAS).items()
                        if name != "n_cameras"}},  # which `t_d_s` implies
        command=COMMAND,
    ),
)  # fmt: skip

GROWTH = (
    Study(
        "network_growth",
        "How time and memory grow with the flight of eight frame cameras",
        lambda: [GrowthCell(duration_s) for duration_s in DURATIONS_S],
        Measure(load_nothing, growth_row, GrowthRow),
        Runs(
            "network_growth.csv",
            ("duration_s",),
            columns=("duration_s", "cameras", "points", *_TOOK, "status", *_GROWN_ERRORS),
            numbered=False,
            took=_TOOK,
        ),
        checks=(
            ("all flights are solved", no_row("network_growth", "status != 'ok'")),
            ("within the mark of time", no_row("network_growth", f"not 0 <= wall_s <= {MARK_S}")),
            (
                "the path errs by less than half of a point's noise",
                no_row("network_growth", f"not 0 <= path_rmse_m <= {0.5 * _NOISE_M}"),
            ),
            (
                "within the mark of memory",
                no_row("network_growth", f"not 0 <= peak_mb <= {MARK_MB}"),
            ),
        ),
        config={
            "durations_s": DURATIONS_S,
            "cameras": N_FRAME_CAMERAS,
            "frames_hz": FRAMES_HZ,
            "noise_px": NOISE_PX,
            "seed": _SEED,
            "spline": _SPLINE,
        },
        command=COMMAND,
        how=How.ALONE,
    ),
)

STUDIES = (*FOUR, *GROWTH)

command = command_of(
    {"four": FOUR, "growth": GROWTH},
    "Solve many cameras at once: four of events, and how time grows with eight of frames.\n\n"
    "What is finished of the former is kept in the cache, so that an interrupted run goes on.",
)
