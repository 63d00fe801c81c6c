"""A camera's events and a seed in; the same events with clutter among them out."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.disturb.clouds import clouds
from sim.disturb.config import DisturbConfig
from sim.disturb.movers import branches, people
from sim.disturb.pixels import View, hot_clusters, lamp, noise
from sim.seeds import generator, sequence
from sim.sensor.buffer import EVENT_DTYPE

FloatArray = NDArray[np.float64]
Draw = Callable[[View, Any, np.random.Generator], NDArray[Any]]
"""Draws the clutter of a kind in a view, as much as the second argument says."""

# Branches of the seed, beside those of `sim.recording`: each disturbance has a stream of its own,
# so that one more leaves the others as they are.
_STREAM = 2
_SECOND, _INTRINSICS, *_CLUTTER = range(8)


def second_seed(seed: int) -> int:
    """Seed of the flight of the second object in a recording with a seed."""
    return int(sequence(seed, _STREAM, _SECOND).generate_state(1)[0])


def clutter(config: DisturbConfig, view: View, seed: int, camera: int) -> NDArray[Any]:
    """Draw all that fires in a view beside the drone, but for a second object.

    Parameters
    ----------
    config
    view
    seed
        Of the recording.
    camera
        Index of the camera: each has clutter of its own.

    Returns
    -------
    NDArray[Any]
        Of EVENT_DTYPE, in order of time; the scene's clock.

    Raises
    ------
    SimError
        When something does not fit into the view.
    """
    kinds: tuple[tuple[Draw, float], ...] = (
        (lamp, config.lamp_px),
        (hot_clusters, config.hot_clusters),
        (noise, config.noise_hz),
        (branches, config.branches),
        (people, config.people),
        (clouds, config.clouds_px_s),
    )
    parts: list[NDArray[Any]] = [np.empty(0, EVENT_DTYPE)]
    for stream, (draw, amount) in zip(_CLUTTER, kinds, strict=True):
        if amount:
            parts.append(draw(view, amount, generator(seed, _STREAM, stream, camera)))
    return merged(*parts)


def thinned(events: NDArray[Any], share: float, seed: int, camera: int) -> NDArray[Any]:
    """Keep a share of the events of a second object, drawn at random."""
    return events[generator(seed, _STREAM, _SECOND, camera).random(len(events)) < share]


def merged(*streams: NDArray[Any]) -> NDArray[Any]:
    """Sort streams of events into one; of events at a time, those of the first come first."""
    events = np.concatenate(streams)
    order = np.argsort(events["t"], kind="stable")
    return np.take(events, order)


def wrong_intrinsics(
    K: FloatArray, config: DisturbConfig, seed: int, camera: int
) -> tuple[FloatArray, FloatArray]:
    """Draw intrinsics as a calibration of stated deviations would give them.

    Parameters
    ----------
    K
        The true ones (3, 3) [px].
    config
    seed, camera
        As of `clutter`.

    Returns
    -------
    K : (3, 3) array
        What the rig is to say [px]. All four numbers are wrong independently.
    deviations_px : (4,) array
        Of fu, fv, pu and pv.
    """
    percent, centre_px = config.intrinsics_error
    focal = 0.01 * percent
    deviations_px = np.array([focal * K[0, 0], focal * K[1, 1], centre_px, centre_px])
    errors_px = deviations_px * generator(seed, _STREAM, _INTRINSICS, camera).standard_normal(4)
    wrong = K.copy()
    wrong[[0, 1, 0, 1], [0, 1, 2, 2]] += errors_px
    return wrong, deviations_px
