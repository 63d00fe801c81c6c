import numpy as np
import pytest

from experiments.scenes import scene
from experiments.scenes.scene import AUTHORS_SAMPLE, SceneFigures, scene_figures, scene_table
from sim.recorded import Recording
from sim.recording import SimConfig, simulate
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.lattice import Lattice
from sim.scene.trajectory import SplineConfig
from sim.sensor.frames import FrameConfig
from tests.sim.scenes import with_time_offset


@pytest.fixture(scope="module")
def recording() -> Recording:
    config = SimConfig(
        spline=SplineConfig(duration_s=6.0),
        sampling=SamplingConfig(max_step_px=1.0),
        render=RenderConfig(lattice=Lattice(4, 1)),
        frames=FrameConfig(rate_hz=0.0),
    )
    return simulate(config, 0)


@pytest.mark.render
def test_figures_are_those_of_the_truth(recording: Recording) -> None:
    figures = scene_figures(recording)
    # What the truth says of the drone's origin: the mean of its events moves with it, but for the
    # windows that N_min drops, which are the slow ones.
    centres = recording.truth.centres_px
    speeds = np.linalg.norm(np.gradient(centres, recording.truth.times_s, axis=1), axis=-1)
    assert figures.speed_px_s == pytest.approx(np.nanmedian(speeds), rel=0.25)
    assert 0 < figures.median_distance_px < figures.mean_distance_px < 2.0
    assert figures.slope_px > 0.0
    assert figures.n_events == np.mean([len(camera.events) for camera in recording.cameras])


@pytest.mark.render
def test_figures_do_not_depend_on_the_offset(recording: Recording) -> None:
    early, late = (scene_figures(with_time_offset(recording, t_d_s)) for t_d_s in (0.0, 0.25))
    assert early == late


def test_the_command_flies_what_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    flown = []

    def take(config: SimConfig, seed: int) -> SceneFigures:
        flown.append((config.drone, config.angle_deg, config.spline.duration_s, seed))
        return SceneFigures(198.0, 348, 400, 0.41, 0.2, 1.3, 20.0, 45.0, 1e6)

    monkeypatch.setattr(scene, "simulate", take)
    monkeypatch.setattr(scene, "scene_figures", lambda figures: figures)
    scene.scene_command(seeds=2, first_seed=9100, drone="two-tone")
    assert flown == [("two-tone", 90.0, 20.0, seed) for seed in (9100, 9101)]


def test_the_table_has_a_row_for_each_figure() -> None:
    table = scene_table(SceneFigures(197.6, 348, 400, 0.412, 0.2, 1.3, 19.6, 45.4, 1e6))
    lines = table.splitlines()
    assert len(lines) == 2 + len(AUTHORS_SAMPLE)
    assert lines[2] == "| median image speed [px/s] | 198 | 198 |"
    assert lines[3] == "| sample times valid in both views | 348 of 400 | 348 of 400 |"
    assert lines[7] == "| width in the event image [px] | 20-45 | 20-45 |"
