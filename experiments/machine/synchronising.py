"""How long `ssac sync` takes for a pair of 20 s, by method and by stage, and reading by format.

Reading is beside each library's own read of the same file, which ends, as ours does, with all
events in one array in memory.
"""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import faery
import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from experiments.machine.parts import Measurement, best_seconds
from sim.recording import SimConfig
from sim.storage import record
from ssac.arrays import Events
from ssac.camera import Cameras
from ssac.config import Config
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE
from ssac.files.event_files import load_events
from ssac.files.hdf5 import FIELDS, save_events_h5
from ssac.files.text import save_events_text
from ssac.fit.least_squares import Parameters
from ssac.methods.algorithms import algorithm_2
from ssac.methods.joint import joint_from
from ssac.methods.tangency import refine_tangents, tangent_times, tangents_under
from ssac.pipeline.chain import MEANS, Chain, Source
from ssac.pipeline.opened import opened, opened_rig
from ssac.pipeline.registry import OURS, Input, Method
from ssac.search.two_views import TwoViews, views_of
from ssac.track.clean import Clean, clean
from ssac.track.observation import Observation

REPEATS = 5  # the best of as many is taken
MARKS_S = {"joint": 0.2, "tangency": 0.35}
"""Of all but reading, for 1.1 million events a camera."""

READ_REPEATS = 3
N_READ = 10_000_000
N_READ_TEXT = 2_000_000  # text is slow to write
WIDTH, HEIGHT = 1280, 720


def bench_sync(config: SimConfig | None = None) -> list[Measurement]:
    """Processor time of `ssac sync` on files of one pair, on one core: by default, of 20 s.

    Stages are those of `tangency`, in their order. The outlines are the events near both tangents,
    found among all of them; tangents alone are found in these. The refinement does both, each some
    times, and solves for offset and pose. Methods take events in memory, noise and all.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "pair"
        record(config or SimConfig(t_d_s=0.05), 0, folder, {})
        rig = opened_rig(folder / "rig_extrinsics.yaml", 2)
        files = opened((folder / "cam1.h5", folder / "cam2.h5"), rig)
        with threadpool_limits(1):  # threads of BLAS that wait for work would count as well
            return _stages(files, rig) + [_whole(method, files, rig) for method in OURS]


def _stages(files: Sequence[Source], rig: Cameras) -> list[Measurement]:
    config = Config()
    rows = []

    def timed(stage: str, function: Callable[..., Any], *arguments: Any) -> Any:
        seconds, result = best_seconds(partial(function, *arguments), REPEATS)
        rows.append(Measurement(f"sync, stage: {stage}", seconds, "s"))
        return result

    seen = timed("reading", _read, files)
    left = timed("checks and denoising", _cleaned, seen, rig)
    views = timed("tracks", _viewed, left, rig, config)
    found = timed("search over +-1 s", algorithm_2, views)
    start = timed("joint refinement", joint_from, found, views)
    if start.R is None or start.t is None:
        raise SsacError(f"joint found no pose in the benchmark's pair: {start.reason}")
    parameters = Parameters(start.t_d_s, start.R, start.t)
    times_s = tangent_times(views, start.t_d_s)
    under = partial(tangents_under, parameters)
    _, near = timed("outlines and tangents", under, views, times_s)
    timed("tangents alone", under, views, times_s, near)
    timed("tangency refinement", refine_tangents, start, views)
    n_events = sum(len(one.events) for one in seen) / 2
    return [Measurement("sync: events per camera", n_events, "events"), *rows]


def _read(files: Sequence[Source], frames: str = "") -> list[Observation]:
    return [file.read(frames) for file in files]


def _cleaned(seen: Sequence[Observation], rig: Cameras) -> list[Clean]:
    how = Config().cleaning
    return [clean(one, camera, how) for one, camera in zip(seen, rig.cameras, strict=True)]


def _viewed(left: Sequence[Clean], rig: Cameras, config: Config) -> TwoViews:
    """Sum up both views, of events of which nothing was summed up before."""
    one, other = (replace(camera) for camera in left)
    return views_of(one, other, rig.pair(0, 1), config)


def _whole(method: Method, files: Sequence[Source], rig: Cameras) -> Measurement:
    """Time a method on what was read."""
    seen = _read(files, MEANS if method.input is Input.FRAMES else "")
    in_all, _ = best_seconds(lambda: Chain(seen, rig).estimate(method), REPEATS)
    return Measurement(
        f"sync, {method.name}: all but reading", in_all, "s", MARKS_S.get(method.name)
    )


def bench_reading() -> list[Measurement]:
    """Time to read events with `load_events`, beside the library's own read of the same file."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        events = _random_events(N_READ)
        for suffix, (write, read) in _LIBRARIES.items():
            path = Path(name) / f"events{suffix}"
            used = events[:N_READ_TEXT] if suffix in (".csv", ".txt") else events
            write(path, used)
            label = f"read {len(used) / 1e6:g} M events, {suffix}"
            ours_s, _ = best_seconds(partial(load_events, path), READ_REPEATS)
            theirs_s, _ = best_seconds(partial(read, path), READ_REPEATS)
            rows += [
                Measurement(label, ours_s, "s"),
                Measurement(f"{label}: the library's own read", theirs_s, "s"),
                Measurement(f"{label}: ratio", ours_s / theirs_s, "x", 1.3),
            ]
            if suffix == ".h5":
                bare, _ = best_seconds(partial(_columns_of_h5, path), READ_REPEATS)
                rows.append(Measurement(f"{label}: h5py's columns, not in one array", bare, "s"))
            path.unlink()
    return rows


def _random_events(n: int) -> Events:
    """Events of an HD sensor in random places, 1 us apart or 0."""
    rng = np.random.default_rng(0)
    events = np.empty(n, EVENT_DTYPE)
    events["t"] = 1_000_000 + np.cumsum(rng.integers(0, 2, n))
    events["x"], events["y"] = rng.integers(0, WIDTH, n), rng.integers(0, HEIGHT, n)
    events["p"] = rng.integers(0, 2, n)
    return events


def _write_with_faery(path: Path, events: Events) -> None:
    stream = faery.events_stream_from_array(events.view(faery.EVENTS_DTYPE), (WIDTH, HEIGHT))
    stream.to_file(path)


def _read_with_faery(path: Path) -> Events:
    """Join faery's blocks."""
    blocks = list(faery.events_stream_from_file(path, dimensions_fallback=(WIDTH, HEIGHT)))
    return np.concatenate(blocks)


def _columns_of_h5(path: Path) -> dict[str, NDArray[Any]]:
    with h5py.File(path) as file:
        return {field: file[f"events/{field}"][:] for field in FIELDS}


def _read_h5(path: Path) -> Events:
    with h5py.File(path) as file:
        events = np.empty(len(file["events/t"]), EVENT_DTYPE)
        for field in FIELDS:
            events[field] = file[f"events/{field}"][:]
    return events


def _read_with_pandas(path: Path, separator: str, per_us: float) -> Events:
    """Copy pandas' columns; `per_us` microseconds are a unit of the file's times."""
    table = pd.read_csv(path, sep=separator, names=list(FIELDS), skiprows=int(separator == ","))
    table["t"] *= per_us
    events = np.empty(len(table), EVENT_DTYPE)
    for field in FIELDS:
        events[field] = table[field]
    return events


_LIBRARIES: dict[str, tuple[Callable[[Path, Events], object], Callable[[Path], Events]]] = {
    ".h5": (lambda path, events: save_events_h5(path, events, WIDTH, HEIGHT), _read_h5),
    **dict.fromkeys((".aedat4", ".raw", ".dat", ".es"), (_write_with_faery, _read_with_faery)),
    ".csv": (
        lambda path, events: pd.DataFrame(events).to_csv(path, index=False),
        partial(_read_with_pandas, separator=",", per_us=1),
    ),
    ".txt": (
        lambda path, events: save_events_text(path, events, None, None),
        partial(_read_with_pandas, separator=r"\s+", per_us=1e6),
    ),
}
"""For each format, how it is written, and how its library reads it."""
