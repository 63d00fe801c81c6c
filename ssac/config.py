"""The parameters of all methods, and the checks of their values."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ssac.errors import SsacError
from ssac.rules import (
    DEFAULT_RULES,
    LineRules,
    NoiseRules,
    PointRules,
    Rules,
    check_rules,
    is_number,
)

N_MIN = 200
"""Least number of events in a window, the paper's N_min."""

MIN_SWINGS = 3.5
"""How many times, at least, a path must go to and fro to tell F's 7 parameters and t_d from chance:
see `ssac.search.two_views.TwoViews.swings`."""

_COUNTS = {
    **dict.fromkeys(("n_samples", "n_min", "n_neighbours", "trials", "final_trials"), 1),
    **dict.fromkeys(("border_px", "seed"), 0),
}
"""Fields that are whole numbers, and the least of each."""

CLOCKS = ("auto", "affine", "pieces")

Interval = tuple[float, float]
"""A lower and an upper bound."""

INTERVAL_S: Interval = (-1.0, 1.0)
"""Offsets searched by default, the paper's [t_b, t_e]."""

EVENT_SKEW_PRIOR_PPM = 50.0
"""Prior deviation of the skew between event cameras' clocks."""

SKEW_PRIOR_PPM = 1000.0
"""The same where a camera gave a track, as phones and camcorders do."""

MAX_SKEW_PPM = 100_000.0
"""Largest prior deviation of a skew."""


@dataclass(frozen=True)
class Cleaning:
    """How noise is told from an object."""

    denoise: bool
    n_neighbours: int | None
    noise: NoiseRules = field(default_factory=NoiseRules)
    line: LineRules = field(default_factory=LineRules)


@dataclass(frozen=True)
class Windows:
    """How the object's positions are made from events or points."""

    half_window_s: float
    n_min: int | None
    border_px: int
    max_border_fraction: float
    points: PointRules


@dataclass(frozen=True)
class Config:
    """Parameters of all methods; the defaults are those of the paper and its published sample.

    `resolved` replaces None and "auto" by values that suit what the cameras gave.
    """

    interval_s: Interval | None = None  # offsets searched; None: INTERVAL_S, or all where needed
    n_samples: int = 400  # sample times per candidate offset, the paper's N
    half_window_s: float = 0.020  # of events on each side of a sample time
    n_min: int | None = None  # events that a window holds at least; None: N_MIN, fewer if thin
    n_neighbours: int | None = None  # that a kept event needs; None: by noise and density
    border_px: int = 5  # width of the border in the margin rule
    max_border_fraction: float = 0.05  # largest share of a window's events on the border
    exhaustive: bool = False  # try an offset every 1 ms as the paper does, not coarse to fine
    robust: str = "lmeds"  # estimator of F: "lmeds" as in the paper, or "magsac"
    trials: int = 2000  # of LMedS at each candidate
    final_trials: int = 12000  # of LMedS at the offset found
    seed: int = 0  # of every random choice
    min_swings: float = MIN_SWINGS  # least number, of the object, where the pose is unknown
    max_valley_s: float = 0.3  # longest one of the cost curve whose middle is taken for an offset
    denoise: bool = True  # first remove hot pixels and isolated events
    skew_prior_ppm: float | None = None  # prior deviation of the clocks' skew; 0: they run alike
    search_skews: bool = True  # where they matter; False: a search of all offsets found the rate
    clock: str = "auto"  # or "affine"; or "pieces": its skew changes slowly
    roughness_ppm: float = 200.0  # prior deviation of that change from one piece to the next
    search: str = "auto"  # or "interval"; or "all" offsets that leave enough common time
    rates: Interval | None = None  # of camera 2's clock to search, where a frame rate is unknown
    choose_object: bool = True  # of several, the one that all saw; never where rates are searched
    rules: Rules = DEFAULT_RULES  # numbers by which stages decide: see `ssac.rules`

    def __post_init__(self) -> None:
        for name in ("interval_s", "rates"):  # a file gives them as lists
            if isinstance(getattr(self, name), (list, np.ndarray)):
                object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def offsets_s(self) -> Interval:
        """Least and largest offset searched."""
        return INTERVAL_S if self.interval_s is None else self.interval_s

    @property
    def prior_ppm(self) -> float:
        """Prior deviation of the skew."""
        return EVENT_SKEW_PRIOR_PPM if self.skew_prior_ppm is None else self.skew_prior_ppm

    @property
    def cleaning(self) -> Cleaning:
        """The part of the config that the noise filter uses."""
        return Cleaning(self.denoise, self.n_neighbours, self.rules.noise, self.rules.line)

    @property
    def windows(self) -> Windows:
        """The part of the config that the object's motion uses."""
        rules = self.border_px, self.max_border_fraction, self.rules.points
        return Windows(self.half_window_s, self.n_min, *rules)

    @property
    def searching(self) -> "Config":
        """The same config with default clocks, which no search depends on."""
        of_clocks = "skew_prior_ppm", "search_skews", "clock", "roughness_ppm"
        return replace(self, **{name: getattr(Config, name) for name in of_clocks})

    def resolved(self, has_track: bool) -> "Config":
        """Settle what is open by the kind of cameras: the clocks of tracks run at other rates."""
        prior_ppm = SKEW_PRIOR_PPM if has_track else EVENT_SKEW_PRIOR_PPM
        return replace(
            self,
            interval_s=self.offsets_s,
            skew_prior_ppm=prior_ppm if self.skew_prior_ppm is None else self.skew_prior_ppm,
            clock="affine" if self.clock == "auto" else self.clock,
            choose_object=self.choose_object and self.rates is None,
        )


def checked(config: Config | None) -> Config:
    """Return the config, or the default, with nothing left open; SsacError if a value is bad."""
    return validated(config).resolved(has_track=False)


def validated(config: Config | None) -> Config:
    """Return the config unchanged, or the default for None; SsacError if a value is bad."""
    config = Config() if config is None else config
    if not isinstance(config, Config):
        raise SsacError(f"config: expected a ssac.Config, got {type(config).__name__} {config!r}")
    for name, bounds in (("interval_s", config.interval_s), ("rates (--rate-range)", config.rates)):
        if bounds is not None and not _are_bounds(bounds):
            raise SsacError(f"{name} must be two finite numbers in ascending order, got {bounds!r}")
    if config.rates is not None and not config.rates[0] > 0.0:
        raise SsacError(f"rates must be positive, got {config.rates!r}: correct --rate-range")
    for name, word, words in (
        ("robust", config.robust, ("lmeds", "magsac")),
        ("clock", config.clock, CLOCKS),
        ("search", config.search, ("auto", "interval", "all")),
    ):
        if not isinstance(word, str) or word not in words:
            raise SsacError(f"{name} must be {' or '.join(words)}, got {word!r}")
    if config.interval_s is not None and (config.search == "all" or config.rates is not None):
        other = 'search="all"' if config.search == "all" else "rates"
        raise SsacError(f"interval_s: not with {other}, which tries every offset: leave one out")
    for name, least in _COUNTS.items():
        # More than ten million would fill the memory before anything is found.
        value, most = getattr(config, name), 2**32 - 1 if name == "seed" else 10_000_000
        is_whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        is_open = value is None and getattr(Config, name) is None
        if not (is_open or (is_whole and least <= value <= most)):
            raise SsacError(f"{name} must be a whole number of {least} to {most}, got {value!r}")
    for name in ("exhaustive", "denoise", "search_skews", "choose_object"):
        if not isinstance(getattr(config, name), (bool, np.bool_)):
            raise SsacError(f"{name} must be True or False, got {getattr(config, name)!r}")
    skew, rough = f"0 to {MAX_SKEW_PPM:g}", f"above 0 and up to {MAX_SKEW_PPM:g}"
    is_right: Callable[[float], bool]
    for name, value, is_right, need in (
        ("half_window_s", config.half_window_s, lambda s: 0.0 < s < np.inf, "positive and finite"),
        ("min_swings", config.min_swings, lambda n: 0 <= n < np.inf, "0 or more, and finite"),
        ("max_valley_s", config.max_valley_s, lambda s: 0 <= s < np.inf, "0 or more, and finite"),
        ("skew_prior_ppm", config.prior_ppm, lambda ppm: 0 <= ppm <= MAX_SKEW_PPM, skew),
        ("roughness_ppm", config.roughness_ppm, lambda ppm: 0 < ppm <= MAX_SKEW_PPM, rough),
        ("max_border_fraction", config.max_border_fraction, lambda x: 0.0 <= x <= 1.0, "0 to 1"),
    ):
        if not (is_number(value) and is_right(value)):
            raise SsacError(f"{name} must be {need}, got {value!r}")
    if config.clock == "pieces" and not config.prior_ppm:
        raise SsacError("a clock of pieces has a skew: its prior must be above 0 ppm, got 0")
    if config.rules is not DEFAULT_RULES:  # which hold, and a grid has many cells
        check_rules(config.rules)
    return config


def _are_bounds(bounds: object) -> bool:
    if not (isinstance(bounds, (tuple, list)) and len(bounds) == 2 and all(map(is_number, bounds))):
        return False
    return bool(np.isfinite(bounds).all() and bounds[0] < bounds[1])
