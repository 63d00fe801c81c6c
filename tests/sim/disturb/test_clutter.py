"""What is added to a recording fires where, when and as often as it says."""

import numpy as np
import pytest

from sim.disturb import (
    CLUSTER_HZ,
    LAMP_HZ,
    LAMP_STEPS,
    DisturbConfig,
    View,
    clutter,
    merged,
    second_seed,
    thinned,
    wrong_intrinsics,
)
from sim.effects.pixels import CLUSTER_PX
from sim.errors import SimError

VIEW = View(346, 260, 2.0)

KINDS = {
    "lamp": DisturbConfig(lamp_px=6),
    "clusters": DisturbConfig(hot_clusters=5),
    "noise": DisturbConfig(noise_hz=1.0),
    "branches": DisturbConfig(branches=20_000),
    "people": DisturbConfig(people=3),
    "clouds": DisturbConfig(clouds_px_s=20.0),
}


def drawn(config: DisturbConfig, seed: int = 0, camera: int = 0) -> np.ndarray:
    return clutter(config, VIEW, seed, camera)


@pytest.mark.parametrize("kind", KINDS)
def test_clutter_is_in_order_within_view_and_time_and_drawn_by_seed_and_camera(kind: str) -> None:
    events = drawn(KINDS[kind])
    assert len(events) > 500
    assert np.all(np.diff(events["t"]) >= 0)
    assert 0 <= events["t"][0] <= events["t"][-1] < 1e6 * VIEW.duration_s
    assert events["x"].max() < VIEW.width
    assert events["y"].max() < VIEW.height
    assert np.array_equal(events, drawn(KINDS[kind]))
    for other in (drawn(KINDS[kind], camera=1), drawn(KINDS[kind], seed=1)):
        assert len(other) != len(events) or not np.array_equal(other, events)


def test_one_disturbance_more_leaves_the_others_as_they_are() -> None:
    both = drawn(DisturbConfig(hot_clusters=5, people=3))
    apart = merged(drawn(KINDS["clusters"]), drawn(KINDS["people"]))
    assert np.array_equal(both, apart)


def test_a_lamp_is_a_square_that_flickers_at_100_hz() -> None:
    events = drawn(KINDS["lamp"])
    assert np.ptp(events["x"]) + 1 == np.ptp(events["y"]) + 1 == 6
    # None is lost but what the jitter moves beyond the ends.
    assert len(events) == pytest.approx(36 * VIEW.duration_s * LAMP_HZ * 2 * LAMP_STEPS, rel=1e-3)
    phases = np.exp(2j * np.pi * LAMP_HZ * 1e-6 * events["t"][events["p"] == 1])
    # Two steps a quarter of a cycle apart; the jitter takes 0.2 % of it.
    assert abs(np.mean(phases)) == pytest.approx(np.cos(np.pi / 4), abs=0.01)
    assert np.mean(events["p"]) == pytest.approx(0.5, abs=1e-3)


def test_hot_clusters_are_squares_of_pixels_that_fire_on_and_on() -> None:
    events = drawn(KINDS["clusters"])
    pixels, counts = np.unique(events["x"].astype(int) * 1000 + events["y"], return_counts=True)
    assert len(pixels) == 5 * CLUSTER_PX**2  # of these seeds, no two overlap
    # Medians of 45 log-normal rates scatter by 1.25 * 0.7 / sqrt(45) = 13 %.
    assert np.median(counts) == pytest.approx(CLUSTER_HZ * VIEW.duration_s, rel=0.4)
    assert events["p"].all()


def test_noise_has_its_rate_everywhere() -> None:
    events = drawn(KINDS["noise"])
    expected = VIEW.width * VIEW.height * VIEW.duration_s
    assert len(events) == pytest.approx(expected, abs=5 * np.sqrt(expected))
    halves = [np.mean(events[name] < half) for name, half in (("x", 173), ("y", 130), ("t", 1e6))]
    assert halves == pytest.approx([0.5] * 3, abs=5 * 0.5 / np.sqrt(expected))


def test_branches_stay_about_their_places_and_fire_while_they_move() -> None:
    events = drawn(KINDS["branches"])
    assert 10_000 < len(events) <= 20_000  # some sway out of the view
    place = np.unique(events["x"] // 40 * 100 + events["y"] // 40)
    assert len(place) < 45  # of 63 tiles: a dozen places, each in four tiles at most


def test_people_walk_in_over_a_side() -> None:
    events = drawn(DisturbConfig(people=1))
    first, last = (events["x"][part].astype(float) for part in (slice(200), slice(-200, None)))
    sides = min(first.min(), VIEW.width - 1 - first.max())
    assert sides < 5
    assert abs(np.median(last) - np.median(first)) > 5  # 10 px/s for a second, at least
    assert np.ptp(events["y"]) <= 0.3 * VIEW.height


def test_of_a_second_object_a_share_is_kept() -> None:
    events = drawn(KINDS["noise"])
    for share in (0.0, 0.1, 1.0):
        kept = thinned(events, share, 0, 0)
        assert len(kept) == pytest.approx(share * len(events), abs=5 * np.sqrt(len(events) * 0.09))
    assert second_seed(3) != second_seed(4)
    assert 0 <= second_seed(2**32 - 1) < 2**32


def test_wrong_intrinsics_are_draws_of_the_stated_deviations() -> None:
    K = np.array([[200.0, 0.0, 173.0], [0.0, 210.0, 130.0], [0.0, 0.0, 1.0]])
    config = DisturbConfig(intrinsics_error=(1.0, 3.0))
    errors = []
    for seed in range(200):
        wrong, deviations_px = wrong_intrinsics(K, config, seed, seed % 2)
        assert deviations_px == pytest.approx([2.0, 2.1, 3.0, 3.0])
        difference = wrong - K
        errors.append(difference[[0, 1, 0, 1], [0, 1, 2, 2]] / deviations_px)
        difference[[0, 1, 0, 1], [0, 1, 2, 2]] = 0.0
        assert not difference.any()
    # A variance of 800 normal draws scatters by sqrt(2 / 800) = 5 %.
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.2)
    exact, none = wrong_intrinsics(K, DisturbConfig(), 0, 0)
    assert np.array_equal(exact, K)
    assert not none.any()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"noise_hz": -1.0}, "noise_hz must be 0 or a positive number, got -1.0"),
        ({"lamp_px": float("nan")}, "lamp_px must be 0 or a positive number, got nan"),
        ({"second_object": 1.5}, "second_object is a share, 0 to 1, got 1.5"),
        ({"intrinsics_error": (11.0, 0.0)}, "intrinsics_error needs 0 to 10 % and 0 px or more"),
    ],
)
def test_what_cannot_be_is_refused(values: dict, message: str) -> None:
    with pytest.raises(SimError, match=message):
        DisturbConfig(**values)


def test_a_lamp_larger_than_the_view_is_refused() -> None:
    with pytest.raises(SimError, match="a lamp of 300 x 300 px does not fit into a view of 346"):
        drawn(DisturbConfig(lamp_px=300))


def test_nothing_asked_for_is_nothing_added() -> None:
    assert DisturbConfig().is_none
    assert not any(config.is_none for config in KINDS.values())
    assert len(drawn(DisturbConfig())) == 0
