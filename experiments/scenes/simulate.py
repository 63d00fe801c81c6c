"""A command line in, a simulated recording as a folder out: `ssac simulate`."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from tqdm import tqdm

from experiments.run.provenance import plain, versions
from experiments.scenes.scene import scene_figures, scene_table
from sim.errors import SimError
from sim.recording import Recording, SimConfig, simulate
from sim.render.instants import SamplingConfig
from sim.render.lattice import Lattice
from sim.render.renderer import RenderConfig
from sim.scene.flyers import DRONES
from sim.scene.trajectory import SplineConfig
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from sim.storage import check_out_dir, save_recording

_DEFAULT = SimConfig()


def simulate_with_progress(config: SimConfig, seed: int, label: str = "simulating") -> Recording:
    """Run the simulator with a progress bar on stderr."""
    # The delay keeps the bar from appearing before a line about bad input.
    style = "{l_bar}{bar}| {remaining} left"
    with tqdm(total=100, desc=label, bar_format=style, delay=0.5) as bar:

        def show(share: float) -> None:
            bar.update(round(100 * share) - bar.n)

        return simulate(config, seed, show)


def simulate_command(
    out_dir: Annotated[
        Path, typer.Argument(help="New folder for the recording.", show_default=False)
    ],
    angle: Annotated[float, typer.Option(help="Between the two lines of sight [deg].")] = 90.0,
    duration: Annotated[float, typer.Option(help="Of the flight [s].")] = 20.0,
    t_d: Annotated[float, typer.Option(help="Offset: t_cam2 = t_cam1 + t_d [s].")] = 0.0,
    seed: Annotated[int, typer.Option(help="The same seed gives the same bytes.")] = 0,
    trajectory: Annotated[
        Path | None,
        typer.Option(help="CSV t,x,y,z,qx,qy,qz,qw instead of a random spline; sets the duration."),
    ] = None,
    drone: Annotated[
        str, typer.Option(help=f"{', '.join(DRONES)}, or a mesh file.")
    ] = _DEFAULT.drone,
    drone_size: Annotated[
        float | None, typer.Option(help="Largest extent of the drone [m].")
    ] = None,
    rotor_hz: Annotated[
        float, typer.Option(help="Turns per second of the quadrotor's rotors.")
    ] = 0.0,
    flap_hz: Annotated[
        float, typer.Option(help="Beats per second of the bird's wings.")
    ] = _DEFAULT.flap_hz,
    distance: Annotated[
        float, typer.Option(help="Of the cameras from the point they look at [m].")
    ] = _DEFAULT.distance_m,
    spread: Annotated[
        float,
        typer.Option(help="Extent of the random flight; less keeps a near drone in view."),
    ] = 1.0,
    focal: Annotated[float, typer.Option(help="Focal length [px].")] = _DEFAULT.focal_px,
    resolution: Annotated[
        tuple[int, int], typer.Option(help="Width and height [px].")
    ] = _DEFAULT.resolution,
    distortion_model: Annotated[
        str, typer.Option(help="none, radtan or equidistant.")
    ] = _DEFAULT.distortion_model,
    distortion: Annotated[
        tuple[float, float, float, float],
        typer.Option(help="Its coefficients: k1 k2 p1 p2 (radtan) or k1 k2 k3 k4 (equidistant)."),
    ] = (0.0, 0.0, 0.0, 0.0),
    background: Annotated[
        list[Path] | None,
        typer.Option(help="Image behind the drone; once for all cameras, or once for each."),
    ] = None,
    background_luminance: Annotated[
        float, typer.Option(help="Of the sky where there is no image, 0 to 1.")
    ] = _DEFAULT.background_luminance,
    noise: Annotated[str, typer.Option(help=f"Sensor preset: {', '.join(PRESETS)}.")] = "ideal",
    threshold_on: Annotated[
        float, typer.Option(help="Contrast threshold C+, of log intensity.")
    ] = _DEFAULT.sensor.threshold_on,
    threshold_off: Annotated[
        float, typer.Option(help="Contrast threshold C-.")
    ] = _DEFAULT.sensor.threshold_off,
    frame_rate: Annotated[
        float, typer.Option(help="Intensity frames per second; 0 for none.")
    ] = _DEFAULT.frames.rate_hz,
    exposure: Annotated[
        float, typer.Option(help="Exposure time of a frame [s].")
    ] = _DEFAULT.frames.exposure_s,
    max_step: Annotated[
        float, typer.Option(help="Largest image motion between rendered instants [px].")
    ] = _DEFAULT.sampling.max_step_px,
    lattice: Annotated[
        tuple[int, int],
        typer.Option(help="Supersampling a b: a*a + b*b samples per pixel, b = 0 or 1."),
    ] = (_DEFAULT.render.lattice.a, _DEFAULT.render.lattice.b),
    gl: Annotated[str, typer.Option(help="GL backend: auto, osmesa or egl.")] = "auto",
    text: Annotated[bool, typer.Option("--text", help="Write ESIM text files too.")] = False,
    figures: Annotated[
        bool,
        typer.Option("--figures", help="Print the scene's figures beside the authors' sample."),
    ] = False,
) -> None:
    """Simulate two event cameras that watch one drone, and write the recording as a folder."""
    if noise not in PRESETS:
        raise SimError(f"--noise: expected one of {', '.join(PRESETS)}, got {noise!r}")
    config = SimConfig(
        angle_deg=angle,
        t_d_s=t_d,
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
        render=RenderConfig(lattice=Lattice(*lattice), backend=gl),
        sensor=replace(PRESETS[noise], threshold_on=threshold_on, threshold_off=threshold_off),
        frames=FrameConfig(rate_hz=frame_rate, exposure_s=exposure),
    )
    check_out_dir(out_dir)
    recording = simulate_with_progress(config, seed)
    provenance = {"config": plain(config), "seed": seed, "versions": versions()}
    save_recording(recording, out_dir, provenance, text)
    typer.echo(summary(recording, out_dir))
    if figures:
        typer.echo(scene_table(scene_figures(recording)))


def _drone(name: str) -> dict[str, Any]:
    """Tell a built-in drone's name from a mesh file's: fields of a SimConfig."""
    if name in DRONES:
        return {"drone": name}
    if not Path(name).exists():
        raise SimError(
            f"--drone: {name} does not exist: expected a mesh file, or one of {', '.join(DRONES)}"
        )
    return {"drone_file": Path(name)}


def _spline(duration_s: float, spread: float) -> SplineConfig:
    """Scale the default box of random positions, and the circle that keeps clear of cameras."""
    if not (math.isfinite(spread) and spread > 0.0):
        raise SimError(f"--spread: expected a positive number, got {spread}")
    x, y, z = (spread * multiplier for multiplier in _DEFAULT.spline.multiplier_xyz_m)
    radius_m = spread * _DEFAULT.spline.max_radius_m
    return SplineConfig(duration_s, multiplier_xyz_m=(x, y, z), max_radius_m=radius_m)


def summary(recording: Recording, out_dir: Path) -> str:
    """Say in a few lines what was recorded and where it lies."""
    lines = [
        f"{camera.camera.name}: {len(camera.events)} events, {len(camera.frames.images)} frames"
        for camera in recording.cameras
    ]
    gl = recording.gl
    lines.append(f"{recording.n_instants} instants rendered with {gl.backend} ({gl.renderer})")
    lines.append(f"written to {out_dir}")
    return "\n".join(lines)
