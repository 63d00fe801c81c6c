"""The parameters of all methods, and whether they make sense."""

from dataclasses import dataclass

import numpy as np

from ssac.errors import SsacError

N_MIN = 200
"""Events that a window holds at least, the paper's N_min."""

MIN_SWINGS = 3.5
"""Least times to and fro that a path must go to tell F's 7 parameters and t_d from chance: see
`ssac.search.two_views.TwoViews.swings`."""

MAX_VALLEY_S = 0.3
"""Longest valley of the cost curve whose middle is taken for an offset."""

CLOCKS = ("affine", "pieces")

MAX_SKEW_PPM = 100_000.0
"""Largest prior deviation of a skew."""


@dataclass(frozen=True)
class Config:
    """Parameters of all methods; the defaults are those of the paper and its published sample."""

    interval_s: tuple[float, float] = (-1.0, 1.0)  # offsets searched, the paper's [t_b, t_e]
    n_samples: int = 400  # sample times per candidate offset, the paper's N
    half_window_s: float = 0.020  # of events on each side of a sample time
    n_min: int | None = None  # events that a window holds at least; None: N_MIN, fewer if thin
    n_neighbours: int | None = None  # of an event that is kept; None: by noise and density
    border_px: int = 5  # width of the border in the margin rule
    max_border_fraction: float = 0.05  # of a window's events may lie on the border
    exhaustive: bool = False  # try an offset every 1 ms as the paper does, not coarse to fine
    robust: str = "lmeds"  # estimator of F: "lmeds" as in the paper, or "magsac"
    trials: int = 2000  # of LMedS at each candidate
    final_trials: int = 12000  # of LMedS at the offset found
    seed: int = 0  # of every random choice
    min_swings: float = MIN_SWINGS  # of the object, where the pose is unknown
    max_valley_s: float = MAX_VALLEY_S  # of the cost curve, where the offset is told
    denoise: bool = True  # first remove hot pixels and isolated events
    skew_prior_ppm: float = 50.0  # prior deviation of the clocks' skew; 0: they run alike
    search_skews: bool = True  # where they matter; no: a search of all offsets found the rate
    clock: str = "affine"  # or "pieces": its skew changes slowly; both beyond the paper's methods
    roughness_ppm: float = 200.0  # prior deviation of that change from one piece to the next


def checked(config: Config | None) -> Config:
    """Return the config, or the default for None; SsacError when a value makes no sense."""
    config = config or Config()
    low, high = config.interval_s
    if not (np.isfinite([low, high]).all() and low < high):
        raise SsacError(
            f"interval_s must be two finite offsets in ascending order, got {low, high}"
        )
    if config.robust not in ("lmeds", "magsac"):
        raise SsacError(f'robust must be "lmeds" or "magsac", got "{config.robust}"')
    if config.clock not in CLOCKS:
        raise SsacError(f'clock must be {" or ".join(CLOCKS)}, got "{config.clock}"')
    if not 0.0 <= config.skew_prior_ppm <= MAX_SKEW_PPM:
        raise SsacError(
            f"skew_prior_ppm must be 0 to {MAX_SKEW_PPM:g}, got {config.skew_prior_ppm}"
        )
    if not 0.0 < config.roughness_ppm <= MAX_SKEW_PPM:
        raise SsacError(
            f"roughness_ppm must be above 0 and up to {MAX_SKEW_PPM:g}, got {config.roughness_ppm}"
        )
    if config.clock == "pieces" and not config.skew_prior_ppm:
        raise SsacError("a clock of pieces has a skew: its prior must be above 0 ppm, got 0")
    for name in ("n_samples", "half_window_s", "n_min", "n_neighbours", "trials", "final_trials"):
        value = getattr(config, name)
        if value is not None and not 0 < value < np.inf:
            raise SsacError(f"{name} must be positive and finite, got {value}")
    for name in ("border_px", "seed", "min_swings", "max_valley_s"):
        value = getattr(config, name)
        if not 0 <= value < np.inf:
            raise SsacError(f"{name} must be 0 or more, and finite, got {value}")
    if not 0.0 <= config.max_border_fraction <= 1.0:
        raise SsacError(f"max_border_fraction must be 0 to 1, got {config.max_border_fraction}")
    return config
