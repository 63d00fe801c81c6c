import pytest

from experiments.physical.imperfections import (
    ALL,
    IMPERFECTIONS,
    KINDS,
    NONE,
    all_but,
    bench_of,
    had_by,
    ideal,
    only,
)
from experiments.physical.measure import known_rig
from sim.twin.bench import bench_rig
from ssac.errors import SsacError

PLACE = (65.06, 10.0, 7)


def test_a_kind_has_the_imperfections_that_it_says() -> None:
    names = set(IMPERFECTIONS)
    assert set(had_by(NONE)) == set()
    assert set(had_by(ALL)) == names
    for name in names:
        assert set(had_by(only(name))) == {name}
        assert set(had_by(all_but(name))) == names - {name}
    assert len(KINDS) == len(set(KINDS)) == 2 * len(names) + 2


def test_each_imperfection_changes_the_ideal_bench_and_its_lack_the_real_one() -> None:
    assert bench_of(NONE, *PLACE) == ideal(*PLACE)
    benches = [bench_of(kind, *PLACE) for kind in KINDS]
    assert len(set(benches)) == len(KINDS)


def test_a_kind_that_is_none_is_refused() -> None:
    with pytest.raises(SsacError, match=r"unknown kind 'only rain': use none, all.*turning"):
        bench_of("only rain", *PLACE)


def test_what_is_not_calibrated_is_true() -> None:
    true = bench_rig(ideal(*PLACE).sim)
    rig = known_rig(ideal(*PLACE))
    assert (rig.cam1.K == true.cameras[0].K).all()
    assert (true.relative_pose(0, 1) == rig.T_2_1).all()
    of_intrinsics, of_truth, of_all = (
        known_rig(bench_of(kind, *PLACE)) for kind in (only("intrinsics"), only("truth"), ALL)
    )
    assert (of_intrinsics.cam1.K != true.cameras[0].K).any()
    assert (of_intrinsics.T_2_1 == rig.T_2_1).all()
    assert (of_truth.cam1.K == rig.cam1.K).all()
    assert (of_truth.T_2_1 != rig.T_2_1).any()
    # One calibration has both errors, and the pose's then also has those of the intrinsics.
    assert (of_all.cam1.K == of_intrinsics.cam1.K).all()
    assert (of_all.T_2_1 != of_truth.T_2_1).any()
