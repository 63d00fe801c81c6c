"""ZNCC_F, the paper's frame-based baseline: intensity frames in, time offset out."""

import math

import numpy as np
from numpy.typing import NDArray

from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.methods.correlation import Signal, binned, correlation_estimate, lags_of, zncc
from ssac.track.observation import Observation

FRAME_S = 0.020
"""Time between frames at the paper's 50 Hz, and so the unit of the offsets found."""


def zncc_f_of_frames(one: Observation, other: Observation, config: Config) -> Estimate:
    """Time offset as the lag at which the brightness of both cameras' frames is most alike.

    After Perot et al. (2020), as the paper uses it: one number per frame, and the lag with the
    highest zero-normalised cross-correlation in the search interval.
    Deviation: the paper does not say which number; here it is the mean brightness, whose errors
    are nearest to the paper's at all angles (docs/zncc.md). Frames are put on one grid of 20 ms
    in both clocks, so that the offset found is a multiple of 20 ms, as the paper states.

    Parameters
    ----------
    one, other
        Frames of cameras 1 and 2.
    config
        Its interval is searched.

    Raises
    ------
    SsacError
        If a camera has no frames, or not one time for each frame.
    """
    signal1, signal2 = mean_brightness(one, "camera 1"), mean_brightness(other, "camera 2")
    lags = lags_of(config, FRAME_S)
    return correlation_estimate(
        "zncc_f", FRAME_S * lags.astype(np.float64), zncc(signal1, signal2, lags)
    )


def mean_brightness(observation: Observation, name: str) -> Signal:
    """Mean of each frame, on the grid of 20 ms; SsacError when there are no frames."""
    frames, times_s = observation.frames, observation.frame_times_s
    if frames is None or times_s is None:
        raise SsacError(f"zncc_f compares intensity frames, but {name} recorded none")
    if len(frames) != len(times_s):
        raise SsacError(f"{name} has {len(frames)} frames but {len(times_s)} frame times")
    return binned(times_s, frame_means(frames), FRAME_S)


def frame_means(frames: NDArray[np.generic]) -> NDArray[np.float64]:
    """Means (n,) of frames (n, height, width), exact for integers."""
    kind = np.float64 if frames.dtype.kind == "f" else np.int64
    size = math.prod(frames.shape[1:])
    return np.asarray(np.sum(frames.reshape(len(frames), size), axis=1, dtype=kind) / size)
