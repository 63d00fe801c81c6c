"""The independent streams of random numbers that branch off one seed.

Each random quantity has a stream of its own, so that more or fewer draws of it leave all others
unchanged. The first number of a stream is a constant beside the code that draws; all differ.
"""

import numpy as np


def generator(seed: int, *stream: int) -> np.random.Generator:
    """Return the stream of a seed (0 or positive) for a quantity and its part, such as a camera."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=stream))
