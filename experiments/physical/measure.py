"""A recording on the bench in; what a method finds, beside the truth as far as it is known, out.

The flights are simulated and kept as any others. What the room adds, and the calibration, are drawn
when they are loaded, so that kinds that differ in these alone share a recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure
from experiments.lab.grid import Cell
from experiments.lab.recorded import Pair, load_pair
from experiments.lab.scored import Frames, Row, frames_of, scored_row
from experiments.physical.imperfections import SetUp
from sim.disturb import merged
from sim.effects.config import SensorEffects
from sim.scene.trajectory import SplineConfig
from sim.seeds import generator
from sim.sensor.events import SensorConfig
from sim.twin.bench import TwinConfig, bench_rig, hanging_of
from sim.twin.calibration import CalibrationConfig, calibrated_camera, calibrated_pose, exact
from sim.twin.room import RoomConfig, room_events
from ssac.camera import Camera, Rig
from ssac.events import US_PER_S
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import METHODS
from ssac.track.observation import Observation

SETTLING_S = 0.1
"""First part of a recording that is left out: pixels that leak or flicker start all at once."""

# Branches of the set-up's seed, beside those of `sim.twin`.
_INTRINSICS_STREAM, _POSE_STREAM = 50, 51


@dataclass(frozen=True)
class PhysicalCell(Cell):
    """A method on one kind of recording of one flight; its `parameters` are its columns."""

    bench: SetUp  # whose `sim` is the cell's

    @property
    def inputs(self) -> tuple[Any, ...]:
        """Everything beside recording and code that its row depends on."""
        return (*super().inputs, replace(self.bench, sim=TwinConfig()))


@dataclass(frozen=True)
class Flown:
    """A flight as it was recorded, and what was made of it last."""

    pair: Pair  # whose rig is the true one
    frames: tuple[Frames, Frames]
    seen: dict[SetUp, Chain] = field(default_factory=dict)


def load_physical(cells: Sequence[PhysicalCell], cache: Cache) -> Flown:
    """Load a recording, which is simulated if it is not there yet."""
    folder = cache.recording_folder(cells[0].sim, cells[0].seed)
    frames = frames_of(folder, [METHODS[cell.method] for cell in cells], cache)
    return Flown(load_pair(folder), frames)


def physical_row(cell: PhysicalCell, flown: Flown) -> Row:
    """Run one method on one kind of a recording, and score it."""
    if cell.bench not in flown.seen:
        flown.seen.clear()  # the cells of a kind follow each other
        flown.seen[cell.bench] = _recorded(cell, flown)
    return scored_row(cell, flown.seen[cell.bench])


PHYSICAL = Measure(load_physical, physical_row, Row)


def known_rig(bench: SetUp) -> Rig:
    """Give what is known of a bench: the intrinsics, and the pose that errors are measured against.

    What is not calibrated is the truth. A calibration is its set-up's: all recordings share it.
    """
    sim = bench.sim
    same_for = replace(
        sim, spline=SplineConfig(), sensor=SensorConfig(), effects=SensorEffects(), textured=False,
        turning=True,
    )  # fmt: skip
    return _known_rig(same_for, bench.calibration, bench.is_calibrated, bench.is_truth_calibrated)


@lru_cache(32)
def _known_rig(
    sim: TwinConfig, config: CalibrationConfig, is_calibrated: bool, is_truth_calibrated: bool
) -> Rig:
    rig = bench_rig(sim)
    cameras = [
        calibrated_camera(camera, config, generator(sim.setup_seed, _INTRINSICS_STREAM, index))
        if is_calibrated
        else exact(camera)
        for index, camera in enumerate(rig.cameras)
    ]
    T_2_1 = rig.relative_pose(0, 1)
    if is_truth_calibrated:
        T_2_1 = calibrated_pose(rig, cameras, config, generator(sim.setup_seed, _POSE_STREAM))
    first, second = (
        Camera(
            one.K,
            camera.width,
            camera.height,
            camera.distortion_model,
            one.distortion_coeffs,
            one.intrinsics_std_px,
        )
        for one, camera in zip(cameras, rig.cameras, strict=True)
    )
    return Rig(first, second, T_2_1)


def _recorded(cell: PhysicalCell, flown: Flown) -> Chain:
    """Make of a recording what the bench's cameras saw."""
    bench, cameras = cell.bench, []
    scene, hanging = None, None
    for index, frames in enumerate(flown.frames):
        events = flown.pair[:2][index].events
        if bench.room != RoomConfig():
            scene = scene or bench.sim.scene(cell.seed)
            hanging = hanging or hanging_of(bench.sim, cell.seed)
            added = room_events(bench.room, scene, hanging, bench.sim.sensor, cell.seed, index)
            events = merged(events, added)
        events = events[events["t"] >= round(US_PER_S * SETTLING_S)]
        if bench.polarity is not None:
            events = events[events["p"] == bench.polarity]
        cameras.append(Observation(events, *frames))
    return Chain(cameras, known_rig(bench), cell.estimator)
