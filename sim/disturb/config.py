"""What is to spoil a recording, as one frozen dataclass; by default nothing is."""

from dataclasses import astuple, dataclass

import numpy as np

from sim.errors import SimError


@dataclass(frozen=True)
class DisturbConfig:
    """How a recording is spoilt: the same things in both cameras, drawn for each by itself."""

    lamp_px: int = 0  # side of the square of pixels that a lamp makes flicker
    hot_clusters: int = 0  # of 3 x 3 pixels each
    noise_hz: float = 0.0  # rate of noise events of each pixel
    branches: int = 0  # events of branches that sway, of each camera
    people: int = 0  # who walk through the view
    clouds_px_s: float = 0.0  # by which clouds drift over the sky
    second_object: float = 0.0  # share that is kept of the events of another flight
    intrinsics_error: tuple[float, float] = (0.0, 0.0)
    """Deviations of the draws by which the rig is wrong: focal lengths [%], centre [px]."""

    def __post_init__(self) -> None:
        for name in ("lamp_px", "hot_clusters", "noise_hz", "branches", "people", "clouds_px_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise SimError(f"disturbance: {name} must be 0 or a positive number, got {value}")
        if not 0.0 <= self.second_object <= 1.0:
            raise SimError(
                f"disturbance: second_object is a share, 0 to 1, got {self.second_object}"
            )
        percent, centre_px = self.intrinsics_error
        if not (0.0 <= percent <= MAX_FOCAL_PERCENT and 0.0 <= centre_px < np.inf):
            raise SimError(
                f"disturbance: intrinsics_error needs 0 to {MAX_FOCAL_PERCENT:g} % and 0 px or "
                f"more, got {percent} and {centre_px}"
            )

    @property
    def is_none(self) -> bool:
        """Whether the recording stays as it is."""
        return astuple(self) == astuple(DisturbConfig())


MAX_FOCAL_PERCENT = 10.0
"""Of which ten deviations are a focal length."""
