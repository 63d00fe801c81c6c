"""`ssac sync` and `ssac track` on track files: what they find, and say."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import yaml

from ssac import sync
from ssac.config import Config
from ssac.estimate import Estimate, Status
from ssac.files.event_files import load_events
from ssac.files.hdf5 import save_events_h5
from ssac.files.rigs import load_rig
from ssac.files.track_files import load_track, save_track
from ssac.pipeline.registry import choose_method
from ssac.pipeline.report import report_text
from ssac.points import PointTrack
from ssac.rules import Rules, TrackRules
from ssac.search.object_track import track_of_events
from ssac.track.clean import clean
from ssac.track.observation import Observation
from tests.recorded import T_D_S
from tests.ssac.command import run
from tests.ssac.crowds import flight, mixed
from tests.ssac.synthetic import HEIGHT, WIDTH, angle_deg, rotation_angle_deg
from tests.ssac.tracks import rig_document, save_pair

WIDE = 4.0  # deviations: a right answer is further off in 1 of 16,000


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    return save_pair(tmp_path_factory.mktemp("tracks"))


def synced(folder, rig="rig.yaml", **more):
    return sync(folder / "cam1.csv", folder / "cam2.csv", folder / rig, **more)


def answer(pair, *more, out):
    code, _, err = run("sync", *pair.args, "--json", out, *more)
    assert code == 0, err
    return json.loads(out.read_text())


def test_two_tracks_are_synchronised_from_nothing(pair, tmp_path):
    found = answer(pair, out=tmp_path / "out.json")
    assert (found["status"], found["method"]) == ("ok", "joint")
    assert abs(found["t_d_s"] - pair.t_d_s) < WIDE * found["t_d_std_s"]
    assert found["t_d_std_s"] < 2e-3  # 0.3 px at 180 px/s are 1.7 ms for one of hundreds of points
    assert rotation_angle_deg(np.array(found["R"]), pair.scene.R) < 1.0
    assert angle_deg(np.array(found["t"]), pair.scene.t) < 1.0


def test_a_synced_track_has_no_offset_left(pair, tmp_path):
    answer(pair, "--write-synced", tmp_path / "synced.csv", out=tmp_path / "out.json")
    again = sync(pair.folder / "cam1.csv", tmp_path / "synced.csv", pair.folder / "rig.yaml")
    assert abs(again.estimate.t_d_s) < WIDE * again.estimate.t_d_std_s


def test_tracks_too_short_for_any_offset_leave_no_guess(pair):
    """Such an answer has a search, and nothing that a table or the network could begin with."""
    cameras = []
    for name in ("cam1.csv", "cam2.csv"):
        track = load_track(pair.folder / name)
        cameras.append(PointTrack(track.times_s[:7], track.points_px[:7]))
    answer = sync(*cameras, pair.folder / "rig.yaml").answer
    assert answer.estimate.status == Status.TOO_LITTLE_MOTION
    assert answer.guess is None
    assert "too_little_motion" in report_text(answer)


def test_an_unknown_frame_rate_is_found(tmp_path):
    rate = 0.71  # frames that were counted at 21.3 Hz, taken for 30
    pair = save_pair(tmp_path, t_d_s=3.0, rate=rate)
    found = answer(pair, "--rate-range", 0.6, 0.8, out=tmp_path / "out.json")
    # The clock shows rate (t + offset).
    true_s = rate * (found["t_ref_s"] + pair.t_d_s) - found["t_ref_s"]
    assert found["skew_ppm"] == pytest.approx(1e6 * (rate - 1.0), abs=2000.0)  # 20 ms over 10 s
    assert abs(found["t_d_s"] - true_s) < 0.02


def test_times_that_are_hardly_seconds_are_pointed_out(pair, tmp_path):
    track = load_track(pair.folder / "cam2.csv")
    save_track(tmp_path / "ms.csv", replace(track, times_s=1e3 * track.times_s))
    rig, nowhere = ("--rig", pair.folder / "rig.yaml"), ("--search", 9e6, 9e6 + 1.0)  # ends soon
    _, _, err = run("sync", pair.folder / "cam1.csv", tmp_path / "ms.csv", *rig, *nowhere)
    assert f"warning: {tmp_path / 'ms.csv'}: its points are " in err
    assert "give seconds" in err
    code, out, err = run("sync", *pair.args, *nowhere)
    assert code == 1
    assert "no common time" in out
    assert "warning" not in err


def test_a_clock_of_pieces_may_leave_the_pose_open(pair, monkeypatch):
    def estimate(cam1, cam2, rig, config):
        status = Status.POOR_FIT if config.clock == "affine" else Status.AMBIGUOUS_POSE
        return Estimate("joint", status, t_d_s=7.3, t_d_std_s=1e-3)

    method = replace(choose_method("joint"), estimate=estimate)
    monkeypatch.setattr("ssac.pipeline.api.choose_method", lambda *names: method)
    answer = synced(pair.folder, config=Config(interval_s=(7.0, 8.0), skew_prior_ppm=1e3)).answer
    assert (answer.estimate.status, answer.clock) == (Status.AMBIGUOUS_POSE, "pieces")


def test_events_and_a_track_of_events_may_be_mixed(recorded, tmp_path):
    track = tmp_path / "cam1.csv"
    code, out, err = run("track", recorded.pair[0], "--rig", recorded / "rig.yaml", "--out", track)
    assert code == 0, err
    assert "points from" in out
    for files in ((track, recorded.pair[1]), recorded.pair):
        result = sync(*files, recorded / "rig.yaml", "joint", search="all")
        assert result.estimate.status == "ok"
        assert result.estimate.t_d_s == pytest.approx(T_D_S, abs=3e-3)  # as for two event files


def test_a_track_is_made_by_the_rules_that_are_given(recorded):
    rig = load_rig(recorded / "rig.yaml")
    config = Config()
    seen = clean(Observation(load_events(recorded.pair[0]).events), rig.cam1, config.cleaning)
    usual = track_of_events(seen, config)
    rules = replace(Rules(), track=TrackRules(step_s=0.02, mean_sizes=0.08, least_sigma_px=0.2))
    other = track_of_events(seen, replace(config, rules=rules))
    assert np.median(np.diff(other.times_s)) == pytest.approx(0.02)
    assert np.median(other.sigmas_px) == pytest.approx(2.0 * np.median(usual.sigmas_px), rel=0.05)
    assert other.sigmas_px.min() >= 0.2


def test_a_track_of_several_things_comes_with_a_warning(tmp_path):
    one, other = flight(4)[0], flight(5)[0]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig_document()))
    for name, events in (("one", one), ("two", mixed(one, other)[0])):
        save_events_h5(tmp_path / f"{name}.h5", events, WIDTH, HEIGHT)
        args = tmp_path / f"{name}.h5", "--rig", tmp_path / "rig.yaml"
        code, _, err = run("track", *args, "--out", tmp_path / f"{name}.csv")
        assert code == 0, err
        assert ("two.h5: 2 things move at a time" in err) == (name == "two")
        assert err.count("warning") == (name == "two")


@pytest.mark.parametrize("step_s", [0.001, 0.01])
def test_times_cut_off_are_noticed_and_make_the_offset_less_sure(pair, tmp_path, step_s):
    track = load_track(pair.folder / "cam1.csv")
    times_s = np.floor(track.times_s / step_s + 1e-9) * step_s
    save_track(tmp_path / "cam1.csv", replace(track, times_s=times_s))
    others = (pair.folder / "cam2.csv", pair.folder / "rig.yaml")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        result = sync(tmp_path / "cam1.csv", *others)
    assert f"all times are whole {1e3 * step_s:g} ms" in str(said[0].message)
    assert result.estimate.t_d_std_s > step_s / 12**0.5
    assert abs(result.estimate.t_d_s - pair.t_d_s) < WIDE * result.estimate.t_d_std_s


# --- Rolling shutters ---

READOUT_S = 0.02


@pytest.fixture(scope="module")
def shuttered(tmp_path_factory):
    """Camera 1's readout is stated, camera 2's is not: none, in truth."""
    return save_pair(tmp_path_factory.mktemp("tracks"), t_d_s=0.2, readout_s=READOUT_S)


@pytest.mark.parametrize("asked", [True, False])
def test_the_readout_that_is_not_stated_is_told_or_taken_for_none_and_that_is_said(
    shuttered, asked
):
    result = synced(shuttered.folder, search="interval", estimate_readout=asked)
    report = result.to_dict()
    assert report["readout_s"][0] == READOUT_S  # exact, as the rig says
    if not asked:
        assert report["readout_s"][1] is None
        assert "--estimate-readout" in report["note"]
        return
    assert report["readout_std_s"][0] == 0.0
    assert 0.0 <= report["readout_s"][1] < 4.0 * report["readout_std_s"][1]
    assert "readout        camera 2 " in result.summary()
    assert report["note"] == ""
