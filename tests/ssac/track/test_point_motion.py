"""The motion of a track of points: what it samples alike with one of events."""

import numpy as np
import pytest

from ssac.camera import Camera, distort_points
from ssac.errors import SsacError
from ssac.points import PointTrack
from ssac.track.motion import WINDOW_INTERVALS, point_motion

CAMERA = Camera(np.array([[200.0, 0, 173], [0, 200.0, 130], [0, 0, 1]]), 346, 260)
STEP_S = 0.04


def path(times_s):
    """A parabola, which local parabolas follow exactly."""
    return np.stack([20.0 + 90.0 * times_s - 8.0 * times_s**2, 30.0 + 11.0 * times_s**2], axis=-1)


def velocity(times_s):
    return np.stack([90.0 - 16.0 * times_s, 22.0 * times_s], axis=-1)


def track_of(times_s):
    return PointTrack(times_s, path(times_s))


TIMES_S = STEP_S * np.arange(100.0)


def test_positions_and_velocities_between_points():
    wanted_s = np.linspace(0.2, 3.6, 77)
    sharp = point_motion(track_of(TIMES_S), CAMERA).sharp_at(wanted_s)
    assert sharp.valid.all()
    np.testing.assert_allclose(sharp.positions_px, path(wanted_s), atol=1e-8)
    np.testing.assert_allclose(sharp.velocities_px_s, velocity(wanted_s), atol=1e-6)


def test_any_shape_of_times_may_be_asked_for():
    motion = point_motion(track_of(TIMES_S), CAMERA)
    wanted_s = np.linspace(0.2, 3.6, 6).reshape(2, 3)
    assert motion.at(wanted_s).positions_px.shape == (2, 3, 2)
    assert motion.velocities_at(wanted_s).shape == (2, 3, 2)


def test_gaps_and_ends_are_not_valid():
    left = TIMES_S[(TIMES_S < 1.0) | (TIMES_S > 2.0)]
    motion = point_motion(track_of(left), CAMERA)
    one_missing = point_motion(track_of(np.delete(TIMES_S, 50)), CAMERA)
    outside = np.array([-0.5, 0.01, 1.1, 1.5, 1.9, 3.95, 5.0])
    assert not motion.at(outside).valid.any()
    assert np.isnan(motion.at(outside).positions_px).all()
    assert one_missing.at(TIMES_S[3:-3]).valid.all()


def test_windows_of_a_faster_camera_are_those_of_events():
    fast = point_motion(track_of(np.arange(0.0, 2.0, 1e-3)), CAMERA, half_window_s=0.02)
    assert fast.half_window_s == 0.02
    slow = point_motion(track_of(TIMES_S), CAMERA, half_window_s=0.02)
    assert slow.half_window_s == pytest.approx(WINDOW_INTERVALS * STEP_S)


@pytest.mark.parametrize("sigma_px", [0.1, 1.0])
def test_the_noise_of_points_is_measured(sigma_px):
    noise = np.random.default_rng(0).normal(0.0, sigma_px, (2000, 2))
    times_s = 1e-3 * np.arange(2000.0)
    motion = point_motion(PointTrack(times_s, path(times_s) + noise), CAMERA)
    # Of 4000 residuals, neighbours' being correlated, the median is good to some 3 %.
    assert motion.sigmas_px[0] == pytest.approx(sigma_px, rel=0.1)


def test_points_count_by_their_deviations():
    sigmas = np.where(np.arange(100) % 2, 1.0, 0.001)
    points = path(TIMES_S) + np.where(np.arange(100) % 2, 5.0, 0.0)[:, None]
    motion = point_motion(PointTrack(TIMES_S, points, sigmas), CAMERA, half_window_s=0.3)
    np.testing.assert_allclose(
        motion.at(TIMES_S[20:80]).positions_px, path(TIMES_S[20:80]), atol=1e-3
    )


def test_distortion_is_removed():
    camera = Camera(CAMERA.K, 346, 260, "radtan", (-0.2, 0.05, 0.001, -0.001, 0.01))
    times_s = TIMES_S[:60]
    seen = PointTrack(times_s, distort_points(camera, path(times_s)))
    wanted_s = np.linspace(0.3, 2.0, 9)
    found = point_motion(seen, camera).at(wanted_s).positions_px
    np.testing.assert_allclose(found, path(wanted_s), atol=1e-5)


def test_rows_of_a_rolling_shutter_have_times_of_their_own():
    camera = Camera(CAMERA.K, 346, 260, readout_s=0.03)
    shown_s, seen = TIMES_S.copy(), path(TIMES_S)
    for _ in range(5):
        seen = path(shown_s + 0.03 * seen[:, 1] / 259.0)
    motion = point_motion(PointTrack(shown_s, seen), camera)
    wanted_s = np.linspace(0.3, 3.5, 9)
    np.testing.assert_allclose(motion.at(wanted_s).positions_px, path(wanted_s), atol=1e-6)


def test_a_readout_longer_than_a_frame_is_refused():
    with pytest.raises(SsacError, match="readout_s is 50 ms, but frames follow each other in 40"):
        point_motion(track_of(TIMES_S), Camera(CAMERA.K, 346, 260, readout_s=0.05))
