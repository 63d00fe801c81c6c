"""One call from recordings to clocks and poses, for scripts, notebooks and the command line."""

import difflib
import inspect
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from ssac.arrays import Events
from ssac.camera import to_be_read_out, with_deviations
from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.files.damage import STRICT, Reading
from ssac.files.whole_file import write_whole
from ssac.methods.method import OF_TRACKS, Method
from ssac.methods.verdict import quantum_s
from ssac.pipeline import opened as border
from ssac.pipeline.answer import Answer, Log, quiet
from ssac.pipeline.chain import Chain
from ssac.pipeline.opened import NOTHING, CameraInput, Known, RigInput, kind_of
from ssac.pipeline.registry import OURS, EstimateFunction, choose_method
from ssac.pipeline.report import html_of, report_json, report_rows, text_of
from ssac.rules import is_number
from ssac.search.two_views import TwoViews
from ssac.track.clean import Clean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ssac.pipeline.many import NetworkResult


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The result for two cameras, with all attributes of its `Estimate`.

    `print(result.summary())` prints it as text, a notebook shows it as a table, and
    `result.answer` holds what the estimate was made from.
    """

    answer: Answer  # the estimate and what it was made from

    @property
    def estimate(self) -> Estimate:
        """Offset and pose, and how far they are to be relied upon."""
        return self.answer.estimate

    @property
    def note(self) -> str:
        """Warnings for the user beside the status; empty if there are none."""
        return self.answer.note

    def summary(self) -> str:
        """Return the result as text for people, as `ssac sync` prints it."""
        return text_of(report_rows(self.answer))

    def to_dict(self) -> dict[str, Any]:
        """Return the result as a dictionary, as `ssac sync --json` writes it."""
        return report_json(self.answer)

    def plot(self, path: Path | str | None = None) -> "Figure | None":
        """Draw the figures that the estimate allows, one below the other; None if it allows none.

        With a path, write them too: to a file (.png, .pdf, .svg), or to a folder as one PNG each.
        """
        from ssac.pipeline.plots import page_of

        if path is not None:
            self.plotted(Path(path))
        return page_of(self.answer)

    def plotted(self, path: Path) -> list[Path]:
        """Write the figures of `plot` to a file or a folder, and return the paths written."""
        from ssac.pipeline.plots import save_figures

        return save_figures(path, self.answer)

    def report(self, path: Path | str, command: str = "") -> Path:
        """Write all that is known as an HTML page that needs no other file; return its path.

        The page shows `command`, the command line that led to the result, unless it is empty.
        """
        from ssac.pipeline.html_report import report_page

        page = report_page({(0, 1): self.answer}, None, report_rows(self.answer), command)
        write_whole(Path(path), page)
        return Path(path)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "answer":
            raise AttributeError(name)
        return getattr(self.answer.estimate, name)

    def __dir__(self) -> list[str]:
        names = (name for name in dir(self.answer.estimate) if not name.startswith("_"))
        return sorted({*super().__dir__(), *names})

    def __repr__(self) -> str:
        one, offset = self.estimate, ""
        if one.has_offset:
            offset = f", t_d {1e3 * one.t_d_s:.3f} ms"
        if one.has_offset and np.isfinite(one.t_d_std_s):
            offset += f", 1 sigma {1e3 * one.t_d_std_s:.3f} ms"
        return f"<ssac.Result {one.method} {one.status}{offset}>"

    def _repr_html_(self) -> str:
        return html_of(report_rows(self.answer))


@overload
def sync(cam1: Sequence[CameraInput], cam2: RigInput, **options: Any) -> "NetworkResult": ...


@overload
def sync(
    cam1: CameraInput,
    cam2: CameraInput,
    rig: RigInput,
    method: str | None = None,
    config: Config | None = None,
    **options: Any,
) -> Result: ...


def sync(
    cam1: Any,
    cam2: Any = None,
    rig: Any = None,
    method: str | None = None,
    config: Config | None = None,
    *,
    known_extrinsics: bool = False,
    cameras: tuple[int, int] = (1, 2),
    focal_std: float | None = None,
    centre_std_px: float | None = None,
    estimate_readout: bool = False,
    reading: Reading = STRICT,
    known: Known = NOTHING,
    log: Log = quiet,
    **fields: Any,
) -> "Result | NetworkResult":
    """Find the offset between cameras' clocks, and their poses, from one moving object.

    Parameters
    ----------
    cam1, cam2
        What each camera recorded: a file of events or of a track, a structured array of events
        with the fields t [us], x, y and p, an `Observation`, or what `load_events` or `load_track`
        returned. For more than two cameras, give a list of them in place of both, as in
        `sync([a, b, c], rig)`.
    rig
        A rig file (Kalibr's or OpenCV's), a `Rig`, `Cameras`, or a list of one `Camera` each.
    method
        Name of a method; None for the best one that the recordings allow.
    config
        Parameters; the defaults when None. Its fields may be given by name instead:
        `sync(..., search="all")`.
    known_extrinsics
        Take the extrinsics of the rig, and find the offset only.
    cameras
        Numbers of the two cameras in a rig file, counted from 1.
    focal_std, centre_std_px
        Standard deviations of all cameras' focal lengths, as a share of them, and of both
        coordinates of their principal points [px]. None keeps those of the rig.
    estimate_readout
        Estimate the rolling-shutter readout of cameras with a track, where the rig states none.
    reading
        How to treat event files that are damaged or unsorted.
    known
        What is known of the scale and the frame; for two cameras only their distance.
    log
        Called with a line of progress after each part.

    Returns
    -------
    Result or NetworkResult
        The result for two cameras, or for more. The `status` and `reason` of each estimate say
        when and why it is not reliable.

    Raises
    ------
    SsacError
        If an input cannot be used; the message says what was given and what to do.
    """
    seen: Sequence[Any] = (cam1, cam2)
    if isinstance(cam1, (list, tuple)):
        if cam2 is not None and rig is not None:
            raise SsacError(
                "sync: a list of cameras stands for all of them, and beside it stands their rig"
                ' alone: call sync([a, b, c], rig, method="joint", ...)'
            )
        seen, rig = cam1, cam2 if rig is None else rig
    if len(seen) < 2:
        raise SsacError(f"sync: expected two cameras or more, got a list of {len(seen)}")
    of_two = len(seen) == 2
    for name, value in (("focal_std", focal_std), ("centre_std_px", centre_std_px)):
        if value is not None and not (is_number(value) and 0.0 <= value < np.inf):
            raise SsacError(f"{name}: expected a deviation of 0 or more, got {value!r}")
    for name, given, kind in (("reading", reading, Reading), ("known", known, Known)):
        if not isinstance(given, kind):
            raise SsacError(f"{name}: expected a ssac.{kind.__name__}, got {given!r}")
    if not callable(log):
        raise SsacError(f"log: expected a function of a line of text, such as print, got {log!r}")
    if of_two and known != Known(known.distance_m):
        raise SsacError(
            "known: positions and RTK are for more than two cameras, and two were given: give"
            " distance_m, or leave it out"
        )
    of_two_alone = {
        "cameras": cameras != (1, 2),
        "known_extrinsics": known_extrinsics,
        "estimate_readout": estimate_readout,
    }
    for name, is_given in of_two_alone.items():
        if is_given and not of_two:
            raise SsacError(f"{name}: is for two cameras, and more were given: leave it out")
    numbers = cameras if of_two else None
    models = border.opened_rig(rig, len(seen), numbers)
    sources = border.opened(seen, models, numbers, reading)
    has_track = any(one.has_track for one in sources)
    chosen = choose_method(method, known_extrinsics, has_track)
    if not of_two and (chosen.needs_extrinsics or chosen.finds_offset_alone):
        does = "holds the rig's pose" if chosen.needs_extrinsics else "finds the offset alone"
        usual = next((one.name for one in OURS if one.known_variant == chosen.name), OF_TRACKS)
        raise SsacError(
            f"{chosen.name}: {does}, and of more than two cameras poses are to be found: use"
            f" another method, such as {usual}"
        )
    if estimate_readout and not has_track:
        raise SsacError(
            "--estimate-readout: expected a track of a frame camera, got events only, which no "
            "shutter reads out: leave it out"
        )
    if chosen.needs_extrinsics and known.distance_m is not None:
        border.check_distance(known.distance_m, models)
    stated = [with_deviations(one, focal_std, centre_std_px) for one in models.cameras]
    for k, source in enumerate(sources):
        if estimate_readout and source.has_track:
            stated[k] = to_be_read_out(stated[k])
    models = replace(models, cameras=tuple(stated))
    chain = Chain(sources, models, _config_of(config, fields), log)
    found: Result | NetworkResult
    if of_two:
        found = Result(replace(chain.answer(chosen), distance_m=known.distance_m))
        cleans: tuple[Clean, ...] = found.answer.cleans
    else:
        from ssac.pipeline.many import network

        found = network(chain, None if method is None else chosen, known)
        cleans = tuple(chain.clean(k) for k in range(len(chain)))
    for k, clean in enumerate(cleans):
        step_s = quantum_s(clean)
        if step_s:
            warnings.warn(
                f"{chain.name(k)}: all times are whole {1e3 * step_s:g} ms: whoever wrote it"
                " rounded them, and by so much the offset may be off; its deviation is widened",
                stacklevel=2,
            )
    return found


def _config_of(config: Config | None, fields: dict[str, Any]) -> Config:
    config = Config() if config is None else config
    if not isinstance(config, Config):
        raise SsacError(f"config: expected a ssac.Config, got {kind_of(config)}")
    known = Config.__dataclass_fields__
    arguments = list(inspect.signature(sync).parameters)[3:-1]  # not the recordings and their rig
    for name in fields:
        if name not in known:
            near = difflib.get_close_matches(name, [*known, *arguments], 3)
            like = f": did you mean {' or '.join(near)}?" if near else ""
            raise SsacError(f"{name}: is no argument of sync and no field of ssac.Config{like}")
    return replace(config, **fields)


def two_views(
    cam1: CameraInput, cam2: CameraInput, rig: RigInput, config: Config | None = None
) -> TwoViews:
    """Return the object's motion in both views (the paper's Sec. IV-A), together with the rig."""
    return Chain((cam1, cam2), rig, config).views()


def usable_events(
    cam1: CameraInput, cam2: CameraInput, rig: RigInput, config: Config | None = None
) -> tuple[Events, Events]:
    """Give both cameras' events, checked, and denoised (Sec. IV-A) if the config asks for it.

    SsacError if the events of a camera are empty, unsorted or outside its sensor.
    """
    chain = Chain((cam1, cam2), rig, config)
    return chain.clean(0).events, chain.clean(1).events


def function_of(method: Method) -> EstimateFunction:
    """Make the function of one method: `ssac.tangency(cam1, cam2, rig, config)`."""

    def estimate(
        cam1: CameraInput, cam2: CameraInput, rig: RigInput, config: Config | None = None
    ) -> Estimate:
        return Chain((cam1, cam2), rig, config).estimate(method)

    estimate.__name__ = estimate.__qualname__ = method.name.replace("-", "_")
    estimate.__doc__ = f"""Estimate as `sync(..., method="{method.name}")` does: {method.summary}.

    Cameras and rig are as for `sync`, the extrinsics among it where the method needs them.
    """
    return estimate
