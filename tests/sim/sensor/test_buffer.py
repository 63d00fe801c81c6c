"""Events come out of the buffer in order, whatever the order and the times they went in with."""

import numpy as np
import pytest

from sim.sensor.kernels import EventBuffer

WIDTH, HEIGHT = 7, 5


def filled(t_s: np.ndarray, seed: int) -> tuple[EventBuffer, np.ndarray]:
    """Fill a buffer with events at random pixels; returns t [us], x, y and p too, (n, 4)."""
    rng, n = np.random.default_rng(seed), len(t_s)
    about = np.stack([rng.integers(0, high, n) for high in (WIDTH, HEIGHT, 2)])
    buffer = EventBuffer()
    buffer.n = n
    buffer.t_s[:n] = t_s
    buffer.x[:n], buffer.y[:n], buffer.p[:n] = about
    return buffer, np.column_stack([np.rint(1e6 * t_s).astype(np.int64), *about])


# A microsecond is shared by many events, and in the last case time, pixel and index do not fit one
# number of 64 bits: 51, 6 and 9 bits.
@pytest.mark.parametrize("span_s", [1e-5, 1.0, 2e9])
@pytest.mark.parametrize("n", [0, 1, 300])
def test_by_time_row_column_and_order_of_emission(span_s: float, n: int) -> None:
    t_s = span_s * (np.random.default_rng(n).integers(0, 10, n) / 10 - 0.3)
    buffer, rows = filled(t_s, n)
    taken = buffer.take(np.inf, WIDTH, HEIGHT)
    expected = rows[np.lexsort((rows[:, 1], rows[:, 2], rows[:, 0]))]  # a stable sort
    np.testing.assert_array_equal(np.stack([taken[name] for name in "txyp"], axis=1), expected)
    assert buffer.n == 0


def test_those_that_stay_are_taken_next() -> None:
    t_s = np.random.default_rng(1).uniform(0.0, 1e-3, 500)
    buffer, rows = filled(t_s, 1)
    first, second = buffer.take(400.0, WIDTH, HEIGHT), buffer.take(np.inf, WIDTH, HEIGHT)
    assert first["t"].max() < 400
    assert second["t"].min() >= 400
    taken = np.concatenate([first, second])
    expected = rows[np.lexsort((rows[:, 1], rows[:, 2], rows[:, 0]))]
    np.testing.assert_array_equal(np.stack([taken[name] for name in "txyp"], axis=1), expected)
