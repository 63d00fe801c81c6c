"""Tests that a damaged file is refused in one line, read whole, or read with a warning.

`make fuzz` tries thousands of damages of each kind, other runs a few. A crash of a compiled reader
ends the whole run.
"""

import re
import resource
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh.creation import box

from experiments.lab.grid import CONFIGS, load_config
from experiments.lab.recorded import check_mesh, load_truth
from sim.errors import SimError
from sim.scene.trajectory import trajectory_from_csv
from ssac.errors import SsacError
from ssac.files.damage import STRICT, Reading
from ssac.files.event_files import load_events
from ssac.files.rigs import load_rig
from ssac.files.track_files import load_track, save_track
from tests.experiments.reported import write_truth
from tests.recorded import kalibr_with_pose
from tests.ssac.files.test_event_files import FORMS, random_events
from tests.ssac.synthetic import make_scene
from tests.ssac.tracks import frame_track

MAX_SILENT = 0.005
"""Largest share of damages that may lose events unseen, as a changed bit can make another event."""

MAX_BYTES = 2 << 30
"""Memory that the tests may use, beyond what the process used at the start."""

WITHOUT_END = (".raw", ".dat", ".es", ".txt", ".csv")  # if cut, a shorter recording
TEXT = (".txt", ".csv", ".yaml", ".toml", ".obj", ".json")
WORD = re.compile(rb"[^\s,:=\[\]{}]+")
TWO_LINES = re.compile(rb"(.+\n?)(.*\n?)")
NASTY_WORDS = (
    b"nan", b"inf", b"-inf", b"-1", b"0", b"1e400", b"9" * 30, b"9" * 5000, b"4294967296", b"",
    b"[]", b"{}", b"'", b'"', b"\0", b"\xff", b"true", b"null", b"~", b"1e-3", b"0x10", b"[[1]]",
    b"<script>", b"../../etc/passwd", b"!!python/object/apply:os.getcwd []", b"&a [*a]", b"*b",
    b"[" * 3000, b"1979-05-27", b"\xef\xbb\xbf", b"=", b":", b"\n", b"\r", b"\t", b"#",
)  # fmt: skip
IN_HDF5 = ("events", "events/t", "events/x", "events/y", "events/p", "CD/events", "t_offset")
IN_PLACE_OF_DATA = (
    None, 5, "", np.nan, 1 << 40, np.full(3000, np.nan), np.array(["a"] * 3000, "S3"),
    np.zeros((3000, 2), np.int64), h5py.Empty("i8"), h5py.SoftLink("/events"),
    h5py.ExternalLink("elsewhere.h5", "/x"), h5py.VirtualLayout((3000,), np.int64),
)  # fmt: skip
DECLARED = (10**6, 4 * 10**8, 4 * 10**9, 10**15)  # events, of which none is stored
SIZES = (
    "346,260", "wide", b"\xff\xfe", "", "1e9x1e9", -1, 0, 1 << 40, 3.7, np.nan, np.inf, [346, 260],
    np.zeros((2, 2)), h5py.Empty("f"), "346x260x3", "<script>",
)  # fmt: skip


@st.composite
def damaged(draw, whole, is_text):
    """Change a copy of a file: its first 1000 bytes, with any headers, as often as the rest."""
    if is_text and draw(st.booleans()):
        if draw(st.booleans()):
            word = draw(st.sampled_from([*WORD.finditer(whole)]))
            return whole[: word.start()] + draw(st.sampled_from(NASTY_WORDS)) + whole[word.end() :]
        lines = draw(st.sampled_from([*TWO_LINES.finditer(whole)]))
        one, other = lines.groups()
        instead = draw(st.sampled_from((other, one + one + other, other + one)))
        return whole[: lines.start()] + instead + whole[lines.end() :]
    n = len(whole)
    places = st.integers(0, min(n, 1000) - 1) | st.integers(0, n - 1)
    at = draw(places)
    end = at + draw(st.integers(1, max(1, min(4096, n // 5))))
    few = draw(st.sampled_from((b"\0", b"\xff")) | st.binary(min_size=1, max_size=16))
    flipped = bytearray(whole)
    for place, bit in draw(st.lists(st.tuples(places, st.integers(0, 7)), min_size=1, max_size=8)):
        flipped[place] ^= 1 << bit
    changed = (
        bytes(flipped),
        whole[:at] + few + whole[at:],
        whole[:at] + whole[at + len(few) :],
        whole[:at] + (4096 * few)[: len(whole[at:end])] + whole[end:],
        whole[:end] + whole[at:],
        whole[: max(at, 1)],
    )
    return draw(st.sampled_from(changed))


def restructure(draw, path):
    """Replace a dataset of an HDF5 file, or its sensor size, by something else."""
    with h5py.File(path, "a") as file:
        name = draw(st.sampled_from([name for name in IN_HDF5 if name in file]))
        what = draw(st.sampled_from(("size", "data", "declared")))
        if what == "size":
            key = draw(st.sampled_from(("geometry", "width", "height")))
            file.attrs[key] = draw(st.sampled_from(SIZES))
            return
        dtype = getattr(file[name], "dtype", np.int64)
        del file[name]
        if what == "declared":
            chunks = draw(st.sampled_from((None, (100_000,))))
            file.create_dataset(name, (draw(st.sampled_from(DECLARED)),), dtype, chunks=chunks)
        elif isinstance(value := draw(st.sampled_from(IN_PLACE_OF_DATA)), h5py.VirtualLayout):
            file.create_virtual_dataset(name, value)
        elif value is not None:
            file[name] = value


SCENE = make_scene(0, duration_s=10.0)
FLIGHT = "t,x,y,z,qx,qy,qz,qw\n" + "".join(
    f"{0.1 * k:.1f},{0.1 * k:.1f},0.5,1.0,0,0,0,1\n" for k in range(40)
)


def text(content):
    return lambda path: path.write_text(content, encoding="utf-8")


# How each file is written and used; the use returns the number of points, or anything else.
OTHERS = {
    "track.csv": (
        lambda path: save_track(path, frame_track(SCENE, 1, 25.0)),
        lambda path: len(load_track(path)),
    ),
    "rig.yaml": (text(kalibr_with_pose(SCENE)), load_rig),
    "flight.csv": (text(FLIGHT), trajectory_from_csv),
    "grid.toml": (text((CONFIGS / "ablation_window.toml").read_text("utf-8")), load_config),
    "drone.obj": (lambda path: box().export(path), check_mesh),
    "truth.json": (
        lambda path: write_truth(path, SCENE, 250),
        lambda path: load_truth(path.parent),
    ),
}


@pytest.fixture
def within_memory():
    before = resource.getrlimit(resource.RLIMIT_AS)
    n_pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = n_pages * resource.getpagesize() + MAX_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.usefixtures("within_memory")
@pytest.mark.parametrize("name", [*FORMS, *OTHERS])
def test_a_damaged_file_is_refused_in_one_line_or_loses_nothing_unsaid(name, tmp_path, capfd):
    path = tmp_path / name
    write, use = OTHERS.get(name, (lambda path: FORMS[name](path, random_events()), None))
    write(path)

    def n_used(reading=STRICT):
        if use:
            return use(path)
        events = load_events(path, reading).events
        assert np.all(np.diff(events["t"]) >= 0)
        assert events["p"].max() <= 1
        return len(events)

    whole, n_whole = path.read_bytes(), n_used()
    is_text = path.suffix in TEXT
    readings = st.sampled_from((STRICT, STRICT, Reading(allow_damaged=True, sort=True)))
    is_silent = []

    @given(st.data(), readings)
    def law(data, reading):
        path.write_bytes(whole)
        if path.suffix in (".h5", ".hdf5") and data.draw(st.booleans()):
            restructure(data.draw, path)
        else:
            path.write_bytes(data.draw(damaged(whole, is_text)))
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                n = n_used(reading)
            except (SimError, SsacError) as error:
                is_silent.append(False)
                assert re.fullmatch(f".*{re.escape(str(path))}.*", str(error))  # noqa: PT017 - a line
                assert not re.search("MemoryError|Unable to allocate", str(error))  # noqa: PT017
                return
        is_cut = name.endswith(WITHOUT_END) and whole.startswith(path.read_bytes())
        fewer = isinstance(n, int) and n < 0.99 * n_whole
        is_silent.append(fewer and not said and not is_cut)

    law()
    assert sum(is_silent) <= 1 + MAX_SILENT * len(is_silent)  # one may be chance
    assert not capfd.readouterr().err
