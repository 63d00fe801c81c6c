"""Two event files and a rig in, the offset and pose between the cameras out: `ssac sync`.

Script, notebook and command line share one function::

    result = sync("cam1.h5", "cam2.h5", "rig.yaml")
    print(report_text(result))
    result.estimate.t_d_s, result.estimate.R, result.estimate.t
"""

import json
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ssac.camera import Rig
from ssac.config import Config, checked
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.files.event_files import load_events, write_synced
from ssac.files.hdf5 import HDF5_SUFFIXES
from ssac.files.whole_file import whole_file
from ssac.tool.load import Paths, check_common_time, check_enough_events, describe, load_pair
from ssac.tool.plots import FILE_SUFFIXES, save_figures
from ssac.tool.registry import DEFAULT, METHODS, Input, Method, choose_method
from ssac.track.observation import Observation, usable_events

Log = Callable[[str], None]

NO_ESTIMATE, BAD_INPUT = 1, 2
"""Exit codes: the data give no reliable estimate; wrong usage, or a file that cannot be used."""

_NEXT_LINE = "\n" + 19 * " "  # of one part's progress
_SYNCED_SUFFIXES = (*HDF5_SUFFIXES, ".txt")


@dataclass(frozen=True)
class SyncResult:
    """An estimate, what it was made from, and how long it took."""

    paths: Paths
    method: Method
    estimate: Estimate
    cam1: Observation  # events denoised if that was asked for, as the method saw them
    cam2: Observation
    rig: Rig
    config: Config  # as asked for
    seconds: dict[str, float]  # by part, in the order they ran


def sync(
    cam1_path: Path | str,
    cam2_path: Path | str,
    rig_path: Path | str,
    method: str | None = None,
    known_extrinsics: bool = False,
    config: Config | None = None,
    log: Log | None = None,
) -> SyncResult:
    """Estimate the offset and the pose between two recorded cameras.

    Parameters
    ----------
    cam1_path, cam2_path
        Event files of any format that `ssac.files.event_files.load_events` reads.
    rig_path
        Kalibr or OpenCV YAML with the intrinsics, and the extrinsics where they are known.
    method
        Name from `ssac.tool.registry`; None for the best one.
    known_extrinsics
        Use the extrinsics of the rig, and find the offset only.
    config
        Parameters of the method; None for the defaults.
    log
        Called with a line of progress after each part.

    Returns
    -------
    SyncResult
        Its estimate says with `status` and `reason` when it is not to be relied upon.

    Raises
    ------
    SsacError
        If a file cannot be used, or does not fit the others; the message names it.
    """
    paths = Path(cam1_path), Path(cam2_path), Path(rig_path)
    chosen = choose_method(method, known_extrinsics)
    config = checked(config)
    clock = _Clock(log or (lambda line: None))

    with clock.part("read") as say:
        cam1, cam2, rig = load_pair(paths, chosen)
        say(describe(cam1, paths[0]))
        say(describe(cam2, paths[1]))
    n_read = len(cam1.events), len(cam2.events)
    if chosen.input is not Input.FRAMES and config.denoise:
        with clock.part("denoise") as say:
            events1, events2 = usable_events(cam1, cam2, rig, config)
            cam1, cam2 = replace(cam1, events=events1), replace(cam2, events=events2)
            say(f"{len(events1)} of {n_read[0]} and {len(events2)} of {n_read[1]} events left")
    for path, camera, n in zip(paths[:2], (cam1, cam2), n_read, strict=True):
        check_enough_events(path, camera, n, chosen, config)
    check_common_time(paths, cam1, cam2, chosen, config)
    with clock.part("estimate") as say:
        estimate = chosen.estimate(cam1, cam2, rig, replace(config, denoise=False))
        say(chosen.name)
    return SyncResult(paths, chosen, estimate, cam1, cam2, rig, config, clock.seconds)


def report_text(result: SyncResult) -> str:
    """Lay out a result for people, the sign of the offset in words."""
    estimate, rows = result.estimate, list[tuple[str, str]]()
    if estimate.status != "ok":
        title = "no pose" if estimate.has_offset else "no estimate"
        rows.append((title, f"{estimate.status}: {estimate.reason}"))
    if np.isfinite(estimate.t_d_s):
        rows += _offset_rows(estimate)
    if result.method.needs_extrinsics:
        rows.append(("pose", f"as given in {result.paths[2]}"))
    elif estimate.R is not None and estimate.t is not None:
        rows += _pose_rows(estimate.R, estimate.t, estimate.covariance)
    if result.method.input is Input.TRACKS:
        rows.append(("samples", f"{estimate.n_samples} of {result.config.n_samples} used"))
    if np.isfinite(estimate.d_avg_px):
        rows.append(("d_avg", f"{estimate.d_avg_px:.3f} px from point to epipolar line"))
    rows.append(("method", f"{result.method.name}: {result.method.summary}"))
    return "\n".join(f"{name:15}{value}" for name, value in rows)


def report_json(result: SyncResult) -> dict[str, Any]:
    """Lay out a result for machines: units in the names, None for what is missing."""
    estimate, (cam1, cam2, rig) = result.estimate, result.paths
    has_samples = result.method.input is Input.TRACKS
    return {
        "t_d_s": _plain(estimate.t_d_s),
        "t_d_std_s": _plain(estimate.t_d_std_s),
        "R": _plain(estimate.R),
        "t": _plain(estimate.t),
        "status": estimate.status,
        "reason": estimate.reason,
        "method": result.method.name,
        "n_samples": estimate.n_samples if has_samples else None,
        "d_avg_px": _plain(estimate.d_avg_px),
        "t_d_is_reliable": estimate.has_offset,
        "alternatives_s": _plain(estimate.alternatives_s),
        "unobservable": _plain(estimate.unobservable),
        "covariance": _plain(estimate.covariance),
        "conventions": "t_cam2 = t_cam1 + t_d; x2 = R x1 + t, |t| = 1; covariance of t_d [s], "
        "rotation vector of exp([w]x) R [rad] and t's two tangents [rad]; unobservable: unit "
        "directions in the same six",
        "search_s": list(result.config.interval_s),
        "cam1": str(cam1),
        "cam2": str(cam2),
        "rig": str(rig),
        "seconds": {part: round(value, 3) for part, value in result.seconds.items()},
    }


def save_json(path: Path, result: SyncResult) -> None:
    """Write `report_json`; the file appears only when it is complete."""
    rows = [
        f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}"
        for key, value in report_json(result).items()
    ]
    with whole_file(path) as temporary:
        temporary.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")


def sync_command(
    cam1: Annotated[Path, typer.Argument(help="Events of camera 1.", show_default=False)],
    cam2: Annotated[Path, typer.Argument(help="Events of camera 2.", show_default=False)],
    rig: Annotated[
        Path, typer.Option(help="Kalibr or OpenCV YAML of both cameras.", show_default=False)
    ],
    known_extrinsics: Annotated[
        bool, typer.Option("--known-extrinsics", help="Use the pose that the rig file gives.")
    ] = False,
    method: Annotated[str, typer.Option(help=f"One of {', '.join(METHODS)}.")] = DEFAULT,
    search: Annotated[
        tuple[float, float], typer.Option(help="Least and largest offset t_d to try [s].")
    ] = Config.interval_s,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the result for machines.")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Draw the result: a folder for all figures, or one .png, .pdf or .svg."),
    ] = None,
    write_synced_file: Annotated[
        Path | None,
        typer.Option(
            "--write-synced", help="Write camera 2's events on camera 1's clock (.h5 or .txt)."
        ),
    ] = None,
    no_denoise: Annotated[
        bool, typer.Option("--no-denoise", help="Keep hot pixels and isolated events.")
    ] = False,
    n_samples: Annotated[
        int, typer.Option(help="Times at which the object's positions are compared.")
    ] = Config.n_samples,
    half_window: Annotated[
        float, typer.Option(help="Events on each side of such a time make a position [s].")
    ] = Config.half_window_s,
    n_min: Annotated[int, typer.Option(help="A position needs as many events.")] = Config.n_min,
) -> None:
    """Find the time offset and the relative pose of two event cameras from one moving object.

    Exit code 0: done; 1: the data give no reliable estimate, the output says why; 2: wrong usage,
    or a file that cannot be used.
    """
    config = Config(
        interval_s=search,
        n_samples=n_samples,
        half_window_s=half_window,
        n_min=n_min,
        denoise=not no_denoise,
    )
    try:
        with _warnings_as_lines():
            if not search[0] < search[1]:
                raise SsacError(f"--search: expected a smaller and a larger offset, got {search}")
            _check_outputs((cam1, cam2, rig), json_file, plot, write_synced_file)
            result = sync(cam1, cam2, rig, method, known_extrinsics, config, log=_to_stderr)
            typer.echo(report_text(result))
            _write_outputs(result, json_file, plot, write_synced_file)
    except (SsacError, OSError) as error:
        _to_stderr(f"error: {' '.join(str(error).split())}")
        raise typer.Exit(BAD_INPUT) from error
    if result.estimate.status != "ok":
        raise typer.Exit(NO_ESTIMATE)


class _Clock:
    """Measures the parts of a run and logs a line for each."""

    def __init__(self, log: Log) -> None:
        self.seconds: dict[str, float] = {}
        self._log = log

    @contextmanager
    def part(self, name: str) -> Iterator[Log]:
        """Give a function that takes the part's line of progress."""
        lines: list[str] = []
        start = time.perf_counter()
        yield lines.append
        self.seconds[name] = time.perf_counter() - start
        self._log(f"{name:9}{self.seconds[name]:6.2f} s  {_NEXT_LINE.join(lines)}")


def _offset_rows(estimate: Estimate) -> list[tuple[str, str]]:
    """Rows on the offset, its sign in words."""
    offset_ms, sigma_ms = 1e3 * estimate.t_d_s, 1e3 * estimate.t_d_std_s
    sigma = f", 1 sigma {sigma_ms:.3f} ms" if np.isfinite(sigma_ms) else ""
    if not estimate.has_offset:
        rows = [("not reliable", f"t_d = {offset_ms:.3f} ms")]
        others = ", ".join(f"{1e3 * other_s:.0f}" for other_s in estimate.alternatives_s)
        return rows + ([("or", f"t_d = {others} ms")] if others else [])
    more, remedy = ("more", "subtract it from") if offset_ms >= 0.0 else ("less", "add it to")
    return [
        ("time offset", f"t_d = {offset_ms:.3f} ms{sigma}"),
        (
            "",
            f"camera 2's clock shows {abs(offset_ms):.3f} ms {more} than camera 1's; "
            f"{remedy} camera 2's timestamps",
        ),
    ]


def _pose_rows(
    R: NDArray[np.float64], t: NDArray[np.float64], covariance: NDArray[np.float64] | None
) -> list[tuple[str, str]]:
    """Rows on the pose x2 = R x1 + t; 1 sigma is the root of the summed variances."""
    rotation = Rotation.from_matrix(R).as_rotvec(degrees=True)
    sigmas = ["", ""]
    if covariance is not None and np.isfinite(covariance).all():
        variances = np.diag(covariance)
        sigmas = [
            f", 1 sigma {np.degrees(np.sqrt(np.sum(variances[part]))):.3f} deg"
            for part in (slice(1, 4), slice(4, 6))
        ]
    apart_deg = np.degrees(np.arccos(np.clip(R[2, 2], -1.0, 1.0)))
    return [
        ("lines of sight", f"{apart_deg:.2f} deg apart"),
        ("rotation", f"vector {_vector(rotation, 3)} deg{sigmas[0]}; x2 = R x1 + t"),
        ("translation", f"t = {_vector(t, 4)}, of unknown length{sigmas[1]}"),
        ("", f"camera 2 lies towards {_vector(-R.T @ t, 3)} of camera 1 (right, down, forward)"),
    ]


def _vector(values: NDArray[np.float64], digits: int) -> str:
    return f"({', '.join(f'{value:.{digits}f}' for value in values + 0.0)})"


def _plain(value: float | NDArray[np.float64] | None) -> Any:
    """Nested lists of Python numbers, None for what is missing or not finite."""
    if value is None:
        return None
    if isinstance(value, np.ndarray):
        return [_plain(part) for part in value]
    return float(value) if np.isfinite(value) else None


def _check_outputs(
    inputs: tuple[Path, ...], json_file: Path | None, plot: Path | None, synced: Path | None
) -> None:
    """Raise SsacError, before any work is done, for outputs that cannot be written."""
    if synced is not None and synced.suffix.lower() not in _SYNCED_SUFFIXES:
        raise SsacError(
            f"{synced}: cannot write the extension {synced.suffix!r}: use one of "
            f"{', '.join(_SYNCED_SUFFIXES)}"
        )
    is_folder = plot is not None and plot.suffix.lower() not in FILE_SUFFIXES
    if is_folder and plot is not None and plot.exists() and not plot.is_dir():
        raise SsacError(
            f"{plot}: exists and is no folder: name a folder, or a file ending in "
            f"{', '.join(FILE_SUFFIXES)}"
        )
    for output in (json_file, None if is_folder else plot, synced):
        if output is None:
            continue
        if output.is_dir() or not output.parent.is_dir():
            raise SsacError(f"{output}: not a file in a folder that exists: name another")
        if any(output.exists() and path.exists() and output.samefile(path) for path in inputs):
            raise SsacError(f"{output}: is one of the inputs and would be lost: name another file")


def _write_outputs(
    result: SyncResult, json_file: Path | None, plot: Path | None, synced: Path | None
) -> None:
    clock = _Clock(_to_stderr)
    estimate = result.estimate
    if json_file is not None:
        save_json(json_file, result)
        _to_stderr(f"wrote {json_file}")
    if plot is not None:
        with clock.part("draw") as say:
            drawn = save_figures(
                plot, estimate, result.cam1, result.cam2, result.rig, result.config
            )
            say(", ".join(map(str, drawn)) or "nothing: the method left no curve and no track")
    if synced is not None and estimate.has_offset:
        with clock.part("write") as say:
            # Read again, whole: what is in memory has been denoised.
            write_synced(synced, load_events(result.paths[1]), estimate.t_d_s)
            say(str(synced))
    elif synced is not None:
        _to_stderr(f"not written: {synced}, since there is no reliable offset")


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Show each warning as one line on stderr."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: _to_stderr(f"warning: {message}")
        yield


def _to_stderr(line: str) -> None:
    typer.echo(line, err=True)
