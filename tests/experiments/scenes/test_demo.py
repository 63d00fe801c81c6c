"""`ssac demo` and `ssac scene`: the texts that they print about estimates and flights."""

import json
from dataclasses import replace

import numpy as np
import pytest

from experiments.lab.provenance import plain
from experiments.lab.score import Truth
from experiments.scenes import scene
from experiments.scenes.demo import DEMO, comparison, demo_command, is_of_a_demo
from experiments.scenes.scene import SHOWN, scene_figures
from sim.errors import SimError
from sim.recording import SimConfig, simulate
from sim.scene.trajectory import SplineConfig
from sim.sensor.events import PRESETS
from ssac.errors import SsacError
from ssac.estimate import Estimate
from tests.sim.scenes import COARSE


def test_the_comparison_shows_estimate_truth_and_error():
    pose = {"R": np.eye(3), "t": np.array([1.0, 0.0, 0.0])}
    truth = Truth(t_d_s=0.05, **pose)
    estimate = Estimate("ssac", t_d_s=0.0512, n_samples=9, d_avg_px=0.4, **pose)
    head, _, t_d, R, t = comparison(estimate, truth).splitlines()
    assert head == "ssac: 9 samples, d_avg 0.400 px"
    assert t_d.split() == ["t_d", "51.200", "ms", "50.000", "ms", "1.200", "ms"]
    assert R.endswith("0.000 deg")
    assert t.endswith("0.000 deg")
    refused = Estimate("ssac", status="too_few_samples", reason="only 3 of them")
    assert comparison(refused, truth) == "ssac: too_few_samples: only 3 of them"


def test_a_demo_replaces_the_recording_of_an_earlier_one_and_nothing_else(tmp_path):
    folder = tmp_path / "recording"
    assert not is_of_a_demo(folder, 0)
    folder.mkdir()
    made_with = {"config": plain(DEMO), "seed": 0, "versions": {}}
    (folder / "truth.json").write_text(json.dumps({"provenance": made_with}))
    assert is_of_a_demo(folder, 0)
    assert not is_of_a_demo(folder, 1)
    (folder / "sync.json").write_text("mine")
    with pytest.raises(SimError, match=r"recording is not empty, .* is in it: name a new folder"):
        demo_command(tmp_path)
    assert {path.name for path in folder.iterdir()} == {"truth.json", "sync.json"}
    (folder / "sync.json").unlink()
    others = ({"config": plain(SimConfig())}, {"disturbances": {}}, {"true_K": {}})
    for other in (*({"provenance": made_with | one} for one in others), {"provenance": {}}, [], ""):
        (folder / "truth.json").write_text(json.dumps(other))
        assert not is_of_a_demo(folder, 0)


def test_figures_are_those_of_the_truth():
    config = replace(COARSE, spline=SplineConfig(6.0))
    recording = simulate(config, 0)
    figures = scene_figures(recording)
    # The true speed is that of the drone's origin. The mean of its events moves alike, but N_min
    # drops windows, those of slow motion.
    centres = recording.truth.centres_px
    speeds = np.linalg.norm(np.gradient(centres, recording.truth.times_s, axis=1), axis=-1)
    assert figures["speed_px_s"] == pytest.approx(np.nanmedian(speeds), rel=0.25)
    assert 0 < figures["median_distance_px"] < figures["mean_distance_px"] < 2.0
    assert figures["slope_px"] > 0.0
    assert figures["n_events"] == np.mean([len(camera.events) for camera in recording.cameras])
    # The figures do not depend on the time offset.
    assert scene_figures(simulate(replace(config, t_d_s=0.25), 0)) == figures
    # Nor does the width depend on noise, but for what denoising leaves or takes too much.
    noisy = simulate(replace(config, sensor=PRESETS["davis346"]), 0)
    assert scene_figures(noisy)["wide_px"] == pytest.approx(figures["wide_px"], rel=0.2)
    # 5 events a camera make no valid sample.
    few = [replace(one, events=one.events[:: len(one.events) // 4]) for one in recording.cameras]
    with pytest.raises(SsacError, match="no figures: at no sample time do both cameras see"):
        scene_figures(replace(recording, cameras=tuple(few)))


def test_the_command_flies_what_it_is_told_and_shows_each_figure(monkeypatch, capsys):
    names = ("speed_px_s", "n_valid", "n_samples", "mean_distance_px", "median_distance_px",
             "slope_px", "narrow_px", "wide_px", "n_events")  # fmt: skip
    numbers = (197.6, 348, 400, 0.412, 0.2, 1.3, 19.6, 45.4, 1e6)
    figures, flown = dict(zip(names, numbers, strict=True)), []
    monkeypatch.setattr(scene, "simulate", lambda *of: flown.append(of))
    monkeypatch.setattr(scene, "scene_figures", lambda _: figures)
    scene.scene_command(seeds=2, first_seed=9100, drone="two-tone")
    usual = {"angle_deg": 90.0, "spline": SplineConfig(20.0), "frames": COARSE.frames}
    config = SimConfig(drone="two-tone", **usual)
    assert flown == [(config, 9100), (config, 9101)]
    _, _, *lines = (" ".join(line.split()) for line in capsys.readouterr().out.splitlines())
    assert len(lines) == len(SHOWN)
    assert lines[0] == "| median image speed [px/s] | 198 | 198 |"
    assert lines[1] == "| sample times valid in both views | 348 of 400 | 348 of 400 |"
    assert lines[5] == "| width in the event image [px] | 20-45 | 20-45 |"
