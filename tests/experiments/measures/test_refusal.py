"""The judgement of estimates: what counts as a confident wrong answer; and the flights."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.lab import cache
from experiments.lab.cache import Cache
from experiments.lab.recorded import Pair
from experiments.measures.refusal import FlownKinds, RefusalCell, judged, refusal_row
from experiments.measures.refusal_flights import (
    KINDS_OF_FLIGHT,
    PATHS,
    T_D_S,
    RefusalCase,
    flight_config,
    flight_of,
)
from ssac.config import Config
from ssac.estimate import Estimate
from ssac.track.observation import Observation
from tests.ssac.synthetic import make_events, make_scene

METHOD_NAMES = ("ssac", "joint", "tangency", "ssac-known", "joint-known", "tangency-known")
SCENE = make_scene(0, duration_s=2.0)
T = SCENE.t / np.linalg.norm(SCENE.t)


def case_of(t_d_s: float = 0.05) -> RefusalCase:
    cam1, cam2 = (Observation(events) for events in make_events(SCENE, 0, 0.05))
    return RefusalCase(cam1, cam2, SCENE.rig, Config(denoise=False), t_d_s, SCENE.R, T)


def joint_estimate(error_s: float, status: str = "ok") -> Estimate:
    return Estimate(
        "joint",
        status,
        t_d_s=0.05 + error_s,
        t_d_std_s=1e-3,
        R=SCENE.R,
        t=T,
        covariance=np.diag([1e-6] + 5 * [1e-4]),
    )


@pytest.mark.parametrize(("error_s", "is_wrong"), [(4.9e-3, False), (5.1e-3, True)])
def test_five_deviations_off_is_a_confident_wrong_answer(error_s, is_wrong):
    row = judged(joint_estimate(error_s), case_of())
    assert row.confident_wrong == is_wrong
    assert row.error_sigmas == pytest.approx(1e3 * error_s)


def test_a_wrong_pose_counts_as_well():
    turned = replace(joint_estimate(0.0), R=SCENE.R @ make_scene(0, 40.0).R)
    assert judged(turned, case_of()).confident_wrong


def test_a_refused_answer_is_not_confident():
    row = judged(joint_estimate(1.0, "ambiguous_offset"), case_of())
    assert not row.confident_wrong
    assert not row.offset_given
    assert not row.pose_given


def test_an_offset_given_without_a_pose_must_hold_too():
    assert judged(joint_estimate(1.0, "degenerate_pose"), case_of()).confident_wrong


def test_any_answer_for_different_objects_is_wrong():
    assert judged(joint_estimate(0.0), case_of(np.nan)).confident_wrong
    assert judged(Estimate("ssac", t_d_s=0.05), case_of(np.nan)).confident_wrong


def test_the_true_offset_may_be_among_the_alternatives():
    estimate = replace(joint_estimate(0.8, "ambiguous_offset"), alternatives_s=np.array([0.05]))
    row = judged(estimate, case_of())
    assert row.truth_among_offsets
    assert row.alternatives == 1


def test_methods_without_deviations_have_limits():
    assert not judged(Estimate("ssac", t_d_s=0.0549), case_of()).confident_wrong
    assert judged(Estimate("ssac", t_d_s=0.0551), case_of()).confident_wrong


@pytest.mark.parametrize("kind", ["ordinary", "few-samples", "short"])
def test_every_method_is_judged_on_every_kind_of_a_flight(kind):
    cam1, cam2 = (Observation(events) for events in make_events(SCENE, 0, T_D_S))
    flown = FlownKinds(Pair(cam1, cam2, SCENE.rig), None)
    sim = flight_config("ordinary", 90.0)
    for method in METHOD_NAMES:
        row = refusal_row(RefusalCell(sim, 1, 2, kind, "ordinary", 3, method), flown)
        assert row.status
    assert list(flown.made) == [kind]  # made once, for all methods


@pytest.mark.parametrize("method", METHOD_NAMES)
def test_recordings_a_minute_apart_have_no_common_time_in_the_interval(method):
    cam1, cam2 = (Observation(events) for events in make_events(SCENE, 0, T_D_S))
    flown = FlownKinds(Pair(cam1, cam2, SCENE.rig), None)
    cell = RefusalCell(flight_config("ordinary", 90.0), 1, 2, "no-overlap", "ordinary", 3, method)
    assert refusal_row(cell, flown).status == "no_common_time"


@pytest.mark.render
def test_a_flight_on_a_path_of_its_own_is_simulated_once(tmp_path, monkeypatch):
    simulated, record = [], cache.record

    def counted(config, seed, *rest):
        simulated.append(config.trajectory_file)
        coarse = replace(config.sampling, max_step_px=2.0)
        return record(replace(config, sampling=coarse), seed, *rest)

    monkeypatch.setattr(cache, "record", counted)
    config = flight_config("circle", 90.0)
    first = flight_of("circle", config, 5, Cache(tmp_path))
    again = flight_of("circle", config, 5, Cache(tmp_path))
    assert len(simulated) == 1
    assert simulated[0] is not None
    assert not simulated[0].exists()
    assert np.array_equal(first.cam2.events, again.cam2.events)
    assert (
        flight_of("circle", config, 6, Cache(tmp_path)).cam1.events.size != first.cam1.events.size
    )
    assert len(simulated) == 2


def test_every_kind_has_a_flight():
    kinds = [kind for made in KINDS_OF_FLIGHT.values() for kind in made]
    assert len(kinds) == len(set(kinds)) == 17
    for name, path in PATHS.items():
        positions = path(np.random.default_rng(1))(np.linspace(0.0, 8.0, 50))
        assert positions.shape == (50, 3), name
