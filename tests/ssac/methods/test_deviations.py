"""Stated deviations against what they stand for: neither too small nor too large."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import Chain, Observation, Status
from ssac.geometry.epipolar import fundamental_from_pose, sampson_distance
from ssac.methods.tangency import TangencyConfig, tangent_pairs
from ssac.track.outline import Tangents
from tests.ssac import synthetic
from tests.ssac.methods.flights import CLEAN, DURATION_S, MIDDLE, T_D_S, seen

SIZE_M = 0.2  # of the cloud of points
UNIFORM_S = 3.0
NEAR = replace(CLEAN, interval_s=(T_D_S - 0.2, T_D_S + 0.2))
# Root mean square size of the cloud, 5 m away, in both images together.
IMAGES_PX = np.sqrt(2.0) * synthetic.FOCAL_PX / synthetic.DISTANCE_M * np.sqrt(2.0 / 12.0) * SIZE_M


@pytest.mark.parametrize(
    ("method", "low_px", "high_px"),
    [
        # A tenth of the size in each image. Where flights at one speed along a line were simulated,
        # the mean of the events lay off by 0.06 for long, and ten times more would refuse them all.
        ("joint-known", 0.06 * IMAGES_PX, 0.2 * IMAGES_PX),
        # 0.2 px on each of the two sides, which share the error of their mean.
        ("tangency-known", 0.1, 0.5),
    ],
    ids=["mean", "outline"],
)
def test_what_strays_all_along_is_allowed_for(method, low_px, high_px):
    """The object rises along a line at one speed, so slowly that a bias stays for all the time."""

    def path(times_s):
        return MIDDLE + (times_s - UNIFORM_S / 2)[..., None] * np.array([0.2, 0.9, 0.3])

    scene = replace(synthetic.make_scene(0, duration_s=UNIFORM_S), path=path)
    streams = synthetic.make_events(scene, 0, T_D_S, rate_hz=50_000.0, size_m=SIZE_M)
    estimate = Chain([*map(Observation, streams)], scene.rig, NEAR).estimate(method)
    assert estimate.status == Status.OK
    # How fast [px/s] a change of t_d makes a shift of all points good again, by least squares.
    times_s = np.linspace(0.1, UNIFORM_S - 0.1, 200)
    F = fundamental_from_pose(synthetic.K, synthetic.K, scene.R, scene.t)
    p1, p2 = synthetic.track_pair(scene, times_s)[0], synthetic.track_pair(scene, times_s + 1e-3)[1]
    rates = sampson_distance(F, p1, p2) / 1e-3
    lever_px_s = np.mean(rates**2) / np.abs(np.mean(rates))
    assert low_px < estimate.t_d_std_s * lever_px_s < high_px
    assert abs(estimate.t_d_s - T_D_S) < 2.0 * estimate.t_d_std_s


def test_deviations_are_neither_too_small_nor_too_large():
    offsets, poses = [], []
    for seed in range(4):
        scene = synthetic.make_scene(seed, duration_s=DURATION_S)
        chain = Chain(seen(scene, seed), scene.rig, NEAR)
        for method in ("joint", "joint-known", "tangency", "tangency-known"):
            estimate = chain.estimate(method)
            offsets.append((estimate.t_d_s - T_D_S) / estimate.t_d_std_s)
            if estimate.covariance is not None:
                poses.append(synthetic.rotation_angle_deg(estimate.R, scene.R) / estimate.r_std_deg)
                poses.append(synthetic.angle_deg(estimate.t, scene.t) / estimate.t_std_deg)
    # The root mean square of 16 is known to 18 %. It is 1.1 of both: deviations of half the size,
    # or of twice, are out of these bounds.
    for normalised in (offsets, poses):
        assert len(normalised) == 16
        assert 0.65 < np.sqrt(np.mean(np.square(normalised))) < 1.6


def test_outlines_that_are_too_wide_in_both_views_are_allowed_for():
    """Deviations grow by it as errors that are independent of the others, and nothing else does."""
    scene = synthetic.make_scene(0, duration_s=DURATION_S)
    chain, found = Chain(seen(scene), scene.rig, NEAR), []
    for width in (0.0, 1.0, 2.0):
        rules = replace(NEAR.rules, tangency=TangencyConfig(hidden_width=width))
        found.append(chain.under(replace(NEAR, rules=rules)).estimate("tangency"))
    none, once, twice = found
    assert (once.t_d_s, *once.R.flat, *once.t) == (none.t_d_s, *none.R.flat, *none.t)
    assert once.r_std_deg > 1.01 * none.r_std_deg
    added = once.covariance - none.covariance
    # Rounding, of the whole covariance.
    atol = 1e-12 * np.abs(none.covariance).max()
    np.testing.assert_allclose(twice.covariance - none.covariance, 4.0 * added, 1e-6, atol)


def test_blurred_tangents_count_less():
    n = 50
    points, valid = np.zeros((n, 2)), np.ones(n, np.bool_)
    both = [Tangents(points, points, np.full(n, spread_px), valid) for spread_px in (0.0, 0.5)]
    weights = tangent_pairs(0.02 * np.arange(n), both, both, 0.0, TangencyConfig()).weights
    # Errors of both views: 0.05 px of any tangent, and the blur of each; to rounding.
    expected = np.sqrt(0.05**2 + 2 * 0.5**2) / 0.05
    np.testing.assert_allclose(weights[:n] / weights[n:], expected, rtol=1e-12)
