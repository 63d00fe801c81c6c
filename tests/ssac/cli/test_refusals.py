"""`ssac sync` refuses input and options that it cannot use in one line, and writes nothing."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from ssac import load_events
from ssac.cli.exits import BAD_INPUT, NO_ESTIMATE
from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import load_track, save_track
from tests.ssac.bags import arrays, mono, write_bag
from tests.ssac.cluttered import noise
from tests.ssac.command import run
from tests.ssac.synthetic import HEIGHT, WIDTH, make_scene
from tests.ssac.tracks import rig_document, save_pair

HEAD = "t_s,x_px,y_px\n"
TEXTS = {
    "no_header": ("{rows}", "first line must name the columns"),
    "unsorted": (HEAD + "1,2,3\n0,1,2\n", "must be in time order"),
    "twice": (HEAD + "0,1,2\n0,1,2\n", "must be in time order"),
    "nan": (HEAD + "-1,nan,3\n{rows}", "no finite number"),
    "text": (HEAD + "-1,here,3\n{rows}", "must be numbers"),
    "empty_field": (HEAD + "-1,,3\n{rows}", "no finite number"),
    "commas": (HEAD + "-1,0,100,5,90,25\n{rows}", "write decimals with a point"),
    "outside": (HEAD + "-1,346,3\n{rows}", "the image is 346 x 260 px"),
    "nothing": (HEAD, "there are no points"),
}
"""Texts of bad track files, with the {rows} of a good one, and the error of each."""


@pytest.fixture(scope="module")
def folder(recorded, tmp_path_factory):
    """Events of all kinds, and in `tracks` tracks of all kinds."""
    folder = tmp_path_factory.mktemp("refused")
    for name in ("cam1.h5", "cam2.h5", "rig.yaml"):
        (folder / name).write_bytes((recorded / name).read_bytes())
    (folder / "folder.h5").mkdir()
    (folder / "zero.h5").write_bytes(b"")
    (folder / "isolated.txt").write_text(f"{WIDTH} {HEIGHT}\n0.1 1 1 1\n0.2 1 1 1\n")
    events = load_events(recorded / "cam1.h5").events
    for k in range(2):
        alone = noise(WIDTH, HEIGHT, 5.0, 500_000, k)
        save_events_h5(folder / f"noise{k}.h5", alone, WIDTH, HEIGHT)
    topics = {"/left": arrays(events[:300]), "/right": mono(events[:300])}
    write_bag(folder / "both.bag", topics)
    write_bag(folder / "one.bag", {"/left": topics["/left"]})
    (folder / "where.csv").write_text("camera,x_m,y_m,z_m\n1,0,0,0\n2,1,0,0\n3,0,1,0\n")
    tracks = folder / "tracks"
    tracks.mkdir()
    save_pair(tracks, make_scene(1), 7.3)
    track = load_track(tracks / "cam1.csv")
    _, rows = (tracks / "cam1.csv").read_text().split("\n", 1)
    for name, (text, _) in TEXTS.items():
        (tracks / f"{name}.csv").write_text(text.format(rows=rows))
    (tracks / "no_attitude.csv").write_text("t_s,x_m,y_m,z_m\n0,1,2,3\n")
    still = "".join(f"{t_s},1,2,3\n" for t_s in range(20))
    (tracks / "still.csv").write_text(f"t_s,x_m,y_m,z_m\n{still}")
    (tracks / "wide-2.csv").write_text("t_s,x_m,y_m,z_m\n0,1,2,3\n")
    (tracks / "cameras_twice.csv").write_text("camera,x_m,y_m,z_m\n1,0,0,0\n1,1,0,0\n")
    poles = "camera,x_m,y_m,z_m\n1,0,0,5\n2,50,0.02,5\n3,100,0,5.01\n"
    (tracks / "row_of_poles.csv").write_text(poles)
    for name, times_s in {
        "whole_us": np.rint(1e6 * track.times_s),
        "whole_ms": np.rint(1e3 * track.times_s),
        "wraps": track.times_s % (2**24 * 1e-6),
        "third": track.times_s,
    }.items():
        save_track(tracks / f"{name}.csv", replace(track, times_s=times_s))
    slow, wrong = rig_document(readout_s=0.05), rig_document(readout_s=33)
    three = {**rig_document(), "cam2": rig_document()["cam0"]}
    for name, rig in {"slow": slow, "wrong": wrong, "three": three}.items():
        (tracks / f"{name}.yaml").write_text(yaml.safe_dump(rig))
    return folder


EVENTS = [
    ("folder.h5", "folder.h5: is a folder: give a file of one camera's events"),
    ("cam2.h5", "cam2.h5: given for both cameras"),
    ("cam1.h5 --search -1e9 1e9", "--search: expected a smaller and a larger offset"),
    ("cam1.h5 --search 0 4000", "at most 3600 seconds apart, got 0 4000"),
    ("noise0.h5 --method zncc_f", "noise0.h5: zncc_f compares intensity frames"),
    ("cam1.h5 --clock quartz", "--clock: expected auto or affine or pieces, got quartz"),
    ("cam1.h5 --clock pieces --skew-prior 0", "its prior must be above 0 ppm"),
    ("cam1.h5 --json no/such/out.json", "out.json: not a file in a folder that exists"),
    ("cam1.h5 --write-synced out.raw", "out.raw: cannot write the extension '.raw'"),
    ("cam1.h5 --write-synced cam1.h5", "cam1.h5: is one of the inputs"),
    ("cam1.h5 --plot cam1.h5", "cam1.h5: exists and is no folder"),
    ("cam1.h5 --plot fig.JPG", "fig.JPG: cannot write the extension '.JPG': name a folder, or a"),
    ("cam1.h5 --plot cam1.h5/figures", "cam1.h5 is a file: name a folder"),
    ("cam1.h5 --plot a --json a", "--plot: a is named for a file too"),
    ("cam1.h5 --plot a.html --report a.html", "--plot: a.html is named for a file too"),
    ("cam1.h5 --json a.txt --write-synced a.txt", "a.txt: is named for two outputs"),
    ("cam1.h5 --distance 3 --write-rig rig.txt", "rig.txt: cannot write the extension '.txt'"),
    *(
        (f"cam1.h5 --method {method} {option} {value}", f"{option}: is of poses or of .* {method}")
        for method, option, value in [
            ("event_rate", "--write-rig", "out.yaml"),
            ("zncc_e", "--trajectory", "out.yaml"),
            ("zncc_e", "--distance", "3"),
            ("zncc_f", "--focal-std", "1"),
            ("event_rate", "--clock", "pieces"),
            ("zncc_e", "--skew-prior", "0"),
        ]
    ),
    ("cam1.h5 --write-rig rig.yaml", "rig.yaml: is one of the inputs"),
    ("cam1.h5 --report page", "page: cannot write the extension '': use one of .htm, .html"),
    ("cam1.h5 --positions where.csv", "--positions: needs three cameras or more"),
    ("cam1.h5 --positions zero.h5", "zero.h5: the first line must be camera,x_m,y_m,z_m"),
    ("cam1.h5 --positions cam1.h5", "cam1.h5: not a text file of positions"),
    ("cam1.h5 --topics /left /right", "--topics: expected one ROS bag or two, got cam1.h5 cam2.h5"),
    ("both.bag/left --json both.bag", "both.bag: is one of the inputs"),
    ("cam1.h5 --search -1", "Option '--search' requires 2 arguments; see .*ssac.cli sync --help$"),
    ("cam1.h5 --n-samples many", "Invalid value for '--n-samples'"),
]

TRACKS = [
    *((f"{name}.csv", f"{name}.csv.*{message}") for name, (_, message) in TEXTS.items()),
    *((f"whole_{unit}.csv", "give t_s in seconds") for unit in ("us", "ms")),
    ("wraps.csv", "counter of 24 bits"),
    ("cam1.csv --rig slow.yaml", "readout_s is 50 ms, but frames follow each other in"),
    ("cam1.csv --rig wrong.yaml", "give seconds"),
    ("cam1.csv --search-all --search -1 1", "--search: not with"),
    ("cam1.csv --rate-range 2 1", r"rates \(--rate-range\) must be .* in ascending order"),
    ("cam1.csv --rate-range -1 2", "rates must be positive, .*: correct --rate-range"),
    ("cam1.csv --estimate-readout --method ssac", "takes shutters as the rig says: use joint"),
    *(
        (f"cam1.csv --method {method}", "is a track of points; .*use joint")
        for method in ("tangency", "zncc_e", "zncc_f", "event_rate")
    ),
]

MANY = [
    ("third.csv --lever-arm 0 0 1", "give --rtk too"),
    ("third.csv --distance 3 --rtk rtk.csv", "--distance: not with --rtk"),
    ("third.csv --cameras 2 3", "--cameras: is for two cameras"),
    ("third.csv --write-synced synced.csv", "--write-synced: is for two cameras"),
    ("third.csv --known-extrinsics", "--known-extrinsics: is for two cameras"),
    ("third.csv --estimate-readout", "--estimate-readout: is for two cameras"),
    ("third.csv --method joint-known", "joint-known: holds the rig's pose, .*, such as joint$"),
    ("third.csv --method zncc_f", "zncc_f: finds the offset alone, .*, such as joint$"),
    ("third.csv --lever-arm 0 0 1 --rtk no_attitude.csv", "no_attitude.csv, .* no attitude"),
    (
        "third.csv --rtk no_attitude.csv",
        "no_attitude.csv, .* has 1 points, and at least 20 are needed",
    ),
    ("third.csv --rtk still.csv", "still.csv, .* truth stands still: give a path that moves"),
    ("third.csv --positions cameras_twice.csv", "camera 1 is there twice"),
    ("third.csv --positions row_of_poles.csv", "stand nearly on a line"),
    *(
        (f"third.csv --rtk no_attitude.csv {option} {name}", f"{name}: is one of the inputs")
        for option in ("--json", "--trajectory")
        for name in ("third.csv", "no_attitude.csv")
    ),
    ("third.csv --plot a.png --json a-1-3.png", "a-1-3.png: is named for two outputs"),
    ("third.csv text.csv --trajectory a.csv --json a-2.csv", "a-2.csv: is named for two outputs"),
    ("third.csv text.csv --trajectory wide.csv --rtk wide-2.csv", "wide-2.csv: is one of the inp"),
    ("third.csv --rig rig.yaml", "there is no cam2 for camera 3"),
    ("cam1.csv", "given for cameras 1 and 3"),
]

ONE = [
    ("cam1.h5", "cam1.h5: expected two cameras, or a folder with cam1.h5"),
    ("nowhere", "nowhere: there is no such file"),
    ("one.bag", "one.bag: one camera's topic, /left: give the other camera's file too"),
    ("both.bag", "2 topics, .*, as both.bag/left, or both cameras' with --topics /left /right$"),
    ("both.bag --topics /left /left", "both.bag/left: given for both cameras"),
]

CASES = [
    *((".", "{} cam2.h5", "rig.yaml", *case) for case in EVENTS),
    *(("tracks", "{} cam2.csv", "rig.yaml", *case) for case in TRACKS),
    *(("tracks", "cam1.csv cam2.csv {}", "three.yaml", *case) for case in MANY),
    (".", "cam1.h5 {}", None, "cam2.h5", "Missing option '--rig'"),
    *((".", "{}", "rig.yaml", *case) for case in ONE),
    (".", "one.bag {}", "rig.yaml", "one.bag", "one.bag: given for both cameras"),
]


@pytest.mark.parametrize(("where", "form", "rig", "args", "message"), CASES)
def test_bad_input_is_refused_in_one_line(where, form, rig, args, message, folder, monkeypatch):
    monkeypatch.chdir(folder / where)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    first, _, more = args.partition(" ")
    rig_of_it = () if rig is None or "--rig" in more else ("--rig", rig)
    cameras = form.format(first).split()
    result = run("sync", *cameras, *rig_of_it, *more.split(), code=BAD_INPUT)
    assert result.stdout == ""
    *progress, last = result.stderr.splitlines()
    assert not any("error" in line for line in progress)
    assert re.search(f"^error: .*{message}", last)
    if form.count("cam") > 1:  # with many cameras, before any pair is looked at
        assert not progress
    assert before == {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ("isolated.txt cam2.h5", "camera 1: denoising left 0 of 2 events: check .*--no-denoise"),
        ("noise0.h5 noise1.h5", "no_motion: of .* events of camera 1 too few keep together"),
    ],
)
def test_data_that_give_nothing_are_a_status_with_advice(args, message, folder, monkeypatch):
    monkeypatch.chdir(folder)
    options = "--rig", "rig.yaml", "--write-synced", "synced.h5"
    result = run("sync", *args.split(), *options, code=NO_ESTIMATE)
    assert re.match(f"no estimate    .*{message}", result.stdout)
    assert "error" not in result.stderr
    assert "search  " not in result.stderr
    assert re.search(r"not written: \S*synced\.h5, since", result.stderr)
    assert not (folder / "synced.h5").exists()


def test_one_camera_of_a_bag_is_not_sent_to_an_option_of_two(folder, tmp_path):
    args = folder / "both.bag", "--rig", folder / "rig.yaml", "--out", tmp_path / "track.csv"
    _, _, err = run("track", *args, code=BAD_INPUT)
    assert err.endswith(f"name one behind the bag, as {folder}/both.bag/left\n")
