"""A seed and the numbers of a stream in; the generator of that stream out.

Whatever is drawn has a stream of its own, so that one draw more, or fewer, leaves all others as
they are. The first number of a stream stands beside what draws from it; no two are alike.
"""

import numpy as np


def sequence(seed: int, *stream: int) -> np.random.SeedSequence:
    """Branch a seed off.

    Parameters
    ----------
    seed
        0 or positive: of a recording, or of a set-up.
    stream
        Numbers of the branch: what is drawn, then of which part, such as a camera's index.
    """
    return np.random.SeedSequence(seed, spawn_key=stream)


def generator(seed: int, *stream: int) -> np.random.Generator:
    """Give the generator of a branch, at its beginning; arguments as of `sequence`."""
    return np.random.default_rng(sequence(seed, *stream))
