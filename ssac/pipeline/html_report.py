"""All that is known of a user's recording, on one HTML page that needs no other file.

The page has the same layout for an estimate and for a refusal: on a refused recording it shows why.
Nothing here decides anything; all numbers come from the answers.
"""

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from jinja2 import BaseLoader, ChoiceLoader, Environment, PackageLoader, StrictUndefined
from scipy.spatial.transform import Rotation

from ssac.arrays import Array
from ssac.estimate import Estimate, Status
from ssac.fit.covariance import NORMAL_95
from ssac.geometry.pose import centre_covariance, vector_by_turn
from ssac.network.graph import Pair
from ssac.network.solve import NetworkAnswer
from ssac.pipeline.answer import Answer
from ssac.pipeline.pair_charts import charts_of, sample_charts
from ssac.pipeline.report import (
    Rows,
    counts_of,
    how_it_runs,
    numbered,
    of_length,
    sight_deg,
    vector,
)
from ssac.pipeline.streams import Seen, as_recorded, scene_of_network, scene_of_two, streams
from ssac.track.motion import ObjectMotion

Answers = Mapping[Pair, Answer]
Card = tuple[str, str, str]  # a name, a value, and its accuracy

_PACKAGES = "ssac-suite", "numpy", "scipy", "numba", "opencv-python-headless"
_MOST_DOTS = 1000  # in a chart of a pair; fewer where there are many pairs
_NUMBERS = {"fu": (0, 0), "fv": (1, 1), "pu": (0, 2), "pv": (1, 2)}


def report_page(
    answers: Answers,
    network: NetworkAnswer | None,
    summary: Rows,
    command: str = "",
    units: Sequence[str] = (),
    seconds: Mapping[str, float] | None = None,
) -> str:
    """Return the page on two cameras, or on all pairs of more cameras and their network.

    `summary` has the rows that are printed, `command` is the command line (empty: a Python call),
    `units` are the networks' units of length, and `seconds` what their parts took. The same input
    gives the same bytes.
    """
    cameras = seen_by(answers, network)
    most = max(150, _MOST_DOTS // len(answers))
    return (
        environment()
        .get_template("report.html")
        .render(
            title=_title(answers, network),
            status=_status(answers, network),
            cards=_cards(answers[0, 1]) if network is None else _cards_of_many(network, units),
            player=player_of(answers, cameras, network),
            network=network,
            unit=_said(units),
            graph=None if network is None else _graph(answers, network),
            pairs=[
                {
                    "pair": (a, b),
                    "numbers": (a + 1, b + 1),
                    "estimate": answer.estimate,
                    "offset": _offset_words(answer.estimate),
                    "charts": charts_of(answer, most),
                    "intrinsics": _intrinsics(answer, (a + 1, b + 1)),
                }
                for (a, b), answer in answers.items()
            ],
            samples=sample_charts(cameras, max(300, 2 * _MOST_DOTS // len(cameras))),
            cameras=cameras,
            of_events=any(isinstance(seen.motion, ObjectMotion) for seen in cameras),
            rig=answers[0, 1].rig_name,
            command=command,
            versions={"Python": platform.python_version(), **{n: _version(n) for n in _PACKAGES}},
            seconds=seconds or answers[0, 1].seconds,
            summary=summary,
        )
    )


def environment(*loaders: BaseLoader) -> Environment:
    """Make the template environment of this page; `loaders` add templates of other pages."""
    made = Environment(
        loader=ChoiceLoader([*loaders, PackageLoader("ssac.pipeline", "page")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["fixed"] = lambda value, digits: f"{round(value, digits) + 0.0:.{digits}f}"
    made.filters["numbered"] = numbered
    made.globals["normal_95"] = NORMAL_95
    made.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    return made


def player_of(
    answers: Answers, cameras: list[Seen], network: NetworkAnswer | None = None, tour: bool = False
) -> dict[str, Any]:
    """Return what the player and the scene draw; with a tour the player starts by itself."""
    scene = scene_of_two(answers[0, 1]) if network is None else scene_of_network(network)
    drawn = streams(answers, cameras)
    holds = [pair["holds"] for pair in drawn["pairs"]]
    return {"tour": tour, "scene": scene, "first": int(np.argmax(holds)), **drawn}


def seen_by(answers: Answers, network: NetworkAnswer | None = None) -> list[Seen]:
    """Give all cameras as the page shows them: refused or faint ones with all of their events."""
    later_s = {b: one.estimate.t_d_s for (a, b), one in answers.items() if a == 0}
    if network is not None and network.cameras[0].group == 1:
        placed = enumerate(network.cameras)
        later_s |= {k: one.t_d_s for k, one in placed if one.group == 1}
    later_s[0] = 0.0
    cameras = list[Seen]()
    for k in range(len(later_s)):
        of_it = {pair: answer for pair, answer in answers.items() if k in pair}
        pair, answer = next(iter(of_it.items()))
        clean, motion = answer.cleans[pair.index(k)], answer.paired.motions[pair.index(k)]
        is_answered = any(one.estimate.has_offset for one in of_it.values())
        shown = clean if is_answered and clean.track is None else as_recorded(clean)
        is_known = bool(np.isfinite(later_s[k]))
        cameras.append(Seen(clean, shown, motion, float(later_s[k]) if is_known else None))
    return cameras


def _title(answers: Answers, network: NetworkAnswer | None) -> str:
    if network is not None:
        placed = sum(one.status == Status.OK for one in network.cameras)
        return f"{placed} of {len(network.cameras)} cameras on one clock and in one frame"
    estimate = answers[0, 1].estimate
    if not estimate.has_offset:
        return "No reliable offset between the two cameras"
    side = "ahead of" if estimate.t_d_s >= 0.0 else "behind"
    return f"Camera 2's clock is {_time(abs(estimate.t_d_s))} {side} camera 1's"


def _status(answers: Answers, network: NetworkAnswer | None) -> dict[str, Any]:
    """Return the status as a word, its kind for display, its meaning, reason, remedy and notes."""
    estimate, notes = answers[0, 1].estimate, answers[0, 1].notes
    status, reason, has_some = estimate.status, estimate.reason, estimate.has_offset
    meaning, remedy = "", ""
    if isinstance(status, Status):  # another package's method may have its own word
        meaning, remedy = status.meaning, status.remedy
    kind = _kind(status, has_some)
    if kind == "ok" and not np.isfinite(estimate.t_d_std_s):
        kind, meaning = "open", "there is an offset, but its accuracy is unknown"
    if network is not None:
        status, reason, has_some = network.status, network.reason, bool(network.built)
        kind, meaning, remedy, notes = _kind(status, has_some), Status.OK.meaning, "", ()
        if status != Status.OK:
            meaning = "not all cameras are on one clock and in one frame"
            remedy = (
                "see below why pairs were refused; check that all files are of one flight, and the"
                " rig of these cameras, in this order"
            )
    return {
        "kind": kind,
        "word": str(status),
        "meaning": meaning,
        "reason": reason,
        "remedy": remedy,
        "notes": notes,
    }


def _kind(status: str, has_some: bool) -> str:
    return "ok" if status == Status.OK else "open" if has_some else "refused"


def _cards(answer: Answer) -> list[Card]:
    estimate, R, t = answer.estimate, answer.estimate.R, answer.estimate.t
    if not estimate.has_offset:
        if not np.isfinite(estimate.t_d_s):
            return []
        return [("Best offset", _time(estimate.t_d_s), "not reliable: do not use it")]
    at = estimate.t_d_s, estimate.t_d_std_s, estimate.t_ref_s
    cards, runs = [_offset_card("Time offset", *at)], how_it_runs(estimate)
    if runs:
        skew_ppm, std_ppm = estimate.skew_ppm, estimate.skew_std_ppm
        sure = _interval(skew_ppm, std_ppm, "ppm", 1) if std_ppm != 0.0 else ""
        told = "; ".join(one for one in (runs, sure, answer.of_skew) if one)
        cards.append(("Clock skew", f"{skew_ppm:+.1f} ppm", told))
    if R is not None and t is not None:
        cards += _pose_cards(answer, R, t)
    if np.isfinite(estimate.d_avg_px):
        of = f"of {estimate.n_samples} {counts_of(answer)} from their epipolar lines"
        cards.append(("Mean distance", f"{estimate.d_avg_px:.2f} px", of))
    return cards


def _pose_cards(answer: Answer, R: Array, t: Array) -> list[Card]:
    estimate, (lies, unit, length) = answer.estimate, of_length(answer.distance_m)
    scale = answer.distance_m or 1.0
    turned_deg = Rotation.from_matrix(R).as_rotvec(degrees=True)
    turn, direction = f"rotation vector {vector(turned_deg, 2)}\N{DEGREE SIGN}", length
    if answer.method.needs_extrinsics:
        turn, direction = f"{turn}, given by the rig file", "given by the rig file"
    elif estimate.covariance is None:
        turn, direction = f"{turn}, of unknown accuracy", f"{length}, of unknown accuracy"
    else:
        by_turn = vector_by_turn(R)
        turn_stds = np.sqrt(np.diag(by_turn @ estimate.covariance[1:4, 1:4] @ by_turn.T))
        where = centre_covariance(R, t, estimate.covariance[1:, 1:])
        stds = scale * np.sqrt(np.diag(where))
        turn += f", {_around(np.degrees(turn_stds), 2)}\N{DEGREE SIGN}"
        turn += f"; 1 sigma {estimate.r_std_deg:.3f}\N{DEGREE SIGN}"
        direction = f"{_around(stds, 3)}{unit}; 1 sigma {estimate.t_std_deg:.3f}\N{DEGREE SIGN}"
        direction += f", {length}"
    place = f"{vector(-scale * R.T @ t, 3)}{unit}"
    return [
        ("Lines of sight", f"{sight_deg(R):.2f}\N{DEGREE SIGN} apart", turn),
        (f"Camera 2 {lies}", place, f"right, down, forward of camera 1; {direction}"),
    ]


def _said(units: Sequence[str]) -> str:
    """Name the unit of all groups, or that of each."""
    if len(set(units)) < 2:
        return "".join(units[:1])  # empty for a page on two cameras
    return ", ".join(f"{unit} (group {k})" for k, unit in enumerate(units, start=1))


def _cards_of_many(network: NetworkAnswer, units: Sequence[str]) -> list[Card]:
    """Return a card with the offset and position of each camera but the first of its group."""
    cards = list[Card]()
    for k, one in enumerate(network.cameras):
        if one.centre is None or one.centre_covariance is None or not one.t_d_std_s > 0.0:
            continue
        first = network.built[one.group - 1].members[0] + 1
        offset = f"Camera {k + 1}'s clock", one.t_d_s, one.t_d_std_s, one.t_ref_s, first
        name, value, sure = _offset_card(*offset)
        stds = np.sqrt(np.diag(one.centre_covariance))
        stands = f"{vector(one.centre, 3)}, {_around(stds, 3)}, in {units[one.group - 1]}"
        cards.append((name, value, f"{sure}. It stands at {stands}"))
    return cards


def _offset_card(name: str, t_d_s: float, std_s: float, t_ref_s: float, first: int = 1) -> Card:
    scale, unit, digits = (1e3, "ms", 3) if abs(t_d_s) < 1.0 else (1.0, "s", 6)
    sure = _interval(scale * t_d_s, scale * std_s, unit, digits)
    if np.isfinite(t_ref_s):
        sure += f"; at {t_ref_s:.3f} s of camera {first}'s clock"
    return name, _time(t_d_s), sure


def _around(stds: Array, digits: int) -> str:
    """Write the half-widths of the 95 % intervals of numbers with these deviations (n,)."""
    return f"95 % within \N{PLUS-MINUS SIGN}{vector(NORMAL_95 * stds, digits)}"


def _interval(value: float, std: float, unit: str, digits: int) -> str:
    if not np.isfinite(std):
        return "of unknown accuracy"
    low, high = (f"{value + side * NORMAL_95 * std:.{digits}f}" for side in (-1, 1))
    return f"95 % interval {low} to {high} {unit}; 1 sigma {std:.{digits}f} {unit}"


def _time(value_s: float) -> str:
    """Write a time to the microsecond, in ms up to a second."""
    if abs(value_s) < 1.0:
        return f"{1e3 * value_s:.3f}\N{NO-BREAK SPACE}ms"
    return f"{value_s:.6f}\N{NO-BREAK SPACE}s"


def _offset_words(estimate: Estimate) -> str:
    if not np.isfinite(estimate.t_d_s):
        return "no offset"
    if not estimate.has_offset:
        return f"{_time(estimate.t_d_s)}, not reliable"
    if not np.isfinite(estimate.t_d_std_s):
        return f"{_time(estimate.t_d_s)}, of unknown accuracy"
    return f"{_time(estimate.t_d_s)}, 1 sigma {1e3 * estimate.t_d_std_s:.3f} ms"


def _intrinsics(answer: Answer, numbers: Pair) -> list[tuple[int, str, float, float, float]]:
    """List cameras, names and values of fitted intrinsics: the rig's, its deviation, the fitted."""
    Ks = () if answer.estimate.Ks is None else enumerate(answer.estimate.Ks)
    return [
        (numbers[k], name, float(answer.cameras[k].K[place]), std_px, float(K[place]))
        for k, K in Ks
        for (name, place), std_px in zip(
            _NUMBERS.items(), answer.cameras[k].intrinsics_std_px, strict=True
        )
        if std_px > 0.0
    ]


def _graph(answers: Answers, network: NetworkAnswer) -> dict[str, Any]:
    """Return the graph of the network: cameras on a circle, pairs as edges, closure errors."""
    angles = 2.0 * np.pi * np.arange(len(network.cameras)) / len(network.cameras)
    places = np.column_stack([180.0 + 120.0 * np.sin(angles), 135.0 - 95.0 * np.cos(angles)])
    edges = [
        {
            "ends": places[list(pair)].ravel().tolist(),
            "kind": "wrong"
            if pair in network.wrong_pairs
            else _kind(answer.estimate.status, answer.estimate.has_offset),
            "off_s": network.wrong_pairs.get(pair),
        }
        for pair, answer in answers.items()
    ]
    closures = list[tuple[str, float, float]]()
    for (a, b, c), off_s in network.closures_s.items():
        stds_s = [answers[pair].estimate.t_d_std_s for pair in ((a, b), (b, c), (a, c))]
        std_ms = 1e3 * float(np.linalg.norm(stds_s))
        closures.append((f"{a + 1}, {b + 1}, {c + 1}", 1e3 * off_s, std_ms))
    return {"places": places.tolist(), "edges": edges, "closures": closures}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # run from its source, or brought by another package
        return "not known"
