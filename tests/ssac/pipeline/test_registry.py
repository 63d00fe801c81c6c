"""Laws of all our methods, how they are listed and chosen, and which stages they share."""

from collections import Counter
from dataclasses import replace
from functools import partial
from importlib import import_module

import numpy as np
import pytest

import ssac
from ssac import Chain, Config, Observation, SsacError, Status
from ssac.cli.command_line import COMMANDS, command_line, run
from ssac.cli.sync import complete_method
from ssac.methods.method import all_summaries, our_methods
from ssac.pipeline.registry import DEFAULT, METHODS, OURS, Input, choose_method
from ssac.rules import Rules
from ssac.track.clean import clean
from tests.answers import assert_same
from tests.ssac.cluttered import noisy_flight
from tests.ssac.synthetic import CAMERA, angle_deg, make_scene, rotation_angle_deg

T_D_S = 0.05
NAMES = [method.name for method in OURS]
STAGES = (
    "ssac.pipeline.chain.clean",
    "ssac.pipeline.chain.one_object",
    "ssac.track.motion._summed_up",
    "ssac.search.view.view_of",
    "ssac.methods.algorithms.algorithm_1",
    "ssac.methods.algorithms.algorithm_2",
    "ssac.methods.joint.joint_from",
    "ssac.methods.tangency.tangency_from",
)
SCENE = make_scene(seed=1, duration_s=6.0)
RIG = SCENE.rig


@pytest.fixture(scope="module")
def raw():
    """Two cameras with noise events, before a flight whose light flickers."""
    return noisy_flight(SCENE, T_D_S)


@pytest.fixture(scope="module")
def chain(raw):
    return Chain(raw, RIG)


def test_what_a_method_lacks_is_said(raw):
    unposed, blind = Chain(raw, SCENE.unknown_rig), Chain([raw[0], Observation(raw[1].events)], RIG)
    posed = [one.name for one in OURS if one.needs_extrinsics]
    lacks = [(name, unposed, f"the rig: {name} needs the extrinsics") for name in posed]
    frames = "camera 2: zncc_f compares intensity frames, and there are none"
    for name, chain, said in (*lacks, ("zncc_f", blind, frames)):
        assert said in chain.lacks(METHODS[name])
        with pytest.raises(SsacError, match=said):
            chain.estimate(name)


def test_a_name_and_known_extrinsics_choose_a_method():
    assert choose_method().name == DEFAULT
    assert choose_method(known_extrinsics=True).name == "tangency-known"
    assert choose_method("ssac", known_extrinsics=True).name == "ssac-known"
    assert choose_method("ssac-known").name == "ssac-known"
    for method in OURS:
        assert not method.known_variant or METHODS[method.known_variant].needs_extrinsics
    with pytest.raises(SsacError, match="zncc_e makes no use of known extrinsics"):
        choose_method("zncc_e", known_extrinsics=True)
    with pytest.raises(SsacError, match=r"unknown method 'scac': use one of .*ssac-known"):
        choose_method("scac")


@pytest.mark.parametrize("name", NAMES)
def test_a_delay_of_camera_2_moves_the_offset_and_nothing_else(name, raw, chain):
    delay_s = -0.295  # by no whole number of frames
    searched, delayed = (Config(interval_s=(-0.4 + by_s, 0.5 + by_s)) for by_s in (0.0, delay_s))
    estimate = Chain([raw[0], raw[1].delayed(delay_s)], RIG, delayed).estimate(name)
    # The delayed chain may reuse cached results, and must give the same to the last bit.
    assert_same(chain.under(delayed).delayed(delay_s).estimate(name), estimate)
    if not METHODS[name].follows_clock:
        return
    expected = chain.under(searched).estimate(name).delayed(delay_s)
    assert (estimate.status, estimate.n_samples) == ("ok", expected.n_samples)
    for field in ("t_d_s", "t_d_std_s", "R", "t", "covariance", "candidates_s", "costs"):
        found, wanted = getattr(estimate, field), getattr(expected, field)
        assert (found is None) == (wanted is None)
        if wanted is not None:
            # The tolerance is the rounding of times, by which no event may enter or leave a window.
            np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_every_method_answers_alike_wherever_the_interval_lies(name, chain):
    centred, moved = (
        chain.under(Config((T_D_S - 1.0 + by_s, T_D_S + 1.0 + by_s))).estimate(name)
        for by_s in (0.0, 0.3137)  # by no whole step of any search
    )
    assert (centred.status, moved.status) == (Status.OK, Status.OK)
    assert (moved.R is None) == METHODS[name].finds_offset_alone
    # The candidates differ, and event counts jump at each: the search resolves 10 us. Samples start
    # at its result, so their windows hold other events; where a free skew makes t_d uncertain
    # (0.6 ms with a known pose here), that moves t_d by a part of its deviation.
    part_s = 0.1 * centred.t_d_std_s if np.isfinite(centred.t_d_std_s) else 0.0
    assert moved.t_d_s == pytest.approx(centred.t_d_s, abs=max(0.03e-3, part_s))
    if centred.R is not None:
        assert rotation_angle_deg(moved.R, centred.R) < 0.02
        assert angle_deg(moved.t, centred.t) < 0.02
    # Both intervals hold the global maximum of the correlation, so the correlation methods agree
    # too; a greater maximum in only one of them would make different answers right.
    assert moved.t_d_s == pytest.approx(T_D_S, abs=0.011)  # half a frame, at most


# --- Lists of methods, for which no method is imported ---


def test_ours_are_declared_in_their_files_which_is_all_that_a_method_takes(tmp_path, monkeypatch):
    """The order is the paper's method, its refinements, and the methods compared with it."""
    names = ["ssac", "ssac-known", "joint", "joint-known", "tangency", "tangency-known"]
    assert [method.name for method in OURS] == [*names, "albl", "zncc_e", "zncc_f", "event_rate"]
    assert list(all_summaries())[: len(OURS)] == [method.name for method in OURS]
    (tmp_path / "mine.py").write_text(
        '@method("mine-too", "the \'second\'", input=Input.RATES)\n'
        '@method(\n    "mine",\n    "the first",\n    place=3,\n)\n'
        "@cached\ndef found(views: TwoViews) -> Estimate:\n    1 / 0\n"
    )
    monkeypatch.setattr("ssac.methods.method.__file__", str(tmp_path / "method.py"))
    one, other = our_methods.__wrapped__()
    assert (one.name, one.summary, one.runs) == ("mine", "the first", "ssac.methods.mine:found")
    assert (other.name, other.summary, other.input) == ("mine-too", "the 'second'", Input.RATES)


def test_help_lists_every_method_with_its_summary_and_a_shell_completes_its_name(capsys):
    assert run(command_line(COMMANDS, ""), ["sync", "--help"], "ssac") == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name, summary in all_summaries().items():
        assert f"{name} {summary}" in shown
    assert [name for name, _ in complete_method("zncc")] == ["zncc_e", "zncc_f"]


# --- Stages that methods, offsets and parameters share run once ---


@pytest.fixture
def calls(monkeypatch):
    counts = Counter()

    def counted(name, work, *args, **options):
        counts[name] += 1
        return work(*args, **options)

    for place in STAGES:
        module, _, name = place.rpartition(".")
        monkeypatch.setattr(place, partial(counted, name, getattr(import_module(module), name)))
    return counts


def test_each_stage_runs_once_for_all_ten_methods(raw, calls, monkeypatch):
    asked = {id(seen): [] for seen in raw}
    monkeypatch.setattr(
        Observation, "read", lambda seen, frames="": asked[id(seen)].append(frames) or seen
    )
    chain = Chain(raw, RIG)
    for name in NAMES * 2:
        assert chain.estimate(name).method == name
    once = ("one_object", "algorithm_1", "algorithm_2")
    # For each camera, and for a free pose and a known one.
    twice = ("clean", "_summed_up", "view_of", "joint_from", "tangency_from")
    assert calls == dict.fromkeys(once, 1) | dict.fromkeys(twice, 2)
    # One more read is for silhouettes: camera 1's do not close, so camera 2's are not needed.
    assert [sorted(frames) for frames in asked.values()] == [["", "", "means"], ["", "means"]]


@pytest.mark.parametrize("name", NAMES)
def test_a_method_changes_no_input_and_gives_the_same_for_what_is_clean(name, raw, chain):
    before = [seen.events.copy() for seen in raw]
    assert chain.lacks(METHODS[name]) == ""
    expected = chain.estimate(name)
    assert (expected.status, expected.method) == ("ok", name)
    cleaned = [clean(seen, CAMERA, Config().cleaning) for seen in raw]
    assert_same(getattr(ssac, name.replace("-", "_"))(*cleaned, RIG), expected)
    for seen, kept in zip(raw, before, strict=True):
        np.testing.assert_array_equal(seen.events, kept)


def ruled(group, **fields):
    return Config(rules=replace(Rules(), **{group: replace(getattr(Rules(), group), **fields)}))


FROM_VIEWS = {"view_of": 2, "algorithm_2": 1, "joint_from": 1}
FROM_EVENTS = {"clean": 2, "one_object": 1, "_summed_up": 2, **FROM_VIEWS}
SHARED = (
    (Config(), 0.0, {}),
    (Config(), 0.1, {"one_object": 1, **FROM_VIEWS}),
    (Config(skew_prior_ppm=20.0), 0.0, {"joint_from": 1}),
    (Config(seed=5), 0.0, {"algorithm_2": 1, "joint_from": 1}),
    (Config(robust="magsac"), 0.0, {"algorithm_2": 1, "joint_from": 1}),
    (Config(half_window_s=0.015), 0.0, FROM_VIEWS),
    (Config(n_min=20), 0.0, FROM_VIEWS),
    (Config(max_border_fraction=0.5), 0.0, FROM_VIEWS),
    (Config(border_px=9), 0.0, {"_summed_up": 2, **FROM_VIEWS}),
    (Config(interval_s=(-0.5, 0.5)), 0.0, {"one_object": 1, **FROM_VIEWS}),
    (Config(n_neighbours=2), 0.0, FROM_EVENTS),
    (ruled("noise", ball_px=4.0), 0.0, FROM_EVENTS),
    # Views are kept under the first rules alone; under others, two stages sum up both of them.
    (ruled("view", max_width=0.31), 0.0, {"one_object": 1, **FROM_VIEWS, "view_of": 4}),
    (ruled("joint", bias_slope=0.4), 0.0, {"one_object": 1, "algorithm_2": 1, "joint_from": 1}),
)


@pytest.mark.parametrize(("config", "delay_s", "expected"), SHARED, ids=range(len(SHARED)))
def test_other_parameters_and_a_delay_share_all_that_they_leave_alone(
    config, delay_s, expected, raw, chain, calls
):
    chain.estimate("joint")
    calls.clear()
    found = chain.under(config).delayed(delay_s).estimate("joint")
    assert +calls == Counter(expected)
    assert chain.under(config).delayed(delay_s).estimate("joint") is found  # the last is kept
    assert_same(found, Chain((raw[0], raw[1].delayed(delay_s)), RIG, config).estimate("joint"))
