"""The pipeline's answer for two cameras: an estimate, its inputs, and notes for the user."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ssac.camera import Camera, Rig
from ssac.config import Config
from ssac.estimate import Estimate, Refusal
from ssac.methods.method import Method
from ssac.screen import columns, folded
from ssac.search.all_offsets import Guess
from ssac.search.start import Start
from ssac.search.two_views import TwoViews, as_found, views_of
from ssac.track.clean import Clean
from ssac.track.observation import Observation

Log = Callable[[str], None]

NO_READOUT = "the rig states no readout_s"
CONTRADICTS = "what is seen contradicts the rig"


def quiet(line: str) -> None:
    """Log nothing."""


@dataclass(frozen=True, eq=False)
class Answer:
    """An estimate, what it was made from, and how long it took."""

    estimate: Estimate  # offset and pose, or why there are none
    method: Method  # that was chosen
    cleans: tuple[Clean, Clean]  # both recordings as the method saw them, on their own clocks
    rig: Rig  # as it was given, with the extrinsics where they are known
    config: Config  # with nothing left open; `interval_s` is the interval searched
    rig_name: str = "the rig"  # for messages: a file's path
    start: Start | None = None  # result of a search over all offsets, if there was one
    clock: str = ""  # kind of camera 2's clock, "fast" or "pieces", where the usual one did not fit
    misfit: str = ""  # what in the rig seems wrong, where its deviations were enlarged for it
    less_certain: Rig | None = None  # the rig with larger deviations, if they were enlarged
    distance_m: float | None = None  # between the cameras, where it was stated
    of_start: str = ""  # why the estimate is that of `method.starts_from`; empty if it is not
    seconds: dict[str, float] = field(default_factory=dict)  # by part, in the order they ran
    asked_clock: str = "auto"  # kind of clock that was asked for

    @property
    def names(self) -> tuple[str, str]:
        """Names of both cameras: their files, or else their numbers."""
        one, other = self.cleans
        return one.name or "camera 1", other.name or "camera 2"

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """Both cameras of the rig."""
        return self.rig.cam1, self.rig.cam2

    @cached_property
    def views(self) -> TwoViews:
        """Both views as recorded, paired as if both clocks ran at the same rate."""
        return views_of(*self.cleans, self.rig, self.config)

    @cached_property
    def paired(self) -> TwoViews:
        """Both views with the readouts, skew and strays found, paired at any offset."""
        return as_found(self.views, self.estimate)

    @property
    def guess(self) -> Guess | None:
        """Best guess of the search over all offsets; None without such a search or a guess."""
        return self.start.guess if self.start is not None and self.start.found.guesses else None

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings for a user of the offset beside its status, a sentence each."""
        estimate, said = self.estimate, list[str]()
        for number, camera in enumerate(self.cameras, start=1):
            pu, pv = camera.K[:2, 2]
            if camera.centre_was_exchanged:
                said.append(
                    f"camera {number}'s principal point, ({pv:g}, {pu:g}) px in the rig, lies far"
                    f" from the middle of its image of {camera.width} x {camera.height} px, and is"
                    f" taken for ({pu:g}, {pv:g}) px, which lies near it: exchange the two in the"
                    " rig; or, if they are right, state deviations (intrinsics_std, --centre-std)"
                )
            if not (0.0 <= pu <= camera.width - 1 and 0.0 <= pv <= camera.height - 1):
                said.append(
                    f"camera {number}'s principal point, ({pu:g}, {pv:g}) px, lies outside of its"
                    f" image of {camera.width} x {camera.height} px: if the image is not cropped,"
                    " the rig is of another camera or resolution, or in another order"
                )
        if not estimate.has_offset:
            return tuple(said)
        if self.clock == "pieces":
            said.append(
                "no one skew fits these tracks: a clock wanders, as those of phones do, and is"
                " followed piece by piece (--clock pieces); the offset alone holds at its time only"
            )
        if self.clock == "fast":
            said.append(
                "no skew of ordinary oscillators fits: camera 2's clock is taken to run at its own"
                f" rate, with a prior deviation of {self.config.prior_ppm:g} ppm (--skew-prior)"
            )
        if self.misfit:
            said.append(
                f"{CONTRADICTS}: {self.misfit}; its intrinsics count as less"
                " certain than it says, and the deviations are the larger for it: calibrate again"
            )
        elif self.less_certain is not None:
            said.append(
                "the rig states no deviations of its intrinsics, and slightly other ones fit as"
                " well or better: they count as less certain than a good calibration's, and the"
                " deviations are the larger for it: state theirs (--focal-std, --centre-std)"
            )
        if self.of_start:
            said.append(f"{self.of_start}: this is the answer of {self.method.starts_from}")
        if any(seen.n_followed for seen in self.cleans):
            said.append(
                "the object makes too few events for windows: it is followed through the noise, and"
                f" the path stands in place of the events (method {estimate.method})"
            )
        if estimate.without_body:
            said.append(f"this is of the outline's tangents alone: {estimate.without_body}")
        if not np.isfinite(estimate.t_d_std_s):
            said.append(
                f"{estimate.method} states no standard deviation, so nothing says how far off this"
                " offset is: compare it with that of a method that states one, such as joint"
            )
            return tuple(said)
        unread = [
            seen.has_track
            and not seen.n_followed
            and camera.readout_s is None
            and not camera.readout_std_s
            for camera, seen in zip(self.cameras, self.cleans, strict=True)
        ]
        if any(unread):
            of = "" if all(unread) else f" of camera {1 + unread.index(True)}"
            said.append(
                f"{NO_READOUT}{of}, so shutters are taken for global ones; rolling ones shift the"
                " offset by up to their readout, beyond its deviation: state it in the rig, or, of"
                " two cameras, estimate it with --estimate-readout"
            )
        return tuple(said)

    @property
    def note(self) -> str:
        """All of `notes` in one line; empty where there is nothing."""
        return "; ".join(self.notes)

    @property
    def of_skew(self) -> str:
        """How the skew compares with its prior; empty where that is nothing unusual."""
        if self.guess is not None and self.guess.rate != 1.0:  # found without the prior
            return ""
        prior_ppm, std_ppm = self.config.prior_ppm, self.estimate.skew_std_ppm
        if abs(self.estimate.skew_ppm) > 3.0 * prior_ppm:
            return f"far beyond the {prior_ppm:g} ppm expected of such clocks: see --skew-prior"
        if 2.0 * std_ppm**2 > prior_ppm**2 > 0.0:
            return f"rather taken to be within {prior_ppm:g} ppm than found: see --skew-prior"
        return ""

    @property
    def sees_several(self) -> bool:
        """Whether a camera sees more than one object at a time."""
        return any(one.used.seen > 1 for one in self.cleans)

    @property
    def looks_at_one_object(self) -> bool:
        """Whether one object was chosen for the method from those that the cameras saw."""
        return self.method.of_one_object and self.config.choose_object

    def because(self, more: str) -> "Answer":
        """Return the answer with `more` added to the reason of its refusal."""
        reason = f"{self.estimate.reason}; {more}"
        return replace(self, estimate=replace(self.estimate, reason=reason))


class Stopwatch:
    """Measures the time of each part of a run, and logs the lines that the part reports."""

    def __init__(self, log: Log = quiet) -> None:
        self.seconds: dict[str, float] = {}
        self.log = log

    @contextmanager
    def part(self, name: str) -> Iterator[Log]:
        """Time a part; yield a function that takes its lines of progress. Repeated parts add up."""
        lines: list[str] = []
        start_s = time.perf_counter()
        yield lines.append
        took_s = time.perf_counter() - start_s
        self.seconds[name] = self.seconds.get(name, 0.0) + took_s
        if lines:
            head = f"{name:9}{took_s:6.2f} s  "
            width = columns(sys.stderr) - len(head)
            parts = [part for line in lines for part in folded(line, width)]
            self.log(head + ("\n" + " " * len(head)).join(parts))


def held_words(seen: Observation, name: str) -> str:
    """Say in a line what a camera recorded."""
    events, (start_s, end_s) = f"{len(seen.events)} events", seen.span_s
    held = events if seen.track is None else f"{len(seen.track)} points"
    return f"{name}: {held} from {start_s:.3f} to {end_s:.3f} s"


def objects_seen(cleans: tuple[Clean, ...], refusal: Refusal | None) -> str:
    """Say how many objects the cameras saw, and what share of the events is used."""
    if refusal is not None:
        return "several, and none told from the others"
    if all(one.used.seen == 1 for one in cleans):
        return "one at a time"
    seen = " and ".join(str(one.used.seen) for one in cleans)
    shares = " and ".join(f"{100.0 * one.used.share:.0f} %" for one in cleans)
    return f"{seen} at a time; {shares} of the events are of one that all cameras see"


def in_fifths(log: Log) -> Callable[[float], None]:
    """Return a function that logs the progress of a long search, a line for each fifth."""
    start_s, logged = time.perf_counter(), [0.0]

    def report(share: float) -> None:
        if share >= logged[0] + 0.2 and time.perf_counter() - start_s > 2.0:
            logged[0] = share
            log(f"search   {100.0 * share:4.0f} %")

    return report
