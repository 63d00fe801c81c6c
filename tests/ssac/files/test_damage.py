"""Event files that are damaged or unsorted: refused with what is wrong, or read as asked for."""

import numpy as np
import pytest
from faery import EVENTS_DTYPE
from faery.file_encoder import events_to_file

from ssac.errors import SsacError
from ssac.files.damage import Reading
from ssac.files.event_files import load_events
from ssac.files.hdf5 import save_events_h5
from ssac.files.text import save_events_text
from tests.ssac.files.test_event_files import HEIGHT, WIDTH, faerys, random_events

N = 4000
ALLOWED = Reading(allow_damaged=True)
ENCODINGS = [("cam1.raw", "evt2"), ("cam1.raw", "evt3"), ("cam1.dat", "dat2")]


def write_faery(path, version=None):
    faerys(version)(path, random_events(N))
    return path.read_bytes()


@pytest.mark.parametrize(("name", "version"), ENCODINGS)
@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
@pytest.mark.parametrize(
    ("n_lost", "inserted"),
    [(0, b"\x55"), (1, b""), (1024, 1024 * b"\0"), (1024, 1024 * b"\xff")],
    ids=["a byte too many", "a byte too few", "a block of zeros", "a block of ones"],
)
def test_damage_in_the_middle_is_seen(tmp_path, name, version, share, n_lost, inserted):
    path = tmp_path / name
    whole = write_faery(path, version)
    at = int(share * len(whole))
    path.write_bytes(whole[:at] + inserted + whole[at + n_lost :])
    with pytest.raises(SsacError, match=r"cam1\.\w+: is damaged: .*--allow-damaged"):
        load_events(path)


def test_a_raw_file_is_read_as_far_as_it_goes_where_that_is_allowed(tmp_path):
    path = tmp_path / "cam1.raw"
    path.write_bytes(write_faery(path, "evt2")[:-3])
    with pytest.warns(UserWarning, match="is damaged, and what is left of it is read: 1 bytes"):
        file = load_events(path, ALLOWED)
    np.testing.assert_array_equal(file.events, random_events(N)[:-1])


def test_of_a_truncated_aedat4_the_whole_packets_are_read(tmp_path):
    path, events = tmp_path / "cam1.aedat4", random_events(50_000)  # several packets
    blocks = iter(np.array_split(events.astype(EVENTS_DTYPE), 10))
    events_to_file(blocks, path, dimensions=(WIDTH, HEIGHT))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SsacError, match="the table of its packets is at byte"):
        load_events(path)
    with pytest.warns(UserWarning, match="no further than its first"):
        found = load_events(path, ALLOWED).events
    np.testing.assert_array_equal(found, events[: len(found)])
    assert 0.3 < len(found) / len(events) < 0.6  # of half the file, less a packet


def test_an_aedat4_header_takes_no_memory_by_its_size_and_its_xml_must_be_parsed(tmp_path):
    path = tmp_path / "cam1.aedat4"
    whole = write_faery(path)
    path.write_bytes(whole[:14] + b"\xff\xff\xff\x7f" + whole[18:])
    with pytest.raises(SsacError, match="its header says that it has 2147483647 bytes"):
        load_events(path)
    for old, new in ((b"string", b"str\xe9ng"), (b"</dv>", b"</dw>"), (b'"2.0"', b'"2.0<')):
        assert old in whole
        path.write_bytes(whole.replace(old, new, 1))
        with pytest.raises(SsacError, match=r"cam1\.aedat4: .*its header.s XML: "):
            load_events(path, ALLOWED)  # of the first the library would end the process


def test_events_late_by_microseconds_are_sorted_only_when_asked(tmp_path):
    mixed = random_events(N)
    mixed["t"][1:] -= np.where(np.arange(1, N) % 2, 400, 0)  # neighbours change places
    expected = mixed[np.argsort(mixed["t"], kind="stable")]
    for name, save in (("cam1.h5", save_events_h5), ("cam1.txt", save_events_text)):
        save(tmp_path / name, mixed, WIDTH, HEIGHT)
        with pytest.raises(SsacError, match=r"must be sorted by .* sort them with --sort"):
            load_events(tmp_path / name)
        with pytest.warns(UserWarning, match="of 4000 events came up to .* us too late"):
            file = load_events(tmp_path / name, Reading(sort=True))
        np.testing.assert_array_equal(file.events, expected)


BREAKS = r"sorted by time|leaps of time by more than 3600 s"
LONGER = r"1000 of 4000 events \(25 %\) are left out"  # of the two parts the longer is kept


@pytest.mark.parametrize(
    ("part", "field", "shift", "error", "warning"),
    [
        (slice(3000, None), "t", -900_000, BREAKS, LONGER),
        (slice(3000, None), "t", 10**13, BREAKS, LONGER),
        (slice(7, 8), "x", 60_000, "there is an event at x = 60", "1 of 4000 events lie outside"),
    ],
)
def test_what_does_not_fit_is_left_out_where_that_is_allowed(
    tmp_path, part, field, shift, error, warning
):
    path, events = tmp_path / "cam1.h5", random_events(N)
    changed = events.copy()
    changed[field][part] += shift
    save_events_h5(path, changed, WIDTH, HEIGHT)
    with pytest.raises(SsacError, match=error):
        load_events(path)
    with pytest.warns(UserWarning, match=warning):
        file = load_events(path, ALLOWED)
    np.testing.assert_array_equal(file.events, np.delete(events, part))
