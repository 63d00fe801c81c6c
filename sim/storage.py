"""Writes a recording as a folder, which appears whole or not at all.

cam1.h5, cam2.h5     events/t, x, y, p; frames/t, frames/images; attributes width, height
rig.yaml             Kalibr camchain without extrinsics
rig_extrinsics.yaml  the same with the true extrinsics, for methods that are given them
truth.json           offset, pose, trajectory, and what the recording was made with

`record` simulates and writes each frame when its exposure closes; `save_recording` writes a
recording that is in memory. Both give the same bytes. Until it is whole, the folder is named
.NAME.HOST.PROCESS.RANDOM.partial in `partial_parent`. No process of any host gives a name twice, so
that a clean-up can tell what a killed process left from what another still writes.

A program that reads the HDF5 files with h5py imports hdf5plugin first, which has their codecs.
"""

import errno
import json
import os
import platform
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sim.arrays import FloatArray, IntArray
from sim.errors import SimError
from sim.recorded import Flight, OpenSink, Recording
from sim.recording import Progress, SimConfig, stream, unseen
from sim.scene.rig import Camera, Known, kalibr_yaml
from sim.sensor.kernels import EVENT_DTYPE

WriteMore = Callable[[Path, Flight], None]
"""Writes further files of a flight into its folder, before this appears under its name."""

_NAME_LENGTH = 32  # letters kept of a name, up to 4 bytes each: a file's name has 255 at most


def partial_path(parent: Path, name: str) -> Path:
    """Return a path in `parent` at which to write what will be called `name`; each call differs."""
    unique = f"{_host()}.{os.getpid()}.{os.urandom(16).hex()}"
    return parent / f".{name[:_NAME_LENGTH]}.{unique}.partial"


def partial_parent(out_dir: Path) -> Path:
    """Return the folder itself where it is there, since it may be a disk of its own, or a parent.

    Only an entry of one disk can be renamed to another.
    """
    out_dir = out_dir.resolve()
    return next(folder for folder in (out_dir, *out_dir.parents) if folder.exists())


@cache
def _host() -> str:
    """Name the scope of a process id: the machine, its last start and its namespace of ids."""
    node = platform.node()
    place = [node]
    with suppress(OSError):  # not Linux
        place.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
    with suppress(OSError):
        place.append(os.readlink("/proc/self/ns/pid"))
    name = re.sub(r"[^A-Za-z0-9-]", "-", node)[:20]
    return f"{name}-{sha256(repr(place).encode()).hexdigest()[:8]}"


_EVENTS_PER_CHUNK = 1 << 16
_FRAMES_PER_CHUNK = 16  # compressed together: what stands still is stored once
_MAX_CHUNK_BYTES = 1 << 24  # of frames
_LINE_BYTES = 32  # at most, of an event as text: 13 characters of its time, 4 of a coordinate
# HDF5 2.0 holds back 8 MB of each open dataset, here of frames and of one column; and its indices.
_SPARE_BYTES = 17 << 20

# As small as gzip after a byte shuffle, and seven times as fast: 28 ms for a million events.
_EVENT_CODEC = hdf5plugin.Blosc(cname="lz4", clevel=5, shuffle=hdf5plugin.Blosc.BITSHUFFLE)
# The codec finds repeats up to 2 MB back, and so the same pixels of the frame before: 90 MB, 20 s
# before a grainy background, become 5 MB; by gzip, frame by frame, 70 MB in 30 times the time.
_FRAME_CODEC = hdf5plugin.Zstd(clevel=3)


class CameraFiles:
    """A sink that writes one camera's files; the same content gives the same bytes."""

    def __init__(
        self, folder: Path, text: bool, camera: Camera, times_us: IntArray, exposure_s: float
    ) -> None:
        self.camera, self.n_events, self.n_frames = camera, 0, len(times_us)
        self._folder = folder
        self._text_path = folder / f"{camera.name}.txt" if text else None
        self._events: list[NDArray[Any]] = []
        _check_room(folder, times_us.nbytes)
        self.file = h5py.File(folder / f"{camera.name}.h5", "w")
        self.file.attrs["width"], self.file.attrs["height"] = camera.width, camera.height
        if not self.n_frames:
            return
        at_once = min(_FRAMES_PER_CHUNK, _MAX_CHUNK_BYTES // (camera.height * camera.width))
        chunk = (max(min(at_once, self.n_frames), 1), camera.height, camera.width)
        self._waiting = np.empty(chunk, np.uint8)
        self.file.create_dataset("frames/t", data=times_us)
        self.file["frames"].attrs["exposure_us"] = round(exposure_s * 1e6)
        about = {"shape": (self.n_frames, *chunk[1:]), "dtype": np.uint8, "chunks": chunk}
        self._dataset = self.file.create_dataset("frames/images", **about, **_FRAME_CODEC)

    def take_frame(self, k: int, image: NDArray[np.uint8]) -> None:
        """Write frame k, with the other frames of its chunk; frames must come in order."""
        at = k % len(self._waiting)
        self._waiting[at] = image
        if at == len(self._waiting) - 1 or k == self.n_frames - 1:
            _check_room(self._folder, self._waiting.nbytes)
            self._dataset[k - at : k + 1] = self._waiting[: at + 1]

    def add(self, events: NDArray[Any]) -> None:
        """Keep events until `close`: where they lie in the file must not depend on the batches."""
        self._events.append(events)
        self.n_events += len(events)

    def close(self) -> None:
        """Write the events and close the file."""
        if self._text_path is not None:
            _check_room(self._folder, self.n_events * _LINE_BYTES)
            save_events_text(self.camera, self._events, self._text_path)
        about: dict[str, Any] = {"shape": (self.n_events,)}
        if self.n_events:
            about |= {"chunks": (min(self.n_events, _EVENTS_PER_CHUNK),), **_EVENT_CODEC}
        for name in ("t", "x", "y", "p"):
            column = self.file.create_dataset(f"events/{name}", dtype=EVENT_DTYPE[name], **about)
            start = 0
            for block in self._events:  # not all at once, which would take as much memory again
                _check_room(self._folder, block[name].nbytes)
                column[start : start + len(block)] = block[name]
                start += len(block)
        self.file.close()
        self._events.clear()  # the next camera's need the room


def _check_room(folder: Path, n_bytes: int) -> None:
    """Raise OSError if these could fill the disk, which HDF5 answers by ending the process."""
    free, needed = shutil.disk_usage(folder).free, n_bytes + _SPARE_BYTES
    if free < needed:
        raise OSError(
            errno.ENOSPC,
            f"{free} bytes are free on this disk, and {needed} are needed: make room, or name "
            "another place",
        )


def save_events_text(camera: Camera, blocks: Iterable[NDArray[Any]], path: Path) -> None:
    """Write events as ESIM text: a line `width height`, then `t x y p` each, t in seconds."""
    with path.open("w", encoding="ascii") as file:
        file.write(f"{camera.width} {camera.height}\n")
        for events in blocks:
            for start in range(0, len(events), _EVENTS_PER_CHUNK):  # tuples take 14 times as much
                rows = events[start : start + _EVENTS_PER_CHUNK].tolist()
                file.writelines(f"{t / 1e6:.6f} {x} {y} {p}\n" for t, x, y, p in rows)


_DIGITS = 9  # decimals of the truth: nanometres and nanoseconds


def check_out_dir(out_dir: Path, ours: Path | None = None) -> None:
    """Raise SimError when a path is a file, or a folder that holds anything but `ours`."""
    try:
        if out_dir.exists() and not out_dir.is_dir():
            raise SimError(f"{out_dir} is a file: name a folder to write the recording to")
        there = list(out_dir.iterdir()) if out_dir.is_dir() else []
    except OSError as error:  # too long a name, or no permission
        raise SimError(f"cannot write the recording to {out_dir}: {error}") from error
    theirs = [path.name for path in there if path != ours]
    if theirs:
        raise SimError(
            f"{out_dir} is not empty, {theirs[0]} is in it: name a new folder, or empty it first"
        )


@dataclass(frozen=True)
class Recorded:
    """A recording that was written to a folder: its flight, and the counts of what it holds."""

    flight: Flight
    n_events: tuple[int, ...]  # of each camera
    n_frames: tuple[int, ...]  # of each camera


def record(
    config: SimConfig,
    seed: int,
    out_dir: Path,
    provenance: dict[str, Any],
    text: bool = False,
    progress: Progress = unseen,
    write_more: WriteMore | None = None,
) -> Recorded:
    """Simulate one flight and write it meanwhile; only one camera's events are in memory.

    The arguments and errors are those of `simulate` and `save_recording`.
    """
    film = partial(stream, config, seed, progress=progress)
    return _write(film, out_dir, provenance, text, write_more=write_more)


def save_recording(
    recording: Recording,
    out_dir: Path,
    provenance: dict[str, Any],
    text: bool = False,
    known: Known | None = None,
    write_more: WriteMore | None = None,
) -> Recorded:
    """Write a recording as a folder, new or empty, which appears only when all of it is written.

    `provenance`, what it was made with, goes into truth.json as it is; `text` writes the events as
    ESIM text (cam1.txt, ...) too; `known` holds the intrinsics that the rig files state in place of
    the true ones; `write_more` adds files. SimError when the folder is not empty or cannot be
    written.
    """

    def replay(open_sink: OpenSink) -> Flight:
        for camera in recording.cameras:
            sink = open_sink(camera.camera, camera.frames.times_us, camera.frames.exposure_s)
            for k, image in enumerate(camera.frames.images):
                sink.take_frame(k, image)
            sink.add(camera.events)
            sink.close()
        return recording

    return _write(replay, out_dir, provenance, text, known, write_more)


def _write(
    film: Callable[[OpenSink], Flight],
    out_dir: Path,
    provenance: dict[str, Any],
    text: bool,
    known: Known | None = None,
    write_more: WriteMore | None = None,
) -> Recorded:
    """Write what a flight's cameras record, and then all other files."""
    sinks: list[CameraFiles] = []
    with _whole_folder(out_dir) as partial, ExitStack() as open_files:

        def open_sink(*about: Any) -> CameraFiles:
            sinks.append(CameraFiles(partial, text, *about))
            open_files.callback(sinks[-1].file.close)
            return sinks[-1]

        flight = film(open_sink)
        n_events = tuple(sink.n_events for sink in sinks)
        for name, with_extrinsics in (("rig.yaml", False), ("rig_extrinsics.yaml", True)):
            (partial / name).write_text(kalibr_yaml(flight.rig, with_extrinsics, known))
        truth = _truth(flight, n_events) | {"provenance": provenance}
        # One line for each entry: json's own indentation takes ten times as long as all the rest.
        lines = (f"{json.dumps(name)}: {json.dumps(value)}" for name, value in truth.items())
        (partial / "truth.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
        if write_more is not None:
            write_more(partial, flight)
    return Recorded(flight, n_events, tuple(sink.n_frames for sink in sinks))


@contextmanager
def _whole_folder(out_dir: Path) -> Iterator[Path]:
    """Yield a folder to fill, which becomes `out_dir` if the block ends without an error."""
    check_out_dir(out_dir)
    try:
        out_dir = out_dir.resolve()
        partial = partial_path(partial_parent(out_dir), out_dir.name)
        partial.mkdir()
        try:
            yield partial
            check_out_dir(out_dir, partial)  # the block may have taken minutes
            if out_dir.is_dir():  # keep it: it may be somebody's working directory
                for path in sorted(partial.iterdir()):
                    path.rename(out_dir / path.name)
            else:
                out_dir.parent.mkdir(parents=True, exist_ok=True)
                partial.rename(out_dir)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise SimError(f"cannot write the recording to {out_dir}: {error}") from error


def _truth(flight: Flight, n_events: tuple[int, ...]) -> dict[str, Any]:
    """Return the content of truth.json, with frames and units in the names."""
    truth, jump = flight.truth, flight.truth.drift.jump
    quaternions = Rotation.from_matrix(truth.T_W_B[:, :3, :3]).as_quat()
    return {
        "t_d_s": truth.t_d_s,
        "skew_ppm": truth.drift.skew_ppm,
        "t_ref_s": truth.drift.t_ref_s,
        "clock_jump": jump and dict(zip(("at_s", "size_s"), jump, strict=True)),
        "R": truth.R.tolist(),
        "t": truth.t.tolist(),
        "baseline_m": truth.baseline_m,
        "conventions": "t_cam2 = t_cam1 + t_d + skew (t_cam1 - t_ref), and a jump's size from then"
        " on; x2 = R x1 + t, |t| = 1; times on camera 1's clock",
        "cameras": {
            camera.name: {
                "time_offset_s": camera.time_offset_s,
                "T_C_W": camera.T_C_W.tolist(),
                "n_events": n,
                "drone_px": _rounded(centres),
            }
            for camera, n, centres in zip(
                flight.rig.cameras, n_events, truth.centres_px, strict=True
            )
        },
        "times_s": _rounded(truth.times_s),
        "drone_position_W_m": _rounded(truth.T_W_B[:, :3, 3]),
        "drone_quaternion_W_B_xyzw": _rounded(quaternions),
        "n_instants": flight.n_instants,
        "gl": asdict(flight.gl) if flight.gl else None,
        # How far the native renderer was from OpenGL where both drew; 0 instants: not compared.
        "render_check": {
            "n_instants": flight.check.n_instants,
            "max_difference": round(flight.check.max_difference, _DIGITS),
            "mean_difference": round(flight.check.mean_difference, _DIGITS),
        },
    }


def _rounded(values: FloatArray) -> list[Any]:
    """Return nested lists, with null where there is no value: NaN is not JSON."""
    rounded = np.round(values, _DIGITS).astype(object)
    rounded[np.isnan(values)] = None
    result: list[Any] = rounded.tolist()
    return result
