"""The paper's outdoor experiment, simulated: one flight, seven ways to know part of its truth.

Two DAVIS346 with 8 mm lenses stand 20 m apart, and a third 20 m further on; a drone of 0.5 m flies
some 15 to 60 m away, and RTK measures its path. The third camera is the second of another recording
of the same flight. Clouds drift behind; their events are added to those that each camera recorded
before an even sky.

The kinds of two cameras differ in what is taken from the truth, which shows what it costs not to
know it. In the last two nothing is known, and all is adjusted jointly, without or with camera 3.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
import yaml
from scipy.spatial.transform import Rotation

from experiments.drawing.style import Figure
from experiments.lab.cache import Cache
from experiments.lab.cell import Flight, Measure, PlainCell, RunRow
from experiments.lab.command import command_of
from experiments.lab.recorded import FlightTruth, load_truth
from experiments.lab.results import Results
from experiments.lab.score import angle_between_deg, rotation_angle_deg
from experiments.lab.study import Made, Runs, Study
from experiments.lab.summary import by_group, held, made_of, shown_table
from experiments.lab.verify import no_row
from sim.disturb import View, clouds, merged
from sim.recording import SimConfig, two_view_rig_of
from sim.scene.rig import kalibr_yaml
from sim.scene.trajectory import SplineConfig
from sim.seeds import generator
from sim.sensor.events import PRESETS
from sim.sensor.frames import FrameConfig
from ssac.arrays import Array
from ssac.cli.options import number
from ssac.clock import Clock
from ssac.config import Config
from ssac.estimate import Estimate, Status
from ssac.events import EventFile
from ssac.files.event_files import load_events, write_synced
from ssac.files.track_files import save_track
from ssac.geometry.pose import depths
from ssac.network.align import smoothed
from ssac.network.comparison import Comparison, compare
from ssac.network.solve import CameraAnswer, NetworkAnswer
from ssac.network.tum import Path as SpacePath
from ssac.pipeline.answer import Answer
from ssac.pipeline.api import sync
from ssac.pipeline.chain import Chain
from ssac.pipeline.many import network
from ssac.points import PointTrack
from ssac.track.faint import faint_object_events

DURATION_S = 120.0
T_D_S = 3.217
SKEW_PPM = 30.0
THIRD_T_D_S, THIRD_SKEW_PPM = -7.3, -20.0
BASELINE_M = 20.0
DISTANCE_M = 35.0
FOCAL_PX = 432.0  # 8 mm over pixels of 18.5 um
CLOUDS_PX_S = 6.0  # 8 m/s at a height of 600 m

FOCAL_STD, CENTRE_STD_PX = 0.001, 0.3
"""Deviations of a good calibration's errors, which estimators assume where a rig states none."""

LEVER_ARM_M = (0.05, 0.0, 0.12)  # RTK's antenna in the body: forward, left, up
_RTK_HZ = 5.0
_RTK_STD_M = (0.01, 0.01, 0.02)
_RTK_CLOCK = Clock(18.4, 5.0)  # beside camera 1's
CALM = SplineConfig(sampling_hz=1.0, segments_per_s=1.0, smoothing=2.0)
"""Smoothing in s^3: turns within some seconds; the box makes the speed, 5 m/s or so."""

FIRST_SEED = 78_000  # nothing was chosen on these; those from 71,000 to 77,009 were looked at
_STREAM = 97  # of what is drawn beside the recording
_BETWEEN_S = 0.00031  # after the truth's samples: times of whole milliseconds look rounded
_OF_TRUTH = 4  # a true track has one in so many of the truth's samples, at 200 Hz

N_FLIGHTS = 10
TWO_AT_ONCE, THREE_CAMERAS = "two_at_once", "three_cameras"
KINDS = ("as_recorded", "true_tracks", "true_pose", "true_intrinsics", "all_true", TWO_AT_ONCE,
         THREE_CAMERAS)  # fmt: skip

CONFIG = Config(
    denoise=False, n_min=8, half_window_s=0.05, n_samples=1200, skew_prior_ppm=50.0, search="all"
)  # of a small drone, and event cameras' clocks
_PATH_HZ = 50.0
_MOST_MISSED = 9.0  # times the median: 6 deviations

Flights = Annotated[int, number("Number of flights.", 1, 1000, metavar="COUNT")]
Duration = Annotated[float, number("Duration of each flight.", 10, 3600, "seconds")]
Third = Annotated[
    bool, typer.Option("--third/--no-third", help="Solve each flight with a third camera too.")
]


@dataclass(frozen=True)
class OutdoorCell(PlainCell):
    """One kind of estimate of a flight."""

    flight: int
    kind: str  # of KINDS
    duration_s: float = DURATION_S

    @property
    def config(self) -> SimConfig:
        """The set-up of the first two cameras."""
        return outdoor_config(self.duration_s)

    @property
    def recordings(self) -> tuple[Flight, ...]:
        """The recording of cameras 1 and 2, and of cameras 1 and 3 if there is a third."""
        configs = [self.config]
        if self.kind == THREE_CAMERAS:  # camera 2 is as far from camera 1 as from camera 3
            clock: dict[str, Any] = {"t_d_s": THIRD_T_D_S, "skew_ppm": THIRD_SKEW_PPM}
            configs.append(replace(self.config, angle_deg=2.0 * self.config.angle_deg, **clock))
        return tuple((config, FIRST_SEED + self.flight) for config in configs)

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that say which run it is."""
        return {"flight": self.flight, "kind": self.kind}


@dataclass(frozen=True)
class PlacedRow(RunRow):
    """Errors and stated deviations of a camera's clock and pose."""

    t_d_error_ms: float = np.nan
    t_d_std_ms: float = np.nan
    skew_error_ppm: float = np.nan
    skew_std_ppm: float = np.nan
    r_error_deg: float = np.nan
    r_std_deg: float = np.nan
    t_error_deg: float = np.nan


@dataclass(frozen=True)
class OutdoorRow(PlacedRow):
    """Errors and deviations of camera 2, and errors of the path by RTK."""

    t_std_deg: float = np.nan
    rmse_m: float = np.nan  # at equal times
    median_m: float = np.nan
    max_m: float = np.nan
    icp_rmse_m: float = np.nan
    scale_error_percent: float = np.nan
    rtk_samples: float = np.nan
    coverage: float = np.nan  # share of RTK's samples that the path has


MEASURED = [one.name for one in fields(OutdoorRow)[2:]]


def cells(
    flights: Flights = N_FLIGHTS, duration: Duration = DURATION_S, third: Third = True
) -> list[OutdoorCell]:
    """List every kind of every flight."""
    kinds = KINDS if third else KINDS[:-1]
    return [OutdoorCell(flight, kind, duration) for flight in range(flights) for kind in kinds]


def load_outdoor(cells: Sequence[OutdoorCell], cache: Cache) -> tuple[Path, ...]:
    """Load recordings, which are simulated if they are not there yet."""
    return tuple(cache.recording_folder(*recording) for recording in cells[0].recordings)


def outdoor_row(cell: OutdoorCell, folders: tuple[Path, ...]) -> OutdoorRow:
    """Find clocks, pose and path as the cell's kind says, and compare them with the truth."""
    truths, path, t_std_deg = truths_of(folders), None, np.nan
    truth = truths[0]
    found: Estimate | CameraAnswer
    if cell.kind in (TWO_AT_ONCE, THREE_CAMERAS):
        answer = at_once(folders, truths, cell)
        row, found = OutdoorRow(str(answer.status), answer.reason), answer.cameras[1]
        if found.status == Status.OK and found.R is not None and answer.cameras[0].group == 1:
            path = answer.paths[0].path
            t_std_deg = float(np.rad2deg(np.linalg.norm(np.asarray(found.t_std))))
    else:
        found, path = estimated(folders[0], truth, cell)
        row, t_std_deg = OutdoorRow(str(found.status), found.reason), found.t_std_deg
    if path is None:
        return row
    shown_s = float(truth.clock.cam2_from_cam1(found.t_ref_s)) - found.t_ref_s
    placed = placed_errors(found, shown_s, truth.clock.skew_ppm, truth.R, truth.t)
    return replace(row, **placed, t_std_deg=t_std_deg, **_path_errors(path, truth, cell.flight))


def placed_errors(
    found: Estimate | CameraAnswer, t_d_s: float, skew_ppm: float, R: Array, t: Array
) -> dict[str, Any]:
    """Compare a clock and a pose with the truth: columns of `PlacedRow`."""
    assert found.R is not None  # there is no path without
    assert found.t is not None
    return {
        "t_d_error_ms": 1e3 * abs(found.t_d_s - t_d_s),
        "t_d_std_ms": 1e3 * found.t_d_std_s,
        "skew_error_ppm": abs(found.skew_ppm - skew_ppm),
        "skew_std_ppm": found.skew_std_ppm,
        "r_error_deg": rotation_angle_deg(found.R.T @ R),
        "r_std_deg": found.r_std_deg,
        "t_error_deg": angle_between_deg(found.t, t),
    }


def truths_of(folders: tuple[Path, ...]) -> tuple[FlightTruth, ...]:
    """Read the truth of a flight's recordings, with the offsets that clocks are given here."""
    both = zip(folders, (T_D_S, THIRD_T_D_S), strict=False)
    return tuple(load_truth(folder, t_d_s) for folder, t_d_s in both)


def at_once(
    folders: tuple[Path, ...], truths: tuple[FlightTruth, ...], cell: OutdoorCell
) -> NetworkAnswer:
    """Find clocks, poses and path of two or three cameras, as `ssac sync` of their files does."""
    with TemporaryDirectory() as name:
        files = write_events(Path(name), folders, truths, cell.flight)
        rig = Path(name) / "rig.yaml"
        write_rig(rig, calibrated(cell.config, cell.flight)[: len(files)])
        return network(Chain(files, rig, CONFIG)).network


def estimated(
    folder: Path, truth: FlightTruth, cell: OutdoorCell
) -> tuple[Estimate, SpacePath | None]:
    """Find clocks, pose and path [baselines, camera 1's frame] of two cameras."""
    config, flight, kind = cell.config, cell.flight, cell.kind
    is_exact = kind in ("true_intrinsics", "all_true")
    with TemporaryDirectory() as name:
        work = Path(name)
        rig = (config,) * 2 if is_exact else calibrated(config, flight)[:2]
        write_rig(work / "rig.yaml", rig)
        if kind in ("true_tracks", "all_true"):
            cam1, cam2 = write_tracks(work, config, truth)
        else:
            cam1, cam2 = write_events(work, (folder,), (truth,), flight)
        answer = sync(cam1, cam2, work / "rig.yaml", config=CONFIG).answer
    found, is_given = answer.estimate, kind in ("true_pose", "all_true")
    R, t = (truth.R, truth.t) if is_given else (found.R, found.t)
    if not found.has_offset or R is None or t is None:
        return found, None
    return found, triangulated(answer, R, t)


def triangulated(found: Answer, R: Array, t: Array) -> SpacePath | None:
    """Triangulate a smoothed path in camera 1's frame; None of too few points before both cameras.

    Pairs of rays that miss each other, for their depth, by far more than the median are left out.
    """
    estimate, rig = found.estimate, found.rig
    views = found.views.under(estimate.clock)
    start_s, end_s = views.overlap_s(np.array([estimate.t_d_s]))
    n_samples = int(_PATH_HZ * (end_s[0] - start_s[0]))
    pairs = views.pairs_at(estimate.t_d_s, n_samples)
    rays1, rays2 = pairs.rays(rig)
    depths1, depths2 = depths(R, t, rays1, rays2)
    before = (depths1 > 0.0) & (depths2 > 0.0) & np.isfinite(depths1 * depths2)
    if before.sum() < 100:
        return None
    first = depths1[:, None] * rays1
    second = (depths2[:, None] * rays2 - t) @ R
    missed = np.linalg.norm(first - second, axis=1) / np.abs(depths1)
    before &= missed < _MOST_MISSED * np.median(missed[before])
    rough = SpacePath(pairs.times_s[before], (0.5 * (first + second))[before])
    return replace(rough, positions_m=smoothed(rough).at(rough.times_s))


def compared(path: SpacePath, truth: FlightTruth, flight: int) -> Comparison:
    """Compare a path with the flight's RTK, whose lever arm is known."""
    return compare(path, rtk_of(truth, flight), lever_arm_m=LEVER_ARM_M)


def _path_errors(path: SpacePath, truth: FlightTruth, flight: int) -> dict[str, Any]:
    found = compared(path, truth, flight)
    assert found.in_time is not None  # both paths have times
    figures = found.in_time.figures()
    return {
        **{name: figures[name] for name in ("rmse_m", "median_m", "max_m")},
        "icp_rmse_m": found.as_shape.rmse_m,
        "scale_error_percent": 100.0 * abs(figures["scale"] / truth.baseline_m - 1.0),
        "rtk_samples": figures["n_samples"],
        "coverage": found.in_time.coverage,
    }


def means(flights: pd.DataFrame) -> dict[str, Any]:
    """Give means over the flights that were answered, and how many these are."""
    given = flights[flights["rmse_m"].notna()]
    return {"answered": len(given), "of": len(flights), **given[MEASURED].mean()}


def first_flight(_: Results, folder: Path) -> Figure | None:
    """Draw the first flight, all adjusted at once, beside its RTK; None if it was refused."""
    from ssac.pipeline.plots import draw_comparison

    truths, cell = truths_of((folder,)), OutdoorCell(0, TWO_AT_ONCE)
    answer = at_once((folder,), truths, cell)
    if not answer.paths:
        return None
    figure = draw_comparison(compared(answer.paths[0].path, truths[0], cell.flight))
    figure.suptitle("Outdoor experiment, simulated: the path found on the first flight, and RTK")
    return figure


def page_table(results: Results) -> str:
    """Lay out mean errors (the path's largest), and how many intervals of t_d and skew hold."""

    def row(flights: pd.DataFrame) -> dict[str, Any]:
        given = flights[flights["rmse_m"].notna()]
        return {
            **means(flights),
            "most_m": given["rmse_m"].max(),
            "n_t_d": held(given, "t_d", "ms").sum(),
            "n_skew": held(given, "skew", "ppm").sum(),
            "seen": 100 * given["coverage"].mean(),
        }

    table = by_group("kind")(row)(results.table("outdoor"))
    return shown_table(table.assign(kind=table["kind"].str.replace("_", " ")), {
        "known": "{kind}",
        "answered": "{answered} of {of}",
        "t_d [ms]": "{t_d_error_ms:.3f}",
        "skew [ppm]": "{skew_error_ppm:.2f}",
        "R [deg]": "{r_error_deg:.3f}",
        "t [deg]": "{t_error_deg:.3f}",
        "held": "{n_t_d}, {n_skew}",
        "path [m]": "{rmse_m:.3f} ({most_m:.3f})",
        "ICP [m]": "{icp_rmse_m:.3f}",
        "seen [%]": "{seen:.0f}",
    })  # fmt: skip


# --- What is flown, and what an estimator is given of it ---


def outdoor_config(duration_s: float = DURATION_S) -> SimConfig:
    """Give the simulated set-up."""
    box_m = (14.0, 36.0, 10.0)
    return SimConfig(
        angle_deg=float(np.rad2deg(2.0 * np.arcsin(BASELINE_M / (2.0 * DISTANCE_M)))),
        t_d_s=T_D_S,
        skew_ppm=SKEW_PPM,
        spline=replace(CALM, duration_s=duration_s, multiplier_xyz_m=box_m, max_radius_m=24.0),
        drone_size_m=0.5,
        distance_m=DISTANCE_M,
        focal_px=FOCAL_PX,
        sensor=PRESETS["davis346"],
        frames=FrameConfig(rate_hz=0.0),
    )


def rtk_of(truth: FlightTruth, flight: int) -> SpacePath:
    """Simulate RTK: its antenna's path on its own clock, with noise of a centimetre or two."""
    rng = np.random.default_rng([_STREAM, FIRST_SEED + flight, 0])
    first_s, last_s = _RTK_CLOCK.cam2_from_cam1(truth.times_s[[0, -1]])
    even_s: Array = np.arange(first_s, last_s, 1.0 / _RTK_HZ)
    nearest = np.searchsorted(truth.times_s, _RTK_CLOCK.cam1_from_cam2(even_s))
    nearest = np.minimum(nearest, len(truth.times_s) - 1)
    shown_s = _RTK_CLOCK.cam2_from_cam1(truth.times_s[nearest])  # evenly spaced to the truth's 5 ms
    turns = Rotation.from_quat(truth.quaternions[nearest])
    antenna_m = truth.positions_m[nearest] + turns.apply(LEVER_ARM_M)
    noise_m = rng.normal(0.0, _RTK_STD_M, antenna_m.shape)
    return SpacePath(shown_s, antenna_m + noise_m, quaternions=truth.quaternions[nearest])


def calibrated(config: SimConfig, flight: int) -> tuple[SimConfig, ...]:
    """Give the three cameras' intrinsics as a calibration would: with its errors."""
    rng = np.random.default_rng([_STREAM, FIRST_SEED + flight, 1])
    cameras = []
    for _ in range(3):
        focal_px = float(config.focal_px * (1.0 + rng.normal(0.0, FOCAL_STD)))
        u_px, v_px = (config.principal_point + rng.normal(0.0, CENTRE_STD_PX, 2)).tolist()
        cameras.append(replace(config, focal_px=focal_px, principal_point=(u_px, v_px)))
    return tuple(cameras)


def write_rig(path: Path, cameras: Sequence[SimConfig]) -> None:
    """Write the estimator's rig; if the cameras' intrinsics differ, they are a calibration's."""
    exact = all(camera == cameras[0] for camera in cameras)
    chain: dict[str, Any] = {}
    for n, camera in enumerate(cameras):
        text = kalibr_yaml(two_view_rig_of(camera), with_extrinsics=False)
        chain[f"cam{n}"] = yaml.safe_load(text)["cam0"]
        if not exact:
            del chain[f"cam{n}"]["intrinsics_std"]  # a good calibration's are the default
    path.write_text(yaml.safe_dump(chain), encoding="utf-8")


def write_events(
    work: Path, folders: tuple[Path, ...], truths: tuple[FlightTruth, ...], flight: int
) -> list[Path]:
    """Write the events of the drone before clouds in all cameras, on their own clocks.

    The first camera is the same in all recordings; each recording's second is one more.
    """
    files = [work / f"cam{k + 1}.h5" for k in range(len(folders) + 1)]
    for k, file in enumerate(files):
        folder, truth = folders[max(k - 1, 0)], truths[max(k - 1, 0)]
        clock = truth.clock  # the recording has its skew, but not its offset
        source, ppm, shown = "cam1.h5", 0.0, Clock()
        if k:
            source, ppm, shown = "cam2.h5", clock.skew_ppm, Clock(-clock.t_d_s)
        duration_s = float(truth.times_s[-1])
        found = drone_events(folder / source, flight, k, ppm, clock.t_ref_s, duration_s)
        write_synced(file, found, shown)
    return files


@lru_cache(maxsize=4)  # of one flight, whose kinds are estimated one after the other
def drone_events(
    file: Path, flight: int, camera: int, skew_ppm: float, t_ref_s: float, duration_s: float
) -> EventFile:
    """Extract the drone's events from those of drone and clouds in a camera, from 0 on."""
    recorded = load_events(file)
    width, height = recorded.width, recorded.height
    assert width is not None  # our own files have both
    assert height is not None
    drawn_by = generator(FIRST_SEED + flight, _STREAM, 2, camera)
    sky = clouds(View(width, height, duration_s), CLOUDS_PX_S, drawn_by)
    runs = Clock(0.0, skew_ppm, t_ref_s)
    sky["t"] = np.rint(1e6 * runs.cam2_from_cam1(1e-6 * sky["t"]))
    events = merged(recorded.events, sky)
    return EventFile(faint_object_events(events, width, height), width, height)


def write_tracks(work: Path, config: SimConfig, truth: FlightTruth) -> list[Path]:
    """Write the images of the drone's origin as both cameras' tracks."""
    files = [work / "cam1.csv", work / "cam2.csv"]
    for file, clock, px in zip(files, (Clock(), truth.clock), truth.centres_px, strict=True):
        save_track(file, true_track(truth.times_s, px, clock, config.resolution, _OF_TRUTH))
    return files


def true_track(
    times_s: Array, centres_px: Array, clock: Clock, resolution: tuple[int, int], every: int
) -> PointTrack:
    """Give the images (n, 2) of the drone's origin at times (n,) as a camera's track.

    The truth's times are camera 1's; `clock` is the camera's own. What is outside its image is left
    out, and all but one in `every` samples.
    """
    centres_px = centres_px + _BETWEEN_S * np.gradient(centres_px, times_s, axis=0)
    inside = np.all((centres_px >= 0.0) & (centres_px <= np.array(resolution) - 1.0), axis=1)
    kept = np.flatnonzero(inside)[::every]
    return PointTrack(clock.cam2_from_cam1(times_s[kept] + _BETWEEN_S), centres_px[kept])


STUDIES = (
    Study(
        "outdoor",
        "The paper's outdoor experiment, simulated",
        cells,
        Measure(load_outdoor, outdoor_row, OutdoorRow),
        Runs("outdoor.csv", ("flight", "kind"), numbered=False,
             columns=("flight", "kind", "status", *MEASURED, "reason")),
        (made_of("outdoor_oracle.csv", by_group("kind")(means), "outdoor"),
         Made("outdoor.png", first_flight, recordings=lambda duration=DURATION_S, **_:
              OutdoorCell(0, TWO_AT_ONCE, duration).recordings)),
        numbers={"table.outdoor": page_table},
        checks=(("a median is no maximum", no_row("outdoor", "median_m > max_m")),
                ("shares are shares", no_row("outdoor", "coverage < 0 or coverage > 1"))),
        config={"flights": N_FLIGHTS, "first_seed": FIRST_SEED, "kinds": KINDS,
                "sim": outdoor_config(), "clouds_px_s": CLOUDS_PX_S},
        command="ssac outdoor",
        shows="outdoor_oracle",
    ),
)  # fmt: skip

command = command_of(
    {"outdoor": STUDIES},
    "Simulate the paper's outdoor set-up, and find clocks, pose and the drone's path.\n\n"
    "What is finished is kept in the cache, so that an interrupted run goes on where it was.",
)
