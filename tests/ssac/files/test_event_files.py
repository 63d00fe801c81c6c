import os
import subprocess
import sys
import tracemalloc
import warnings

import faery
import h5py
import hdf5plugin
import numpy as np
import pytest
from faery.file_encoder import events_to_file

from ssac.clock import Clock
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, EventFile, events_from_arrays
from ssac.files import hdf5
from ssac.files.event_files import (
    load_events,
    write_synced,
)
from ssac.files.hdf5 import save_events_h5
from ssac.files.text import save_events_text

WIDTH, HEIGHT = 346, 260
OFFSET_US = 53_217
"""The offset between the two cameras of a round trip; it must come back to the microsecond."""


def _random_events(n=2000, first_us=20_000_000, seed=0):
    """Events over a second, starting after EVT3's 24-bit clock has overflowed once."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, 1_000_000, n)) + first_us
    return events_from_arrays(
        t, rng.integers(0, WIDTH, n), rng.integers(0, HEIGHT, n), rng.integers(0, 2, n)
    )


def _two_cameras():
    cam1 = _random_events()
    cam2 = cam1.copy()
    cam2["t"] += OFFSET_US
    return cam1, cam2


def _write_h5(path, events):
    save_events_h5(path, events, WIDTH, HEIGHT)


def _write_text(path, events):
    save_events_text(path, events, WIDTH, HEIGHT)


def _write_faery(version=None, zero_t0=True):
    def write(path, events):
        events_to_file(
            iter([events.astype(faery.EVENTS_DTYPE)]),
            path,
            dimensions=(WIDTH, HEIGHT),
            version=version,
            zero_t0=zero_t0,
        )

    return write


def _write_evt2_as_a_camera_does(path, events):
    """EVT2 words with absolute times: a TIME_HIGH (bits 6 to 33 of t) before each event."""
    words = []
    for t, x, y, p in events.tolist():
        words.append(0x8 << 28 | t >> 6)
        words.append(p << 28 | (t & 0x3F) << 22 | x << 11 | y)
    header = f"% evt 2.0\n% format EVT2;width={WIDTH};height={HEIGHT}\n% end\n".encode()
    path.write_bytes(header + np.array(words, "<u4").tobytes())


def _write_evt3_as_a_camera_does(path, events):
    """EVT3 words from the camera's start at t = 0 on, with every TIME_HIGH (bits 12 to 23)."""
    words, high = [], -1
    for t, x, y, p in events.tolist():
        while high < t >> 12:
            high += 1
            words.append(0x8 << 12 | high & 0xFFF)
        words += [0x6 << 12 | t & 0xFFF, y, 0x2 << 12 | p << 11 | x]
    header = f"% evt 3.0\n% format EVT3;width={WIDTH};height={HEIGHT}\n% end\n".encode()
    path.write_bytes(header + np.array(words, "<u2").tobytes())


@pytest.mark.parametrize(
    ("suffix", "write"),
    [
        (".h5", _write_h5),
        (".hdf5", _write_h5),
        (".txt", _write_text),
        (".csv", _write_faery()),
        (".aedat4", _write_faery()),
        (".raw", _write_faery("evt2")),
        (".raw", _write_faery("evt3")),
        (".raw", _write_evt2_as_a_camera_does),
        (".raw", _write_evt3_as_a_camera_does),
        (".dat", _write_faery("dat2")),
        (".es", _write_faery(zero_t0=False)),
    ],
)
def test_two_cameras_keep_their_absolute_times(tmp_path, suffix, write):
    for i, events in enumerate(_two_cameras()):
        path = tmp_path / f"cam{i + 1}{suffix}"
        write(path, events)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            file = load_events(path)
        assert file.events.dtype == EVENT_DTYPE
        np.testing.assert_array_equal(file.events, events)
        assert (file.width, file.height) == (WIDTH, HEIGHT)


def test_an_event_stream_that_lost_its_start_gives_a_warning(tmp_path):
    _write_faery()(tmp_path / "cam1.es", _random_events())
    with pytest.warns(UserWarning, match=r"cam1\.es starts at time 0: .* subtracted"):
        load_events(tmp_path / "cam1.es")


def test_dsec_layout(tmp_path):
    events = _random_events()
    path = tmp_path / "events.h5"
    with h5py.File(path, "w") as file:
        blosc = hdf5plugin.Blosc(cname="zstd")
        t = (events["t"] - 20_000_000).astype(np.uint32)
        for field, column in (("t", t), ("x", events["x"]), ("y", events["y"]), ("p", events["p"])):
            file.create_dataset(f"events/{field}", data=column, **blosc)
        file["t_offset"] = 20_000_000
        file["ms_to_idx"] = np.searchsorted(t, np.arange(0, 1_000_000, 1000))
    file = load_events(path)
    np.testing.assert_array_equal(file.events, events)
    assert (file.width, file.height) == (None, None)


def test_prophesee_hdf5_layout(tmp_path):
    events = _random_events()
    path = tmp_path / "events.hdf5"
    with h5py.File(path, "w") as file:
        dtype = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")], align=True)
        file["CD/events"] = events[["x", "y", "p", "t"]].astype(dtype)
        file.attrs["geometry"] = np.bytes_(f"{WIDTH}x{HEIGHT}")
    file = load_events(path)
    np.testing.assert_array_equal(file.events, events)
    assert (file.width, file.height) == (WIDTH, HEIGHT)


def test_hdf5_size_may_stand_on_the_group(tmp_path):
    path = tmp_path / "cam1.h5"
    save_events_h5(path, _random_events(), None, None)
    assert load_events(path).width is None
    with h5py.File(path, "a") as file:
        file["events"].attrs["width"], file["events"].attrs["height"] = WIDTH, HEIGHT
    assert (load_events(path).width, load_events(path).height) == (WIDTH, HEIGHT)


def test_text_is_exact_to_the_microsecond_for_negative_and_unix_times(tmp_path):
    for first_us in (-500_000, 1_700_000_000_123_457):
        events = _random_events(first_us=first_us)
        save_events_text(tmp_path / "cam1.txt", events, None, None)
        np.testing.assert_array_equal(load_events(tmp_path / "cam1.txt").events, events)


@pytest.mark.parametrize("darker", ["0", "-1"])
def test_esim_text_without_a_size(tmp_path, darker):
    path = tmp_path / "events.txt"
    path.write_text(f"0.000001 10 20 1\n1.5\t11  21 {darker}\n")
    file = load_events(path)
    assert file.events.tolist() == [(1, 10, 20, 1), (1_500_000, 11, 21, 0)]
    assert (file.width, file.height) == (None, None)


def test_csv_columns_in_any_order(tmp_path):
    path = tmp_path / "events.csv"
    path.write_text("x,y,p,id,t\n10,20,1,7,100\n11,21,0,8,200\n")
    assert load_events(path).events.tolist() == [(100, 10, 20, 1), (200, 11, 21, 0)]


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.csv", "t,x@346,y@260,p\n100,1,2,1\n"), ("a.txt", "346 260\n1e-4 1 2 1\n")],
)
def test_a_byte_order_mark_is_passed_over(tmp_path, name, text):
    (tmp_path / name).write_text(text, encoding="utf-8-sig")
    file = load_events(tmp_path / name)
    assert file.events.tolist() == [(100, 1, 2, 1)]
    assert (file.width, file.height) == (346, 260)


def test_text_longer_than_a_block(tmp_path, monkeypatch):
    monkeypatch.setattr("ssac.files.text.LINES_PER_BLOCK", 300)
    events = _random_events(1000)
    _write_text(tmp_path / "cam1.txt", events)
    np.testing.assert_array_equal(load_events(tmp_path / "cam1.txt").events, events)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "a.bag",
            "x",
            r"a\.bag: unknown extension '\.bag': use one of \.aedat4, \.csv.* convert the",
        ),
        (
            "a.MP4",
            "x",
            r"a\.MP4: unknown extension '\.MP4': .*; of a video, give the object's track",
        ),
        ("a.h5", "", r"a\.h5: the file is empty \(0 bytes\)"),
        ("a.h5", "hello", r"a\.h5: not a readable HDF5 file"),
        ("a.raw", "hello", r"a\.raw: not a complete \.raw file \(.*no version information"),
        ("a.raw", "% evt 2.1\n% end\n" + 64 * "a", r"a\.raw: its encoding is evt2\.1: convert"),
        ("a.dat", "hello", r"a\.dat: is damaged: 3 bytes beyond the last whole word of 8"),
        ("a.es", "hello there, world", r"a\.es: not a complete \.es file"),
        ("a.aedat4", "hello there, world", r"a\.aedat4: not a complete \.aedat4 file"),
        ("a.txt", "346 260\n", r"a\.txt: there are no events"),
        ("a.txt", "hello\n", r"a\.txt: the first line must be `t x y p` or `width height`"),
        ("a.txt", "0.1 1 2 1\n0.2 1", r"a\.txt: every line must be t, x, y, p in whole"),
        ("a.txt", "0.1 1 2 1\n0.2 1.5 2 1\n", r"a\.txt: every line must be t, x, y, p in whole"),
        ("a.txt", "nan 1 2 1\n", r"a\.txt: times must be finite"),
        ("a.txt", "0.2 1 2 1\n0.1 1 2 1\n", r"a\.txt: events must be sorted by time"),
        ("a.txt", "9 9\n0.1 9 2 1\n", r"a\.txt: the sensor is 9 x 9 px, but .* at x = 9"),
        ("a.txt", "0.1 1 -2 1\n", r"a\.txt: y must lie in 0 to 65535, got -2"),
        ("a.txt", "0.1 1 2 7\n", r"a\.txt: polarity must be 0 or 1, got 7"),
        ("a.csv", "1,2,3,1\n", r"a\.csv: the first line must name the columns t,x,y,p"),
        ("a.csv", "t,x,y,p\n0.1,2,3,1\n", r"whole numbers, t in microseconds"),
        ("a.txt", f"{10**20} 9\n0.1 1 2 1\n", r"a\.txt: the sensor's size .* 1 to 65535 px"),
        ("a.txt", "\u00b3 9\n0.1 1 2 1\n", r"a\.txt: the first line must be"),
        ("a.csv", "t,x@0,y,p\n1,2,3,1\n", r"a\.csv: the sensor's size .* 1 to 65535 px, got 0"),
    ],
)
def test_unusable_files_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(SsacError, match=message):
        load_events(tmp_path / name)


def test_a_binary_file_called_text_is_refused(tmp_path):
    (tmp_path / "a.txt").write_bytes(bytes(range(256)))
    with pytest.raises(SsacError, match="not a text file"):
        load_events(tmp_path / "a.txt")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(SsacError, match="there is no such file"):
        load_events(tmp_path / "cam1.h5")


@pytest.mark.parametrize(
    ("suffix", "write", "message"),
    [
        (".h5", _write_h5, "truncated"),
        (".aedat4", _write_faery(), "is damaged: the table of its packets is at byte"),
    ],
)
def test_truncated_files_are_refused(tmp_path, suffix, write, message):
    path = tmp_path / f"cam1{suffix}"
    write(path, _random_events())
    os.truncate(path, path.stat().st_size * 2 // 3)
    with pytest.raises(SsacError, match=message):
        load_events(path)


def test_hdf5_of_another_layout_is_refused(tmp_path):
    path = tmp_path / "cam1.h5"
    with h5py.File(path, "w") as file:
        file["events/ts"] = [0.0, 1.0]
    with pytest.raises(SsacError, match=r"expected the datasets events/t, .* has \['events'\]"):
        load_events(path)


def test_hdf5_columns_of_different_length_are_refused(tmp_path):
    path = tmp_path / "cam1.h5"
    _write_h5(path, _random_events())
    with h5py.File(path, "a") as file:
        del file["events/x"]
        file["events/x"] = np.zeros(3, np.uint16)
    with pytest.raises(SsacError, match=r"cam1\.h5: t, x, y and p must be of one length"):
        load_events(path)


def test_reading_needs_little_more_memory_than_the_events(tmp_path):
    events = _random_events(200_000)
    _write_h5(tmp_path / "cam1.h5", events)
    load_events(tmp_path / "cam1.h5")  # loads the compiled checks, which are not meant
    tracemalloc.start()
    load_events(tmp_path / "cam1.h5")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # The columns, the event array made of them, and one mask of the checks.
    assert peak < 2.5 * events.nbytes


def test_writing_is_all_or_nothing(tmp_path):
    for name, save in (("cam1.h5", save_events_h5), ("cam1.txt", save_events_text)):
        path = tmp_path / name
        save(path, _random_events(), WIDTH, HEIGHT)
        before = path.read_bytes()
        with pytest.raises(TypeError):
            save(path, None, WIDTH, HEIGHT)
        assert path.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cam1.h5", "cam1.txt"]


@pytest.mark.parametrize("name", ["synced.h5", "synced.txt"])
@pytest.mark.parametrize("time_offset_s", [OFFSET_US * 1e-6, -21.5])
def test_write_synced_puts_camera_2_on_camera_1s_clock(tmp_path, name, time_offset_s):
    cam1 = _random_events()
    cam2 = cam1.copy()
    cam2["t"] += round(time_offset_s * 1e6)
    write_synced(tmp_path / name, EventFile(cam2, WIDTH, HEIGHT), Clock(time_offset_s))
    file = load_events(tmp_path / name)
    np.testing.assert_array_equal(file.events, cam1)
    assert (file.width, file.height) == (WIDTH, HEIGHT)


def test_write_synced_takes_the_skew_away_too(tmp_path):
    cam1 = _random_events()
    clock = Clock(0.05, 800.0, 0.5)
    cam2 = cam1.copy()
    cam2["t"] = np.rint(1e6 * clock.cam2_from_cam1(cam1["t"] * 1e-6))
    write_synced(tmp_path / "synced.h5", EventFile(cam2, WIDTH, HEIGHT), clock)
    after = load_events(tmp_path / "synced.h5").events["t"]
    assert np.abs(after - cam1["t"]).max() <= 1  # both conversions round


def test_write_synced_refuses_other_formats(tmp_path):
    with pytest.raises(SsacError, match=r"cannot write the extension '\.raw': use one of"):
        write_synced(tmp_path / "a.raw", EventFile(_random_events(), None, None), Clock())


_READ_WITHOUT_THE_PLUGIN = """
import sys
sys.modules["hdf5plugin"] = None
from ssac.errors import SsacError
from ssac.files.event_files import load_events
from ssac.files.hdf5 import load_frames
print(len(load_events(sys.argv[1]).events))
for load in (load_events, load_frames):
    try:
        load(sys.argv[2])
    except SsacError as error:
        print(error)
"""


def test_a_codec_that_is_not_installed_is_named_with_its_package(tmp_path):
    events = _random_events()
    plain, ours = tmp_path / "plain.h5", tmp_path / "ours.h5"
    _write_h5(plain, events)
    with h5py.File(ours, "w") as file:
        for field in ("t", "x", "y", "p"):
            file.create_dataset(f"events/{field}", data=events[field], **hdf5plugin.Blosc())
        file["frames/t"] = [0]
        file.create_dataset("frames/images", shape=(1, 4, 5), dtype="u1", **hdf5plugin.Zstd())
    command = [sys.executable, "-c", _READ_WITHOUT_THE_PLUGIN, plain, ours]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout.splitlines() == [
        str(len(events)),
        f"{ours}: events/t is compressed with blosc (number 32001), which this HDF5 library does "
        "not have: pip install hdf5plugin",
        f"{ours}: frames/images is compressed with HDF5 zstd filter (number 32015), which this "
        "HDF5 library does not have: pip install hdf5plugin",
    ]


def test_prophesees_own_codec_is_not_in_that_package(tmp_path, monkeypatch):
    path = tmp_path / "cam1.h5"
    events = _random_events()
    with h5py.File(path, "w") as file:
        file.create_dataset("CD/events", data=events, **hdf5plugin.Blosc())
    monkeypatch.setattr(hdf5, "_PROPHESEE_ECF", 32001)
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda code: False)
    with pytest.raises(SsacError, match="install Prophesee's HDF5 plugin, or convert the file"):
        load_events(path)


def test_microseconds_in_a_file_of_seconds_are_named(tmp_path):
    path = tmp_path / "cam1.txt"
    path.write_text("".join(f"{t} 1 2 1\n" for t in range(0, 2_000_000, 1000)))
    with pytest.raises(SsacError, match="t must be in seconds, but all times are whole numbers"):
        load_events(path)
