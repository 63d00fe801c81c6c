"""Skews that are far: how they are searched for, and what they make of a step of the clock."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.clock import Clock
from ssac.estimate import Estimate
from ssac.methods import clocks
from ssac.methods.joint import refine
from tests.ssac.methods.test_clocks import START, views_of


@pytest.mark.parametrize(("known", "name"), [(False, "algorithm_2"), (True, "algorithm_1")])
@pytest.mark.parametrize("t_d_s", [3.0, -2.0])
def test_an_offset_that_was_found_with_a_skew_is_of_the_same_clock_at_the_middle(
    known, name, t_d_s, monkeypatch
):
    """The common time, and with it the middle, is known only when the offset is."""
    searched = []

    def search(views):
        searched.append(views.clock)
        return replace(START, t_d_s=t_d_s, d_avg_px=abs(views.clock.skew_ppm - 2900.0))

    monkeypatch.setattr(clocks, name, search)
    views = views_of(Clock(0.05), known=known, skew_prior_ppm=1000.0)
    found = clocks.with_coarse_skew(Estimate("ssac", "no_match"), views)
    of_search = next(one for one in searched if one.skew_ppm == found.skew_ppm)
    assert abs(found.t_ref_s - of_search.t_ref_s) > 0.5
    as_found = replace(of_search, t_d_s=of_search.t_d_s + t_d_s)
    times_s = np.array([0.0, 20.0, 40.0])
    shown_s = found.clock.cam2_from_cam1(times_s)
    np.testing.assert_allclose(shown_s, as_found.cam2_from_cam1(times_s), atol=1e-9)  # rounding


@pytest.mark.parametrize(("prior_ppm", "status"), [(50.0, "clock_jump"), (1000.0, "ok")])
def test_a_step_of_less_than_six_deviations_is_a_jump_only_where_it_bends_the_skew_far(
    prior_ppm, status, monkeypatch
):
    """It bends the skew by some 500 ppm: by ten deviations of 50 ppm, half a one of 1000 ppm."""
    views = views_of(Clock(0.05), jump=(15.0, 0.010), skew_prior_ppm=prior_ppm)
    jump = refine(START, views).jump
    covariance_of, wider = clocks.covariance_of, jump.size_s / jump.size_std_s / 5.2
    monkeypatch.setattr(clocks, "covariance_of", lambda *about: wider**2 * covariance_of(*about))
    assert refine(START, views).status == status
