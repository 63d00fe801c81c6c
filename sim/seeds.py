"""The streams of random numbers that a seed branches into.

Whatever is drawn has a stream of its own, so that one draw more, or fewer, leaves all others as
they are. The first number of a stream stands beside what draws from it; no two are alike.
"""

import numpy as np


def generator(seed: int, *stream: int) -> np.random.Generator:
    """Branch a seed, 0 or positive, off: by what is drawn, then by the part, such as a camera."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=stream))
