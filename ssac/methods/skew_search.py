"""What a search with clocks alike found in; the same or a better one, with a coarse skew, out.

Where clocks may differ by far, over a long recording, no one offset fits both of its ends. So the
search is repeated with skews so near to each other that the ends differ by little.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ssac.clock import PPM, Clock
from ssac.estimate import SETTLED_BY, Estimate, Status
from ssac.methods.algorithms import algorithm_1, algorithm_2
from ssac.search.two_views import TwoViews

Array = NDArray[np.float64]

MAX_END_S = 0.020
"""What a skew may be off by at both ends: from twice as far the refinements still converge."""

_SIGMAS = 3.0  # of the prior, either way
_MAX_SKEWS = 61
_FITS = (Status.OK, *SETTLED_BY["joint"])


def with_coarse_skew(start: Estimate, views: TwoViews) -> Estimate:
    """Search anew with other skews, where the prior allows for ones that matter.

    Parameters
    ----------
    start
        Of Algorithm 1 or 2 with clocks alike.
    views
        Both views, as they were searched.

    Returns
    -------
    Estimate
        The one that fits best; `start` itself where no skew matters, or none fits.
    """
    skews_ppm = _skews_ppm(start, views) if views.config.search_skews else np.zeros(1)
    if len(skews_ppm) < 2:
        return start
    search = algorithm_1 if views.pose_is_known else algorithm_2
    t_ref_s = _middle_s(start, views)
    found = [start]
    for skew_ppm in skews_ppm[skews_ppm != 0.0].tolist():
        one = search(views.under(Clock(0.0, skew_ppm, t_ref_s)))
        middle_s = _middle_s(one, views)
        t_d_s = one.t_d_s + PPM * skew_ppm * (middle_s - t_ref_s)
        found.append(replace(one, t_d_s=t_d_s, skew_ppm=skew_ppm, t_ref_s=middle_s))
    fits = [one for one in found if one.status in _FITS and np.isfinite(one.d_avg_px)]
    return min(fits, key=lambda one: one.d_avg_px, default=start)


def _skews_ppm(start: Estimate, views: TwoViews) -> Array:
    """Give the skews to be tried, zero among them."""
    (first_s,), (last_s,) = views.overlap_s(np.array([_offset_s(start, views)]))
    half_s = 0.5 * float(last_s - first_s)
    most_s = _SIGMAS * PPM * views.config.prior_ppm * half_s
    if not most_s > 2.0 * MAX_END_S:
        return np.zeros(1)
    n = int(min(np.ceil(most_s / (2.0 * MAX_END_S)), _MAX_SKEWS // 2))
    return np.asarray(np.arange(-n, n + 1) * (2.0 * MAX_END_S / (PPM * half_s)), np.float64)


def _middle_s(estimate: Estimate, views: TwoViews) -> float:
    """Middle of the common time at an estimate's offset."""
    (first_s,), (last_s,) = views.overlap_s(np.array([_offset_s(estimate, views)]))
    return 0.5 * float(first_s + last_s)


def _offset_s(estimate: Estimate, views: TwoViews) -> float:
    known = np.isfinite(estimate.t_d_s)
    return float(estimate.t_d_s if known else np.mean(views.config.offsets_s))
