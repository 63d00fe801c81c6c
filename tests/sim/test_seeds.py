"""Streams of a seed: each its own, and those that NumPy would branch off."""

import numpy as np

from sim.seeds import generator, sequence


def test_a_stream_is_the_branch_that_numpy_spawns() -> None:
    branch = np.random.SeedSequence(5).spawn(4)[3].spawn(2)[1]
    np.testing.assert_array_equal(sequence(5, 3, 1).generate_state(8), branch.generate_state(8))
    expected = np.random.default_rng(branch).random(100)
    np.testing.assert_array_equal(generator(5, 3, 1).random(100), expected)


def test_streams_and_seeds_have_no_number_in_common() -> None:
    streams = [generator(seed, *at) for seed in (0, 1) for at in ((), (0,), (1,), (0, 1), (1, 0))]
    drawn = np.concatenate([stream.integers(0, 2**63, 100) for stream in streams])
    assert len(np.unique(drawn)) == len(drawn)
