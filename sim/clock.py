"""Times of the scene in; what a drifting or jumping clock shows beside a constant offset, out.

Camera 2's clock shows t + t_d + skew (t - t_ref), with t_ref the middle of the recording, and a
jump's size more from some time on. Camera 1's clock is the scene's.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.errors import SimError

MAX_SKEW_PPM = 100_000.0
"""Largest skew, either way: a tenth, far beyond any oscillator."""

Jump = tuple[float, float]
"""When a clock jumps [s, of the scene], and by how much [s]."""


@dataclass(frozen=True)
class Drift:
    """How camera 2's clock strays from a constant offset; the default does not."""

    skew_ppm: float = 0.0  # by which it runs fast
    t_ref_s: float = 0.0  # where the skew adds nothing
    jump: Jump | None = None

    def added_us(self, times_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return what the clock shows more (n,) [us] at times (n,) [us] of the scene.

        Rounded without the offset, so that recordings that differ in their offset alone differ by
        one number. Stamps stay in order: a microsecond adds less than one.
        """
        added_us = np.zeros(len(times_us), np.int64)
        if self.skew_ppm:
            since_us = times_us - 1e6 * self.t_ref_s
            added_us += np.rint(1e-6 * self.skew_ppm * since_us).astype(np.int64)
        if self.jump is not None:
            at_s, size_s = self.jump
            added_us[times_us >= round(1e6 * at_s)] += round(1e6 * size_s)
        return added_us


def drift_of(skew_ppm: float, jump: Jump | None, duration_s: float) -> Drift:
    """Check what a clock is to do during a recording.

    Parameters
    ----------
    skew_ppm
        At most `MAX_SKEW_PPM`, either way.
    jump
        Within the recording, and forwards. A clock that is set back would give each stamp of a
        while twice; what a driver makes of that differs, and seen from the other camera it is a
        jump forwards.
    duration_s
        Of the recording.

    Raises
    ------
    SimError
        When it cannot be.
    """
    if not abs(skew_ppm) <= MAX_SKEW_PPM:
        raise SimError(
            f"clock skew: expected -{MAX_SKEW_PPM:g} to {MAX_SKEW_PPM:g} ppm, got {skew_ppm:g}"
        )
    if jump is not None:
        at_s, size_s = jump
        if not 0.0 < at_s < duration_s:
            raise SimError(
                f"clock jump: expected a time within the flight, 0 to {duration_s:g} s,"
                f" got {at_s:g}"
            )
        if not 0.0 < size_s < np.inf:
            raise SimError(
                f"clock jump: expected a size above 0 s, got {size_s:g}: stamps of a clock that is"
                " set back are out of order; a jump forwards with the cameras swapped is the same"
            )
    return Drift(skew_ppm, duration_s / 2.0, jump)


def microseconds(seconds: float) -> int:
    """Return the nearest number of whole microseconds, which is what clocks show."""
    return round(seconds * 1e6)
