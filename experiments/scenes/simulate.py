"""`ssac simulate`: simulation of event cameras that watch one drone, written to a folder."""

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from scipy.spatial.transform import Rotation

from experiments.lab.cache import recording_bytes
from experiments.lab.provenance import plain, versions
from experiments.lab.recorded import check_mesh
from experiments.scenes.options import OPTIONS, chosen, chosen_sensor
from sim.disturb import DisturbConfig, record_disturbed
from sim.errors import SimError
from sim.recorded import Flight
from sim.recording import Scene, SimConfig
from sim.render.config import RenderConfig
from sim.render.lattice import Lattice
from sim.scene.flyers import DRONES
from sim.scene.rig import Rig, look_at_rig
from sim.scene.trajectory import SplineConfig
from sim.storage import Recorded, partial_parent, record
from ssac.cli.options import argument, with_options
from ssac.cli.progress import compilation_told, progress
from ssac.files.whole_file import check_folder, remove_left_over
from ssac.network.tum import Path as SpacePath
from ssac.network.tum import write_path


@dataclass(frozen=True)
class ManyCameras(SimConfig):
    """Equal cameras before equal backgrounds; camera k + 1's clock is offset by k `t_d_s`."""

    n_cameras: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 2 <= self.n_cameras < 360.0 / self.angle_deg + 1.0:
            raise SimError(
                f"cameras: {self.n_cameras} of them, {self.angle_deg:g} deg from each to the next, "
                f"go once round: use an angle below {360.0 / (self.n_cameras - 1):g} deg"
            )
        if len(self.background_files) > 1:
            raise SimError("background: more than two cameras have one image for all, or none")

    def scene(self, seed: int) -> Scene:
        """Build the scene of two cameras, and place all cameras in it."""
        two, numbers = super().scene(seed), range(self.n_cameras)
        first, *_ = two.rig.cameras
        placed = look_at_rig([self.angle_deg * k for k in numbers], self.distance_m).cameras
        cameras = tuple(
            replace(first, name=one.name, T_C_W=one.T_C_W, time_offset_s=self.t_d_s * k)
            for k, one in enumerate(placed)
        )
        return replace(two, rig=Rig(cameras), backgrounds=two.backgrounds[:1] * self.n_cameras)


@with_options(OPTIONS)
def simulate_command(
    out_dir: Annotated[Path, argument("OUT_DIR", "New folder for the recording.")],
    **options: Any,
) -> None:
    """Simulate event cameras that watch one drone, and write the recording as a folder."""
    given = dict(options)
    width, height = given["resolution"]
    spread, default = given["spread"], SplineConfig()
    sensor = chosen_sensor(given)
    given["background"] = tuple(given["background"] or ())
    if given["distortion_model"] == "none":
        if any(given["distortion"]):
            raise SimError("--distortion: needs --distortion-model radtan or equidistant")
        given["distortion"] = ()
    config, disturb = chosen(
        given,
        # The box of random positions, and the circle that keeps the drone clear of the cameras.
        spline=SplineConfig(
            multiplier_xyz_m=tuple(spread * one for one in default.multiplier_xyz_m),
            max_radius_m=spread * default.max_radius_m,
        ),
        **_drone(given["drone"]),
        principal_point=(width / 2, height / 2),
        render=RenderConfig(lattice=Lattice(*given["lattice"])),
        sensor=sensor.sensor,
        effects=sensor.effects,
    )
    n_cameras = given["cameras"]
    if n_cameras > 2:
        config = ManyCameras(**vars(config), n_cameras=n_cameras)
    check_folder(out_dir, recording_bytes(config) * n_cameras // 2)
    config = drawable(config)
    # From a run that was killed while writing.
    remove_left_over(partial_parent(out_dir), out_dir.resolve().name)
    recorded = record_with_progress(config, given["seed"], out_dir, given["text"], disturb)
    typer.echo(summary(recorded, out_dir))


def drawable(config: SimConfig) -> SimConfig:
    """Return the configuration, without the check against OpenGL if pyrender is not installed."""
    if find_spec("pyrender") is not None:
        return config
    return replace(config, render=replace(config.render, check=False))


def record_with_progress(
    config: SimConfig,
    seed: int,
    out_dir: Path,
    text: bool = False,
    disturb: DisturbConfig | None = None,
) -> Recorded:
    """Simulate a recording into a folder, with progress on stderr."""
    provenance = {"config": plain(config), "seed": seed, "versions": versions()}
    with (
        compilation_told(),
        progress(100, "simulating", is_brief=True) as advance,  # no bar before bad input is found
    ):

        def show(share: float) -> None:
            advance(round(100 * share))

        how = seed, out_dir, provenance, text, show, _write_path
        if disturb in (None, DisturbConfig()):
            return record(config, *how)
        return record_disturbed(config, disturb, *how)


def _write_path(folder: Path, flight: Flight) -> None:
    truth = flight.truth
    attitudes = Rotation.from_matrix(truth.T_W_B[:, :3, :3]).as_quat()
    path = SpacePath(truth.times_s, truth.T_W_B[:, :3, 3], quaternions=attitudes)
    write_path(folder / "truth.tum", path)


def summary(recorded: Recorded, out_dir: Path) -> str:
    """Describe in a few lines what was recorded, the renderer and its check, and the folder."""
    flight, gl, check = recorded.flight, recorded.flight.gl, recorded.flight.check
    lines = [
        f"{camera.name}: {n_events} events, {n_frames} frames"
        for camera, n_events, n_frames in zip(
            flight.rig.cameras, recorded.n_events, recorded.n_frames, strict=True
        )
    ]
    native, rendered = "the native renderer", f"{flight.n_instants} instants rendered with"
    by_gl = f"{gl.backend} ({gl.renderer})" if gl else native
    lines.append(f"{rendered} {native if check.n_instants else by_gl}")
    if check.n_instants:
        lines.append(
            f"{check.n_instants} of them with {by_gl} too:\n    luminance differs by "
            f"{check.mean_difference:.0e} in the mean, {check.max_difference:.0e} at most"
        )
    elif find_spec("pyrender") is None:
        lines.append("none of them compared with OpenGL, as pyrender is not installed")
    return "\n".join([*lines, f"written to {out_dir}"])


def _drone(name: str) -> dict[str, Any]:
    """Return fields of SimConfig for a built-in drone or a mesh file; SimError if it is neither."""
    if name in DRONES:
        return {"drone": name}
    if not Path(name).exists():
        raise SimError(
            f"--drone: {name} does not exist: expected a mesh file, or one of {', '.join(DRONES)}"
        )
    check_mesh(Path(name))
    return {"drone_file": Path(name)}
