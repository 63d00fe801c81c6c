"""What one camera records in, its HDF5 file, and its events as text, out.

Who reads the HDF5 files with h5py imports hdf5plugin before: it has the codecs, blosc for the
events and zstandard for the frames.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
from numpy.typing import NDArray

from sim.scene.camera import Camera
from sim.sensor.buffer import EVENT_DTYPE

_EVENTS_PER_CHUNK = 1 << 16
_FRAMES_PER_CHUNK = 16  # compressed together: what stands still is stored once
_MAX_CHUNK_BYTES = 1 << 24  # of frames

# As small as gzip after a byte shuffle, and seven times as fast: 28 ms for a million events.
_EVENT_CODEC = hdf5plugin.Blosc(cname="lz4", clevel=5, shuffle=hdf5plugin.Blosc.BITSHUFFLE)
# Finds again what lies up to 2 MB back, and so the same pixels of the frame before: of 90 MB, 20 s
# before a grainy background, it leaves 5, and gzip, frame by frame, 70 in 30 times the time.
_FRAME_CODEC = hdf5plugin.Zstd(clevel=3)


class CameraFiles:
    """A sink that writes one camera's files; the same content gives the same bytes.

    A context manager, so that its file is closed whatever happens.
    """

    def __init__(
        self,
        folder: Path,
        text: bool,
        camera: Camera,
        times_us: NDArray[np.int64],
        exposure_s: float,
    ) -> None:
        self.camera = camera
        self.n_events, self.n_frames = 0, len(times_us)
        self._text_path = folder / f"{camera.name}.txt" if text else None
        self._events: list[NDArray[Any]] = []
        self._file = h5py.File(folder / f"{camera.name}.h5", "w")
        self._file.attrs["width"], self._file.attrs["height"] = camera.width, camera.height
        self.images = _ImageChunks(self._file, camera, times_us, exposure_s)

    def __enter__(self) -> "CameraFiles":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, events: NDArray[Any]) -> None:
        """Keep events: their columns must not lie between frames wherever these happen to end."""
        self._events.append(events)
        self.n_events += len(events)

    def close(self) -> None:
        """Write the events and close the file."""
        columns = {
            name: self._file.create_dataset(
                f"events/{name}",
                shape=(self.n_events,),
                dtype=EVENT_DTYPE[name],
                **({"chunks": (min(self.n_events, _EVENTS_PER_CHUNK),)} | dict(_EVENT_CODEC)
                   if self.n_events else {}),
            )
            for name in ("t", "x", "y", "p")
        }  # fmt: skip
        start = 0
        for events in _regrouped(self._events, _EVENTS_PER_CHUNK):
            for name, column in columns.items():
                column[start : start + len(events)] = events[name]
            start += len(events)
        if self._text_path is not None:
            save_events_text(self.camera, self._events, self._text_path)
        self._events = []
        self._file.close()


class _ImageChunks:
    """Writes frames, given in their order, to an open HDF5 file."""

    def __init__(
        self, file: h5py.File, camera: Camera, times_us: NDArray[np.int64], exposure_s: float
    ) -> None:
        self._n = len(times_us)
        if not self._n:
            return
        shape = (camera.height, camera.width)
        at_once = min(_FRAMES_PER_CHUNK, _MAX_CHUNK_BYTES // (shape[0] * shape[1]), self._n)
        self._waiting = np.empty((max(at_once, 1), *shape), np.uint8)
        file.create_dataset("frames/t", data=times_us)
        file["frames"].attrs["exposure_us"] = round(exposure_s * 1e6)
        self._dataset = file.create_dataset(
            "frames/images",
            shape=(self._n, *shape),
            dtype=np.uint8,
            chunks=self._waiting.shape,
            **_FRAME_CODEC,
        )

    def __setitem__(self, k: int, image: NDArray[np.uint8]) -> None:
        at = k % len(self._waiting)
        self._waiting[at] = image
        if at == len(self._waiting) - 1 or k == self._n - 1:
            self._dataset[k - at : k + 1] = self._waiting[: at + 1]


def save_events_text(camera: Camera, blocks: Iterable[NDArray[Any]], path: Path) -> None:
    """Write events, block after block, as ESIM text.

    A line `width height`, then `t x y p` each, t in seconds.
    """
    with path.open("w", encoding="ascii") as file:
        file.write(f"{camera.width} {camera.height}\n")
        for events in blocks:
            seconds, microseconds = np.divmod(np.abs(events["t"]), 1_000_000)
            sign = np.where(events["t"] < 0, "-", "")
            rows = zip(
                sign, seconds, microseconds, events["x"], events["y"], events["p"], strict=True
            )
            file.writelines(f"{m}{s}.{us:06d} {x} {y} {p}\n" for m, s, us, x, y, p in rows)


def _regrouped(blocks: Iterable[NDArray[Any]], size: int) -> Iterator[NDArray[Any]]:
    """Cut and join blocks of any length to blocks of one length, but for the last."""
    parts: list[NDArray[Any]] = []
    n_waiting = 0
    for block in blocks:
        start = 0
        while n_waiting + len(block) - start >= size:
            stop = start + size - n_waiting
            piece = block[start:stop]
            yield _joined([*parts, piece]) if parts else piece
            start, parts, n_waiting = stop, [], 0
        parts.append(block[start:])
        n_waiting += len(block) - start
    if n_waiting:
        yield _joined(parts)


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Join events as plain bytes: NumPy copies records field by field."""
    as_bytes = [part.view(f"V{part.itemsize}") for part in parts]
    joined: NDArray[Any] = np.concatenate(as_bytes).view(EVENT_DTYPE)
    return joined
