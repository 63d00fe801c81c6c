"""Cells of one recording in, one scored row each out: record -> estimate -> score."""

import resource
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from experiments.run.cache import Brightness, Cache, Denoised, recording_key, run_key
from experiments.run.grid import Cell
from experiments.run.score import score
from sim.recording import SimConfig
from ssac.baselines.zncc_f import frame_means
from ssac.camera import Rig
from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.events import US_PER_S
from ssac.files.hdf5 import load_events_h5, load_frames
from ssac.files.rigs import load_rig
from ssac.tool.registry import METHODS, Chain, Input, Method
from ssac.track.observation import Observation, prepare, usable_events

FloatArray = NDArray[np.float64]
Frames = tuple[NDArray[np.generic] | None, FloatArray | None]
"""Images (n, height, width) and their times (n,) [s], or neither."""

CRASHED = "crashed"
"""Status of a run that could not be simulated, or whose method raised what is not an SsacError."""

UNUSABLE = "unusable"
"""Status of a run on data that the method refuses with an SsacError."""


Chains = dict[tuple[float, Config], Chain]
"""By offset and parameters: all of one recording."""


@dataclass(frozen=True)
class Task:
    """All runs that need one recording."""

    sim: SimConfig
    seed: int
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Row:
    """One scored run; NaN for what the method does not give."""

    status: str  # the estimate's, or "skipped", UNUSABLE, CRASHED
    reason: str = ""
    t_d_estimate_ms: float = np.nan
    t_d_error_ms: float = np.nan
    r_error_deg: float = np.nan  # NaN for a method that was given the pose, as is t_error_deg
    t_error_deg: float = np.nan
    t_d_std_ms: float = np.nan
    r_std_deg: float = np.nan  # this and those below as in `score.PoseScore`
    t_std_deg: float = np.nan
    r_mahalanobis: float = np.nan
    t_mahalanobis: float = np.nan
    r_x_normalised: float = np.nan
    r_y_normalised: float = np.nan
    r_z_normalised: float = np.nan
    t_1_normalised: float = np.nan
    t_2_normalised: float = np.nan
    n_samples: int = 0
    d_avg_px: float = np.nan
    n_events_cam1: int = 0  # as recorded
    n_events_cam2: int = 0


@dataclass(frozen=True)
class Recorded:
    """A recording as the methods see it, and the pose that they are scored against."""

    cam1: Observation
    cam2: Observation
    rig: Rig  # with the true extrinsics
    n_events: tuple[int, int]


def tasks_of(cells: Sequence[Cell]) -> list[Task]:
    """Group cells by recording, in the order in which the recordings first appear."""
    groups: dict[tuple[SimConfig, int], list[Cell]] = {}
    for cell in cells:
        groups.setdefault((cell.sim, cell.seed), []).append(cell)
    return [Task(sim, seed, tuple(group)) for (sim, seed), group in groups.items()]


def keys_of(task: Task) -> list[str]:
    """Keys of a task's cells in the cache."""
    recording = recording_key(task.sim, task.seed)
    return [
        run_key(recording, cell.t_d_s, cell.estimator, cell.method, METHODS[cell.method].version)
        for cell in task.cells
    ]


def run_task(task: Task, cache: Cache) -> tuple[list[dict[str, Any]], float]:
    """Run those cells of a task that the cache does not hold yet.

    Parameters
    ----------
    task : Task
    cache : Cache
        Is given every row as soon as it is there, but for crashed ones.

    Returns
    -------
    rows : list[dict[str, Any]]
        One for each cell, the fields of `Row`. Nothing that a cell does raises.
    peak_mb : float
        Peak memory of this process so far.
    """
    with threadpool_limits(1):  # one worker a core, and sums in the same order everywhere
        rows = _rows(task, cache)
    unit = 1 if sys.platform == "darwin" else 1024
    return rows, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _rows(task: Task, cache: Cache) -> list[dict[str, Any]]:
    try:
        keys = keys_of(task)
        rows = [cache.load_run(key) for key in keys]
        missing = [cell for cell, row in zip(task.cells, rows, strict=True) if row is None]
        recorded = _recorded(task, missing, cache) if missing else None
    except Exception as error:  # whatever it is: the row says so, and the other recordings go on
        return [plain(_refusal(error, "recording"))] * len(task.cells)
    delayed: dict[float, Observation] = {}
    found: Chains = {}
    for index, (key, cell) in enumerate(zip(keys, task.cells, strict=True)):
        if rows[index] is not None or recorded is None:
            continue
        if cell.t_d_s not in delayed:
            delayed = {cell.t_d_s: recorded.cam2.delayed(cell.t_d_s)}
        row = run_cell(cell, recorded, delayed[cell.t_d_s], found)
        rows[index] = plain(row)
        if row.status != CRASHED:
            cache.save_run(key, plain(row))
    return [row for row in rows if row is not None]


def run_cell(cell: Cell, recorded: Recorded, cam2: Observation, found: Chains) -> Row:
    """Run one method on one recording, camera 2's clock being set already, and score it.

    What other methods `found` on the same recording spares a method that starts from there to do
    it again; a chain that is missing is added.
    """
    method = METHODS[cell.method]
    rig = method.rig_of(recorded.rig)
    n_cam1, n_cam2 = recorded.n_events
    reason = method.skip_reason(recorded.cam1, cam2, rig)
    if reason:
        return Row("skipped", reason, n_events_cam1=n_cam1, n_events_cam2=n_cam2)
    try:
        key = (cell.t_d_s, cell.estimator)
        if key not in found:
            found[key] = Chain(recorded.cam1, cam2, recorded.rig, cell.estimator)
        estimate = found[key].estimate(method.name)
        row = _scored(estimate, cell, recorded.rig)
    except Exception as error:
        row = _refusal(error, cell.method)
    return replace(row, n_events_cam1=n_cam1, n_events_cam2=n_cam2)


def _scored(estimate: Estimate, cell: Cell, truth: Rig) -> Row:
    T_2_1 = np.asarray(truth.T_2_1)
    given = METHODS[cell.method].needs_extrinsics  # a pose that was given has no error
    errors = score(estimate, cell.t_d_s, T_2_1[:3, :3], T_2_1[:3, 3])
    return Row(
        str(estimate.status),
        estimate.reason,
        1e3 * estimate.t_d_s,
        errors.t_d_error_ms,
        np.nan if given else errors.r_error_deg,
        np.nan if given else errors.t_error_deg,
        1e3 * estimate.t_d_std_s,
        n_samples=estimate.n_samples,
        d_avg_px=estimate.d_avg_px,
        **({} if given else vars(errors.pose)),
    )


def _recorded(task: Task, cells: Sequence[Cell], cache: Cache) -> Recorded:
    """Load what the cells need of a recording, which is simulated if it is not there yet."""
    folder = cache.recording_folder(task.sim, task.seed)
    rig = load_rig(folder / "rig_extrinsics.yaml")
    denoise = all(cell.estimator.denoise for cell in cells)
    if denoise:
        cam1, cam2, n_recorded = cache.denoised(folder, Config(), lambda: _denoised(folder, rig))
    else:
        cam1, cam2 = _events(folder)
        n_recorded = np.array([len(cam1), len(cam2)])
    frames1, frames2 = _frames(folder, [METHODS[cell.method] for cell in cells], cache)
    first, second = prepare(
        Observation(cam1, *frames1, denoised=denoise),
        Observation(cam2, *frames2, denoised=denoise),
        rig,
        replace(cells[0].estimator, denoise=False),
    )
    return Recorded(first, second, rig, (int(n_recorded[0]), int(n_recorded[1])))


def _events(folder: Path) -> tuple[NDArray[np.void], NDArray[np.void]]:
    return load_events_h5(folder / "cam1.h5").events, load_events_h5(folder / "cam2.h5").events


def _denoised(folder: Path, rig: Rig) -> Denoised:
    cam1, cam2 = _events(folder)
    left1, left2 = usable_events(Observation(cam1), Observation(cam2), rig, Config())
    return Denoised(left1, left2, np.array([len(cam1), len(cam2)]))


def _frames(folder: Path, methods: Sequence[Method], cache: Cache) -> tuple[Frames, Frames]:
    """Frames of both cameras where a method looks at them; images of one pixel if that will do."""
    looking = [method for method in methods if method.input is Input.FRAMES]
    if not looking:
        return (None, None), (None, None)
    if all(method.takes_means for method in looking):
        means = cache.brightness(folder, lambda: _brightness(folder))
        return _timed(means.times1_us, means.cam1), _timed(means.times2_us, means.cam2)
    return _timed(*_images(folder / "cam1.h5")), _timed(*_images(folder / "cam2.h5"))


def _images(path: Path) -> tuple[NDArray[np.int64], NDArray[np.generic]]:
    return load_frames(path) or (np.empty(0, np.int64), np.empty((0, 1, 1)))


def _brightness(folder: Path) -> Brightness:
    (times1_us, images1), (times2_us, images2) = (
        _images(folder / name) for name in ("cam1.h5", "cam2.h5")
    )
    return Brightness(frame_means(images1), times1_us, frame_means(images2), times2_us)


def _timed(times_us: NDArray[np.int64], images: NDArray[np.generic]) -> Frames:
    if len(images) == 0:
        return None, None
    return images.reshape(len(images), *(images.shape[1:] or (1, 1))), times_us / US_PER_S


def _refusal(error: Exception, where: str) -> Row:
    text = " ".join(str(error).split())
    if isinstance(error, SsacError):
        return Row(UNUSABLE, text)
    return Row(CRASHED, f"{where}: {type(error).__name__}: {text}")


def plain(row: Row) -> dict[str, Any]:
    """Turn a row into what JSON holds exactly: None for NaN."""
    values: Mapping[str, Any] = vars(row)
    return {
        name: None if isinstance(value, float) and np.isnan(value) else value
        for name, value in values.items()
    }
