"""How fast event files of every format are read, beside their libraries' own read."""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import faery
import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.machine.measurement import Measurement, best_seconds
from ssac.events import EVENT_DTYPE
from ssac.files.event_files import load_events
from ssac.files.hdf5 import FIELDS, save_events_h5
from ssac.files.text import save_events_text

REPEATS = 3  # the best of as many is taken
N_READ = 10_000_000
N_READ_TEXT = 2_000_000  # text is slow to write
FAERY_SUFFIXES = (".aedat4", ".raw", ".dat", ".es")
WIDTH, HEIGHT = 1280, 720


def bench_reading() -> list[Measurement]:
    """Time to read events with `load_events`, beside the library's own read of the same file.

    The library's own read ends, as ours does, with all events in one array in memory: faery's
    blocks joined; h5py's and pandas' four columns copied into the structured array.
    """
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        events = _random_events(N_READ)
        for suffix, (write, read) in _LIBRARIES.items():
            path = folder / f"events{suffix}"
            used = events[:N_READ_TEXT] if suffix in (".csv", ".txt") else events
            write(path, used)
            label = f"read {len(used) / 1e6:g} M events, {suffix}"
            rows += _compare(label, partial(load_events, path), partial(read, path))
            if suffix == ".h5":
                bare, _ = best_seconds(partial(_bare_columns, path), REPEATS)
                rows.append(Measurement(f"{label}: h5py's columns, not in one array", bare, "s"))
            path.unlink()
    return rows


def _compare(
    label: str, ours: Callable[[], object], theirs: Callable[[], object]
) -> list[Measurement]:
    ours_s, _ = best_seconds(ours, REPEATS)
    theirs_s, _ = best_seconds(theirs, REPEATS)
    return [
        Measurement(label, ours_s, "s"),
        Measurement(f"{label}: the library's own read", theirs_s, "s"),
        Measurement(f"{label}: ratio", ours_s / theirs_s, "x", 1.3),
    ]


def _random_events(n: int) -> NDArray[np.void]:
    """Events of an HD sensor in random places, 1 us apart or 0."""
    rng = np.random.default_rng(0)
    events = np.empty(n, EVENT_DTYPE)
    events["t"] = 1_000_000 + np.cumsum(rng.integers(0, 2, n))
    events["x"], events["y"] = rng.integers(0, WIDTH, n), rng.integers(0, HEIGHT, n)
    events["p"] = rng.integers(0, 2, n)
    return events


def _write_h5(path: Path, events: NDArray[np.void]) -> None:
    save_events_h5(path, events, WIDTH, HEIGHT)


def _write_with_faery(path: Path, events: NDArray[np.void]) -> None:
    stream = faery.events_stream_from_array(events.view(faery.EVENTS_DTYPE), (WIDTH, HEIGHT))
    stream.to_file(path)


def _write_csv(path: Path, events: NDArray[np.void]) -> None:
    pd.DataFrame(events).to_csv(path, index=False)


def _write_text(path: Path, events: NDArray[np.void]) -> None:
    save_events_text(path, events, None, None)


def _columns_by_h5py(path: Path) -> NDArray[np.void]:
    with h5py.File(path) as file:
        events = np.empty(len(file["events/t"]), EVENT_DTYPE)
        for field in FIELDS:
            events[field] = file[f"events/{field}"][:]
    return events


def _bare_columns(path: Path) -> list[NDArray[Any]]:
    with h5py.File(path) as file:
        return [file[f"events/{field}"][:] for field in FIELDS]


def _read_with_faery(path: Path) -> NDArray[np.void]:
    blocks = list(faery.events_stream_from_file(path, dimensions_fallback=(WIDTH, HEIGHT)))
    return np.concatenate(blocks)


def _columns_by_pandas(path: Path, separator: str) -> NDArray[np.void]:
    has_header = separator == ","
    table = pd.read_csv(path, sep=separator, names=list(FIELDS), skiprows=int(has_header))
    events = np.empty(len(table), EVENT_DTYPE)
    for field in FIELDS:
        events[field] = table[field] if has_header or field != "t" else table[field] * 1e6
    return events


Write = Callable[[Path, NDArray[np.void]], None]
Read = Callable[[Path], NDArray[np.void]]

_LIBRARIES: dict[str, tuple[Write, Read]] = {
    ".h5": (_write_h5, _columns_by_h5py),
    **dict.fromkeys(FAERY_SUFFIXES, (_write_with_faery, _read_with_faery)),
    ".csv": (_write_csv, partial(_columns_by_pandas, separator=",")),
    ".txt": (_write_text, partial(_columns_by_pandas, separator=r"\s+")),
}
"""For each format, how it is written, and how its library reads it."""
