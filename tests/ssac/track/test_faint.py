"""A small object in noise, followed where it makes few events, and nothing where there is none."""

import numpy as np
import pytest
import yaml

from ssac.events import events_from_arrays
from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import load_track
from ssac.rules import FaintRules
from ssac.track.faint import follow, smoothed_path
from tests.ssac import cluttered
from tests.ssac.cluttered import merged
from tests.ssac.command import run

WIDTH, HEIGHT, DURATION_S = 120, 90, 12.0
GAP_S = 5.0, 8.0  # in which the object is weak
NOISE = cluttered.noise(WIDTH, HEIGHT, 0.4, round(1e6 * DURATION_S))  # as of a DAVIS346
RULES = FaintRules()


def path_px(times_s):
    """Turn at up to 25 px/s^2, as a drone some 35 m away."""
    return np.stack([60.0 + 40.0 * np.sin(0.5 * times_s), 45.0 + 25.0 * np.cos(times_s)], axis=-1)


def recorded(weak_hz, seed=0, last_s=DURATION_S):
    """All events, those that are sure, and those of the object; weak in the gap, till the last."""
    rng = np.random.default_rng(seed)

    def seen(start_s, end_s, rate_hz):
        t = np.sort(rng.uniform(start_s, end_s, int(rate_hz * max(end_s - start_s, 0.0))))
        px = np.rint(path_px(t) + [2.0, 1.0] * rng.standard_normal((len(t), 2))).astype(int)
        return events_from_arrays(np.rint(1e6 * t).astype(int), *px.T, rng.integers(0, 2, len(t)))

    weak = seen(GAP_S[0], min(GAP_S[1], last_s), weak_hz)
    sure = merged(seen(0.0, GAP_S[0], 600.0), seen(GAP_S[1], last_s, 600.0))
    ours = merged(sure, weak)
    return merged(ours, NOISE), sure, ours


def followed(events, sure):
    """What is found, and the middles [s] of its bins."""
    found = follow(events, sure, WIDTH, HEIGHT, RULES)
    bins = np.arange(len(found.seen)) + 0.5
    return found, 1e-6 * (found.start_us + RULES.bin_us * bins)


@pytest.mark.parametrize("seed", range(3))
def test_a_weak_object_is_followed_through_a_gap(seed):
    events, sure, ours = recorded(120.0, seed)
    found, middles_s = followed(events, sure)
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
    found, middles_s = followed(events, sure)
    bins = (events["t"] - found.start_us) // RULES.bin_us
    ages_s = 1e-6 * events["t"] - middles_s[bins]
    there = found.positions_px[bins] + ages_s[:, None] * found.velocities_px_s[bins]
    away = np.column_stack([events["x"], events["y"]]) - there
    inside = np.sum((away / found.half_sizes_px[bins]) ** 2, axis=1) < 1.0
    np.testing.assert_array_equal(found.events, events[inside & found.seen[bins]])


def test_noise_alone_is_not_followed():
    found, middles_s = followed(*recorded(0.0)[:2])
    # Near its ends, the window of half a second holds events of the object beside the gap.
    in_gap = (middles_s > GAP_S[0] + 0.3) & (middles_s < GAP_S[1] - 0.3)
    assert not found.seen[in_gap].any()
    assert found.seen[middles_s < GAP_S[0]].mean() > 0.98
    events, sure, _ = recorded(120.0)
    for few in (sure[:0], sure[:10]):  # too few for a size
        assert follow(events, few, WIDTH, HEIGHT, RULES) is None


def test_a_path_that_leads_to_no_sure_place_is_kept_for_half_a_second():
    found, middles_s = followed(*recorded(120.0, last_s=GAP_S[1])[:2])
    # The object is sure until 0.1 s after the gap begins, by the events before.
    assert GAP_S[0] + 0.4 < middles_s[found.seen].max() < GAP_S[0] + 0.65


def test_a_clock_that_shows_more_changes_nothing():
    events, sure, _ = recorded(120.0)
    found, _ = followed(events, sure)
    for each in (events, sure):
        each["t"] += 1_700_000_000_000_000
    later, _ = followed(events, sure)
    np.testing.assert_array_equal(found.events[["x", "y", "p"]], later.events[["x", "y", "p"]])


def test_the_path_is_as_uncertain_in_a_gap_as_a_random_acceleration_makes_it():
    step_s, n, gap = 0.02, 300, 100  # 2 s
    middle = n // 2
    variances = np.full(n, 1e-4)
    variances[middle - gap // 2 : middle + gap // 2] = np.inf
    times_s = step_s * np.arange(n)
    line, density = 10.0 + 7.0 * times_s, RULES.acceleration
    positions, velocities, found = smoothed_path(
        line, variances, step_s, density, RULES.max_speed_variance
    )
    np.testing.assert_allclose(positions, line, atol=1e-3)  # by the prior of 0 +- 1000 px
    np.testing.assert_allclose(velocities, 7.0, atol=1e-1)
    # Between two known positions and velocities: density T^3 / 192, T one bin longer than the gap;
    # the ends' velocities are known to some 0.7 px/s, of 20 px/s that the acceleration makes.
    expected = density * ((gap + 1) * step_s) ** 3 / 192.0
    assert found[middle] == pytest.approx(expected, rel=0.1)


def track(folder, events, *options):
    """Call `ssac track`."""
    save_events_h5(folder / "cam.h5", events, WIDTH, HEIGHT)
    camera = {
        "camera_model": "pinhole", "intrinsics": [200.0, 200.0, 60.0, 45.0],
        "distortion_model": "none", "distortion_coeffs": [], "resolution": [WIDTH, HEIGHT],
    }  # fmt: skip
    (folder / "rig.yaml").write_text(yaml.safe_dump({"cam0": camera}))
    files = folder / "cam.h5", "--rig", folder / "rig.yaml", "--out", folder / "cam.csv"
    code, _, err = run("track", *files, "--faint", *options)
    return code, err, folder / "cam.csv"


POINTS = ("--half-window", "0.05", "--n-min", "8")


def test_a_faint_object_has_a_track_where_it_is_weak(tmp_path):
    code, err, out = track(tmp_path, recorded(120.0)[0], *POINTS)
    assert code == 0, err
    found = load_track(out)
    weak = (found.times_s > GAP_S[0]) & (found.times_s < GAP_S[1])
    assert np.count_nonzero(weak) > 0.9 * 100 * (GAP_S[1] - GAP_S[0])  # a point each 10 ms
    errors_px = np.linalg.norm(found.points_px - path_px(found.times_s), axis=1)
    # 12 events of an image of 2 px leave 0.6 px, of each coordinate; five deviations.
    assert np.max(errors_px[weak]) < 3.0


@pytest.mark.parametrize(
    ("options", "message"), [(POINTS, "no object is seen"), (["--no-denoise"], "leave one out")]
)
def test_noise_alone_and_noise_that_is_kept_are_refused(tmp_path, options, message):
    code, err, out = track(tmp_path, NOISE, *options)
    assert (code, err.count("\n"), out.exists()) == (2, 1, False)
    assert message in err
