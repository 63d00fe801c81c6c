"""Offsets by correlation of two signals: event rates, and the brightness of frames."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from ssac.arrays import Array, IntArray
from ssac.config import Config
from ssac.estimate import Estimate, Status
from ssac.events import US_PER_S
from ssac.methods.method import Input, method
from ssac.rules import SignalRules
from ssac.track.observation import Observation


@dataclass(frozen=True)
class Signal:
    """One number per time bin; bin b covers the times from b to b + 1 bin lengths."""

    first_bin: int  # number b of the first value's bin
    values: Array  # (n,)


def counted(times_us: IntArray, bin_us: int) -> Signal:
    """Count ascending times (n,) [us] in each bin from the first to the last; n may be 0."""
    if len(times_us) == 0:
        return Signal(0, np.empty(0))
    bins = times_us // bin_us
    return Signal(int(bins[0]), np.bincount(bins - bins[0]).astype(np.float64))


def binned(times_s: Array, values: Array, bin_s: float) -> Signal:
    """Average values (n,) at ascending times in each bin; empty bins are interpolated."""
    bins = np.floor(times_s / bin_s + 1e-6).astype(np.int64)  # frame times are often bounds of bins
    if len(bins) == 0:
        return Signal(0, np.empty(0))
    counts = np.bincount(bins - bins[0])
    means = np.bincount(bins - bins[0], values) / np.maximum(counts, 1)
    filled = np.flatnonzero(counts)
    return Signal(int(bins[0]), np.interp(np.arange(len(counts)), filled, means[filled]))


def zncc(
    signal1: Signal, signal2: Signal, lags: IntArray, min_overlap: float = SignalRules.min_overlap
) -> Array:
    """Zero-normalised cross-correlation of signal1 at bin b with signal2 at bin b + lag.

    Each value, from -1 to 1, is over the bins that both signals cover; it is NaN where these are
    fewer than 2 or than a share `min_overlap` of the shorter signal, or a signal is constant there.
    """
    curve = np.full(len(lags), np.nan)
    needed = max(2.0, min_overlap * min(len(signal1.values), len(signal2.values)))
    for i, lag in enumerate(lags.tolist()):
        shift = signal1.first_bin + lag - signal2.first_bin  # bin 0 of signal1 in signal2
        start, end = max(0, -shift), min(len(signal1.values), len(signal2.values) - shift)
        if end - start < needed:
            continue
        a, b = signal1.values[start:end], signal2.values[start + shift : end + shift]
        a, b = a - np.add.reduce(a) / len(a), b - np.add.reduce(b) / len(b)
        power = np.sqrt((a @ a) * (b @ b))
        if power > 0.0:
            curve[i] = a @ b / power
    return curve


def lags_of(config: Config, bin_s: float) -> IntArray:
    """All whole lags [bins] within the search interval."""
    low, high = config.offsets_s
    first, last = np.ceil(low / bin_s - 1e-9), np.floor(high / bin_s + 1e-9)
    return np.arange(first, last + 1).astype(np.int64)


def correlation_estimate(method: str, lags_s: Array, curve: Array) -> Estimate:
    """Choose the lag of highest correlation; status "no_common_signal" when there is none."""
    found = Estimate(method, candidates_s=lags_s, costs=-curve)
    if not np.isfinite(curve).any():
        reason = (
            "at no lag in the interval do both signals overlap by half and vary: check that both"
            " cameras recorded at a time, and search where they did (--search)"
        )
        if len(lags_s) == 0:
            reason = "no multiple of the bins' length lies in the interval: widen it (--search)"
        return replace(found, status=Status.NO_COMMON_SIGNAL, reason=reason)
    return replace(found, t_d_s=float(lags_s[np.nanargmax(curve)]))


@method("event_rate", "event rates, Censi and Scaramuzza (2014)", place=10, input=Input.RATES)
def event_rate_of_events(one: Observation, other: Observation, config: Config) -> Estimate:
    """Time offset as the lag at which the product of the event rates is largest.

    As the paper describes the method: events are counted over fixed intervals in both streams, and
    the counts, without their means, are correlated. Unlike `zncc_e` the correlation is normalised
    once for the whole recordings, not for the overlap at each lag, and the intervals are 1 ms.
    """
    bin_s = config.rules.signals.rate_bin_s
    signals = [counted(seen.events["t"], round(bin_s * US_PER_S)) for seen in (one, other)]
    lags, shift = lags_of(config, bin_s), signals[1].first_bin - signals[0].first_bin
    rate1, rate2 = (
        signal.values - np.sum(signal.values) / max(len(signal.values), 1) for signal in signals
    )
    power = float(np.linalg.norm(rate1) * np.linalg.norm(rate2))
    curve: Array = np.full(len(lags), np.nan)
    if power > 0.0:
        n = len(rate2) + len(rate1) - 1
        n_fast = next_fast_len(n, real=True)
        spectrum = rfft(rate2, n_fast) * rfft(rate1[::-1], n_fast)  # as scipy.signal does
        products = np.asarray(irfft(spectrum, n_fast)[:n], np.float64) / power
        shifts = np.arange(n) + 1 - len(rate1) + shift
        curve = np.interp(lags, shifts, products, left=np.nan, right=np.nan)
    return correlation_estimate("event_rate", bin_s * lags.astype(np.float64), curve)


@method("zncc_e", "correlation of event rates, offset only", place=8, input=Input.RATES)
def zncc_e_of_events(one: Observation, other: Observation, config: Config) -> Estimate:
    """Time offset as the lag at which the event rates of both cameras correlate best.

    After Perot et al. (2020), as the paper uses it: the number of events in bins, and the lag with
    the highest zero-normalised cross-correlation in the search interval.
    Deviation: the paper gives no bin length; its errors of ZNCC_E are multiples of 10 ms.
    """
    bin_s = config.rules.signals.zncc_bin_s
    signals = [counted(seen.events["t"], round(bin_s * US_PER_S)) for seen in (one, other)]
    return _most_alike("zncc_e", signals, bin_s, config)


def _most_alike(method: str, signals: list[Signal], bin_s: float, config: Config) -> Estimate:
    lags = lags_of(config, bin_s)
    curve = zncc(signals[0], signals[1], lags, config.rules.signals.min_overlap)
    return correlation_estimate(method, bin_s * lags.astype(np.float64), curve)


@method(
    "zncc_f",
    "correlation of frame brightness, offset only",
    place=9,
    input=Input.FRAMES,
    takes_means=True,
)
def zncc_f_of_frames(one: Observation, other: Observation, config: Config) -> Estimate:
    """Time offset as the lag at which the brightness of both cameras' frames is most alike.

    After Perot et al. (2020), as `zncc_e`, with one number per frame. Deviation: the paper does not
    say which; here it is the mean brightness, whose errors are nearest to the paper's at all angles
    (docs/methods.md). Frames are put on one grid of 20 ms in both clocks, so that the offset found
    is a multiple of 20 ms, as the paper states.
    """
    frame_s, signals = config.rules.signals.frame_s, []
    for seen in (one, other):
        assert seen.frames is not None  # a method that lacks frames is not run
        assert seen.frame_times_s is not None
        signals.append(binned(seen.frame_times_s, frame_means(seen.frames), frame_s))
    return _most_alike("zncc_f", signals, frame_s, config)


def frame_means(frames: NDArray[np.generic]) -> Array:
    """Means (n,) of frames (n, height, width), exact for integers."""
    kind = np.float64 if frames.dtype.kind == "f" else np.int64
    size = math.prod(frames.shape[1:])
    return np.asarray(np.sum(frames.reshape(len(frames), size), axis=1, dtype=kind) / size)
