"""All that is known of a user's recording, on one HTML page that needs no other file.

It is the same for what was answered and for what was refused: a page on a refused recording shows
why. Nothing here decides anything; all numbers come from the answers.
"""

import json
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import BaseLoader, ChoiceLoader, Environment, PackageLoader, StrictUndefined

from ssac.estimate import Estimate, Status
from ssac.files.whole_file import whole_file
from ssac.fit.covariance import NORMAL_95
from ssac.network.graph import Pair
from ssac.network.solve import NetworkAnswer
from ssac.pipeline.answer import Answer
from ssac.pipeline.pair_charts import charts_of, sample_charts
from ssac.pipeline.report import rows_of
from ssac.pipeline.streams import Seen, as_recorded, scene_of_network, scene_of_two, streams

Answers = Mapping[Pair, Answer]

_PACKAGES = "ssac-suite", "numpy", "scipy", "numba", "opencv-python-headless"
_MOST_DOTS = 1000  # in a chart of a pair's; fewer where there are many pairs
_NUMBERS = {"fu": (0, 0), "fv": (1, 1), "pu": (0, 2), "pv": (1, 2)}


def save_report(
    path: Path, answers: Answers, network: NetworkAnswer | None, summary: str, command: str = ""
) -> Path:
    """Write `report_page`; give its path."""
    page = report_page(answers, network, summary, command)
    with whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def report_page(
    answers: Answers, network: NetworkAnswer | None, summary: str, command: str = ""
) -> str:
    """Lay out the page on two cameras, or on all pairs of more and their network.

    The summary is what is printed, and the command what was called; empty: from Python. The same
    input gives the same bytes.
    """
    cameras = seen_by(answers, network)
    most = max(150, _MOST_DOTS // len(answers))
    return (
        environment()
        .get_template("report.html")
        .render(
            title=_title(answers, network),
            status=_status(answers, network),
            cards=_cards(answers[0, 1]) if network is None else [],
            player=player_of(answers, cameras, network),
            network=network,
            graph=None if network is None else _graph(answers, network),
            pairs=[
                {
                    "numbers": (a + 1, b + 1),
                    "status": str(answer.estimate.status),
                    "reason": answer.estimate.reason,
                    "offset": _offset_words(answer.estimate),
                    "charts": charts_of(answer, most),
                    "intrinsics": _intrinsics(answer),
                }
                for (a, b), answer in answers.items()
            ],
            samples=sample_charts(cameras, max(300, 2 * _MOST_DOTS // len(cameras))),
            cameras=cameras,
            rig=answers[0, 1].rig_name,
            command=command,
            versions={"Python": platform.python_version(), **{n: _version(n) for n in _PACKAGES}},
            seconds=answers[0, 1].seconds,
            summary=rows_of(summary),
        )
    )


def environment(*loaders: BaseLoader) -> Environment:
    """Make the environment of this page's templates, for pages of others too, which have more."""
    made = Environment(
        loader=ChoiceLoader([*loaders, PackageLoader("ssac.pipeline", "page")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["fixed"] = lambda value, digits: f"{round(value, digits) + 0.0:.{digits}f}"
    made.filters["script_json"] = script_json
    made.globals["ours"] = {
        name: (files("ssac.pipeline") / "page" / name).read_text(encoding="utf-8").strip()
        for name in ("page.css", "page.js")
    }
    return made


def script_json(content: Any) -> str:
    """Lay out as JSON that is safe inside a script element."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def player_of(
    answers: Answers,
    cameras: list[Seen],
    network: NetworkAnswer | None = None,
    tour: bool = False,
) -> dict[str, Any]:
    """Lay out what the player and the scene draw; with a tour the player starts by itself."""
    scene = scene_of_two(answers[0, 1]) if network is None else scene_of_network(network)
    return {"tour": tour, "scene": scene, **streams(answers, cameras)}


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
    """Say how it went: a word, a kind for the eye, why, and what to do."""
    estimate, notes = answers[0, 1].estimate, answers[0, 1].notes
    status, reason, has_some = estimate.status, estimate.reason, estimate.has_offset
    if network is not None:
        status, reason, has_some = network.status, network.reason, bool(network.built)
        notes = ()
    ours = {str(one): one for one in Status}.get(status)  # another's method may have its own word
    return {
        "kind": _kind(status, has_some),
        "word": str(status),
        "meaning": ours.meaning if ours else "",
        "reason": reason,
        "remedy": ours.remedy if ours else "",
        "notes": notes,
    }


def _kind(status: str, has_some: bool) -> str:
    return "ok" if status == Status.OK else "open" if has_some else "refused"


def _cards(answer: Answer) -> list[tuple[str, str, str]]:
    """Give what was found in large print: a name, a value, and how sure it is."""
    estimate, R, t = answer.estimate, answer.estimate.R, answer.estimate.t
    if not estimate.has_offset:
        if not np.isfinite(estimate.t_d_s):
            return []
        return [("Best offset", _time(estimate.t_d_s), "not reliable: do not use it")]
    in_ms = abs(estimate.t_d_s) < 1.0
    scale, unit, digits = (1e3, "ms", 3) if in_ms else (1.0, "s", 5)
    sure = _interval(scale * estimate.t_d_s, scale * estimate.t_d_std_s, unit, digits)
    cards = [("Time offset", _time(estimate.t_d_s), sure)]
    if np.isfinite(estimate.skew_ppm) and estimate.skew_std_ppm != 0.0:
        runs = f"camera 2's clock runs {'fast' if estimate.skew_ppm >= 0.0 else 'slow'}"
        sure = _interval(estimate.skew_ppm, estimate.skew_std_ppm, "ppm", 1)
        told = "; ".join(one for one in (runs, sure, answer.of_skew) if one)
        cards.append(("Clock skew", f"{estimate.skew_ppm:+.1f} ppm", told))
    if R is not None and t is not None:
        said = [
            f"1 sigma {std_deg:.3f}°" if np.isfinite(std_deg) else "of unknown accuracy"
            for std_deg in (estimate.r_std_deg, estimate.t_std_deg)
        ]
        if answer.method.needs_extrinsics:
            said = 2 * ["given by the rig file"]
        apart_deg = np.degrees(np.arccos(np.clip(R[2, 2], -1.0, 1.0)))
        towards = ", ".join(f"{value:.2f}" for value in np.round(-R.T @ t, 2) + 0.0)
        cards.append(("Lines of sight", f"{apart_deg:.2f}° apart", f"rotation: {said[0]}"))
        where = f"right, down, forward of camera 1; direction: {said[1]}, length unknown"
        cards.append(("Camera 2 lies towards", f"({towards})", where))
    if np.isfinite(estimate.d_avg_px):
        of = f"of {estimate.n_samples} {answer.method.counts} from their epipolar lines"
        cards.append(("Mean distance", f"{estimate.d_avg_px:.2f} px", of))
    return cards


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


def _intrinsics(answer: Answer) -> list[dict[str, Any]]:
    """Compare the intrinsics that were fitted with the rig's, in deviations of the rig's."""
    rows = list[dict[str, Any]]()
    for k, K in enumerate(answer.estimate.Ks or ()):
        stds_px = zip(_NUMBERS.items(), answer.cameras[k].intrinsics_std_px, strict=True)
        for (name, place), std_px in stds_px:
            given_px, found_px = float(answer.cameras[k].K[place]), float(K[place])
            if std_px > 0.0:
                rows.append(
                    {
                        "camera": k + 1,
                        "name": name,
                        "given_px": given_px,
                        "std_px": std_px,
                        "found_px": found_px,
                        "deviations": (found_px - given_px) / std_px,
                    }
                )
    return rows


def _graph(answers: Answers, network: NetworkAnswer) -> dict[str, Any]:
    """Lay out the cameras on a circle, and what their pairs say of each other."""
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
    closures = {tuple(k + 1 for k in one): off_s for one, off_s in network.closures_s.items()}
    return {"places": places.tolist(), "edges": edges, "closures": closures}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # run from its source, or brought by another package
        return "not known"
