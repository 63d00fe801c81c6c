"""A flight as two synthetic cameras recorded it: what measures of spoilt recordings start from."""

import numpy as np

from experiments.lab.recorded import Pair
from ssac.camera import Rig
from ssac.track.observation import Observation
from tests.ssac.synthetic import make_events, make_scene

DURATION_S = 6.0
SCENE = make_scene(0, duration_s=DURATION_S)


def flown(seed: int = 0) -> Pair:
    """Synthetic cameras whose clocks show the same, with events within the flight alone."""
    first, second = (
        Observation(events[(events["t"] >= 0) & (events["t"] < 1e6 * DURATION_S)])
        for events in make_events(make_scene(seed, duration_s=DURATION_S), seed, size_m=0.4)
    )
    T_2_1 = np.eye(4)
    T_2_1[:3, :3], T_2_1[:3, 3] = SCENE.R, SCENE.t
    return Pair(first, second, Rig(SCENE.rig.cam1, SCENE.rig.cam2, T_2_1))
