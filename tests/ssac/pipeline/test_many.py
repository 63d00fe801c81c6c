"""The files that `ssac sync` reads and writes for three cameras, and the path from two."""

import re

import numpy as np
import pytest
import yaml

from ssac.files.rigs import load_rig
from ssac.files.track_files import save_track
from ssac.network.tum import read_path
from ssac.pipeline.many import short_names
from ssac.points import PointTrack
from tests.ssac.command import read_json, run
from tests.ssac.network.flights import DURATION_S, make_flight
from tests.ssac.tracks import rig_document


@pytest.fixture(scope="module")
def flight():
    return make_flight(3)


@pytest.fixture(scope="module")
def files(flight, tmp_path_factory):
    """Three tracks of one flight, and their rig."""
    folder = tmp_path_factory.mktemp("many")
    size = {"intrinsics": [900.0, 900.0, 480.0, 300.0], "resolution": [960, 600]}
    entry = rig_document(**size, intrinsics_std=[0.0] * 4)["cam0"]
    files = [folder / name for name in ("cam1.csv", "cam2.csv", "cam3.csv", "rig.yaml")]
    for file, seen in zip(files, flight.seen, strict=False):
        save_track(file, PointTrack(seen.times_s, seen.points_px))
    files[3].write_text(yaml.safe_dump({f"cam{k}": entry for k in range(3)}))
    return files


def rms_off_m(flight, file):
    """Return the rms distance [m] of a written path from the true one."""
    path = read_path(file)
    off_m = np.linalg.norm(path.positions_m - flight.path(path.times_s), axis=1)
    return float(np.sqrt(np.mean(off_m**2)))


def test_three_cameras(flight, files, tmp_path):
    out, path_file, rig_file = (tmp_path / name for name in ("out.json", "path.tum", "rig.yaml"))
    options = ("--json", out, "--trajectory", path_file, "--distance", flight.distance_m)
    *cameras, rig = files
    code, text, err = run("sync", *cameras, "--rig", rig, *options, "--write-rig", rig_file)
    assert code == 0, err
    assert "cam3" in text
    found = read_json(out)
    assert [camera["status"] for camera in found["cameras"]] == ["ok"] * 3
    for k, camera in enumerate(found["cameras"][1:], 1):
        true_s = flight.shown_s(k, camera["t_ref_s"])
        # Readouts of frames are unknown, so deviations include 10 ms for them.
        assert abs(camera["t_d_s"] - true_s) < 4.0 * camera["t_d_std_s"]
        assert camera["t_d_std_s"] < 0.02
    assert np.linalg.norm(found["cameras"][1]["t"]) == pytest.approx(flight.distance_m, rel=1e-4)
    cam2, cam3 = found["cameras"][1:]
    rig = load_rig(rig_file, (1, 3))
    np.testing.assert_allclose(rig.T_2_1[:3, :3], cam3["R"], atol=1e-12)  # by way of camera 2
    np.testing.assert_allclose(rig.T_2_1[:3, 3], cam3["t"], atol=1e-9)
    shifts_s = [
        entry.get("timeshift_cn_cnm1", 0.0) for entry in yaml.safe_load(rig_file.open()).values()
    ]
    # Offsets hold at different times, between which skews of some 100 ppm change them.
    assert shifts_s[1] == pytest.approx(cam2["t_d_s"], abs=1e-3)
    assert sum(shifts_s) == pytest.approx(cam3["t_d_s"], abs=1e-2)
    assert rms_off_m(flight, path_file) < 0.1  # readouts of 5 ms at some 5 m/s, and noise of 9 mm
    assert np.ptp(read_path(path_file).times_s) > 0.7 * DURATION_S  # all three see most of it


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["a/cam1.h5", "b/cam2.csv"], ["cam1", "cam2"]),
        (["a/left/x.h5", "a/right/x.h5", "x.csv"], ["left/x", "right/x", "x"]),
        (["two.bag/1/events", "two.bag/2/events"], ["1/events", "2/events"]),
        (["a/x.h5", "a/x.csv"], ["a/x.h5", "a/x.csv"]),
        (["camera 1", "camera 2"], ["camera 1", "camera 2"]),
    ],
)
def test_files_of_one_name_are_told_apart_by_their_folders(names, short):
    assert short_names(names) == short


def test_options_reach_every_pair(files):
    *cameras, rig = files
    code, _, err = run("sync", *cameras, "--rig", rig, "--search", -1, 1)
    assert code == 1, err
    assert err.count("no_common_time") == 2  # the clocks are 26 and 30 s apart
    assert "offsets" not in err


def save_another(path, start_s):
    """Save a track of 3 s of another object, which no offset fits."""
    times_s = start_s + 0.05 * np.arange(60)
    points_px = 300.0 + 100.0 * np.column_stack([np.cos(9.0 * times_s), np.sin(7.0 * times_s)])
    save_track(path, PointTrack(times_s, points_px))
    return path


@pytest.mark.parametrize("n_cameras", [2, 3])
def test_where_nothing_fits_that_is_told_and_no_error_of_the_frame(files, tmp_path, n_cameras):
    rtk, out, path = tmp_path / "rtk.csv", tmp_path / "out.json", tmp_path / "path.tum"
    rtk.write_text("t_s,x_m,y_m,z_m\n0,1,2,3\n1,2,2,3\n2,2,3,3\n")
    strangers = [save_another(tmp_path / f"{k}.csv", 1e3 * k) for k in range(1, n_cameras)]
    rig = tmp_path / "found.yaml"
    outputs = ("--trajectory", path, "--json", out, "--write-rig", rig)
    options = ("--rtk", rtk, *outputs, "--search", -1, 1)  # strangers are 1000 s apart
    code, _, err = run("sync", files[0], *strangers, "--rig", files[-1], *options)
    assert code == 1, err
    for output in (path, rig):
        assert f"not written: {output}" in err
        assert not output.exists()
    assert read_json(out)["status"] != "ok"


def test_two_cameras_write_a_path_and_a_third_that_fits_nowhere_is_not_averaged_in(
    flight, files, tmp_path
):
    out, late = tmp_path / "path.csv", save_another(tmp_path / "late.csv", 1000.0)
    one, other, _, of_three = files
    options = ("--trajectory", out, "--distance", flight.distance_m)
    code, text, err = run("sync", one, other, "--rig", of_three, *options)
    assert code == 0, err
    assert "time offset" in text
    assert "which hold from" in err
    assert rms_off_m(flight, out) < 0.15  # more than with three cameras, as one view is missing
    path = read_path(out)
    assert path.deviations_m.shape == path.positions_m.shape
    found, rig = tmp_path / "out.json", tmp_path / "rig.yaml"
    outputs = ("--json", found, "--write-rig", rig, "--distance", 7)  # one camera gets no place
    code, text, err = run("sync", one, late, other, "--rig", of_three, *outputs)
    assert code == 1, err
    assert re.search(r"late +no_match", text)
    assert "placed; no pose with the others: camera 2 (no_match)\n" in err
    assert load_rig(rig, (1, 2)).T_2_1 is None
    written = load_rig(rig, (1, 3))  # the camera between has no pose
    np.testing.assert_allclose(written.T_2_1[:3, :3], read_json(found)["cameras"][2]["R"])
    assert not written.in_metres
    assert np.linalg.norm(written.T_2_1[:3, 3]) == pytest.approx(1.0)
    assert "--distance is not used" in text
    assert read_json(found)["scale_is_known"] is False


@pytest.mark.parametrize("unit", ["m", "first_baseline"])
def test_the_path_of_known_extrinsics_has_their_scale_if_it_is_told(flight, files, tmp_path, unit):
    R, t_m = flight.poses[1]
    rig, out = yaml.safe_load(files[-1].read_text()), tmp_path / "path.csv"
    T_2_1 = np.vstack([np.column_stack([R, t_m]), [0.0, 0.0, 0.0, 1.0]])
    rig["cam1"] |= {"T_cn_cnm1": T_2_1.tolist(), "length_unit": unit}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    options = ("--rig", tmp_path / "rig.yaml", "--known-extrinsics", "--trajectory", out)
    again = tmp_path / "again.yaml"
    code, _, err = run("sync", *files[:2], *options, "--write-rig", again)
    assert code == 0, err
    if unit == "first_baseline":
        T_2_1[:3, 3] /= flight.distance_m
        assert err.count("in distances of the first two cameras placed") == 2
    else:
        assert rms_off_m(flight, out) < 0.15  # as where --distance states the scale
    np.testing.assert_allclose(load_rig(again).T_2_1, T_2_1, atol=1e-12)
    assert load_rig(again).in_metres == (unit == "m")
