"""ZNCC_E, the paper's event-based baseline."""

import numpy as np

from ssac.config import Config
from ssac.estimate import Estimate
from ssac.events import US_PER_S
from ssac.methods.correlation import correlation_estimate, counted, lags_of, zncc
from ssac.track.observation import Observation

BIN_S = 0.010
"""Deviation: the paper gives no bin length; its errors of ZNCC_E are multiples of 10 ms."""


def zncc_e_of_events(one: Observation, other: Observation, config: Config) -> Estimate:
    """Time offset as the lag at which the event rates of both cameras correlate best.

    After Perot et al. (2020), as the paper uses it: the number of events in bins of 10 ms, and the
    lag with the highest zero-normalised cross-correlation in the search interval.

    Parameters
    ----------
    one, other
        Events of cameras 1 and 2 without noise.
    config
        Its interval is searched, in steps of one bin.
    """
    signal1 = counted(one.events["t"], round(BIN_S * US_PER_S))
    signal2 = counted(other.events["t"], round(BIN_S * US_PER_S))
    lags = lags_of(config, BIN_S)
    return correlation_estimate(
        "zncc_e", BIN_S * lags.astype(np.float64), zncc(signal1, signal2, lags)
    )
