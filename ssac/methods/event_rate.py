"""Event-rate matching after Censi and Scaramuzza (2014)."""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from ssac.config import Config
from ssac.estimate import Estimate
from ssac.events import US_PER_S
from ssac.methods.correlation import Signal, correlation_estimate, counted, lags_of
from ssac.track.observation import Observation

BIN_S = 0.001
"""Interval in which events are counted."""


def event_rate_of_events(one: Observation, other: Observation, config: Config) -> Estimate:
    """Time offset as the lag at which the product of the event rates is largest.

    As the paper describes the method: events are counted over fixed intervals in both streams, and
    the counts, without their means, are correlated. Unlike `zncc_e` the correlation is normalised
    once for the whole recordings, not for the overlap at each lag, and the intervals are 1 ms.

    Parameters
    ----------
    one, other
        Events of cameras 1 and 2 without noise.
    config
        Its interval is searched, in steps of one interval.
    """
    signal1 = counted(one.events["t"], round(BIN_S * US_PER_S))
    signal2 = counted(other.events["t"], round(BIN_S * US_PER_S))
    lags = lags_of(config, BIN_S)
    rate1, rate2 = _centred(signal1), _centred(signal2)
    power = float(np.linalg.norm(rate1) * np.linalg.norm(rate2))
    curve: NDArray[np.float64] = np.full(len(lags), np.nan)
    if power > 0.0:
        products = _correlated(rate2, rate1) / power
        shifts = np.arange(len(products)) + 1 - len(rate1) + signal2.first_bin - signal1.first_bin
        curve = np.interp(lags, shifts, products, left=np.nan, right=np.nan)
    return correlation_estimate("event_rate", BIN_S * lags.astype(np.float64), curve)


def _correlated(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlate a with b at shifts from 1 - len(b) to len(a) - 1, as scipy.signal does."""
    n = len(a) + len(b) - 1
    n_fast = next_fast_len(n, real=True)
    return np.asarray(irfft(rfft(a, n_fast) * rfft(b[::-1], n_fast), n_fast)[:n], np.float64)


def _centred(signal: Signal) -> NDArray[np.float64]:
    return signal.values - np.sum(signal.values) / max(len(signal.values), 1)
