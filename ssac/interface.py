"""What every method takes and gives, and how it refuses: Observation and Config in, Estimate out.

All methods, in `estimate`, `refinement` and `baselines`, have one signature:
`method(cam1, cam2, rig, config) -> Estimate`. Data without a reliable answer give an Estimate that
says why; malformed input raises SsacError.
"""

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Rig
from ssac.denoise import radius_filter, remove_hot_pixels
from ssac.errors import SsacError
from ssac.events import check_events
from ssac.fundamental import MIN_PAIRS
from ssac.offset_search import OffsetSearch
from ssac.tracks import ObjectMotion, object_motion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observation:
    """What one camera recorded, in its own clock."""

    events: NDArray[np.void]  # (n,) of EVENT_DTYPE, sorted by time
    frames: NDArray[np.generic] | None = None  # (m, height, width) intensities, for ZNCC_F
    frame_times_s: Array | None = None  # (m,) [s], ascending


@dataclass(frozen=True)
class Config:
    """Parameters of all methods; the defaults are those of the paper and its published sample."""

    interval_s: tuple[float, float] = (-1.0, 1.0)  # offsets searched, the paper's [t_b, t_e]
    n_samples: int = 400  # sample times per candidate offset, the paper's N
    half_window_s: float = 0.020  # of events on each side of a sample time
    n_min: int = 200  # events that a window holds at least, the paper's N_min
    border_px: int = 5  # width of the border in the margin rule
    max_border_fraction: float = 0.05  # of a window's events may lie on the border
    exhaustive: bool = False  # try an offset every 1 ms as the paper does, not coarse to fine
    robust: str = "lmeds"  # estimator of F: "lmeds" as in the paper, or "magsac"
    trials: int = 2000  # of LMedS at each candidate
    final_trials: int = 12000  # of LMedS at the offset found
    seed: int = 0  # of every random choice
    denoise: bool = True  # first remove hot pixels and isolated events


@dataclass(frozen=True)
class Estimate:
    """The result of any method; what a method does not estimate stays NaN or None."""

    method: str
    status: str = "ok"  # or the name of the reason why there is no reliable estimate
    reason: str = ""  # that reason as a sentence
    t_d_s: float = np.nan  # t_cam2 = t_cam1 + t_d
    t_d_std_s: float = np.nan  # standard deviation of t_d
    R: Array | None = None  # (3, 3) x2 = R x1 + t
    t: Array | None = None  # (3,) length 1
    F: Array | None = None  # (3, 3) p2' F p1 = 0 for undistorted pixels, norm 1
    covariance: Array | None = None  # (6, 6), parameters as in `refinement`
    n_samples: int = 0  # valid pairs at the offset found
    d_avg_px: float = np.nan  # the paper's Eq. 4 at the offset found
    candidates_s: Array = field(default_factory=lambda: np.empty(0))  # (M,) offsets tried
    costs: Array = field(default_factory=lambda: np.empty(0))  # (M,) d_avg [px] or -correlation


def checked(config: Config | None) -> Config:
    """Return the config, or the default for None; SsacError when a value makes no sense."""
    config = config or Config()
    low, high = config.interval_s
    if not (np.isfinite([low, high]).all() and low < high):
        raise SsacError(
            f"interval_s must be two finite offsets in ascending order, got {low, high}"
        )
    if config.robust not in ("lmeds", "magsac"):
        raise SsacError(f'robust must be "lmeds" or "magsac", got "{config.robust}"')
    for name in ("n_samples", "half_window_s", "n_min", "trials", "final_trials"):
        if not getattr(config, name) > 0:
            raise SsacError(f"{name} must be positive, got {getattr(config, name)}")
    return config


def usable_events(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Both cameras' events, checked, and denoised (Sec. IV-A) if the config asks for it.

    Raises
    ------
    SsacError
        If the events of a camera are empty, unsorted or outside its sensor.
    """
    events1, events2 = cam1.events, cam2.events
    check_events(events1, rig.cam1.width, rig.cam1.height, "camera 1")
    check_events(events2, rig.cam2.width, rig.cam2.height, "camera 2")
    if config.denoise:
        events1 = radius_filter(remove_hot_pixels(events1, rig.cam1.width, rig.cam1.height))
        events2 = radius_filter(remove_hot_pixels(events2, rig.cam2.width, rig.cam2.height))
    return events1, events2


def object_motions(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config
) -> tuple[ObjectMotion, ObjectMotion]:
    """Prepare the object's motion in both views: the paper's Sec. IV-A."""
    prepare = partial(
        object_motion,
        half_window_s=config.half_window_s,
        n_min=config.n_min,
        border_px=config.border_px,
        max_border_fraction=config.max_border_fraction,
    )
    events1, events2 = usable_events(cam1, cam2, rig, config)
    return prepare(events1, rig.cam1), prepare(events2, rig.cam2)


def known_pose(rig: Rig) -> tuple[Array, Array]:
    """R (3, 3) and t (3,) of length 1 of the rig; SsacError when they are unknown."""
    if rig.T_2_1 is None:
        raise SsacError("known extrinsics were asked for, but the rig has no T_2_1")
    length_m = np.linalg.norm(rig.T_2_1[:3, 3])
    if not length_m > 0.0:
        raise SsacError(f"the rig's T_2_1 must have a translation, got {rig.T_2_1[:3, 3]} m")
    return rig.T_2_1[:3, :3], np.asarray(rig.T_2_1[:3, 3] / length_m)


def offset_estimate(method: str, search: OffsetSearch, config: Config) -> Estimate:
    """Report the offset that a search found, or why there is none to be trusted."""
    low, high = config.interval_s
    where = f"offset between {low:g} and {high:g} s"
    status, reason = "ok", ""
    if len(search.candidates_s) == 0:
        status, reason = "no_common_time", f"the usable events have no common time at any {where}"
    elif np.isnan(search.t_d_s):
        status = "too_few_samples"
        reason = (
            f"at no {where} are {MIN_PAIRS} of {config.n_samples} sample times valid in both views:"
            f" a window of {2e3 * config.half_window_s:g} ms must hold {config.n_min} events or"
            f" more, and at most {100 * config.max_border_fraction:g} % of them on the border"
        )
    elif search.at_bound:
        status = "search_bound"
        reason = f"the best offset, {search.t_d_s:.3f} s, bounds the search: widen the interval"
    return Estimate(
        method,
        status,
        reason,
        search.t_d_s if status == "ok" else np.nan,
        candidates_s=search.candidates_s,
        costs=search.d_avg_px,
    )
