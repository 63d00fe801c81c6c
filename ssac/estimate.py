"""The result of every method: an offset, a pose, and how far each is to be relied upon."""

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from ssac.arrays import Array
from ssac.clock import Clock


class Status(str, Enum):
    """How far an estimate is to be relied upon: a word (`Status.OK == "ok"`) with its `meaning`.

    The order is that of the stages that refuse: of several refusals, the first is reported.
    """

    meaning: str  # for users
    remedy: str  # what to do

    OK = "ok", "all that is given is to be relied upon", ""
    SEVERAL_OBJECTS = (
        "several_objects",
        "several things move, and no pair of them in both views is clearly one object",
        "cut out a part of the recordings in which one object moves, or mask the others",
    )
    NO_COMMON_SIGNAL = (
        "no_common_signal",
        "at no lag searched do the signals of both cameras overlap by half and vary",
        "check the times of both files, or take a method that looks at positions",
    )
    NO_MOTION = (
        "no_motion",
        "the object hardly leaves its own outline, or is lost in noise",
        "let the object move through the view, or record with less noise",
    )
    NO_COMMON_TIME = (
        "no_common_time",
        "at no offset searched do both cameras record at a time",
        "leave out --search, or widen it",
    )
    TOO_FEW_SAMPLES = (
        "too_few_samples",
        "the object is seen well by both cameras at too few sample times",
        "record for longer, with the object in both views",
    )
    SEARCH_BOUND = (
        "search_bound",
        "the best offset lies at a bound of the search, or of what both have in common",
        "widen --search, or give --search-all; or record longer",
    )
    TOO_LITTLE_MOTION = (
        "too_little_motion",
        "the object turns back too seldom to tell an offset and a pose from chance",
        "record for longer, with more turns; or give the pose with --known-extrinsics",
    )
    NO_CONVERGENCE = (
        "no_convergence",
        "the iterations ran out, or left the minimum they began in",
        "check the rig: cameras, their order, resolution and lens",
    )
    CLOCK_JUMP = (
        "clock_jump",
        "camera 2's clock jumps: no one offset holds all along",
        "cut both recordings at the jump, and synchronise each part by itself",
    )
    NO_MATCH = (
        "no_match",
        "at no offset do the two views show one object's path",
        "check that both files are of one flight, and the rig of these cameras, in this order",
    )
    POOR_FIT = (
        "poor_fit",
        "what was refined fits far worse than one object seen by calibrated cameras does",
        "check the rig, and whether it is one rigid object; calibrate again",
    )
    AMBIGUOUS_OFFSET = (
        "ambiguous_offset",
        "several offsets fit alike, or the motion hardly tells one from another",
        "record for longer, on a path that is no line, circle or repeated loop; or narrow --search",
    )
    DEGENERATE_POSE = (
        "degenerate_pose",
        "the offset holds, but the path leaves the pose open",
        "use the offset; for the pose let the object move in all directions",
    )
    AMBIGUOUS_POSE = (
        "ambiguous_pose",
        "the offset holds, but several poses fit alike",
        "use the offset; for the pose let the object leave the plane in which it moved",
    )

    def __new__(cls, word: str, meaning: str, remedy: str) -> "Status":
        """Make a member that equals its word."""
        member = str.__new__(cls, word)
        member._value_ = word
        member.meaning, member.remedy = meaning, remedy
        return member

    def __str__(self) -> str:
        return str(self.value)

    @property
    def has_offset(self) -> bool:
        """Whether the offset of such an estimate holds, though its pose may be open."""
        return self is Status.OK or self in POSE_IS_OPEN


POSE_IS_OPEN = (Status.AMBIGUOUS_POSE, Status.DEGENERATE_POSE)
"""Statuses of estimates whose offset holds, but whose pose is not known."""

SETTLED_BY: dict[str, tuple[Status, ...]] = {
    stage: tuple(Status[word.upper()] for word in words.split())
    for stage, words in {
        "joint": "ambiguous_offset ambiguous_pose degenerate_pose",
        "tangency": "ambiguous_offset degenerate_pose poor_fit",
        "fast": "no_convergence clock_jump no_match poor_fit ambiguous_offset",
        "rates": "no_convergence no_match",
        "pieces": "clock_jump poor_fit",
        "all offsets": "several_objects no_common_time too_few_samples search_bound "
        "too_little_motion no_convergence clock_jump no_match poor_fit ambiguous_offset",
        "jump": "search_bound too_little_motion no_match ambiguous_offset",
        "closer": "several_objects clock_jump no_match poor_fit ambiguous_offset",
        "start": "several_objects no_motion no_convergence no_match poor_fit",
        "one object": "no_motion too_few_samples too_little_motion no_convergence no_match "
        "poor_fit ambiguous_offset",
        "few events": "no_motion too_few_samples too_little_motion",
        "longer": "several_objects poor_fit ambiguous_offset degenerate_pose",
        "noise": "several_objects clock_jump no_match poor_fit ambiguous_offset degenerate_pose",
        "lost": "no_motion too_few_samples",
        "thin": "too_little_motion no_match ambiguous_offset",
        "rig": "search_bound no_convergence no_match poor_fit degenerate_pose ambiguous_pose",
    }.items()
}
"""Refusals that each later stage may overrule: a refinement its start's, a fast clock or one of
pieces those of an ordinary clock, and a retry of `ssac.pipeline.retries` those of the default."""


@dataclass(frozen=True)
class Refusal:
    """Why a stage gives no estimate, or only a part of one."""

    status: Status
    reason: str
    t_d_s: float = np.nan  # the best of several offsets in question
    alternatives_s: tuple[float, ...] = ()  # the others [s]


def first(*refusals: Refusal | None) -> Refusal | None:
    """Return the refusal whose status comes first in `Status`; None if there is none."""
    there = [refusal for refusal in refusals if refusal is not None]
    return min(there, key=lambda refusal: list(Status).index(refusal.status), default=None)


@dataclass(frozen=True)
class ClockJump:
    """Where camera 2's clock jumps, and the offsets on both sides."""

    at_s: float  # camera 1's clock
    size_s: float  # how much more camera 2's clock shows from then on
    size_std_s: float  # standard deviation of size_s
    before_s: float  # t_d until then
    after_s: float  # t_d from then on

    def delayed(self, t_d_s: float) -> "ClockJump":
        """Return the jump as if camera 2's clock had shown `t_d_s` [s] more."""
        return replace(self, before_s=self.before_s + t_d_s, after_s=self.after_s + t_d_s)


def _unknown() -> Array:
    return np.full(2, np.nan)


@dataclass(frozen=True)
class Estimate:
    """The result of any method; what a method does not estimate stays NaN or None."""

    method: str  # its name
    status: str = Status.OK  # a Status; another package's method may give a word of its own
    reason: str = ""  # why there is no reliable estimate, as a sentence
    t_d_s: float = np.nan  # t_cam2 = t_cam1 + t_d, + skew (t_cam1 - t_ref) where there is one
    t_d_std_s: float = np.nan  # standard deviation of t_d
    R: Array | None = None  # (3, 3) x2 = R x1 + t
    t: Array | None = None  # (3,) length 1
    F: Array | None = None  # (3, 3) p2' F p1 = 0 for undistorted pixels, norm 1
    covariance: Array | None = None  # (6, 6) of t_d [s], R's three angles and t's two [rad]
    alternatives_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) other offsets t_d
    unobservable: Array = field(default_factory=lambda: np.empty((0, 6)))  # (k, 6) unit vectors
    t_ref_s: float = np.nan  # of the skew, camera 1's clock; NaN: both clocks are taken as alike
    skew_ppm: float = np.nan  # by which camera 2's clock runs fast
    skew_std_ppm: float = np.nan  # standard deviation of the skew
    clock_covariance: Array | None = None  # (2, 2) of t_d [s] and the skew [s/s]
    knots_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) as of `ssac.clock.Clock`
    strays_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) as of `ssac.clock.Clock`
    strays_std_s: Array = field(default_factory=lambda: np.empty(0))  # (k,) of the whole clock
    readouts_s: Array = field(default_factory=_unknown)  # (2,) of rolling shutters; NaN: not known
    readouts_std_s: Array = field(default_factory=_unknown)  # (2,) 0 where the rig states it
    jump: ClockJump | None = None  # with status "clock_jump"
    n_samples: int = 0  # valid pairs at the offset found
    d_avg_px: float = np.nan  # the paper's Eq. 4 at the offset found
    per_focal_deg: Array = field(default_factory=_unknown)
    """Angles (2,) by which R and t turn per relative lengthening of both cameras' focal lengths, to
    first order: the residuals hardly show an error that both share."""
    Ks: tuple[Array, Array] | None = None  # (3, 3) each: intrinsics that were fitted with the rest
    against: float = 0.0  # from the rig's intrinsics to the best-fitting ones, in deviations
    against_skew: float = 0.0  # the same of the skew, from its prior; inf: it was to be none
    misfit: str = ""  # which intrinsics would fit better, if the evidence is strong, as a sentence
    without_body: str = ""  # why tangents are not joined with a rigid body, as a part of a sentence
    doubt: str = ""  # what is not ordinary in the last step's fit, as a sentence
    candidates_s: Array = field(default_factory=lambda: np.empty(0))  # (M,) offsets tried
    costs: Array = field(default_factory=lambda: np.empty(0))  # (M,) d_avg [px] or -correlation
    start: "Estimate | None" = field(default=None, repr=False, compare=False)  # the one refined

    def __post_init__(self) -> None:
        if self.status in _MEMBERS:  # a word that is a status becomes the member
            object.__setattr__(self, "status", _MEMBERS[self.status])

    @property
    def has_offset(self) -> bool:
        """Whether `t_d_s` is to be relied upon, even if the pose is not."""
        holds = isinstance(self.status, Status) and self.status.has_offset
        return holds and bool(np.isfinite(self.t_d_s))

    @property
    def clock(self) -> Clock:
        """Both clocks, to convert times with."""
        if not np.isfinite(self.skew_ppm):
            return Clock(self.t_d_s)
        return Clock(self.t_d_s, self.skew_ppm, self.t_ref_s, self.knots_s, self.strays_s)

    def clock_std_s(self, times_s: Array) -> Array:
        """Deviation (n,) [s] of what `clock` shows at times (n,) [s] of camera 1's clock."""
        if self.clock_covariance is None:
            return np.full(np.shape(times_s), self.t_d_std_s)
        if len(self.knots_s):
            return np.asarray(np.interp(times_s, self.knots_s, self.strays_std_s))
        (var_t_d, both), (_, var_skew) = self.clock_covariance
        since_s = np.asarray(times_s) - self.t_ref_s
        return np.asarray(np.sqrt(var_t_d + 2.0 * both * since_s + var_skew * since_s**2))

    @property
    def r_std_deg(self) -> float:
        """Deviation [deg] of R: root of its three angles' summed variances; NaN if unknown."""
        return self._angle_std_deg(slice(1, 4))

    @property
    def t_std_deg(self) -> float:
        """Deviation [deg] of t's direction: root of the summed variances of its two angles."""
        return self._angle_std_deg(slice(4, 6))

    def delayed(self, t_d_s: float) -> "Estimate":
        """Return it as if camera 2's clock had shown `t_d_s` [s] more; the reason is unchanged."""
        return replace(
            self,
            t_d_s=self.t_d_s + t_d_s,
            alternatives_s=self.alternatives_s + t_d_s,
            candidates_s=self.candidates_s + t_d_s,
            jump=None if self.jump is None else self.jump.delayed(t_d_s),
            start=None if self.start is None else self.start.delayed(t_d_s),
        )

    def _angle_std_deg(self, part: slice) -> float:
        if self.covariance is None:
            return np.nan
        return float(np.rad2deg(np.sqrt(np.sum(np.diag(self.covariance)[part]))))


_MEMBERS: dict[str, Status] = {str(status): status for status in Status}
