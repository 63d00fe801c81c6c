"""Statuses are words with a sentence each, and deviations have one definition."""

import json
import pickle
from itertools import combinations

import numpy as np
import pytest

from ssac.estimate import POSE_IS_OPEN, SETTLED_BY, Estimate, Refusal, Status, first

BY_STAGE = (
    ("one object", "several_objects"),
    ("signals", "no_common_signal"),
    ("views", "no_motion", "no_common_time", "too_few_samples"),
    ("search", "search_bound", "too_little_motion"),
    ("refine", "no_convergence", "clock_jump"),
    ("verdict", "no_match", "poor_fit", "ambiguous_offset", "degenerate_pose", "ambiguous_pose"),
)  # fmt: skip
"""The stage that is the last to give a status, or the only one."""


def test_a_status_is_its_word_with_a_sentence_in_the_order_of_the_stages():
    assert Status.OK == "ok"
    assert f"{Status.NO_MATCH}" == str(Status.NO_MATCH) == "no_match"
    assert json.dumps([Status.NO_MATCH]) == '["no_match"]'
    assert {"no_match": 1}[Status.NO_MATCH] == 1
    assert pickle.loads(pickle.dumps(Status.NO_MATCH)) is Status.NO_MATCH
    assert len({status.meaning for status in Status}) == len(Status)
    for status in Status:
        assert status.value == status.name.lower()
        assert len(status.meaning.split()) > 4
    assert ["ok", *(status for _, *given in BY_STAGE for status in given)] == list(Status)
    assert all(Status.OK not in settled for settled in SETTLED_BY.values())


def test_the_first_of_several_refusals_is_that_of_the_earliest_stage():
    for earlier, later in combinations(Status, 2):
        one, other = Refusal(earlier, "one"), Refusal(later, "other")
        assert first(one, other) is first(other, None, one) is one
    one, other = Refusal(Status.NO_MATCH, "one"), Refusal(Status.NO_MATCH, "other")
    assert first(one, other) is one
    assert first() is first(None, None) is None


def test_a_word_of_ours_becomes_its_status_and_another_stays():
    assert Estimate("mine", "no_match").status is Status.NO_MATCH
    assert Estimate("mine").status is Status.OK
    own = Estimate("mine", "too_dark", "the sun had set", t_d_s=0.1)
    assert (own.status, own.has_offset) == ("too_dark", False)
    for status in Status:  # an offset holds where no more than the pose is open
        holds = status == Status.OK or status in POSE_IS_OPEN
        assert Estimate("mine", status, t_d_s=0.1).has_offset == holds
        assert not Estimate("mine", status).has_offset


def test_deviations_of_the_pose_are_roots_of_summed_variances():
    covariance = np.diag(np.deg2rad([9.0, 1.0, 2.0, 2.0, 3.0, 4.0]) ** 2)
    estimate = Estimate("mine", covariance=covariance)
    assert (estimate.r_std_deg, estimate.t_std_deg) == pytest.approx((3.0, 5.0))
    assert np.isnan([Estimate("mine").r_std_deg, Estimate("mine").t_std_deg]).all()


def test_a_delay_moves_all_offsets_of_an_estimate():
    start = Estimate("search", t_d_s=0.1, candidates_s=np.array([0.0, 0.1]))
    others_s = np.array([0.4])
    estimate = Estimate("mine", t_d_s=0.11, t_d_std_s=0.02, alternatives_s=others_s, start=start)
    delayed = estimate.delayed(0.5)
    assert (delayed.t_d_s, delayed.start.t_d_s) == pytest.approx((0.61, 0.6))
    assert delayed.t_d_std_s == 0.02
    assert delayed.alternatives_s == pytest.approx([0.9])
    assert delayed.start.candidates_s == pytest.approx([0.5, 0.6])
    assert np.isnan(Estimate("mine").delayed(0.5).t_d_s)
