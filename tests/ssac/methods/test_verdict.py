"""What rounded times take away from an offset's certainty."""

import numpy as np
import pytest

from ssac.estimate import Estimate
from ssac.methods.verdict import less_sure


@pytest.mark.parametrize("quanta_s", [(0.0, 0.0), (0.001, 0.0), (0.001, 0.01), (0.01, 0.01)])
def test_rounded_times_widen_the_offsets_deviation_by_that_of_an_even_distribution(quanta_s):
    covariance = np.diag([1e-6, 1e-8, 1e-8, 1e-8, 1e-8, 1e-8])
    found = less_sure(Estimate("joint", t_d_std_s=1e-3, covariance=covariance), quanta_s)
    # Two times, each anywhere in a step: the deviation of such an error is the step over sqrt(12).
    variance = 1e-6 + sum(step_s**2 for step_s in quanta_s) / 12.0
    assert found.t_d_std_s == pytest.approx(np.sqrt(variance), rel=1e-12)
    assert found.covariance[0, 0] == pytest.approx(variance, rel=1e-12)
    np.testing.assert_array_equal(found.covariance[1:, 1:], covariance[1:, 1:])
