"""A recording in memory to a folder on disk, whole or not at all.

cam1.h5, cam2.h5     events/t, x, y, p; frames/t, frames/images; attributes width, height
rig.yaml             Kalibr camchain without extrinsics
rig_extrinsics.yaml  the same with the true extrinsics, for methods that are given them
truth.json           offset, pose, trajectory, and what the recording was made with
"""

import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sim.errors import SimError
from sim.partial import partial_path
from sim.recording import CameraRecording, Recording
from sim.scene.rig import kalibr_yaml

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


def save_recording(
    recording: Recording, out_dir: Path, provenance: dict[str, Any], text: bool = False
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

    Raises
    ------
    SimError
        When the folder is not empty or cannot be written.
    """
    check_out_dir(out_dir)
    out_dir = out_dir.resolve()
    existing = next(folder for folder in out_dir.parents if folder.exists())
    partial = partial_path(existing, out_dir.name)
    try:
        partial.mkdir()
        for camera in recording.cameras:
            _save_camera(camera, partial / f"{camera.camera.name}.h5")
            if text:
                save_events_text(camera, partial / f"{camera.camera.name}.txt")
        (partial / "rig.yaml").write_text(kalibr_yaml(recording.rig, with_extrinsics=False))
        (partial / "rig_extrinsics.yaml").write_text(
            kalibr_yaml(recording.rig, with_extrinsics=True)
        )
        truth = json.dumps(_truth(recording) | {"provenance": provenance}, indent=1)
        (partial / "truth.json").write_text(truth + "\n")
        if out_dir.is_dir():  # and stays the same one: it may be somebody's working directory
            for path in sorted(partial.iterdir()):
                path.rename(out_dir / path.name)
        else:
            out_dir.parent.mkdir(parents=True, exist_ok=True)
            partial.rename(out_dir)
    except OSError as error:
        raise SimError(f"cannot write the recording to {out_dir}: {error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def save_events_text(recording: CameraRecording, path: Path) -> None:
    """Write events as ESIM text: a line `width height`, then `t x y p` each, t in seconds."""
    camera, events = recording.camera, recording.events
    seconds, microseconds = np.divmod(np.abs(events["t"]), 1_000_000)
    sign = np.where(events["t"] < 0, "-", "")
    with path.open("w", encoding="ascii") as file:
        file.write(f"{camera.width} {camera.height}\n")
        rows = zip(sign, seconds, microseconds, events["x"], events["y"], events["p"], strict=True)
        file.writelines(f"{m}{s}.{us:06d} {x} {y} {p}\n" for m, s, us, x, y, p in rows)


def _save_camera(recording: CameraRecording, path: Path) -> None:
    """Write one camera's events and frames; the same content gives the same bytes."""
    camera, frames = recording.camera, recording.frames
    with h5py.File(path, "w") as file:
        file.attrs["width"] = camera.width
        file.attrs["height"] = camera.height
        for name in ("t", "x", "y", "p"):
            file.create_dataset(
                f"events/{name}",
                data=recording.events[name],
                chunks=(1 << 16,) if len(recording.events) >= 1 << 16 else None,
                **({"compression": "gzip", "compression_opts": 1, "shuffle": True}
                   if len(recording.events) else {}),
            )  # fmt: skip
        if len(frames.images):
            file.create_dataset("frames/t", data=frames.times_us)
            file.create_dataset(
                "frames/images",
                data=frames.images,
                chunks=(1, *frames.images.shape[1:]),
                compression="gzip",
                compression_opts=1,
            )
            file["frames"].attrs["exposure_us"] = round(frames.exposure_s * 1e6)


def _truth(recording: Recording) -> dict[str, Any]:
    """Return the content of truth.json, with frames and units in the names."""
    truth = recording.truth
    quaternions = Rotation.from_matrix(truth.T_W_B[:, :3, :3]).as_quat()
    return {
        "t_d_s": truth.t_d_s,
        "R": truth.R.tolist(),
        "t": truth.t.tolist(),
        "baseline_m": truth.baseline_m,
        "conventions": "t_cam2 = t_cam1 + t_d; x2 = R x1 + t, |t| = 1; times on camera 1's clock",
        "cameras": {
            camera.camera.name: {
                "time_offset_s": camera.camera.time_offset_s,
                "T_C_W": camera.camera.T_C_W.tolist(),
                "n_events": len(camera.events),
                "drone_px": _rounded(centres),
            }
            for camera, centres in zip(recording.cameras, truth.centres_px, strict=True)
        },
        "times_s": _rounded(truth.times_s),
        "drone_position_W_m": _rounded(truth.T_W_B[:, :3, 3]),
        "drone_quaternion_W_B_xyzw": _rounded(quaternions),
        "n_instants": recording.n_instants,
        "gl": asdict(recording.gl) if recording.gl else None,
        # How far the native renderer was from OpenGL where both drew; 0 instants: not compared.
        "render_check": {
            "n_instants": recording.check.n_instants,
            "max_difference": round(recording.check.max_difference, _DIGITS),
            "mean_difference": round(recording.check.mean_difference, _DIGITS),
        },
    }


def _rounded(values: NDArray[np.float64]) -> list[Any]:
    """Return nested lists, with null where there is no value: NaN is not JSON."""
    rounded = np.round(values, _DIGITS).astype(object)
    rounded[np.isnan(values)] = None
    result: list[Any] = rounded.tolist()
    return result
