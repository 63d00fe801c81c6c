"""A flight in, its recording as a folder on disk out, whole or not at all.

cam1.h5, cam2.h5     events/t, x, y, p; frames/t, frames/images; attributes width, height
rig.yaml             Kalibr camchain without extrinsics
rig_extrinsics.yaml  the same with the true extrinsics, for methods that are given them
truth.json           offset, pose, trajectory, and what the recording was made with

`record` simulates and writes each frame when its exposure closes; `save_recording` writes what was
simulated before. Both give the same bytes.
"""

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sim.camera_files import CameraFiles
from sim.clock import Drift
from sim.errors import SimError
from sim.partial import partial_path
from sim.recorded import Flight, Recording
from sim.recording import SimConfig, stream
from sim.scene.rig import Rig, kalibr_yaml

_DIGITS = 9  # decimals of the truth: nanometres and nanoseconds


def check_out_dir(out_dir: Path) -> None:
    """Refuse a folder that a recording must not be written to.

    Raises
    ------
    SimError
        When the path is a file, or a folder that is not empty.
    """
    if out_dir.exists() and not out_dir.is_dir():
        raise SimError(f"{out_dir} is a file: name a folder to write the recording to")
    if out_dir.is_dir() and any(out_dir.iterdir()):
        raise SimError(f"{out_dir} is not empty: name a new folder, or empty it first")


@dataclass(frozen=True)
class Recorded:
    """What a recording that was written to a folder holds."""

    flight: Flight
    n_events: tuple[int, ...]  # of each camera
    n_frames: tuple[int, ...]  # of each camera


def record(
    config: SimConfig,
    seed: int,
    out_dir: Path,
    provenance: dict[str, Any],
    text: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Recorded:
    """Simulate one flight and write it as a folder meanwhile; the recording never is in memory.

    Of what is recorded, only one camera's events are in memory.

    Parameters
    ----------
    config, seed, progress
        As for `sim.recording.simulate`.
    out_dir, provenance, text
        As for `save_recording`.

    Returns
    -------
    Recorded

    Raises
    ------
    SimError
        As both; the folder is not there then, or as empty as before.
    """
    with _whole_folder(out_dir) as partial, ExitStack() as open_files:
        sinks: list[CameraFiles] = []

        def open_sink(*about: Any) -> CameraFiles:
            sinks.append(open_files.enter_context(CameraFiles(partial, text, *about)))
            return sinks[-1]

        flight = stream(config, seed, open_sink, progress)
        recorded = _recorded(flight, sinks)
        _save_about(recorded, partial, provenance)
    return recorded


def save_recording(
    recording: Recording,
    out_dir: Path,
    provenance: dict[str, Any],
    text: bool = False,
    rig_files: Mapping[str, str] | None = None,
) -> None:
    """Write a recording as a folder.

    Parameters
    ----------
    recording
    out_dir
        New, or empty. The folder appears under this name only when all of it is written.
    provenance
        What the recording was made with; goes into truth.json as it is.
    text
        Write the events as ESIM text (cam1.txt, ...) too.
    rig_files
        Name -> text, in place of `true_rig_files` of the recording's rig.

    Raises
    ------
    SimError
        When the folder is not empty or cannot be written.
    """
    with _whole_folder(out_dir) as partial:
        sinks = []
        for camera in recording.cameras:
            frames = camera.frames
            about = (camera.camera, frames.times_us, frames.exposure_s)
            with CameraFiles(partial, text, *about) as sink:
                for k, image in enumerate(frames.images):
                    sink.images[k] = image
                sink.add(camera.events)
                sink.close()
            sinks.append(sink)
        _save_about(_recorded(recording.flight, sinks), partial, provenance, rig_files)


def true_rig_files(rig: Rig) -> dict[str, str]:
    """Give the texts of the rig's files by name, without the true extrinsics and with them."""
    return {
        "rig.yaml": kalibr_yaml(rig, with_extrinsics=False),
        "rig_extrinsics.yaml": kalibr_yaml(rig, with_extrinsics=True),
    }


@contextmanager
def _whole_folder(out_dir: Path) -> Iterator[Path]:
    """Give a folder to fill, which becomes `out_dir` if the block ends well; else nothing is left.

    Raises
    ------
    SimError
        When `out_dir` is not empty, before the block or after it, or cannot be written.
    """
    check_out_dir(out_dir)
    try:
        out_dir = out_dir.resolve()
        existing = next(folder for folder in out_dir.parents if folder.exists())
        partial = partial_path(existing, out_dir.name)
        partial.mkdir()
    except OSError as error:
        raise _unwritable(out_dir, error) from error
    try:
        yield partial
        check_out_dir(out_dir)  # the block may have taken minutes
        if out_dir.is_dir():  # and stays the same one: it may be somebody's working directory
            for path in sorted(partial.iterdir()):
                path.rename(out_dir / path.name)
        else:
            out_dir.parent.mkdir(parents=True, exist_ok=True)
            partial.rename(out_dir)
    except OSError as error:
        raise _unwritable(out_dir, error) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _unwritable(out_dir: Path, error: OSError) -> SimError:
    return SimError(f"cannot write the recording to {out_dir}: {error}")


def _recorded(flight: Flight, sinks: Sequence[CameraFiles]) -> Recorded:
    n_events = tuple(sink.n_events for sink in sinks)
    return Recorded(flight, n_events, tuple(sink.n_frames for sink in sinks))


def _save_about(
    recorded: Recorded,
    folder: Path,
    provenance: dict[str, Any],
    rig_files: Mapping[str, str] | None = None,
) -> None:
    """Write all files but those of the cameras."""
    for name, text in (rig_files or true_rig_files(recorded.flight.rig)).items():
        (folder / name).write_text(text)
    truth = _truth(recorded) | {"provenance": provenance}
    # A line for each entry: json's own indentation is ten times as slow as all else about it.
    lines = (f"{json.dumps(name)}: {json.dumps(value)}" for name, value in truth.items())
    (folder / "truth.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")


def _truth(recorded: Recorded) -> dict[str, Any]:
    """Return the content of truth.json, with frames and units in the names."""
    flight = recorded.flight
    truth = flight.truth
    quaternions = Rotation.from_matrix(truth.T_W_B[:, :3, :3]).as_quat()
    return {
        "t_d_s": truth.t_d_s,
        "skew_ppm": truth.drift.skew_ppm,
        "t_ref_s": truth.drift.t_ref_s,
        "clock_jump": _jump(truth.drift),
        "R": truth.R.tolist(),
        "t": truth.t.tolist(),
        "baseline_m": truth.baseline_m,
        "conventions": "t_cam2 = t_cam1 + t_d + skew (t_cam1 - t_ref), and a jump's size from then"
        " on; x2 = R x1 + t, |t| = 1; times on camera 1's clock",
        "cameras": {
            camera.name: {
                "time_offset_s": camera.time_offset_s,
                "T_C_W": camera.T_C_W.tolist(),
                "n_events": n_events,
                "drone_px": _rounded(centres),
            }
            for camera, n_events, centres in zip(
                flight.rig.cameras, recorded.n_events, truth.centres_px, strict=True
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


def _jump(drift: Drift) -> dict[str, float] | None:
    if drift.jump is None:
        return None
    at_s, size_s = drift.jump
    return {"at_s": at_s, "size_s": size_s}


def _rounded(values: NDArray[np.float64]) -> list[Any]:
    """Return nested lists, with null where there is no value: NaN is not JSON."""
    rounded = np.round(values, _DIGITS).astype(object)
    rounded[np.isnan(values)] = None
    result: list[Any] = rounded.tolist()
    return result
