"""A good input of each kind, and how a user's command would read it.

Reading returns how many events there are, or rows, or 1: a damaged input is held against that.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
from faery import EVENTS_DTYPE
from faery.file_encoder import events_to_file
from numpy.typing import NDArray

from experiments.lab.bridge import check_mesh
from experiments.lab.cache import BRIGHTNESS_CODE, Cache, is_sound, save_sums
from experiments.lab.grid import CONFIGS, load_config
from experiments.worlds.bound import load_truth
from sim.scene.flyers import quadrotor
from sim.scene.trajectory import trajectory_from_csv
from ssac.arrays import Events
from ssac.events import EVENT_DTYPE
from ssac.files.damage import STRICT, Reading
from ssac.files.event_files import load_events
from ssac.files.hdf5 import save_events_h5
from ssac.files.rigs import load_rig
from ssac.files.text import save_events_text
from ssac.files.track_files import load_track, save_track
from ssac.points import PointTrack, check_track

WIDTH, HEIGHT = 346, 260
N_EVENTS = 3000

_RIG = """\
cam0:
  camera_model: pinhole
  intrinsics: [200.0, 201.0, 173.0, 130.0]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0.0005, -0.0005]
  resolution: [346, 260]
  readout_s: 0.01
cam1:
  camera_model: pinhole
  intrinsics: [200.0, 201.0, 173.0, 130.0]
  distortion_model: equidistant
  distortion_coeffs: [-0.1, 0.01, 0.0005, -0.0005]
  resolution: [346, 260]
  T_cn_cnm1:
  - [0.0, 0.0, 1.0, -5.0]
  - [0.0, 1.0, 0.0, 0.0]
  - [-1.0, 0.0, 0.0, 5.0]
  - [0.0, 0.0, 0.0, 1.0]
"""


@dataclass(frozen=True)
class Input:
    """A file that is whole, and how it or a damaged copy is used."""

    kind: str
    path: Path
    use: Callable[[Path], int]
    good: int = 1  # what `use` returns for the whole one
    is_text: bool = True  # so that it is damaged by its words too
    has_end: bool = True  # no: a truncated one is a shorter recording
    use_damaged: Callable[[Path], int] | None = None  # the same by who allows for damage


def whole_inputs(folder: Path) -> list[Input]:
    """Write a good input of each kind."""
    folder.mkdir(parents=True)
    events = _events()
    found = [*_event_files(folder, events), *_small_files(folder), *_entries(folder, events)]
    for one in found:
        if one.use(one.path) != one.good:
            raise AssertionError(f"{one.kind}: the whole one must be read as it is")
    return found


def _events() -> Events:
    """Events of a second as of a camera that was switched on 20 s before: an object and noise."""
    rng = np.random.default_rng(0)
    events = np.empty(N_EVENTS, EVENT_DTYPE)
    events["t"] = 20_000_000 + np.sort(rng.integers(0, 1_000_000, N_EVENTS))
    middle = 60 + 200 * np.linspace(0.0, 1.0, N_EVENTS)
    events["x"] = np.clip(rng.normal(middle, 10.0), 0, WIDTH - 1)
    events["y"] = np.clip(rng.normal(130.0, 10.0, N_EVENTS), 0, HEIGHT - 1)
    events["p"] = rng.integers(0, 2, N_EVENTS)
    return events


def _event_files(folder: Path, events: Events) -> list[Input]:
    forgiving = partial(_n_events, reading=Reading(allow_damaged=True, sort=True))
    inputs = []
    for kind, (name, write) in _EVENT_FILES.items():
        write(folder / name, events)
        is_text, has_end = kind in ("esim text", "csv"), kind.startswith(("hdf5", "aedat4"))
        inputs.append(
            Input(kind, folder / name, _n_events, len(events), is_text, has_end, forgiving)
        )
    return inputs


def _n_events(path: Path, reading: Reading = STRICT) -> int:
    return len(load_events(path, reading).events)


def _save_with_faery(path: Path, events: Events, version: Any = None) -> None:
    blocks = iter([events.astype(EVENTS_DTYPE)])
    starts_at_0 = path.suffix != ".es"
    events_to_file(blocks, path, dimensions=(WIDTH, HEIGHT), version=version, zero_t0=starts_at_0)


def _save_dsec(path: Path, events: Events) -> None:
    with h5py.File(path, "w") as file:
        columns = {name: events[name] for name in "txyp"}
        columns["t"] = (events["t"] - 20_000_000).astype(np.uint32)
        for name, column in columns.items():
            blosc = hdf5plugin.Blosc(cname="zstd")
            file.create_dataset(f"events/{name}", data=column, chunks=(500,), **blosc)
        file["t_offset"] = 20_000_000


def _save_prophesee(path: Path, events: Events) -> None:
    with h5py.File(path, "w") as file:
        dtype = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")], align=True)
        data = np.zeros(len(events), dtype)  # with its padding, which is written too
        for name in "xypt":
            data[name] = events[name]
        file.create_dataset("CD/events", data=data, chunks=(500,), compression="gzip")
        file.attrs["geometry"] = np.bytes_(f"{WIDTH}x{HEIGHT}")


def _save_evt2(path: Path, events: Events) -> None:
    """Write a TIME_HIGH every 16 us, as cameras do, up to the last event."""
    words: list[int] = []
    beat = 0
    for t, x, y, p in events.tolist():
        beat = max(beat, (t >> 4) - 4)
        words += [0x8 << 28 | passed >> 2 for passed in range(beat, (t >> 4) + 1)]
        beat = max(beat, (t >> 4) + 1)
        words.append(p << 28 | (t & 0x3F) << 22 | x << 11 | y)
    _save_words(path, 2, np.array(words, "<u4"))


def _save_evt3(path: Path, events: Events) -> None:
    """Write a TIME_HIGH, of 4.096 ms, eight times each, from the start of the camera on."""
    words: list[int] = []
    beat = 0
    for t, x, y, p in events.tolist():
        words += [0x8 << 12 | passed >> 3 & 0xFFF for passed in range(beat, (t >> 9) + 1)]
        beat = max(beat, (t >> 9) + 1)
        words += [0x6 << 12 | t & 0xFFF, y, 0x2 << 12 | p << 11 | x]
    _save_words(path, 3, np.array(words, "<u2"))


def _save_words(path: Path, version: int, words: NDArray[np.unsignedinteger[Any]]) -> None:
    size = f"width={WIDTH};height={HEIGHT}"
    header = f"% evt {version}.0\n% format EVT{version};{size}\n% end\n"
    path.write_bytes(header.encode() + words.tobytes())


_EVENT_FILES: Mapping[str, tuple[str, Callable[[Path, Events], None]]] = {
    "hdf5": ("plain.h5", lambda path, events: save_events_h5(path, events, WIDTH, HEIGHT)),
    "hdf5 dsec": ("dsec.h5", _save_dsec),
    "hdf5 prophesee": ("prophesee.hdf5", _save_prophesee),
    "esim text": ("esim.txt", lambda path, events: save_events_text(path, events, WIDTH, HEIGHT)),
    "csv": ("events.csv", _save_with_faery),
    "aedat4": ("events.aedat4", _save_with_faery),
    "evt2": ("evt2.raw", partial(_save_with_faery, version="evt2")),
    "evt3": ("evt3.raw", partial(_save_with_faery, version="evt3")),
    "evt2 camera": ("camera_evt2.raw", _save_evt2),
    "evt3 camera": ("camera_evt3.raw", _save_evt3),
    "dat": ("events.dat", partial(_save_with_faery, version="dat2")),
    "es": ("events.es", _save_with_faery),
}
"""By kind, the file and how it is written."""


def _small_files(folder: Path) -> list[Input]:
    times_s = np.arange(250) / 25.0
    points = np.column_stack([100.0 + 10.0 * times_s, 130.0 + 5.0 * np.sin(times_s)])
    save_track(folder / "track.csv", PointTrack(times_s, points, np.full(len(times_s), 0.3)))
    flight = "".join(f"{t:.3f},{t:.4f},0.5,1.0,0,0,0,1\n" for t in 0.1 * np.arange(40))
    (part,) = quadrotor().parts
    vertices = "".join(f"v {x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in part.vertices_B_m)
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in part.faces + 1)
    truth = {
        "times_s": times_s.tolist(),
        "drone_position_W_m": np.column_stack([points, times_s]).tolist(),
        "cameras": {name: {"T_C_W": np.eye(4).tolist()} for name in ("cam1", "cam2")},
    }
    texts: dict[str, tuple[str, str, Callable[[Path], object]]] = {
        "rig": ("rig.yaml", _RIG, load_rig),
        "trajectory": ("flight.csv", f"t,x,y,z,qx,qy,qz,qw\n{flight}", trajectory_from_csv),
        "grid": ("grid.toml", (CONFIGS / "ablation_window.toml").read_text("utf-8"), load_config),
        "mesh": ("drone.obj", vertices + faces, check_mesh),
        "truth": ("truth.json", json.dumps(truth), lambda path: load_truth(path.parent)),
    }
    for name, text, _ in texts.values():
        (folder / name).write_text(text, encoding="utf-8")
    return [
        Input("track", folder / "track.csv", _n_points, len(times_s), has_end=False),
        *(Input(kind, folder / name, partial(_used, read))
          for kind, (name, _, read) in texts.items()),
    ]  # fmt: skip


def _n_points(path: Path) -> int:
    track = load_track(path)
    check_track(track, WIDTH, HEIGHT, str(path))
    return len(track)


def _used(read: Callable[[Path], object], path: Path) -> int:
    read(path)
    return 1


_ROW = {"status": "ok", "reason": "", "t_d_error_ms": 0.12345, "n_samples": 348}
_MEANS = {
    name: np.arange(50) if "times" in name else np.arange(50) / 50.0
    for name in ("cam1", "times1_us", "cam2", "times2_us")
}
_TOLD = BRIGHTNESS_CODE, [*_MEANS], lambda: _MEANS


def _entries(folder: Path, events: Events) -> list[Input]:
    """Entries of a cache: a damaged one must not be used."""
    cache = Cache(folder / "cache")
    cache.save_run("abcd", _ROW)
    made = folder / "cache" / "recordings" / "abcd"
    cache.told("brightness", made, *_TOLD)
    (means,) = (folder / "cache" / "brightness").iterdir()
    made.mkdir(parents=True)
    save_events_h5(made / "cam1.h5", events, WIDTH, HEIGHT)
    row = folder / "cache" / "runs" / "ab" / "abcd.json"
    return [
        Input("cached row", row, _use_row, is_text=False),
        Input("cached brightness", means, _use_brightness, is_text=False),
        Input("cached recording", made / "cam1.h5", _use_recording, is_text=False),
    ]


def _use_row(path: Path) -> int:
    """Read a row back: the same one, or none."""
    cache = Cache(path.parent / "cache")
    put = cache.folder / "runs" / "ab" / "abcd.json"
    put.parent.mkdir(parents=True, exist_ok=True)
    put.write_bytes(path.read_bytes())
    row = cache.load_run("abcd")
    if row not in (None, _ROW):
        raise AssertionError("a damaged row is used")
    return 1


def _use_brightness(path: Path) -> int:
    cache = Cache(path.parent / "cache")
    recording = cache.folder / "recordings" / "abcd"
    cache.told("brightness", recording, *_TOLD)
    (put,) = (cache.folder / "brightness").iterdir()
    put.write_bytes(path.read_bytes())
    for name, kept in cache.told("brightness", recording, *_TOLD).items():
        if not np.array_equal(kept, _MEANS[name]):
            raise AssertionError("damaged means are used")
    return 1


def _use_recording(path: Path) -> int:
    """Look at a recording whose checksums are those of the whole one."""
    whole = path.parent / "recording"
    whole.mkdir(exist_ok=True)
    save_events_h5(whole / "cam1.h5", _events(), WIDTH, HEIGHT)
    save_sums(whole)
    expected = (whole / "cam1.h5").read_bytes()
    (whole / "cam1.h5").write_bytes(path.read_bytes())
    if is_sound(whole) and path.read_bytes() != expected:
        raise AssertionError("a damaged recording is used")
    return 1
