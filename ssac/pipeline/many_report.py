"""What is found of many cameras, as text for people and as JSON for machines."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ssac.estimate import Status
from ssac.network.graph import Pair
from ssac.network.ground import Ground
from ssac.network.solve import CameraAnswer, NetworkAnswer
from ssac.pipeline.answer import Answer
from ssac.pipeline.report import html_of, plain


@dataclass(frozen=True, eq=False, repr=False)
class NetworkResult:
    """What is found of many cameras, what it was made from, and how long it took."""

    names: tuple[str, ...]  # of the recordings, in the order of the rig's cameras
    rig_name: str
    network: NetworkAnswer
    pairs: dict[Pair, Answer]
    scale_is_known: bool  # lengths are metres; no: distances of the first two cameras
    ground: Ground | None  # the frame of cameras and path; None: the first camera's
    seconds: dict[str, float]

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

    def summary(self) -> str:
        """Lay it out for people: what `ssac sync` prints."""
        answer, rows = self.network, list[tuple[str, str]]()
        if answer.reason:
            rows.append(("incomplete", answer.reason))
        if self.ground is not None:
            rows.append(("frame", self.ground.said))
        for camera in answer.cameras:
            rows += _camera_rows(camera)
        notes = dict[str, list[str]]()  # each with the pairs that it is said of
        for (a, b), pair in self.pairs.items():
            for note in pair.notes:
                notes.setdefault(note, []).append(f"{a + 1}-{b + 1}")
        rows += [("note", f"{note} (cameras {', '.join(of)})") for note, of in notes.items()]
        for (a, b), off_s in answer.wrong_pairs.items():
            rows.append(("wrong pair", f"{a + 1} and {b + 1}: its clock is {off_s:+.3f} s off"))
        unit = "m" if self.scale_is_known else "distances of the first two cameras"
        for k, found in enumerate(answer.paths, start=1):
            stds = found.path.deviations_m
            medians = np.full(3, np.nan) if stds is None or not len(stds) else np.median(stds, 0)
            sigma = ", ".join(f"{value:.2g}" for value in medians)
            rows.append((f"path {k}", f"{len(found.path)} samples, 1 sigma ({sigma}), in {unit}"))
            for start_s, end_s in found.spans_s:
                rows.append(("", f"holds from {start_s:.3f} to {end_s:.3f} s"))
        return "\n".join(f"{name:15}{value}" for name, value in rows)

    def to_dict(self) -> dict[str, Any]:
        """Lay it out for machines, None for what is missing: what `ssac sync --json` writes."""
        answer = self.network
        return {
            "status": str(answer.status),
            "reason": answer.reason,
            "cameras": [
                _camera(camera, name)
                for camera, name in zip(answer.cameras, self.names, strict=True)
            ],
            "pairs": [
                {
                    "cameras": [a + 1, b + 1],
                    "status": str(pair.estimate.status),
                    "reason": pair.estimate.reason,
                    "note": pair.note,
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
                }
                for built, found in zip(answer.built, answer.paths, strict=True)
            ],
            "scale_is_known": self.scale_is_known,
            "frame": "of each group's first camera" if self.ground is None else self.ground.said,
            "conventions": "of each group's first camera, 1: t_camK = t_cam1 + t_d + skew (t_cam1 "
            "- t_ref), and what it strays at knots, linear in between; x_K = R X + t, X in the "
            "frame, |t| of the second camera is 1, or metres where the scale is known",
            "rig": self.rig_name,
            "seconds": {part: round(value, 3) for part, value in self.seconds.items()},
        }

    def __repr__(self) -> str:
        placed = sum(camera.status == Status.OK for camera in self.network.cameras)
        return f"<ssac.NetworkResult {self.status}, {placed} of {len(self.names)} cameras placed>"

    def _repr_html_(self) -> str:
        return html_of(self.summary())


_NUMBERS = (
    "t_d_s", "t_d_std_s", "t_ref_s", "skew_ppm", "skew_std_ppm", "readout_s", "readout_std_s",
    "R", "t", "r_std_deg", "t_std",
)  # fmt: skip
"""Of a camera, as its answer names them."""


def _camera(camera: CameraAnswer, name: str) -> dict[str, Any]:
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
        "n_samples": camera.n_samples,
        "rms_px": plain(camera.rms_px),
    }


def _camera_rows(camera: CameraAnswer) -> list[tuple[str, str]]:
    if camera.status != Status.OK or camera.R is None or camera.t is None:
        return [(camera.name, f"{camera.status}: {camera.reason}")]
    stands = "({})".format(", ".join(f"{value:.3f}" for value in -camera.R.T @ camera.t))
    turn_deg = np.degrees(Rotation.from_matrix(camera.R).magnitude())
    used = f"{camera.n_samples} of {camera.n_seen} sightings used, {camera.rms_px:.2f} px"
    if not camera.t_d_std_s > 0.0:
        return [(camera.name, f"the first of group {camera.group}"), ("", used)]
    return [
        (
            camera.name,
            f"t_d = {1e3 * camera.t_d_s:.2f} ms, 1 sigma {1e3 * camera.t_d_std_s:.2f} ms, at "
            f"{camera.t_ref_s:.2f} s; skew {camera.skew_ppm:+.1f} ppm, 1 sigma "
            f"{camera.skew_std_ppm:.1f}",
        ),
        ("", f"at {stands}, turned by {turn_deg:.2f} deg, 1 sigma {camera.r_std_deg:.3f}; {used}"),
    ]
