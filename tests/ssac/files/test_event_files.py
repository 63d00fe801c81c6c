"""Event files of all formats are read as written, refused with the reason, and written whole."""

import os
import tracemalloc
from functools import partial

import faery
import h5py
import hdf5plugin
import numpy as np
import pytest
from faery.file_encoder import events_to_file
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ssac import Clock, Reading, SsacError
from ssac.events import EVENT_DTYPE, EventFile, events_from_arrays
from ssac.files import hdf5
from ssac.files.event_files import FORMATS, WRITTEN, load_events, save_events_numpy, write_synced
from ssac.files.hdf5 import save_events_h5
from ssac.files.text import save_events_text
from tests.ssac.bags import arrays as event_arrays
from tests.ssac.bags import mono, packets, write_bag

WIDTH, HEIGHT = 346, 260
FIRST_US = 20_000_000  # EVT3's 24-bit clock has overflowed once by then


@st.composite
def some_events(draw, first_us):
    """Sorted events, some at one time; too few for equal ones to count as a damaged block."""
    n = draw(st.integers(1, 31))
    steps_us = draw(arrays(np.int64, n, elements=st.integers(0, 50_000)))
    sides = ((WIDTH - 1, np.int64), (HEIGHT - 1, np.int64), (1, np.int64))
    x, y, p = (draw(arrays(kind, n, elements=st.integers(0, most))) for most, kind in sides)
    return events_from_arrays(draw(first_us) + np.cumsum(steps_us), x, y, p)


def random_events(n=2000):
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, 1_000_000, n)) + FIRST_US
    sides = (WIDTH, HEIGHT, 2)
    return events_from_arrays(t, *(rng.integers(0, most, n) for most in sides))


def ours(save):
    return lambda path, events: save(path, events, WIDTH, HEIGHT)


def faerys(version=None, zero_t0=True):
    def write(path, events):
        blocks = iter([events.astype(faery.EVENTS_DTYPE)])
        size = (WIDTH, HEIGHT)
        events_to_file(blocks, path, dimensions=size, version=version, zero_t0=zero_t0)

    return write


def evt2_of_a_camera(path, events):
    """Write absolute times: a TIME_HIGH (bits 6 to 33 of t) before each event."""
    words = []
    for t, x, y, p in events.tolist():
        words += [0x8 << 28 | t >> 6, p << 28 | (t & 0x3F) << 22 | x << 11 | y]
    header = f"% evt 2.0\n% format EVT2;width={WIDTH};height={HEIGHT}\n% end\n".encode()
    path.write_bytes(header + np.array(words, "<u4").tobytes())


def evt3_of_a_camera(path, events, on_change=False):
    """Write words from the camera's start at t = 0, with every TIME_HIGH (bits 12 to 23 of t)."""
    words, high = [], -1
    for t, x, y, p in events.tolist():
        if on_change:  # without those of times when nothing was seen
            high = max(high, (t >> 12) - 1)
        while high < t >> 12:
            high += 1
            words.append(0x8 << 12 | high & 0xFFF)
        words += [0x6 << 12 | t & 0xFFF, y, 0x2 << 12 | p << 11 | x]
    header = f"% evt 3.0\n% format EVT3;width={WIDTH};height={HEIGHT}\n% end\n".encode()
    path.write_bytes(header + np.array(words, "<u2").tobytes())


def dsec(path, events):
    with h5py.File(path, "w") as file:
        t = (events["t"] - FIRST_US).astype(np.uint32)
        for field, column in (("t", t), *((name, events[name]) for name in "xyp")):
            file.create_dataset(f"events/{field}", data=column, **hdf5plugin.Blosc(cname="zstd"))
        file["t_offset"] = FIRST_US
        file["ms_to_idx"] = np.searchsorted(t, np.arange(0, 1_000_000, 1000))


def prophesee(path, events):
    with h5py.File(path, "w") as file:
        dtype = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")], align=True)
        file["CD/events"] = events[["x", "y", "p", "t"]].astype(dtype)
        file.attrs["geometry"] = np.bytes_(f"{WIDTH}x{HEIGHT}")


def size_on_group(path, events):
    save_events_h5(path, events, None, None)
    with h5py.File(path, "a") as file:
        file["events"].attrs["width"], file["events"].attrs["height"] = WIDTH, HEIGHT


def four_arrays(path, events):
    np.savez(path, **{name: events[name] for name in "txyp"}, width=WIDTH, height=HEIGHT)


def bag_of(messages):
    return lambda path, events: write_bag(path, {"/camera/events": messages(events)})


def bag_of_words(encoding, of_a_camera, n_bytes, is_bigendian, path, events):
    """A bag of a camera's words, cut into packets anywhere; the first packet has no time yet."""
    of_a_camera(path, events)
    data = path.read_bytes().partition(b"% end\n")[2]
    some = [data[k : k + n_bytes] for k in range(0, len(data), n_bytes)]
    unknown = {"evt2": 4 * b"\1", "evt3": 2 * b"\1"}[encoding]
    if is_bigendian:
        some = [np.frombuffer(one, "<u4").astype(">u4").tobytes() for one in some]
    data = [(0, unknown), *((0, one) for one in some)]
    write_bag(path, {"/camera/events": packets(encoding, data, is_bigendian)})


FORMS = {
    "ours.h5": ours(save_events_h5),
    "ours.hdf5": ours(save_events_h5),
    "group.h5": size_on_group,
    "dsec.h5": dsec,
    "prophesee.hdf5": prophesee,
    "esim.txt": ours(save_events_text),
    "faery.csv": faerys(),
    "array.npy": ours(save_events_numpy),
    "array.npz": ours(save_events_numpy),
    "four.npz": four_arrays,
    "faery.aedat4": faerys(),
    "faery-evt2.raw": faerys("evt2"),
    "faery-evt3.raw": faerys("evt3"),
    "evt2.raw": evt2_of_a_camera,
    "evt3.raw": evt3_of_a_camera,
    "faery.dat": faerys("dat2"),
    "faery.es": faerys(zero_t0=False),
    "dvs.bag": bag_of(event_arrays),
    "dvs.mcap": bag_of(event_arrays),
    "prophesee.db3": bag_of(lambda events: event_arrays(events, "prophesee_event_msgs")),
    "mono.bag": bag_of(mono),
    "mono.db3": bag_of(lambda events: mono(events, ">")),
    "evt2.mcap": partial(bag_of_words, "evt2", evt2_of_a_camera, 36, True),
    "evt3.bag": partial(bag_of_words, "evt3", evt3_of_a_camera, 2000, False),
}
WITHOUT_SIZE = ("dsec.h5", "array.npy", "times.txt")
ANY_TIME_US = st.integers(-(10**6), 2 * 10**15)  # negative, or since 1970


def test_evt3_whose_clock_starts_again_while_nothing_is_seen(tmp_path):
    """A sensor that writes the time only when it changes leaves out the words 4095 and 0."""
    steps_us = np.full(200, 1000)
    steps_us[100] = 20_000  # a pause of five words
    t = (1 << 24) - 110_000 + np.cumsum(steps_us)
    evt3_of_a_camera(tmp_path / "cam1.raw", events_from_arrays(t, t % 7, t % 5, t % 2), True)
    assert np.array_equal(np.diff(load_events(tmp_path / "cam1.raw").events["t"]), steps_us[1:])


def test_every_format_is_tried():
    assert {f".{name.rpartition('.')[2]}" for name in FORMS} == set(FORMATS)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", [*FORMS, "times.txt"])
def test_events_come_back_as_they_were_recorded(name, tmp_path_factory, monkeypatch):
    path = tmp_path_factory.mktemp("form") / name
    monkeypatch.setattr("ssac.files.text.LINES_PER_BLOCK", 7)

    @given(some_events(ANY_TIME_US if name == "times.txt" else st.just(FIRST_US)))
    def law(events):
        FORMS.get(name, partial(save_events_text, width=None, height=None))(path, events)
        file = load_events(path)
        assert file.events.dtype == EVENT_DTYPE
        np.testing.assert_array_equal(file.events, events)
        expected = (None, None) if name in WITHOUT_SIZE else (WIDTH, HEIGHT)
        assert (file.width, file.height) == expected
        assert len(load_events(path, Reading(True, True)).events) == len(events)

    law()


@pytest.mark.parametrize("suffix", WRITTEN)
def test_writing_is_all_or_nothing(tmp_path, suffix):
    path = tmp_path / f"cam1{suffix}"
    write = FORMS[next(name for name in FORMS if name.endswith(suffix))]
    write(path, random_events())
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write(path, None)
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", WRITTEN)
@pytest.mark.parametrize("clock", [Clock(0.053217), Clock(-21.5), Clock(0.05, 800.0, 0.5)])
def test_camera_2_is_written_on_camera_1s_clock(tmp_path, suffix, clock):
    cam1, path = random_events(), tmp_path / f"synced{suffix}"
    cam2 = cam1.copy()
    cam2["t"] = np.rint(1e6 * clock.cam2_from_cam1(cam1["t"] * 1e-6))
    write_synced(path, EventFile(cam2, WIDTH, HEIGHT), clock)
    after = load_events(path).events
    # Where the rates of the clocks differ, both conversions round.
    assert np.abs(after["t"] - cam1["t"]).max() <= (not clock.is_delay)
    np.testing.assert_array_equal(after[["x", "y", "p"]], cam1[["x", "y", "p"]])
    with pytest.raises(SsacError, match=r"cannot write the extension '\.raw': use one of"):
        write_synced(tmp_path / "a.raw", EventFile(cam2, None, None), clock)


def test_an_event_stream_that_lost_its_start_gives_a_warning(tmp_path):
    faerys()(tmp_path / "cam1.es", random_events())
    with pytest.warns(UserWarning, match=r"cam1\.es starts at time 0: .* subtracted"):
        load_events(tmp_path / "cam1.es")


@pytest.mark.parametrize(
    ("name", "text", "events"),
    [
        ("a.txt", "0.000001 10 20 1\n1.5\t11  21 0\n", [(1, 10, 20, 1), (1_500_000, 11, 21, 0)]),
        ("a.txt", "1.5 11 21 -1\n", [(1_500_000, 11, 21, 0)]),
        ("a.csv", "x,y,p,id,t\n10,20,1,7,100\n", [(100, 10, 20, 1)]),
        ("a.csv", "\ufefft,x@346,y@260,p\n100,1,2,1\n", [(100, 1, 2, 1)]),
        ("a.csv", "t,x,y,p\n100,1,2,1,\n200,3,4,0,\n", [(100, 1, 2, 1), (200, 3, 4, 0)]),
        ("a.txt", "\ufeff346 260\n1e-4 1 2 1\n", [(100, 1, 2, 1)]),
    ],
)
def test_text_as_others_write_it(tmp_path, name, text, events):
    (tmp_path / name).write_text(text, encoding="utf-8")
    file = load_events(tmp_path / name)
    assert file.events.tolist() == events
    assert (file.width, file.height) == ((346, 260) if "346" in text else (None, None))


# --- What is refused ---


def _attribute(key, value):
    return lambda file: file.attrs.__setitem__(key, value)


def _instead(old, value, new=None):
    def change(file):
        del file[old]
        file[new or old] = value

    return change


def _declared(file):
    del file["events"]
    for field in "txyp":
        file.create_dataset(f"events/{field}", (4_000_000_000,), np.int64, chunks=(1000,))


def _lost_block(field, first=1000):
    def change(file):
        values = file[f"events/{field}"][:]
        del file[f"events/{field}"]
        how = values.shape, values.dtype
        column = file.create_dataset(f"events/{field}", *how, chunks=(500,))
        column[:first], column[first + 500 :] = values[:first], values[first + 500 :]

    return change


HDF5 = [
    (_attribute("geometry", "346,260"), "geometry must be WIDTHxHEIGHT"),
    (_attribute("width", "wide"), "the attribute width must be a number of 1 to 65535"),
    (_attribute("height", np.nan), "the attribute height must be a number"),
    (_instead("events/t", 5), "must be of one length"),
    (_instead("events/x", np.zeros(3, np.uint16)), "t, x, y and p must be of one length"),
    (_instead("events", [0.0, 1.0], "events/ts"), r"expected the datasets .* \['events'\]"),
    (_instead("events/t", 0, "events/t/no"), "events/t must be a dataset"),
    (_instead("events/t", h5py.SoftLink("/events/t")), "events/t is a link to elsewhere"),
    (_instead("events", h5py.ExternalLink("other.h5", "/")), "is a link to elsewhere"),
    (lambda file: file.create_dataset("t_offset", data="now"), "t_offset must be one number"),
    (lambda file: file.create_dataset("t_offset", data=np.nan), "t_offset must be one number"),
    (lambda file: file.create_dataset("CD/events", data=5), "CD/events must be a list of x"),
    (_declared, "says that it has 4000000000 values, but 0 bytes of it are stored"),
    (_lost_block("t"), "is damaged: 1 of 4 blocks of events/t are lost.*--allow-damaged"),
    (_lost_block("y"), "is damaged: 1 of 4 blocks of events/y are lost: copy or record it again$"),
    (lambda file: os.truncate(file.filename, 9000), "truncated"),
]
SECONDS = "".join(f"{t} 1 2 1\n" for t in range(0, 2_000_000, 1000))


@pytest.mark.filterwarnings("error")  # no warning comes with an error
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.bag", "hello", r"not a readable ROS bag \(File magic is invalid"),
        ("a.MP4", "x", r"unknown extension '\.MP4': .*; of a video, give the object's track"),
        ("a.h5", "", r"the file is empty \(0 bytes\)"),
        ("a.h5", None, "there is no such file"),
        ("a.h5", "hello", "not a readable HDF5 file"),
        ("a.npy", "hello", r"not a complete \.npy file of NumPy"),
        ("a.npz", "hello", r"not a complete \.npz file of NumPy"),
        ("a.raw", "hello", r"not a complete \.raw file \(.*no version information"),
        ("a.raw", "% evt 2.1\n% end\n" + 64 * "a", r"its encoding is evt2\.1: convert"),
        ("a.dat", "hello", "is damaged: 3 bytes beyond the last whole word of 8"),
        ("a.es", "hello there, world", r"not a complete \.es file"),
        ("a.aedat4", "hello there, world", r"not a complete \.aedat4 file"),
        ("a.txt", "346 260\n", "there are no events"),
        ("a.txt", "hello\n", "the first line must be four numbers t x y p, or `width"),
        ("a.txt", "0.1 1 2 1\n0.2 1", "every line must be t, x, y, p in whole"),
        ("a.txt", "0.1 1 2 1\n0.2 1.5 2 1\n", "every line must be t, x, y, p in whole"),
        ("a.txt", "0.1 1 2 1\n0.2 1 2 1 0.3 1 2 0\n", "every line .* 4 fields in line 2, saw 8"),
        ("a.txt", "9 9\n0.1 1 2 1 0.3 1 2 0\n0.4 1 2 1\n", "every line must be t, x, y, p"),
        ("a.txt", "0.1 1 2 1\n1e300 1 2 1\n", "times must be finite, got nan, inf or more"),
        ("a.txt", SECONDS, "t must be in seconds, but all times are whole numbers"),
        ("a.txt", "9 9\n0.1 9 2 1\n", "the sensor is 9 x 9 px, but .* at x = 9"),
        ("a.txt", f"{10**20} 9\n0.1 1 2 1\n", r"the sensor's size .* 1 to 65535 px"),
        ("a.txt", "\u00b3 9\n0.1 1 2 1\n", "the first line must be"),
        ("a.txt", bytes(range(1, 256)), "not a text file"),
        ("a.txt", b"0.1 1 2 1\n" + 4096 * b"\0" + b"\n0.2 1 2 1\n", "byte 10 is zero"),
        ("a.csv", "t,x,y,p\n1,2,3,1\n".encode("utf-16"), "its text is UTF-16: save it as UTF-8"),
        ("a.csv", "1,2,3,1\n", "the first line must name the columns t,x,y,p"),
        ("a.csv", "t_s,x_px,y_px\n1,2,3\n", "is a track of points, not events"),
        ("a.csv", "t,x,y,p\n0.1,2,3,1\n", "whole numbers, t in microseconds"),
        ("a.csv", "t,x@0,y,p\n1,2,3,1\n", "the sensor's size .* 1 to 65535 px, got '?0"),
        ("a.csv", "t,x,y,p\n1,1,1,1\n99999999999999999999999,1,1,1\n", "every line must be"),
        ("a.csv", "t,x,y,p\n1,2,3,1\n4,5,6,1,7\n", "every line .* 4 fields in line 3, saw 5"),
        ("a.csv", "t,x,y,p\n1,2,3,1,7\n4,5,6,1\n", "every line must be"),
        ("a.csv", 't,x,y,p\n1,1,"1,1\n2,1,1",1\n', "every line must be"),
        ("a.npy", np.zeros(3), "expected a structured array with the fields t"),
        ("a.npy", np.array([{}, None]), "Python objects"),
        ("a.npy", np.zeros(3, [("t", "i8"), ("x", "i4")]), "without y, p"),
        ("a.npz", {"t": np.zeros(2, int), "x": np.zeros(2, int)}, "an array for each of them"),
        ("a.npz", {name: np.zeros(k, int) for k, name in enumerate("txyp")}, "of one length"),
        ("a.npz", {"events": np.zeros(1, EVENT_DTYPE), "width": "wide"}, "width must be a number"),
        *(("a.h5", change, message) for change, message in HDF5),
    ],
)
def test_unusable_files_are_refused(tmp_path, name, content, message):
    path = tmp_path / name
    if isinstance(content, dict):
        np.savez(path, **content)
    elif isinstance(content, np.ndarray):
        np.save(path, content)
    elif callable(content):
        save_events_h5(path, random_events(), WIDTH, HEIGHT)
        with h5py.File(path, "a") as file:
            content(file)
    elif content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(SsacError, match=rf"{name.replace('.', '[.]')}: .*{message}"):
        load_events(path)


def test_events_whose_times_are_lost_are_left_out_at_the_start_too(tmp_path):
    save_events_h5(tmp_path / "a.h5", random_events(), WIDTH, HEIGHT)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        _lost_block("t", first=0)(file)
    with pytest.warns(UserWarning, match="1 of 4 blocks of events/t are lost"):
        found = load_events(tmp_path / "a.h5", Reading(allow_damaged=True))
    np.testing.assert_array_equal(found.events, random_events()[500:])


@pytest.mark.parametrize(
    ("name", "per_s", "form", "message"),
    [
        *(
            (name, 10**n, "{:.0f}", f"t must be in microseconds, .* 50000 events last {said}")
            for name in ("a.csv", "a.npy", "a.h5")
            for n, said in ((9, "19999.6 s: if it is in nanoseconds, divide"),
                            (3, "0.02 s: if it is in milliseconds, multiply"))
        ),
        ("a.txt", 10**3, "{:.1f}", "t must be in seconds, .* if it is in milliseconds, divide"),
        *(
            ("a.txt", 10**n, "{:.0f}", "whole numbers, up to .*, as of milliseconds or finer")
            for n in (3, 6, 9)
        ),
    ],
)  # fmt: skip
def test_times_in_another_unit_are_said_to_be(name, per_s, form, message, tmp_path):
    times = per_s * (0.00049 + 0.0004 * np.arange(50_000))
    if name in ("a.npy", "a.h5"):
        events = random_events(len(times))
        events["t"] = times
        save = save_events_numpy if name == "a.npy" else save_events_h5
        save(tmp_path / name, events, None, None)
    else:
        head, between = ("t,x,y,p\n", ",") if name == "a.csv" else ("", " ")
        lines = (between.join((form.format(t), "1", "2", "1")) for t in times)
        (tmp_path / name).write_text(head + "\n".join(lines))
    refused, warned = (pytest.raises, SsacError), (pytest.warns, UserWarning)
    expected, kind = refused if "whole" in message else warned
    with expected(kind, match=message):
        load_events(tmp_path / name)


def test_reading_needs_little_more_memory_than_the_events(tmp_path):
    events = random_events(200_000)
    save_events_h5(tmp_path / "cam1.h5", events, WIDTH, HEIGHT)
    load_events(tmp_path / "cam1.h5")  # loads the compiled checks, whose memory is not counted
    tracemalloc.start()
    load_events(tmp_path / "cam1.h5")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # The columns, the event array made of them, and one mask of the checks.
    assert peak < 2.5 * events.nbytes


def test_a_codec_that_is_not_installed_is_named(tmp_path, monkeypatch):
    with h5py.File(tmp_path / "cam1.h5", "w") as file:
        file.create_dataset("CD/events", data=random_events(9), **hdf5plugin.Blosc())
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda code: False)
    message = r"CD/events is compressed with blosc.* \(number 32001\), .*: install its plugin"
    with pytest.raises(SsacError, match=rf"cam1\.h5: {message}"):
        load_events(tmp_path / "cam1.h5")


# --- Frames beside the events ---


def write_frames(path, times_us, images, **how):
    save_events_h5(path, random_events(9), WIDTH, HEIGHT)
    with h5py.File(path, "a") as file:
        file["frames/t"] = times_us
        file.create_dataset("frames/images", data=images, **how)
    return path


def test_frames_are_read_whole_or_summed_up_a_few_at_a_time(tmp_path, monkeypatch):
    path = tmp_path / "cam1.h5"
    save_events_h5(path, random_events(9), WIDTH, HEIGHT)
    assert hdf5.load_frames(path) is None
    assert hdf5.load_frames(tmp_path / "cam1.txt") is None
    images = np.random.default_rng(0).integers(0, 256, (23, 26, 34)).astype(np.uint8)
    path = write_frames(path, 20_000 * np.arange(23), images, chunks=(4, 26, 34))
    times_us, whole = hdf5.load_frames(path)
    assert times_us.dtype == np.int64
    np.testing.assert_array_equal(times_us, 20_000 * np.arange(23))
    np.testing.assert_array_equal(whole, images)
    monkeypatch.setattr(hdf5, "BYTES_PER_BLOCK", 9 * 26 * 34)
    sizes = []

    def largest(some):
        sizes.append(len(some))
        return some.max(axis=(1, 2))

    np.testing.assert_array_equal(hdf5.load_frames(path, largest)[1], images.max(axis=(1, 2)))
    assert sizes == [8, 8, 7]  # whole chunks


@pytest.mark.parametrize(
    ("times_us", "images", "message"),
    [
        ([0, 1], np.zeros((3, 4, 5), np.uint8), r"got \(3, 4, 5\) uint8 and \(2,\) times"),
        ([0, 1], np.zeros((2, 4, 5)), "as .* uint8"),
        ([1, 1], np.zeros((2, 4, 5), np.uint8), "increasing whole microseconds"),
        ([0.0, 0.1], np.zeros((2, 4, 5), np.uint8), "increasing whole microseconds"),
    ],
)
def test_unusable_frames_are_refused(tmp_path, times_us, images, message):
    path = write_frames(tmp_path / "cam1.h5", times_us, images)
    with pytest.raises(SsacError, match=message):
        hdf5.load_frames(path)


def test_frames_of_an_even_sky_are_no_damage_however_small_they_are_stored(tmp_path):
    images = np.full((100, 200, 300), 7, np.uint8)
    how = {"chunks": (20, 200, 300), **hdf5plugin.Zstd(clevel=10)}
    path = write_frames(tmp_path / "cam1.h5", np.arange(100), images, **how)
    with h5py.File(path) as file:
        assert file["frames/images"].id.get_storage_size() < images.size / 2000
    np.testing.assert_array_equal(hdf5.load_frames(path)[1], images)


def test_lost_frames_are_refused_without_the_advice_to_allow_damage(tmp_path):
    how = {"shape": (8, 4, 5), "dtype": np.uint8, "chunks": (2, 4, 5)}
    path = write_frames(tmp_path / "cam1.h5", np.arange(8), None, **how)
    with h5py.File(path, "a") as file:
        file["frames/images"][:4] = 7
    message = r"2 of 4 blocks of frames/images are lost: .*, or use a method for events$"
    with pytest.raises(SsacError, match=message):
        hdf5.load_frames(path)
