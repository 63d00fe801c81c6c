"""What `ssac sync` tells of an estimate, as text and as JSON."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import sync
from ssac.estimate import ClockJump, Estimate
from ssac.pipeline.answer import Answer
from ssac.pipeline.registry import METHODS
from ssac.pipeline.report import report_json, report_text
from ssac.track.clean import ObjectsUsed
from ssac.track.denoise import Clutter
from tests.ssac.command import unfolded


@pytest.fixture(scope="module")
def answer(recorded) -> Answer:
    return sync(*recorded.pair, recorded / "rig.yaml", "ssac").answer


def told(answer: Answer, **changes):
    """Give the text and the JSON for another estimate than the answer's."""
    other = replace(answer, estimate=replace(answer.estimate, **changes))
    return report_text(other), report_json(other)


def used(answer: Answer, *objects: ObjectsUsed) -> Answer:
    """Say of both cameras what became of the things that they saw."""
    pairs = zip(answer.cleans, objects, strict=True)
    return replace(answer, cleans=tuple(replace(seen, used=said) for seen, said in pairs))


NO_POSE = {"reason": "so it is", "R": None, "t": None}


def test_an_offset_is_explained_where_it_holds_alone(answer):
    others_s, direction = np.array([-0.75, 0.85]), np.eye(6)[[5]]
    text, report = told(answer, status="ambiguous_offset", alternatives_s=others_s, **NO_POSE)
    assert text.startswith("no estimate    ambiguous_offset: so it is\nnot reliable   t_d = ")
    assert "or             t_d = -750, 850 ms" in text
    assert "camera 2's clock" not in text
    assert report["alternatives_s"] == [-0.75, 0.85]
    assert report["t_d_is_reliable"] is False
    text, report = told(answer, status="degenerate_pose", unobservable=direction, **NO_POSE)
    assert text.startswith("no pose        degenerate_pose: so it is\ntime offset    t_d = ")
    assert "camera 2's clock shows" in text
    assert "rotation" not in text
    assert report["t_d_is_reliable"] is True
    assert report["unobservable"] == direction.tolist()


def test_clocks_are_told(answer):
    plain = report_json(answer)
    names = ("t_ref_s", "skew_ppm", "skew_std_ppm", "clock_covariance", "clock_jump")
    assert [plain[name] for name in names] == [None] * 5  # the paper's takes them to run alike
    assert plain["clock_knots"] == []
    clock = {"t_ref_s": 5.0, "skew_ppm": -400.0, "skew_std_ppm": 2.5}
    strays_s = np.array([0.001, -0.002, 0.001])
    knots = {"knots_s": np.array([0.0, 5.0, 10.0]), "strays_std_s": np.full(3, 1e-4)}
    text, report = told(answer, strays_s=strays_s, **clock, **knots)
    assert "clock skew     -400.0 ppm, 1 sigma 2.5 ppm\n" in text
    assert "camera 2's clock runs slow; t_d holds at 5.000 s of camera 1's\n" in text
    assert "and strays by up to 2.000 ms, 3 knots\n" in text
    assert "far beyond the 50 ppm expected of such clocks: see --skew-prior\n" in text
    assert {name: report[name] for name in clock} == clock
    assert report["clock_knots"][1] == {"t_s": 5.0, "stray_s": -0.002, "std_s": 1e-4}
    jump = ClockJump(3.0, 0.02, 0.001, 0.05, 0.07)
    jumping = replace(answer, estimate=Estimate("joint", "clock_jump", "so it is", jump=jump))
    assert report_text(jumping).startswith("no estimate    clock_jump: so")
    report = report_json(jumping)
    assert report["clock_jump"] == vars(jump)
    assert (report["t_d_s"], report["t_d_is_reliable"]) == (None, False)


def test_a_clock_runs_fast_or_slow_beyond_one_deviation_only(answer):
    clock = {"t_ref_s": 5.0, "skew_std_ppm": 20.0}
    for skew_ppm, words in (
        (-20.0, "the clocks run alike, as far as this tells"),
        (-20.1, "camera 2's clock runs slow"),
        (20.1, "camera 2's clock runs fast"),
    ):
        text, _ = told(answer, skew_ppm=skew_ppm, **clock)
        assert f"\n               {words}; t_d holds at 5.000 s of camera 1's\n" in text


def test_a_length_that_was_stated_is_told_with_its_unit(answer):
    direction = answer.estimate.t
    assert "of unknown length" in report_text(answer)
    near = replace(answer, distance_m=0.5)
    vector = ", ".join(f"{value:.4f}" for value in 0.5 * direction)
    assert f"t = ({vector}) m, 0.5 m long as stated" in report_text(near)
    assert "camera 2 lies at (" in report_text(near)
    report = report_json(near)
    assert (report["distance_m"], report["t"]) == (0.5, direction.tolist())


def test_every_line_fits_a_screen(answer):
    reason = "other offsets fit about as well: " * 9
    text, _ = told(answer, status="ambiguous_offset", reason=reason, R=None, t=None)
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    assert [line[:15].strip() for line in lines[:3]] == ["no estimate", "", ""]
    assert " ".join(line[15:] for line in lines).count("other offsets fit about as well:") == 9


def test_clutter_is_told(answer):
    assert "clutter" not in report_text(answer)
    plain = report_json(answer)["clutter"]
    assert [camera["masked_pixels"] for camera in plain] == [0, 0]
    assert [(camera["n_neighbours"], camera["n_min"]) for camera in plain] == [(20, 200)] * 2
    one, other = answer.cleans
    lamp = replace(one, clutter=Clutter(36, 7200, 0.2, 5.0, 20, 200))
    noisy = replace(other, clutter=Clutter(0, 0, 9.8, 3.0, 12, 150))
    text = unfolded(report_text(replace(answer, cleans=(lamp, noisy))))
    assert "clutter        camera 1: 36 px that fire by themselves masked (7200 events)\n" in text
    assert (
        "clutter        camera 2: with a background of 9.8 Hz/px an event needs 12 others within"
        " 3 px, ms, and a position 150 events\n"
    ) in text
    held = np.arange(len(one.events)) % 10 == 0
    text = unfolded(report_text(replace(answer, cleans=(replace(one, on_line=held), other))))
    assert (
        "clutter        camera 1: a line that holds the object is seen, and no part of its outline"
        f" ({held.sum()} events)\n"
    ) in text
    config = replace(answer.config, n_min=30)
    found = report_json(replace(answer, cleans=(one, noisy), config=config))["clutter"][1]
    assert found == {
        "masked_pixels": 0, "masked_events": 0, "background_hz": 9.8, "radius_px": 3.0,
        "n_neighbours": 12, "n_min": 30,
    }  # fmt: skip


def test_a_start_that_is_the_answer_is_called_so(recorded):
    answer = sync(*recorded.pair, recorded / "rig.yaml").answer
    assert "tangents to the outline" in report_text(answer)
    text = report_text(replace(answer, is_start=True))
    assert "note           the object is too small for an outline" in text
    assert "pairs of positions used, of 400 sample times" in text


def test_several_things_are_told(answer):
    assert report_json(answer)["objects"] == [{"seen": 1, "share": 1.0}] * 2
    assert "objects" not in report_text(answer)
    crowded = used(answer, ObjectsUsed(3, 0.25), ObjectsUsed(1, 1.0))
    row = "objects        camera 1 sees 3, 25 % of its events used; camera 2 sees 1, 100 % of"
    assert row in report_text(crowded)
    assert report_json(crowded)["objects"][0] == {"seen": 3, "share": 0.25}
    refused = used(answer, ObjectsUsed(3, 0.0), ObjectsUsed(2, 0.0))
    assert "objects        camera 1 sees 3; camera 2 sees 2\n" in report_text(refused)
    # A method that looks at no object says nothing of them.
    assert report_json(replace(answer, method=METHODS["albl"]))["objects"] is None
