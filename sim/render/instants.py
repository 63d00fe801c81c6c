"""Trajectory and camera in, the instants to render out: dense where the image moves fast."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.errors import SimError
from sim.render.footprint import footprint
from sim.scene.camera import Camera
from sim.scene.drone import Drone
from sim.scene.trajectory import PosesAt, Trajectory

FloatArray = NDArray[np.float64]

PROBE_HZ = 1000.0  # how finely the motion is looked at beforehand
PROBES_PER_TURN = 100  # and along a turn of a rotor


@dataclass(frozen=True)
class SamplingConfig:
    """Adaptive sampling after ESIM (Rebecq et al., CoRL 2018, section 3.1), in pixels moved."""

    max_step_px: float = 0.25  # largest image displacement between two instants
    min_rate_hz: float = 100.0  # also when nothing moves or the drone is out of view

    def __post_init__(self) -> None:
        for name in ("max_step_px", "min_rate_hz"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise SimError(f"sampling: {name} must be a positive number, got {value}")


def choose_instants(
    drone: Drone, camera: Camera, trajectory: Trajectory, config: SamplingConfig | None = None
) -> FloatArray:
    """Choose the instants to render for one camera.

    Each camera has instants of its own, so that the bound holds in all of them without any being
    rendered as densely as the fastest view needs.

    Parameters
    ----------
    drone
    camera
    trajectory
    config

    Returns
    -------
    FloatArray
        Increasing times [s] from 0 to the trajectory's end, both included. Between two of them no
        point of the drone's outline moves by more than `max_step_px`, to about 1 %, where it is
        in view.
    """
    config = config or SamplingConfig()
    turns_hz = [abs(part.joint.rate_hz) for part in drone.parts if part.joint is not None]
    probe_hz = max([PROBE_HZ, *(PROBES_PER_TURN * rate for rate in turns_hz)])
    n_probes = max(2, int(np.ceil(trajectory.duration_s * probe_hz)) + 1)
    probes_s: FloatArray = np.linspace(0.0, trajectory.duration_s, n_probes, dtype=np.float64)
    moved_px = footprint(drone, camera, probes_s, PosesAt(trajectory, probes_s)).moved_px
    # Count steps: along the sum of displacements, or of time where that asks for more.
    steps = np.maximum(moved_px[1:] / config.max_step_px, np.diff(probes_s) * config.min_rate_hz)
    count = np.concatenate([[0.0], np.cumsum(steps)])
    n_instants = int(np.ceil(count[-1])) + 1
    return np.interp(np.linspace(0.0, count[-1], n_instants), count, probes_s)
