"""Pixels that fire by themselves are masked, lone events removed, faint objects followed."""

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from ssac import load_track
from ssac.config import N_MIN
from ssac.events import EVENT_DTYPE, events_from_arrays
from ssac.files.hdf5 import save_events_h5
from ssac.rules import FaintRules, NoiseRules
from ssac.track.denoise import least_neighbours, masked_pixels, radius_filter, without_noise
from ssac.track.faint import follow
from tests.ssac.cluttered import lamp, merged, noise, pixel_events
from tests.ssac.command import run
from tests.ssac.synthetic import events_at
from tests.ssac.tracks import rig_document

WIDTH, HEIGHT = 96, 80
LONG_US = 6_000_000
RULES = NoiseRules()


def mask_of(events):
    return masked_pixels(events, WIDTH, HEIGHT, RULES)[0]


def pixels(*squares):
    found = np.zeros((HEIGHT, WIDTH), bool)
    for x, y, size_px in squares:
        found[y : y + size_px, x : x + size_px] = True
    return found


def blob(path, n=60_000, deviation_px=1.8, duration_us=LONG_US, size=(WIDTH, HEIGHT)):
    """Events normally distributed about path(times [s]) -> (x, y) [px]."""
    rng = np.random.default_rng(0)
    times_s = np.sort(rng.uniform(0.0, 1e-6 * duration_us, n))
    points_px = np.stack(path(times_s), axis=-1) + rng.normal(0.0, deviation_px, (n, 2))
    return events_at(times_s, points_px, size)


def flight(t_s):
    return 48 + 30 * np.sin(2.3 * t_s), 40 + 25 * np.sin(3.1 * t_s)


def hover(t_s):
    """Stay within 1.5 px of one place for half of each 3 s, and go away in between."""
    away = np.clip(np.abs((t_s % 3.0) - 1.5) - 0.75, 0.0, None)
    return 48 + 60 * away + 1.5 * np.sin(7.0 * t_s), 40 + 1.5 * np.cos(5.0 * t_s)


PATHS = {
    "flight": flight,
    "hover": hover,
    "to and fro": lambda t_s: (48 + 6 * np.sin(12.0 * t_s), 40 + 4 * np.sin(17.0 * t_s)),
    "still": lambda t_s: (48 + 1.5 * np.sin(7.0 * t_s), 40 + 1.5 * np.cos(5.0 * t_s)),
    "round": lambda t_s: (32 + 20 * np.cos(np.pi * t_s), 24 + 15 * np.sin(2 * np.pi * t_s)),
}


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("hz", [0.0, 10.0])
def test_what_moves_is_not_masked(path, hz):
    assert not mask_of(merged(blob(PATHS[path]), noise(WIDTH, HEIGHT, hz, LONG_US))).any()


def hot(x, y, size_px, duration_us=LONG_US):
    """A square of hot pixels, each of which fires at random times of its own."""
    places = np.argwhere(pixels((x, y, size_px)))
    return merged(*(pixel_events(column, row, 700, duration_us) for row, column in places))


LONE = [(10, 10)], [(10, 10), (11, 10)], [(0, 0), (63, 47)], [(30, 5), (31, 6)]


@pytest.mark.parametrize(
    ("fires", "squares", "hz", "duration_us"),
    [
        # Alone in a corner, and where the object passes.
        *((lamp, [(*place, 3)], 10.0, LONG_US) for place in ((3, 60), (40, 35))),
        *((lamp, [(*place, 12)], 0.0, LONG_US) for place in ((3, 60), (40, 35))),
        (hot, [(5, 5, 3), (30, 60, 3), (80, 20, 3)], 0.2, LONG_US),
        # Lone pixels are told in short recordings, too.
        *((hot, [(*place, 1) for place in places], 1.0, 1_000_000) for places in LONE),
    ],
)
def test_what_fires_by_itself_is_masked_whole_and_nothing_else(fires, squares, hz, duration_us):
    parts = [fires(*square, duration_us) for square in squares]
    parts += [noise(WIDTH, HEIGHT, hz, duration_us)] + [blob(flight)] * (duration_us == LONG_US)
    events = merged(*parts)
    late = events.copy()
    late["t"] += 3_600_000_000
    for recorded in (events, merged(events, late)):  # a gap changes nothing
        np.testing.assert_array_equal(mask_of(recorded), pixels(*squares))


def test_a_short_recording_tells_no_lamp_and_a_clean_one_has_no_background():
    # A thin bar that sweeps, and then stands still and flickers for most of a short recording.
    bar = [pixel_events(x, y, 6) for x in range(5, 50) for y in range(10, 25)]
    bar += [pixel_events(50, y, 700) for y in range(10, 25)]
    for events in (lamp(40, 35, 6, 1_500_000), merged(*bar), np.empty(0, EVENT_DTYPE)):
        assert not mask_of(events).any()
    assert mask_of(lamp(40, 35, 6, 3_000_000)).any()
    assert masked_pixels(blob(flight), WIDTH, HEIGHT, RULES)[1] == 0.0


@pytest.mark.parametrize("hz", [0.2, 1.0, 10.0])
def test_the_background_is_that_of_ordinary_pixels(hz):
    start = noise(WIDTH, HEIGHT, 1000.0, 20_000)  # at first, every pixel fires again and again
    parts = blob(flight), lamp(3, 60, 12, LONG_US), noise(WIDTH, HEIGHT, hz, LONG_US), start
    _, found_hz = masked_pixels(merged(*parts), WIDTH, HEIGHT, RULES)
    # The object and the lamp fill 7 of 30 squares, which shifts the middle of all by a quarter of
    # the deviation; and a Poisson number's median is 1/3 below its mean: at 0.2 Hz, 1/3 of 5.
    of_square = hz * 25.6
    assert found_hz == pytest.approx(hz, rel=0.3 / of_square + 0.35 / of_square**0.5)


@st.composite
def bursts(draw):
    """Bursts of unlike density, far apart or not; in whole ms, many lie just on a boundary."""
    burst = st.tuples(st.integers(1, 9000), st.integers(1, 40_000), st.integers(0, 99))
    step_us = draw(st.sampled_from([1, 1000]))
    parts, first_us = [], draw(st.sampled_from([0, 1_700_000_000_000_000]))
    for n, duration_us, seed in draw(st.lists(burst, min_size=1, max_size=4)):
        rng = np.random.default_rng(seed)
        t = first_us + step_us * np.sort(rng.integers(0, duration_us // step_us + 1, n))
        x, y = rng.integers(0, [[64], [48]], (2, n))  # a part of the sensor, so that they are dense
        parts.append(events_from_arrays(t, x, y, np.zeros(n, int)))
        first_us = t[-1] + draw(st.sampled_from([0, 4000, 10_000_000_000]))
    return np.concatenate(parts)


BALLS = [(5.0, 1.0, 20), (4.3, 1.0, 12), (2.5, 0.5, 2), (1.0, 4.0, 1), (0.5, 4.0, 1),
         (9.0, 1.0, 100)]  # fmt: skip


@pytest.mark.parametrize("ball", BALLS)
@given(bursts())
def test_the_filter_equals_a_k_d_tree(ball, events):
    radius_px, ms_per_unit, n_neighbours = ball
    us_per_px = 1000.0 * ms_per_unit  # whole numbers keep distances on the boundary exact
    t = events["t"] - events["t"][0]
    points = np.column_stack([t, events["x"] * us_per_px, events["y"] * us_per_px])
    n_found = cKDTree(points).query_ball_point(points, radius_px * us_per_px, return_length=True)
    before = events.copy()
    kept = radius_filter(events, *ball)
    np.testing.assert_array_equal(kept, events[n_found - 1 >= n_neighbours])
    np.testing.assert_array_equal(events, before)


def test_neighbours_must_be_as_many_as_asked():
    left, found = without_noise(small(15_000), WIDTH, HEIGHT, 9, RULES)
    assert (found.radius_px, found.n_neighbours) == (RULES.ball_px, 9)
    np.testing.assert_array_equal(left, radius_filter(small(15_000), n_neighbours=9))
    assert len(without_noise(np.empty(0, EVENT_DTYPE), WIDTH, HEIGHT, None, RULES)[0]) == 0


def test_noise_alone_leaves_at_most_an_event_in_a_window():
    for hz in (0.2, 2.0, 10.0):
        n = least_neighbours(hz, 64 * 48, RULES.ball_px, 1000, RULES)
        left = radius_filter(noise(64, 48, hz, 20_000_000), n_neighbours=n)
        # The limit is one in each of 500 windows, with a Poisson deviation of 22; the events of
        # one ball are kept together, so three deviations are allowed.
        assert len(left) < 500 + 3 * 22
        assert n >= RULES.least_neighbours
        assert least_neighbours(hz, 64 * 48, RULES.ball_px, 6, RULES) <= 6


def small(n):
    return blob(PATHS["round"], n, 0.9, 10_000_000)


@pytest.mark.parametrize(
    ("rate_hz", "noise_hz", "ball"),
    [
        # A thin object; a dense one, as in the paper; one in much noise.
        (1_500, 0.1, (RULES.ball_px, RULES.least_neighbours, RULES.least_n_min)),
        (20_000, 0.1, (RULES.ball_px, RULES.ball_neighbours, N_MIN)),
        (20_000, 10.0, (RULES.near_ball_px, RULES.near_ball_neighbours, N_MIN)),
    ],
)
def test_a_thin_object_needs_fewer_neighbours_and_one_in_much_noise_nearer_ones(
    rate_hz, noise_hz, ball
):
    ours = small(10 * rate_hz)
    events = merged(ours, noise(WIDTH, HEIGHT, noise_hz, 10_000_000))
    left, found = without_noise(events, WIDTH, HEIGHT, None, RULES)
    by_paper = radius_filter(events)
    assert (found.radius_px, found.n_neighbours, found.n_min) == ball
    assert found.is_adapted == (ball != (RULES.ball_px, RULES.ball_neighbours, N_MIN))
    if not found.is_adapted:
        np.testing.assert_array_equal(left, by_paper)
    elif noise_hz == 10.0:  # less of the noise beside the object is left
        assert len(ours) < len(left) < len(by_paper)
    else:
        assert abs(len(left) - len(ours)) < 0.1 * len(ours)
        assert len(by_paper) < 0.1 * len(ours)


# --- A faint object ---

SIZE, DURATION_S = (120, 90), 12.0
GAP_S = 5.0, 8.0  # in which the object is weak
NOISE = noise(*SIZE, 0.4, round(1e6 * DURATION_S))  # as of a DAVIS346
FAINT = FaintRules()


def path_px(times_s):
    """Positions of a drone some 35 m away, whose image accelerates by up to 25 px/s^2."""
    return np.stack([60.0 + 40.0 * np.sin(0.5 * times_s), 45.0 + 25.0 * np.cos(times_s)], axis=-1)


def recorded(weak_hz, seed=0, last_s=DURATION_S):
    """All events, the sure ones and the object's, which is weak in the gap and ends at `last_s`."""
    rng = np.random.default_rng(seed)

    def seen(start_s, end_s, rate_hz):
        t = np.sort(rng.uniform(start_s, end_s, int(rate_hz * max(end_s - start_s, 0.0))))
        return events_at(t, path_px(t) + [2.0, 1.0] * rng.standard_normal((len(t), 2)), SIZE)

    weak = seen(GAP_S[0], min(GAP_S[1], last_s), weak_hz)
    sure = merged(seen(0.0, GAP_S[0], 600.0), seen(GAP_S[1], last_s, 600.0))
    ours = merged(sure, weak)
    return merged(ours, NOISE), sure, ours


def followed(events, sure):
    """The path found, and the middles [s] of its bins."""
    found = follow(events, sure, *SIZE, FAINT)
    bins = np.arange(len(found.seen)) + 0.5
    return found, 1e-6 * (found.start_us + FAINT.bin_us * bins)


@pytest.mark.parametrize("seed", range(3))
def test_a_weak_object_is_followed_through_a_gap(seed):
    events, sure, ours = recorded(120.0, seed)
    found, middles_s = followed(events, sure)
    in_gap = (middles_s > GAP_S[0]) & (middles_s < GAP_S[1])
    assert found.seen[in_gap].mean() > 0.98
    errors_px = np.linalg.norm(found.positions_px - path_px(middles_s), axis=1)
    assert np.max(errors_px[in_gap]) < 2.0  # 4 deviations of 0.5 px: 15 events of 2 px in 1/8 s
    of_gap = (ours["t"] > 1e6 * GAP_S[0]) & (ours["t"] < 1e6 * GAP_S[1])
    assert found.seen[(found.events["t"] - found.start_us) // FAINT.bin_us].all()
    # Of a normal distribution, 4 % lie outside the corridor; noise of 15 events/s lies within.
    n = np.count_nonzero((found.events["t"] > 5e6) & (found.events["t"] < 8e6))
    assert 0.85 < n / np.count_nonzero(of_gap) < 1.25


def test_noise_alone_is_not_followed():
    found, middles_s = followed(*recorded(0.0)[:2])
    # Near its ends, the window of half a second holds events of the object beside the gap.
    in_gap = (middles_s > GAP_S[0] + 0.3) & (middles_s < GAP_S[1] - 0.3)
    assert not found.seen[in_gap].any()
    assert found.seen[middles_s < GAP_S[0]].mean() > 0.98
    events, sure, _ = recorded(120.0)
    for few in (sure[:0], sure[:10]):  # too few to give a size
        assert follow(events, few, *SIZE, FAINT) is None


def test_a_path_that_leads_to_no_sure_place_is_kept_for_half_a_second():
    found, middles_s = followed(*recorded(120.0, last_s=GAP_S[1])[:2])
    # Events before the gap keep the object sure until 0.1 s after the gap begins.
    assert GAP_S[0] + 0.4 < middles_s[found.seen].max() < GAP_S[0] + 0.65


def test_a_clock_that_shows_more_changes_nothing():
    events, sure, _ = recorded(120.0)
    found, _ = followed(events, sure)
    for each in (events, sure):
        each["t"] += 1_700_000_000_000_000
    later, _ = followed(events, sure)
    np.testing.assert_array_equal(found.events[["x", "y", "p"]], later.events[["x", "y", "p"]])


def track(folder, events, *options, code=0):
    save_events_h5(folder / "cam.h5", events, *SIZE)
    rig = rig_document(intrinsics=[200.0, 200.0, 60.0, 45.0], resolution=[*SIZE])
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    files = folder / "cam.h5", "--rig", folder / "rig.yaml", "--out", folder / "cam.csv"
    _, _, err = run("track", *files, "--faint", *options, code=code)
    return err, folder / "cam.csv"


POINTS = ("--half-window", "0.05", "--n-min", "8")


def test_a_faint_object_has_a_track_where_it_is_weak(tmp_path):
    _, out = track(tmp_path, recorded(120.0)[0], *POINTS)
    found = load_track(out)
    weak = (found.times_s > GAP_S[0]) & (found.times_s < GAP_S[1])
    assert np.count_nonzero(weak) > 0.9 * 100 * (GAP_S[1] - GAP_S[0])  # a point each 10 ms
    errors_px = np.linalg.norm(found.points_px - path_px(found.times_s), axis=1)
    # 12 events of an image of 2 px give a deviation of 0.6 px in each coordinate; five of those.
    assert np.max(errors_px[weak]) < 3.0


@pytest.mark.parametrize(
    ("options", "message"), [(POINTS, "no object is seen"), (["--no-denoise"], "leave one out")]
)
def test_noise_alone_and_noise_that_is_kept_are_refused(tmp_path, options, message):
    err, out = track(tmp_path, NOISE, *options, code=2)
    assert (err.count("\n"), out.exists()) == (1, False)
    assert message in err
