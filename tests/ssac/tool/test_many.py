"""`ssac sync` of three cameras, and the path of two: files in, files out."""

import json

import numpy as np
import pytest
import yaml

from ssac.files.track_files import save_track
from ssac.path.tum import read_path
from ssac.points import PointTrack
from tests.ssac.command import run
from tests.ssac.network.flights import DURATION_S, make_flight


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Three tracks of one flight and their rig."""
    folder, flight = tmp_path_factory.mktemp("many"), make_flight(3)
    entry = {
        "camera_model": "pinhole",
        "intrinsics": [900.0, 900.0, 480.0, 300.0],
        "distortion_model": "none",
        "resolution": [960, 600],
        "intrinsics_std": [0.0, 0.0, 0.0, 0.0],
    }
    for k, seen in enumerate(flight.seen):
        save_track(folder / f"cam{k + 1}.csv", PointTrack(seen.times_s, seen.points_px))
    rig = {f"cam{k}": entry for k in range(3)}
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    return folder, flight


def test_three_cameras(files, tmp_path):
    folder, flight = files
    cameras = [folder / f"cam{k}.csv" for k in (1, 2, 3)]
    out, path_file = tmp_path / "out.json", tmp_path / "path.tum"
    args = ("--rig", folder / "rig.yaml", "--json", out, "--trajectory", path_file)
    code, text, err = run("sync", *cameras, *args, "--distance", flight.distance_m)
    assert code == 0, err
    assert "cam3" in text
    found = json.loads(out.read_text())
    assert [camera["status"] for camera in found["cameras"]] == ["ok"] * 3
    for k, camera in enumerate(found["cameras"][1:], 1):
        true_s = flight.shown_s(k, camera["t_ref_s"])
        # Frames' readouts are not known, and 10 ms of them are allowed for.
        assert abs(camera["t_d_s"] - true_s) < 4.0 * camera["t_d_std_s"]
        assert camera["t_d_std_s"] < 0.02
    assert np.linalg.norm(found["cameras"][1]["t"]) == pytest.approx(flight.distance_m, rel=1e-4)
    path = read_path(path_file)
    off_m = np.linalg.norm(path.positions_m - flight.path(path.times_s), axis=1)
    assert np.sqrt(np.mean(off_m**2)) < 0.1  # 5 ms of readouts, at some 5 m/s, and 9 mm of noise
    assert np.ptp(path.times_s) > 0.7 * DURATION_S  # all three see it most of the time


def test_what_is_for_two_cameras_is_refused_for_more(files):
    folder, _ = files
    cameras = [folder / f"cam{k}.csv" for k in (1, 2, 3)]
    code, _, err = run("sync", *cameras, "--rig", folder / "rig.yaml", "--search", -1, 1)
    assert code == 2
    assert "--search: is for two cameras" in err


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--lever-arm", 0, 0, 1), "give --rtk too"),
        (("--distance", 3, "--rtk", "rtk.csv"), "--distance: not with --rtk"),
        (("--focal-std", 1), "--focal-std: is for two cameras"),
    ],
)
def test_options_that_do_not_go_together_are_one_line(files, args, said):
    folder, _ = files
    cameras = [folder / f"cam{k}.csv" for k in (1, 2, 3)]
    code, _, err = run("sync", *cameras, "--rig", folder / "rig.yaml", *args)
    assert code == 2
    assert said in err
    assert err.strip().count("\n") == 0


@pytest.mark.parametrize(
    ("text", "args", "said"),
    [
        ("t_s,lat,lon,alt\n0,47,8,400\n", ("--rtk",), "turn latitude and longitude"),
        ("x_m,y_m,z_m\n0,47,8\n", ("--rtk",), "needs times"),
        ("t_s,x_m,y_m,z_m\n0,1,2,3\n", ("--lever-arm", 0, 0, 1, "--rtk"), "no attitude"),
        ("camera,x_m,y_m,z_m\n1,0,0,0\n1,1,0,0\n", ("--positions",), "camera 1 is there twice"),
        (None, ("--positions",), "there is no such file"),
    ],
)
def test_what_cannot_be_used_is_told_before_any_work(files, tmp_path, text, args, said):
    folder, _ = files
    given = tmp_path / "given.csv"
    if text is not None:
        given.write_text(text)
    cameras = [folder / f"cam{k}.csv" for k in (1, 2, 3)]
    code, _, err = run("sync", *cameras, "--rig", folder / "rig.yaml", *args, given)
    assert code == 2
    assert said in err
    assert err.strip().count("\n") == 0  # no pair's progress before it


def test_a_rig_of_fewer_cameras_is_told_before_any_work(files, tmp_path):
    folder, _ = files
    rig = yaml.safe_load((folder / "rig.yaml").read_text())
    del rig["cam2"]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    cameras = [folder / f"cam{k}.csv" for k in (1, 2, 3)]
    code, _, err = run("sync", *cameras, "--rig", tmp_path / "rig.yaml")
    assert code == 2
    assert "there is no cam2 for camera 3" in err
    assert err.strip().count("\n") == 0


def test_cameras_that_share_no_time_are_told_and_not_averaged_in(files, tmp_path):
    folder, _ = files
    late = tmp_path / "late.csv"  # some seconds of another object: they fit nowhere
    times_s = 1000.0 + 0.05 * np.arange(60)
    points_px = 300.0 + 100.0 * np.column_stack([np.cos(9.0 * times_s), np.sin(7.0 * times_s)])
    save_track(late, PointTrack(times_s, points_px))
    cameras = [folder / "cam1.csv", folder / "cam2.csv", late]
    code, text, err = run("sync", *cameras, "--rig", folder / "rig.yaml")
    assert code == 1, err
    assert "late" in text
    assert "no_match" in text


def test_a_camera_twice_is_one_line(files):
    folder, _ = files
    cameras = [folder / f"cam{k}.csv" for k in (1, 2, 1)]
    code, _, err = run("sync", *cameras, "--rig", folder / "rig.yaml")
    assert code == 2
    assert "given for cameras 1 and 3" in err
    assert err.strip().count("\n") == 0


def test_two_cameras_write_a_path_with_deviations(files, tmp_path):
    folder, flight = files
    cameras, out = [folder / f"cam{k}.csv" for k in (1, 2)], tmp_path / "path.csv"
    args = ("--rig", folder / "rig.yaml", "--trajectory", out, "--distance", flight.distance_m)
    code, text, err = run("sync", *cameras, *args)
    assert code == 0, err
    assert "time offset" in text
    assert "which hold from" in err
    path = read_path(out)
    off_m = np.linalg.norm(path.positions_m - flight.path(path.times_s), axis=1)
    assert np.sqrt(np.mean(off_m**2)) < 0.15  # as of three cameras, and one less to hold them
    assert path.deviations_m.shape == path.positions_m.shape
