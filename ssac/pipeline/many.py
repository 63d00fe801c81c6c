"""Clocks and poses of all cameras of a rig, and the object's path, from all its pairs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ssac.arrays import Array
from ssac.camera import Camera
from ssac.errors import SsacError
from ssac.estimate import Estimate, Status
from ssac.files.rigs import Step, save_rig
from ssac.files.whole_file import FIGURE_SUFFIXES, numbered_file, write_whole
from ssac.methods.method import Method
from ssac.methods.verdict import quantum_s
from ssac.network.graph import Link, Pair
from ssac.network.ground import Ground, PlacesError, ground_of_positions, ground_of_rtk, in_frame
from ssac.network.solve import CameraAnswer, NetworkAnswer, link_of, rounded_by, solve_network
from ssac.network.state import Sightings, sightings
from ssac.network.tum import write_path
from ssac.pipeline.answer import CONTRADICTS, NO_READOUT, Answer, Log, Stopwatch
from ssac.pipeline.chain import Chain, one_thread
from ssac.pipeline.opened import NOTHING, Known
from ssac.pipeline.report import Rows, html_of, numbered, plain, text_of, vector
from ssac.points import PointTrack
from ssac.rules import Rules
from ssac.search.object_track import ShapedTrack, shaped_track_of_events, track_of_events
from ssac.track.moments import LEAST_VIEWS


@dataclass(frozen=True, eq=False, repr=False)
class NetworkResult:
    """The result for many cameras, what it was made from, and how long it took."""

    names: tuple[str, ...]  # of the recordings, in the order of the rig's cameras
    rig_name: str  # for messages: a file's path
    network: NetworkAnswer  # clocks and poses of all cameras, and the object's path
    pairs: dict[Pair, Answer]  # answers for two cameras each, by their numbers from 0 on
    scale_is_known: bool  # of the first group; unknown: in distances of the first two placed
    ground: Ground | None  # the frame of cameras and path; None: the first camera's
    seconds: dict[str, float]  # by part, in the order they ran
    note: str = ""  # which argument of the call could not be used

    @property
    def status(self) -> Status:
        """Whether all cameras are in one network: "ok" if so."""
        return self.network.status

    @property
    def reason(self) -> str:
        """Why not all cameras are in one network; empty where they are."""
        return self.network.reason

    @property
    def cameras(self) -> list[Any]:
        """Clock and pose of each camera (`ssac.network.solve.CameraAnswer`)."""
        return list(self.network.cameras)

    @property
    def are_in_metres(self) -> list[bool]:
        """Whether each group's lengths are in metres, in the order of the networks."""
        return [self.scale_is_known and k == 0 for k in range(len(self.network.built))]

    def summary(self) -> str:
        """Return the result as text for people, as `ssac sync` prints it."""
        return text_of(self.rows())

    def rows(self) -> Rows:
        """Return the result as rows for people, whose long values are not yet folded."""
        answer, rows = self.network, list[tuple[str, str]]()
        if answer.reason:
            rows.append(("incomplete", answer.reason))
        if self.note:
            rows.append(("note", self.note))
        if self.ground is not None:
            rows.append(("frame", self.ground.said))
        for camera in answer.cameras:
            in_metres = camera.group > 0 and self.are_in_metres[camera.group - 1]
            rows += _camera_rows(camera, " m" if in_metres else "")
            if camera.calibration is not None:
                focals = ", ".join(f"{one:.2f}" for one in np.diag(camera.calibration.K)[:2])
                sigma = ", ".join(f"{one:.2g}" for one in camera.calibration.intrinsics_std_px[:2])
                rows.append(("", f"not as in the rig: focal lengths {focals} px, 1 sigma {sigma}"))
        finds = [camera.readout_std_s > 0.0 for camera in answer.cameras]
        as_stated = [camera.group and camera.calibration is None for camera in answer.cameras]
        notes = dict[str, list[str]]()  # by note, the pairs to which it applies
        for (a, b), pair in self.pairs.items():
            for note in pair.notes:
                if note.startswith(NO_READOUT) and finds[a] and finds[b]:
                    continue  # the network tells them
                if note.startswith(CONTRADICTS) and as_stated[a] and as_stated[b]:
                    continue  # all cameras together do not
                notes.setdefault(numbered(note, (a, b)), []).append(f"{a + 1}-{b + 1}")
        rows += [("note", f"{note} (cameras {', '.join(of)})") for note, of in notes.items()]
        for (a, b), off_s in answer.wrong_pairs.items():
            rows.append(("wrong pair", f"{a + 1} and {b + 1}: its clock is {off_s:+.3f} s off"))
        units = map(_unit, self.are_in_metres)
        for k, (found, unit) in enumerate(zip(answer.paths, units, strict=True), start=1):
            stds = found.path.deviations_m
            medians = np.full(3, np.nan) if stds is None or not len(stds) else np.median(stds, 0)
            sigma = ", ".join(f"{value:.2g}" for value in medians)
            rows.append((f"path {k}", f"{len(found.path)} samples, 1 sigma ({sigma}), in {unit}"))
            for start_s, end_s in found.spans_s:
                rows.append(("", f"holds from {start_s:.3f} to {end_s:.3f} s"))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Return the result as `ssac sync --json` writes it, None for what is missing."""
        answer = self.network
        return {
            "status": str(answer.status),
            "reason": answer.reason,
            "note": self.note,
            "cameras": [
                _camera(camera, name)
                for camera, name in zip(answer.cameras, self.names, strict=True)
            ],
            "pairs": [
                {
                    "cameras": [a + 1, b + 1],
                    "status": str(pair.estimate.status),
                    "reason": numbered(pair.estimate.reason, (a, b)),
                    "note": numbered(pair.note, (a, b)),
                    "t_d_s": plain(pair.estimate.t_d_s),
                    "t_d_std_s": plain(pair.estimate.t_d_std_s),
                    "contradicted_by_s": answer.wrong_pairs.get((a, b)),
                }
                for (a, b), pair in self.pairs.items()
            ],
            "closures": [
                {"cameras": [k + 1 for k in triple], "closure_s": off_s}
                for triple, off_s in answer.closures_s.items()
            ],
            "groups": [
                {
                    "cameras": [k + 1 for k in built.members],
                    "n_path": len(found.path),
                    "path_spans_s": plain(found.spans_s),
                    "scale_is_known": in_metres,
                }
                for built, found, in_metres in zip(
                    answer.built, answer.paths, self.are_in_metres, strict=True
                )
            ],
            "scale_is_known": self.scale_is_known,
            "frame": "of each group's first camera" if self.ground is None else self.ground.said,
            "conventions": "of each group's first camera, 1: t_camK = t_cam1 + t_d + skew (t_cam1 "
            "- t_ref), and what it strays at knots, linear in between; x_K = R X + t, X in the "
            "frame, |t| of the second camera is 1, or metres where the scale is known",
            "rig": self.rig_name,
            "seconds": {part: round(value, 3) for part, value in self.seconds.items()},
        }

    def plot(self, path: Path | str) -> list[Path]:
        """Do what `plotted` does."""
        return self.plotted(Path(path))

    def plotted(self, path: Path) -> list[Path]:
        """Draw each pair as `Result.plot` does, into `path/I-J` or `PATH-I-J.png`; give the files.

        I and J are the numbers of both cameras, from 1 on.
        """
        from ssac.pipeline.plots import save_figures

        drawn = list[Path]()
        for (a, b), answer in self.pairs.items():
            pair, is_file = f"{a + 1}-{b + 1}", path.suffix.lower() in FIGURE_SUFFIXES
            drawn += save_figures(numbered_file(path, pair) if is_file else path / pair, answer)
        return drawn

    def report(self, path: Path | str, command: str = "") -> Path:
        """Write a page as `Result.report` does, on all pairs and their network; give its path."""
        from ssac.pipeline.html_report import report_page

        units = [_unit(in_metres) for in_metres in self.are_in_metres or [False]]
        page = report_page(self.pairs, self.network, self.rows(), command, units, self.seconds)
        write_whole(Path(path), page)
        return Path(path)

    def __repr__(self) -> str:
        placed = sum(camera.status == Status.OK for camera in self.network.cameras)
        return f"<ssac.NetworkResult {self.status}, {placed} of {len(self.names)} cameras placed>"

    def _repr_html_(self) -> str:
        return html_of(self.rows())


def network(chain: Chain, method: Method | None = None, known: Known = NOTHING) -> NetworkResult:
    """Synchronise and calibrate many cameras, and find the path of the object.

    `method` is used for each pair; None takes the best one that the pair allows. SsacError if a
    recording cannot be used, or contradicts what is known.
    """
    watch, pairs = Stopwatch(chain.watch.log), dict[Pair, Answer]()
    for a, b in combinations(range(len(chain)), 2):
        with watch.part(f"{a + 1}-{b + 1}") as say:
            pairs[a, b] = chain.answer(method, a, b)
            one = pairs[a, b].estimate
            said = [str(one.status)]
            if one.has_offset:
                said.append(f"t_d {one.t_d_s:.4f} s")
            if one.has_offset and np.isfinite(one.t_d_std_s):
                said.append(f"1 sigma {1e3 * one.t_d_std_s:.2f} ms")
            say(", ".join(said))
    distance_m, note = known.distance_m, ""
    with watch.part("network") as say, one_thread():
        answer = solve_pairs(chain, pairs, distance_m)
        if distance_m is not None and [one.members[:2] for one in answer.built] != [[0, 1]]:
            distance_m, answer = None, solve_pairs(chain, pairs)
            note = "--distance is not used: cameras 1 and 2 are not both in the only network"
        quanta_s = [quantum_s(chain.clean(k)) for k in range(len(chain))]
        answer = rounded_by(answer, quanta_s)
        ground = None
        try:
            answer, ground = grounded(answer, known, chain.config.rules)
        except PlacesError as error:
            note = f"--positions is not used: {error}"
        say(", ".join(f"{camera.name} {camera.status}" for camera in answer.cameras))
    in_metres = ground is not None or distance_m is not None
    names = tuple(chain.name(k) for k in range(len(chain)))
    return NetworkResult(
        names, chain.rig.name, answer, pairs, in_metres, ground, watch.seconds, note
    )


def solve_pairs(
    chain: Chain, pairs: dict[Pair, Answer], distance_m: float | None = None
) -> NetworkAnswer:
    """Solve a chain's network; `distance_m` is between the first two; None: the unit of length."""
    seen = []
    for k, name in enumerate(short_names([chain.name(k) for k in range(len(chain))])):
        with chain.watch.part("follow") as say:
            seen.append(_sightings(chain, k, name, pairs))
            say(f"{chain.name(k)}: {len(seen[-1])} positions")
    links = dict[Pair, Link]()
    for pair, answer in pairs.items():
        of_events = not any(seen[k].has_frames for k in pair)
        estimate = answer.estimate
        if estimate.has_offset and not np.isfinite(estimate.t_ref_s):  # it has no skew
            middle_s = 0.5 * sum(answer.paired.common_s(estimate.t_d_s))
            estimate = replace(estimate, t_ref_s=middle_s)
        link = link_of(estimate, answer.guess, of_events, bool(answer.misfit))
        if link is not None and all(len(seen[k]) > 1 for k in pair):
            links[pair] = link
    posed = all(answer.method.needs_extrinsics for answer in pairs.values())
    return solve_network(seen, links, chain.config, distance_m or 1.0, posed)


def grounded(
    answer: NetworkAnswer, known: Known, rules: Rules
) -> tuple[NetworkAnswer, Ground | None]:
    """Transform an answer to the known frame, if one is known and there is any network."""
    if not answer.built:
        return answer, None
    if known.positions is not None:
        ground = ground_of_positions(answer, known.positions, rules.ground)
    elif known.rtk is not None:
        ground = ground_of_rtk(answer, known.rtk, rules.ground, rules.fit, known.lever_arm_m)
    else:
        return answer, None
    return in_frame(answer, ground), ground


def write_two(
    answer: Answer, known: Known, trajectory: Path | None, rig: Path | None, log: Log
) -> None:
    """Write the object's path, and the rig with the pose found; log the files, or why not."""
    estimate, distance_m = answer.estimate, answer.distance_m
    T_2_1 = answer.rig.T_2_1 if answer.method.needs_extrinsics and answer.rig.in_metres else None
    if distance_m is None and T_2_1 is not None:
        distance_m = float(np.linalg.norm(T_2_1[:3, 3]))
    if estimate.status != Status.OK or estimate.R is None or estimate.t is None:
        for file in filter(None, (trajectory, rig)):
            log(f"not written: {file}, since there is no reliable pose")
        return
    scale, in_metres = distance_m or 1.0, distance_m is not None
    if trajectory is not None:
        # Of a network's clocks more is asked than of a pair's: whether they wander is found out.
        clock = answer.asked_clock if answer.config.clock == "affine" else answer.config.clock
        chain = Chain(answer.cleans, answer.rig, replace(answer.config, clock=clock))
        found = solve_pairs(chain, {(0, 1): answer}, distance_m)
        found, ground = grounded(found, known, answer.config.rules)
        if ground is not None:
            scale, in_metres = scale * ground.similarity.scale, True
        _write_paths(trajectory, found, in_metres, log)
    if rig is not None:
        T = _transform(estimate)
        T[:3, 3] *= scale
        step = Step(1, T, estimate.t_d_s + estimate.clock.stray_at_ref_s, in_metres)
        used = answer.less_certain or answer.rig
        _save_rig(rig, (used.cam1, used.cam2), [None, step], log)


def write_many(result: NetworkResult, trajectory: Path | None, rig: Path | None, log: Log) -> None:
    """Write as `write_two` does; each pose is from the camera placed before it in its group."""
    if trajectory is not None:
        _write_paths(trajectory, result.network, result.scale_is_known, log)
    if rig is None:
        return
    found, steps = result.network.cameras, list[Step | None]()
    groups = [camera.group for camera in found]  # 0 of one that is placed nowhere
    for k, other in enumerate(found):
        before = [j for j in range(k) if 0 < groups[j] == groups[k]]
        step = None
        if before:
            one = found[before[-1]]
            T = _transform(other) @ np.linalg.inv(_transform(one))
            shown_s = [float(of.clock.cam2_from_cam1(other.t_ref_s)) for of in (one, other)]
            in_metres = result.scale_is_known and groups[k] == 1
            step = Step(k - before[-1], T, shown_s[1] - shown_s[0], in_metres)
        steps.append(step)
    if not any(steps):
        log(f"not written: {rig}, since no two cameras are placed")
        return
    apart = ", ".join(
        f"camera {k} ({f'group {camera.group}' if camera.group else camera.status})"
        for k, camera in enumerate(found, start=1)
        if camera.group != 1
    )
    rigs = [result.pairs[0, k].rig for k in range(1, len(found))]
    stated = rigs[0].cam1, *(one.cam2 for one in rigs)
    used = [one.calibration or camera for one, camera in zip(found, stated, strict=True)]
    _save_rig(rig, used, steps, log, apart)


def _save_rig(
    file: Path, cameras: Sequence[Camera], steps: Sequence[Step | None], log: Log, apart: str = ""
) -> None:
    units = dict.fromkeys(_unit(step.in_metres) for step in steps if step is not None)
    about = f"lengths in {' or '.join(units)}{', as length_unit says' * (len(units) > 1)}"
    if apart:
        about += f"; no pose with the others: {apart}"
    save_rig(file, cameras, steps, f"{about}; t_cn = t_cnm1 + timeshift_cn_cnm1")
    log(f"wrote {file}, {about}")


def _unit(in_metres: bool) -> str:
    return "metres" if in_metres else "distances of the first two cameras placed"


def _transform(of: CameraAnswer | Estimate) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = of.R, of.t
    return T


def _write_paths(file: Path, answer: NetworkAnswer, in_metres: bool, log: Log) -> None:
    """Write and log the path of the first group, perhaps in metres; others to numbered files."""
    for k, found in enumerate(answer.paths):
        other = file if k == 0 else numbered_file(file, k + 1)
        has_scale = in_metres and k == 0
        write_path(other, found.path, has_scale)
        spans = ", ".join(f"{start_s:.3f} to {end_s:.3f} s" for start_s, end_s in found.spans_s)
        held = f"{len(found.path)} samples in {_unit(has_scale)}, which hold from {spans}"
        log(f"wrote {other}: {held}")
    if not answer.paths:
        reasons = dict.fromkeys(camera.reason for camera in answer.cameras)
        log(f"not written: {file}, since {'; '.join(reasons)}")


def short_names(names: Sequence[str]) -> list[str]:
    """Return the shortest ends of all paths, without extensions, that differ from each other."""
    parts = [(*Path(name).parent.parts, Path(name).stem) for name in names]
    for n in range(1, max(map(len, parts)) + 1):
        ends = ["/".join(one[-n:]) for one in parts]
        if len(set(ends)) == len(ends):
            return ends
    return list(names)


def _sightings(chain: Chain, k: int, name: str, pairs: dict[Pair, Answer]) -> Sightings:
    """Return a camera's sightings of the object; none where its events show no object."""
    own = ((pair.index(k), answer) for pair, answer in pairs.items() if k in pair)
    # A refused pair may not have its object: of a faint one there is no track, but noise.
    place, answer = max(own, key=lambda one: one[1].estimate.has_offset)
    clean = answer.cleans[place]
    # An answer may be of other windows than were asked for; so is then the track.
    config = answer.config if answer.estimate.has_offset else chain.config
    try:
        if clean.track is not None:
            shaped = ShapedTrack(clean.track, None)
        elif len(chain) < LEAST_VIEWS:  # too few for the perspective of silhouettes
            shaped = ShapedTrack(track_of_events(clean, config), None)
        else:
            events = chain.recorded(k).events
            shaped = shaped_track_of_events(clean, events, config)
    except SsacError:  # its pairs say why
        shaped = ShapedTrack(PointTrack(np.empty(0), np.empty((0, 2))), None)
    has_frames = clean.has_track and not clean.n_followed
    # Events have no rows.
    camera = clean.camera if has_frames else replace(clean.camera, readout_s=None)
    return sightings(shaped, camera, name, has_frames, config.rules.points)


_NUMBERS = (
    "t_d_s", "t_d_std_s", "t_ref_s", "skew_ppm", "skew_std_ppm", "readout_s", "readout_std_s",
    "R", "t", "r_std_deg", "t_std",
)  # fmt: skip
"""Fields of `CameraAnswer` that the JSON output has under the same names."""


def _camera(camera: CameraAnswer, name: str) -> dict[str, Any]:
    found = camera.calibration
    return {
        "name": camera.name,
        "file": name,
        "status": str(camera.status),
        "reason": camera.reason,
        "group": camera.group or None,
        **{name: plain(getattr(camera, name)) for name in _NUMBERS},
        "clock_knots": [
            {"t_s": t_s, "stray_s": stray_s}
            for t_s, stray_s in zip(camera.knots_s.tolist(), camera.strays_s.tolist(), strict=True)
        ],
        "intrinsics": found and [*np.diag(found.K)[:2].tolist(), *found.K[:2, 2].tolist()],
        "intrinsics_std": found and list(found.intrinsics_std_px),
        "n_samples": camera.n_samples,
        "rms_px": plain(camera.rms_px),
    }


def _camera_rows(camera: CameraAnswer, unit: str) -> list[tuple[str, str]]:
    if camera.status != Status.OK or camera.R is None or camera.t is None:
        return [(camera.name, f"{camera.status}: {camera.reason}")]
    stands = vector(-camera.R.T @ camera.t, 3)
    turn_deg = np.degrees(Rotation.from_matrix(camera.R).magnitude())
    used = f"{camera.n_samples} of {camera.n_seen} sightings used, {camera.rms_px:.2f} px"
    turned = f"turned by {turn_deg:.2f} deg, 1 sigma {camera.r_std_deg:.3f}"
    placed = f"at {stands}{unit}, {turned}; {used}"
    readout = f"rows read out in {1e3 * camera.readout_s:.2f} ms, "
    readout += f"1 sigma {1e3 * camera.readout_std_s:.2f} ms"
    own = [("", readout)] if camera.readout_std_s > 0.0 else []
    if not camera.t_d_std_s > 0.0:
        in_own_frame = np.allclose(camera.t, 0.0) and camera.r_std_deg == 0.0  # rounding apart
        rows = [(camera.name, f"the first of group {camera.group}")]
        return [*rows, ("", used if in_own_frame else placed), *own]
    offset = f"t_d = {1e3 * camera.t_d_s:.2f} ms, 1 sigma {1e3 * camera.t_d_std_s:.2f} ms"
    skew = f"skew {camera.skew_ppm:+.1f} ppm, 1 sigma {camera.skew_std_ppm:.1f}"
    rows = [(camera.name, f"{offset}, at {camera.t_ref_s:.2f} s; {skew}")]
    if len(camera.knots_s):
        then_ms = 1e3 * camera.clock.stray_at_ref_s
        rows.append(("", f"for a straight line, from which it strays by {then_ms:+.2f} ms then"))
    return [*rows, ("", placed), *own]
