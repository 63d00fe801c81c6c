"""Two paths as sets of points, without times, in; the similarity that lays one on the other, out.

Iterative closest points, as the paper registers its outdoor path to RTK: each point of the estimate
goes with the nearest of the truth. What is left is a distance between shapes: an error along the
path, as of a wrong clock, does not show in it.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ssac.errors import SsacError
from ssac.network.align import Similarity, similarity

Array = NDArray[np.float64]

_MOST_POINTS = 2000  # of the estimate, evenly, while it is moved
_N_STEPS = 200
_DONE = 1e-7  # change of the distance, by itself
_MOST_GROWTH = 2.0  # of the scale from its start: the nearest points of a small path are one point


def registered(
    source: Array, target: Array, start: Similarity | None, with_scale: bool
) -> tuple[Similarity, Array]:
    """Register one path to another.

    Parameters
    ----------
    source, target
        Points (n, 3) and (m, 3) [m]; the target's dense beside the errors that are sought.
    start
        Where to begin; None: where the middles, sizes and main axes agree, in the best of the ways
        that they can, for which both must be of the whole flight.
    with_scale
        Whether the scale is free.

    Returns
    -------
    tuple of Similarity and NDArray
        From the source's frame to the target's, and the distance (n,) [m] of each point.
    """
    tree = KDTree(target)
    thin = source[:: max(1, len(source) // _MOST_POINTS)]
    starts = [start] if start is not None else [*_by_main_axes(source, target, with_scale)]
    found = [_closest(thin, target, tree, each, with_scale) for each in starts]
    # By the scale: a path that shrinks is near to everything.
    best, _ = min(found, key=lambda fit: fit[1] / fit[0].scale)
    return best, np.asarray(tree.query(best.apply(source))[0])


def _closest(
    source: Array, target: Array, tree: KDTree, start: Similarity, with_scale: bool
) -> tuple[Similarity, float]:
    """Move the source until its distances rest; give the similarity and their RMS [m]."""
    fit, before = start, np.inf
    for _ in range(_N_STEPS):
        distances, nearest = tree.query(fit.apply(source))
        rms = float(np.sqrt(np.mean(distances**2)))
        if before - rms <= _DONE * rms:
            break
        before = rms
        try:
            moved = similarity(source, target[nearest], with_scale)
        except SsacError:
            break  # all nearest to one stretch of the truth
        if not 1.0 / _MOST_GROWTH < moved.scale / start.scale < _MOST_GROWTH:
            break
        fit = moved
    return fit, before


def _by_main_axes(source: Array, target: Array, with_scale: bool) -> Iterator[Similarity]:
    """Yield the four similarities that take main axes to main axes."""
    (middle, axes, size), (middle_target, axes_target, size_target) = map(_main, (source, target))
    scale = size_target / size if with_scale else 1.0
    for one, two in product((1.0, -1.0), repeat=2):
        signs = np.array([one, two, one * two])
        R = (axes_target * signs) @ axes.T
        yield Similarity(scale, R, middle_target - scale * R @ middle)


def _main(points: Array) -> tuple[Array, Array, float]:
    """Give the middle (3,), main axes (3, 3) in columns, right-handed, and RMS size of points."""
    middle = points.mean(axis=0)
    _, values, axes = np.linalg.svd(points - middle, full_matrices=False)
    if len(points) < 3 or values[1] <= 0.0:
        raise SsacError("a path of points on a line does not tell how it is turned")
    axes = axes.T * np.array([1.0, 1.0, np.linalg.det(axes)])
    return middle, axes, float(np.sqrt(np.sum(values**2) / len(points)))
