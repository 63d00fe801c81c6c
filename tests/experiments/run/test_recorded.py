"""A recording of the cache, denoised once and from then on by what is kept of that; no OpenGL."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from experiments.run import recorded as module
from experiments.run.cache import Cache
from experiments.run.recorded import Pair, denoised_pair, load_pair, packed, unpacked
from ssac.config import Config
from ssac.events import events_from_arrays
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
    raw = cam1, cam2, rig = load_pair(recorded.folder)
    clean = denoised(cam1, cam2, rig, CONFIG)
    assert 0 < len(clean[0].events) < len(cam1.events)
    if has_line:
        on_line = np.arange(len(clean[0].events)) % 3 == 0
        clean = replace(clean[0], on_line=on_line), clean[1]
    calls = []
    monkeypatch.setattr(module, "denoised", lambda *_: clean)
    for _ in range(2):
        *pair, n_events = denoised_pair(
            recorded.folder, lambda: calls.append(1) or raw, CONFIG, Cache(tmp_path)
        )
        for one, other in zip(pair, clean, strict=True):
            assert_same(one, other)
        assert n_events == (len(cam1.events), len(cam2.events))
    assert len(calls) == 1  # the second time nothing of the recording is read


def test_a_camera_of_which_nothing_is_left_comes_back_as_recorded(
    recorded: Recorded, tmp_path: Path
) -> None:
    cam1, cam2, rig = load_pair(recorded.folder)
    few = replace(cam2, events=cam2.events[:: len(cam2.events) // 9])  # none near another
    raw = Pair(cam1, few, rig)
    for _ in range(2):
        found = denoised_pair(recorded.folder, lambda: raw, CONFIG, Cache(tmp_path))
        assert found[0] is cam1
        assert found[1] is few


@pytest.mark.parametrize("n", [0, 1, 1000])
def test_packed_events_come_back_whatever_the_time_between_them(n: int) -> None:
    rng = np.random.default_rng(n)
    gaps_us = rng.choice([0, 1, 255, 256, 257, 511, 512, 10**9, 10**13], n)
    events = events_from_arrays(
        np.cumsum(gaps_us) - 10**6 if n else gaps_us,
        *rng.integers(0, 1 << 16, (2, n)),
        rng.integers(0, 2, n),
    )
    found, leaps = packed(events)
    assert found.nbytes == 6 * n
    np.testing.assert_array_equal(unpacked(found, leaps), events, strict=True)
