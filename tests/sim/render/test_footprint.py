"""Tests where a drone's outline lies in an image, how far it moves, and the chosen instants."""

import numpy as np
import pytest

from sim.render.config import SamplingConfig
from sim.render.footprint import choose_instants, footprint
from sim.scene.flyers import bird, quadrotor
from sim.scene.trajectory import SplineConfig, random_spline
from tests.sim.scenes import LENSES, make_camera, rng, straight


@pytest.mark.parametrize("lens", LENSES)
def test_only_steps_with_both_ends_in_view_count_and_the_fastest_point(lens):
    camera, times_s = make_camera(lens), np.linspace(0.0, 1.0, 600)
    T_W_B = straight(times_s, (-8.0, 0.0, 0.0), (16.0, 0.0, 0.0))
    seen = footprint(quadrotor(), camera, times_s, T_W_B)  # more poses than one batch
    entered = int(np.argmax(seen.visible))
    left = len(seen.visible) - int(np.argmax(seen.visible[::-1]))
    assert 0 < entered < left < 600
    assert seen.visible[entered:left].all()
    assert not seen.moved_px[: entered + 1].any()
    assert not seen.moved_px[left:].any()
    moved_px = seen.moved_px[entered + 1 : left]
    assert (moved_px > 0.0).all()
    if lens == "none":
        # All points have one speed v; in the image those nearest to the camera move fastest, at
        # f v / z with the least depth z.
        expected_px = camera.K[0, 0] * 16.0 / 599 / seen.depth_m[entered + 1 : left, 0]
        np.testing.assert_allclose(moved_px, expected_px, rtol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize(
    ("drone", "gain"),
    [(quadrotor(), 1.01), (quadrotor(rotor_hz=60.0), 1.04), (bird(1.0, 8.0), 1.04)],
    ids=["still", "spinning", "flapping"],
)
def test_steps_are_as_long_as_the_bound_lets_them(lens, drone, gain):
    trajectory, max_step_px = random_spline(SplineConfig(1.0), rng(1)), 0.25
    for camera in (make_camera(lens), make_camera(lens, number=1)):
        instants_s = choose_instants(drone, camera, trajectory, SamplingConfig(max_step_px))
        steps_px = footprint(drone, camera, instants_s, trajectory.poses(instants_s)).moved_px
        # Between probes the speed is taken as constant. In flight it is, to 1 % of a step; but in
        # 1/100 of a turn a blade seen aslant or a wing gains up to 4 % on its mean speed.
        assert steps_px.max() <= gain * max_step_px
        # The bound holds for the fastest corner, and which one that is changes with time.
        assert np.median(steps_px[1:]) > 0.8 * max_step_px


@pytest.mark.parametrize("seed", [3, 4])
def test_instants_go_from_start_to_end_at_the_least_rate(seed):
    trajectory = random_spline(SplineConfig(4.0), rng(seed))
    config = SamplingConfig(max_step_px=50.0, min_rate_hz=80.0)  # no image moves that fast
    instants_s = choose_instants(quadrotor(), make_camera(number=1), trajectory, config)
    assert (instants_s[0], instants_s[-1]) == (0.0, trajectory.duration_s)
    intervals_s = np.diff(instants_s)
    assert 0.0 < intervals_s.min() <= intervals_s.max() <= (1.0 + 1e-9) / 80.0  # round-off
    assert len(instants_s) <= 4.0 * 80.0 + 2
