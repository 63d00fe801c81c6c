"""A recording of the cache, denoised once and from then on by what is kept of that; no OpenGL."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from experiments.run import recorded as module
from experiments.run.cache import Cache
from experiments.run.recorded import denoised_pair, load_pair
from ssac.config import Config
from ssac.track.clutter import chosen_events, which_of
from ssac.track.observation import Observation, denoised
from tests.recorded import Recorded

CONFIG = Config()


def assert_same(one: Observation, other: Observation) -> None:
    for field in fields(Observation):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b, strict=True)
        else:
            assert a == b, field.name


@pytest.mark.parametrize("has_line", [False, True])
def test_a_pair_comes_back_as_denoising_left_it(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_line: bool
) -> None:
    cam1, cam2, rig = load_pair(recorded.folder)
    clean = denoised(cam1, cam2, rig, CONFIG)
    assert 0 < len(clean[0].events) < len(cam1.events)
    if has_line:
        on_line = np.arange(len(clean[0].events)) % 3 == 0
        clean = replace(clean[0], on_line=on_line), clean[1]
    calls = []
    monkeypatch.setattr(module, "denoised", lambda *_: calls.append(1) or clean)
    for _ in range(2):
        pair = denoised_pair(recorded.folder, cam1, cam2, rig, CONFIG, Cache(tmp_path))
        for one, other in zip(pair, clean, strict=True):
            assert_same(one, other)
    assert len(calls) == 1


def test_a_camera_of_which_nothing_is_left_comes_back_as_recorded(
    recorded: Recorded, tmp_path: Path
) -> None:
    cam1, cam2, rig = load_pair(recorded.folder)
    few = replace(cam2, events=cam2.events[:: len(cam2.events) // 9])  # none near another
    for _ in range(2):
        pair = denoised_pair(recorded.folder, cam1, few, rig, CONFIG, Cache(tmp_path))
        assert pair[0] is cam1
        assert pair[1] is few


def test_events_that_are_alike_are_told_apart_by_their_number(recorded: Recorded) -> None:
    events = np.repeat(load_pair(recorded.folder).cam1.events[:1000], 3)
    chosen = np.random.default_rng(0).random(len(events)) < 0.6
    left = chosen_events(events, chosen)
    found = which_of(events, left)
    assert np.count_nonzero(found) == len(left) < len(events)
    np.testing.assert_array_equal(chosen_events(events, found), left)
