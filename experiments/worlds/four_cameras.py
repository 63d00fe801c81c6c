"""A flight before four event cameras on a half circle, 60 deg apart.

The sensors are ideal. Recordings are simulated with equal clocks; each camera's offset is added
where its events are written for the estimator.
"""

from dataclasses import dataclass, field

from sim.recording import Scene, SimConfig
from sim.scene.rig import look_at_rig
from sim.sensor.frames import FrameConfig

T_D_S = (0.0, 0.05, -0.23, 0.41)
"""By how much each clock shows more than the first."""

ANGLE_DEG = 60.0
"""From each camera to the next."""

N_CAMERAS = len(T_D_S)


@dataclass(frozen=True)
class FourCameras(SimConfig):
    """The default flight and drone, before four cameras."""

    angle_deg: float = ANGLE_DEG
    frames: FrameConfig = field(default_factory=lambda: FrameConfig(rate_hz=0.0))

    def scene(self, seed: int) -> Scene:
        """Build the default scene, with more cameras: all equal, as are their backgrounds."""
        two = super().scene(seed)
        rig = look_at_rig(
            [self.angle_deg * k for k in range(N_CAMERAS)],
            distance_m=self.distance_m,
            focal_px=self.focal_px,
            resolution=self.resolution,
            principal_point=self.principal_point,
        )
        return Scene(rig, two.backgrounds[:1] * N_CAMERAS, two.drone, two.trajectory)
