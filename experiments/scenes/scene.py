"""Statistics of a simulated recording as the method sees it, beside the authors' public sample."""

from typing import Annotated

import numpy as np
import pandas as pd
import typer

from experiments.lab.recorded import observations, rig_of
from experiments.lab.summary import markdown_table
from experiments.scenes.options import MAX_SEED
from sim.recorded import Recording
from sim.recording import SimConfig, simulate
from sim.scene.flyers import DRONES
from sim.sensor.frames import FrameConfig
from ssac.arrays import Array, Events
from ssac.camera import known_pose
from ssac.cli.options import named, number
from ssac.config import Config
from ssac.errors import SsacError
from ssac.geometry.epipolar import epipolar_distance, fundamental_from_pose
from ssac.pipeline.chain import Chain

SLOPE_STEP_S = 0.010  # d_avg's slope is measured from 10 ms on each side of the truth
_WIDTH_QUANTILES = (0.01, 0.99)  # of the events' x in a window: its width without outliers

SHOWN = (
    ("median image speed [px/s]", "198", "{speed_px_s:.0f}"),
    ("sample times valid in both views", "348 of 400", "{n_valid:.0f} of {n_samples:.0f}"),
    ("mean distance, true F [px]", "0.41", "{mean_distance_px:.2f}"),
    ("median distance, true F [px]", "0.20", "{median_distance_px:.2f}"),
    ("slope of d_avg [px per 10 ms]", "1.3", "{slope_px:.2f}"),
    ("width in the event image [px]", "20-45", "{narrow_px:.0f}-{wide_px:.0f}"),
    ("events per camera", "", "{n_events:.0f}"),
)
"""For each quantity: name, value in the authors' sample, and format of `scene_figures`."""


def scene_figures(recording: Recording) -> dict[str, float]:
    """Return the statistics of SHOWN, at the true clock and with the true fundamental matrix F.

    The speed is the median over both cameras, and the slope the rise of d_avg 10 ms off the true
    offset; the widths are the 5th and the 95th percentile over the valid sample times, and the
    events the mean per camera. SsacError if nothing is seen.
    """
    config, rig, t_d_s = Config(), rig_of(recording), recording.truth.t_d_s
    chain = Chain(observations(recording), rig, config)
    views = chain.views()
    F = fundamental_from_pose(rig.cam1.K, rig.cam2.K, *known_pose(rig))
    seen, offsets_s = [chain.clean(k).events for k in range(2)], [-SLOPE_STEP_S, 0.0, SLOPE_STEP_S]
    pairs = views.pairs(t_d_s + np.array(offsets_s)) if all(map(len, seen)) else None
    if pairs is None or not pairs.valid.any(axis=1).all():
        raise SsacError(
            "no figures: at no sample time do both cameras see the drone well enough: fly longer, "
            "nearer or by a larger drone"
        )
    distances = [epipolar_distance(F, *pairs.valid_positions(m)) for m in range(3)]
    before, mean, after = (np.mean(of_offset) for of_offset in distances)
    times_s = pairs.times_s[1][pairs.valid[1]]
    velocities, widths = [], []
    shown_s = times_s, views.on_clock_2(times_s, t_d_s)
    for k, (motion, at_s) in enumerate(zip(views.motions, shown_s, strict=True)):
        velocities.append(motion.velocities_at(at_s))
        widths += _widths_px(seen[k], at_s, config.half_window_s)
    return {
        "speed_px_s": float(np.nanmedian(np.linalg.norm(velocities, axis=-1))),
        "n_valid": float(np.count_nonzero(pairs.valid[1])),
        "n_samples": config.n_samples,
        "mean_distance_px": float(mean),
        "median_distance_px": float(np.median(distances[1])),
        "slope_px": float((before + after) / 2 - mean),
        "narrow_px": float(np.percentile(widths, 5)),
        "wide_px": float(np.percentile(widths, 95)),
        "n_events": float(np.mean([len(camera.events) for camera in recording.cameras])),
    }


def scene_command(
    seeds: Annotated[int, number("Flights to average over.", 1, 1000, metavar="COUNT")] = 10,
    first_seed: Annotated[int, number("Seed of the first flight.", 0, MAX_SEED)] = 0,
    drone: Annotated[str, named("NAME", f"Drone: {', '.join(DRONES)}.")] = SimConfig.drone,
) -> None:
    """Print how the default scene looks to the method, beside the authors' public sample."""
    # The sample's angle and duration.
    config = SimConfig(drone=drone, frames=FrameConfig(rate_hz=0.0))
    rows = []
    for flight in range(seeds):
        typer.echo(f"flight {flight + 1} of {seeds}", err=True)
        rows.append(scene_figures(simulate(config, first_seed + flight)))
    means = pd.DataFrame(rows).mean()
    shown = [(name, theirs, ours.format(**means)) for name, theirs, ours in SHOWN]
    texts = pd.DataFrame(shown, columns=["quantity", "authors' sample", "ours"])
    typer.echo(markdown_table(texts))


def _widths_px(events: Events, times_s: Array, half_window_s: float) -> list[float]:
    """Return the width [px] of the event image around each time on the camera's clock."""
    t_us, x = events["t"], events["x"]
    first = np.searchsorted(t_us, (times_s - half_window_s) * 1e6)
    last = np.searchsorted(t_us, (times_s + half_window_s) * 1e6)
    ends = [np.quantile(x[a:b], _WIDTH_QUANTILES) for a, b in zip(first, last, strict=True)]
    return [float(high - low + 1.0) for low, high in ends]
