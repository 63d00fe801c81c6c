"""One or two cameras' object motions in; times at which the object is seen, spread evenly, out.

Where it is seen most of the time, sample times are even and some of them fail. In flights spread
over an hour nearly all would, so that there the times at which it is seen are what is sampled.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssac.track.motion import Motion

Array = NDArray[np.float64]

MOST = 0.5
"""Share of the time in which the object must be seen for even sample times."""

_STEP_S = 0.02  # as finely as events' windows tell
_MAX_STEPS = 50_000


@dataclass(frozen=True)
class Seen:
    """Whether a camera sees the object, step by step."""

    start_s: float
    step_s: float
    valid: NDArray[np.bool_]  # (n,) at the middle of each step

    @property
    def share(self) -> float:
        """Of the time."""
        return float(np.mean(self.valid)) if len(self.valid) else 0.0


def seen_of(motion: Motion, step_s: float | None = None) -> Seen:
    """Look at a motion from end to end, in steps of its own choice where none is given."""
    start_s, end_s = motion.span_s
    length_s = max(end_s - start_s, 0.0) if np.isfinite(end_s - start_s) else 0.0
    step_s = max(_STEP_S, length_s / _MAX_STEPS) if step_s is None else step_s
    times_s = start_s + step_s * (np.arange(int(length_s / step_s), dtype=np.float64) + 0.5)
    return Seen(start_s, step_s, motion.at(times_s).valid)


def seen_times(seen: Seen, n: int) -> Array:
    """Spread n times [s] evenly over those at which one camera sees the object; empty for none."""
    return _spread(seen, seen.valid, 0, n)


def seen_by_both(one: Seen, other: Seen, t_d_s: float, n: int) -> Array | None:
    """Spread n times [s], camera 1's clock, over those at which both cameras see the object.

    None where they do so most of the time that both record, or never.

    Parameters
    ----------
    one, other
        Of camera 1 and 2, in the same steps.
    t_d_s
        What camera 2's clock shows more [s].
    n
        Times wanted.
    """
    shift = round((one.start_s + t_d_s - other.start_s) / one.step_s)  # other = one + shift
    first, last = max(0, -shift), min(len(one.valid), len(other.valid) - shift)
    if last <= first:
        return None
    both = one.valid[first:last] & other.valid[first + shift : last + shift]
    if not both.any() or np.mean(both) >= MOST:
        return None
    return _spread(one, both, first, n)


def _spread(seen: Seen, valid: NDArray[np.bool_], first: int, n: int) -> Array:
    steps = np.flatnonzero(valid)
    places = (np.arange(n) + 0.5) * len(steps) / n  # in steps of those valid
    whole = places.astype(np.intp)
    if len(steps) == 0:
        return np.empty(0)
    return np.asarray(seen.start_s + seen.step_s * (first + steps[whole] + places - whole))
