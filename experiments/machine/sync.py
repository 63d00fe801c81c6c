"""How long `ssac sync` takes for a pair of 20 s, by method and by stage."""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_limits

from experiments.machine.measurement import Measurement, best_seconds
from sim.recording import SimConfig
from sim.storage import record
from ssac.camera import Cameras
from ssac.config import Config
from ssac.errors import SsacError
from ssac.fit.least_squares import Parameters
from ssac.methods.algorithms import algorithm_2
from ssac.methods.joint import joint_from
from ssac.methods.tangency import refine_tangents, tangent_times, tangents_under
from ssac.pipeline.chain import MEANS, Chain, Source
from ssac.pipeline.opened import opened, opened_rig
from ssac.pipeline.registry import OURS, Input, Method
from ssac.search.two_views import TwoViews, views_of
from ssac.track.clean import Clean, clean
from ssac.track.observation import Observation

REPEATS = 5  # the best of as many is taken

MARKS_S = {"joint": 0.2, "tangency": 0.35}
"""Of all but reading, for 1.1 million events a camera."""


def bench_sync(config: SimConfig | None = None) -> list[Measurement]:
    """Processor time of `ssac sync` on files of one pair, on one core: by default, of 20 s.

    Stages are those of `tangency`, in their order. The outlines are the events near both tangents,
    found among all of them; tangents alone are found in these. The refinement does both, each some
    times, and solves for offset and pose. Methods take events in memory, noise and all.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "pair"
        record(config or SimConfig(t_d_s=0.05), 0, folder, {})
        rig = opened_rig(folder / "rig_extrinsics.yaml", 2)
        files = opened((folder / "cam1.h5", folder / "cam2.h5"), rig)
        with threadpool_limits(1):  # threads of BLAS that wait for work would count as well
            return _stages(files, rig) + [_whole(method, files, rig) for method in OURS]


def _stages(files: Sequence[Source], rig: Cameras) -> list[Measurement]:
    config = Config()
    seconds: dict[str, float] = {}
    read = partial(_read, files)
    seconds["reading"], (cam1, cam2) = best_seconds(read, REPEATS)
    filtered = partial(_cleaned, (cam1, cam2), rig)
    seconds["checks and denoising"], left = best_seconds(filtered, REPEATS)
    tracks = partial(_viewed, left, rig, config)
    seconds["tracks"], views = best_seconds(tracks, REPEATS)
    search = partial(algorithm_2, views)
    seconds["search over +-1 s"], found = best_seconds(search, REPEATS)
    seconds["joint refinement"], start = best_seconds(partial(joint_from, found, views), REPEATS)
    R, t = start.R, start.t
    if R is None or t is None:
        raise SsacError(f"joint found no pose in the benchmark's pair: {start.reason}")
    parameters = Parameters(start.t_d_s, R, t)
    times_s = tangent_times(views, start.t_d_s)
    under = partial(tangents_under, parameters, views, times_s)
    seconds["outlines and tangents"], (_, near) = best_seconds(under, REPEATS)
    seconds["tangents alone"], _ = best_seconds(partial(under, near), REPEATS)
    refinement = partial(refine_tangents, start, views)
    seconds["tangency refinement"], _ = best_seconds(refinement, REPEATS)
    n_events = (len(cam1.events) + len(cam2.events)) / 2
    return [
        Measurement("sync: events per camera", n_events, "events"),
        *(Measurement(f"sync, stage: {stage}", value, "s") for stage, value in seconds.items()),
    ]


def _read(files: Sequence[Source], frames: str = "") -> list[Observation]:
    return [file.read(frames) for file in files]


def _cleaned(seen: Sequence[Observation], rig: Cameras) -> list[Clean]:
    how = Config().cleaning
    return [clean(one, camera, how) for one, camera in zip(seen, rig.cameras, strict=True)]


def _viewed(left: Sequence[Clean], rig: Cameras, config: Config) -> TwoViews:
    """Sum up both views, of events of which nothing was summed up before."""
    one, other = (replace(camera) for camera in left)
    return views_of(one, other, rig.pair(0, 1), config)


def _whole(method: Method, files: Sequence[Source], rig: Cameras) -> Measurement:
    """Time a method on what was read."""
    seen = _read(files, MEANS if method.input is Input.FRAMES else "")
    in_all, _ = best_seconds(lambda: Chain(seen, rig).estimate(method), REPEATS)
    return Measurement(
        f"sync, {method.name}: all but reading", in_all, "s", MARKS_S.get(method.name)
    )
