"""Clocks and poses of all cameras of a rig, and the path that they saw, from all its pairs."""

import json
from itertools import combinations
from pathlib import Path

import numpy as np

from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.files.whole_file import whole_file
from ssac.methods.method import Method
from ssac.network.graph import Link, Pair
from ssac.network.ground import Ground, ground_of_positions, ground_of_rtk, in_frame
from ssac.network.solve import NetworkAnswer, link_of, solve_network
from ssac.network.state import Sightings, sightings
from ssac.network.tum import write_path
from ssac.pipeline.answer import Answer, Log, Stopwatch
from ssac.pipeline.chain import Chain, one_thread
from ssac.pipeline.many_report import NetworkResult
from ssac.pipeline.object_track import ShapedTrack, shaped_track_of_events, track_of_events
from ssac.pipeline.opened import NOTHING, Known
from ssac.points import PointTrack
from ssac.rules import GroundRules
from ssac.track.body import LEAST_VIEWS


def network(chain: Chain, method: Method | None = None, known: Known = NOTHING) -> NetworkResult:
    """Synchronise and calibrate many cameras, and find the path that they saw.

    `method` is for each pair; None for the best one that it allows. SsacError if a recording cannot
    be used, or contradicts what is known.
    """
    watch, pairs = Stopwatch(chain.watch.log), dict[Pair, Answer]()
    for a, b in combinations(range(len(chain)), 2):
        with watch.part(f"{a + 1}-{b + 1}") as say:
            pairs[a, b] = chain.answer(method, a, b)
            one = pairs[a, b].estimate
            offset = f", t_d {one.t_d_s:.4f} s, 1 sigma {1e3 * one.t_d_std_s:.2f} ms"
            say(f"{one.status}{offset if one.has_offset else ''}")
    with watch.part("network") as say, one_thread():
        answer = solve_pairs(chain, pairs, known.distance_m)
        answer, ground = grounded(answer, known, chain.config.rules.ground)
        say(", ".join(f"{camera.name} {camera.status}" for camera in answer.cameras))
    in_metres = ground is not None or known.distance_m is not None
    names = tuple(chain.name(k) for k in range(len(chain)))
    return NetworkResult(names, chain.rig.name, answer, pairs, in_metres, ground, watch.seconds)


def solve_pairs(
    chain: Chain, pairs: dict[Pair, Answer], distance_m: float | None = None
) -> NetworkAnswer:
    """Solve two cameras or more, `distance_m` between the first two; None: the unit of lengths."""
    seen = []
    for k in range(len(chain)):
        with chain.watch.part("follow") as say:
            seen.append(_sightings(chain, k, pairs))
            say(f"{chain.name(k)}: {len(seen[-1])} positions")
    links = dict[Pair, Link]()
    for pair, answer in pairs.items():
        of_events = not any(seen[k].has_frames for k in pair)
        link = link_of(answer.estimate, answer.guess, of_events)
        if link is not None:
            links[pair] = link
    has_frames = any(camera.has_frames for camera in seen)
    prior_ppm = chain.config.resolved(has_frames).prior_ppm
    return solve_network(seen, links, prior_ppm, distance_m or 1.0, chain.config.rules)


def grounded(
    answer: NetworkAnswer, known: Known, rules: GroundRules
) -> tuple[NetworkAnswer, Ground | None]:
    """Put an answer into the frame that is known, where one is and there is a network at all."""
    if not answer.built:
        return answer, None
    if known.positions is not None:
        ground = ground_of_positions(answer, known.positions, rules)
    elif known.rtk is not None:
        ground = ground_of_rtk(answer, known.rtk, rules, known.lever_arm_m)
    else:
        return answer, None
    return in_frame(answer, ground), ground


def write_path_of_two(file: Path, answer: Answer, known: Known, log: Log) -> None:
    """Find the path that two cameras saw and write it; say so, or why there is none."""
    if answer.estimate.status != Status.OK or answer.estimate.R is None:
        log(f"not written: {file}, since there is no reliable pose")
        return
    distance_m, T_2_1 = known.distance_m, answer.rig.T_2_1
    if distance_m is None and answer.method.needs_extrinsics and T_2_1 is not None:
        distance_m = float(np.linalg.norm(T_2_1[:3, 3]))
    chain = Chain(answer.cleans, answer.rig, answer.config)
    found = solve_pairs(chain, {(0, 1): answer}, distance_m)
    write_paths(file, grounded(found, known, answer.config.rules.ground)[0], log)


def write_many(
    result: NetworkResult, json_file: Path | None, trajectory: Path | None, log: Log
) -> None:
    """Write what was asked for, and say so."""
    if json_file is not None:
        with whole_file(json_file) as temporary:
            text = json.dumps(result.to_dict(), indent=1, allow_nan=False)
            temporary.write_text(text + "\n", encoding="utf-8")
        log(f"wrote {json_file}")
    if trajectory is not None:
        write_paths(trajectory, result.network, log)


def write_paths(file: Path, answer: NetworkAnswer, log: Log) -> None:
    """Write the path of the first group, and say so; that of another group beside it."""
    for k, found in enumerate(answer.paths):
        other = file if k == 0 else file.with_name(f"{file.stem}-{k + 1}{file.suffix}")
        write_path(other, found.path)
        spans = ", ".join(f"{start_s:.3f} to {end_s:.3f} s" for start_s, end_s in found.spans_s)
        log(f"wrote {other}: {len(found.path)} samples, which hold from {spans}")
    if not answer.paths:
        log(f"not written: {file}, since no cameras see the object's path together")


def _sightings(chain: Chain, k: int, pairs: dict[Pair, Answer]) -> Sightings:
    """Say where a camera saw the object; nowhere, of one whose events show none."""
    clean = next(answer.cleans[pair.index(k)] for pair, answer in pairs.items() if k in pair)
    name, rules = Path(chain.name(k)).stem, chain.config.rules.points
    if clean.track is not None:
        return sightings(clean.track, clean.camera, name, clean.has_track, rules)
    try:
        if len(chain) < LEAST_VIEWS:  # to tell what perspective does to silhouettes
            shaped = ShapedTrack(track_of_events(clean, chain.config), None)
        else:
            events = chain.recorded(k).events
            shaped = shaped_track_of_events(clean, events, chain.config)
    except SsacError:  # its pairs say why
        shaped = ShapedTrack(PointTrack(np.empty(0), np.empty((0, 2))), None)
    shapes = shaped.spreads_px2, shaped.images
    return sightings(shaped.track, clean.camera, name, clean.has_track, rules, *shapes)
