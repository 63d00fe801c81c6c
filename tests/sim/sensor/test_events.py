"""Tests the events that thresholds, effects of real pixels and noise make of frames or crops."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effects.config import SENSOR_PRESETS, SensorEffects
from sim.effects.pixels import EffectsSensor
from sim.sensor.events import PRESETS, Sensor, SensorConfig, events_from_frames
from tests.sim.scenes import counts, reference_levels, rng, smooth_video

EPS = 1e-3
SHAPE = (50, 60)
FLICKER_RAD = 1.0  # away from crests, where a threshold may just be reached or not
IDEAL = SensorConfig()
# The general loop in place of the one for ideal pixels, by a dead time too short to matter.
SLOW = SensorConfig(refractory_s=1e-15)
DEAD = SensorConfig(refractory_s=0.01)
QUIET = SensorConfig(threshold_on=20.0, threshold_off=20.0)  # only noise makes events
FINE = SensorConfig(threshold_on=0.02, threshold_off=0.02)
# Pixels with effects in place of pixels without, by a latency too short to matter.
FAINT = SensorEffects(latency_s=1e-12)

SENSORS = {
    **{name: (config, None) for name, config in PRESETS.items()},
    **{f"{name}, effects": (one.sensor, one.effects) for name, one in SENSOR_PRESETS.items()},
}


def sensor_of(image, config, effects=None, time_s=0.0, background=None):
    """Make a sensor, whose pixels have effects unless these are None."""
    first = image.astype(np.float32)
    about = (first, time_s, rng(1), first if background is None else background)
    if effects is None:
        return Sensor(config, *about)
    return EffectsSensor(config, effects, rng(1001), FLICKER_RAD, *about)


def events_of(video, times_s, config=IDEAL, effects=None):
    """Events of a video (n, height, width) of linear light at times (n,) [s]."""
    sensor = sensor_of(video[0], config, effects, float(times_s[0]))
    feed(sensor, times_s[1:], np.ascontiguousarray(video[1:], np.float32))
    return sensor.finish(float(times_s[-1]))


def still_events(light, duration_s, config=QUIET, effects=None, shape=SHAPE):
    """Events of pixels that see constant light."""
    return sensor_of(np.full(shape, light), config, effects).finish(duration_s)


def feed(sensor, times_s, video):
    zeros = np.zeros(len(times_s), np.int64)
    sensor.feed(times_s, zeros, zeros, video)


def stepping(before, after, until_s, shape=(1, 1)):
    """A video of light that changes at 1 s, within a nanosecond, and its times."""
    times_s = np.array([0.0, 1.0, 1.0 + 1e-9, until_s])
    levels = np.array([before, before, after, after], np.float32)
    return np.broadcast_to(levels[:, None, None], (4, *shape)), times_s


def by_pixel(events):
    return events[np.lexsort((events["t"], events["x"], events["y"]))]


def gaps_us(events):
    """Intervals between consecutive events of the same pixel."""
    y, x, t = (np.diff(by_pixel(events)[name].astype(np.int64)) for name in "yxt")
    return t[(y == 0) & (x == 0)]


@pytest.mark.parametrize("config", [
    *(replace(config, threshold_on=on, threshold_off=off)
      for config in (IDEAL, SLOW) for on, off in ((0.25, 0.25), (0.01, 0.03))),
    SensorConfig(threshold_mismatch=0.05),
])  # fmt: skip
def test_events_rebuild_the_log_image(config):
    """Each pixel has its own thresholds, which are constant in time.

    The event buffer starts with room for 65,536 events, which is less than fine thresholds need.
    """
    video, times_s = smooth_video(60, 20, 30), 0.001 * np.arange(60)
    given = video.copy()
    sensor = sensor_of(video[0], config)
    on, off = config.threshold_on, config.threshold_off
    if config.threshold_mismatch:
        on, off = np.log(sensor._up), -np.log(sensor._down)
        # The tolerances are 5 standard errors of 600 draws.
        assert on.mean() == pytest.approx(0.25, abs=5 * 0.05 / 600**0.5)
        assert on.std() == pytest.approx(0.05, rel=5 / 1200**0.5)
        assert abs(np.corrcoef(on.ravel(), off.ravel())[0, 1]) < 5 / 600**0.5
    feed(sensor, times_s[1:], video[1:])
    events = sensor.finish(times_s[-1])
    np.testing.assert_array_equal(video, given)
    log_light = np.log(video.astype(np.float64) + EPS)
    for k in range(60):
        # Times are rounded to 1 us, so events up to 0.5 us after the instant belong to it.
        before = events[events["t"] <= 1000 * k]
        error = log_light[k] - log_light[0] - reference_levels(before, on, off, (20, 30))
        # The tolerance covers float32 light, and 1 us at up to 40 thresholds per second.
        assert ((-off - 1e-4 < error) & (error < on + 1e-4)).all()
    assert len(events) > (65_536 if config.threshold_on < 0.25 else 10 * 20 * 30)


@pytest.mark.parametrize(
    ("config", "n"),
    [(IDEAL, 2), (SLOW, 2), (DEAD, 2), (DEAD, 52)],  # by 52 frames, dead times end in later ones
    ids=["ideal", "general", "dead time", "dead time over frames"],
)
@pytest.mark.parametrize(("before", "after"), [(0.1, 0.9), (0.9, 0.1), (0.0, 1.0), (1.0, 0.0)])
def test_crossings_of_a_linear_ramp(config, n, before, after):
    """A pixel fires a threshold away from what it memorised, and memorises after its dead time.

    ESIM counts the thresholds passed in the dead time; a real pixel ignores them.
    """
    duration_s = 0.5
    video = np.linspace(before, after, n, dtype=np.float32)[:, None, None]
    events = events_from_frames(video, np.linspace(2.0, 2.0 + duration_s, n), config)
    speed, expected_s, memory = (after - before) / duration_s, [], before + EPS
    step = np.exp(np.copysign(0.25, speed))
    while (crossing_s := (memory * step - EPS - before) / speed) <= duration_s:
        expected_s.append(2.0 + crossing_s)
        memory = before + speed * (crossing_s + config.refractory_s) + EPS
    assert len(events) == len(expected_s) > 3
    # The tolerance is the rounding to 1 us and that of float32 light, 6e-8 of half a second.
    np.testing.assert_allclose(events["t"], 1e6 * np.array(expected_s), atol=0.5 + 0.1)


@pytest.mark.parametrize(
    ("config", "effects"),
    [
        (SLOW, None),
        (IDEAL, FAINT),
        # A time constant of 0.2 us.
        (IDEAL, SensorEffects(cutoff_hz_per_lux=1e4, cutoff_min_hz=1e6, cutoff_max_hz=1e6)),
        (IDEAL, SensorEffects(flicker_depth=1e-9)),
    ],
)
def test_what_is_next_to_nothing_gives_the_ideal_events(config, effects):
    video, times_s = smooth_video(80, 20, 30), 1e-3 * np.arange(80)
    ideal = by_pixel(events_of(video, times_s))
    events = by_pixel(events_of(video, times_s, config, effects))
    assert len(ideal) > 5000
    np.testing.assert_array_equal(events[["x", "y", "p"]], ideal[["x", "y", "p"]])
    # A pixel memorises the level or the light at the crossing; the time constant; rounding.
    assert np.abs(events["t"] - ideal["t"]).max() <= (1 if effects is None else 2)


def test_videos_of_any_type_and_layout():
    video, times_s = smooth_video(20, 10, 12), 0.04 * np.arange(20)
    expected = events_from_frames(video, times_s)
    twice = np.repeat(np.repeat(video, 2, axis=1), 2, axis=2)
    backwards = np.ascontiguousarray(video[:, ::-1])[:, ::-1]
    same = (video.astype(np.float64), np.asfortranarray(video), twice[:, ::2, ::2], backwards)
    for given in same:
        np.testing.assert_array_equal(events_from_frames(given, times_s), expected)
    for dtype in (np.uint8, np.uint16):
        codes = np.rint(video * np.iinfo(dtype).max).astype(dtype)
        light = codes.astype(np.float32) / np.float32(np.iinfo(dtype).max)
        of_light = events_from_frames(light, times_s)
        np.testing.assert_array_equal(events_from_frames(codes, times_s), of_light)


@pytest.mark.parametrize("name", SENSORS)
def test_crops_give_the_events_of_whole_frames(name):
    """A square stands before a textured wall at the start, leaves, and comes back elsewhere."""
    wall, times_s = smooth_video(1, 30, 40)[0], 1e-3 * np.arange(120)
    video = np.repeat(wall[None], 120, axis=0)
    for k in range(120):
        if not 40 < k % 60 < 55:
            x, y = (k + 5) % 60 - 10, 8 + k // 8
            video[k, y : y + 7, max(x, 0) : max(x + 9, 0)] = 0.1
    sensor, margins = sensor_of(video[0], *SENSORS[name], background=wall), rng(2)
    for k in range(1, 120):
        ys, xs = np.nonzero(video[k] != wall)
        low = np.array([xs.min(), ys.min()]) if len(xs) else np.array([3, 3])
        high = np.array([xs.max(), ys.max()]) + 1 if len(xs) else np.array([4, 4])
        margin = margins.integers(0, 3, (2, 2))
        x0, y0 = np.maximum(low - margin[0], 0)
        x1, y1 = np.minimum(high + margin[1], [40, 30])
        # An instant may be left out when neither it nor its neighbours show the square.
        if (video[k - 1 : k + 2] != wall).any():
            crop = np.ascontiguousarray(video[k : k + 1, y0:y1, x0:x1])
            sensor.feed(times_s[k : k + 1], np.array([x0]), np.array([y0]), crop)
    whole = events_of(video, times_s, *SENSORS[name])
    np.testing.assert_array_equal(sensor.finish(times_s[-1]), whole)
    assert len(whole) > 300


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("step_s", [1e-3, 0.7e-6])
def test_events_are_in_order_and_may_be_taken_as_they_settle(name, step_s):
    """Instants are fed one by one or together; at small steps one microsecond has many feeds."""
    config = PRESETS[name]
    video, times_s = smooth_video(50, 12, 15), step_s * np.arange(50)
    whole = events_of(video, times_s, config)
    by_row = np.lexsort((whole["x"], whole["y"], whole["t"]))  # which is a stable sort
    np.testing.assert_array_equal(by_row, np.arange(len(whole)))
    if config == IDEAL:  # a pixel's events of one microsecond keep their order
        slow = events_of(video, 1e-3 * np.arange(50))
        np.testing.assert_array_equal(by_pixel(whole)["p"], by_pixel(slow)["p"])
    sensor, taken = sensor_of(video[0], config), []
    for part in (*(slice(k, k + 1) for k in range(1, 20)), slice(20, 45), slice(45, 50)):
        feed(sensor, times_s[part], video[part])
        taken.append(sensor.take_settled())
        if len(taken[-1]):
            assert taken[-1]["t"][-1] < np.rint(1e6 * times_s[part][-1])
    taken.append(sensor.finish(times_s[-1]))
    np.testing.assert_array_equal(np.concatenate(taken), whole)
    assert (len(taken[-1]) < 0.2 * len(whole)) == config.is_ideal_in_time  # left for the end


@pytest.mark.parametrize("light", [0.0, 0.5, 0.999])
@pytest.mark.parametrize("effects", [None, FAINT])
def test_shot_noise_falls_to_a_quarter_in_full_light(effects, light):
    events = still_events(light, 5.0, replace(QUIET, shot_noise_hz=2.0), effects)
    expected = 2.0 * (1.0 - 0.75 * light) * 5.0 * 3000
    # Counts are within five standard deviations, here and below.
    assert len(events) == pytest.approx(expected, abs=5.0 * expected**0.5)
    assert (events["p"] == 1).sum() == pytest.approx(expected / 2, abs=5.0 * (expected / 2) ** 0.5)
    times = np.histogram(events["t"], bins=10, range=(0, 5_000_000))[0]
    assert np.abs(times - expected / 10).max() < 5.0 * (expected / 10) ** 0.5
    per_pixel = counts(events, SHAPE)
    # A Poisson count of mean m has variance m; 3000 counts give it to sqrt((2 + 1 / m) / 3000).
    assert per_pixel.var() == pytest.approx(expected / 3000, rel=5 * (2.5 / 3000) ** 0.5)


@pytest.mark.parametrize("light", [0.1, 0.9])
@pytest.mark.parametrize(("lux", "falls"), [(0.1, 1.0), (1.0, 10**-0.75), (161.0, 1610**-0.75)])
def test_shot_noise_falls_with_the_light(lux, falls, light):
    duration_s = 10.0 / falls**0.5
    effects = SensorEffects(illuminance_lux=lux / light, dim_noise_on_hz=5.0, dim_noise_off_hz=3.7)
    events = still_events(light, duration_s, effects=effects)
    on = int((events["p"] == 1).sum())
    # There are at least 5000 events, whose number has a deviation of 1.4 % at most.
    per_pixel = falls * duration_s * 3000
    assert on == pytest.approx(5.0 * per_pixel, rel=0.05)
    assert len(events) - on == pytest.approx(3.7 * per_pixel, rel=0.05)


def test_noise_falls_due_alike_whether_or_not_the_light_changes():
    """Pixels are updated at each change of light, which must not restart their wait for noise."""
    times_s = np.linspace(0.0, 5.0, 501)
    light = np.broadcast_to(0.5 + 0.01 * (np.arange(501) % 2)[:, None, None], (501, *SHAPE))
    events = events_of(light, times_s, replace(QUIET, background_hz=3.0), FAINT)
    assert len(events) == pytest.approx(45_000, abs=5.0 * 45_000**0.5)  # 3 Hz, 5 s, 3000 pixels


def test_rates_spread_over_pixels():
    spread = 0.25
    effects = SensorEffects(illuminance_lux=0.1, dim_noise_on_hz=20.0, noise_spread_decades=spread)
    events = still_events(0.9, 60.0, effects=effects)
    assert len(events) == pytest.approx(20.0 * 60.0 * 3000, rel=0.05)  # 3000 draws: 1.2 %
    # The scatter of counts of about a thousand per pixel adds 0.014 decades.
    assert np.log10(counts(events, SHAPE)).std() == pytest.approx(np.hypot(spread, 0.014), rel=0.05)


@pytest.mark.parametrize("light", [0.0, 0.6])
@pytest.mark.parametrize(
    ("mismatch", "effects"),
    [
        (0.0, None),
        (0.03, None),
        *((0.0, replace(FAINT, leak_jitter=jitter)) for jitter in (0.0, 0.1, 0.2)),
    ],
)
def test_leak_events_are_on_and_regular_but_for_their_jitter(light, mismatch, effects):
    config = SensorConfig(leak_hz=3.0, threshold_mismatch=mismatch)
    jitter = effects.leak_jitter if effects else 0.0
    events = still_events(light, 10.0, config, effects)
    assert (events["p"] == 1).all()
    # Every pixel fires each 1/3 s, from a random phase on.
    assert len(events) == pytest.approx(3.0 * 10.0 * 3000, rel=0.01 if jitter else 0.001)
    gaps_s = 1e-6 * gaps_us(events)
    assert gaps_s.mean() == pytest.approx(1 / 3.0, rel=0.01)
    assert gaps_s.std() * 3.0 == pytest.approx(jitter, rel=0.05, abs=1e-5)
    if not jitter:
        phases = np.histogram(events["t"] % 333_333, bins=10)[0]
        assert np.abs(phases - 9000).max() < 5 * 30 * 300**0.5  # 300 pixels, 30 events each


def test_leaking_pixels_that_see_change_stay_within_a_threshold():
    video, times_s = smooth_video(100, 20, 30), 5e-3 * np.arange(100)
    sensor = sensor_of(video[0], SensorConfig(leak_hz=5.0))
    for k in range(1, 100):
        feed(sensor, times_s[k : k + 1], video[k : k + 1])
        # Between instants both light and the leak's exponential are taken as linear.
        assert np.abs(np.log((video[k] + EPS) / sensor._reference)).max() < 0.25 + 1e-3
    assert (sensor.finish(0.5)["p"] == 0).any()


def test_leaking_pixels_under_faint_flicker_fire_at_the_crests():
    still, faint = np.full((2, *SHAPE), 0.5), SensorEffects(flicker_depth=0.05)
    events = events_of(still, np.array([0.0, 5.0]), SensorConfig(leak_hz=2.0), faint)
    assert (events["p"] == 1).all()
    # A crest lifts the signal by 0.05 of the 0.25 that leak away in half a second, and the level
    # memorised there is as much higher: the rate stays.
    assert len(events) / 3000 / 5.0 == pytest.approx(2.0, rel=0.05)
    phases = np.exp(1j * (2 * np.pi * 100.0 * 1e-6 * events["t"] + FLICKER_RAD))
    assert np.angle(phases.mean()) == pytest.approx(0.0, abs=0.5)  # crests, a little before


@pytest.mark.parametrize(
    ("config", "effects"),
    [
        (SensorConfig(hot_pixel_share=0.01, hot_pixel_hz=100.0), None),
        (QUIET, SensorEffects(hot_clusters=40, hot_cluster_hz=100.0)),
    ],
)
def test_hot_pixels_and_clusters(config, effects):
    events = still_events(0.5, 10.0, config, effects, (200, 200))
    assert (events["p"] == 1).all()
    fired = counts(events, (200, 200)).reshape(200, 200)
    hot = fired > 0
    if effects is None:
        assert hot.sum() == pytest.approx(400, abs=5.0 * 400**0.5)  # a draw per pixel
    else:
        assert 40 * 9 * 0.9 < hot.sum() <= 40 * 9  # some overlap
        neighbours = sum(np.roll(hot, shift, axis) for shift in (-1, 1) for axis in (0, 1))
        assert (neighbours[hot] >= 2).all()
    # Log-normal of spread 0.7 about the median.
    rates = np.log(fired[hot] / 10.0 / 100.0)
    assert np.median(rates) == pytest.approx(0.0, abs=5 * 1.25 * 0.7 / 360**0.5)
    assert rates.std() == pytest.approx(0.7, abs=5 * 0.7 / 720**0.5)


DAVIS = SENSOR_PRESETS["davis346"]
STEADY = replace(DAVIS.effects, jitter_s=0.0, jitter_lux_s=0.0, latency_lux_s=0.0)


@pytest.mark.parametrize(
    ("config", "effects"),
    [
        (SensorConfig(refractory_s=0.002), None),
        (SensorConfig(refractory_s=0.002, shot_noise_hz=300.0, leak_hz=20.0), None),
        (SensorConfig(refractory_s=0.01, hot_pixel_share=0.5, hot_pixel_hz=200.0), None),
        (replace(DAVIS.sensor, refractory_s=0.002), STEADY),
        (replace(DAVIS.sensor, refractory_s=0.01), STEADY),
    ],
)
def test_no_two_events_of_a_pixel_within_the_dead_time(config, effects):
    video, times_s = smooth_video(150, 20, 30), 1e-3 * np.arange(150)
    gaps = gaps_us(events_of(video, times_s, config, effects))
    assert len(gaps) > 1000
    # Whole microseconds: rounding two times that are the dead time apart keeps the difference.
    assert gaps.min() >= round(config.refractory_s * 1e6)


@pytest.mark.parametrize(
    ("lux", "light", "expected_hz"),
    [(1.0, 0.4, 12.0), (20.0, 0.4, 240.0), (20.0, 0.2, 120.0), (1e4, 0.4, 3e3), (0.01, 0.4, 5.0)],
)
def test_a_step_is_followed_with_the_time_constant_of_its_light(lux, light, expected_hz):
    effects = SensorEffects(
        illuminance_lux=lux, cutoff_hz_per_lux=30.0, cutoff_min_hz=5.0, cutoff_max_hz=3000.0
    )
    video, times_s = stepping(light / 2, light, 3.0)
    events = events_of(video, times_s, FINE, effects)
    reached = (light / 2 + EPS) * np.exp(0.02 * np.arange(1, len(events) + 1)) - EPS
    left = (light - reached) / (light / 2)
    usable = left > 0.05
    assert usable.sum() > 20
    rate = -np.polyfit(1e-6 * events["t"][usable], np.log(left[usable]), 1)[0]
    # log_eps counts as light, 0.25 % of it, and time stamps are whole microseconds.
    assert rate / (2 * np.pi) == pytest.approx(expected_hz, rel=0.02)


@pytest.mark.parametrize("lux", [500.0, 5.0])
def test_latency_and_jitter_depend_on_the_light(lux):
    effects = SensorEffects(
        illuminance_lux=lux, latency_s=100e-6, latency_lux_s=1e-3, jitter_s=10e-6, jitter_lux_s=1e-4
    )
    video, times_s = stepping(0.2, 0.3, 2.0, SHAPE)
    events = events_of(video, times_s, effects=effects)
    assert len(events) == 3000
    seen_lux = lux * (0.2 + EPS) * np.exp(0.25)  # light at the threshold
    delays_us = events["t"] - 1e6
    expected_us = 100 + 1e3 / seen_lux
    # 3000 draws give the deviation to 1.3 % and the mean to 0.2 %.
    assert delays_us.mean() == pytest.approx(expected_us, rel=0.02)
    assert delays_us.std() == pytest.approx(expected_us / 10, rel=0.05)


def test_a_signal_that_turns_within_an_interval_passes_its_threshold():
    """The light falls throughout, but the lagging photoreceptor at first still rises."""
    effects = SensorEffects(
        illuminance_lux=1e3, cutoff_hz_per_lux=1.0, cutoff_max_hz=50.0, cutoff_min_hz=50.0
    )
    light = np.array([0.2, 0.2, 0.8, 0.1], np.float32)[:, None, None]
    coarse_s = np.array([0.0, 0.1, 0.1 + 1e-9, 0.11])
    fine_s = np.concatenate([coarse_s[:3], np.linspace(0.1 + 1e-9, 0.11, 500)[1:]])
    fine = np.interp(fine_s, coarse_s, light[:, 0, 0])[:, None, None]
    coarse = events_of(light, coarse_s, effects=effects)
    events = events_of(fine, fine_s, effects=effects)
    assert len(coarse) == len(events) >= 2
    np.testing.assert_allclose(coarse["t"], events["t"], atol=2)  # rounding, in a fall of 10 ms


def test_a_fast_flicker_ends_its_cycles_also_late():
    still, effects = np.full((2, 1, 1), 0.5), SensorEffects(flicker_depth=0.4, flicker_hz=20_000.0)
    events = events_of(still, np.array([590.0, 590.01]), effects=effects)
    assert len(events) > 200  # in each of its 200 cycles


@pytest.mark.parametrize("cutoff_hz", [1e6, 50.0])
def test_flicker_is_what_light_that_swings_would_be(cutoff_hz):
    depth, hz = 0.4, 100.0
    filtered = SensorEffects(
        cutoff_hz_per_lux=1e9, cutoff_min_hz=cutoff_hz, cutoff_max_hz=cutoff_hz
    )
    times_s = np.linspace(0.0, 0.3, 30_001)
    # The pixel starts in its steady state, as if it had followed the lamps for long.
    gain, lag = 1 / np.hypot(1, hz / cutoff_hz), np.arctan(hz / cutoff_hz)
    swinging = 0.5 * (1.0 + depth * np.cos(2 * np.pi * hz * times_s + FLICKER_RAD))
    swinging[0] = 0.5 * (1.0 + depth * gain * np.cos(FLICKER_RAD - lag))
    by_light = events_of(swinging[:, None, None], times_s, effects=filtered)
    still, ends_s = np.full((2, 1, 1), 0.5), times_s[[0, -1]]
    events = events_of(still, ends_s, effects=replace(filtered, flicker_depth=depth))
    assert len(by_light) == len(events) > 50
    np.testing.assert_array_equal(events["p"], by_light["p"])
    # The tolerance is one step of the light, 10 us of a cycle of 10 ms, and covers rounding.
    np.testing.assert_allclose(events["t"], by_light["t"], atol=10)
