"""True values in place of the estimates of `tangency`: they are right, and remove the error."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.lab.cache import Cache
from experiments.studies import tangency as oracle
from experiments.studies.tangency import CauseCell, FilmedPair
from sim.recording import SimConfig
from sim.scene.trajectory import SplineConfig
from sim.sensor.frames import FrameConfig
from ssac.camera import known_pose
from ssac.geometry.epipolar import fundamental_from_pose, sampson_distance
from ssac.geometry.pose import pencils
from ssac.methods import tangency
from ssac.track.outline import tangents

pytestmark = pytest.mark.render

T_D_S = 0.05
SIM = SimConfig(t_d_s=T_D_S, spline=SplineConfig(5.0), frames=FrameConfig(rate_hz=0.0))
CELL = CauseCell(SIM, 0, 1, oracle.AS_IT_IS)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> FilmedPair:
    return oracle.load_filmed([CELL], Cache(tmp_path_factory.mktemp("cache")))


def test_true_tangents_are_pairs_and_move_as_they_are_said_to(flown: FilmedPair) -> None:
    R, t = known_pose(flown.pair.rig)
    Ks = flown.pair.rig.cam1.K, flown.pair.rig.cam2.K
    times_s = np.arange(0.5, 4.5, 0.005)
    of_cameras = zip(flown.filmed, pencils(R, t, *Ks), (0.0, T_D_S), strict=True)
    both = [filmed.tangents(pencil, times_s + late_s) for filmed, pencil, late_s in of_cameras]
    F = fundamental_from_pose(*Ks, R, t)
    for (one_px, _), (other_px, px_s) in zip(*both, strict=True):
        np.testing.assert_allclose(sampson_distance(F, one_px, other_px), 0.0, atol=1e-9)
        # Normal to itself, a tangent moves as its point of contact, if that is the same for long.
        stays = np.linalg.norm(np.diff(other_px, axis=0), axis=1) < 2.0
        moved = np.sum(np.diff(other_px, axis=0) * px_s[:-1], axis=1) / 0.005
        assert np.median(np.abs(moved / np.sum(px_s[:-1] ** 2, axis=1) - 1.0)[stays]) < 0.05


def test_truth_takes_the_error_away_and_each_truth_is_used(flown: FilmedPair) -> None:
    found = {one: oracle.cause_row(replace(CELL, cause=one), flown) for one in oracle.CAUSES}
    assert {one.status for one in found.values()} == {"ok"}
    errors_ms = {cause: one.t_d_error_ms for cause, one in found.items()}
    for cause, share in ((oracle.TANGENTS, 1e-3), (oracle.BOTH, 1e-3), (oracle.BODY, 0.5)):
        assert errors_ms[cause] < share * errors_ms[oracle.AS_IT_IS], cause
    assert found[oracle.POSE].r_error_deg == found[oracle.POSE].t_error_deg == 0.0
    used = (oracle.AS_IT_IS, oracle.POSE, oracle.VELOCITIES, oracle.CLOCKS)
    assert len({errors_ms[cause] for cause in used}) == len(used)
    assert tangency.tangents is tangents  # the original function is back in place
