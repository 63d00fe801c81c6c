"""What every method takes and gives, and how it refuses: Observation and Config in, Estimate out.

All methods, in `estimate`, `refinement` and `baselines`, have one signature:
`method(cam1, cam2, rig, config) -> Estimate`. Data without a reliable answer give an Estimate that
says why; malformed input raises SsacError.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Camera, Rig, same_camera
from ssac.denoise import radius_filter, remove_hot_pixels
from ssac.errors import SsacError
from ssac.events import US_PER_S, check_events
from ssac.fundamental import MIN_PAIRS
from ssac.observability import Refusal, Valley
from ssac.offset_search import OffsetSearch
from ssac.tracks import ObjectMotion, object_motion

Array = NDArray[np.float64]

POSE_IS_OPEN = ("ambiguous_pose", "degenerate_pose")
"""Statuses of estimates whose offset holds all the same."""


@dataclass(frozen=True)
class Prepared:
    """What `prepare` found in one camera's events, and what from, so that it is not done again."""

    events: NDArray[np.void]  # (n,) the very array of the Observation, checked against the camera
    camera: Camera
    denoised: bool  # as in Observation
    border_px: int  # as in Config
    motion: ObjectMotion  # of the events


@dataclass(frozen=True)
class Observation:
    """What one camera recorded, in its own clock."""

    events: NDArray[np.void]  # (n,) of EVENT_DTYPE, sorted by time
    frames: NDArray[np.generic] | None = None  # (m, height, width) intensities, for ZNCC_F
    frame_times_s: Array | None = None  # (m,) [s], ascending
    prepared: Prepared | None = None  # by `prepare`; None: each method starts from the events

    def __post_init__(self) -> None:
        if self.prepared is not None and self.prepared.events is not self.events:
            raise SsacError(
                "a prepared Observation must keep its events, but other events were put in their"
                " place: make a new Observation of these, and prepare it"
            )

    @property
    def denoised(self) -> bool:
        """Whether the noise has left the events already."""
        return self.prepared is not None and self.prepared.denoised

    def delayed(self, t_d_s: float) -> "Observation":
        """As if the camera's clock had shown `t_d_s` [s] more; what is prepared stays so.

        Events count whole microseconds, so the delay is rounded to these, for frames as well.
        """
        shift_us = round(t_d_s * US_PER_S)
        events = self.events.copy()
        events["t"] += shift_us
        times_s, prepared = self.frame_times_s, self.prepared
        if times_s is not None:
            times_s = times_s + shift_us / US_PER_S
        if prepared is not None:
            prepared = replace(prepared, events=events, motion=prepared.motion.delayed(shift_us))
        return Observation(events, self.frames, times_s, prepared)


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
    alternatives_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) other offsets t_d
    unobservable: Array = field(default_factory=lambda: np.empty((0, 6)))  # (k, 6) unit vectors
    n_samples: int = 0  # valid pairs at the offset found
    d_avg_px: float = np.nan  # the paper's Eq. 4 at the offset found
    candidates_s: Array = field(default_factory=lambda: np.empty(0))  # (M,) offsets tried
    costs: Array = field(default_factory=lambda: np.empty(0))  # (M,) d_avg [px] or -correlation

    @property
    def has_offset(self) -> bool:
        """Whether `t_d_s` is to be relied upon: it may be though the pose is not."""
        return self.status in ("ok", *POSE_IS_OPEN) and bool(np.isfinite(self.t_d_s))


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


def prepare(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None
) -> tuple[Observation, Observation]:
    """Check, denoise and sum up the events once, for many methods and offsets.

    Every method gives the same estimate for the result as for what the cameras recorded, as long
    as the cameras, `border_px` and `denoise` stay as they are here; all else of the config may
    change at no cost. What another camera or border needs is done again from the events left, and
    denoising that was skipped is made up for, but noise once removed does not come back.

    Parameters
    ----------
    cam1, cam2
        What the two cameras recorded.
    rig
        Intrinsics; the extrinsics are not used.
    config
        Parameters; the defaults when None.

    Returns
    -------
    tuple of Observation
        Of camera 1 and camera 2, with `prepared`, and with the usable events as their events.

    Raises
    ------
    SsacError
        As `usable_events`, or if a parameter makes no sense.
    """
    config = checked(config)
    events1, events2 = usable_events(cam1, cam2, rig, config)
    return (
        _with_preparation(cam1, events1, rig.cam1, config),
        _with_preparation(cam2, events2, rig.cam2, config),
    )


def usable_events(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Both cameras' events, checked, and denoised (Sec. IV-A) if the config asks for it.

    Raises
    ------
    SsacError
        If the events of a camera are empty, unsorted or outside its sensor.
    """
    for name, observation, camera in (("camera 1", cam1, rig.cam1), ("camera 2", cam2, rig.cam2)):
        if observation.prepared is None or not same_camera(observation.prepared.camera, camera):
            check_events(observation.events, camera.width, camera.height, name)
    return _denoised(cam1, rig.cam1, config), _denoised(cam2, rig.cam2, config)


def object_motions(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config
) -> tuple[ObjectMotion, ObjectMotion]:
    """Prepare the object's motion in both views: the paper's Sec. IV-A."""
    events1, events2 = usable_events(cam1, cam2, rig, config)
    return _motion(cam1, events1, rig.cam1, config), _motion(cam2, events2, rig.cam2, config)


def _denoised(observation: Observation, camera: Camera, config: Config) -> NDArray[np.void]:
    """Events of one camera without noise if the config asks for it, else the very same array."""
    if observation.denoised or not config.denoise:
        return observation.events
    return radius_filter(remove_hot_pixels(observation.events, camera.width, camera.height))


def _motion(
    observation: Observation, events: NDArray[np.void], camera: Camera, config: Config
) -> ObjectMotion:
    """Motion of the usable events: the prepared one, where it is of these events and this camera.

    What it sums up does not depend on the parameters of its windows.
    """
    known = observation.prepared
    if (
        known is not None
        and known.events is events
        and known.border_px == config.border_px
        and same_camera(known.camera, camera)
    ):
        return replace(
            known.motion,
            half_window_s=config.half_window_s,
            n_min=config.n_min,
            max_border_fraction=config.max_border_fraction,
        )
    return object_motion(
        events,
        camera,
        half_window_s=config.half_window_s,
        n_min=config.n_min,
        border_px=config.border_px,
        max_border_fraction=config.max_border_fraction,
    )


def _with_preparation(
    observation: Observation, events: NDArray[np.void], camera: Camera, config: Config
) -> Observation:
    motion = _motion(observation, events, camera, config)
    denoised = observation.denoised or config.denoise
    prepared = Prepared(events, camera, denoised, config.border_px, motion)
    return replace(observation, events=events, prepared=prepared)


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


def refused(estimate: Estimate, refusal: Refusal, found: list[Valley] | None = None) -> Estimate:
    """Give the reason why there is no reliable offset, without what was found of the pose.

    Parameters
    ----------
    estimate
        What was found.
    refusal
        Why it is not to be relied upon.
    found
        Of the cost curve. With status "ambiguous_offset" the estimate keeps its offset when there
        are other single ones beside it, which go to `alternatives_s`.
    """
    others_s = np.array(sorted(valley.least_s for valley in (found or [])[1:]))
    keeps = refusal.status == "ambiguous_offset" and len(others_s) > 0
    return replace(
        estimate,
        status=refusal.status,
        reason=refusal.reason,
        t_d_s=estimate.t_d_s if keeps else np.nan,
        alternatives_s=others_s if keeps else np.empty(0),
        R=None,
        t=None,
        t_d_std_s=np.nan,
        covariance=None,
    )
