"""How much less sure an offset is of recordings whose times somebody rounded."""

from dataclasses import replace

import numpy as np

from ssac.estimate import Estimate
from ssac.events import US_PER_S, time_quantum_s
from ssac.track.observation import Observation

_FEW = 1000  # events of which one is off a coarse grid, unless all are on it


def quantum_s(camera: Observation) -> float:
    """Step [s] to which a camera's times were rounded: 10 or 1 ms, or 0."""
    if camera.track is not None:
        return time_quantum_s(camera.track.times_s)
    some_us = camera.events["t"][:_FEW]
    if len(some_us) == 0 or np.any(some_us % 1000):
        return 0.0
    return time_quantum_s(camera.events["t"] / US_PER_S)


def less_sure(estimate: Estimate, quanta_s: tuple[float, float]) -> Estimate:
    """Widen the offset's deviation by what the rounding of times may shift it.

    Times cut off below a step of q are late by q / 2 on average, rounded ones are not: +-1.96
    deviations of an even distribution of width q hold both.
    """
    hidden = sum(step_s**2 for step_s in quanta_s) / 12.0
    if hidden == 0.0 or not np.isfinite(estimate.t_d_std_s):
        return estimate
    covariance = estimate.covariance
    if covariance is not None:
        covariance = covariance.copy()
        covariance[0, 0] += hidden
    of_clock = estimate.clock_covariance
    if of_clock is not None:
        of_clock = of_clock + np.diag([hidden, 0.0])
    return replace(
        estimate,
        t_d_std_s=float(np.hypot(estimate.t_d_std_s, hidden**0.5)),
        covariance=covariance,
        clock_covariance=of_clock,
        strays_std_s=np.hypot(estimate.strays_std_s, hidden**0.5),
    )
