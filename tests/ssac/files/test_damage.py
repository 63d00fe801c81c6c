"""Damaged and unsorted files and ROS bags: which are refused, and what is read of the others."""

import re
import sys

import numpy as np
import pytest
from faery import EVENTS_DTYPE
from faery.file_encoder import events_to_file

from ssac import PointTrack, SsacError, load_events
from ssac.events import events_from_arrays
from ssac.files.damage import STRICT, Reading, readable
from ssac.files.hdf5 import save_events_h5
from ssac.files.ros_bags import bag_of, topic_of
from ssac.files.text import save_events_text
from ssac.files.track_files import is_track_file, load_track
from ssac.pipeline.opened import Recording
from tests.ssac.bags import PACKETS, PER_MESSAGE, arrays, mono, packets, points, write_bag
from tests.ssac.files.test_event_files import HEIGHT, WIDTH, faerys, random_events
from tests.ssac.synthetic import CAMERA

N = 4000
ALLOWED = Reading(allow_damaged=True)
ENCODINGS = [("cam1.raw", "evt2"), ("cam1.raw", "evt3"), ("cam1.dat", "dat2")]


def write_faery(path, version=None):
    faerys(version)(path, random_events(N))
    return path.read_bytes()


def refused_or_left(path, error, warning, reading=ALLOWED):
    """Return the events read of a file that is refused unless `reading` allows it."""
    with pytest.raises(SsacError, match=error):
        Recording(path, CAMERA, "camera 1", STRICT).read()
    with pytest.warns(UserWarning, match=warning):
        return Recording(path, CAMERA, "camera 1", reading).read().events


@pytest.mark.parametrize(("name", "version"), ENCODINGS)
@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_damage_in_the_middle_is_seen(tmp_path, name, version, share):
    path = tmp_path / name
    whole = write_faery(path, version)
    at = int(share * len(whole))
    for n_lost, inserted in (
        *((0, b"\x55"), (1, b"")),  # a byte too many or too few
        *((1024, 1024 * byte) for byte in (b"\0", b"\xff")),
    ):
        path.write_bytes(whole[:at] + inserted + whole[at + n_lost :])
        with pytest.raises(SsacError, match=r"cam1\.\w+: is damaged: .*--allow-damaged"):
            load_events(path)


def test_a_file_is_read_as_far_as_it_goes_where_that_is_allowed(tmp_path):
    path = tmp_path / "cam1.raw"
    path.write_bytes(write_faery(path, "evt2")[:-3])
    said = "is damaged, and what is left of it is read: 1 bytes"
    found = refused_or_left(path, "is damaged: 1 bytes", said)
    np.testing.assert_array_equal(found, random_events(N)[:-1])
    path, events = tmp_path / "cam1.aedat4", random_events(50_000)  # several packets
    blocks = iter(np.array_split(events.astype(EVENTS_DTYPE), 10))
    events_to_file(blocks, path, dimensions=(WIDTH, HEIGHT))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    said = "the table of its packets is at byte", "no further than its first"
    found = refused_or_left(path, *said)
    np.testing.assert_array_equal(found, events[: len(found)])
    assert 0.3 < len(found) / len(events) < 0.6  # of half the file, less a packet


def test_an_aedat4_header_takes_no_memory_by_its_size_and_its_xml_names_one_stream(tmp_path):
    path = tmp_path / "cam1.aedat4"
    whole = write_faery(path)
    path.write_bytes(whole[:14] + b"\xff\xff\xff\x7f" + whole[18:])
    with pytest.raises(SsacError, match="its header says that it has 2147483647 bytes"):
        load_events(path)
    for old, new, said in (
        (b"string", b"str\xe9ng", ".*its header.s XML: "),  # it made the library end the process
        (b"</dv>", b"</dw>", ".*its header.s XML: "),
        (b'"2.0"', b'"2.0<', ".*its header.s XML: "),
        (b">events</attr>", b">EVTS</attr>  ", "holds 2 streams of events: write each"),
    ):
        assert old in whole
        path.write_bytes(whole.replace(old, new, 1))
        with pytest.raises(SsacError, match=rf"cam1\.aedat4: {said}"):
            load_events(path, ALLOWED)


def test_events_late_by_microseconds_are_sorted_only_when_asked(tmp_path):
    mixed = random_events(N)
    mixed["t"][1:] -= 400 * (np.arange(1, N) % 3)  # neighbours and their neighbours change places
    expected = mixed[np.argsort(mixed["t"], kind="stable")]
    latest = np.maximum.accumulate(mixed["t"])
    n_back, late_us = np.sum(np.diff(mixed["t"]) < 0), np.max(latest - mixed["t"])
    for name, save in (("cam1.h5", save_events_h5), ("cam1.txt", save_events_text)):
        save(tmp_path / name, mixed, WIDTH, HEIGHT)
        said = (
            f"{n_back} of 4000 come up to {late_us} us too late: sort them with --sort",
            f"{n_back} of 4000 events came up to {late_us} us too late",
        )
        found = refused_or_left(tmp_path / name, *said, Reading(sort=True))
        np.testing.assert_array_equal(found, expected)
    mixed["t"][N // 2 :] -= 3000  # which none sorts
    save_events_h5(path := tmp_path / "cam1.h5", mixed, WIDTH, HEIGHT)
    with pytest.warns(UserWarning, match=r"2000 of 4000 events \(50 %\) are left out"):
        assert len(load_events(path, Reading(allow_damaged=True, sort=True)).events) == N // 2


def test_events_that_are_repeated_32_times_are_damage_but_not_in_text(tmp_path):
    events = random_events(N)
    for first, n in ((100, 40), (200, 31), (300, 32)):
        events[first : first + n] = events[first]
    save_events_h5(tmp_path / "cam1.h5", events, WIDTH, HEIGHT)
    said = "72 events stand there 32 times in a row or more"
    np.testing.assert_array_equal(refused_or_left(tmp_path / "cam1.h5", said, said), events)
    save_events_text(tmp_path / "cam1.txt", events, WIDTH, HEIGHT)
    np.testing.assert_array_equal(load_events(tmp_path / "cam1.txt").events, events)


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
@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (None, None)], ids=["stated", "of the rig"])
def test_what_does_not_fit_is_left_out_if_allowed(
    tmp_path, part, field, shift, error, warning, size
):
    path, events = tmp_path / "cam1.h5", random_events(N)
    changed = events.copy()
    changed[field][part] += shift
    save_events_h5(path, changed, *size)
    found = refused_or_left(path, error, rf"cam1\.h5:? .*{warning}")
    np.testing.assert_array_equal(found, np.delete(events, part))


# --- ROS bags ---

EVENTS = random_events(3 * PER_MESSAGE)
OTHERS = events_from_arrays(EVENTS["t"] + 5, EVENTS["y"], EVENTS["x"] % 260, 1 - EVENTS["p"])
TRACK = PointTrack(1.7e9 + 0.04 * np.arange(20), np.linspace([3.5, 4.25], [300.0, 200.0], 20))


@pytest.mark.parametrize("kind", [".bag", ".mcap", ".db3", ""])
def test_a_bag_is_read_topic_by_topic_and_its_only_topic_by_itself(kind, tmp_path):
    topics = {"/left/events": arrays(EVENTS), "/right/events": mono(OTHERS), "/seen": points(TRACK)}
    bag = write_bag(tmp_path / f"flight{kind}", topics)
    for topic, events in (("left/events", EVENTS), ("right/events", OTHERS)):
        np.testing.assert_array_equal(load_events(bag / topic).events, events)
        assert not is_track_file(bag / topic)
    assert is_track_file(bag / "seen")
    found = load_track(bag / "seen")
    # Header times are whole nanoseconds, which float64 of Unix seconds does not resolve.
    np.testing.assert_allclose(found.times_s, TRACK.times_s, atol=5e-7, rtol=0)
    np.testing.assert_array_equal(found.points_px, TRACK.points_px)
    assert found.sigmas_px is None
    with pytest.raises(SsacError, match=r"2 topics, /left/events, /right/events: .*/left/events$"):
        load_events(bag)
    bag = write_bag(tmp_path / f"a{kind}", {"/seen": points(TRACK), "/events": arrays(EVENTS)})
    assert topic_of(bag).name == "/events"
    assert len(load_events(bag).events) == len(EVENTS)
    bag = write_bag(tmp_path / f"b{kind}", {"/seen": points(TRACK)})
    assert is_track_file(bag)
    assert len(load_track(bag)) == len(TRACK)


def other_size(messages):
    kind, (first, *rest) = messages
    t_us, fields = first
    return kind, [(t_us, lambda types: fields(types) | {"height": 100}), *rest]


WORDS = np.array([0x8000_0000, 0x10], "<u4").tobytes()
TWO_ENCODINGS = PACKETS, [packets(f"evt{k}", [(k, WORDS)])[1][0] for k in (2, 3)]


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
@pytest.mark.parametrize(
    ("topics", "inside", "message"),
    [
        ({"/seen": points(TRACK)}, "/seen", r"/seen holds points, a track: expected a topic of ev"),
        ({"/events": arrays(EVENTS)}, "/other", r"there is no topic /other, only /events"
         r" \(dvs_msgs/msg/EventArray\): name one"),
        ({"/events": packets("libcaer", [(0, b"")])}, "", "encoding mono, evt2 or evt3, got 'libc"),
        ({"/events": packets("evt3", [(0, b"abc")])}, "", r"not a readable ROS bag \(buffer size"),
        ({"/events": packets("mono", [(0, b"abc")])}, "", r"not a readable ROS bag \(buffer size"),
        ({"/events": TWO_ENCODINGS}, "", r"got 346 x 260 px of evt2, 346 x 260 px"),
        ({"/events": packets("evt2", [(0, 40 * b"\xff\xff\xff\xf7")])}, "", "there are no events"),
        ({"/events": other_size(arrays(EVENTS))}, "", r"got 346 x 100 px of events, 346 x 260 "),
        ({}, "", r"expected a topic of events or points .* the topics none"),
        ({"/events": arrays(EVENTS[:0])}, "", "there are no events"),
        ({"/events": arrays(EVENTS[::-1])}, "", "events must be sorted by time"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_one_error(topics, inside, message, suffix, tmp_path):
    bag = write_bag(tmp_path / f"flight{suffix}", topics)
    with pytest.raises(SsacError, match=rf"flight[.]{suffix[1:]}\S*: .*{message}"):
        load_events(bag / inside.strip("/"))


@pytest.mark.filterwarnings("ignore:.* is damaged")
@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9, 0.999])
def test_a_bag_that_is_cut_off_is_refused(share, suffix, tmp_path):
    bag = write_bag(tmp_path / f"flight{suffix}", {"/events": arrays(random_events(9000))})
    whole = bag.read_bytes()
    bag.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(SsacError, match=rf"flight[.]{suffix[1:]}: "):
        load_events(bag)


def test_what_is_left_of_a_bag_is_read_if_allowed_as_far_as_its_messages_can_be_read(tmp_path):
    folder = write_bag(tmp_path / "flight", {"/events": arrays(EVENTS)})
    about = folder / "metadata.yaml"
    about.write_text(about.read_text().replace("message_count: 3", "message_count: 5"))
    said = "damaged: 2 of 5 messages are missing", "what is left of it is read: 2 of 5 messages"
    assert len(refused_or_left(folder, *said)) == len(EVENTS)
    kind, messages = mono(EVENTS)
    broken = packets("mono", [(EVENTS["t"][-1], b"abc")])[1]
    bag = write_bag(tmp_path / "flight.bag", {"/events": (kind, [*messages, *broken])})
    said = "not a readable ROS bag", "no further than its first 3 messages"
    assert len(refused_or_left(bag, *said)) == len(EVENTS)


def test_a_size_that_a_library_believes_is_damage_and_no_lack_of_memory(tmp_path):
    said = "a.bag: not a readable ROS bag (a size in it is larger than the memory here): copy or"
    with (
        pytest.raises(SsacError, match=re.escape(said)),
        readable(tmp_path / "a.bag", "a readable ROS bag"),
    ):
        np.empty(2**58)


def test_without_the_library_it_is_named(tmp_path, monkeypatch):
    bag = write_bag(tmp_path / "flight.bag", {"/events": arrays(EVENTS)})
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(SsacError, match=r'flight[.]bag: .*: pip install "ssac-suite\[ros\]"$'):
        load_events(bag)


def test_a_compressed_file_of_a_bag_is_no_damaged_one_and_other_metadata_make_no_bag(tmp_path):
    folder = write_bag(tmp_path / "flight", {"/events": arrays(EVENTS)})
    (file,) = folder.glob("*.db3")
    assert len(load_events(file).events) == len(EVENTS)
    about = folder / "metadata.yaml"
    text = about.read_text()
    about.write_text(text.replace("compression_mode: ''", "compression_mode: MESSAGE"))
    assert about.read_text() != text
    for path in (file, file.rename(f"{file}.zstd")):
        path.touch()
        with pytest.raises(SsacError, match=r"is compressed: give its folder with metadata[.]yaml"):
            load_events(path)
    about.write_text("camera: left\n")
    assert bag_of(folder) is None
    for path in (folder, folder / "missing.h5"):
        with pytest.raises(SsacError, match=r"is a folder: give|there is no such file"):
            load_events(path)
