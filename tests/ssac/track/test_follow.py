"""A small object in noise, followed where it makes few events, and nothing where there is none."""

import numpy as np
import pytest

from ssac.events import EVENT_DTYPE, events_from_arrays
from ssac.track.faint import ACCELERATION, BIN_US, follow, smoothed_path
from tests.ssac.cluttered import merged

WIDTH, HEIGHT, DURATION_S = 120, 90, 12.0
SIGMAS_PX = np.array([2.0, 1.0])
NOISE_HZ = 0.4  # of a pixel, as of a DAVIS346 before clouds
GAP_S = 5.0, 8.0  # in which the object is weak


def path_px(times_s):
    """Turn at up to 25 px/s^2, as a drone some 35 m away."""
    return np.stack([60.0 + 40.0 * np.sin(0.5 * times_s), 45.0 + 25.0 * np.cos(times_s)], axis=-1)


def _object(rng, start_s, end_s, rate_hz):
    t = np.sort(rng.uniform(start_s, end_s, int(rate_hz * (end_s - start_s))))
    px = np.rint(path_px(t) + SIGMAS_PX * rng.standard_normal((len(t), 2))).astype(int)
    return events_from_arrays(
        np.rint(1e6 * t).astype(int), px[:, 0], px[:, 1], rng.integers(0, 2, len(t))
    )


def noise(rng):
    n = int(NOISE_HZ * WIDTH * HEIGHT * DURATION_S)
    t = np.sort(rng.integers(0, round(1e6 * DURATION_S), n))
    x, y = rng.integers(0, WIDTH, n), rng.integers(0, HEIGHT, n)
    return events_from_arrays(t, x, y, rng.integers(0, 2, n))


def recorded(weak_hz, seed=0, last_s=DURATION_S):
    """All events, those that are sure, and those of the object; weak in the gap, till the last."""
    rng = np.random.default_rng(seed)
    strong = [_object(rng, 0.0, GAP_S[0], 600.0)]
    weak = _object(rng, GAP_S[0], min(GAP_S[1], last_s), weak_hz)
    if last_s > GAP_S[1]:
        strong.append(_object(rng, GAP_S[1], last_s, 600.0))
    sure = np.concatenate(strong)
    ours = merged(sure, weak)
    return merged(ours, noise(rng)), sure, ours


def _middles_s(found):
    return 1e-6 * (found.start_us + BIN_US * (np.arange(len(found.seen)) + 0.5))


@pytest.mark.parametrize("seed", range(3))
def test_a_weak_object_is_followed_through_a_gap(seed):
    events, sure, ours = recorded(120.0, seed)
    found = follow(events, sure, WIDTH, HEIGHT)
    middles_s = _middles_s(found)
    in_gap = (middles_s > GAP_S[0]) & (middles_s < GAP_S[1])
    assert found.seen[in_gap].mean() > 0.98
    errors_px = np.linalg.norm(found.positions_px - path_px(middles_s), axis=1)
    assert np.max(errors_px[in_gap]) < 2.0  # 4 deviations of 0.5 px: 2 px by 15 events in 1/8 s
    of_gap = (ours["t"] > 1e6 * GAP_S[0]) & (ours["t"] < 1e6 * GAP_S[1])
    # 4 % of a normal image lie outside of the corridor; noise of 15 events/s lies within it.
    n = np.count_nonzero((found.events["t"] > 5e6) & (found.events["t"] < 8e6))
    assert 0.85 < n / np.count_nonzero(of_gap) < 1.25


def test_events_given_back_lie_in_the_corridor_where_the_object_is_seen():
    events, sure, _ = recorded(120.0)
    found = follow(events, sure, WIDTH, HEIGHT)
    bins = (events["t"] - found.start_us) // BIN_US
    ages_s = 1e-6 * (events["t"] - found.start_us - BIN_US * bins - BIN_US / 2)
    there = found.positions_px[bins] + ages_s[:, None] * found.velocities_px_s[bins]
    away = np.column_stack([events["x"], events["y"]]) - there
    inside = np.sum((away / found.half_sizes_px[bins]) ** 2, axis=1) < 1.0
    np.testing.assert_array_equal(found.events, events[inside & found.seen[bins]])


def test_noise_alone_is_not_followed():
    events, sure, _ = recorded(0.0)
    found = follow(events, sure, WIDTH, HEIGHT)
    middles_s = _middles_s(found)
    # Near its ends, the window of half a second holds events of the object beside the gap.
    in_gap = (middles_s > GAP_S[0] + 0.3) & (middles_s < GAP_S[1] - 0.3)
    assert not found.seen[in_gap].any()
    assert found.seen[middles_s < GAP_S[0]].mean() > 0.98


def test_a_path_that_leads_to_no_sure_place_is_kept_for_half_a_second():
    events, sure, _ = recorded(120.0, last_s=GAP_S[1])
    found = follow(events, sure, WIDTH, HEIGHT)
    last_s = _middles_s(found)[found.seen].max()
    # The object is sure until 0.1 s after the gap begins, by the events before.
    assert GAP_S[0] + 0.4 < last_s < GAP_S[0] + 0.65


def test_a_clock_that_shows_more_changes_nothing():
    events, sure, _ = recorded(120.0)
    later_events, later_sure = events.copy(), sure.copy()
    for each in (later_events, later_sure):
        each["t"] += 1_700_000_000_000_000
    found, later = (
        follow(each, strong, WIDTH, HEIGHT)
        for each, strong in ((events, sure), (later_events, later_sure))
    )
    np.testing.assert_array_equal(found.events[["x", "y", "p"]], later.events[["x", "y", "p"]])


def test_nothing_is_followed_where_nothing_is_sure():
    events, sure, _ = recorded(120.0)
    assert follow(events, np.empty(0, EVENT_DTYPE), WIDTH, HEIGHT) is None
    assert follow(events, sure[:10], WIDTH, HEIGHT) is None  # too few for a size


def test_the_path_is_as_uncertain_in_a_gap_as_a_random_acceleration_makes_it():
    step_s, n, gap = 0.02, 300, 100  # 2 s
    middle = n // 2
    variances = np.full(n, 1e-4)
    variances[middle - gap // 2 : middle + gap // 2] = np.inf
    times_s = step_s * np.arange(n)
    line = 10.0 + 7.0 * times_s
    positions, velocities, found = smoothed_path(line, variances, step_s, ACCELERATION)
    np.testing.assert_allclose(positions, line, atol=1e-3)  # by the prior of 0 +- 1000 px
    np.testing.assert_allclose(velocities, 7.0, atol=1e-1)
    # Between two known positions and velocities: density T^3 / 192, T one bin longer than the gap;
    # the ends' velocities are known to some 0.7 px/s, of 20 px/s that the acceleration makes.
    expected = ACCELERATION * ((gap + 1) * step_s) ** 3 / 192.0
    assert found[middle] == pytest.approx(expected, rel=0.1)
