"""A synthetic folder in the layout of the public data sets is read and synchronised."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments.studies.real import PAIRS, STRAYS, TRIPLES, real_figure
from experiments.worlds import tracks
from ssac import Clock, Estimate, SsacError, load_rig, load_track
from ssac.files.drone_tracking import import_data_set
from ssac.network.graph import closures_s
from tests.experiments.reported import RESULTS
from tests.ssac.command import run
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_scene
from tests.ssac.tracks import FPS, frame_track

OFFSET_S = 4.0


def calibrated(**changed):
    size = [WIDTH, HEIGHT]
    camera = {"K-matrix": K.tolist(), "distCoeff": [0.0] * 4, "fps": 30, "resolution": size}
    return json.dumps(camera | changed)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Two cameras of one flight, as `dataset2`."""
    root = tmp_path_factory.mktemp("data")
    folder = root / "dataset2"
    (folder / "detections").mkdir(parents=True)
    (folder / "cameras.txt").write_text("cam0 - phone\ncam1 - camcorder\n")
    scene = make_scene(1)
    cameras = ("phone", FPS[0], 0.0), ("camcorder", FPS[1], OFFSET_S)
    for k, (model, fps, offset_s) in enumerate(cameras):
        track = frame_track(scene, k + 1, fps, offset_s, seed=k)
        frames = np.rint(track.times_s * fps)
        rows = np.zeros((int(frames[-1]) + 1, 3))
        rows[:, 0] = np.arange(len(rows))
        rows[frames.astype(int), 1:] = track.points_px
        rows[3, 1:] = (WIDTH + 40.0, 20.0)  # a label beyond the image
        header = " frame no.            x            y\n" if k else ""
        text = "".join(f"{f:.6f} {x:12.8f} {y:12.8f}\n" for f, x, y in rows)
        (folder / "detections" / f"cam{k}.txt").write_text(header + text)
        (root / "calibration" / model).mkdir(parents=True)
        calibration = calibrated(distCoeff=[0.0] * (4 + k), fps=fps)
        (root / "calibration" / model / f"{model}.json").write_text(calibration)
    return root


def test_a_data_set_becomes_tracks_and_a_rig(data, tmp_path):
    _, out, _ = run("import", "drone-tracking", data / "dataset2", tmp_path / "out")
    assert out.count("1 outside the image left out") == 2
    for k, fps in enumerate(FPS):
        track = load_track(tmp_path / "out" / f"cam{k}.csv")
        whole = track.times_s * fps
        np.testing.assert_allclose(whole, np.rint(whole), atol=1e-4)  # frame k at k / fps
        camera = load_rig(tmp_path / "out" / "rig.yaml", (k + 1, k + 1)).cam1
        assert (camera.width, camera.distortion_model) == (WIDTH, "radtan")
        np.testing.assert_array_equal(camera.K, K)


def test_the_number_in_a_folders_name_tells_which_data_set_it_is(data, tmp_path):
    shutil.copytree(data, tmp_path / "data")
    folder = (tmp_path / "data" / "dataset2").rename(tmp_path / "data" / "dataset4")
    for camera, fps in zip(import_data_set(folder, tmp_path / "out"), FPS, strict=True):
        assert set(np.rint(camera.track.times_s * fps).astype(int) % 4) == {1}
    with pytest.raises(SsacError, match="mine: expected a name that ends in the data set's number"):
        import_data_set(folder.rename(tmp_path / "data" / "mine"), tmp_path / "none")
    assert not (tmp_path / "none").exists()
    with pytest.raises(SsacError, match="there is no such folder"):
        run_pairs(tmp_path, tmp_path, (1,))


def run_pairs(data, work, numbers):
    return tracks.pair_tables(tracks.data_sets(data, work, lambda line: None, numbers))


def test_all_pairs_are_run_and_say_what_they_rest_on(data, tmp_path):
    tables = run_pairs(data, tmp_path, (2,))
    (row,) = tables[PAIRS].to_dict("records")
    assert list(row) == (RESULTS / f"{PAIRS}.csv").read_text().splitlines()[0].split(",")
    assert row["status"] == "ok"
    # Labels are put on whole frames: +-0.13 frames of either camera, at most 10 ms together.
    assert abs(row["t_d_s"] - OFFSET_S) < 0.01
    assert 0.0 <= row["readout_1_ms"] < 4.0 * row["readout_1_std_ms"]  # the truth is 0
    assert row["t_d_std_ms"] > row["global_std_ms"]  # unknown readouts leave less known
    assert [len(tables[name]) for name in (TRIPLES, STRAYS)] == [0, 0]
    strays = pd.DataFrame([(2, 0, 1, 3.0, 1.0, 0.5)], columns=tracks.STRAY_COLUMNS)
    *small, above = real_figure(SimpleNamespace(table={**tables, STRAYS: strays}.get)).axes
    assert [label.get_text() for label in above.get_xticklabels()] == ["2: 0-1"]
    assert [axes.get_title() for axes in small if axes.axison] == ["2: 0-1"]


def test_clocks_of_varying_rates_are_followed_ever_more_roughly(data, tmp_path, monkeypatch):
    tried = []

    def refused(*paths, config, **more):
        tried.append((config.clock, config.roughness_ppm))
        jumped = {"estimate": Estimate("joint", "clock_jump"), "guess": None, "start": None}
        return SimpleNamespace(answer=SimpleNamespace(**jumped, config=config))

    monkeypatch.setattr(tracks, "sync", refused)
    monkeypatch.setattr(tracks, "VARIABLE_RATES", {(2, 1)})
    (row,) = run_pairs(data, tmp_path, (2,))[PAIRS].to_dict("records")
    assert tried == [("pieces", one) for one in sorted(tracks.ROUGHNESSES_PPM)]
    assert row["status"] == "clock_jump"


PHONE = "../calibration/phone/phone.json"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cameras.txt", "nothing", "expected lines like"),
        ("cameras.txt", "cam0 - phone\ncam0 - phone\n", "cam0 is there twice"),
        *(
            ("cameras.txt", f"cam0 - {name}\n", f"expected a camera's name, got '{name}'")
            for name in ("../../secret", "/secret", "..", ".", "phone/.")
        ),
        ("detections/cam0.txt", "inf 5 5\n", "a frame's number is not finite"),
        ("detections/cam0.txt", "1 2 three\n", "not a list of lines `frame x y`"),
        ("detections/cam0.txt", "1 0 0\n", "the object is seen in no frame"),
        ("detections/cam0.txt", "1 5 5\n1 9 9\n", "rows must be in time order"),
        ("detections/cam0.txt", "2 5 5\n1 9 9\n", "rows must be in time order"),
        (PHONE, "{}", "not a calibration"),
        (PHONE, calibrated(fps=0), "0 frames a second"),
        (PHONE, calibrated(resolution=[346]), "not enough values"),
        (PHONE, calibrated(resolution=[1, 1]), "no camera's of 1 x 1 px"),
    ],
)
def test_a_bad_data_set_is_one_line(data, tmp_path, name, text, message):
    folder = shutil.copytree(data, tmp_path / "data") / "dataset2"
    (folder / name).write_text(text)
    _, _, err = run("import", "drone-tracking", folder, tmp_path / "out", code=2)
    assert err.count("\n") == 1
    assert message in err


def test_the_closure_of_true_clocks_is_nothing():
    knots = np.array([20.0, 40.0]), np.array([0.01, 0.03])  # the first clock wanders, too
    clocks = {(0, 1): Clock(3.0, 1e3, 10.0, *knots), (1, 2): Clock(-5.0, -3e5, 20.0)}
    direct_s = float(clocks[1, 2].cam2_from_cam1(clocks[0, 1].cam2_from_cam1(30.0))) - 30.0
    for off_s in (0.0, 0.02):
        clocks[0, 2] = Clock(direct_s + off_s, 0.0, 30.0)
        assert closures_s(clocks)[0, 1, 2] == pytest.approx(-off_s, abs=1e-12)


def test_published_clocks_are_read(tmp_path):
    alpha = "| --- | --- |\n|0 | 1.0 | 0.4999 |\n|1 | 2.0 | 1.0 |\n"
    (tmp_path / "README.md").write_text(alpha + "|0 | 0 | 0.5 |\n|1 | -1.0 | 0 |\n")
    truth = tracks.load_clocks(tmp_path)
    assert truth.alpha[0, 1] == 0.4999
    # The finer of both directions: frame i = 2 j - 1; 100 s are frame 6000, which is j = 3000.5.
    assert truth.t_d_s(0, 1, (60.0, 30.0), 100.0) == pytest.approx(0.5 / 30.0)
