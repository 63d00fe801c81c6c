"""Rows that share estimates are the same as the rows of full runs."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from experiments.lab import scored
from experiments.lab.grid import Cell
from experiments.lab.recorded import Pair, load_pair
from experiments.lab.scored import load_recorded, scored_row
from sim.recording import SimConfig
from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import METHODS, OURS, Input, Method

OFFSETS_S = (0.05, 0.5)


@pytest.fixture(scope="module")
def pair(recorded):
    return Chain(recorded.pair, str(recorded / "rig_extrinsics.yaml"))


@pytest.fixture
def fresh(pair):
    """A chain on the same pair, as a study has it, without results of methods yet."""
    return Chain([replace(pair.clean(k), name="") for k in range(2)], pair.rig)


def cell_of(t_d_s):
    config = Config(interval_s=(t_d_s - 1.0, t_d_s + 1.0))
    return Cell(SimConfig(), 0, 0, t_d_s, config, "mine", {"sim.t_d_s": t_d_s})


def with_method(monkeypatch, estimate, **fields):
    method = Method("mine", estimate, Input.TRACKS, "A method of a test.", **fields)
    methods = {**METHODS, "mine": method}
    monkeypatch.setattr("ssac.pipeline.registry.METHODS", methods)
    monkeypatch.setattr(scored, "METHODS", methods)


@pytest.mark.parametrize(("follows", "runs"), [(True, 1), (False, 2)])
def test_offsets_share_a_run_of_a_method_that_follows_the_clock(follows, runs, fresh, monkeypatch):
    starts_s = []

    def mine(cam1, cam2, rig, config=None):
        starts_s.append(cam2.events["t"][0] * 1e-6)
        return Estimate("mine", t_d_s=float(starts_s[-1]))

    with_method(monkeypatch, mine, follows_clock=follows)
    offsets_ms = [scored_row(cell_of(t_d_s), fresh).t_d_estimate_ms for t_d_s in OFFSETS_S]
    assert len(starts_s) == runs
    assert np.diff(offsets_ms) == pytest.approx([450.0])


def test_a_skewed_clock_is_right_in_the_middle_of_a_files_flight(fresh, monkeypatch, tmp_path):
    table = np.zeros((31, 8))
    table[:, 0], table[:, 1], table[:, 7] = np.linspace(0, 6, 31), np.linspace(-1, 1, 31), 1.0
    np.savetxt(tmp_path / "flight.csv", table, delimiter=",")

    found = Estimate("mine", t_d_s=0.05, skew_ppm=1000.0, t_ref_s=3.0)
    with_method(monkeypatch, lambda *_: found)
    cell = cell_of(0.05)
    sim = replace(cell.sim, trajectory_file=tmp_path / "flight.csv", skew_ppm=1000.0)
    assert scored_row(replace(cell, sim=sim), fresh).t_d_error_ms == pytest.approx(0.0, abs=1e-9)


def test_a_refusal_is_made_anew_since_it_names_offsets(fresh, monkeypatch):
    def mine(cam1, cam2, rig, config=None):
        return Estimate("mine", "search_bound", f"from {config.interval_s[0]:.3f} s on")

    with_method(monkeypatch, mine, follows_clock=True)
    row = scored_row(cell_of(0.5), fresh)
    assert row.status == "search_bound"
    assert row.reason.startswith("from -0.500 s on")


def test_an_unusable_recording_is_so_at_all_offsets(fresh, monkeypatch):
    with_method(monkeypatch, Mock(side_effect=SsacError("too dark")), follows_clock=True)
    rows = [scored_row(cell_of(t_d_s), fresh) for t_d_s in OFFSETS_S]
    assert {(row.status, row.reason) for row in rows} == {("unusable", "too dark")}


@pytest.mark.parametrize("field", ["t_d_s", "R", "status"])
def test_a_method_that_does_not_follow_the_clock_is_stopped(field, fresh, monkeypatch):
    def mine(cam1, cam2, rig, config=None):
        shown_s = cam2.events["t"][0] * 1e-6
        estimate = Estimate("mine", t_d_s=shown_s, R=np.eye(3), t=np.array([1.0, 0.0, 0.0]))
        late = shown_s > 0.1 + fresh.clean(1).events["t"][0] * 1e-6
        wrong = {"t_d_s": shown_s + 2e-9, "R": np.eye(3) + 2e-9, "status": "no_match"}
        return replace(estimate, **{field: wrong[field]}) if late else estimate

    with_method(monkeypatch, mine, follows_clock=True)
    again = Chain([fresh.clean(k) for k in range(2)], fresh.rig)
    assert scored_row(cell_of(0.5), fresh).status == "ok"
    monkeypatch.setattr(scored, "GUARDED", 1)
    with pytest.raises(ArithmeticError, match=f"differs in {field}"):
        scored_row(cell_of(0.5), again)


def test_retries_of_a_row_may_denoise_by_other_rules(recorded):
    cache = Mock()
    cache.recording_folder.return_value = recorded.folder
    chain = load_recorded([replace(cell_of(0.0), method="ssac")], cache)
    events = load_pair(recorded.folder).cam1.events
    assert len(chain.clean(0).events) < len(events)
    np.testing.assert_array_equal(chain.clean(0).all_events(), events)
    np.testing.assert_array_equal(chain.under(Config(denoise=False)).clean(0).events, events)


def test_of_a_camera_of_which_nothing_is_left_every_method_says_so(recorded, monkeypatch):
    cam1, cam2, rig = load_pair(recorded.folder)
    few = replace(cam2, events=cam2.events[:: len(cam2.events) // 9])  # no event is near another
    monkeypatch.setattr(scored, "load_pair", lambda *_: Pair(cam1, few, rig))
    chain = load_recorded([replace(cell_of(0.0), method="ssac")], Mock())
    assert len(chain.clean(1).events) == 0 < len(few.events) == chain.clean(1).n_recorded
    for method in OURS:
        if method.input is not Input.FRAMES:
            found = chain.estimate(method)
            assert found.status in ("too_few_samples", "no_common_signal"), found
