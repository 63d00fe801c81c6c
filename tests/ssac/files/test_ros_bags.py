"""ROS bags: topics, tracks, and what is refused of them."""

import sys

import numpy as np
import pytest

from ssac.errors import SsacError
from ssac.events import events_from_arrays
from ssac.files.damage import Reading
from ssac.files.event_files import load_events
from ssac.files.ros_bags import topic_of
from ssac.files.track_files import is_track_file, load_track
from ssac.points import PointTrack
from tests.ssac.bags import PER_MESSAGE, arrays, mono, packets, points, write_bag
from tests.ssac.files.test_event_files import random_events

EVENTS = random_events(3 * PER_MESSAGE)
OTHERS = events_from_arrays(EVENTS["t"] + 5, EVENTS["y"], EVENTS["x"] % 260, 1 - EVENTS["p"])
TRACK = PointTrack(1.7e9 + 0.04 * np.arange(20), np.linspace([3.5, 4.25], [300.0, 200.0], 20))
KINDS = (".bag", ".mcap", ".db3", "")


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_of_both_cameras_is_read_topic_by_topic(kind, tmp_path):
    topics = {"/left/events": arrays(EVENTS), "/right/events": mono(OTHERS), "/seen": points(TRACK)}
    bag = write_bag(tmp_path / f"flight{kind}", topics)
    for topic, events in (("left/events", EVENTS), ("right/events", OTHERS)):
        np.testing.assert_array_equal(load_events(bag / topic).events, events)
        assert not is_track_file(bag / topic)
    assert is_track_file(bag / "seen")
    found = load_track(bag / "seen")
    # Header times are whole nanoseconds, which doubles of today's seconds do not tell apart.
    np.testing.assert_allclose(found.times_s, TRACK.times_s, atol=5e-7, rtol=0)
    np.testing.assert_array_equal(found.points_px, TRACK.points_px)
    assert found.sigmas_px is None
    with pytest.raises(SsacError, match=r"2 topics, /left/events, /right/events: .* --topics /le"):
        load_events(bag)


@pytest.mark.parametrize("kind", KINDS)
def test_the_only_topic_of_events_is_taken_by_itself_and_else_that_of_points(kind, tmp_path):
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


def two_encodings(messages):
    kind, _ = messages
    words = np.array([0x8000_0000, 0x10], "<u4").tobytes()
    both = [*packets("evt2", [(0, words)])[1], *packets("evt3", [(1, words)])[1]]
    return kind, both


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
@pytest.mark.parametrize(
    ("topics", "inside", "message"),
    [
        ({"/seen": points(TRACK)}, "/seen", r"/seen holds points, a track: expected a topic of ev"),
        ({"/events": arrays(EVENTS)}, "/other", r"expected these on the topic /other \(dvs_msgs/.*"
         r"got the topics /events \(dvs_msgs/msg/EventArray\)"),
        ({"/events": packets("libcaer", [(0, b"")])}, "", "encoding mono, evt2 or evt3, got 'libc"),
        ({"/events": packets("evt3", [(0, b"abc")])}, "", r"not a readable ROS bag \(buffer size"),
        ({"/events": packets("mono", [(0, b"abc")])}, "", r"not a readable ROS bag \(buffer size"),
        ({"/events": two_encodings(mono(EVENTS))}, "", r"got 346 x 260 px of evt2, 346 x 260 px"),
        ({"/events": packets("evt2", [(0, 40 * b"\xff\xff\xff\xf7")])}, "", "there are no events"),
        ({"/events": other_size(arrays(EVENTS))}, "", r"got 346 x 100 px of events, 346 x 260 "),
        ({"/events": arrays(EVENTS[:0])}, "", "there are no events"),
        ({"/events": arrays(EVENTS[::-1])}, "", "events must be sorted by time"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_one_error(topics, inside, message, suffix, tmp_path):
    bag = write_bag(tmp_path / f"flight{suffix}", topics)
    with pytest.raises(SsacError, match=rf"flight[.]{suffix[1:]}\S*: .*{message}"):
        load_events(bag / inside.strip("/"))


def test_a_bag_without_events_or_points_says_what_it_has(tmp_path):
    bag = write_bag(tmp_path / "flight.mcap", {})
    with pytest.raises(SsacError, match=r"expected a topic of events or points .* the topics none"):
        load_events(bag)
    with pytest.raises(SsacError, match=r"nix[.]bag: there is no such file"):
        load_events(tmp_path / "nix.bag")


@pytest.mark.filterwarnings("ignore:.* is damaged")
@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9, 0.999])
def test_a_bag_that_is_cut_off_is_refused(share, suffix, tmp_path):
    bag = write_bag(tmp_path / f"flight{suffix}", {"/events": arrays(random_events(9000))})
    whole = bag.read_bytes()
    bag.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(SsacError, match=rf"flight[.]{suffix[1:]}: "):
        load_events(bag)


def test_missing_messages_are_seen_and_what_is_left_is_read_if_allowed(tmp_path):
    folder = write_bag(tmp_path / "flight", {"/events": arrays(EVENTS)})
    about = folder / "metadata.yaml"
    about.write_text(about.read_text().replace("message_count: 3", "message_count: 5"))
    with pytest.raises(SsacError, match=r"is damaged: 2 of 5 messages are missing"):
        load_events(folder)
    with pytest.warns(UserWarning, match=r"what is left of it is read: 2 of 5 messages"):
        assert len(load_events(folder, Reading(allow_damaged=True)).events) == len(EVENTS)


def test_a_message_that_cannot_be_read_ends_what_is_allowed_to_be_damaged(tmp_path):
    kind, messages = mono(EVENTS)
    broken = packets("mono", [(EVENTS["t"][-1], b"abc")])[1]
    bag = write_bag(tmp_path / "flight.bag", {"/events": (kind, [*messages, *broken])})
    with pytest.raises(SsacError, match="not a readable ROS bag"):
        load_events(bag)
    with pytest.warns(UserWarning, match="no further than its first 3 messages"):
        assert len(load_events(bag, Reading(allow_damaged=True)).events) == len(EVENTS)


def test_without_the_library_it_is_named(tmp_path, monkeypatch):
    bag = write_bag(tmp_path / "flight.bag", {"/events": arrays(EVENTS)})
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(SsacError, match=r"flight[.]bag: ROS bags need .*: pip install rosbags"):
        load_events(bag)
