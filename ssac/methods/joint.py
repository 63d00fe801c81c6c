"""Offset and pose refined together by robust least squares, from a search's result.

Beyond the paper. The residuals are Sampson distances between the positions p1(t_i) and
p2(t_i + t_d), as `ssac.fit.least_squares` has them.

What limits the accuracy is not noise: the mean of the events is the image of no fixed point of the
object, but has a bias that changes slowly with attitude and grows with the object's image. So the
positions are those of `ObjectMotion.sharp_at`, and each residual is weighted by the inverse of its
images' size.
"""

from collections.abc import Hashable
from dataclasses import replace

import numpy as np

from ssac.arrays import Array
from ssac.clock import PPM
from ssac.estimate import Estimate, Status
from ssac.fit.least_squares import Parameters, Residuals, WeighedPairs, linearise
from ssac.methods.clocks import checked_clock, with_coarse_skew
from ssac.methods.hypotheses import Choice
from ssac.methods.method import method
from ssac.methods.refinement import Refinement, Round, smooth_errors
from ssac.methods.verdict import certain, doubt, is_spread
from ssac.search.two_views import TwoViews


@method(
    "joint",
    "ssac, then offset and pose refined together",
    place=3,
    known="ssac-known, then the offset refined",
    starts_from="ssac",
    finds_readout=True,
    follows_clock=True,
    of_one_object=True,
)
def joint_from(start: Estimate, views: TwoViews) -> Estimate:
    """Refine offset and pose together, or the offset alone where the pose is known.

    The start is what Algorithm 2, or Algorithm 1 with a known pose, found of the same views.
    """
    name = "joint-known" if views.pose_is_known else "joint"
    start = with_coarse_skew(start, views)
    start = replace(start, method=name, start=start)
    choice = Choice(views, refine)
    found = choice.confirmed(certain(choice.settled(start), views.rules.verdict), start)
    return _with_any_skew(found, views)


def _with_any_skew(found: Estimate, views: TwoViews) -> Estimate:
    """Say that the skew is only known by its prior, where an object on a line left it open."""
    prior_ppm = views.config.prior_ppm
    if not found.has_offset or found.clock_covariance is not None or not prior_ppm > 0.0:
        return found
    return replace(
        found,
        t_ref_s=0.5 * sum(views.common_s(found.t_d_s)),
        skew_ppm=float(np.nan_to_num(found.skew_ppm)),
        skew_std_ppm=prior_ppm,
        clock_covariance=np.diag([found.t_d_std_s, PPM * prior_ppm]) ** 2,
    )


def refine(start: Estimate, views: TwoViews) -> Estimate:
    """Minimise Cauchy's loss of the Sampson distances, from an offset and a pose.

    A start that is not "ok" is returned as it is. With a known pose only t_d is refined, and there
    is a `t_d_std_s` but no `covariance`. The views keep what was refined: where `joint` refuses,
    `tangency` begins with the same starts.
    """
    if start.status != Status.OK or start.R is None or start.t is None:
        return start
    content = _content(start)
    if content not in views.refined:
        views.refined[content] = _OfPositions(start, views).estimate(start.R, start.t)
    return replace(views.refined[content], method=start.method, start=start.start)


def _content(start: Estimate) -> Hashable:
    """Return all that an estimate holds but its method and start, to the last bit."""
    values = {**vars(start), "method": "", "start": None}.values()
    return tuple(
        np.asarray(one).tobytes() if isinstance(one, (np.ndarray, tuple)) else repr(one)
        for one in values
    )


class _OfPositions(Refinement):
    """Pairs of the object's sharp positions."""

    def __init__(self, start: Estimate, views: TwoViews) -> None:
        super().__init__(start, views)
        self.max_rounds = self.rules.joint.max_rounds
        self.times_s = views.sample_times(np.array([start.t_d_s]))[0]

    def pairs(self, seen: TwoViews, parameters: Parameters) -> WeighedPairs:
        pairs, self.size_px = sharp_pairs(seen, self.times_s, parameters.t_d_s)
        return pairs

    def unseen(self, n_pairs: int, parameters: Parameters) -> Estimate:
        # Views that are cut in pieces share next to nothing at some offsets.
        return self.no_convergence(
            f"{self.moved(parameters)}, where only {n_pairs} sample times are valid in both views,"
            f" and {self.rules.search.min_pairs} are needed"
        )

    def settles(self, last: Round) -> bool:
        rules, stray_s = self.rules.joint, self.model.moved_s(last.before, last.found.parameters)
        return last.shift_s < rules.last_shift_s and stray_s < rules.last_stray_s

    def refused(self, last: Round) -> Estimate | None:
        rules, parameters = self.rules.verdict, last.found.parameters
        if last.number == self.rules.joint.last_hope:
            residuals = linearise(last.problem, parameters)
            if is_spread(residuals.distances_px, self.size_px, rules):
                found_by = checked_clock(self.start, self.model, residuals)
                if found_by.status == Status.CLOCK_JUMP or np.isinf(found_by.against_skew):
                    return found_by
                reason = doubt(residuals.distances_px, self.size_px, rules)
                return replace(self.start, status=Status.POOR_FIT, reason=reason, R=None, t=None)
        self.allowance.learn(last.problem, parameters)
        return None

    def hidden_px(self, last: Round, residuals: Residuals) -> Array:
        parameters, rules = residuals.parameters, self.rules.joint
        offset = rules.bias_offset
        if self.views.pose_is_known:
            seen = self.model.views(self.views, parameters)
            offset = max(offset, rules.known_bias_offset * seen.lasting_share(parameters.t_d_s))
        # Distances are weighted by the inverse of the image's size, to which the bias is
        # proportional: so the weights cancel.
        return smooth_errors(residuals, self.size_px, offset, rules.bias_slope)


def sharp_pairs(views: TwoViews, times_s: Array, t_d_s: float) -> tuple[WeighedPairs, float]:
    """Pair sharp positions at times (n,) [s] of camera 1's clock, where both views have them.

    Pairs are weighed by the inverse of the images' size, whose median [px] is the second result.
    """
    one, two = views.sharp_at(times_s, t_d_s)
    sizes_px = np.hypot(one.sizes_px, two.sizes_px) + 1e-12
    size_px = float(np.median(sizes_px)) if len(sizes_px) else 0.0
    moving = one.times_s, one.positions_px, two.positions_px, two.velocities_px_s
    return WeighedPairs(*moving, size_px / sizes_px, t_d_s), size_px
