"""A recording of the cache, denoised once and from then on by what is kept of that; no OpenGL."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from experiments.lab import recorded as module
from experiments.lab.cache import Cache
from experiments.lab.recorded import Pair, clean_pair, load_pair
from ssac.camera import same_camera
from ssac.config import Cleaning
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import OURS, Input
from ssac.track.clean import Clean, clean
from tests.recorded import Recorded

HOW = Cleaning(denoise=True, n_neighbours=None)


def assert_same(one: Clean, other: Clean) -> None:
    for field in fields(Clean):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b, strict=True)
        elif field.name == "camera":
            assert same_camera(a, b)
        elif field.compare:
            assert a == b, field.name


@pytest.mark.parametrize("has_line", [False, True])
def test_a_pair_comes_back_as_denoising_left_it(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_line: bool
) -> None:
    raw = cam1, cam2, rig = load_pair(recorded.folder)
    left = [clean(one, camera, HOW) for one, camera in ((cam1, rig.cam1), (cam2, rig.cam2))]
    assert 0 < len(left[0].events) < len(cam1.events)
    if has_line:
        left[0] = replace(left[0], on_line=np.arange(len(left[0].events)) % 3 == 0)
    by_events = {id(cam1): left[0], id(cam2): left[1]}
    calls = []
    monkeypatch.setattr(module, "clean", lambda seen, *_: by_events[id(seen)])
    monkeypatch.setattr(module, "load_pair", lambda _: calls.append(1) or raw)
    for _ in range(2):
        pair = clean_pair(recorded.folder, HOW, Cache(tmp_path))
        for one, other in zip(pair, left, strict=True):
            assert_same(one, other)
        assert [one.n_recorded for one in pair] == [len(cam1.events), len(cam2.events)]
    assert len(calls) == 1  # the second time nothing of the recording is read


def test_of_a_camera_of_which_nothing_is_left_every_method_says_so(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cam1, cam2, rig = load_pair(recorded.folder)
    few = replace(cam2, events=cam2.events[:: len(cam2.events) // 9])  # none near another
    monkeypatch.setattr(module, "load_pair", lambda _: Pair(cam1, few, rig))
    for _ in range(2):
        pair = clean_pair(recorded.folder, HOW, Cache(tmp_path))
        assert len(pair[1].events) == 0 < len(few.events) == pair[1].n_recorded
        chain = Chain(pair, rig)
        for method in OURS:
            if method.input is not Input.FRAMES:
                found = chain.estimate(method)
                assert found.status in ("too_few_samples", "no_common_signal"), found
