"""A command line in, a simulated recording as a folder out: `ssac simulate`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from experiments.lab.bridge import check_mesh, recording_bytes, rig_of
from experiments.scenes.disturb_options import (
    BranchesOption,
    CloudsOption,
    HotClustersOption,
    IntrinsicsErrorOption,
    LampOption,
    NoiseOption,
    PeopleOption,
    SecondObjectOption,
)
from experiments.scenes.effects_options import (
    IDEAL,
    EffectOption,
    IlluminanceOption,
    NoiseNameOption,
    PresetOption,
    chosen_sensor,
)
from experiments.scenes.record import MAX_SEED, record_with_progress, summary
from experiments.scenes.scene import SceneFigures, pair_figures, scene_table
from sim.disturb import DisturbConfig
from sim.errors import SimError
from sim.recorded import MAX_SKEW_PPM
from sim.recording import SimConfig
from sim.render.config import RENDERERS, RenderConfig, SamplingConfig
from sim.render.lattice import Lattice
from sim.scene.flyers import DRONES
from sim.scene.trajectory import SplineConfig
from sim.sensor.frames import FrameConfig
from sim.storage import Recorded
from ssac.console.options import number
from ssac.files.hdf5 import load_events_h5
from ssac.files.temporary import remove_left_over
from ssac.files.whole_file import check_folder
from ssac.track.observation import Observation

_DEFAULT = SimConfig()


def simulate_command(
    out_dir: Annotated[
        Path,
        typer.Argument(metavar="OUT_DIR", help="New folder for the recording.", show_default=False),
    ],
    angle: Annotated[
        float, number("Angle between the two lines of sight.", 1, 179, "degrees")
    ] = 90.0,
    duration: Annotated[float, number("Duration of the flight.", 1, 3600, "seconds")] = 20.0,
    t_d: Annotated[
        float, number("Time offset: t_cam2 = t_cam1 + t_d.", -86400, 86400, "seconds")
    ] = 0.0,
    skew_ppm: Annotated[
        float,
        number(
            "Camera 2's clock runs fast by this rate; t_d then holds at mid-flight.",
            -MAX_SKEW_PPM,
            MAX_SKEW_PPM,
            "ppm",
        ),
    ] = 0.0,
    clock_jump: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="T S", help="Camera 2's clock jumps forward by S seconds (S > 0) at time T."
        ),
    ] = None,
    seed: Annotated[
        int, number("Random seed: the same seed gives the same bytes.", 0, MAX_SEED)
    ] = 0,
    trajectory: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="CSV t,x,y,z,qx,qy,qz,qw instead of a random spline; sets the duration.",
        ),
    ] = None,
    drone: Annotated[
        str, typer.Option(metavar="NAME", help=f"{', '.join(DRONES)}, or a mesh file.")
    ] = _DEFAULT.drone,
    drone_size: Annotated[
        float | None, number("Largest extent of the drone.", 0.01, 100, "metres")
    ] = None,
    rotor_hz: Annotated[
        float, number("Turns per second of a quadrotor's rotors.", -1000, 1000, "hertz")
    ] = 0.0,
    flap_hz: Annotated[
        float, number("Beats per second of the bird's wings.", 0, 100, "hertz")
    ] = _DEFAULT.flap_hz,
    distance: Annotated[
        float, number("Distance of the cameras from the point they look at.", 0.1, 10_000, "metres")
    ] = _DEFAULT.distance_m,
    spread: Annotated[
        float,
        number("Scale of the random flight; below 1 keeps a near drone in view.", 0.01, 100),
    ] = 1.0,
    focal: Annotated[float, number("Focal length.", 10, 100_000, "pixels")] = _DEFAULT.focal_px,
    resolution: Annotated[
        tuple[int, int],
        number("Width and height of each camera's image.", 16, 8192, "pixels", "WIDTH HEIGHT"),
    ] = _DEFAULT.resolution,
    distortion_model: Annotated[
        str, typer.Option(metavar="NAME", help="none, radtan or equidistant.")
    ] = _DEFAULT.distortion_model,
    distortion: Annotated[
        tuple[float, float, float, float],
        number(
            "Distortion coefficients: k1 k2 p1 p2 (radtan) or k1 k2 k3 k4 (equidistant).",
            -10,
            10,
            metavar="K K K K",
        ),
    ] = (0.0, 0.0, 0.0, 0.0),
    background: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Image behind the drone: give one for all cameras, or one for each.",
        ),
    ] = None,
    background_luminance: Annotated[
        float, number("Luminance of the sky where there is no image.", 0, 1)
    ] = _DEFAULT.background_luminance,
    preset: PresetOption = None,
    illuminance: IlluminanceOption = None,
    effect: EffectOption = None,
    noise: NoiseNameOption = IDEAL,
    lamp: LampOption = 0,
    hot_clusters: HotClustersOption = 0,
    noise_hz: NoiseOption = 0.0,
    branches: BranchesOption = 0,
    people: PeopleOption = 0,
    clouds: CloudsOption = 0.0,
    second_object: SecondObjectOption = 0.0,
    intrinsics_error: IntrinsicsErrorOption = (0.0, 0.0),
    threshold_on: Annotated[
        float | None,
        number(
            f"ON contrast threshold, in log intensity; default: {_DEFAULT.sensor.threshold_on:g}, "
            "or the preset's.",
            0.01,
            5,
        ),
    ] = None,
    threshold_off: Annotated[
        float | None, number("OFF contrast threshold; same default.", 0.01, 5)
    ] = None,
    frame_rate: Annotated[
        float, number("Intensity frames per second; 0 for none.", 0, 1000, "hertz")
    ] = _DEFAULT.frames.rate_hz,
    exposure: Annotated[
        float, number("Exposure time of a frame.", 1e-5, 1, "seconds")
    ] = _DEFAULT.frames.exposure_s,
    max_step: Annotated[
        float, number("Largest image motion between rendered instants.", 0.005, 10, "pixels")
    ] = _DEFAULT.sampling.max_step_px,
    lattice: Annotated[
        tuple[int, int],
        number("Supersampling: a*a + b*b samples per pixel, b = 0 or 1.", 0, 64, metavar="A B"),
    ] = (_DEFAULT.render.lattice.a, _DEFAULT.render.lattice.b),
    renderer: Annotated[
        str, typer.Option(metavar="NAME", help=f"Renderer: {' or '.join(RENDERERS)} (OpenGL).")
    ] = _DEFAULT.render.renderer,
    check: Annotated[
        bool,
        typer.Option(
            "--check/--no-check",
            help="Check some instants against OpenGL; --no-check where there is none.",
        ),
    ] = True,
    gl: Annotated[
        str, typer.Option(metavar="NAME", help="GL backend: auto, osmesa or egl.")
    ] = "auto",
    text: Annotated[bool, typer.Option("--text", help="Write ESIM text files too.")] = False,
    figures: Annotated[
        bool,
        typer.Option(
            "--figures", help="Print statistics of the scene beside those of the authors' sample."
        ),
    ] = False,
) -> None:
    """Simulate two event cameras that watch one drone, and write the recording as a folder."""
    chosen = chosen_sensor(preset, noise, threshold_on, threshold_off, illuminance, effect or ())
    config = SimConfig(
        angle_deg=angle,
        t_d_s=t_d,
        skew_ppm=skew_ppm,
        clock_jump=clock_jump,
        spline=_spline(duration, spread),
        trajectory_file=trajectory,
        drone_size_m=drone_size,
        rotor_hz=rotor_hz,
        flap_hz=flap_hz,
        **_drone(drone),
        distance_m=distance,
        focal_px=focal,
        resolution=resolution,
        principal_point=(resolution[0] / 2, resolution[1] / 2),
        distortion_model=distortion_model,
        distortion_coeffs=() if distortion_model == "none" else distortion,
        background_luminance=background_luminance,
        background_files=tuple(background or ()),
        sampling=SamplingConfig(max_step_px=max_step),
        render=RenderConfig(lattice=Lattice(*lattice), renderer=renderer, check=check, backend=gl),
        sensor=chosen.sensor,
        frames=FrameConfig(rate_hz=frame_rate, exposure_s=exposure),
        effects=chosen.effects,
    )
    disturb = DisturbConfig(
        lamp, hot_clusters, noise_hz, branches, people, clouds, second_object, intrinsics_error
    )
    check_folder(out_dir, recording_bytes(config))
    existing = next(folder for folder in out_dir.resolve().parents if folder.exists())
    remove_left_over(existing, out_dir.name)  # of a run that was killed while it wrote
    recorded = record_with_progress(config, seed, out_dir, text, disturb)
    typer.echo(summary(recorded, out_dir))
    if figures:
        typer.echo(scene_table(_figures(recorded, out_dir)))


def _drone(name: str) -> dict[str, Any]:
    """Tell a built-in drone's name from a mesh file's: fields of a SimConfig."""
    if name in DRONES:
        return {"drone": name}
    if not Path(name).exists():
        raise SimError(
            f"--drone: {name} does not exist: expected a mesh file, or one of {', '.join(DRONES)}"
        )
    check_mesh(Path(name))
    return {"drone_file": Path(name)}


def _spline(duration_s: float, spread: float) -> SplineConfig:
    """Scale the default box of random positions, and the circle that keeps clear of cameras."""
    x, y, z = (spread * multiplier for multiplier in _DEFAULT.spline.multiplier_xyz_m)
    radius_m = spread * _DEFAULT.spline.max_radius_m
    return SplineConfig(duration_s, multiplier_xyz_m=(x, y, z), max_radius_m=radius_m)


def _figures(recorded: Recorded, folder: Path) -> SceneFigures:
    """Measure a recording that lies in a folder."""
    flight = recorded.flight
    cam1, cam2 = (
        Observation(load_events_h5(folder / f"{camera.name}.h5").events)
        for camera in flight.rig.cameras[:2]
    )
    return pair_figures(cam1, cam2, rig_of(flight, with_extrinsics=True), flight.truth.t_d_s)
