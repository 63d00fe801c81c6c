"""Two views and what is not known of their rolling shutters in; the views, read out otherwise, out.

A frame's row is exposed its share of the height, times the readout, later than the frame's time. So
a readout that is longer by d shows the object at a time t where it was d times that share before:
its image moves by that much against its velocity.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ssac.camera import MAX_READOUT_S, distort_points
from ssac.estimate import Estimate
from ssac.search.two_views import TwoViews
from ssac.track.motion import PointMotion

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shutters:
    """The k cameras, of both, whose readout is to be estimated; none by default."""

    cameras: tuple[int, ...] = ()  # 0 and 1
    expected_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) readouts beforehand
    deviations_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) of what is expected
    longest_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) a frame's length

    def views(self, views: TwoViews, readouts_s: Array) -> TwoViews:
        """Give both views with points where readouts (k,) [s] put them in time."""
        motions = [views.motion1, views.motion2]
        for k, readout_s in zip(self.cameras, readouts_s.tolist(), strict=True):
            motion = motions[k]
            if isinstance(motion, PointMotion):
                motions[k] = motion.read_out(readout_s)
        return replace(views, motion1=motions[0], motion2=motions[1]) if self.cameras else views

    def told(self, views: TwoViews, estimate: Estimate) -> TwoViews:
        """Give both views with the readouts of an estimate, or those expected where it has none."""
        found_s = estimate.readouts_s[list(self.cameras)]
        return self.views(views, np.where(np.isnan(found_s), self.expected_s, found_s))

    def moves(self, views: TwoViews, times_s: tuple[Array, Array]) -> list[tuple[Array, Array]]:
        """Give how both images move (n, 2) [px] by a longer readout of each, per second of it.

        Parameters
        ----------
        views
            As they are read out.
        times_s
            When they are sampled, each (n,) on its camera's clock.
        """
        found = []
        for k in self.cameras:
            motion = (views.motion1, views.motion2)[k]
            camera = (views.rig.cam1, views.rig.cam2)[k]
            track = motion.sharp_at(times_s[k])
            rows = distort_points(camera, track.positions_px)[:, 1] / max(camera.height - 1, 1)
            moved = -rows[:, None] * track.velocities_px_s
            nothing = np.zeros_like(moved)
            found.append((moved, nothing) if k == 0 else (nothing, moved))
        return found

    def within(self, readouts_s: Array) -> Array:
        """Give the readouts (k,) [s] that are nearest to some, from none to a frame's length."""
        return np.asarray(np.clip(readouts_s, 0.0, self.longest_s))


def shutters_of(views: TwoViews) -> Shutters:
    """Say which cameras' readouts are to be estimated: of tracks, and not exactly known."""
    found = []
    for k, motion in enumerate((views.motion1, views.motion2)):
        camera = (views.rig.cam1, views.rig.cam2)[k]
        if camera.readout_std_s > 0.0 and isinstance(motion, PointMotion):
            longest_s = min(motion.interval_s, MAX_READOUT_S)
            found.append((k, camera.readout_s or 0.0, camera.readout_std_s, longest_s))
    if not found:
        return Shutters()
    cameras, *numbers = zip(*found, strict=True)
    return Shutters(cameras, *(np.array(some, np.float64) for some in numbers))
