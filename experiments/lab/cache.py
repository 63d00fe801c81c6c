"""A cache of recordings and of the rows measured on them, with locks on entries in the making.

An entry's key is a digest of all parameters and of all code that makes the entry
(`experiments.lab.code`), so a change of either makes a new entry and never returns an old one.

    recordings/<key>/     as sim.storage writes them, with t_d = 0: ordinary input of `ssac sync`
    recordings/<key>.sha256  checksums of its files; without them a recording does not count
    runs/<ab>/<key>.json  one measured row, and its checksum
    damaged/              entries that do not agree with their checksums

A full disk, a killed machine or a flipped bit leaves entries that can be read and are wrong, so
each entry is checked against its checksum before it is used.

An entry in the making is locked by a file that the lock's holder touches now and then. A lock is
free when its holder is a process of this host that has ended, or when nobody touched the file for
`LAPSES_S`. Locks only save work: should two processes make the same entry, each writes it whole.
"""

import hashlib
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from filelock import SoftFileLease, Timeout

from experiments.lab.code import SIM_PACKAGES, SSAC_PACKAGES, code_digest, package_versions
from experiments.lab.results import save_text, sha256
from sim.recording import SimConfig
from sim.render.gl_context import open_context
from sim.scene.drone import drone_from_file
from sim.storage import record
from ssac.cli.progress import say
from ssac.errors import SsacError, WriteError
from ssac.files.whole_file import check_folder, remove_left_over

DEFAULT_FOLDER = Path("cache")

ASIDE = "damaged"  # folder of the damaged entries, where they can be inspected

# Code that makes a recording: none is in `experiments`, so edits there keep all recordings.
RECORDING_CODE = ("sim.recording", "sim.storage")

CLAIM = ".claim"

LAPSES_S = 120.0
"""A lock untouched for this long [s] lapses: a network disk's delay (NFS: 60 s), 1 or 2 touches."""

ASK_AGAIN_S = 1.0  # after which a process that finds a lock taken tries again


@dataclass(frozen=True)
class Cache:
    """Recordings and rows in one folder, which processes of several hosts may share."""

    folder: Path = DEFAULT_FOLDER
    simulated: list[Path] = field(default_factory=list, compare=False)  # made by this object
    sound: set[Path] = field(default_factory=set, compare=False)  # recordings found undamaged

    def recording_folder(self, config: SimConfig, seed: int) -> Path:
        """Return the folder of a recording, which is simulated first if it is not there yet.

        Its clocks are equal, whatever the config's `t_d_s`. SimError when it cannot be simulated,
        WriteError when it cannot be written or there is no room for it.
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

    def load_run(self, key: str) -> dict[str, Any] | None:
        """Return a run's row; None when the cache holds none, or a damaged one."""
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
        if not path.exists():
            save_text(path, text_of_row(row))

    def claim_of_runs(self, recordings: str) -> Path:
        """Name the lock of all runs on the recordings with this `schedule.recordings_key`."""
        return self.folder / "runs" / f".{recordings}{CLAIM}"

    def tidy(self) -> None:
        """Remove what killed processes left half-made."""
        runs = self.folder / "runs"
        for folder in (self.folder / "recordings", runs, *runs.glob("*")):
            remove_left_over(folder)
            remove_lapsed(folder)

    def size_bytes(self) -> int:
        """Return the size of all entries, but for those that another run moves meanwhile."""
        total = 0
        for folder, _, names in os.walk(self.folder):
            for name in names:
                with suppress(OSError):
                    total += Path(folder, name).stat().st_size
        return total

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
        if folder.exists():  # without checksums: its maker was killed before it wrote them
            self._set_aside(folder)
        try:
            record(config, seed, folder, {"config": content(config), "seed": seed})
            save_sums(folder)
            self.sound.add(folder)
            self.simulated.append(folder)
        except Exception as error:
            if isinstance(error.__cause__, OSError):
                raise WriteError(str(error)) from error
            if not folder.exists():  # else another process made it after our lock lapsed
                raise

    def _set_aside(self, path: Path) -> None:
        """Move a damaged entry and its checksums into ASIDE, and say so."""
        unique = os.urandom(4).hex()
        for one in (path, _sums_path(path)):
            aside = self.folder / ASIDE / f"{one.stem}.{unique}{one.suffix}"
            try:
                aside.parent.mkdir(parents=True, exist_ok=True)
                one.rename(aside)
            except FileNotFoundError:  # no checksums, or another process moved it first
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
    """Return the key of a recording: a digest of its inputs, with OpenGL also of this GL driver."""
    drawn_with_gl = config.render.renderer == "pyrender"
    context = open_context(config.render.backend) if drawn_with_gl else None
    return _digest(
        content(replace(config, t_d_s=0.0)),
        seed,
        code_digest(*RECORDING_CODE, type(config).__module__),  # the module of the scene
        *([] if config.drone_file is None else _shown_of(config.drone_file)),
        package_versions(SIM_PACKAGES),
        content(context),
    )


def _shown_of(mesh: Path) -> list[str]:
    """Digest what is drawn of a mesh: its file may name others, of colours or of vertices."""
    (part,) = drone_from_file(mesh).parts
    arrays = part.vertices_B_m, part.faces, part.albedo
    return [hashlib.sha256(array.tobytes()).hexdigest() for array in arrays]


def run_key(recordings: tuple[str, ...], inputs: Any, code: tuple[str, ...]) -> str:
    """Return a row's key: a digest of its recordings' keys, other inputs and code (`code_of`)."""
    return _digest(recordings, content(inputs), code_digest(*code), package_versions(SSAC_PACKAGES))


def content(value: Any) -> Any:
    """Turn a configuration into JSON types; the path of a file becomes the digest of the file."""
    if isinstance(value, Path):
        return sha256(value) if value.is_file() else str(value)
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
    """Estimate a recording's size [bytes] without noise, to refuse a full disk before any work."""
    frames = 0.1 * config.frames.rate_hz * config.resolution[0] * config.resolution[1]  # compressed
    events = 200_000.0  # a second: 60,000 events per camera, at 3 bytes each
    truth = 100_000.0
    return round(config.duration_s * (2.0 * (frames + events) + truth))


# --- Checks that an entry is as it was written ---


def save_sums(folder: Path) -> None:
    """Write the checksums of a folder's files beside the folder."""
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
"""Leases that found a lock taken: each remembers since when nobody has touched the lock."""


@contextmanager
def claimed(path: Path) -> Iterator[bool]:
    """Hold a lock, whose file ends with CLAIM, in a block; yield False if another holder has it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lease = _SEEN.pop(path, None) or SoftFileLease(
        path, lease_duration=LAPSES_S, timeout=0, thread_local=False
    )
    try:
        held = lease.acquire()
    except Timeout:
        _SEEN[path] = lease
        yield False
    else:
        with held:
            yield True


def remove_lapsed(folder: Path) -> None:
    """Remove the locks in a folder whose holders are gone."""
    for path in folder.glob(f".*{CLAIM}"):
        with suppress(OSError):
            if path.stat().st_size == 0:  # its holder was killed before it wrote its identity
                path.unlink()
                continue
        with claimed(path):
            pass
