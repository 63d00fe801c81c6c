"""What earlier runs made: recordings, and the rows that were measured on them.

Everything is addressed by its content: by all parameters and by all code that makes it
(`experiments.lab.code`), so a change of either makes a new entry and never returns an old one.

    recordings/<key>/     as sim.storage writes them, with t_d = 0: ordinary input of `ssac sync`
    recordings/<key>.sha256  checksums of its files
    brightness/<key>.npz  the mean of each of their frames
    denoised/<key>.npz    the events that denoising leaves, in 6 bytes each
    runs/<ab>/<key>.json  one measured row, and its checksum
    damaged/              entries that were not what had been written (`experiments.lab.health`)

What methods read of a recording stands in the last two: as long as these are there, it is not read.
"""

import hashlib
import json
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from experiments.lab.bridge import recording_bytes
from experiments.lab.code import SIM_PACKAGES, SSAC_PACKAGES, code_digest, code_of, package_versions
from experiments.lab.health import is_sound, row_of_text, save_sums, set_aside, text_of_row
from experiments.lab.lock import ASK_AGAIN_S, claimed, remove_lapsed
from experiments.lab.lock import SUFFIX as CLAIM
from experiments.lab.provenance import plain
from sim.recording import SimConfig
from sim.render.gl_context import open_context
from sim.storage import record
from ssac.errors import WriteError
from ssac.files.whole_file import check_folder, remove_left_over, whole_file

DEFAULT_FOLDER = Path("cache")

RECORDED = ("recordings", "brightness", "denoised")
"""Folders of recordings, and of what is told of them once for all methods."""

RECORDING_CODE = ("sim.recording", "sim.storage")
"""What makes a recording: nothing of `experiments`, so that recordings outlive its edits."""

BRIGHTNESS_CODE = ("ssac.methods.correlations", "ssac.files.hdf5")

DENOISED_CODE = ("ssac.track.clean", "ssac.files.hdf5")


class Brightness(NamedTuple):
    """Means of the frames of both cameras, and their times [us]; empty where there are none."""

    cam1: NDArray[np.float64]
    times1_us: NDArray[np.int64]
    cam2: NDArray[np.float64]
    times2_us: NDArray[np.int64]


class Denoised(NamedTuple):
    """What denoising did to the events of both cameras."""

    n_recorded: NDArray[np.int64]  # (2,) events of both cameras before it
    events1: NDArray[np.uint8]  # (n, 6) those that it left, as `recorded` packs them
    leaps1: NDArray[np.int64]  # (k, 2) of their times
    clutter1: NDArray[np.float64]  # (6,) the fields of `ssac.track.denoise.Clutter`
    on_line1: NDArray[np.bool_]  # whether each is on a thin line; empty where there is none
    events2: NDArray[np.uint8]
    leaps2: NDArray[np.int64]
    clutter2: NDArray[np.float64]
    on_line2: NDArray[np.bool_]


Kept = TypeVar("Kept", Brightness, Denoised)


@dataclass(frozen=True)
class Cache:
    """What earlier runs made, in one folder.

    Several processes may share it, of several hosts if the folder is on a network disk: entries
    appear whole, under names that say all about them. What is being made is claimed
    (`experiments.lab.lock`), so that nobody else makes it meanwhile.
    """

    folder: Path = DEFAULT_FOLDER
    simulated: list[Path] = field(default_factory=list, compare=False)  # by this object
    sound: set[Path] = field(default_factory=set, compare=False)  # recordings it has looked at

    def recording_folder(
        self, config: SimConfig, seed: int, names: Collection[str] | None = None
    ) -> Path:
        """Give the folder of a recording, simulating it first if it is not there yet.

        Parameters
        ----------
        config
            Its `t_d_s` does not count: the recording has both clocks equal.
        names
            Of its files that are to be read, and are held against their checksums; all when None.

        Raises
        ------
        SimError
            When it cannot be simulated.
        WriteError
            When it cannot be written, or there is no room for it.
        """
        config = replace(config, t_d_s=0.0)
        folder = self._recording_path(config, seed)
        while not self._is_kept(folder, names):
            with claimed(folder.with_name(f".{folder.name}{CLAIM}")) as is_ours:
                if not is_ours:  # another process makes it
                    time.sleep(ASK_AGAIN_S)
                elif not folder.exists():
                    self._simulate(config, seed, folder)
        return folder

    def brightness(self, recording: Path, measure: Callable[[], Brightness]) -> Brightness:
        """Give the means of a recording's frames, which `measure` takes if it was not done before.

        Reading all frames takes longer than most methods do.
        """
        key = _digest(recording.name, code_digest(*BRIGHTNESS_CODE), Brightness._fields)
        return self._arrays(Brightness, self.folder / "brightness" / f"{key}.npz", measure)

    def denoised(
        self, recording: Path, n_neighbours: int | None, denoise: Callable[[], Denoised]
    ) -> Denoised:
        """Give what denoising leaves of a recording, which `denoise` tells if it was not done yet.

        It takes an eighth of the time that all methods take, and to read the recording for it
        nearly as much.
        """
        by = code_digest(*DENOISED_CODE), package_versions(SSAC_PACKAGES)
        key = _digest(recording.name, n_neighbours, *by, Denoised._fields)
        return self._arrays(Denoised, self.folder / "denoised" / f"{key}.npz", denoise)

    def load_run(self, key: str) -> dict[str, Any] | None:
        """Return a run's row; None when there is none."""
        path = self._run_path(key)
        if not path.exists():
            return None
        row = row_of_text(path.read_bytes())
        if row is None:
            set_aside(path, self.folder)
        return row

    def save_run(self, key: str, row: dict[str, Any]) -> None:
        """Keep a run's row, unless it is there already."""
        path = self._run_path(key)
        if path.exists():
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            temporary.write_text(text_of_row(row), encoding="utf-8")

    def claim_of_runs(self, recordings: str) -> Path:
        """Name the claim to all runs on some recordings, as `task.recordings_key` names these."""
        return self.folder / "runs" / f".{recordings}{CLAIM}"

    @contextmanager
    def tidied(self) -> Iterator[None]:
        """Remove what killed processes left half-made, before the block and after it."""
        self._tidy()
        try:
            yield
        finally:
            self._tidy()

    def size_bytes(self) -> int:
        """Return the size of all entries."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file())

    def _is_kept(self, folder: Path, names: Collection[str] | None) -> bool:
        """Whether a recording is there and whole; a damaged one is moved aside."""
        if folder not in self.sound and folder.exists():
            if not is_sound(folder, names):
                set_aside(folder, self.folder)
                return False
            if names is None:
                self.sound.add(folder)
        return folder.exists()

    def _simulate(self, config: SimConfig, seed: int, folder: Path) -> None:
        provenance = {"config": plain(config), "seed": seed}
        check_folder(folder.parent, recording_bytes(config))
        try:
            record(config, seed, folder, provenance)
            save_sums(folder)
            self.sound.add(folder)
            self.simulated.append(folder)
        except Exception as error:
            if isinstance(error.__cause__, OSError):
                raise WriteError(str(error)) from error
            if not folder.exists():  # unless another process was first, its claim having lapsed
                raise

    def _arrays(self, kind: type[Kept], path: Path, measure: Callable[[], Kept]) -> Kept:
        """Load arrays, which are measured and kept first where they are not there, or damaged."""
        if path.exists():
            try:
                with np.load(path) as kept:  # whose parts have checksums
                    return kind(*(kept[name] for name in kind._fields))
            except Exception:  # of zip, of the format, of what stands in it
                set_aside(path, self.folder)
        path.parent.mkdir(parents=True, exist_ok=True)
        made = measure()
        with whole_file(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **made._asdict())
        return made

    def _tidy(self) -> None:
        runs = self.folder / "runs"
        others = (self.folder / name for name in RECORDED)
        for folder in (*others, runs, *runs.glob("*")):
            remove_left_over(folder)
            remove_lapsed(folder)

    def _recording_path(self, config: SimConfig, seed: int) -> Path:
        return self.folder / "recordings" / recording_key(config, seed)

    def _run_path(self, key: str) -> Path:
        return self.folder / "runs" / key[:2] / f"{key}.json"


def recording_key(config: SimConfig, seed: int) -> str:
    """Name a recording by all that it depends on: if OpenGL draws it, this machine's driver too."""
    drawn_with_gl = config.render.renderer == "pyrender"
    context = open_context(config.render.backend) if drawn_with_gl else None
    return _digest(
        content(replace(config, t_d_s=0.0)),
        seed,
        code_digest(*RECORDING_CODE, *code_of(type(config))),  # whose scene it is
        package_versions(SIM_PACKAGES),
        plain(context) if context else None,
    )


def run_key(recordings: tuple[str, ...], inputs: Any, code: tuple[str, ...]) -> str:
    """Name a row by all that it depends on.

    Parameters
    ----------
    recordings
        Keys of the recordings that it is measured on.
    inputs
        Everything else that goes in: parameters, the method's name and its version.
    code
        That measures it, as of `code_of`.
    """
    return _digest(recordings, content(inputs), code_digest(*code), package_versions(SSAC_PACKAGES))


def content(value: Any) -> Any:
    """Turn a configuration into what JSON holds, with the digest of each file in its place."""
    if isinstance(value, Path):
        return hashlib.sha256(value.read_bytes()).hexdigest() if value.exists() else str(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {one.name: content(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, (list, tuple)):
        return [content(item) for item in value]
    return value


def _digest(*parts: Any) -> str:
    text = json.dumps(parts, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]
