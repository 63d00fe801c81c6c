"""`ssac sync` on input and options that it cannot use: one line each."""

import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from ssac.cli.exits import BAD_INPUT, NO_ESTIMATE
from ssac.files.event_files import load_events
from ssac.files.hdf5 import save_events_h5
from ssac.files.text import save_events_text
from tests.recorded import empty_events
from tests.ssac.command import run_sync
from tests.ssac.synthetic import HEIGHT, WIDTH, make_events


def make_bad_inputs(recorded, folder: Path):
    """File names of camera 1's events and the rig, or options, and what the error must say."""
    (folder / "folder.h5").mkdir()
    (folder / "zero.h5").write_bytes(b"")
    (folder / "truncated.h5").write_bytes((recorded / "cam1.h5").read_bytes()[:50_000])
    (folder / "events.foo").write_bytes(b"1")
    save_events_h5(folder / "no_events.h5", empty_events(), WIDTH, HEIGHT)
    (folder / "unsorted.txt").write_text(f"{WIDTH} {HEIGHT}\n0.2 1 1 1\n0.1 1 1 1\n")
    (folder / "outside.txt").write_text("0.1 400 1 1\n0.2 1 1 1\n")
    (folder / "isolated.txt").write_text(f"{WIDTH} {HEIGHT}\n0.1 1 1 1\n0.2 1 1 1\n")
    events = load_events(recorded / "cam1.h5").events
    save_events_text(folder / "sparse.txt", events[::8], WIDTH, HEIGHT)
    late = events.copy()
    late["t"] += 60_000_000
    save_events_h5(folder / "late.h5", late, WIDTH, HEIGHT)
    rig = (recorded / "rig.yaml").read_text()
    (folder / "large.yaml").write_text(rig.replace(f"[{WIDTH}, {HEIGHT}]", "[640, 480]"))
    copied = load_events(recorded / "cam2.h5").events
    copied["t"] += 20_000  # another clock makes no other camera of it
    save_events_h5(folder / "copy.h5", copied, WIDTH, HEIGHT)
    still = np.array([0.3, 0.2, 5.1])
    at_rest = replace(recorded.scene, path=lambda times_s: np.tile(still, (len(times_s), 1)))
    for k, events in enumerate(make_events(at_rest, 0, size_m=0.4), start=1):
        save_events_h5(folder / f"still{k}.h5", events, WIDTH, HEIGHT)
    (folder / "where.csv").write_text("camera,x_m,y_m,z_m\n1,0,0,0\n2,1,0,0\n")
    (folder / "nan.yaml").write_text(rig.replace("173.0", ".nan"))


BAD_INPUTS = [
    (("missing.h5",), "missing.h5: there is no such file"),
    (("zero.h5",), "zero.h5: the file is empty"),
    (("truncated.h5",), "truncated.h5: not a readable HDF5 file"),
    (("folder.h5",), "folder.h5: is a folder: give a file of one camera's events"),
    (("events.foo",), "events.foo: unknown extension '.foo': use one of"),
    (("no_events.h5",), "no_events.h5: there are no events"),
    (("unsorted.txt",), "unsorted.txt: events must be sorted by time"),
    (("outside.txt",), "outside.txt with camera 1 of .*: the sensor is 346 x 260 px"),
    (("cam2.h5",), "cam2.h5: given for both cameras"),
    (("copy.h5",), "copy.h5 and cam2.h5 hold the same points: one is a copy of the other"),
    (("cam1.h5", "--search", "-1e9", "1e9"), "--search: expected a smaller and a larger offset"),
    (("cam1.h5", "--n-samples", "100000000"), "--n-samples: expected 20 to 100000, got 1000"),
    (("cam1.h5", "--rig", "large.yaml"), "large.yaml is calibrated at 640 x 480 px, but .*cam1.h5"),
    (("cam1.h5", "--rig", "nan.yaml"), "nan.yaml, cam0, intrinsics: expected 4 finite numbers"),
    (("cam1.h5", "--rig", "cam1.h5"), "cam1.h5: unknown extension '.h5' of a rig"),
    (("cam1.h5", "--known-extrinsics"), "rig.yaml: tangency-known needs the extrinsics"),
    (("cam1.h5", "--method", "scac"), "unknown method 'scac': use one of ssac"),
    (("events_only.h5", "--method", "zncc_f"), "events_only.h5: zncc_f compares intensity frames"),
    (("cam1.h5", "--search", "1", "-1"), "--search: expected a smaller and a larger offset"),
    (("cam1.h5", "--search", "0", "nan"), "--search: expected a smaller and a larger offset"),
    (("cam1.h5", "--skew-prior", "-1"), "--skew-prior: expected 0 to 100000 ppm, got -1"),
    (("cam1.h5", "--clock", "quartz"), "--clock: expected auto or affine or pieces, got quartz"),
    (("cam1.h5", "--clock", "pieces", "--skew-prior", "0"), "its prior must be above 0 ppm"),
    (("cam1.h5", "--search", "0", "4000"), "at most 3600 seconds apart, got 0 4000"),
    (("cam1.h5", "--n-samples", "0"), "--n-samples: expected 20 to 100000, got 0"),
    (("cam1.h5", "--half-window", "20"), "--half-window: expected 0.001 to 0.25 seconds, got 20"),
    (("cam1.h5", "--half-window", "nan"), "--half-window: expected 0.001 to 0.25 seconds"),
    (("cam1.h5", "--n-min", "-3"), "--n-min: expected 1 to 100000, got -3"),
    (("cam1.h5", "--json", "no/such/out.json"), "out.json: not a file in a folder that exists"),
    (("cam1.h5", "--write-synced", "out.raw"), "out.raw: cannot write the extension '.raw'"),
    (("cam1.h5", "--write-synced", "cam1.h5"), "cam1.h5: is one of the inputs"),
    (("cam1.h5", "--plot", "cam1.h5"), "cam1.h5: exists and is no folder"),
    (("cam1.h5", "--plot", "cam1.h5/figures"), "cam1.h5 is a file: name a folder"),
    (("cam1.h5", "--json", "a.txt", "--write-synced", "a.txt"), "a.txt: is named for two outputs"),
    (("cam1.h5", "--json", "a.txt", "--trajectory", "a.txt"), "a.txt: is named for two outputs"),
    (("cam1.h5", "--distance", "3"), "--distance: is for the object's path: give --trajectory too"),
    (("cam1.h5", "--positions", "where.csv"), "--positions: needs three cameras or more"),
    (("cam1.h5", "--positions", "zero.h5"), "zero.h5: the first line must be camera,x_m,y_m,z_m"),
    (("cam1.h5", "--positions", "cam1.h5"), "cam1.h5: not a text file of positions"),
]


NOTHING_TO_FIND = [
    (("isolated.txt",), "camera 1: denoising left 0 of 2 events: check that .*--no-denoise"),
    (("sparse.txt", "--n-min", "200"), "camera 1: no window of 40 ms holds 200 events.*--n-min"),
    (("late.h5", "--search", "-1", "1"), r"camera 1 .60.* have no common time .* --search -6.*"),
    (("late.h5", "--search", "-1", "1", "--method", "ssac"), r"no common time .* --search -6.*"),
    (("still1.h5",), "no_motion: in camera 1 the object moves by .*: it is at rest"),
    (("still1.h5", "--search-all"), "no_motion: in camera 1 the object moves by .*: it is at rest"),
]


@pytest.fixture(scope="module")
def bad_folder(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    for name in ("cam1.h5", "cam2.h5", "rig.yaml"):
        (folder / name).write_bytes((recorded / name).read_bytes())
    (folder / "events_only.h5").write_bytes((recorded / "cam1.h5").read_bytes())
    with h5py.File(folder / "events_only.h5", "a") as file:
        del file["frames"]
    make_bad_inputs(recorded, folder)
    return folder


@pytest.mark.parametrize(("args", "message"), BAD_INPUTS, ids=lambda value: " ".join(value))
def test_bad_input_is_refused_in_one_line(args, message, bad_folder, monkeypatch):
    monkeypatch.chdir(bad_folder)
    before = {path.name: path.stat().st_mtime_ns for path in bad_folder.iterdir()}
    rig = () if "--rig" in args else ("--rig", "rig.yaml")
    result = run_sync(args[0], "cam2.h5", *args[1:], *rig)
    assert result.exit_code == BAD_INPUT
    assert result.stdout == ""
    *progress, last = result.stderr.splitlines()
    assert not any("error" in line for line in progress)
    assert last.startswith("error: ")
    with pytest.raises(ValueError, match=message):
        raise ValueError(last)
    assert before == {path.name: path.stat().st_mtime_ns for path in bad_folder.iterdir()}


@pytest.mark.parametrize(("args", "message"), NOTHING_TO_FIND, ids=lambda value: " ".join(value))
def test_data_that_give_nothing_are_a_status_with_advice(args, message, bad_folder, monkeypatch):
    monkeypatch.chdir(bad_folder)
    result = run_sync(args[0], "cam2.h5", *args[1:], "--rig", "rig.yaml")
    assert result.exit_code == NO_ESTIMATE, result.stderr
    first, *_ = result.stdout.splitlines()
    assert first.startswith("no estimate    ")
    assert re.search(message, first)
    assert "error" not in result.stderr


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((), "Missing option '--rig'"),
        (("--search", "-1"), "Option '--search' requires 2 arguments"),
        (("--n-samples", "many"), "Invalid value for '--n-samples'"),
    ],
)
def test_bad_usage_is_refused_in_one_line(args, message, recorded):
    rig = ("--rig", recorded / "rig.yaml") if args else ()
    result = run_sync(*recorded.pair, *rig, *args)
    assert result.exit_code == BAD_INPUT
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"error: {message}")
    assert line.endswith("; see python -m ssac.cli sync --help")
