"""A flight as three cameras recorded it in; what all together tell beside its truth, out."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from experiments.outdoor.flights import Truth, calibrated
from experiments.outdoor.twin import (
    COLUMNS,
    CONFIG,
    compared,
    path_figures,
    write_events,
    write_rig,
)
from experiments.run.score import angle_between_deg, rotation_angle_deg
from sim.recording import SimConfig
from ssac.estimate import Status
from ssac.network.answers import CameraAnswer
from ssac.network.solve import NetworkAnswer
from ssac.tool.many import sync_all

THREE_CAMERAS = "three_cameras"
"""The kind of a row beside `twin.KINDS`: nothing is known, of a third camera neither."""


def three_row(
    folders: tuple[Path, Path], config: SimConfig, truths: tuple[Truth, Truth], flight: int
) -> dict[str, Any]:
    """Solve three cameras at once, and compare the second's clock and pose, and the path.

    Parameters
    ----------
    folders
        Of the recordings of cameras 1 and 2, and of cameras 1 and 3.
    config
        The former was simulated with.
    truths
        Theirs.
    flight
        Number of the flight.
    """
    answer, truth = three_cameras(folders, config, truths, flight), truths[0]
    camera = answer.cameras[1]
    row: dict[str, Any] = dict.fromkeys(COLUMNS, np.nan)
    row |= {"flight": flight, "kind": THREE_CAMERAS, "reason": answer.reason}
    row |= {"status": str(answer.status)}
    if camera.status == Status.OK and camera.R is not None and answer.cameras[0].group == 1:
        row |= _camera_figures(camera, truth)
        row |= path_figures(compared(answer.paths[0].path, truth, flight), truth)
    return row


def three_cameras(
    folders: tuple[Path, Path], config: SimConfig, truths: tuple[Truth, Truth], flight: int
) -> NetworkAnswer:
    """Find clocks, poses and path of three cameras, as `ssac sync` of three does."""
    with TemporaryDirectory() as name:
        work = Path(name)
        write_rig(work / "rig.yaml", calibrated(config, flight))
        paths = [work / f"cam{k}.h5" for k in (1, 2, 3)]
        write_events(work, folders[1], truths[1])
        paths[1].rename(paths[2])
        write_events(work, folders[0], truths[0])
        return sync_all(paths, work / "rig.yaml", config=CONFIG, search_all=True).answer


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
