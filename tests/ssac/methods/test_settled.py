"""Which refusals a later stage may overrule: those of one table, and no others."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ssac import Chain, Config, Estimate, Status, two_views
from ssac.estimate import SETTLED_BY
from ssac.methods.hypotheses import Choice
from ssac.methods.tangency import tangency_from
from ssac.rules import RetryRules, Rules
from ssac.track.observation import tracked
from tests.ssac.box import CLEAN, box_events, observations
from tests.ssac.synthetic import make_scene
from tests.ssac.tracks import frame_track

T_D_S = 0.05
REFUSALS = [status for status in Status if status != Status.OK]
SCENE = make_scene(0, duration_s=3.0)
OFFSETS_S = np.arange(-0.2, 0.3, 0.001)
SEARCH = Estimate(
    "ssac", t_d_s=T_D_S, candidates_s=OFFSETS_S, costs=1.0 + np.abs(OFFSETS_S - T_D_S)
)


@pytest.mark.parametrize("status", REFUSALS)
def test_positions_settle_what_the_table_names_of_a_search(status):
    views = SimpleNamespace(pose_is_known=True, rig=SCENE.rig, rules=Rules())
    tried = Choice(views, refine=None).hypotheses(replace(SEARCH, status=status))
    assert bool(tried) == (status in SETTLED_BY["joint"])
    assert all(one.status == Status.OK for one in tried)


@pytest.fixture(scope="module")
def views():
    return two_views(*observations(*box_events(SCENE, 0)), SCENE.unknown_rig, CLEAN)


@pytest.mark.parametrize("status", REFUSALS)
@pytest.mark.parametrize("searched", [Status.OK, Status.AMBIGUOUS_OFFSET, Status.NO_MATCH])
def test_tangents_settle_what_the_table_names_of_joint(status, searched, views, monkeypatch):
    found = Estimate("tangency", t_d_s=T_D_S, t_d_std_s=1e-4)
    looked = []

    def settled(choice, start):
        looked.append(choice.by_own_pairs)
        return found

    monkeypatch.setattr("ssac.methods.hypotheses.Choice.settled", settled)
    search = replace(SEARCH, status=searched, alternatives_s=np.array([0.1]))
    start = Estimate("joint", status, "a reason", start=search)
    estimate = tangency_from(start, views)
    assert estimate.method == "tangency"
    if status in SETTLED_BY["tangency"]:
        assert estimate.status == Status.OK
        # Where the search has an offset, it is of positions; else tangents are to find one.
        assert looked == [searched != Status.OK]
    else:
        assert (estimate.status, estimate.reason) == (status, "a reason")
        assert looked == []


def answered(config, status, helps, monkeypatch):
    """The answer of joint, which refuses an affine clock, and the clocks that were tried."""
    tried = []

    def joint_from(start, views):
        tried.append(views.config.clock)
        if views.config.clock == "pieces" and helps:
            return Estimate("joint", t_d_s=T_D_S, t_d_std_s=1e-3)
        return Estimate("joint", status, "a reason", start=start)

    monkeypatch.setattr("ssac.methods.joint.joint_from", joint_from)
    monkeypatch.setattr("ssac.methods.algorithms.algorithm_2", lambda views: SEARCH)
    tracks = [tracked(frame_track(SCENE, k + 1, 30.0, k * T_D_S, seed=k)) for k in range(2)]
    config = replace(config, interval_s=(-0.5, 0.5))
    return Chain(tracks, SCENE.unknown_rig, config).answer("joint"), tried


@pytest.mark.parametrize("status", REFUSALS)
@pytest.mark.parametrize("helps", [True, False])
def test_a_clock_of_pieces_settles_what_the_table_names_of_tracks(status, helps, monkeypatch):
    answer, tried = answered(Config(), status, helps, monkeypatch)
    is_settled = status in SETTLED_BY["pieces"]
    # The smoothest first, then rougher ones.
    n_tried = (1 if helps else 1 + len(RetryRules.roughnesses_ppm)) if is_settled else 0
    assert tried == ["affine", *n_tried * ["pieces"]]
    wanders = answer.clock == "pieces"
    assert wanders == (is_settled and helps)
    assert answer.estimate.status == (Status.OK if wanders else status)
    assert answer.config.clock == ("pieces" if wanders else "affine")
    assert ("a clock wanders" in answer.note) == wanders


@pytest.mark.parametrize(
    "config", [Config(clock="affine"), Config(skew_prior_ppm=0.0)], ids=["affine", "no-skew"]
)
def test_a_clock_that_was_asked_for_stays(config, monkeypatch):
    answer, tried = answered(config, Status.CLOCK_JUMP, True, monkeypatch)
    assert (answer.estimate.status, answer.clock, tried) == ("clock_jump", "", ["affine"])
