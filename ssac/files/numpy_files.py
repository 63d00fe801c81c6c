"""NumPy files of events: a structured array (.npy), or an archive of arrays (.npz).

Fields are in any order, such as the Metavision SDK's. An archive has an array `events`, or an array
for each of t, x, y and p, and perhaps the sensor's `width` and `height`. Nothing is unpickled.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Events
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, EventFile, events_from_arrays, events_of_array
from ssac.files.damage import STRICT, Reading, checked_file, noting_unit
from ssac.files.readable import readable, side_px
from ssac.files.whole_file import check_writable, whole_file


def load_events_numpy(path: Path, reading: Reading = STRICT) -> EventFile:
    """Read events that NumPy saved."""
    with readable(path, f"a complete {path.suffix} file of NumPy"):
        if path.suffix.lower() == ".npy":
            arrays = {"events": np.array(np.load(path, mmap_mode="r", allow_pickle=False))}
        else:
            with np.load(path, allow_pickle=False) as archive:
                wanted = {"events", *"txyp", "width", "height"}.intersection(archive.files)
                arrays = {name: archive[name] for name in wanted}
    width, height = (
        side_px(arrays[name], f"{name} must be a number of", path) if name in arrays else None
        for name in ("width", "height")
    )
    file = checked_file(_events(arrays, path), (width, height), path, reading)
    return noting_unit(file, path, "microseconds")


def save_events_numpy(
    path: Path | str, events: Events, width: int | None, height: int | None
) -> None:
    """Write events; an archive (.npz) also holds the sensor's size [px] where it is known."""
    path = Path(path)
    check_writable(path, EVENT_DTYPE.itemsize * len(events))
    with whole_file(path) as temporary, temporary.open("wb") as file:
        if path.suffix.lower() == ".npy":
            np.save(file, events)
        else:
            sizes = {"width": width, "height": height}
            arrays = {name: np.asarray(side) for name, side in sizes.items() if side is not None}
            np.savez(file, allow_pickle=False, events=events, **arrays)


def _events(arrays: dict[str, NDArray[Any]], path: Path) -> Events:
    if "events" in arrays and arrays["events"].ndim == 1:
        return events_of_array(arrays["events"], str(path))
    if all(field in arrays for field in "txyp"):
        t, x, y, p = (arrays[field] for field in "txyp")
        return events_from_arrays(t, x, y, p, name=str(path))
    raise SsacError(
        f"{path}: expected a structured array with the fields t [us], x, y and p (in an archive as"
        " `events`, or an array for each of them): save it so"
    )
