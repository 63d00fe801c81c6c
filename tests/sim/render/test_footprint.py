"""Where a drone's outline lies in a camera, and how far it moves: on flights straight through."""

import numpy as np
import pytest

from sim.render.footprint import footprint, outline_points
from sim.scene.flyers import quadrotor
from sim.scene.rig import two_view_rig
from tests.sim.scenes import LENSES

DRONE = quadrotor()


def across_the_view(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Fly from far left to far right of camera 1, level, in n instants of a second."""
    times_s = np.linspace(0.0, 1.0, n)
    T_W_B = np.tile(np.eye(4), (n, 1, 1))
    T_W_B[:, 0, 3] = 16.0 * (times_s - 0.5)
    return times_s, T_W_B


@pytest.mark.parametrize("lens", LENSES)
def test_only_steps_with_both_ends_in_view_count(lens: str) -> None:
    camera = two_view_rig(90.0, distortion_model=lens, distortion_coeffs=LENSES[lens]).cameras[0]
    seen = footprint(DRONE, camera, *across_the_view(200))
    entered = int(np.argmax(seen.visible))
    left = len(seen.visible) - int(np.argmax(seen.visible[::-1]))
    assert 0 < entered < left < 200
    assert seen.visible[entered:left].all()
    assert not seen.moved_px[: entered + 1].any()
    assert not seen.moved_px[left:].any()
    assert (seen.moved_px[entered + 1 : left] > 0.0).all()


def test_the_fastest_point_counts() -> None:
    times_s, T_W_B = across_the_view(200)
    camera = two_view_rig(90.0).cameras[0]
    seen = footprint(DRONE, camera, times_s, T_W_B)
    # All points are as fast; in the image those nearest to the camera are the fastest, which is
    # f v / z with the least depth.
    expected_px = camera.K[0, 0] * 16.0 / 199 / seen.depth_m[:, 0]
    moving = seen.moved_px > 0.0
    np.testing.assert_allclose(seen.moved_px[moving], expected_px[moving], rtol=1e-9)


def test_more_instants_than_are_projected_at_a_time() -> None:
    camera = two_view_rig(90.0).cameras[0]
    times_s, T_W_B = across_the_view(9000)
    whole = footprint(DRONE, camera, times_s, T_W_B)
    part = footprint(DRONE, camera, times_s[4000:4200], T_W_B[4000:4200])  # over 4096
    np.testing.assert_allclose(whole.moved_px[4001:4200], part.moved_px[1:], rtol=1e-9)
    np.testing.assert_array_equal(whole.low_px[4000:4200], part.low_px)


@pytest.mark.parametrize("rotor_hz", [0.0, 30.0])
def test_the_compiled_pass_finds_what_the_camera_projects(rotor_hz: float) -> None:
    """A lens that could distort, but does not, takes the other way."""
    drone = quadrotor(rotor_hz=rotor_hz)
    plain, bent = (
        two_view_rig(30.0, distortion_model=lens, distortion_coeffs=coeffs).cameras[1]
        for lens, coeffs in (("none", ()), ("radtan", (0.0, 0.0, 0.0, 0.0)))
    )
    ours, theirs = (footprint(drone, camera, *across_the_view(200)) for camera in (plain, bent))
    assert ours.visible.any()
    np.testing.assert_array_equal(ours.visible, theirs.visible)
    # Rounding: of a few parts in 1e16, of some 1000 px.
    np.testing.assert_allclose(ours.low_px, theirs.low_px, rtol=0, atol=1e-11)
    np.testing.assert_allclose(ours.high_px, theirs.high_px, rtol=0, atol=1e-11)
    np.testing.assert_allclose(ours.depth_m, theirs.depth_m, rtol=0, atol=1e-13)


def test_where_lines_bend_points_along_the_edges_are_outline_too() -> None:
    plain, bent = (
        two_view_rig(90.0, distortion_model=lens, distortion_coeffs=LENSES[lens]).cameras[0]
        for lens in ("none", "radtan")
    )
    longest_m = DRONE.size_m / 4
    for corners, points in zip(
        outline_points(DRONE, plain), outline_points(DRONE, bent), strict=True
    ):
        assert len(points) >= len(corners)
        span_m = np.linalg.norm(np.ptp(corners, axis=0))
        if span_m > 3.0 * longest_m:
            assert len(points) > len(corners)
