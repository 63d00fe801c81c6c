"""A configuration in; the recording or the result that was made with it before, out.

Everything is addressed by its content: by all parameters and by the source text of the code that
makes it, so a change of either makes a new entry and never returns an old one.

    recordings/<key>/     as sim.storage writes them, with t_d = 0: ordinary input of `ssac sync`
    denoised/<key>.npz    the events that denoising leaves of them
    brightness/<key>.npz  the mean of each of their frames
    runs/<ab>/<key>.json  one scored run of one method
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

import sim
import ssac
from experiments.run.provenance import plain
from sim.recording import SimConfig, simulate
from sim.render.gl_context import open_context
from sim.storage import save_recording
from ssac.files.whole_file import whole_file

DEFAULT_FOLDER = Path("cache")

# Packages whose version may change a recording, or an estimate.
_SIM_PACKAGES = ("numpy", "scipy", "numba", "pyrender", "PyOpenGL", "trimesh", "manifold3d")
_SSAC_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless")
_SOURCE_SUFFIXES = (".py", ".vert", ".frag")


class Denoised(NamedTuple):
    """Events of both cameras without noise."""

    cam1: NDArray[np.void]
    cam2: NDArray[np.void]
    n_recorded: NDArray[np.int64]  # (2,) events with noise


class Brightness(NamedTuple):
    """Means of the frames of both cameras, and their times [us]; empty where there are none."""

    cam1: NDArray[np.float64]
    times1_us: NDArray[np.int64]
    cam2: NDArray[np.float64]
    times2_us: NDArray[np.int64]


Made = TypeVar("Made", Denoised, Brightness)


@dataclass(frozen=True)
class Cache:
    """What earlier runs made, in one folder.

    Several processes may share it: entries appear whole, under names that say all about them.
    """

    folder: Path = DEFAULT_FOLDER

    def recording_folder(self, config: SimConfig, seed: int) -> Path:
        """Give the folder of a recording, simulating it first if it is not there yet.

        Parameters
        ----------
        config : SimConfig
            Its `t_d_s` does not count: the recording has both clocks equal.
        seed : int

        Raises
        ------
        SimError
            When it cannot be simulated or written.
        """
        config = replace(config, t_d_s=0.0)
        folder = self._recording_path(config, seed)
        if not folder.exists():
            provenance = {"config": plain(config), "seed": seed}
            try:
                save_recording(simulate(config, seed), folder, provenance)
            except Exception:
                if not folder.exists():  # unless another process was first
                    raise
        return folder

    def has_recording(self, config: SimConfig, seed: int) -> bool:
        """Return whether a recording is there."""
        return self._recording_path(config, seed).exists()

    def denoised(self, recording: Path, config: Any, denoise: Callable[[], Denoised]) -> Denoised:
        """Give the events that denoising leaves, kept under the denoising's source text.

        Parameters
        ----------
        recording : Path
            As `recording_folder` gives it.
        config : Any
            All that the denoising depends on beside the recording.
        denoise : Callable[[], Denoised]
            Does it, where it was not done before.
        """
        code = source_digest("ssac", ("denoise", "events"))
        key = _digest(recording.name, plain(config), code, Denoised._fields)
        return self._kept(f"denoised/{key}.npz", Denoised, denoise)

    def brightness(self, recording: Path, measure: Callable[[], Brightness]) -> Brightness:
        """Give the means of a recording's frames, which `measure` takes if it was not done before.

        Reading all frames takes longer than most methods do.
        """
        key = _digest(recording.name, source_digest("ssac", ("zncc_f",)), Brightness._fields)
        return self._kept(f"brightness/{key}.npz", Brightness, measure)

    def load_run(self, key: str) -> dict[str, Any] | None:
        """Return a run's row; None when there is none."""
        path = self._run_path(key)
        if not path.exists():
            return None
        row: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return row

    def save_run(self, key: str, row: dict[str, Any]) -> None:
        """Keep a run's row, unless it is there already."""
        path = self._run_path(key)
        if path.exists():
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            temporary.write_text(json.dumps(row), encoding="utf-8")

    def size_bytes(self) -> int:
        """Return the size of all entries."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file())

    def _kept(self, name: str, kind: type[Made], make: Callable[[], Made]) -> Made:
        path = self.folder / name
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            made = make()
            with whole_file(path) as temporary, temporary.open("wb") as file:
                np.savez(file, **made._asdict())
            return made
        with np.load(path) as file:
            return kind(*(file[field] for field in kind._fields))

    def _recording_path(self, config: SimConfig, seed: int) -> Path:
        return self.folder / "recordings" / recording_key(config, seed)

    def _run_path(self, key: str) -> Path:
        return self.folder / "runs" / key[:2] / f"{key}.json"


def recording_key(config: SimConfig, seed: int) -> str:
    """Name a recording by all that it depends on, the OpenGL driver of this machine included."""
    context = open_context(config.render.backend)
    return _digest(
        content(replace(config, t_d_s=0.0)),
        seed,
        source_digest("sim"),
        _versions(_SIM_PACKAGES),
        plain(context),
    )


def run_key(recording: str, t_d_s: float, estimator: Any, method: str, method_code: str) -> str:
    """Name a run by all that it depends on.

    Parameters
    ----------
    recording : str
        Key of the recording.
    t_d_s : float
        Offset added to camera 2's clock.
    estimator : Any
        Parameters of the method.
    method, method_code : str
        The method's name, and the version of its code where that is not in `ssac`.
    """
    return _digest(
        recording,
        t_d_s,
        plain(estimator),
        method,
        method_code,
        source_digest("ssac"),
        source_digest("experiments", ("bridge", "load", "run", "score")),
        _versions(_SSAC_PACKAGES),
    )


@lru_cache
def source_digest(package: str, modules: tuple[str, ...] = ()) -> str:
    """Digest of the source text of a package of ours, or of some of its modules."""
    folder = _FOLDERS[package]
    files = [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix in _SOURCE_SUFFIXES and (not modules or path.stem in modules)
    ]
    return _digest(*[[str(path.relative_to(folder)), path.read_text()] for path in files])


@lru_cache
def _versions(packages: tuple[str, ...]) -> dict[str, str]:
    return {name: version(name) for name in packages}


def content(value: Any) -> Any:
    """Turn a configuration into what JSON holds, with the digest of each file in its place."""
    if isinstance(value, Path):
        return hashlib.sha256(value.read_bytes()).hexdigest() if value.exists() else str(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: content(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, (list, tuple)):
        return [content(item) for item in value]
    return value


def _digest(*parts: Any) -> str:
    text = json.dumps(parts, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


_FOLDERS = {
    "sim": Path(str(sim.__file__)).parent,
    "ssac": Path(str(ssac.__file__)).parent,
    "experiments": Path(__file__).parents[1],
}
