"""A clock converts times both ways, and is the inverse of the other camera's."""

import numpy as np
import pytest

from ssac.clock import Clock

TIMES_S = np.linspace(-50.0, 150.0, 1001)
KNOTS_S = np.arange(0.0, 101.0, 5.0)
STRAYS_S = 0.02 * np.sin(KNOTS_S / 9.0)
CLOCKS = {
    "the same": Clock(),
    "delay": Clock(-0.7),
    "skew": Clock(0.05, 1000.0, 41.0),
    "fast by a half": Clock(12.0, 5e5, -3.0),
    "pieces": Clock(0.05, -300.0, 41.0, KNOTS_S, STRAYS_S),
}


@pytest.mark.parametrize("clock", CLOCKS.values(), ids=CLOCKS)
def test_times_come_back(clock):
    shown_s = clock.cam2_from_cam1(TIMES_S)
    # Rounding at 150 s.
    np.testing.assert_allclose(clock.cam1_from_cam2(shown_s), TIMES_S, rtol=0, atol=2e-13)
    np.testing.assert_allclose(
        clock.cam2_from_cam1(clock.cam1_from_cam2(TIMES_S)), TIMES_S, rtol=0, atol=2e-13
    )


@pytest.mark.parametrize("clock", CLOCKS.values(), ids=CLOCKS)
def test_swapped_cameras_have_the_inverse_clock(clock):
    inverse = clock.inverse()
    np.testing.assert_allclose(
        inverse.cam2_from_cam1(TIMES_S), clock.cam1_from_cam2(TIMES_S), rtol=0, atol=2e-13
    )
    np.testing.assert_allclose(
        inverse.cam1_from_cam2(TIMES_S), clock.cam2_from_cam1(TIMES_S), rtol=0, atol=2e-13
    )


def test_a_delay_is_a_sum_and_nothing_else():
    np.testing.assert_array_equal(Clock(0.0123).cam2_from_cam1(TIMES_S), TIMES_S + 0.0123)
    np.testing.assert_array_equal(Clock(0.0123).cam1_from_cam2(TIMES_S), TIMES_S - 0.0123)


def test_the_offset_holds_at_the_reference():
    clock = CLOCKS["skew"]
    assert clock.cam2_from_cam1(41.0) == 41.05
    assert clock.cam2_from_cam1(51.0) == pytest.approx(51.06, abs=1e-12)  # 1000 ppm of 10 s


def test_strays_are_linear_between_knots_and_stay_outside():
    clock = Clock(0.0, 0.0, 0.0, np.array([0.0, 10.0]), np.array([0.001, 0.003]))
    np.testing.assert_allclose(
        clock.added_s(np.array([-5.0, 0.0, 5.0, 10.0, 20.0])), [0.001, 0.001, 0.002, 0.003, 0.003]
    )
