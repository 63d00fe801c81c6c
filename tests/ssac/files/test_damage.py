"""Event files that are damaged or unsorted: refused with what is wrong, or read as asked for."""

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
@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
@pytest.mark.parametrize(
    ("n_lost", "inserted"),
    [(0, b"\x55"), (1, b""), (1024, 1024 * b"\0"), (1024, 1024 * b"\xff")],
    ids=["a byte too many", "a byte too few", "a block of zeros", "a block of ones"],
)
def test_damage_in_the_middle_is_seen(tmp_path, name, version, share, n_lost, inserted):
    path = tmp_path / name
    whole = write_raw(path, version)
    at = int(share * len(whole))
    path.write_bytes(whole[:at] + inserted + whole[at + n_lost :])
    with pytest.raises(SsacError, match=r"cam1\.\w+: is damaged: .*--allow-damaged"):
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
