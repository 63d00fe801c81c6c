"""A clock converts times both ways, and is the inverse of the other camera's."""

import numpy as np
import pytest

from ssac.clock import Clock

TIMES_S = np.linspace(-50.0, 150.0, 1001)
KNOTS_S = np.arange(0.0, 101.0, 5.0)
CLOCKS = {
    "the same": Clock(),
    "delay": Clock(-0.7),
    "skew": Clock(0.05, 1000.0, 41.0),
    "fast by a half": Clock(12.0, 5e5, -3.0),
    "pieces": Clock(0.05, -300.0, 41.0, KNOTS_S, 0.02 * np.sin(KNOTS_S / 9.0)),
}


@pytest.mark.parametrize("clock", CLOCKS.values(), ids=CLOCKS)
def test_times_come_back_and_swapped_cameras_have_the_inverse_clock(clock):
    shown_s, back_s = clock.cam2_from_cam1(TIMES_S), clock.cam1_from_cam2(TIMES_S)
    inverse = clock.inverse()
    for found_s, expected_s in (
        (clock.cam1_from_cam2(shown_s), TIMES_S),
        (clock.cam2_from_cam1(back_s), TIMES_S),
        (inverse.cam2_from_cam1(TIMES_S), back_s),
        (inverse.cam1_from_cam2(TIMES_S), shown_s),
    ):
        # Rounding at 150 s.
        np.testing.assert_allclose(found_s, expected_s, rtol=0, atol=2e-13)


def test_a_clock_is_what_it_says():
    delay, skew = Clock(0.0123), CLOCKS["skew"]
    np.testing.assert_array_equal(delay.cam2_from_cam1(TIMES_S), TIMES_S + 0.0123)
    np.testing.assert_array_equal(delay.cam1_from_cam2(TIMES_S), TIMES_S - 0.0123)
    assert skew.cam2_from_cam1(41.0) == 41.05  # the offset holds at the reference
    assert skew.cam2_from_cam1(51.0) == pytest.approx(51.06, abs=1e-12)  # 1000 ppm of 10 s
    strays = Clock(0.0, 0.0, 0.0, np.array([0.0, 10.0]), np.array([0.001, 0.003]))
    added_s = strays.added_s(np.array([-5.0, 0.0, 5.0, 10.0, 20.0]))
    np.testing.assert_allclose(added_s, [0.001, 0.001, 0.002, 0.003, 0.003])
