"""Event files that are damaged or unsorted: refused with what is wrong, or read as asked for."""

import warnings

import h5py
import numpy as np
import pytest
from faery import EVENTS_DTYPE
from faery.file_encoder import events_to_file

from ssac.errors import SsacError
from ssac.events import events_from_arrays
from ssac.files.damage import Reading
from ssac.files.event_files import load_events
from ssac.files.hdf5 import save_events_h5
from ssac.files.text import save_events_text

WIDTH, HEIGHT, N = 346, 260, 4000
ALLOWED = Reading(allow_damaged=True)


def make_events(n=N):
    rng = np.random.default_rng(0)
    t = 20_000_000 + np.sort(rng.integers(0, 1_000_000, n))
    return events_from_arrays(
        t, rng.integers(0, WIDTH, n), rng.integers(0, HEIGHT, n), rng.integers(0, 2, n)
    )


def write_raw(path, version):
    events = make_events().astype(EVENTS_DTYPE)
    events_to_file(iter([events]), path, dimensions=(WIDTH, HEIGHT), version=version)
    return path.read_bytes()


RAW = [("cam1.raw", "evt2"), ("cam1.raw", "evt3"), ("cam1.dat", "dat2")]


@pytest.mark.parametrize(("name", "version"), RAW)
@pytest.mark.parametrize("n_bytes", [1, -1])
def test_a_byte_too_many_or_too_few_is_seen(tmp_path, name, version, n_bytes):
    path = tmp_path / name
    whole = write_raw(path, version)
    for share in (0.2, 0.5, 0.9):
        at = int(share * len(whole))
        path.write_bytes(whole[:at] + b"\x55" * max(n_bytes, 0) + whole[at + max(-n_bytes, 0) :])
        with pytest.raises(SsacError, match=r"cam1\.\w+: is damaged: .*--allow-damaged"):
            load_events(path)


@pytest.mark.parametrize(("name", "version"), RAW)
@pytest.mark.parametrize("fill", [b"\0", b"\xff"])
def test_a_block_that_was_overwritten_is_seen(tmp_path, name, version, fill):
    path = tmp_path / name
    whole = write_raw(path, version)
    at = len(whole) // 2
    path.write_bytes(whole[:at] + 1024 * fill + whole[at + 1024 :])
    with pytest.raises(SsacError, match="is damaged"):
        load_events(path)


def test_a_raw_file_is_read_as_far_as_it_goes_where_that_is_allowed(tmp_path):
    path = tmp_path / "cam1.raw"
    whole = write_raw(path, "evt2")
    path.write_bytes(whole[:-3])
    with pytest.warns(UserWarning, match="is damaged, and what is left of it is read: 1 bytes"):
        file = load_events(path, ALLOWED)
    np.testing.assert_array_equal(file.events, make_events()[:-1])


def test_of_a_truncated_aedat4_the_whole_packets_are_read(tmp_path):
    path = tmp_path / "cam1.aedat4"
    n = 50_000  # several packets
    events_to_file(
        iter(np.array_split(make_events(n).astype(EVENTS_DTYPE), 10)),
        path,
        dimensions=(WIDTH, HEIGHT),
    )
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SsacError, match="the table of its packets is at byte"):
        load_events(path)
    with pytest.warns(UserWarning, match="no further than its first"):
        events = load_events(path, ALLOWED).events
    np.testing.assert_array_equal(events, make_events(n)[: len(events)])
    assert 0.3 * n < len(events) < 0.6 * n  # of half the file, less a packet


def test_a_size_in_an_aedat4_header_takes_no_memory(tmp_path):
    path = tmp_path / "cam1.aedat4"
    events = make_events().astype(EVENTS_DTYPE)
    events_to_file(iter([events]), path, dimensions=(WIDTH, HEIGHT))
    whole = path.read_bytes()
    path.write_bytes(whole[:14] + b"\xff\xff\xff\x7f" + whole[18:])
    with pytest.raises(SsacError, match="its header says that it has 2147483647 bytes"):
        load_events(path)


def test_an_aedat4_header_whose_xml_cannot_be_parsed_is_refused(tmp_path):
    path = tmp_path / "cam1.aedat4"
    events = make_events().astype(EVENTS_DTYPE)
    events_to_file(iter([events]), path, dimensions=(WIDTH, HEIGHT))
    whole = path.read_bytes()
    for old, new in ((b"string", b"str\xe9ng"), (b"</dv>", b"</dw>"), (b'"2.0"', b'"2.0<')):
        assert old in whole
        path.write_bytes(whole.replace(old, new, 1))
        with pytest.raises(SsacError, match=r"cam1\.aedat4: .*its header.s XML: "):
            load_events(path, ALLOWED)  # of the first the library would end the process


def test_events_late_by_microseconds_are_sorted_only_when_asked(tmp_path):
    events = make_events()
    mixed = events.copy()
    mixed["t"][1:] -= np.where(np.arange(1, N) % 2, 400, 0)  # neighbours change places
    expected = mixed[np.argsort(mixed["t"], kind="stable")]
    for name, save in (("cam1.h5", save_events_h5), ("cam1.txt", save_events_text)):
        save(tmp_path / name, mixed, WIDTH, HEIGHT)
        with pytest.raises(SsacError, match=r"must be sorted by .* sort them with --sort"):
            load_events(tmp_path / name)
        with pytest.warns(UserWarning, match="of 4000 events came up to .* us too late"):
            file = load_events(tmp_path / name, Reading(sort=True))
        np.testing.assert_array_equal(file.events, expected)


@pytest.mark.parametrize(
    ("shift_us", "n_left"),
    [(-900_000, 3000), (10**13, 3000)],  # a quarter of the events: of the two parts the longer
)
def test_time_that_breaks_leaves_the_longer_part(tmp_path, shift_us, n_left):
    events = make_events()
    events["t"][3000:] += shift_us
    save_events_h5(tmp_path / "cam1.h5", events, WIDTH, HEIGHT)
    with pytest.raises(SsacError, match=r"sorted by time|leaps of time by more than 3600 s"):
        load_events(tmp_path / "cam1.h5")
    with pytest.warns(UserWarning, match=r"1000 of 4000 events \(25 %\) are left out"):
        file = load_events(tmp_path / "cam1.h5", ALLOWED)
    np.testing.assert_array_equal(file.events, events[:n_left])


@pytest.mark.parametrize("shift_us", [-700_000, 700_000, 10**13])
def test_parts_that_follow_each_other_are_joined(tmp_path, shift_us):
    events = make_events()
    events["t"][1000:1100] += shift_us
    save_events_h5(tmp_path / "cam1.h5", events, WIDTH, HEIGHT)
    with pytest.warns(UserWarning, match="100 of 4000 events"):
        file = load_events(tmp_path / "cam1.h5", ALLOWED)
    np.testing.assert_array_equal(file.events, np.delete(events, slice(1000, 1100)))


def test_events_beside_the_sensor_are_left_out_where_that_is_allowed(tmp_path):
    events = make_events()
    events["x"][7] = 60_000
    save_events_h5(tmp_path / "cam1.h5", events, WIDTH, HEIGHT)
    with pytest.raises(SsacError, match="there is an event at x = 60000"):
        load_events(tmp_path / "cam1.h5")
    with pytest.warns(UserWarning, match="1 of 4000 events lie outside the sensor"):
        file = load_events(tmp_path / "cam1.h5", ALLOWED)
    np.testing.assert_array_equal(file.events, np.delete(events, 7))


def test_whole_files_are_read_alike_with_any_leave(tmp_path):
    save_events_h5(tmp_path / "cam1.h5", make_events(), WIDTH, HEIGHT)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        file = load_events(tmp_path / "cam1.h5", Reading(True, True))
    np.testing.assert_array_equal(file.events, make_events())


def _attribute(key, value):
    def change(file):
        file.attrs[key] = value

    return change


def _instead(name, value):
    def change(file):
        del file[name]
        file[name] = value

    return change


def _declared(file):
    del file["events"]
    for field in "txyp":
        file.create_dataset(f"events/{field}", (4_000_000_000,), np.int64, chunks=(1000,))


def _lost_block(file):
    t = file["events/t"][:]
    del file["events/t"]
    column = file.create_dataset("events/t", t.shape, t.dtype, chunks=(1000,))
    column[:2000], column[3000:] = t[:2000], t[3000:]


def _group(file):
    del file["events/t"]
    file.create_group("events/t")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_attribute("geometry", "346,260"), "geometry must be WIDTHxHEIGHT"),
        (_attribute("width", "wide"), "the attribute width must be a number of 1 to 65535"),
        (_attribute("height", np.nan), "the attribute height must be a number"),
        (_instead("events/t", 5), "must be of one length"),
        (_group, "events/t must be a dataset"),
        (_instead("events/t", h5py.SoftLink("/events/t")), "events/t is a link to elsewhere"),
        (_instead("events", h5py.ExternalLink("other.h5", "/")), "is a link to elsewhere"),
        (lambda file: file.create_dataset("t_offset", data="now"), "t_offset must be one number"),
        (lambda file: file.create_dataset("t_offset", data=np.nan), "t_offset must be a time"),
        (lambda file: file.create_dataset("CD/events", data=5), "CD/events must be a list of x"),
        (_declared, "says that it has 4000000000 values, but 0 bytes of it are stored"),
        (_lost_block, "is damaged: 1 of 4 blocks of events/t are lost"),
    ],
)
def test_hdf5_that_is_not_what_it_says_is_one_error(tmp_path, change, message):
    save_events_h5(tmp_path / "cam1.h5", make_events(), WIDTH, HEIGHT)
    with h5py.File(tmp_path / "cam1.h5", "a") as file:
        change(file)
    with pytest.raises(SsacError, match=message) as raised:
        load_events(tmp_path / "cam1.h5")
    assert "cam1.h5" in str(raised.value)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", b"0.1 1 2 1\n" + 4096 * b"\0" + b"\n0.2 1 2 1\n", "byte 10 is zero"),
        ("a.csv", b"t,x,y,p\n1,1,1,1\n99999999999999999999999,1,1,1\n", "every line must be"),
        ("a.csv", b"t,x,y,p\n1,1,1,1\n1e400,1,1,1\n", "every line must be"),  # no warning beside it
        ("a.txt", b"0.1 1 2 1\n1e300 1 2 1\n", "times must be finite, got nan, inf or more"),
        ("a.csv", b't,x,y,p\n1,1,"1,1\n2,1,1",1\n', "every line must be"),
    ],
)
def test_text_that_is_damaged_is_one_error(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SsacError, match=message):
        load_events(tmp_path / name)
