"""Reports of two cameras' answer, as text for people and as JSON for machines."""

import json
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ssac.arrays import Array
from ssac.config import Interval
from ssac.estimate import Estimate
from ssac.files.whole_file import write_whole
from ssac.methods.method import Input, Method
from ssac.pipeline.answer import Answer
from ssac.screen import columns, folded

Rows = Sequence[tuple[str, str]]  # pairs of a name, which may be empty, and a value

_NAME = 15  # columns of a row's name


def report_rows(answer: Answer) -> Rows:
    """Return an answer as rows for people, whose long values are not yet folded."""
    estimate, rows = answer.estimate, list[tuple[str, str]]()
    if estimate.status != "ok":
        title = "no pose" if estimate.has_offset else "no estimate"
        rows.append((title, f"{estimate.status}: {estimate.reason}"))
    if np.isfinite(estimate.t_d_s):
        rows += _offset_rows(estimate) + _skew_rows(answer) + _readout_rows(estimate)
    rows += _objects_row(answer)
    if answer.note:
        rows.append(("note", answer.note))
    if answer.method.needs_extrinsics:
        rows.append(("pose", f"as given in {answer.rig_name}"))
    elif estimate.R is not None and estimate.t is not None:
        rows += _pose_rows(answer, estimate.R, estimate.t)
    if answer.method.input is Input.TRACKS:
        counts = counts_of(answer)
        times = "" if counts != Method.counts else f", of {answer.config.n_samples} sample times"
        rows.append(("samples", f"{estimate.n_samples} {counts} used{times}"))
    rows += _clutter_rows(answer)
    if np.isfinite(estimate.d_avg_px):
        rows.append(("d_avg", f"{estimate.d_avg_px:.3f} px from point to epipolar line"))
    rows.append(("method", f"{answer.method.name}: {answer.method.summary}"))
    return rows


def text_of(rows: Rows) -> str:
    """Lay out rows as text; long values are folded."""
    lines, width = [], columns(sys.stdout) - _NAME
    for name, value in rows:
        first, *others = folded(value, width)
        if len(name) >= _NAME:  # a camera's, after its file
            lines.append(name)
            name = ""
        lines += [f"{name:{_NAME}}{first}", *(f"{'':{_NAME}}{other}" for other in others)]
    return "\n".join(lines)


def report_json(answer: Answer) -> dict[str, Any]:
    """Return an answer as a dictionary for JSON: units in the names, None for what is missing."""
    estimate = answer.estimate
    of_clock = "t_d_s", "t_d_std_s", "t_ref_s", "skew_ppm", "skew_std_ppm"
    return {
        **{name: plain(getattr(estimate, name)) for name in of_clock},
        "readout_s": plain(estimate.readouts_s),
        "readout_std_s": plain(estimate.readouts_std_s),
        "R": plain(estimate.R),
        "t": plain(estimate.t),
        "distance_m": answer.distance_m,
        "deg_per_percent_of_focals": plain(0.01 * estimate.per_focal_deg),
        "status": str(estimate.status),
        "reason": estimate.reason,
        "note": answer.note,
        "method": answer.method.name,
        "n_samples": estimate.n_samples if answer.method.input is Input.TRACKS else None,
        "d_avg_px": plain(estimate.d_avg_px),
        "t_d_is_reliable": estimate.has_offset,
        "alternatives_s": plain(estimate.alternatives_s),
        "unobservable": plain(estimate.unobservable),
        "covariance": plain(estimate.covariance),
        "clock_covariance": plain(estimate.clock_covariance),
        "clock_knots": [  # std_s: deviation of the whole clock reading there
            dict(zip(("t_s", "stray_s", "std_s"), knot.tolist(), strict=True))
            for knot in np.column_stack(
                [estimate.knots_s, estimate.strays_s, estimate.strays_std_s]
            )
        ],
        "objects": [asdict(seen.used) for seen in answer.cleans]
        if answer.looks_at_one_object
        else None,
        "clock_jump": None
        if estimate.jump is None
        else {name: plain(value) for name, value in asdict(estimate.jump).items()},
        "clutter": [
            None
            if seen.clutter is None
            else asdict(seen.clutter) | {"n_min": seen.n_min(answer.config.n_min)}
            for seen in answer.cleans
        ],
        "conventions": "t_cam2 = t_cam1 + t_d + skew (t_cam1 - t_ref), and what it strays at knots,"
        " linear in between; x2 = R x1 + t, |t| = 1; covariance of t_d [s], "
        "rotation vector of exp([w]x) R [rad] and t's two tangents [rad]; unobservable: unit "
        "directions in the same six; readouts of camera 1 and 2, null: not known, taken for 0",
        "search_s": list(_searched_s(answer)),
        "cam1": answer.names[0],
        "cam2": answer.names[1],
        "rig": answer.rig_name,
        "seconds": {part: round(value, 3) for part, value in answer.seconds.items()},
    }


def _searched_s(answer: Answer) -> Interval:
    """Bounds [s] of the offsets searched: of all, where a search of all of them gave no answer."""
    if answer.start is None or answer.estimate.has_offset:
        return answer.config.offsets_s
    found = answer.start.found
    tried_s = found.candidates_s[np.isfinite(found.costs)].tolist()
    return (min(tried_s), max(tried_s)) if tried_s else answer.config.offsets_s


def _objects_row(answer: Answer) -> list[tuple[str, str]]:
    """Row on the number of objects seen; none where all cameras saw one at a time."""
    if not (answer.looks_at_one_object and answer.sees_several):
        return []
    parts = [
        f"camera {number} sees {seen.used.seen}"
        + (f", {100.0 * seen.used.share:.0f} % of its events used" if seen.used.share else "")
        for number, seen in enumerate(answer.cleans, start=1)
    ]
    return [("objects", "; ".join(parts))]


def html_of(rows: Rows) -> str:
    """Lay out rows as a table, for notebooks."""
    left = "style='text-align:left'"
    cells = [f"<th {left}>{escape(a)}</th><td {left}>{escape(b)}</td>" for a, b in rows]
    return f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"


def save_json(path: Path, told: dict[str, Any]) -> None:
    """Write a dictionary as a JSON file, which appears only when it is complete."""
    rows = [
        f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in told.items()
    ]
    write_whole(path, "{\n" + ",\n".join(rows) + "\n}\n")


def _offset_rows(estimate: Estimate) -> list[tuple[str, str]]:
    """Rows on the offset, its sign in words; what to do with it only where its error is known."""
    offset_ms, sigma_ms = 1e3 * estimate.t_d_s, 1e3 * estimate.t_d_std_s
    if not estimate.has_offset:
        rows = [("not reliable", f"t_d = {offset_ms:.3f} ms")]
        others = ", ".join(f"{1e3 * other_s:.0f}" for other_s in estimate.alternatives_s)
        return rows + ([("or", f"t_d = {others} ms")] if others else [])
    more, remedy = ("more", "subtract it from") if offset_ms >= 0.0 else ("less", "add it to")
    words = f"camera 2's clock shows {abs(offset_ms):.3f} ms {more} than camera 1's"
    if not np.isfinite(sigma_ms):
        return [("time offset", f"t_d = {offset_ms:.3f} ms, of unknown accuracy"), ("", words)]
    return [
        ("time offset", f"t_d = {offset_ms:.3f} ms, 1 sigma {sigma_ms:.3f} ms"),
        ("", f"{words}; {remedy} camera 2's timestamps"),
    ]


def _skew_rows(answer: Answer) -> list[tuple[str, str]]:
    estimate, std_ppm = answer.estimate, answer.estimate.skew_std_ppm
    runs = how_it_runs(estimate)
    if not runs:
        return []
    sigma = f", 1 sigma {std_ppm:.1f} ppm" if 0.0 < std_ppm < np.inf else ""
    rows = [
        ("clock skew", f"{estimate.skew_ppm:+.1f} ppm{sigma}"),
        ("", f"{runs}; t_d holds at {estimate.t_ref_s:.3f} s of camera 1's"),
    ]
    if len(estimate.knots_s):
        most_ms = 1e3 * float(np.max(np.abs(estimate.strays_s)))
        then_ms = 1e3 * estimate.clock.stray_at_ref_s
        rows += [
            ("", f"for a straight line, from which it strays by up to {most_ms:.3f} ms, and by"),
            ("", f"{then_ms:+.3f} ms at that time: {len(estimate.knots_s)} knots"),
        ]
    if answer.of_skew:
        rows.append(("", answer.of_skew))
    return rows


def how_it_runs(estimate: Estimate) -> str:
    """Say how camera 2's clock runs; empty where its skew was neither estimated nor searched."""
    ppm, std_ppm = estimate.skew_ppm, estimate.skew_std_ppm
    if not (estimate.has_offset and np.isfinite(ppm)) or ppm == std_ppm == 0.0:
        return ""
    if abs(ppm) <= std_ppm:
        mostly = " on average" if len(estimate.knots_s) else ""
        return f"the clocks run alike{mostly}, as far as this tells"
    return f"camera 2's clock runs {'fast' if ppm >= 0.0 else 'slow'}"


def _readout_rows(estimate: Estimate) -> list[tuple[str, str]]:
    readouts = zip(estimate.readouts_s, estimate.readouts_std_s, strict=True)
    found = [
        f"camera {number} {1e3 * readout_s:.1f} ms, 1 sigma {1e3 * std_s:.1f} ms"
        for number, (readout_s, std_s) in enumerate(readouts, start=1)
        if std_s > 0.0
    ]
    return [("readout", "; ".join(found))] if found else []


def _pose_rows(answer: Answer, R: Array, t: Array) -> list[tuple[str, str]]:
    """Rows on the pose x2 = R x1 + t, with its deviations where they are known."""
    estimate, (lies, unit, length) = answer.estimate, of_length(answer.distance_m)
    t = (answer.distance_m or 1.0) * t
    stds_deg = estimate.r_std_deg, estimate.t_std_deg
    rotation = Rotation.from_matrix(R).as_rotvec(degrees=True)
    sigmas = [f", 1 sigma {std:.3f} deg" if np.isfinite(std) else "" for std in stds_deg]
    rows = [
        ("lines of sight", f"{sight_deg(R):.2f} deg apart"),
        ("rotation", f"vector {vector(rotation, 3)} deg{sigmas[0]}; x2 = R x1 + t"),
        ("translation", f"t = {vector(t, 4)}{unit}, {length}{sigmas[1]}"),
        ("", f"camera 2 {lies} {vector(-R.T @ t, 3)}{unit} of camera 1 (right, down, forward)"),
    ]
    if np.isfinite(estimate.per_focal_deg).all():
        R_deg, t_deg = 0.01 * estimate.per_focal_deg
        both = f"1 % of both focal lengths turns R by {R_deg:.2f} deg and t by {t_deg:.2f} deg"
        rows.append(("rests on", both))
    return rows


def sight_deg(R: Array) -> float:
    """Return the angle [deg] between both cameras' optical axes."""
    return float(np.degrees(np.arccos(np.clip(R[2, 2], -1.0, 1.0))))


def of_length(distance_m: float | None) -> tuple[str, str, str]:
    """Return the words for camera 2's place, its unit and the length of t, by the distance."""
    if distance_m is None:
        return "lies towards", "", "of unknown length"
    return "lies at", " m", f"{distance_m:g} m long as stated"


def counts_of(answer: Answer) -> str:
    """Name what the estimate's `n_samples` counts, in the words of its method."""
    if answer.estimate.status != "ok":  # the method may have stopped before it had its own pairs
        return "pairs"
    counts = Method.counts if answer.of_start else answer.method.counts
    # A body's pairs, which are named after a comma, are there only if it has joined.
    return counts.partition(",")[0] if answer.estimate.without_body else counts


def _clutter_rows(answer: Answer) -> list[tuple[str, str]]:
    """Rows on cameras with masked pixels, an adapted filter, a faint object or a line."""
    rows = []
    for number, camera in enumerate(answer.cleans, start=1):
        clutter, parts = camera.clutter, list[str]()
        if clutter is not None and clutter.masked_pixels:
            parts.append(
                f"{clutter.masked_pixels} px that fire by themselves masked"
                f" ({clutter.masked_events} events)"
            )
        if camera.n_followed:
            parts.append(f"a faint object followed, of {camera.n_followed} events")
        elif clutter is not None and clutter.is_adapted:
            parts.append(
                f"with a background of {clutter.background_hz:.2g} Hz/px an event needs"
                f" {clutter.n_neighbours} others within {clutter.radius_px:g} px, ms, and a"
                f" position {camera.n_min(answer.config.n_min)} events"
            )
        if camera.on_line is not None:
            parts.append(
                "a line that holds the object is seen, and no part of its outline"
                f" ({np.count_nonzero(camera.on_line)} events)"
            )
        if parts:
            rows.append(("clutter", f"camera {number}: {'; '.join(parts)}"))
    return rows


def vector(values: Array, digits: int) -> str:
    """Write numbers (n,) in brackets."""
    return f"({', '.join(f'{value:.{digits}f}' for value in values + 0.0)})"


def numbered(said: str, pair: tuple[int, int]) -> str:
    """Give cameras 1 and 2, of which a pair says something, their numbers in the network."""
    return re.sub(r"\b([Cc]amera) ([12])\b", lambda of: f"{of[1]} {pair[int(of[2]) - 1] + 1}", said)


def plain(value: float | Array | None) -> Any:
    """Nested lists of Python numbers, None for what is missing or not finite."""
    if value is None:
        return None
    if isinstance(value, np.ndarray):
        return [plain(part) for part in value]
    return float(value) if np.isfinite(value) else None
