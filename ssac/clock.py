"""Camera 2's clock: what it shows at times of camera 1's, and back.

The sign convention of the whole package, with t_ref on camera 1's clock:

    t_cam2 = t_cam1 + t_d + skew (t_cam1 - t_ref)

A clock that is not affine strays from this by a piecewise linear function of t_cam1.
"""

from dataclasses import dataclass, field

import numpy as np

from ssac.arrays import Array

PPM = 1e-6


@dataclass(frozen=True, eq=False)
class Clock:
    """Camera 2's clock as a function of camera 1's; by default they show the same."""

    t_d_s: float = 0.0  # offset at t_ref, before any stray
    skew_ppm: float = 0.0  # rate of camera 2's clock over camera 1's, less 1
    t_ref_s: float = 0.0  # camera 1's clock
    knots_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) ascending, camera 1's clock
    strays_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) added to the affine clock

    @property
    def is_delay(self) -> bool:
        """Whether the clocks differ by nothing but an offset."""
        return not self.skew_ppm and not len(self.knots_s)

    def added_s(self, times_s: Array | float) -> Array:
        """Return the difference (...,) [s] beside t_d; strays are constant beyond the knots."""
        added_s = PPM * self.skew_ppm * (times_s - self.t_ref_s)
        if len(self.knots_s):
            added_s = added_s + np.interp(times_s, self.knots_s, self.strays_s)
        return np.asarray(added_s)

    @property
    def stray_at_ref_s(self) -> float:
        """Return what the clock shows at t_ref [s] beyond its offset there."""
        return float(self.added_s(self.t_ref_s))

    def cam2_from_cam1(self, times_s: Array | float) -> Array:
        """Return what camera 2's clock shows (...,) [s] at times of camera 1's."""
        times_s = np.asarray(times_s, np.float64)
        shown_s = times_s + self.t_d_s
        return np.asarray(shown_s if self.is_delay else shown_s + self.added_s(times_s))

    def cam1_from_cam2(self, times_s: Array | float) -> Array:
        """Return what camera 1's clock shows (...,) [s] at times of camera 2's."""
        delayed_s = np.asarray(times_s, np.float64) - self.t_d_s
        if self.is_delay:
            return np.asarray(delayed_s)
        rate = 1.0 + PPM * self.skew_ppm
        # The inverse is linear between knots too: strays are interpolated at times of camera 2.
        knots_s, strays_s = self.knots_s, self.strays_s
        if not len(knots_s):
            return np.asarray(self.t_ref_s + (delayed_s - self.t_ref_s) / rate)
        shown_s = self.t_ref_s + rate * (knots_s - self.t_ref_s) + strays_s
        strayed_s = np.interp(delayed_s, shown_s, strays_s)
        return np.asarray(self.t_ref_s + (delayed_s - strayed_s - self.t_ref_s) / rate)

    def inverse(self) -> "Clock":
        """Return camera 1's clock as a function of camera 2's, with t_ref on camera 2's."""
        rate = 1.0 + PPM * self.skew_ppm
        return Clock(
            -self.t_d_s,
            (1.0 / rate - 1.0) / PPM,
            self.t_ref_s + self.t_d_s,
            self.cam2_from_cam1(self.knots_s),
            -self.strays_s / rate,
        )
