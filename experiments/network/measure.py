"""A flight before four cameras in; what solving all at once finds beside the truth, out.

Rows of one flight and kind share one solution. Kinds are `as_recorded`, and `true_tracks`: the
images of the drone's origin in place of the events, so that one sees what the tracks cost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.score import angle_between_deg
from experiments.network.cameras import N_CAMERAS, T_D_S, Truth, load_truth
from experiments.outdoor.twin import true_track
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

Array = NDArray[np.float64]

AS_RECORDED, TRUE_TRACKS = "as_recorded", "true_tracks"
KINDS = (AS_RECORDED, TRUE_TRACKS)

_ARM_ROUNDS = 40  # of the similarity and the lever arm in turn


@dataclass(frozen=True)
class CameraCell(FlightCell):
    """One camera of a flight; the first, whose clock and frame the others are told by, its path."""

    kind: str  # of KINDS
    camera: int  # from 1 on

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which it is."""
        return {**self.flown, "kind": self.kind, "camera": self.camera}

    @property
    def inputs(self) -> tuple[Any, ...]:
        """What the row depends on beside the recording."""
        return self.kind, self.camera


@dataclass(frozen=True)
class CameraRow:
    """Errors and stated deviations of a camera, or, of the first, of the path."""

    status: str
    reason: str = ""
    t_d_error_ms: float = np.nan
    t_d_std_ms: float = np.nan
    skew_error_ppm: float = np.nan
    skew_std_ppm: float = np.nan
    r_error_deg: float = np.nan
    r_std_deg: float = np.nan
    t_error_deg: float = np.nan
    t_d_normalised: float = np.nan
    skew_normalised: float = np.nan
    r_mahalanobis: float = np.nan
    t_mahalanobis: float = np.nan
    path_rmse_mm: float = np.nan  # of the drone's origin, after alignment by similarity
    path_median_mm: float = np.nan
    path_max_mm: float = np.nan
    path_point_rmse_mm: float = np.nan  # likewise, of the point fixed in the body that fits best
    path_std_mm: float = np.nan  # stated, as `path_rmse_mm`
    path_held: float = np.nan  # share of the coordinates' intervals of 95 % that hold the truth
    path_seen: float = np.nan  # share of the flight


@dataclass(frozen=True)
class FlownBefore:
    """A flight's files, and what was found of each kind so far."""

    folder: Path
    truth: Truth
    found: dict[str, NetworkAnswer] = field(default_factory=dict)


def load_flight(cells: Sequence[CameraCell], cache: Cache) -> FlownBefore:
    """Load a flight, which is simulated if it is not there yet."""
    folder = cache.recording_folder(cells[0].sim, cells[0].seed)
    return FlownBefore(folder, load_truth(folder))


def camera_row(cell: CameraCell, flown: FlownBefore) -> CameraRow:
    """Tell of one camera."""
    if cell.kind not in flown.found:
        flown.found[cell.kind] = solved(cell.kind, flown)
    answer, k = flown.found[cell.kind], cell.camera - 1
    camera = answer.cameras[k]
    if camera.status != Status.OK or camera.group != 1 or answer.cameras[0].group != 1:
        return CameraRow(str(camera.status), camera.reason)
    figures = _pose_figures(answer, k, flown.truth) if k else _path_figures(answer, flown.truth)
    return replace(CameraRow(str(camera.status)), **figures)


CAMERAS = Measure(load_flight, camera_row, CameraRow)


def solved(kind: str, flown: FlownBefore) -> NetworkAnswer:
    """Synchronise every pair and solve all, as `ssac sync` of four files does."""
    with TemporaryDirectory() as name:
        files = [_written(Path(name), kind, k, flown) for k in range(N_CAMERAS)]
        return sync(files, flown.folder / "rig.yaml").network


def _written(work: Path, kind: str, k: int, flown: FlownBefore) -> Path:
    """Write what a camera saw, by its own clock."""
    clock = Clock(T_D_S[k])
    if kind == TRUE_TRACKS:
        file = work / f"cam{k + 1}.csv"
        size = load_events(flown.folder / f"cam{k + 1}.h5")
        assert size.width is not None  # our own files have both
        assert size.height is not None
        resolution = size.width, size.height
        times_s, centres_px = flown.truth.times_s, flown.truth.centres_px[k]
        save_track(file, true_track(times_s, centres_px, clock, resolution, 2))
        return file
    file = work / f"cam{k + 1}.h5"
    write_synced(file, load_events(flown.folder / file.name), clock.inverse())
    return file


def _pose_figures(answer: NetworkAnswer, k: int, truth: Truth) -> dict[str, Any]:
    """Compare the clock and the pose of the k-th camera."""
    camera, built, T_k_1 = answer.cameras[k], answer.built[0], truth.poses[k]
    assert camera.R is not None  # the network has it
    assert camera.t is not None
    at = int(border_offsets(built.network)[built.members.index(k)])
    covariance = built.solved.border_covariance() * built.network.lasting
    part = covariance[at:, at:]
    turned = Rotation.from_matrix(T_k_1[:3, :3] @ camera.R.T).as_rotvec()
    length = float(np.linalg.norm(camera.t))
    direction = T_k_1[:3, 3] / np.linalg.norm(T_k_1[:3, 3])
    across = tangent_basis(camera.t / length)
    moved = across @ direction * length
    t_d_error_ms = 1e3 * (camera.t_d_s - T_D_S[k])
    return {
        "t_d_error_ms": abs(t_d_error_ms),
        "t_d_std_ms": 1e3 * camera.t_d_std_s,
        "skew_error_ppm": abs(camera.skew_ppm),
        "skew_std_ppm": camera.skew_std_ppm,
        "r_error_deg": float(np.rad2deg(np.linalg.norm(turned))),
        "r_std_deg": camera.r_std_deg,
        "t_error_deg": angle_between_deg(camera.t, direction),
        "t_d_normalised": t_d_error_ms / (1e3 * camera.t_d_std_s),
        "skew_normalised": camera.skew_ppm / camera.skew_std_ppm,
        "r_mahalanobis": _mahalanobis(turned, part[ROTATION, ROTATION]),
        "t_mahalanobis": _mahalanobis(moved, across @ part[TRANSLATION, TRANSLATION] @ across.T),
    }


def _mahalanobis(off: Array, covariance: Array) -> float:
    return float(np.sqrt(off @ np.linalg.solve(covariance, off)))


def _path_figures(answer: NetworkAnswer, truth: Truth) -> dict[str, Any]:
    """Compare the path, laid over the truth at equal times by a similarity."""
    path = answer.paths[0].path
    true_m = np.column_stack(
        [np.interp(path.times_s, truth.times_s, axis) for axis in truth.positions_m.T]
    )
    frame = similarity(path.positions_m, true_m)
    off_m = frame.apply(path.positions_m) - true_m
    distances_mm = 1e3 * np.linalg.norm(off_m, axis=1)
    deviations_m = path.deviations_m
    assert deviations_m is not None  # the network tells them
    own = off_m @ frame.R / frame.scale  # along the axes of the deviations
    std_mm = 1e3 * frame.scale * np.linalg.norm(deviations_m, axis=1)
    return {
        "path_rmse_mm": float(np.sqrt(np.mean(distances_mm**2))),
        "path_median_mm": float(np.median(distances_mm)),
        "path_max_mm": float(distances_mm.max()),
        "path_point_rmse_mm": 1e3 * path_off_best_point_m(path, true_m, truth),
        "path_std_mm": float(np.sqrt(np.mean(std_mm**2))),
        "path_held": float(np.mean(np.abs(own) <= NORMAL_95 * deviations_m)),
        "path_seen": float(len(path) * np.median(np.diff(path.times_s)) / truth.times_s[-1]),
    }


def path_off_best_point_m(path: SpacePath, true_m: Array, truth: Truth) -> float:
    """Rms distance [m] of the path from the point, fixed in the body, that it fits best."""
    nearest = np.minimum(np.searchsorted(truth.times_s, path.times_s), len(truth.times_s) - 1)
    turns = Rotation.from_quat(truth.quaternions[nearest])
    arm_m, off_m = np.zeros(3), np.zeros_like(true_m)
    for _ in range(_ARM_ROUNDS):
        target = true_m + turns.apply(arm_m)
        laid = similarity(path.positions_m, target).apply(path.positions_m)
        off_m = laid - target
        arm_m = arm_m + turns.inv().apply(off_m).mean(axis=0)
    return float(np.sqrt(np.mean(np.sum(off_m**2, axis=1))))
