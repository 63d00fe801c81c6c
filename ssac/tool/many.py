"""Files of many cameras and a rig in; every pair synchronised, and all solved at once, out."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from ssac.camera import Camera
from ssac.compare.frame import (
    Ground,
    check_rtk,
    ground_of_positions,
    ground_of_rtk,
    in_frame,
    load_positions,
)
from ssac.config import Config
from ssac.convert.events_as_track import ShapedTrack, shaped_track_of_events, track_of_events
from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.files.damage import STRICT, Reading
from ssac.files.event_files import load_events
from ssac.files.net import check_is_file
from ssac.files.rigs import load_rig
from ssac.files.track_files import is_track_file
from ssac.network.graph import Link, Pair
from ssac.network.sightings import Sightings, sightings
from ssac.network.solve import NetworkAnswer, link_of, solve_network
from ssac.path.tum import write_path
from ssac.silhouette.perspective import LEAST_VIEWS
from ssac.tool.everywhere import SKEW_PRIOR_PPM
from ssac.tool.sync import Clock, Log, SyncResult, sync
from ssac.track.observation import Observation


@dataclass(frozen=True)
class Known:
    """What is known of the scale and the frame: one of these at most."""

    distance_m: float | None = None  # between the first two cameras
    positions: Path | None = None  # of the cameras
    rtk: Path | None = None  # the object's own path, on a clock of its own
    lever_arm_m: tuple[float, float, float] | None = None  # where RTK's antenna is in the body


NOTHING = Known()


@dataclass(frozen=True)
class ManyResult:
    """What is found of many cameras, what it was made from, and how long it took."""

    paths: list[Path]
    rig: Path
    answer: NetworkAnswer
    pairs: dict[Pair, SyncResult]
    scale_is_known: bool  # lengths are metres; no: distances of the first two cameras
    ground: Ground | None  # the frame of cameras and path; None: the first camera's
    seconds: dict[str, float]


def sync_all(
    paths: Sequence[Path],
    rig_path: Path,
    method: str | None = None,
    config: Config | None = None,
    log: Log | None = None,
    known: Known = NOTHING,
    search_all: bool | None = None,
    reading: Reading = STRICT,
) -> ManyResult:
    """Synchronise and calibrate many cameras, and find the path that they saw.

    Parameters
    ----------
    paths
        Event or track files, in the order of the rig's cameras.
    rig_path
        Camchain with the intrinsics of all.
    method, config
        As of `ssac.tool.sync.sync`, for each pair.
    log
        Called with a line of progress after each pair.
    known
        Of scale and frame.
    search_all, reading
        As of `ssac.tool.sync.sync`.

    Raises
    ------
    SsacError
        If a file cannot be used, is given twice, or contradicts what is found.
    """
    _check_files(paths)
    for number in range(2, len(paths) + 1):  # before hours of work
        load_rig(rig_path, (1, number))

    clock, pairs = Clock(log or (lambda line: None)), dict[Pair, SyncResult]()
    for a, b in combinations(range(len(paths)), 2):
        with clock.part(f"{a + 1}-{b + 1}") as say:
            pairs[a, b] = sync(
                paths[a],
                paths[b],
                rig_path,
                method,
                config=config,
                cameras=(a + 1, b + 1),
                search_all=search_all,
                reading=reading,
            )
            say(_told(pairs[a, b]))
    with clock.part("network") as say:
        answer = solve_pairs(paths, pairs, config, known.distance_m)
        answer, ground = grounded(answer, known)
        say(", ".join(f"{camera.name} {camera.status}" for camera in answer.cameras))
    in_metres = ground is not None or known.distance_m is not None
    return ManyResult(list(paths), rig_path, answer, pairs, in_metres, ground, clock.seconds)


def grounded(answer: NetworkAnswer, known: Known) -> tuple[NetworkAnswer, Ground | None]:
    """Put an answer into the frame that is known, where one is and there is a network at all."""
    if not answer.built:
        return answer, None
    if known.positions is not None:
        ground = ground_of_positions(answer, known.positions)
    elif known.rtk is not None:
        ground = ground_of_rtk(answer, known.rtk, known.lever_arm_m)
    else:
        return answer, None
    return in_frame(answer, ground), ground


def known_of(
    distance_m: float | None,
    positions: Path | None,
    rtk: Path | None,
    lever_arm_m: tuple[float, float, float] | None = None,
) -> Known:
    """Sum up options on the scale and the frame, before the work of hours begins.

    Raises
    ------
    SsacError
        Where they do not go together, or a file cannot be used.
    """
    given = {"--distance": distance_m, "--positions": positions, "--rtk": rtk}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise SsacError(
            f"{names[0]}: not with {names[1]}, as each sets the scale: give the better one alone"
        )
    if lever_arm_m is not None and rtk is None:
        raise SsacError("--lever-arm: is of RTK's antenna: give --rtk too, or leave it out")
    if positions is not None:
        load_positions(positions)
    if rtk is not None:
        check_rtk(rtk, lever_arm_m)
    return Known(distance_m, positions, rtk, lever_arm_m)


def check_for_two(given: list[str]) -> None:
    """Refuse options that are of two cameras."""
    if given:
        raise SsacError(
            f"{given[0]}: is for two cameras, and more were given: leave it out, or give two"
        )


def check_known_of_two(known: Known, has_trajectory: bool) -> None:
    """Refuse what two cameras cannot use: of these, the path alone has a scale and a frame."""
    if known.positions is not None:
        raise SsacError(
            "--positions: needs three cameras or more, and two were given: give --distance"
        )
    name = "--distance" if known.distance_m is not None else "--rtk"
    if known != NOTHING and not has_trajectory:
        raise SsacError(f"{name}: is for the object's path: give --trajectory too, or leave it out")


def solve_pairs(
    paths: Sequence[Path],
    pairs: dict[Pair, SyncResult],
    config: Config | None = None,
    distance_m: float | None = None,
) -> NetworkAnswer:
    """Solve all cameras at once, from what every pair gave; as `sync_all`."""
    seen = [_sightings(k, paths[k], pairs) for k in range(len(paths))]
    links = dict[Pair, Link]()
    for pair, result in pairs.items():
        of_events = not any(seen[k].has_frames for k in pair)
        link = link_of(result.estimate, result.guess, of_events)
        if link is not None:
            links[pair] = link
    has_frames = any(camera.has_frames for camera in seen)
    prior_ppm = SKEW_PRIOR_PPM if has_frames else Config.skew_prior_ppm
    if config is not None:
        prior_ppm = config.skew_prior_ppm
    return solve_network(seen, links, prior_ppm, distance_m or 1.0)


def write_path_of_two(file: Path, result: SyncResult, known: Known, log: Log) -> None:
    """Find the path that two cameras saw and write it; say so, or why there is none."""
    if result.estimate.status != Status.OK or result.estimate.R is None:
        log(f"not written: {file}, since there is no reliable pose")
        return
    distance_m, T_2_1 = known.distance_m, result.rig.T_2_1
    if distance_m is None and result.method.needs_extrinsics and T_2_1 is not None:
        distance_m = float(np.linalg.norm(T_2_1[:3, 3]))
    answer = solve_pairs(result.paths[:2], {(0, 1): result}, result.config, distance_m)
    write_paths(file, grounded(answer, known)[0], log)


def write_paths(file: Path, answer: NetworkAnswer, log: Log) -> None:
    """Write the path of the first group, and say so; that of another group beside it."""
    for k, found in enumerate(answer.paths):
        other = file if k == 0 else file.with_name(f"{file.stem}-{k + 1}{file.suffix}")
        write_path(other, found.path)
        spans = ", ".join(f"{start_s:.3f} to {end_s:.3f} s" for start_s, end_s in found.spans_s)
        log(f"wrote {other}: {len(found.path)} samples, which hold from {spans}")
    if not answer.paths:
        log(f"not written: {file}, since no cameras see the object's path together")


def _sightings(k: int, path: Path, pairs: dict[Pair, SyncResult]) -> Sightings:
    """Take what a camera saw from any of its pairs."""
    (a, _), result = next((pair, result) for pair, result in pairs.items() if k in pair)
    observation, camera = (
        (result.cam1, result.rig.cam1) if k == a else (result.cam2, result.rig.cam2)
    )
    shaped = None
    track = observation.track
    if track is None:
        shaped = _followed(observation, camera, path, result, len(pairs) >= LEAST_VIEWS)
        track = shaped.track
    told = (shaped.spreads_px2, shaped.images) if shaped is not None else (None, None)
    return sightings(track, camera, path.stem, is_track_file(path), *told)


def _followed(
    observation: Observation, camera: Camera, path: Path, result: SyncResult, are_many: bool
) -> ShapedTrack:
    """Follow the object through events; an error names the file.

    What perspective does to silhouettes takes three cameras to tell.
    """
    try:
        if not are_many:
            return ShapedTrack(track_of_events(observation, camera, result.config), None)
        recorded = load_events(path, result.reading).events
        return shaped_track_of_events(observation, recorded, camera, result.config)
    except SsacError as error:
        raise SsacError(f"{path}: {error}") from error


def _check_files(paths: Sequence[Path]) -> None:
    for path in paths:
        check_is_file(path)
    for a, b in combinations(range(len(paths)), 2):
        if paths[a].samefile(paths[b]):
            raise SsacError(
                f"{paths[a]}: given for cameras {a + 1} and {b + 1}: give each camera's own file"
            )


def _told(result: SyncResult) -> str:
    estimate = result.estimate
    if not estimate.has_offset:
        return str(estimate.status)
    sigma_ms = 1e3 * estimate.t_d_std_s
    return f"{estimate.status}, t_d {estimate.t_d_s:.4f} s, 1 sigma {sigma_ms:.2f} ms"
