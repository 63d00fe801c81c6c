"""Several things before one camera: whether there are, and how far each can be followed."""

import numpy as np
import pytest

from ssac.events import EVENT_DTYPE
from ssac.rules import ObjectRules
from ssac.track.objects import objects_of, seem_several
from tests.ssac.crowds import branches, flight, mixed
from tests.ssac.synthetic import CAMERA, make_events, make_scene, track_pair

RULES = ObjectRules()


@pytest.fixture(scope="module")
def both():
    """One camera's events of two flights, which is which, and what is found."""
    events, thing = mixed(flight(4)[0], flight(5)[0])
    return events, thing, objects_of(events, CAMERA, RULES)


@pytest.mark.parametrize("size_m", [0.2, 0.8])  # images of 8 and 32 px
def test_one_thing_seems_one(size_m):
    for events in make_events(make_scene(4, duration_s=8.0), 4, size_m=size_m):
        assert not seem_several(events, CAMERA, RULES)
    assert not seem_several(np.empty(0, EVENT_DTYPE), CAMERA, RULES)


def test_the_parts_of_a_large_thing_are_one():
    events = make_events(make_scene(6, duration_s=8.0), 6, size_m=1.6)[1]
    assert seem_several(events, CAMERA, RULES)  # points of a cloud of 64 px do not hang together
    assert not objects_of(events, CAMERA, RULES).are_several


@pytest.mark.parametrize("share", [0.1, 0.2, 1.0])
def test_two_things_seem_several(share):
    for one, other in zip(flight(4), flight(5, share), strict=True):
        assert seem_several(mixed(one, other)[0], CAMERA, RULES)


def test_each_piece_is_of_one_thing(both):
    events, thing, found = both
    assert found.are_several
    assert found.n_seen == 2
    shares, n_bins = [], 0
    for piece in found.pieces:
        share = np.mean(thing[found.events_of([piece])])
        shares.append(max(share, 1.0 - share))
        n_bins += len(piece.positions_px)
    # Where two touch, a bin or two of the few at a piece's ends hold both.
    assert np.mean(np.array(shares) > 0.97) > 0.9
    # Both are in view most of the time, and apart for most of that.
    assert n_bins > 1.2 * np.ptp(events["t"]) / RULES.bin_us


def test_pieces_follow_the_path():
    scene = make_scene(4, duration_s=8.0)
    found = objects_of(make_events(scene, 4, size_m=0.4)[0], CAMERA, RULES)
    for piece in found.pieces:
        bins = np.arange(piece.first, piece.last)
        times_s = 1e-6 * (found.start_us + RULES.bin_us * (bins + 0.5))
        inner = (times_s > 0.02) & (times_s < 7.98)  # bins that the flight fills
        apart_px = np.linalg.norm(piece.positions_px - track_pair(scene, times_s)[0], axis=1)
        # 500 events of 16 px lie 0.3 px from their mean; what leaves the view is cut.
        assert np.median(apart_px[inner]) < 0.5


def test_what_stays_in_its_place_is_no_piece():
    events, thing = mixed(flight(4)[0], branches(1))
    found = objects_of(events, CAMERA, RULES)
    assert found.are_several
    assert found.n_seen > 2
    chosen = thing[found.events_of(found.pieces)]
    assert len(chosen) > 0.3 * np.count_nonzero(thing == 0)
    # Leaves beyond the cells that they fill in a third of the bins are few.
    assert np.mean(chosen) < 0.02
