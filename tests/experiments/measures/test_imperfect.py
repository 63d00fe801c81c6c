"""Imperfect recordings: what is made of a flight, and how an estimate of it is scored."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.measures.imperfect import (
    FlownImperfect,
    ImperfectCell,
    imperfect_row,
    scored,
    spoilt_pair,
)
from experiments.measures.imperfect_kinds import KINDS, SCENES, SKEW_STD_PPM, T_D_S, Kind
from sim.disturb import DisturbConfig
from sim.recording import SimConfig
from ssac.estimate import Estimate
from tests.experiments.synthetic_flight import DURATION_S, SCENE, flown

SEED = 5
T = SCENE.t / np.linalg.norm(SCENE.t)


def test_the_plain_kind_adds_an_offset_and_nothing_else() -> None:
    flight = flown()
    pair = spoilt_pair(flight, None, KINDS["ordinary"], SEED, DURATION_S)
    assert np.array_equal(pair.cam1.events, flight.cam1.events)
    assert np.array_equal(pair.cam2.events, flight.cam2.delayed(T_D_S).events)
    for one, other in ((pair.rig.cam1, flight.rig.cam1), (pair.rig.cam2, flight.rig.cam2)):
        assert np.array_equal(one.K, other.K)
        assert not any(one.intrinsics_std_px)
    assert np.array_equal(pair.rig.T_2_1, flight.rig.T_2_1)


def test_what_a_kind_says_is_added() -> None:
    kind = Kind(
        "ordinary", DisturbConfig(lamp_px=4, second_object=0.2, intrinsics_error=(1, 3)), 50
    )
    flight, other = flown(), flown(1)
    pair = spoilt_pair(flight, other, kind, SEED, DURATION_S)
    lamp = 16 * 100 * 4 * DURATION_S
    for camera, plain, second in (
        (pair.cam1, flight.cam1, other.cam1),
        (pair.cam2, flight.cam2, other.cam2),
    ):
        expected = len(plain.events) + lamp + 0.2 * len(second.events)
        # Of the second object a share is drawn: 5 deviations of it, and what a lamp's jitter loses.
        spread = 5 * 0.4 * np.sqrt(len(second.events)) + 20
        assert len(camera.events) == pytest.approx(expected, abs=spread)
        assert np.all(np.diff(camera.events["t"]) >= 0)
    end_us = pair.cam2.events["t"][-1] - pair.cam1.events["t"][-1]
    skew_us = 0.5 * DURATION_S * kind.skew_ppm(SEED)
    # Of the lamp's last step in both views, 0.1 ms of jitter each way times a few deviations.
    assert end_us == pytest.approx(1e6 * T_D_S + skew_us, abs=1000)
    assert pair.rig.cam1.intrinsics_std_px == pytest.approx((2.0, 2.0, 3.0, 3.0))
    assert not np.array_equal(pair.rig.cam1.K, flight.rig.cam1.K)
    assert not np.array_equal(
        pair.rig.cam1.K - flight.rig.cam1.K, pair.rig.cam2.K - SCENE.rig.cam2.K
    )


def test_skews_are_drawn_from_their_deviation() -> None:
    kind = KINDS["skew"]
    drawn = [kind.skew_ppm(seed) for seed in range(200)]
    # The deviation of 200 draws scatters by 5 %.
    assert np.std(drawn) == pytest.approx(SKEW_STD_PPM, rel=0.25)
    assert KINDS["ordinary"].skew_ppm(3) == 0.0


def test_every_scene_has_kinds_and_every_kind_a_scene() -> None:
    assert {kind.scene for kind in KINDS.values()} == set(SCENES)
    assert all(sim.t_d_s == T_D_S for sim in SCENES.values())
    textures = [file for sim in SCENES.values() for file in sim.background_files]
    assert textures
    assert all(file.is_file() for file in textures)


def estimate(error_s: float = 0.0, **values: object) -> Estimate:
    fields = {
        "t_d_s": T_D_S + error_s, "t_d_std_s": 1e-3, "R": SCENE.R, "t": T,
        "covariance": np.diag([1e-6] + 5 * [1e-4]),
    } | values  # fmt: skip
    return Estimate("joint", **fields)  # type: ignore[arg-type]


def test_an_offset_is_scored_where_it_holds() -> None:
    """At t_ref the true offset of clocks that drift is another than in the middle."""
    found = estimate(1e-4, t_ref_s=5.0, skew_ppm=110.0, skew_std_ppm=20.0)
    row = scored(found, flown().rig, skew_ppm=100.0, t_mid_s=3.0)
    assert row.t_d_normalised == pytest.approx(-0.1)  # 0.1 ms found of 100 ppm times 2 s
    assert row.t_d_error_ms == pytest.approx(0.1)
    assert row.skew_normalised == pytest.approx(0.5)
    assert (row.offset_given, row.pose_given) == (True, True)
    assert row.r_mahalanobis == pytest.approx(0.0, abs=1e-6)


def test_what_is_refused_has_no_errors() -> None:
    refused = scored(estimate(1.0, status="no_match"), flown().rig, 0.0, 3.0)
    assert (refused.offset_given, refused.pose_given) == (False, False)
    assert np.isnan([refused.t_d_normalised, refused.r_mahalanobis, refused.t_d_error_ms]).all()
    open_pose = scored(estimate(2e-3, status="ambiguous_pose"), flown().rig, 0.0, 3.0)
    assert (open_pose.offset_given, open_pose.pose_given) == (True, False)
    assert open_pose.t_d_normalised == pytest.approx(2.0)
    assert np.isnan(open_pose.r_mahalanobis)
    known = replace(estimate(), method="joint-known")
    assert not scored(known, flown().rig, 0.0, 3.0).pose_given


def test_a_method_is_run_on_what_was_spoilt() -> None:
    spline = replace(SimConfig().spline, duration_s=DURATION_S)
    cell = ImperfectCell(
        SimConfig(spline=spline), 0, SEED, "good calibration", SEED + 1, "joint-known"
    )
    row = imperfect_row(cell, FlownImperfect(flown(), None))
    assert row.status == "ok", row.reason
    assert row.n_events_cam1 == len(flown().cam1.events)
    assert row.t_d_error_ms < 5.0  # a few times the scatter of these points over 6 s
    assert np.isfinite([row.t_d_normalised, row.skew_normalised]).all()
