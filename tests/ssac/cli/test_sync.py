"""`ssac sync` and `ssac track`: what they find, print, read and write."""

import os
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from ssac import Clock, PointTrack, Result, Status, load_events, load_rig, sync
from ssac.cli.exits import BAD_INPUT, NO_ESTIMATE
from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import load_track, save_track
from ssac.network.tum import Path, read_path, write_path
from ssac.pipeline.many import short_names
from ssac.pipeline.plots import d_avg_px
from tests.recorded import T_D_S
from tests.ssac.bags import arrays, mono, write_bag
from tests.ssac.cluttered import flight, mixed
from tests.ssac.command import read_json, run
from tests.ssac.network.flights import DURATION_S, make_flight
from tests.ssac.synthetic import HEIGHT, WIDTH, angle_deg, make_scene, rotation_angle_deg
from tests.ssac.tracks import rig_document, save_pair

TOLERANCE_S = 3e-3  # 8 s of noisy synthetic pixels err by about 1 ms


def answered(folder, *args, code=0):
    """Run `ssac sync`, which must end so; return the run, and its JSON without the duration."""
    result = run("sync", *args, "--json", folder / "out.json", code=code)
    return result, {**read_json(folder / "out.json"), "seconds": 0}


def test_the_offset_is_found_told_and_taken_off_the_synced_events(recorded, tmp_path):
    """Results are on stdout, progress on stderr."""
    synced = tmp_path / "synced.h5"
    result, found = answered(tmp_path, recorded.folder, "--write-synced", synced)
    assert "the outline does not close" in found["note"]  # the object is a cloud of pixels
    assert (found["status"], found["reason"], found["method"]) == ("ok", "", "tangency")
    assert abs(found["t_d_s"] - T_D_S) < TOLERANCE_S
    shown_ms = f"{1e3 * found['t_d_s']:.3f} ms"
    assert f"t_d = {shown_ms}" in result.stdout
    assert f"camera 2's clock shows {shown_ms} more than camera 1's; subtract it" in result.stdout
    assert f"{found['n_samples']} pairs of tangents to the outline" in result.stdout
    for part in ("read", "denoise", "estimate", "write"):
        assert part not in result.stdout
        assert any(line.startswith(part) and " s  " in line for line in result.stderr.splitlines())
    assert str(synced) in result.stderr
    before, after = load_events(recorded / "cam2.h5").events, load_events(synced).events
    clock = Clock(found["t_d_s"], found["skew_ppm"], found["t_ref_s"])
    expected_us = 1e6 * clock.cam1_from_cam2(before["t"] / 1e6)
    # The tolerance is half a microsecond of rounding, and the last digits of a float.
    assert np.abs(after["t"] - expected_us).max() <= 0.5 + 1e-6
    assert all(np.array_equal(before[field], after[field]) for field in "xyp")


def test_bags_give_what_the_files_give_that_they_were_made_of(recorded, tmp_path):
    bag = tmp_path / "flight.bag"
    cam1, cam2 = (load_events(path).events[:50_000] for path in recorded.pair)
    files = tmp_path / "cam1.h5", tmp_path / "cam2.h5"
    for file, events in zip(files, (cam1, cam2), strict=True):
        save_events_h5(file, events, WIDTH, HEIGHT)
    write_bag(bag, {"/cam2/events": mono(cam2), "/cam1/events": arrays(cam1)})
    args = ("--rig", recorded / "rig.yaml", "--method", "event_rate", "--no-denoise")
    forms = (
        files,
        (bag, "--topics", "/cam1/events", "/cam2/events"),
        (bag, bag, "--topics", "cam1/events", "cam2/events"),
        (bag / "cam1/events", bag / "cam2/events"),
        (files[0], bag / "cam2/events"),
    )
    unnamed = {"cam1": "", "cam2": ""}
    found = [answered(tmp_path, *cameras, *args)[1] | unnamed for cameras in forms]
    assert found[1:] == found[:1] * 4


def test_the_rig_that_is_written_gives_the_same_offset_with_its_extrinsics(recorded, tmp_path):
    rig, args = tmp_path / "found.yaml", (*recorded.pair, "--method", "joint")
    written = ("--rig", recorded / "rig.yaml", "--write-rig", rig, "--distance", 7)
    _, found = answered(tmp_path, *args, *written)
    assert found["distance_m"] == 7.0
    T_2_1 = load_rig(rig).T_2_1
    np.testing.assert_array_equal(T_2_1[:3, :3], found["R"])
    np.testing.assert_allclose(T_2_1[:3, 3], 7.0 * np.array(found["t"]), rtol=1e-12)
    assert f"timeshift_cn_cnm1: {found['t_d_s']!r}\n" in rig.read_text()
    known, again = answered(tmp_path, *args, "--rig", rig, "--known-extrinsics")
    assert f"as given in {rig}" in known.stdout
    assert again["method"] == "joint-known"
    assert again["deg_per_percent_of_focals"] == [None, None]  # no pose is estimated
    np.testing.assert_allclose(again["t"], found["t"], atol=1e-12)
    # The known pose is the one that fitted best, so the offset stays, to its deviation.
    assert abs(again["t_d_s"] - found["t_d_s"]) < found["t_d_std_s"]


def test_a_folder_as_it_was_simulated_is_enough(recorded, tmp_path):
    known = ("--method", "ssac", "--known-extrinsics"), "rig_extrinsics.yaml"
    named = ("--method", "ssac-known"), "rig_extrinsics.yaml"
    for method, rig in ((("--method", "event_rate"), "rig.yaml"), known, named):
        _, found = answered(tmp_path, recorded.folder, *method)
        _, by_rig = answered(tmp_path, *recorded.pair, "--rig", recorded / rig, *method)
        assert found == by_rig


@pytest.mark.parametrize("method", ["ssac", "zncc_f"])
def test_an_offset_without_a_deviation_comes_with_no_advice_to_apply_it(method, recorded, tmp_path):
    synced = tmp_path / "synced.h5"
    args = ("--method", method, "--write-synced", synced)
    result, found = answered(tmp_path, recorded.folder, *args)
    assert f"{synced}, by an offset of unknown accuracy\n" in result.stderr
    assert ("denoise" in result.stderr) == (method != "zncc_f")
    note = f"{method} states no standard deviation"
    assert "ms, of unknown accuracy\n" in result.stdout
    assert f"note           {note}" in result.stdout
    assert "subtract" not in result.stdout
    assert found["note"].startswith(note)
    assert found["status"] == "ok"
    assert found["t_d_s"] is not None
    missing = ("t_d_std_s", "covariance")
    if method == "zncc_f":  # what a method does not estimate is null
        missing += ("R", "t", "n_samples", "d_avg_px")
    assert [found[key] for key in missing] == [None] * len(missing)


def test_deviations_of_the_intrinsics_widen_those_of_the_pose(recorded, tmp_path):
    args = (recorded.folder, "--method", "joint", "--no-denoise")
    stds = []
    for focal, centre in (("0", "0"), ("1", "3")):
        options = "--n-samples", 150, "--focal-std", focal, "--centre-std", centre
        result, found = answered(tmp_path, *args, *options)
        assert " pairs of positions used, of 150 sample times\n" in result.stdout
        assert "denoise" not in result.stderr
        stds.append(np.sqrt(np.diag(found["covariance"]))[1:])
    assert np.all(stds[1] > stds[0])


# --- Tracks ---

SCENE, TRACKS_S = make_scene(1, duration_s=10.0), 7.3  # the offset of the tracks
WIDE = 4.0  # deviations: a right answer is further off in 1 of 16,000
NOT_UTF_8 = os.fsdecode(b"M\xfcnchen.csv")


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    return save_pair(tmp_path_factory.mktemp("tracks"), SCENE, TRACKS_S)


def test_two_tracks_of_any_name_are_synchronised_from_nothing_and_no_offset_is_left(pair, tmp_path):
    late, page, one = (tmp_path / name for name in ("synced.csv", "a.html", NOT_UTF_8))
    one.write_bytes((pair / "cam1.csv").read_bytes())
    args = one, pair / "cam2.csv", "--rig", pair / "rig.yaml", "--report", page
    result, found = answered(tmp_path, *args, "--write-synced", late)
    assert "warning" not in result.stderr
    assert r"M\udcfcnchen" in page.read_text()
    assert (found["status"], found["method"]) == ("ok", "joint")
    assert abs(found["t_d_s"] - TRACKS_S) < WIDE * found["t_d_std_s"]
    assert found["t_d_std_s"] < 2e-3  # 0.3 px at 180 px/s: 1.7 ms for each of hundreds of points
    assert rotation_angle_deg(np.array(found["R"]), SCENE.R) < 1.0
    assert angle_deg(np.array(found["t"]), SCENE.t) < 1.0
    again = sync(one, late, pair / "rig.yaml", search="interval")
    assert abs(again.estimate.t_d_s) < WIDE * again.estimate.t_d_std_s


def test_deviations_of_a_track_are_written_as_numbers_above_zero(tmp_path):
    for sigmas_px in ([0.3517, 12.3456], [0.3517, 2e-6]):
        track = PointTrack(np.arange(2.0), np.ones((2, 2)), np.array(sigmas_px))
        save_track(tmp_path / "cam1.csv", track)
        found = load_track(tmp_path / "cam1.csv").sigmas_px
        np.testing.assert_allclose(found, sigmas_px, rtol=5e-4)


def test_tracks_too_short_for_any_offset_leave_no_guess(pair):
    """The answer has a search, but no guess from which a table or the network could start."""
    whole = (load_track(pair / name) for name in ("cam1.csv", "cam2.csv"))
    short = [PointTrack(track.times_s[:7], track.points_px[:7]) for track in whole]
    answer = sync(*short, pair / "rig.yaml").answer
    assert answer.estimate.status == Status.TOO_LITTLE_MOTION
    assert answer.guess is None
    assert "too_little_motion" in Result(answer).summary()


def test_times_that_are_hardly_seconds_are_pointed_out(pair, tmp_path):
    track = load_track(pair / "cam2.csv")
    save_track(tmp_path / "ms.csv", replace(track, times_s=1e3 * track.times_s))
    rig, nowhere = ("--rig", pair / "rig.yaml"), ("--search", 9e6, 9e6 + 1.0)  # keeps the run short
    args = (pair / "cam1.csv", tmp_path / "ms.csv", *rig, *nowhere)
    _, _, err = run("sync", *args, code=NO_ESTIMATE)
    assert f"warning: {tmp_path / 'ms.csv'}: its points are " in err
    assert "give seconds" in err


def test_events_and_a_track_of_events_may_be_mixed_but_of_several_things_with_a_warning(
    recorded, tmp_path
):
    track, two = tmp_path / "cam1.csv", tmp_path / "two.h5"
    options = "--rig", recorded / "rig.yaml", "--out", track
    save_events_h5(two, mixed(flight(4)[0], flight(5)[0])[0], WIDTH, HEIGHT)
    _, _, err = run("track", two, *options)
    assert "two.h5: 2 things move at a time" in err
    assert err.count("warning") == 1
    _, out, err = run("track", recorded.pair[0], *options)
    assert "points from" in out
    assert "warning" not in err
    result = sync(track, recorded.pair[1], recorded / "rig.yaml", "joint")
    assert result.status == "ok"
    assert result.t_d_s == pytest.approx(T_D_S, abs=TOLERANCE_S)  # the same as for two event files


def test_times_cut_off_are_noticed_and_make_the_offset_less_sure(pair, tmp_path):
    track, step_s = load_track(pair / "cam1.csv"), 0.01
    times_s = np.floor(track.times_s / step_s + 1e-9) * step_s
    save_track(tmp_path / "cam1.csv", replace(track, times_s=times_s))
    others = (pair / "cam2.csv", pair / "rig.yaml")
    with pytest.warns(UserWarning, match="all times are whole 10 ms"):
        result = sync(tmp_path / "cam1.csv", *others)
    assert result.estimate.t_d_std_s > step_s / 12**0.5
    assert abs(result.estimate.t_d_s - TRACKS_S) < WIDE * result.estimate.t_d_std_s


# --- Rolling shutters ---

READOUT_S = 0.02


@pytest.fixture(scope="module")
def shuttered(tmp_path_factory):
    """The rig states camera 1's readout but not camera 2's, whose true readout is 0."""
    return save_pair(tmp_path_factory.mktemp("tracks"), SCENE, 0.2, READOUT_S)


def test_figures_show_the_pairs_with_the_readouts_found(shuttered, pair):
    files = shuttered / "cam1.csv", shuttered / "cam2.csv", pair / "rig.yaml"  # without a readout
    result = sync(*files, search="interval", estimate_readout=True)
    shown_px = d_avg_px(result.answer, np.array([result.t_d_s]))
    assert shown_px[0] < 1.1 * result.d_avg_px  # of all pairs, few of which are left out


@pytest.mark.parametrize("asked", [True, False])
def test_a_readout_that_is_not_stated_is_found_or_said_to_be_taken_for_none(shuttered, asked):
    files = (shuttered / name for name in ("cam1.csv", "cam2.csv", "rig.yaml"))
    result = sync(*files, search="interval", estimate_readout=asked)
    report = result.to_dict()
    assert report["readout_s"][0] == READOUT_S  # exact, as the rig says
    if not asked:
        assert report["readout_s"][1] is None
        assert "the rig states no readout_s of camera 2, so shutters" in report["note"]
        return
    assert report["readout_std_s"][0] == 0.0
    assert 0.0 <= report["readout_s"][1] < 4.0 * report["readout_std_s"][1]
    assert "readout        camera 2 " in result.summary()
    assert report["note"] == ""


# --- Three cameras, and the path from two ---


FLOWN = make_flight(3)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Three tracks of one flight, and their rig."""
    folder = tmp_path_factory.mktemp("many")
    size = {"intrinsics": [900.0, 900.0, 480.0, 300.0], "resolution": [960, 600]}
    entry = rig_document(**size, intrinsics_std=[0.0] * 4)["cam0"]
    files = [folder / name for name in ("cam1.csv", "cam2.csv", "cam3.csv", "rig.yaml")]
    for file, seen in zip(files, FLOWN.seen, strict=False):
        save_track(file, PointTrack(seen.times_s, seen.points_px))
    files[3].write_text(yaml.safe_dump({f"cam{k}": entry for k in range(3)}))
    return files


def rms_off_m(file):
    """Return the rms distance [m] of a written path from the true one."""
    path = read_path(file)
    off_m = np.linalg.norm(path.positions_m - FLOWN.path(path.times_s), axis=1)
    return float(np.sqrt(np.mean(off_m**2)))


def test_three_cameras(files, tmp_path):
    *cameras, rig = files
    path_file, rig_file = tmp_path / "path.tum", tmp_path / "rig.yaml"
    outputs = ("--trajectory", path_file, "--write-rig", rig_file, "--distance", FLOWN.distance_m)
    result, found = answered(tmp_path, *cameras, "--rig", rig, *outputs)
    assert "cam3" in result.stdout
    assert [camera["status"] for camera in found["cameras"]] == ["ok"] * 3
    for k, camera in enumerate(found["cameras"][1:], 1):
        true_s = FLOWN.shown_s(k, camera["t_ref_s"])
        # Readouts of frames are unknown, so deviations include 10 ms for them.
        assert abs(camera["t_d_s"] - true_s) < 4.0 * camera["t_d_std_s"]
        assert camera["t_d_std_s"] < 0.02
        knots = zip(*(one.values() for one in camera["clock_knots"]), strict=True)
        stray_ms = 1e3 * np.interp(camera["t_ref_s"], *knots)
        assert f"straight line, from which it strays by {stray_ms:+.2f} ms then" in result.stdout
    assert np.linalg.norm(found["cameras"][1]["t"]) == pytest.approx(FLOWN.distance_m, rel=1e-4)
    cam2, cam3 = found["cameras"][1:]
    rig = load_rig(rig_file, (1, 3))
    np.testing.assert_allclose(rig.T_2_1[:3, :3], cam3["R"], atol=1e-12)  # by way of camera 2
    np.testing.assert_allclose(rig.T_2_1[:3, 3], cam3["t"], atol=1e-9)
    entries = yaml.safe_load(rig_file.read_text()).values()
    shifts_s = [entry.get("timeshift_cn_cnm1", 0.0) for entry in entries]
    # Offsets hold at different times, between which skews of some 100 ppm change them.
    assert shifts_s[1] == pytest.approx(cam2["t_d_s"], abs=1e-3)
    assert sum(shifts_s) == pytest.approx(cam3["t_d_s"], abs=1e-2)
    assert rms_off_m(path_file) < 0.1  # readouts of 5 ms at some 5 m/s, and noise of 9 mm
    assert np.ptp(read_path(path_file).times_s) > 0.7 * DURATION_S  # all three see most of it


def test_pairs_without_a_skew_contradict_no_network_at_epoch_times(files, tmp_path):
    late = []
    for file in files[:3]:
        track = load_track(file)
        late.append(tmp_path / file.name)
        save_track(late[-1], replace(track, times_s=track.times_s - track.times_s[0] + 1.7e9))
    options = ("--method", "ssac", "--search", -1, 1)
    result, found = answered(tmp_path, *late, "--rig", files[-1], *options)
    assert found["status"] == "ok"
    assert len(re.findall(r"ok, t_d [-\d.]+ s$", result.stderr, re.MULTILINE)) == 3  # no deviation
    assert [pair["contradicted_by_s"] for pair in found["pairs"]] == [None] * 3


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


def save_another(path, start_s):
    """Save a track of 3 s of another object, which no offset fits."""
    times_s = start_s + 0.05 * np.arange(60)
    points_px = 300.0 + 100.0 * np.column_stack([np.cos(9.0 * times_s), np.sin(7.0 * times_s)])
    save_track(path, PointTrack(times_s, points_px))
    return path


@pytest.mark.parametrize("n_cameras", [2, 3])
def test_where_nothing_fits_that_is_told_and_no_error_of_the_frame(files, tmp_path, n_cameras):
    rtk, *outputs = (tmp_path / name for name in ("rtk.csv", "path.tum", "found.yaml"))
    write_path(rtk, Path(np.arange(20.0), np.random.default_rng(0).normal(size=(20, 3))))
    strangers = [save_another(tmp_path / f"{k}.csv", 1e3 * k) for k in range(1, n_cameras)]
    options = ("--rtk", rtk, "--trajectory", outputs[0], "--write-rig", outputs[1])
    args = (files[0], *strangers, "--rig", files[-1], "--search", -1, 1)  # they are 1000 s apart
    result, found = answered(tmp_path, *args, *options, code=NO_ESTIMATE)
    for output in outputs:
        assert f"not written: {output}" in result.stderr
        assert not output.exists()
    assert found["status"] != "ok"
    assert "offsets" not in result.stderr
    if n_cameras == 3:  # the options reach every pair
        assert [pair["status"] for pair in found["pairs"]] == ["no_common_time"] * 3


@pytest.mark.parametrize(
    ("option", "why"),
    [("--distance", "cameras 1 and 2 are not"), ("--positions", ".*: positions of at least 3 cam")],
)
def test_a_camera_that_fits_nowhere_gets_no_place_and_no_scale_rests_on_it(
    files, tmp_path, option, why
):
    late, stated, rig = (tmp_path / name for name in ("late.csv", "positions.csv", "rig.yaml"))
    save_another(late, 1000.0)
    stated.write_text('camera,x_m,y_m,z_m\n"1",0,0,0\n2,9,0,0\n3,0,9,0\n')
    near = "--search", *(FLOWN.clocks[1].t_d_s + np.array([-1.0, 1.0]))
    options = ("--rig", files[-1], "--write-rig", rig, *near)
    scale = (option, 7 if option == "--distance" else stated)
    args = (files[0], late, files[1], *options, *scale)
    result, found = answered(tmp_path, *args, code=NO_ESTIMATE)
    assert [camera["status"] for camera in found["cameras"]] == ["ok", "no_match", "ok"]
    assert re.search(r"late +no_match", result.stdout)
    assert "placed; no pose with the others: camera 2 (no_match)\n" in result.stderr
    assert load_rig(rig, (1, 2)).T_2_1 is None
    written = load_rig(rig, (1, 3))  # the camera between has no pose
    np.testing.assert_allclose(written.T_2_1[:3, :3], found["cameras"][2]["R"])
    assert not written.in_metres
    assert np.linalg.norm(written.T_2_1[:3, 3]) == pytest.approx(1.0)
    assert re.match(f"{option} is not used: {why}", found["note"])
    assert found["note"] in result.stdout
    assert found["scale_is_known"] is False


def test_rtk_sets_the_scale_of_path_and_rig_or_contradicts_and_costs_them(files, tmp_path):
    names = "rtk.csv", "path.csv", "rig.yaml", "page.html"
    rtk, out, rig, page = (tmp_path / name for name in names)
    outputs = ("--trajectory", out, "--write-rig", rig, "--report", page)
    args = (*files[:2], "--rig", files[-1], "--rtk", rtk, *outputs)
    write_path(rtk, Path(0.1 * np.arange(150), np.random.default_rng(0).normal(size=(150, 3))))
    result, found = answered(tmp_path, *args, code=BAD_INPUT)
    assert re.search(f"error: {rtk}.*flight", result.stderr)
    assert found["status"] == "ok"
    assert [one.exists() for one in (out, rig, page)] == [False, False, True]
    times_s = np.arange(0.5, DURATION_S - 0.5, 0.1)
    write_path(rtk, Path(times_s, FLOWN.path(times_s)))
    result, _ = answered(tmp_path, *args)
    assert rms_off_m(out) < 0.15  # more than with three cameras, as one view is missing
    assert read_path(out).deviations_m.shape == read_path(out).positions_m.shape
    assert "which hold from" in result.stderr
    assert f"wrote {rig}, lengths in metres" in result.stderr
    found = load_rig(rig)
    assert found.in_metres
    assert np.linalg.norm(found.T_2_1[:3, 3]) == pytest.approx(FLOWN.distance_m, rel=0.01)


@pytest.mark.parametrize("unit", ["m", "first_baseline"])
def test_the_path_of_known_extrinsics_has_their_scale_if_it_is_told(files, tmp_path, unit):
    R, t_m = FLOWN.poses[1]
    rig, out, again = yaml.safe_load(files[-1].read_text()), tmp_path / "a.csv", tmp_path / "b.yaml"
    T_2_1 = np.vstack([np.column_stack([R, t_m]), [0.0, 0.0, 0.0, 1.0]])
    rig["cam1"] |= {"T_cn_cnm1": T_2_1.tolist(), "length_unit": unit}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    options = ("--rig", tmp_path / "rig.yaml", "--known-extrinsics", "--trajectory", out)
    result, _ = answered(tmp_path, *files[:2], *options, "--write-rig", again)
    if unit == "first_baseline":
        T_2_1[:3, 3] /= FLOWN.distance_m
        assert result.stderr.count("in distances of the first two cameras placed") == 2
    else:
        assert rms_off_m(out) < 0.03  # 0.15 where the pose is adjusted with the path
    np.testing.assert_allclose(load_rig(again).T_2_1, T_2_1, atol=1e-12)
    assert load_rig(again).in_metres == (unit == "m")
