"""Clocks that stray, and the streams of a seed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim.recorded import Drift, drift_of
from sim.recording import SimConfig, simulate
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.lattice import Lattice
from sim.scene.trajectory import SplineConfig
from sim.seeds import generator, sequence
from sim.storage import record
from tests.sim.scenes import with_time_offset

QUICK = SimConfig(
    spline=SplineConfig(duration_s=1.0),
    sampling=SamplingConfig(max_step_px=1.0),
    render=RenderConfig(Lattice(3, 1), check=False),
)
DRIFTING = replace(QUICK, skew_ppm=-20_000.0, clock_jump=(0.7, 0.005))


def test_a_clock_that_does_not_stray_adds_nothing():
    times_us = np.arange(-5, 1000)
    assert not drift_of(0.0, None, 1e-3).added_us(times_us).any()


@pytest.mark.parametrize("skew_ppm", [50.0, -50.0, 100_000.0, -100_000.0])
def test_the_skew_adds_its_share_since_the_middle_and_keeps_the_order(skew_ppm):
    times_us = np.arange(0, 2_000_000, 7)
    drift = drift_of(skew_ppm, None, 2.0)
    expected_us = skew_ppm * 1e-6 * (times_us - 1e6)
    # Half a microsecond by rounding, and the last digits of a float.
    np.testing.assert_allclose(drift.added_us(times_us), expected_us, rtol=0, atol=0.5 + 1e-6)
    dense_us = np.arange(0, 50_000)
    assert np.diff(dense_us + drift.added_us(dense_us)).min() >= 0


def test_a_jump_adds_its_size_from_its_time_on():
    added_us = Drift(jump=(0.5, 0.02)).added_us(np.array([0, 499_999, 500_000, 900_000]))
    np.testing.assert_array_equal(added_us, [0, 0, 20_000, 20_000])


@pytest.mark.render
def test_a_drifting_clock_changes_the_stamps_of_camera_2_and_nothing_else():
    plain, drifting = simulate(QUICK, 5), simulate(DRIFTING, 5)
    np.testing.assert_array_equal(plain.cameras[0].events, drifting.cameras[0].events)
    drift = drifting.truth.drift
    assert drift == Drift(-20_000.0, 0.5, (0.7, 0.005))
    events = plain.cameras[1].events.copy()
    assert len(events) > 1000
    events["t"] += drift.added_us(events["t"])
    np.testing.assert_array_equal(drifting.cameras[1].events, events)
    assert np.diff(events["t"]).min() >= 0
    times_us = plain.cameras[1].frames.times_us
    np.testing.assert_array_equal(
        drifting.cameras[1].frames.times_us, times_us + drift.added_us(times_us)
    )
    # And one recording serves all offsets, to the last bit.
    shifted = simulate(replace(DRIFTING, t_d_s=0.0123456), 5)
    again = with_time_offset(drifting, 0.0123456)
    np.testing.assert_array_equal(again.cameras[1].events, shifted.cameras[1].events)
    np.testing.assert_array_equal(
        again.cameras[1].frames.times_us, shifted.cameras[1].frames.times_us
    )


@pytest.mark.render
def test_the_truth_tells_how_the_clock_strays(tmp_path: Path):
    for name, config in (("plain", QUICK), ("drifting", DRIFTING)):
        record(config, 0, tmp_path / name, {})
    plain, drifting = (
        json.loads((tmp_path / name / "truth.json").read_text()) for name in ("plain", "drifting")
    )
    assert (plain["skew_ppm"], plain["t_ref_s"], plain["clock_jump"]) == (0.0, 0.5, None)
    assert (drifting["skew_ppm"], drifting["t_ref_s"]) == (-20_000.0, 0.5)
    assert drifting["clock_jump"] == {"at_s": 0.7, "size_s": 0.005}


def test_a_stream_is_the_branch_that_numpy_spawns() -> None:
    branch = np.random.SeedSequence(5).spawn(4)[3].spawn(2)[1]
    np.testing.assert_array_equal(sequence(5, 3, 1).generate_state(8), branch.generate_state(8))
    expected = np.random.default_rng(branch).random(100)
    np.testing.assert_array_equal(generator(5, 3, 1).random(100), expected)


def test_streams_and_seeds_have_no_number_in_common() -> None:
    streams = [generator(seed, *at) for seed in (0, 1) for at in ((), (0,), (1,), (0, 1), (1, 0))]
    drawn = np.concatenate([stream.integers(0, 2**63, 100) for stream in streams])
    assert len(np.unique(drawn)) == len(drawn)
