"""A pair of 20 s in; how long `ssac sync` takes for it, by method and by stage, out."""

import tempfile
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_limits

from experiments.bench.measurement import Measurement, best_seconds
from sim.recording import SimConfig
from sim.storage import record
from ssac.config import Config
from ssac.errors import SsacError
from ssac.fit.problem import Parameters
from ssac.methods.algorithms import algorithm_2
from ssac.methods.joint import joint_from
from ssac.methods.tangency import refine_tangents
from ssac.methods.tangent_pairs import TangencyConfig, tangent_times, tangents_under
from ssac.search.two_views import two_views
from ssac.tool.load import Paths, load_pair
from ssac.tool.registry import OURS, Method, choose_method
from ssac.track.observation import Observation, usable_events

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
        paths = folder / "cam1.h5", folder / "cam2.h5", folder / "rig_extrinsics.yaml"
        with threadpool_limits(1):  # threads of BLAS that wait for work would count as well
            return _stages(paths) + [_whole(method, paths) for method in OURS]


def _stages(paths: Paths) -> list[Measurement]:
    config, outline = Config(), TangencyConfig()
    seconds: dict[str, float] = {}
    read = partial(load_pair, paths, choose_method("tangency", known_extrinsics=False))
    seconds["reading"], (cam1, cam2, rig) = best_seconds(read, REPEATS)
    filtered = partial(usable_events, cam1, cam2, rig, config)
    seconds["checks and denoising"], events = best_seconds(filtered, REPEATS)
    left = [Observation(one, denoised=True) for one in events]
    tracks = partial(two_views, left[0], left[1], rig, config)
    seconds["tracks"], views = best_seconds(tracks, REPEATS)
    search = partial(algorithm_2, views)
    seconds["search over +-1 s"], found = best_seconds(search, REPEATS)
    seconds["joint refinement"], start = best_seconds(partial(joint_from, found, views), REPEATS)
    R, t = start.R, start.t
    if R is None or t is None:
        raise SsacError(f"joint found no pose in the benchmark's pair: {start.reason}")
    parameters = Parameters(start.t_d_s, R, t)
    times_s = tangent_times(views, start.t_d_s, outline)
    under = partial(tangents_under, parameters, views, times_s, outline)
    seconds["outlines and tangents"], (_, near) = best_seconds(under, REPEATS)
    seconds["tangents alone"], _ = best_seconds(partial(under, near), REPEATS)
    refinement = partial(refine_tangents, start, views)
    seconds["tangency refinement"], _ = best_seconds(refinement, REPEATS)
    n_events = (len(cam1.events) + len(cam2.events)) / 2
    return [
        Measurement("sync: events per camera", n_events, "events"),
        *(Measurement(f"sync, stage: {stage}", value, "s") for stage, value in seconds.items()),
    ]


def _whole(method: Method, paths: Paths) -> Measurement:
    """Time a method on what was read."""
    cam1, cam2, rig = load_pair(paths, method)
    work = partial(method.estimate, cam1, cam2, method.rig_of(rig), Config())
    in_all, _ = best_seconds(work, REPEATS)
    return Measurement(
        f"sync, {method.name}: all but reading", in_all, "s", MARKS_S.get(method.name)
    )
