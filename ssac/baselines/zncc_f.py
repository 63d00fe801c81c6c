"""ZNCC_F, the paper's frame-based baseline: intensity frames in, time offset out."""

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from ssac.baselines.correlation import Signal, binned, correlation_estimate, lags_of, zncc
from ssac.camera import Rig
from ssac.errors import SsacError
from ssac.interface import Config, Estimate, Observation, checked

FRAME_S = 0.020
"""Time between frames at the paper's 50 Hz, and so the unit of the offsets found."""


def zncc_f(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None
) -> Estimate:
    """Time offset as the lag at which the frames of both cameras change most alike.

    After Perot et al. (2020), as the paper uses it: one number per frame, and the lag with the
    highest zero-normalised cross-correlation in the search interval.
    Deviation: the paper does not say which number; here it is the mean absolute difference from
    the frame before, the counterpart of the event rate. Frames are put on one grid of 20 ms in
    both clocks, so that the offset found is a multiple of 20 ms, as the paper states.

    Parameters as for `ssac.estimate.ssac_known`; the rig is not used.

    Raises
    ------
    SsacError
        If a camera has no frames, or not one time for each frame.
    """
    config = checked(config)
    signal1, signal2 = _frame_changes(cam1, "camera 1"), _frame_changes(cam2, "camera 2")
    lags = lags_of(config, FRAME_S)
    return correlation_estimate(
        "zncc_f", FRAME_S * lags.astype(np.float64), zncc(signal1, signal2, lags)
    )


def _frame_changes(observation: Observation, name: str) -> Signal:
    """Mean absolute difference of each frame from the one before, on the grid of 20 ms."""
    frames, times_s = observation.frames, observation.frame_times_s
    if frames is None or times_s is None:
        raise SsacError(f"zncc_f compares intensity frames, but {name} recorded none")
    if len(frames) != len(times_s):
        raise SsacError(f"{name} has {len(frames)} frames but {len(times_s)} frame times")
    changes = [_mean_change(before, after) for before, after in pairwise(frames)]
    return binned(times_s[1:], np.array(changes), FRAME_S)


def _mean_change(before: NDArray[np.generic], after: NDArray[np.generic]) -> float:
    if before.dtype == after.dtype == np.uint8:  # the same in whole numbers, a tenth of the time
        first, second = before.astype(np.uint8, copy=False), after.astype(np.uint8, copy=False)
        return float(cv2.norm(first, second, cv2.NORM_L1)) / first.size
    return float(np.mean(np.abs(after.astype(np.float64) - before.astype(np.float64))))
