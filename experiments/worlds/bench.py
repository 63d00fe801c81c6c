"""The twin of the paper's small-scale bench, with no, one, all or all but one imperfection.

Each entry of IMPERFECTIONS changes some fields of a `SetUp`, most of them to the values of the
preset of the paper's camera, so that the ideal bench and the real one differ in nothing else.

Flights are simulated and cached as any others. The room's events and the calibration are drawn when
a recording is loaded, so that kinds that differ in these alone share it.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from operator import attrgetter
from typing import Annotated, Any

from experiments.lab.cache import Cache
from experiments.lab.cell import Measure
from experiments.lab.grid import Cell, changed, flight_seed
from experiments.lab.recorded import Flown, Pair, load_pair
from experiments.lab.scored import Row, frames_of, scored_row
from sim.disturb import merged
from sim.effects.config import SENSOR_PRESETS, SensorEffects
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.lattice import Lattice
from sim.scene.trajectory import SplineConfig
from sim.seeds import generator
from sim.sensor.events import SensorConfig
from sim.twin.bench import TwinConfig, bench_rig, hanging_of
from sim.twin.calibration import CalibrationConfig, calibrated_camera, calibrated_pose, exact
from sim.twin.room import RoomConfig, room_events
from ssac.camera import Camera, Rig
from ssac.cli.options import number
from ssac.config import Config
from ssac.events import US_PER_S
from ssac.pipeline.chain import Chain

COMMAND = "ssac physical"

_FEWER = "Recordings at each point; fewer for a trial run."
Recordings = Annotated[
    int | None, number(_FEWER, 1, 1000, metavar="COUNT", default_words="the study's")
]
"""Option of the command."""

PRESET = SENSOR_PRESETS["davis346"]
ANGLES_DEG = (43.14, 65.06, 95.18, 131.77)  # of the paper's data-1 to data-4
LIGHT_STD = 0.1  # of the logarithm of a room's light within a recording
SHADOW = 0.3  # share of the light that a hand's shadow takes
WIRE_M = 1e-4  # a hair, or the finest fishing line
FLICKER_DEPTH = 0.05  # of lamps at the mains that pass for steady ones
FRAME_GAP_S = 0.006  # of 5 to 25 ms: with 10, `ssac`'s error of t_d is twice the paper's
CAMERA2_LIGHT = 0.7  # apertures that were set by eye: half a stop

# A quarter of other studies' samples per pixel, and steps as long as ESIM's, halve the run time.
# They change the number of events by 1 to 2.6 % on trials of the real bench, whose lens blurs by
# 0.5 px, and by 4 % on an ideal one, at edges that light what another edge is about to cover.
RENDER = RenderConfig(lattice=Lattice(8, 1), check=False)
SAMPLING = SamplingConfig(max_step_px=0.5)

NONE, ALL = "none", "all"

SETTLING_S = 0.1
"""First part of a recording that is left out: pixels that leak or flicker start all at once."""

SEARCH_AROUND_TRUTH_S = (-1.0, 1.0)  # as of the simulation tables
_MOTION_SEEDS, _SETUP_SEEDS = 14, 15  # sets of seeds, beside that of the simulation tables

# Branches of the set-up's seed, beside those of `sim.twin`.
_INTRINSICS_STREAM, _POSE_STREAM = 50, 51


@dataclass(frozen=True)
class SetUp:
    """All that a recording and the known rig of a bench depend on, except seeds."""

    sim: TwinConfig
    room: RoomConfig = field(default_factory=RoomConfig)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    is_calibrated: bool = False  # the known intrinsics are a calibration's; else the true ones
    is_truth_calibrated: bool = False  # errors are measured against a calibrated pose
    polarity: int | None = None  # of the events that are used: 1 or 0; None: both


def _preset(*names: str) -> dict[str, Any]:
    """Return some of the preset's fields, named as fields of a `SetUp`."""
    return {f"sim.{name}": attrgetter(name)(PRESET) for name in names}


IMPERFECTIONS: Mapping[str, Mapping[str, Any]] = {
    "turning": {"sim.turning": True},
    "texture": {"sim.textured": True},
    "mismatch": _preset("sensor.threshold_mismatch"),
    "noise": _preset(
        "sensor.leak_hz", "sensor.hot_pixel_share", "sensor.hot_pixel_hz", "sensor.shot_noise_hz",
        "sensor.background_hz", "effects.dim_noise_on_hz", "effects.dim_noise_off_hz",
        "effects.dim_noise_exponent", "effects.noise_spread_decades", "effects.leak_jitter",
        "effects.hot_clusters", "effects.hot_cluster_hz",
    ),
    "low-pass": _preset(
        "effects.cutoff_hz_per_lux", "effects.cutoff_min_hz", "effects.cutoff_max_hz"
    ),
    "latency": _preset(
        "effects.latency_s", "effects.latency_lux_s", "effects.jitter_s", "effects.jitter_lux_s"
    ),
    "readout": _preset("sensor.refractory_s", "effects.readout_hz", "effects.readout_queue"),
    "frame gaps": {
        "sim.effects.frame_gap_s": FRAME_GAP_S,
        **_preset("effects.frame_phase_spread", "effects.frame_read_noise",
                  "effects.frame_full_well_e"),
    },
    "blur": _preset("effects.blur_px"),
    "flicker": {"sim.effects.flicker_depth": FLICKER_DEPTH},
    "unequal light": {"sim.effects.camera2_light": CAMERA2_LIGHT},
    "changing light": {"room.light_std": LIGHT_STD},
    "shadow": {"room.shadow": SHADOW},
    "wire": {"room.wire_m": WIRE_M},
    "intrinsics": {"is_calibrated": True},
    "truth": {"is_truth_calibrated": True},
}  # fmt: skip
"""By name: the fields of a `SetUp` that differ from the ideal bench, with their values."""


only, all_but = "only {}".format, "all but {}".format
"""Names of the kinds that have one imperfection, or all but one."""

KINDS: Mapping[str, Collection[str]] = {
    NONE: (),
    **{only(name): (name,) for name in IMPERFECTIONS},
    **{all_but(name): [one for one in IMPERFECTIONS if one != name] for name in IMPERFECTIONS},
    ALL: IMPERFECTIONS,
}
"""Kinds of benches in the error budget, by name: the imperfections of each."""


def ideal(angle_deg: float, duration_s: float, setup_seed: int) -> SetUp:
    """Give the bench without any imperfection: the drone hangs level before an even wall."""
    spline = SplineConfig(duration_s=duration_s)
    sim = TwinConfig(
        angle_deg=angle_deg,
        spline=spline,
        setup_seed=setup_seed,
        turning=False,
        textured=False,
        sampling=SAMPLING,
        render=RENDER,
        sensor=SensorConfig(PRESET.sensor.threshold_on, PRESET.sensor.threshold_off),
        effects=SensorEffects(illuminance_lux=PRESET.effects.illuminance_lux),
    )
    return SetUp(sim)


def bench_of(kind: str, angle_deg: float, duration_s: float, setup_seed: int) -> SetUp:
    """Give the bench of a kind, one of KINDS."""
    return spoilt(ideal(angle_deg, duration_s, setup_seed), KINDS[kind])


def spoilt(bench: SetUp, names: Iterable[str]) -> SetUp:
    """Add imperfections to a bench."""
    return changed(bench, {k: v for name in names for k, v in IMPERFECTIONS[name].items()})


@dataclass(frozen=True)
class PhysicalCell(Cell):
    """A method on one kind of recording of one flight; its `parameters` are columns of its row."""

    bench: SetUp  # whose `sim` is the cell's

    @property
    def inputs(self) -> tuple[Any, ...]:
        """Everything beside recording and code that its row depends on."""
        return (*super().inputs, replace(self.bench, sim=TwinConfig()))


def setup_seed(angle_deg: float, number: int) -> int:
    """Return the seed of a set-up at an angle; number 0 is that of the tables."""
    return flight_seed(0.0, angle_deg, number, _SETUP_SEEDS)


def cells_of(
    bench: SetUp,
    named: dict[str, object],
    flight: int,
    t_ds_ms: Sequence[float],
    methods: Sequence[str],
) -> Iterator[PhysicalCell]:
    """Yield every method at every offset on one recording; `named` are their first columns."""
    sim, (low_s, high_s) = bench.sim, SEARCH_AROUND_TRUTH_S
    flown = {"duration_s": sim.spline.duration_s, "angle_deg": sim.angle_deg}
    seed = flight_seed(sim.spline.duration_s, sim.angle_deg, flight, _MOTION_SEEDS)
    for t_d_ms in t_ds_ms:
        t_d_s, columns = 1e-3 * t_d_ms, {**named, **flown, "t_d_ms": t_d_ms}
        estimator = Config(interval_s=(t_d_s + low_s, t_d_s + high_s))
        for method in methods:
            yield PhysicalCell(sim, flight, seed, t_d_s, estimator, method, columns, bench)


def load_physical(cells: Sequence[PhysicalCell], cache: Cache) -> Flown:
    """Load a recording, which is simulated if it is not there yet."""
    folder = cache.recording_folder(cells[0].sim, cells[0].seed)
    pair = load_pair(folder, frames_of(cells))
    return Flown(lambda _: pair, cells[0].seed)


def physical_row(cell: PhysicalCell, flown: Flown) -> Row:
    """Run one method on one kind of a recording, and score it."""
    return scored_row(cell, flown.made(cell.bench, lambda: _recorded(cell, flown.flight)))


PHYSICAL = Measure(load_physical, physical_row, Row)


@lru_cache(32)
def known_rig(bench: SetUp) -> Rig:
    """Return the known rig of a bench: intrinsics, and the pose that errors are measured against.

    Both are true unless a calibration gives them, which all recordings of a set-up share.
    """
    sim, config, rig = bench.sim, bench.calibration, bench_rig(bench.sim)
    cameras = [
        calibrated_camera(camera, config, generator(sim.setup_seed, _INTRINSICS_STREAM, index))
        if bench.is_calibrated
        else exact(camera)
        for index, camera in enumerate(rig.cameras)
    ]
    cam1, cam2 = (
        Camera(one.K, camera.width, camera.height, camera.distortion_model,
               one.distortion_coeffs, one.intrinsics_std_px)
        for camera, one in zip(rig.cameras, cameras, strict=True)
    )  # fmt: skip
    T_2_1 = rig.relative_pose(0, 1)
    if bench.is_truth_calibrated:
        T_2_1 = calibrated_pose(rig, cameras, config, generator(sim.setup_seed, _POSE_STREAM))
    return Rig(cam1, cam2, T_2_1)


def _recorded(cell: PhysicalCell, pair: Pair) -> Chain:
    """Add the room's events to a recording, and select those that the method is given."""
    bench, cameras = cell.bench, []
    filmed = None
    if bench.room != RoomConfig():
        filmed = bench.sim.scene(cell.seed), hanging_of(bench.sim, cell.seed)
    for index, camera in enumerate((pair.cam1, pair.cam2)):
        events = camera.events
        if filmed:
            added = room_events(bench.room, *filmed, bench.sim.sensor, cell.seed, index)
            events = merged(events, added)
        events = events[events["t"] >= round(US_PER_S * SETTLING_S)]
        if bench.polarity is not None:
            events = events[events["p"] == bench.polarity]
        cameras.append(replace(camera, events=events))
    return Chain(cameras, known_rig(bench), cell.estimator)
