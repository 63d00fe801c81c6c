"""Ordinary and odd recordings: the default of `ssac sync` beside settings by hand.

A user should not need a setting that the default could have found out. Of each recording the
default is judged; where it is not right, eight settings are tried that a user would try.

    ssac by-hand --first 5650                           # what is committed; kinds take turns
    ssac by-hand --base 1 --recordings 72 --out out     # numbers 0 to 71 of another base
    ssac by-hand --base 1 --first 17 --recordings 1 --every --out out

Each recording is drawn from a base seed and its number alone, so any range of numbers may be looked
at, and another one kept for the end. What spoils it is added when it is loaded, as in
`worlds.spoilt`; of clocks only the offset is in the configuration.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
from scipy.special import chdtr

from experiments.drawing.style import FILLS, Figure, panels
from experiments.lab.cache import Cache
from experiments.lab.cell import FlightCell, Measure
from experiments.lab.command import command_of
from experiments.lab.grid import flight_seed
from experiments.lab.recorded import Flown, Pair, recorded_pair
from experiments.lab.score import Truth
from experiments.lab.study import Runs, Study
from experiments.lab.summary import made_of, quoted
from experiments.scenes.options import MAX_SEED
from experiments.studies.coverage import QUANTITIES
from experiments.studies.imperfect import ImperfectRow, counted, given_columns, held
from experiments.worlds.spoilt import GOOD, RIGHT, T_D_S, Errors, Kind, spoilt_pair
from sim.disturb import DisturbConfig, second_seed
from sim.effects.config import SENSOR_PRESETS
from sim.recording import SimConfig
from sim.scene.rig import DISTANCE_M, FOCAL_PX, PRINCIPAL_POINT
from sim.scene.trajectory import SplineConfig
from sim.sensor.frames import FrameConfig
from ssac.arrays import Array, Mask
from ssac.camera import Rig, known_pose, with_deviations
from ssac.cli.options import flag, number
from ssac.config import Config
from ssac.errors import SsacError
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import DEFAULT

Rng = np.random.Generator

UNASKED = "default"
SHORT_S = 6.0
WRONG_RIG = "wrong rig"
IDEAL, NOISY = "ideal", ("davis346", "evk4", "davis346-dim", "v2e-noisy")


@dataclass(frozen=True)
class Draw:
    """What the recordings of a kind are drawn from: uniformly, or so in the logarithm."""

    duration_s: tuple[float, float] = (6.0, 60.0)  # log
    distance_m: tuple[float, float] = (2.0, 40.0)  # log
    size_px: tuple[float, float] = (6.0, 120.0)  # log; in the middle of the flight
    focal_px: float = FOCAL_PX
    sensors: tuple[str, ...] = (IDEAL, IDEAL, *NOISY[:2])
    far: float = 0.5  # share of clocks up to an hour apart; the others are within 1 s
    skew_ppm: tuple[float, float] | None = None  # log, either way; None: normal, as of oscillators


KINDS: Mapping[str, Draw] = {
    "plain": Draw(duration_s=(3.0, 60.0)),
    "short": Draw(duration_s=(3.0, SHORT_S)),
    "far clocks": Draw(duration_s=(6.0, 30.0), far=1.0),
    "fast clocks": Draw(skew_ppm=(200.0, 3000.0)),
    "faint": Draw(distance_m=(10.0, 100.0), size_px=(2.5, 7.0), sensors=(IDEAL, NOISY[0])),
    "clutter": Draw(duration_s=(6.0, 30.0), sensors=NOISY),
    "two objects": Draw(duration_s=(6.0, 30.0), size_px=(6.0, 60.0)),
    WRONG_RIG: Draw(duration_s=(6.0, 30.0)),
    "wide": Draw(distance_m=(2.0, 6.0), size_px=(6.0, 60.0), focal_px=90.0),
}
"""Recording k is of the k-th kind, in turns."""

SKEW_STD_PPM = 20.0
MAX_M_S, _PLAIN_M_S = 15.0, 5.0
"""Median speed of the fastest flights, and of `SplineConfig`'s."""

CALIBRATIONS = (GOOD, GOOD, (0.3, 1.0), (1.0, 3.0))
"""Deviations of focal lengths [%] and centres [px] that rigs are drawn from and state."""


@dataclass(frozen=True)
class HandCell(FlightCell):
    """A setting on one recording."""

    base: int
    kind: str
    sensor: str
    size_px: float
    spoilt: Kind
    spoilt_by: str  # in words
    setting: str = UNASKED  # of SETTINGS
    every: bool = False  # even where the default is right

    @property
    def columns(self) -> dict[str, Any]:
        """Which run it is, and all that was drawn."""
        sim, (percent, _) = self.sim, self.spoilt.disturb.intrinsics_error
        return {
            "base": self.base, "kind": self.kind, **self.flown, "distance_m": sim.distance_m,
            "size_px": self.size_px, "focal_px": sim.focal_px, "sensor": self.sensor,
            "slowness": round(SplineConfig().sampling_hz / sim.spline.sampling_hz, 2),
            "t_d_s": sim.t_d_s, "skew_ppm": self.spoilt.skew_ppm, "focal_std_percent": percent,
            "spoilt_by": self.spoilt_by, "setting": self.setting,
        }  # fmt: skip


def drawn(base: int, flight: int) -> HandCell:
    """Draw a recording by its number."""
    rng = np.random.default_rng((base, flight))
    kind = list(KINDS)[flight % len(KINDS)]
    draw = KINDS[kind]
    duration_s = round(_log_uniform(rng, *draw.duration_s), 1)
    angle_deg = round(rng.uniform(20.0, 160.0), 1)
    distance_m = round(_log_uniform(rng, *draw.distance_m), 1)
    size_px = round(_log_uniform(rng, *draw.size_px), 1)
    sensor = str(rng.choice(draw.sensors))
    near_s, far_s = rng.uniform(-1.0, 1.0), _log_uniform(rng, 1.0, 3600.0) * rng.choice((-1, 1))
    is_far = rng.random() < draw.far
    sim = SimConfig(
        angle_deg=angle_deg,
        t_d_s=round(float(far_s if is_far else near_s), 6),
        spline=_spline(rng, duration_s, distance_m, size_px),
        drone_size_m=round(size_px * distance_m / draw.focal_px, 3),
        distance_m=distance_m,
        focal_px=draw.focal_px,
        frames=FrameConfig(rate_hz=0.0),
    )
    if sensor != IDEAL:
        preset = SENSOR_PRESETS[sensor]
        sim = replace(sim, sensor=preset.sensor, effects=preset.effects)
    skew_ppm = SKEW_STD_PPM * rng.standard_normal()
    if draw.skew_ppm is not None:
        skew_ppm = _log_uniform(rng, *draw.skew_ppm) * rng.choice((-1.0, 1.0))
    calibration = CALIBRATIONS[rng.integers(len(CALIBRATIONS))]
    spoilt = Kind("", DisturbConfig(intrinsics_error=calibration), skew_ppm=round(skew_ppm, 1))
    spoilt, words = _SPOILS[kind](spoilt, rng, duration_s) if kind in _SPOILS else (spoilt, "")
    seed = flight_seed(duration_s, angle_deg, flight, base)
    return HandCell(sim, flight, seed, base, kind, sensor, size_px, spoilt, words)


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _spline(rng: Rng, duration_s: float, distance_m: float, size_px: float) -> SplineConfig:
    """Fill the view with the flight, less so for large objects, slower if long or fast."""
    plain, slowest = SplineConfig(), float(np.clip(duration_s / 8.0, 1.0, 2.5))
    slowness = _log_uniform(rng, 1.0, slowest)
    spread = distance_m / DISTANCE_M * rng.uniform(0.6, 1.0) * (1.0 - size_px / 240.0)
    too_fast = max(1.0, _PLAIN_M_S * spread / slowness / MAX_M_S)
    slowness, spread = round(slowness * too_fast**0.5, 2), spread / too_fast**0.5
    x, y, z = (round(spread * one, 3) for one in plain.multiplier_xyz_m)
    return replace(
        plain, duration_s=duration_s, sampling_hz=plain.sampling_hz / slowness,
        smoothing=plain.smoothing * slowness**3, multiplier_xyz_m=(x, y, z),
        max_radius_m=spread * plain.max_radius_m,
    )  # fmt: skip


def _cluttered(kind: Kind, rng: Rng, duration_s: float) -> tuple[Kind, str]:
    what = rng.integers(3)
    people = int(rng.integers(1, 4)) if what != 1 else 0
    branches = round(rng.uniform(5e3, 25e3) * duration_s) if what != 0 else 0
    disturb = replace(kind.disturb, people=people, branches=branches)
    return replace(kind, disturb=disturb), f"people {people} branches {branches}"


def _two_objects(kind: Kind, rng: Rng, duration_s: float) -> tuple[Kind, str]:
    share = round(rng.uniform(0.3, 1.0), 2)
    return replace(kind, disturb=replace(kind.disturb, second_object=share)), f"second {share}"


def _wrong_rig(kind: Kind, rng: Rng, duration_s: float) -> tuple[Kind, str]:
    """Spoil one thing, of which the rig states nothing."""
    index, sign = int(rng.integers(2)), rng.choice((-1.0, 1.0))
    focal, pu_px = round(sign * rng.uniform(0.0, 0.3), 3), round(sign * rng.uniform(5.0, 40.0), 1)
    both = round(sign * rng.uniform(0.0, 0.02), 4)
    swap_px = PRINCIPAL_POINT[1] - PRINCIPAL_POINT[0]
    errors, words = [
        (_one(index, (focal, focal, 0.0, 0.0)), f"focal length {index + 1} {100 * focal:+.1f} %"),
        (_one(index, (0.0, 0.0, swap_px, -swap_px)), f"principal point {index + 1} swapped"),
        (_one(index, (0.0, 0.0, pu_px, 0.0)), f"principal point {index + 1} {pu_px:+.1f} px"),
        (((both, both, 0.0, 0.0),) * 2, f"focal lengths {100 * both:+.1f} %"),
    ][int(rng.choice(4, p=(0.4, 0.2, 0.2, 0.2)))]
    disturb = replace(kind.disturb, intrinsics_error=(0.0, 0.0))
    return replace(kind, disturb=disturb, errors=errors, stated=GOOD), words


def _one(index: int, errors: Errors) -> tuple[Errors, Errors]:
    return (RIGHT, errors) if index else (errors, RIGHT)


_SPOILS: Mapping[str, Callable[[Kind, Rng, float], tuple[Kind, str]]] = {
    "clutter": _cluttered, "two objects": _two_objects, WRONG_RIG: _wrong_rig,
}  # fmt: skip


# --- What is said of them ---

BASE, FIRST, N_RECORDINGS = 300, 5650, 600
"""No choice was made on these; the next start at 6250.

On those before, and bases 1 to 5, 100, 101 and 200, some were made.
"""

SPARED = "spared"  # status of a setting that was not tried, as the default is right

MAX_SIGMAS, MAX_ERROR_MS, MAX_ERROR_DEG = 4.0, 10.0, 3.0
"""An estimate is right if its offset is within both bounds of it, and its pose within one."""

HELD = {name: QUANTITIES[name] for name in ("t_d", "R", "t")}


@dataclass(frozen=True)
class Setting:
    """What a user types behind the files."""

    config: Config = field(default_factory=Config)
    method: str = DEFAULT
    deviations: tuple[float | None, float | None] = (None, None)  # focal lengths, centres [px]


SETTINGS: Mapping[str, Setting] = {
    UNASKED: Setting(),
    "--search-all": Setting(Config(search="all")),
    "--no-denoise --half-window 0.05 --n-min 8": Setting(
        Config(denoise=False, half_window_s=0.05, n_min=8)
    ),
    "--clock pieces": Setting(Config(clock="pieces")),
    "--skew-prior 3000": Setting(Config(skew_prior_ppm=3000.0)),
    "--focal-std 3 --centre-std 10": Setting(deviations=(0.03, 10.0)),
    "--method joint": Setting(method="joint"),
    "--half-window 0.04": Setting(Config(half_window_s=0.04)),
    "--neighbours 3 --n-min 8": Setting(Config(n_neighbours=3, n_min=8)),
}


@dataclass(frozen=True)
class HandRow(ImperfectRow):
    """What was said, its errors, and what it took."""

    t_d_estimate_ms: float = np.nan  # given or not
    cpu_s: float = np.nan  # with denoising for the default, and without where that was done before


def hand_cells(
    base: Annotated[int, number("Seed of all draws.", 0, MAX_SEED)] = BASE,
    first: Annotated[int, number("Number of the first recording.", 0, MAX_SEED)] = 0,
    recordings: Annotated[
        int, number("How many numbers.", 1, MAX_SEED, metavar="COUNT")
    ] = N_RECORDINGS,
    every: Annotated[bool, flag("every", "Try settings where the default is right too.")] = False,
) -> list[HandCell]:
    """List all settings on recordings that are drawn by their numbers."""
    return [
        replace(drawn(base, one), setting=setting, every=every and setting != UNASKED)
        for one in range(first, first + recordings)
        for setting in SETTINGS
    ]


@dataclass
class Tried:
    """A recording, and what settings say of it."""

    pair: Pair  # with the rig as it is stated, and its true pose
    truth: Truth

    @cached_property
    def chain(self) -> Chain:
        """What all settings share that leave the rig as it is; SsacError if that is unusable."""
        return self.pair.chain()

    def said(self, setting: Setting) -> HandRow:
        """Run a setting, and score what it says."""
        chain, rig = self.chain, self.pair.rig
        if setting.deviations != (None, None):
            one, other = (with_deviations(of, *setting.deviations) for of in (rig.cam1, rig.cam2))
            chain = self.pair._replace(rig=Rig(one, other, rig.T_2_1)).chain()
        start_s = time.process_time()
        estimate = chain.under(setting.config).estimate(setting.method)
        cpu_s = time.process_time() - start_s
        n_cam1, n_cam2 = (chain.clean(k).n_recorded for k in range(2))
        columns = given_columns(estimate, self.truth) | {"t_d_estimate_ms": 1e3 * estimate.t_d_s}
        return HandRow(**columns, n_events_cam1=n_cam1, n_events_cam2=n_cam2, cpu_s=cpu_s)

    @cached_property
    def by_default(self) -> HandRow:
        """What the default says, which is found once."""
        return self.said(SETTINGS[UNASKED])


def load_tried(cells: Sequence[HandCell], cache: Cache) -> Tried:
    """Load the recording that the cells share."""
    sim, seed, kind = cells[0].sim, cells[0].seed, cells[0].spoilt
    load, duration_s = partial(recorded_pair, cache, replace(sim, t_d_s=0.0)), sim.spline.duration_s
    pair = spoilt_pair(Flown(load, seed, second_seed(seed)), kind, duration_s)
    pair = pair._replace(cam2=pair.cam2.delayed(sim.t_d_s - T_D_S))
    truth = Truth(sim.t_d_s, *known_pose(pair.rig), kind.skew_of(seed), 0.5 * duration_s)
    return Tried(pair, truth)


def hand_row(cell: HandCell, tried: Tried) -> HandRow:
    """Run one setting on one recording, unless the default is right and gives all."""
    if cell.setting == UNASKED:
        return tried.by_default
    if not cell.every:
        with suppress(SsacError):  # of which the default's own row tells
            default = tried.by_default
            if default.pose_given and right(pd.DataFrame([vars(default)]))[0]:
                return HandRow(SPARED)
    return tried.said(SETTINGS[cell.setting])


def beyond(runs: pd.DataFrame) -> dict[str, Mask]:
    """Tell of t_d, R and t whether they are given and over `MAX_SIGMAS` deviations off."""
    most = chdtr(1, MAX_SIGMAS**2)  # of several angles together one that is as improbable
    return {name: one.levels(runs) > most for name, one in HELD.items()}


def right(runs: pd.DataFrame) -> Mask:
    """Tell which runs (n,) give an offset, and nothing that is wrong."""
    far = beyond(runs)
    bad = far["t_d"] | ~(runs["t_d_error_ms"] < MAX_ERROR_MS)
    for name, column in (("R", "r_error_deg"), ("t", "t_error_deg")):
        bad |= far[name] & (runs[column] > MAX_ERROR_DEG)
    return np.asarray(runs["offset_given"].astype(bool) & ~bad)


def hand_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Sum up by kind what the default says, and what settings by hand would.

    Each recording is one of `wrong`, `settled`, where a setting is right and gives more, be it an
    offset or a pose, `right`, and refused by all; `settings` are those that are right, with counts.
    Of `settled_refused` the default gives nothing.
    `beyond` are over `MAX_SIGMAS` deviations off, and `worst` is the recording that is farthest
    off, and by how many.
    """
    runs = runs.assign(is_right=right(runs), is_beyond=np.any(list(beyond(runs).values()), axis=0))
    runs["gives"] = runs["offset_given"].astype(int) + runs["pose_given"].astype(int)
    default = pd.DataFrame([_judged(group) for _, group in runs.groupby(["base", "flight"])])
    parts = {
        "all": default,
        "rig as stated": default[default["kind"] != WRONG_RIG],
        f"under {SHORT_S:g} s": default[default["duration_s"] < SHORT_S],
        **{kind: default[default["kind"] == kind] for kind in KINDS},
    }
    rows = [{"kind": kind, **_counts(some)} for kind, some in parts.items() if len(some)]
    return pd.DataFrame(rows)


def _judged(runs: pd.DataFrame) -> dict[str, Any]:
    """Give the row of the default on a recording, with what is to be said of it."""
    default = runs[runs["setting"] == UNASKED].iloc[0]
    better = list(runs[runs["is_right"] & (runs["gives"] > default["gives"])]["setting"])
    verdict = "right" if default["is_right"] else "refused"
    if default["gives"] and not default["is_right"]:
        verdict, better = "wrong", []
    elif better:
        verdict = "settled"
    return {**default, "verdict": verdict, "settings": better}


def _counts(default: pd.DataFrame) -> dict[str, Any]:
    given = default["offset_given"].astype(bool)
    shares, _ = held(default, HELD, as_shares=True)
    off = default[[one.column for one in HELD.values()]].abs().max(axis=1)
    return {
        "recordings": len(default),
        "answered": int(given.sum()),
        "posed": int(default["pose_given"].astype(bool).sum()),
        **{one: int((default["verdict"] == one).sum()) for one in ("right", "wrong", "settled")},
        "settled_refused": int(((default["verdict"] == "settled") & ~given).sum()),
        **shares,
        "beyond": int(default["is_beyond"].sum()),
        "worst": "" if off.isna().all() else f"{default['flight'][off.idxmax()]}: {off.max():.1f}",
        "refused": counted(default["status"][~given].value_counts(), "{} {}", "; "),
        "settings": counted(default["settings"].explode().value_counts(), "{} {}", "; "),
        "cpu_s_median": default["cpu_s"].median(),
        "cpu_s_most": default["cpu_s"].max(),
    }


_SHOWN_AS = {
    "rig as stated": f"all but {WRONG_RIG}",
    f"under {SHORT_S:g} s": f"all under {SHORT_S:g} s",
    "plain": "nothing odd",
    "two objects": "a second object",
}


def hand_figure(table: pd.DataFrame) -> Figure:
    """Draw by kind what became of the recordings, and how often the 95 % intervals hold."""
    n, places = table["recordings"], np.arange(len(table))
    title = f"The default, beside settings by hand, on {n.max()} recordings"
    figure, grid = panels(title, 4.4, columns=2, sharey=True)
    left, axes = grid[0]
    parts = {
        "right": table["right"],
        "wrong": table["wrong"],
        "a setting gives more": table["settled"],
        "refused by all": n - table[["right", "wrong", "settled"]].sum(axis=1),
    }
    start: Array = np.zeros(len(table))
    for (label, count), color in zip(parts.items(), FILLS, strict=True):
        share = 100.0 * (count / n).to_numpy(np.float64)
        left.barh(places, share, left=start, color=color, label=label)
        start = start + share
    greys = ("0.0", "0.5", "1.0")  # beside each other, as one may be at another's place
    for k, ((name, quantity), grey) in enumerate(zip(HELD.items(), greys, strict=True)):
        look = {"marker": "Ds^"[k], "color": grey, "mec": "black", "ms": 4, "ls": "none"}
        beside = places + 0.28 * (k - 1)
        axes.plot(100.0 * table[f"{name}_held"], beside, label=quantity.label, **look)
    axes.axvline(95.0, color="0.6", lw=0.8, zorder=1, label="95 %")
    left.set_yticks(places, [_SHOWN_AS.get(kind, kind) for kind in table["kind"]])
    left.set_xlabel("recordings [%]")
    axes.set_xlabel("in the interval of 95 % [%]")
    left.invert_yaxis()
    for one in (left, axes):
        above = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}
        one.legend(**above, ncols=2, fontsize=8, frameon=False)
    return figure


_ALL_HELD = "{t_d_held:.0%}, {R_held:.0%} and {t_held:.0%}"

STUDIES = (
    Study(
        "by_hand",
        "Ordinary and odd recordings: the default beside settings by hand",
        hand_cells,
        Measure(load_tried, hand_row, HandRow),
        Runs("by_hand_runs.csv", ("base", "flight", "setting"), took=("cpu_s",)),
        (
            made_of("by_hand.csv", hand_table, "by_hand_runs"),
            made_of("by_hand.png", hand_figure, "by_hand"),
        ),
        command="ssac by-hand",
        committed={"first": FIRST},
        shows="by_hand",
        again=False,
        numbers={
            f"by_hand.{name}": quoted("by_hand", f"{{{name}:.0f}}", kind="all")
            for name in ("recordings", "right", "wrong", "settled", "settled_refused", "beyond")
        }
        | {
            "by_hand.held": quoted("by_hand", _ALL_HELD, kind="all"),
            "by_hand.wrong_rigs": quoted(
                "by_hand", "{settled:.0f} and {beyond:.0f}", kind=WRONG_RIG
            ),
        },
    ),
)

command = command_of(
    {"by_hand": STUDIES},
    "Ordinary and odd recordings: the default of `ssac sync` beside settings by hand.",
)
