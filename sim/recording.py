"""The whole chain, from a configuration and a seed to the recordings of all cameras and the truth.

`stream` is the chain; it hands on frames and events as they are made. `simulate` keeps them in
memory, `sim.storage.record` writes them to files.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Float32Array, IntArray
from sim.effects.camera import CameraEffects
from sim.effects.config import SensorEffects
from sim.errors import SimError
from sim.recorded import (
    CameraRecording,
    Drift,
    Flight,
    Jump,
    OpenSink,
    Recording,
    drift_of,
    truth_of,
)
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.footprint import choose_instants
from sim.render.renderer import Crops, Renderer
from sim.scene.background import load_background, uniform_background
from sim.scene.drone import Drone, drone_from_file
from sim.scene.flyers import DRONES, FLAP_HZ, built_in_drone
from sim.scene.rig import (
    DISTANCE_M,
    FOCAL_PX,
    PRINCIPAL_POINT,
    RESOLUTION,
    Camera,
    Rig,
    two_view_rig,
)
from sim.scene.trajectory import (
    PosesAt,
    SplineConfig,
    Trajectory,
    random_spline,
    trajectory_from_csv,
)
from sim.seeds import generator
from sim.sensor.events import Sensor, SensorConfig
from sim.sensor.frames import FrameConfig, FrameExposer, Frames, frame_times_us
from sim.sensor.kernels import EVENT_DTYPE

_TRAJECTORY_STREAM, _SENSOR_STREAM = 0, 1  # branches of the seed

Progress = Callable[[float], None]
"""Takes the share of the work done, 0 to 1."""


def unseen(_share: float) -> None:
    """Show no progress."""


@dataclass(frozen=True)
class Scene:
    """What is filmed, and from where."""

    rig: Rig
    backgrounds: tuple[Float32Array, ...]  # luminance of the empty view of each camera
    drone: Drone
    trajectory: Trajectory


@dataclass(frozen=True)
class SimConfig:
    """Everything that a recording depends on, except its seed.

    A set-up of another kind is a subclass with a `scene` of its own.
    """

    angle_deg: float = 90.0  # between the two lines of sight, 0 to 180 exclusive
    t_d_s: float = 0.0  # t_cam2 = t_cam1 + t_d
    skew_ppm: float = 0.0  # by which camera 2's clock runs fast; t_d then holds in mid-recording
    clock_jump: Jump | None = None  # of camera 2's clock: scene time and size [s]
    spline: SplineConfig = field(default_factory=SplineConfig)
    trajectory_file: Path | None = None  # CSV, instead of a random spline
    drone: str = "quadrotor"  # one of sim.scene.flyers.DRONES
    drone_size_m: float | None = None  # None: the default, or the file's own size
    drone_file: Path | None = None  # any mesh, instead of a built-in drone
    rotor_hz: float = 0.0  # turns per second of a quadrotor's rotors
    flap_hz: float = FLAP_HZ  # beats per second of the bird's wings
    distance_m: float = DISTANCE_M  # of both cameras from the point they look at
    focal_px: float = FOCAL_PX
    resolution: tuple[int, int] = RESOLUTION
    principal_point: tuple[float, float] = PRINCIPAL_POINT
    distortion_model: str = "none"
    distortion_coeffs: tuple[float, ...] = ()
    background_luminance: float = 0.4
    background_files: tuple[Path, ...] = ()  # one image for all cameras, or one for each
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    render: RenderConfig = field(default_factory=RenderConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)
    frames: FrameConfig = field(default_factory=FrameConfig)
    effects: SensorEffects = field(default_factory=SensorEffects)

    def __post_init__(self) -> None:
        if self.drone not in DRONES:
            raise SimError(f"drone: expected one of {', '.join(DRONES)}, got {self.drone!r}")
        gap_s, rate_hz = self.effects.frame_gap_s, self.frames.rate_hz
        if gap_s * rate_hz >= 1.0:
            raise SimError(
                f"effects: frame_gap_s must be less than 1 / rate_hz of the frames = "
                f"{1.0 / rate_hz:g} s, got {gap_s:g}: no event would be left"
            )

    @property
    def duration_s(self) -> float:
        """Duration of the flight [s]."""
        if self.trajectory_file is not None:
            return trajectory_from_csv(self.trajectory_file).duration_s
        return self.spline.duration_s

    def scene(self, seed: int) -> Scene:
        """Build what is filmed with a seed."""
        rig = two_view_rig_of(self)
        if self.trajectory_file is not None:
            trajectory = trajectory_from_csv(self.trajectory_file)
        else:
            trajectory = random_spline(self.spline, generator(seed, _TRAJECTORY_STREAM))
        return Scene(rig, tuple(_backgrounds(self, rig)), _drone(self), trajectory)


def two_view_rig_of(config: SimConfig) -> Rig:
    """Place the two cameras of a configuration, each with its lens and clock."""
    return two_view_rig(
        config.angle_deg,
        distance_m=config.distance_m,
        focal_px=config.focal_px,
        resolution=config.resolution,
        principal_point=config.principal_point,
        distortion_model=config.distortion_model,
        distortion_coeffs=config.distortion_coeffs,
        t_d_s=config.t_d_s,
    )


class _InMemory:
    """A sink that keeps all frames and events in memory."""

    def __init__(self, camera: Camera, times_us: IntArray, exposure_s: float) -> None:
        self.camera = camera
        self.images = np.empty((len(times_us), camera.height, camera.width), np.uint8)
        self.frames = Frames(times_us, self.images, exposure_s)
        self.events: list[NDArray[Any]] = [np.empty(0, EVENT_DTYPE)]

    def take_frame(self, k: int, image: NDArray[np.uint8]) -> None:
        self.images[k] = image

    def add(self, events: NDArray[Any]) -> None:
        self.events.append(events)

    def close(self) -> None:
        self.events = [np.concatenate(self.events)]


def simulate(config: SimConfig, seed: int, progress: Progress = unseen) -> Recording:
    """Simulate one flight of one drone, seen by all cameras.

    The seed, 0 or positive, is the only source of randomness. The offset does not enter into it:
    recordings that differ in `t_d_s` alone differ in camera 2's timestamps alone. `progress` is
    called now and then with the share of the work done, 0 to 1. SimError for invalid input, or
    when OpenGL is needed and not available.
    """
    sinks: list[_InMemory] = []

    def open_sink(*about: Any) -> _InMemory:
        sinks.append(_InMemory(*about))
        return sinks[-1]

    flight = stream(config, seed, open_sink, progress)
    cameras = tuple(CameraRecording(sink.camera, sink.events[0], sink.frames) for sink in sinks)
    return Recording(**vars(flight), cameras=cameras)


def stream(
    config: SimConfig, seed: int, open_sink: OpenSink, progress: Progress = unseen
) -> Flight:
    """Simulate one flight as `simulate` does, and pass frames and events to sinks as they are made.

    Cameras record one after the other, each into a sink opened for it. Memory grows by some numbers
    per instant; a sensor with temporal noise or effects also holds a camera's events to the end.
    """
    if seed < 0:
        raise SimError(f"seed: expected 0 or a positive integer, got {seed}")
    scene = config.scene(seed)
    drift = drift_of(config.skew_ppm, config.clock_jump, scene.trajectory.duration_s)
    n_instants = 0
    with Renderer(scene.drone, config.render, seed) as renderer:
        for index in range(len(scene.rig.cameras)):
            added = drift if index == 1 else Drift()
            n_instants += _record(config, scene, seed, index, renderer, added, open_sink, progress)
    truth = truth_of(scene.rig, scene.trajectory, config.t_d_s, drift)
    return Flight(scene.rig, truth, n_instants, renderer.context, renderer.check)


def _record(
    config: SimConfig,
    scene: Scene,
    seed: int,
    index: int,
    renderer: Renderer,
    drift: Drift,
    open_sink: OpenSink,
    progress: Progress,
) -> int:
    """Render, sense and expose one camera's view in batches; returns the number of instants."""
    camera, sharp = scene.rig.cameras[index], scene.backgrounds[index]
    n_cameras = len(scene.rig.cameras)
    instants_s = choose_instants(scene.drone, camera, scene.trajectory, config.sampling)
    start_s, end_s = float(instants_s[0]), float(instants_s[-1])
    rng = generator(seed, _SENSOR_STREAM, index)
    effects = CameraEffects(config.effects, config.sensor, config.frames, sharp, seed, index)
    background = effects.background
    times_us = frame_times_us(config.frames, end_s, effects.frame_start_s)
    clock_us = round(1e6 * camera.time_offset_s)
    stamps_us = times_us + drift.added_us(times_us) + clock_us
    sink = open_sink(camera, stamps_us, config.frames.exposure_s)
    take = effects.through_noise(sink.take_frame)
    exposer = FrameExposer(config.frames, background, len(times_us), take, effects.frame_start_s)

    def hand_on(events: NDArray[Any]) -> None:
        events["t"] += drift.added_us(events["t"]) + clock_us
        sink.add(events)

    sensor: Sensor | None = None
    T_W_B = PosesAt(scene.trajectory, instants_s)
    for crops in map(effects.through_lens, renderer.crops(camera, instants_s, T_W_B, sharp)):
        exposer.feed(*crops)
        if sensor is None:  # the first image is that of the start, in view or not
            image = background.copy()
            height, width = crops.luminance.shape[1:]
            y0, x0 = crops.y0_px[0], crops.x0_px[0]
            image[y0 : y0 + height, x0 : x0 + width] = crops.luminance[0]
            sensor = effects.start_sensor(image, start_s, rng)
            n_seen = int(crops.times_s[0] == start_s)  # by the sensor, when it starts
            crops = Crops._make(values[n_seen:] for values in crops)
        if len(crops.times_s):
            sensor.feed(*crops)
            hand_on(sensor.take_settled())
            progress((index + float(crops.times_s[-1]) / end_s) / n_cameras)
    if sensor is None:  # never in view
        sensor = effects.start_sensor(background, start_s, rng)
    hand_on(effects.read_out(sensor.finish(end_s), end_s))
    exposer.finish()
    sink.close()
    progress((index + 1) / n_cameras)
    return len(instants_s)


def _backgrounds(config: SimConfig, rig: Rig) -> list[Float32Array]:
    files = config.background_files
    if len(files) not in (0, 1, len(rig.cameras)):
        raise SimError(
            f"background: expected one image for all cameras or one for each of the "
            f"{len(rig.cameras)}, got {len(files)}"
        )
    if not files:
        return [uniform_background(camera, config.background_luminance) for camera in rig.cameras]
    each = files * len(rig.cameras) if len(files) == 1 else files
    return [load_background(path, camera) for path, camera in zip(each, rig.cameras, strict=True)]


def _drone(config: SimConfig) -> Drone:
    if config.drone_file is not None:
        if config.rotor_hz:
            raise SimError("rotors spin on the built-in quadrotors only: leave out rotor_hz")
        return drone_from_file(config.drone_file, config.drone_size_m)
    return built_in_drone(config.drone, config.drone_size_m, config.rotor_hz, config.flap_hz)
