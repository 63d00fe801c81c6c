"""Offsets by correlation of two signals: event rates, and the brightness of frames."""

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate, Status
from ssac.events import US_PER_S
from ssac.methods.method import Input, method
from ssac.rules import SignalRules
from ssac.track.observation import Observation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Signal:
    """One number per time bin; bin b covers the times from b to b + 1 bin lengths."""

    first_bin: int
    values: Array  # (n,)


def counted(times_us: NDArray[np.int64], bin_us: int) -> Signal:
    """Count times (n,) [us], ascending, maybe none, in each bin from the first time to the last."""
    if len(times_us) == 0:
        return Signal(0, np.empty(0))
    first_bin, last_bin = int(times_us[0]) // bin_us, int(times_us[-1]) // bin_us
    bounds_us = bin_us * np.arange(first_bin + 1, last_bin + 1, dtype=np.int64)
    before = _first_from_each(times_us, bounds_us)
    counts = np.diff(before, prepend=0, append=len(times_us))
    return Signal(first_bin, counts.astype(np.float64))


@numba.njit(cache=True)
def _first_from_each(
    times_us: NDArray[np.int64], bounds_us: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Index (m,) of the first of n sorted times at or after each of ascending bounds [us]."""
    # As `ssac.events.first_from`, but each search begins where the last one ended and goes on in
    # doubled steps: bounds are so near each other that the rest of the times need not be looked at.
    indices = np.empty(len(bounds_us), np.int64)
    n, low = len(times_us), 0
    for k in range(len(bounds_us)):
        bound_us, step = bounds_us[k], 1
        while low + step < n and times_us[low + step] < bound_us:
            low += step
            step *= 2
        high = min(low + step, n)
        while low < high:
            middle = (low + high) // 2
            if times_us[middle] < bound_us:
                low = middle + 1
            else:
                high = middle
        indices[k] = low
    return indices


def binned(times_s: Array, values: Array | None, bin_s: float) -> Signal:
    """Average values (n,) at ascending times in each bin, empty bins interpolated; None counts."""
    bins = np.floor(times_s / bin_s + 1e-6).astype(np.int64)  # frame times are often exact bounds
    if len(bins) == 0:
        return Signal(0, np.empty(0))
    counts = np.bincount(bins - bins[0])
    if values is None:
        return Signal(int(bins[0]), counts.astype(np.float64))
    means = np.bincount(bins - bins[0], values) / np.maximum(counts, 1)
    filled = np.flatnonzero(counts)
    return Signal(int(bins[0]), np.interp(np.arange(len(counts)), filled, means[filled]))


def zncc(
    signal1: Signal,
    signal2: Signal,
    lags: NDArray[np.int64],
    min_overlap: float = SignalRules.min_overlap,
) -> Array:
    """Zero-normalised cross-correlation of signal1 at bin b with signal2 at bin b + lag.

    From -1 to 1, over the bins that both signals cover; NaN when these are less than a share of the
    shorter signal, or a signal is constant.
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


def lags_of(config: Config, bin_s: float) -> NDArray[np.int64]:
    """All whole lags [bins] within the search interval."""
    low, high = config.offsets_s
    return np.arange(np.ceil(low / bin_s - 1e-9), np.floor(high / bin_s + 1e-9) + 1).astype(
        np.int64
    )


def correlation_estimate(method: str, lags_s: Array, curve: Array) -> Estimate:
    """Choose the lag of highest correlation; status "no_common_signal" when there is none."""
    if not np.isfinite(curve).any():
        reason = (
            "at no lag in the interval do both signals overlap by half and vary: check that both"
            " cameras recorded at a time, and search where they did (--search)"
        )
        return Estimate(method, Status.NO_COMMON_SIGNAL, reason, candidates_s=lags_s, costs=-curve)
    best = int(np.nanargmax(curve))
    return Estimate(method, t_d_s=float(lags_s[best]), candidates_s=lags_s, costs=-curve)


@method("event_rate", "event rates, Censi and Scaramuzza (2014)", place=10, input=Input.RATES)
def event_rate_of_events(one: Observation, other: Observation, config: Config) -> Estimate:
    """Time offset as the lag at which the product of the event rates is largest.

    As the paper describes the method: events are counted over fixed intervals in both streams, and
    the counts, without their means, are correlated. Unlike `zncc_e` the correlation is normalised
    once for the whole recordings, not for the overlap at each lag, and the intervals are 1 ms.
    """
    bin_s = config.rules.signals.rate_bin_s
    signal1 = counted(one.events["t"], round(bin_s * US_PER_S))
    signal2 = counted(other.events["t"], round(bin_s * US_PER_S))
    lags = lags_of(config, bin_s)
    rate1, rate2 = _centred(signal1), _centred(signal2)
    power = float(np.linalg.norm(rate1) * np.linalg.norm(rate2))
    curve: NDArray[np.float64] = np.full(len(lags), np.nan)
    if power > 0.0:
        products = _correlated(rate2, rate1) / power
        shifts = np.arange(len(products)) + 1 - len(rate1) + signal2.first_bin - signal1.first_bin
        curve = np.interp(lags, shifts, products, left=np.nan, right=np.nan)
    return correlation_estimate("event_rate", bin_s * lags.astype(np.float64), curve)


def _correlated(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlate a with b at shifts from 1 - len(b) to len(a) - 1, as scipy.signal does."""
    n = len(a) + len(b) - 1
    n_fast = next_fast_len(n, real=True)
    return np.asarray(irfft(rfft(a, n_fast) * rfft(b[::-1], n_fast), n_fast)[:n], np.float64)


def _centred(signal: Signal) -> NDArray[np.float64]:
    return signal.values - np.sum(signal.values) / max(len(signal.values), 1)


@method("zncc_e", "correlation of event rates, offset only", place=8, input=Input.RATES)
def zncc_e_of_events(one: Observation, other: Observation, config: Config) -> Estimate:
    """Time offset as the lag at which the event rates of both cameras correlate best.

    After Perot et al. (2020), as the paper uses it: the number of events in bins, and the lag with
    the highest zero-normalised cross-correlation in the search interval.
    Deviation: the paper gives no bin length; its errors of ZNCC_E are multiples of 10 ms.
    """
    rules = config.rules.signals
    bin_s = rules.zncc_bin_s
    signal1 = counted(one.events["t"], round(bin_s * US_PER_S))
    signal2 = counted(other.events["t"], round(bin_s * US_PER_S))
    lags = lags_of(config, bin_s)
    return correlation_estimate(
        "zncc_e", bin_s * lags.astype(np.float64), zncc(signal1, signal2, lags, rules.min_overlap)
    )


@method(
    "zncc_f",
    "correlation of frame brightness, offset only",
    place=9,
    input=Input.FRAMES,
    takes_means=True,
)
def zncc_f_of_frames(one: Observation, other: Observation, config: Config) -> Estimate:
    """Time offset as the lag at which the brightness of both cameras' frames is most alike.

    After Perot et al. (2020), as the paper uses it: one number per frame, and the lag with the
    highest zero-normalised cross-correlation in the search interval.
    Deviation: the paper does not say which number; here it is the mean brightness, whose errors
    are nearest to the paper's at all angles (docs/zncc.md). Frames are put on one grid of 20 ms
    in both clocks, so that the offset found is a multiple of 20 ms, as the paper states.

    Raises
    ------
    SsacError
        If a camera has no frames, or not one time for each frame.
    """
    rules = config.rules.signals
    signal1, signal2 = (
        mean_brightness(seen, name, rules.frame_s)
        for seen, name in ((one, "camera 1"), (other, "camera 2"))
    )
    lags = lags_of(config, rules.frame_s)
    return correlation_estimate(
        "zncc_f",
        rules.frame_s * lags.astype(np.float64),
        zncc(signal1, signal2, lags, rules.min_overlap),
    )


def mean_brightness(observation: Observation, name: str, frame_s: float) -> Signal:
    """Mean of each frame, on a grid of even frames; SsacError when there are no frames."""
    frames, times_s = observation.frames, observation.frame_times_s
    if frames is None or times_s is None:
        raise SsacError(f"zncc_f compares intensity frames, but {name} recorded none")
    if len(frames) != len(times_s):
        raise SsacError(f"{name} has {len(frames)} frames but {len(times_s)} frame times")
    return binned(times_s, frame_means(frames), frame_s)


def frame_means(frames: NDArray[np.generic]) -> NDArray[np.float64]:
    """Means (n,) of frames (n, height, width), exact for integers."""
    kind = np.float64 if frames.dtype.kind == "f" else np.int64
    size = math.prod(frames.shape[1:])
    return np.asarray(np.sum(frames.reshape(len(frames), size), axis=1, dtype=kind) / size)
