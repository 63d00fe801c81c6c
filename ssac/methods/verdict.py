"""A search, or an estimate and what speaks against it, in; an Estimate that says so, out."""

from dataclasses import replace

import numpy as np

from ssac.config import Config
from ssac.estimate import Estimate
from ssac.geometry.fundamental import MIN_PAIRS
from ssac.search.observability import Refusal, Valley
from ssac.search.offset_search import OffsetSearch


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
