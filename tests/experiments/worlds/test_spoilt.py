"""Flights that are spoilt by clutter, by clocks with skew or a jump, or by wrong intrinsics."""

import numpy as np
import pytest

from experiments.lab.recorded import Flown, Pair
from experiments.worlds.spoilt import SCENES, T_D_S, Kind, spoilt_pair
from sim.disturb import DisturbConfig, View, clutter, thinned
from tests.experiments.reported import DURATION_S, SCENE, flown
from tests.ssac.synthetic import HEIGHT, WIDTH

SEED = 5


def made(kind: Kind) -> Pair:
    flights = {SEED: 0, SEED + 1: 1}
    return spoilt_pair(Flown(lambda seed: flown(flights[seed]), SEED, SEED + 1), kind, DURATION_S)


@pytest.mark.parametrize(("kind", "second"), [("ordinary", 0), ("20 s", 1)])
def test_a_plain_kind_adds_an_offset_alone_and_others_fly_before_camera_2(kind, second) -> None:
    flight, pair = flown(), made(Kind(kind, others=second > 0))
    assert np.array_equal(pair.cam1.events, flight.cam1.events)
    assert np.array_equal(pair.cam2.events, flown(second).cam2.delayed(T_D_S).events)
    for one, other in ((pair.rig.cam1, flight.rig.cam1), (pair.rig.cam2, flight.rig.cam2)):
        assert np.array_equal(one.K, other.K)
        assert not any(one.intrinsics_std_px)
    assert np.array_equal(pair.rig.T_2_1, flight.rig.T_2_1)


def test_what_a_kind_says_is_added() -> None:
    disturb = DisturbConfig(lamp_px=4, second_object=0.2, intrinsics_error=(1, 3))
    kind = Kind("ordinary", disturb, skew_std_ppm=50)
    flight, other, pair = flown(), flown(1), made(kind)
    view = View(WIDTH, HEIGHT, DURATION_S)
    for k in range(2):
        added = clutter(disturb, view, SEED, k), thinned(other[k].events, 0.2, SEED, k)
        assert len(pair[k].events) == len(flight[k].events) + sum(map(len, added))
        assert np.all(np.diff(pair[k].events["t"]) >= 0)
    end_us = pair.cam2.events["t"][-1] - pair.cam1.events["t"][-1]
    # Either view ends with the lamp's last step, whose jitter is 0.1 ms: a few deviations of both.
    assert end_us == pytest.approx(1e6 * T_D_S + 0.5 * DURATION_S * kind.skew_of(SEED), abs=1000)
    assert pair.rig.cam1.intrinsics_std_px == pytest.approx((2.0, 2.0, 3.0, 3.0))
    off_1, off_2 = pair.rig.cam1.K - SCENE.rig.cam1.K, pair.rig.cam2.K - SCENE.rig.cam2.K
    assert off_1.any()
    assert not np.array_equal(off_1, off_2)


def test_skews_are_drawn_from_their_deviation_and_scenes_have_the_offset_and_textures() -> None:
    drawn = [Kind("ordinary", skew_std_ppm=50.0).skew_of(seed) for seed in range(200)]
    assert np.std(drawn) == pytest.approx(50.0, rel=0.25)  # that of 200 draws scatters by 5 %
    assert Kind("ordinary").skew_of(3) == 0.0
    assert Kind("ordinary", skew_ppm=20.0).skew_of(3) == 20.0
    assert all(sim.t_d_s == T_D_S for sim in SCENES.values())
    assert {file.is_file() for sim in SCENES.values() for file in sim.background_files} == {True}


def test_a_clock_runs_fast_about_the_middle_and_jumps_once() -> None:
    cam2_us = flown().cam2.events["t"]
    fast, stepped = (
        made(kind).cam2.events["t"] - cam2_us - round(1e6 * T_D_S)
        for kind in (Kind("20 s", skew_ppm=50.0), Kind("20 s", jump=(4.0, 5e-3)))
    )
    # Times are rounded to whole microseconds.
    assert np.abs(fast - 5e-5 * (cam2_us - 0.5e6 * DURATION_S)).max() <= 0.5
    assert np.array_equal(stepped, np.where(cam2_us >= 4_000_000, 5_000, 0))


def test_intrinsics_are_off_and_stated_as_a_kind_says() -> None:
    errors = ((0.01, 0.02, 3.0, -2.0), (0.0, 0.0, 0.0, 0.0))
    pair, true = made(Kind("10 s", errors=errors, stated=(1.0, 3.0))), SCENE.rig
    assert np.diag(pair.rig.cam1.K) == pytest.approx(np.diag(true.cam1.K) * (1.01, 1.02, 1.0))
    assert (pair.rig.cam1.K - true.cam1.K)[:2, 2] == pytest.approx((3.0, -2.0))
    assert np.array_equal(pair.rig.cam2.K, true.cam2.K)
    focal_px = 0.01 * true.cam2.K[0, 0]
    assert pair.rig.cam2.intrinsics_std_px == pytest.approx((focal_px, focal_px, 3, 3))
