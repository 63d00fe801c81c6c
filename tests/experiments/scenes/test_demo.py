import json
from pathlib import Path

import numpy as np
import pytest

from experiments.lab.provenance import code_commit, plain, provenance, versions, write_provenance
from experiments.scenes.demo import DEMO, comparison, demo_command, is_of_a_demo
from sim.errors import SimError
from sim.recorded import Truth
from sim.recording import SimConfig
from ssac.estimate import Estimate

TRUTH = Truth(
    t_d_s=0.05,
    R=np.eye(3),
    t=np.array([1.0, 0.0, 0.0]),
    baseline_m=7.0,
    times_s=np.zeros(1),
    T_W_B=np.eye(4)[None],
    centres_px=np.zeros((2, 1, 2)),
)


def test_the_comparison_shows_estimate_truth_and_error() -> None:
    estimate = Estimate("ssac", t_d_s=0.0512, R=np.eye(3), t=TRUTH.t, n_samples=9, d_avg_px=0.4)
    head, _, t_d, R, t = comparison(estimate, TRUTH).splitlines()
    assert head == "ssac: 9 samples, d_avg 0.400 px"
    assert t_d.split() == ["t_d", "51.200", "ms", "50.000", "ms", "1.200", "ms"]
    assert R.endswith("0.000 deg")
    assert t.endswith("0.000 deg")


def test_no_estimate_says_why() -> None:
    refused = Estimate("ssac", status="too_few_samples", reason="only 3 of them")
    assert comparison(refused, TRUTH) == "ssac: too_few_samples: only 3 of them"


def test_a_demo_replaces_the_recording_of_an_earlier_one_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    assert not is_of_a_demo(folder)
    folder.mkdir()
    (folder / "truth.json").write_text(json.dumps({"provenance": {"config": plain(DEMO)}}))
    assert is_of_a_demo(folder)
    for other in ({"provenance": {"config": plain(SimConfig())}}, {"provenance": {}}, [], "x"):
        (folder / "truth.json").write_text(json.dumps(other))
        assert not is_of_a_demo(folder)
    with pytest.raises(SimError, match="recording is not empty: name a new folder"):
        demo_command(tmp_path)
    assert [path.name for path in folder.iterdir()] == ["truth.json"]


def test_provenance_holds_all_that_a_result_depends_on(tmp_path: Path) -> None:
    write_provenance(tmp_path / "a.csv", provenance("ssac x", SimConfig(), 1.25, None))
    text = (tmp_path / "a.provenance.json").read_text()
    for word in ("ssac x", code_commit(), versions()["numpy"], "max_step_px", '"wall_time_s": 1.2'):
        assert word in text


def test_plain_keeps_structure(tmp_path: Path) -> None:
    assert plain({"a": (1, tmp_path), 2: [None]}) == {"a": [1, str(tmp_path)], "2": [None]}
    assert plain(SimConfig())["render"]["lattice"] == {"a": 16, "b": 1}
    with pytest.raises(KeyError):
        plain(SimConfig())["no such key"]
