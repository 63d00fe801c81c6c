"""A flight as two or three cameras recorded it in; what all at once tell beside its truth, out."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from experiments.lab.score import angle_between_deg, rotation_angle_deg
from experiments.outdoor.flights import Truth, calibrated
from experiments.outdoor.twin import (
    COLUMNS,
    CONFIG,
    compared,
    path_figures,
    write_events,
    write_rig,
)
from sim.recording import SimConfig
from ssac.estimate import Status
from ssac.network.solve import CameraAnswer, NetworkAnswer
from ssac.pipeline.api import chain_of
from ssac.pipeline.many import network

TWO_AT_ONCE, THREE_CAMERAS = "two_at_once", "three_cameras"
"""Kinds of rows beside `twin.KINDS`: nothing is known, and all are adjusted together with the path,
as `ssac sync` does it for more than two cameras and for the path of two."""


def at_once_row(
    folders: tuple[Path, ...], config: SimConfig, truths: tuple[Truth, ...], flight: int
) -> dict[str, Any]:
    """Solve two or three cameras at once, and compare the second's clock and pose, and the path.

    Parameters
    ----------
    folders
        Of the recording of cameras 1 and 2, and of that of cameras 1 and 3 if there is a third.
    config
        The former was simulated with.
    truths
        Theirs.
    flight
        Number of the flight.
    """
    answer, truth = at_once(folders, config, truths, flight), truths[0]
    camera = answer.cameras[1]
    row: dict[str, Any] = dict.fromkeys(COLUMNS, np.nan)
    row |= {"flight": flight, "kind": (TWO_AT_ONCE, THREE_CAMERAS)[len(folders) - 1]}
    row |= {"reason": answer.reason}
    row |= {"status": str(answer.status)}
    if camera.status == Status.OK and camera.R is not None and answer.cameras[0].group == 1:
        row |= _camera_figures(camera, truth)
        row |= path_figures(compared(answer.paths[0].path, truth, flight), truth)
    return row


def at_once(
    folders: tuple[Path, ...], config: SimConfig, truths: tuple[Truth, ...], flight: int
) -> NetworkAnswer:
    """Find clocks, poses and path of two or three cameras; parameters as of `at_once_row`."""
    with TemporaryDirectory() as name:
        work, n = Path(name), len(folders) + 1
        write_rig(work / "rig.yaml", calibrated(config, flight)[:n])
        paths = [work / f"cam{k + 1}.h5" for k in range(n)]
        for k in reversed(range(1, n)):
            write_events(work, folders[k - 1], truths[k - 1], flight, second=k)
            paths[1].rename(paths[k])
        return network(chain_of(paths, work / "rig.yaml", CONFIG)).network


def _camera_figures(camera: CameraAnswer, truth: Truth) -> dict[str, float]:
    """Give the columns of a row that tell of a camera whose distance is the unit of lengths."""
    assert camera.R is not None  # the network has it
    assert camera.t is not None
    assert camera.t_std is not None
    shown_s = float(truth.clock.cam2_from_cam1(camera.t_ref_s)) - camera.t_ref_s
    return {
        "t_d_error_ms": 1e3 * abs(camera.t_d_s - shown_s),
        "t_d_std_ms": 1e3 * camera.t_d_std_s,
        "skew_error_ppm": abs(camera.skew_ppm - truth.clock.skew_ppm),
        "skew_std_ppm": camera.skew_std_ppm,
        "r_error_deg": rotation_angle_deg(camera.R.T @ truth.R),
        "r_std_deg": camera.r_std_deg,
        "t_error_deg": angle_between_deg(camera.t, truth.t),
        "t_std_deg": float(np.rad2deg(np.linalg.norm(camera.t_std))),
    }
