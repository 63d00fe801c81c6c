"""Tests that the scripts of docs/ do what the pages say about them."""

import re
import runpy
from dataclasses import fields, is_dataclass

import cv2
import matplotlib.pyplot as plt
import numpy as np
import pytest

import ssac
from docs import conf, example, track_video
from experiments.lab.code import ROOT


@pytest.mark.render
def test_the_tour_runs_and_finds_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(ROOT / "docs" / "tour" / "tour.py"))
    said = capsys.readouterr().out
    assert len(plt.get_fignums()) == 1
    assert "<script" in (tmp_path / "report.html").read_text(encoding="utf-8")
    plt.close("all")
    assert re.search(r"^status ok$", said, re.MULTILINE)
    # The bound for 6 s of flight is a few times the mean error of `tangency` over 10 s.
    assert float(re.findall(r"^offset off by ([\d.]+) ms", said, re.MULTILINE)[0]) < 0.5
    assert re.search(r"^ambiguous_offset\n\w", said, re.MULTILINE)
    # Four bins of 5 ms: the drone's middle is not at one height for both cameras.
    assert float(re.findall(r"^heights: .* off by ([\d.]+) ms", said, re.MULTILINE)[0]) <= 20


def test_a_video_becomes_the_track_of_what_moves_in_it(tmp_path):
    fps, size = 30.0, (160, 120)
    frames = np.arange(90)
    path_px = np.column_stack([80 + 50 * np.cos(0.1 * frames), 60 + 35 * np.sin(0.13 * frames)])
    ground = np.random.default_rng(0).integers(120, 200, (15, 20), np.uint8)
    ground = cv2.resize(ground, size, interpolation=cv2.INTER_CUBIC)
    video = cv2.VideoWriter(
        str(tmp_path / "a.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), fps, size, isColor=True
    )
    for x, y in path_px:
        image = cv2.circle(ground.copy(), (round(16 * x), round(16 * y)), 6 * 16, 20, -1, 16, 4)
        video.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    video.release()
    times_s, points_px = track_video.followed(tmp_path / "a.mp4", 12)
    seen = np.rint(times_s * fps).astype(int)
    # The frames of the first second are missing, as the background is learnt from them.
    assert seen.tolist() == list(range(30, 90))
    # The mask has whole pixels, and the video is compressed.
    assert np.abs(points_px - path_px[seen]).max() < 1.0


@pytest.mark.render
def test_the_readme_shows_what_its_commands_and_its_python_print(tmp_path, monkeypatch, capsys):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    simulated = example.printed(example.SIMULATE, tmp_path)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    summary, _, last_line = capsys.readouterr().out.rpartition("\nok ")
    assert last_line.startswith("0.0")
    # `ssac sync` prints the summary too: see tests/test_one_answer.py.
    printed = f"$ {example.SIMULATE}\n{simulated}$ {example.SYNC}\n{summary}"
    # Digits depend on the GL library, so only the words are compared.
    assert _words(example.shown_in(readme)) == _words(printed), "run docs/example.py"


@pytest.mark.parametrize("name", [one for one in ssac.__all__ if is_dataclass(getattr(ssac, one))])
def test_the_reference_says_what_each_field_is(name):
    one = getattr(ssac, name)
    said = {
        field
        for base in one.__mro__[:-1]
        for owner, field in conf.ModuleAnalyzer.for_module(base.__module__).find_attr_docs()
        if owner == base.__qualname__
    }
    assert {field.name for field in fields(one)} <= said


def _words(text):
    return re.sub(r"-?\d[\d.]*|\(.*llvmpipe.*\)|osmesa|egl", "#", text).split()
