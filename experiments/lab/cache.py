"""What earlier runs made, recordings and the rows that were measured on them, and who makes what.

Everything is addressed by its content: by all parameters and by all code that makes it
(`experiments.lab.code`), so a change of either makes a new entry and never returns an old one.

    recordings/<key>/     as sim.storage writes them, with t_d = 0: ordinary input of `ssac sync`
    recordings/<key>.sha256  checksums of its files: it is not there without them
    brightness/<key>.npz  the mean of each of their frames
    denoised/<key>.npz    the events that denoising leaves
    runs/<ab>/<key>.json  one measured row, and its checksum
    damaged/              entries that were not what had been written

A disk that was full, a machine that was killed or a flipped bit leave entries that can
be read and are wrong, so each is held against its checksum before it is used.

What is being made is locked by a file that its holder touches now and then. A lock is free when its
holder is a process of this host that has ended, or when nobody touched it for `LAPSES_S`. Locks
save work, and nothing rests on them: should two processes make one entry, either is whole.
"""

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from filelock import SoftFileLease, Timeout
from numpy.typing import NDArray

from experiments.lab.code import SIM_PACKAGES, SSAC_PACKAGES, code_digest, package_versions
from experiments.lab.results import save_text, sha256
from sim.recording import SimConfig
from sim.render.gl_context import open_context
from sim.storage import record
from ssac.cli.progress import say
from ssac.errors import SsacError, WriteError
from ssac.files.whole_file import check_folder, remove_left_over, whole_file

DEFAULT_FOLDER = Path("cache")

ASIDE = "damaged"
"""Folder of the cache that damaged entries are moved to, for who wants to know what happened."""

RECORDED = ("recordings", "brightness", "denoised")
"""Folders of recordings, and of what is told of them once for all methods."""

# What makes an entry: nothing of `experiments`, so that recordings outlive its edits.
RECORDING_CODE = ("sim.recording", "sim.storage")
BRIGHTNESS_CODE = ("ssac.methods.correlations", "ssac.files.hdf5")
DENOISED_CODE = ("ssac.track.clean", "ssac.files.hdf5")

CLAIM = ".claim"

LAPSES_S = 120.0
"""Longer than a client of a network disk may show old times (NFS: 60 s), and a touch or two."""

ASK_AGAIN_S = 1.0
"""How long those wait who find something locked."""


Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Cache:
    """What earlier runs made, in one folder, which processes of several hosts may share."""

    folder: Path = DEFAULT_FOLDER
    simulated: list[Path] = field(default_factory=list, compare=False)  # by this object
    sound: set[Path] = field(default_factory=set, compare=False)  # recordings it has looked at

    def recording_folder(self, config: SimConfig, seed: int) -> Path:
        """Give the folder of a recording, simulating it first if it is not there yet.

        Its clocks are equal, whatever the config's `t_d_s`. SimError when it cannot be simulated,
        WriteError when it cannot be written, or there is no room for it.
        """
        config = replace(config, t_d_s=0.0)
        folder = self._recording_path(config, seed)
        while not self._is_kept(folder):
            with claimed(folder.with_name(f".{folder.name}{CLAIM}")) as is_ours:
                if not is_ours:  # another process makes it
                    time.sleep(ASK_AGAIN_S)
                elif not self._is_kept(folder):
                    self._simulate(config, seed, folder)
        return folder

    def told(
        self,
        kind: str,
        recording: Path,
        code: tuple[str, ...],
        names: Sequence[str],
        tell: Callable[[], Arrays],
        inputs: Any = None,
    ) -> Arrays:
        """Give arrays of some names, one kind of RECORDED, that some code tells of a recording.

        Once for all methods: to read all frames takes longer than most of them do, and to tell
        noise, reading the events included, a quarter of the time that all of them take.
        """
        by = code_digest(*code), package_versions(SSAC_PACKAGES)
        key = _digest(recording.name, by, names, inputs)
        path = self.folder / kind / f"{key}.npz"
        if path.exists():
            try:
                with np.load(path) as kept:  # whose parts have checksums
                    return {name: kept[name] for name in names}
            except Exception:  # of zip, of the format, of what stands in it
                self._set_aside(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        told = tell()
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **told)  # type: ignore[arg-type]
        return told

    def load_run(self, key: str) -> dict[str, Any] | None:
        """Return a run's row; None when there is none."""
        path = self._run_path(key)
        if not path.exists():
            return None
        row = row_of_text(path.read_bytes())
        if row is None:
            self._set_aside(path)
        return row

    def save_run(self, key: str, row: dict[str, Any]) -> None:
        """Keep a run's row, unless it is there already."""
        path = self._run_path(key)
        if path.exists():
            return
        save_text(path, text_of_row(row))

    def claim_of_runs(self, recordings: str) -> Path:
        """Name the lock of all runs on recordings, as `schedule.recordings_key` names these."""
        return self.folder / "runs" / f".{recordings}{CLAIM}"

    def tidy(self) -> None:
        """Remove what killed processes left half-made."""
        runs = self.folder / "runs"
        for folder in (*(self.folder / name for name in RECORDED), runs, *runs.glob("*")):
            remove_left_over(folder)
            remove_lapsed(folder)

    def size_bytes(self) -> int:
        """Return the size of all entries."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file())

    def _is_kept(self, folder: Path) -> bool:
        """Whether a recording is there and whole; a damaged one is moved aside."""
        if folder in self.sound and folder.exists():
            return True
        if not (folder.exists() and _sums_path(folder).exists()):
            return False
        if not is_sound(folder):
            self._set_aside(folder)
            return False
        self.sound.add(folder)
        return True

    def _simulate(self, config: SimConfig, seed: int, folder: Path) -> None:
        check_folder(folder.parent, recording_bytes(config))
        if folder.exists():  # and has no checksums: who made it was killed just then
            self._set_aside(folder)
        try:
            record(config, seed, folder, {"config": content(config), "seed": seed})
            save_sums(folder)
            self.sound.add(folder)
            self.simulated.append(folder)
        except Exception as error:
            if isinstance(error.__cause__, OSError):
                raise WriteError(str(error)) from error
            if not folder.exists():  # unless another process was first, its lock having lapsed
                raise

    def _set_aside(self, path: Path) -> None:
        """Move a damaged entry, and its checksums, to where it is not used, and say so."""
        unique = os.urandom(4).hex()
        for one in (path, _sums_path(path)):
            aside = self.folder / ASIDE / f"{one.stem}.{unique}{one.suffix}"
            try:
                aside.parent.mkdir(parents=True, exist_ok=True)
                one.rename(aside)
            except FileNotFoundError:  # it has none, or another process was faster
                continue
            except OSError as error:
                raise SsacError(
                    f"{one}: is damaged and cannot be moved aside ({error.strerror}): delete it"
                ) from error
            if one == path:
                say(f"{path} was damaged: moved to {aside}, and made again")

    def _recording_path(self, config: SimConfig, seed: int) -> Path:
        return self.folder / "recordings" / recording_key(config, seed)

    def _run_path(self, key: str) -> Path:
        return self.folder / "runs" / key[:2] / f"{key}.json"


# --- What an entry depends on ---


def recording_key(config: SimConfig, seed: int) -> str:
    """Name a recording by all that it depends on: if OpenGL draws it, this machine's driver too."""
    drawn_with_gl = config.render.renderer == "pyrender"
    context = open_context(config.render.backend) if drawn_with_gl else None
    return _digest(
        content(replace(config, t_d_s=0.0)),
        seed,
        code_digest(*RECORDING_CODE, type(config).__module__),  # whose scene it is
        package_versions(SIM_PACKAGES),
        content(context),
    )


def run_key(recordings: tuple[str, ...], inputs: Any, code: tuple[str, ...]) -> str:
    """Name a row by the keys of its recordings, all else that goes in, and code as of `code_of`."""
    return _digest(recordings, content(inputs), code_digest(*code), package_versions(SSAC_PACKAGES))


def content(value: Any) -> Any:
    """Turn a configuration into what JSON holds, with the digest of each file in its place."""
    if isinstance(value, Path):
        return sha256(value) if value.exists() else str(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {one.name: content(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, (list, tuple)):
        return [content(item) for item in value]
    return value


def _digest(*parts: Any) -> str:
    return _sha256(json.dumps(parts, sort_keys=True))[:24]


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def recording_bytes(config: SimConfig) -> int:
    """Bound the space of a recording: a disk that runs full while HDF5 writes ends the process."""
    frames = 0.1 * config.frames.rate_hz * config.resolution[0] * config.resolution[1]  # as coded
    events = 200_000.0  # of 60,000 events a second and camera, at 3 bytes each
    truth = 100_000.0
    return round(config.spline.duration_s * (2.0 * (frames + events) + truth))


# --- Whether an entry is what was written ---


def save_sums(folder: Path) -> None:
    """Note the checksums of a folder's files beside it."""
    save_text(_sums_path(folder), json.dumps(_sums(folder)))


def is_sound(folder: Path) -> bool:
    """Whether a folder's files are those that were written."""
    try:
        noted = json.loads(_sums_path(folder).read_text(encoding="utf-8"))
    except ValueError:
        return False
    return bool(noted == _sums(folder))


def text_of_row(row: dict[str, Any]) -> str:
    """Give the text of an entry that holds one measured row."""
    return json.dumps({"row": row, "sha256": _sha256(json.dumps(row))})


def row_of_text(text: bytes) -> dict[str, Any] | None:
    """Read a row; None when the text is damaged."""
    try:
        entry = json.loads(text.decode("utf-8"))
        row: dict[str, Any] = entry["row"]
        return row if entry["sha256"] == _sha256(json.dumps(row)) else None
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _sums_path(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.sha256")


def _sums(folder: Path) -> dict[str, str]:
    return {path.name: sha256(path) for path in folder.iterdir() if path.is_file()}


# --- Locks that one process at a time can hold, whatever host it runs on ---

_SEEN: dict[Path, SoftFileLease] = {}
"""Of those who found a lock taken: each remembers since when nobody has touched it."""


@contextmanager
def claimed(path: Path) -> Iterator[bool]:
    """Hold a lock, whose file ends with CLAIM, while the block runs; False when another has it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lease = _SEEN.pop(path, None) or SoftFileLease(
        path, lease_duration=LAPSES_S, timeout=0, thread_local=False
    )
    try:
        lease.acquire()
    except Timeout:
        _SEEN[path] = lease
        yield False
        return
    try:
        yield True
    finally:
        lease.release()


def remove_lapsed(folder: Path) -> None:
    """Remove the locks in a folder whose holders are gone."""
    for path in folder.glob(f".*{CLAIM}"):
        with suppress(OSError):
            if path.stat().st_size == 0:  # it was killed before it wrote who it is
                path.unlink()
                continue
        with claimed(path):
            pass
