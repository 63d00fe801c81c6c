"""ZNCC_E, the paper's event-based baseline: event rates in, time offset out."""

import numpy as np

from ssac.baselines.correlation import correlation_estimate, counted, lags_of, zncc
from ssac.camera import Rig
from ssac.config import Config, checked
from ssac.estimate import Estimate
from ssac.events import US_PER_S
from ssac.track.observation import Observation, usable_events

BIN_S = 0.010
"""Deviation: the paper gives no bin length; its errors of ZNCC_E are multiples of 10 ms."""


def zncc_e(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None
) -> Estimate:
    """Time offset as the lag at which the event rates of both cameras correlate best.

    After Perot et al. (2020), as the paper uses it: the number of events in bins of 10 ms, and the
    lag with the highest zero-normalised cross-correlation in the search interval.

    Parameters and errors as for `ssac.methods.algorithms.ssac_known`; of the rig only the
    sensor sizes matter. The resolution is one bin.
    """
    config = checked(config)
    events1, events2 = usable_events(cam1, cam2, rig, config)
    signal1 = counted(events1["t"], round(BIN_S * US_PER_S))
    signal2 = counted(events2["t"], round(BIN_S * US_PER_S))
    lags = lags_of(config, BIN_S)
    return correlation_estimate(
        "zncc_e", BIN_S * lags.astype(np.float64), zncc(signal1, signal2, lags)
    )
