"""What is known beforehand of the scale and the frame of many cameras."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssac.errors import SsacError


@dataclass(frozen=True)
class Known:
    """What is known of the scale and the frame: one of these at most."""

    distance_m: float | None = None  # between the first two cameras
    positions: Path | None = None  # of the cameras
    rtk: Path | None = None  # the object's own path, on a clock of its own
    lever_arm_m: tuple[float, float, float] | None = None  # where RTK's antenna is in the body

    def __post_init__(self) -> None:
        if self.distance_m is not None and not (
            isinstance(self.distance_m, (int, float)) and 0.0 < self.distance_m < np.inf
        ):
            raise SsacError(f"distance_m must be positive and finite, got {self.distance_m!r}")
        if sum(one is not None for one in (self.distance_m, self.positions, self.rtk)) > 1:
            raise SsacError("distance_m, positions, rtk: each sets the scale: give the best alone")
        for name in ("positions", "rtk"):
            if isinstance(getattr(self, name), str):
                object.__setattr__(self, name, Path(getattr(self, name)))


NOTHING = Known()


def known_of(
    distance_m: float | None,
    positions: Path | None,
    rtk: Path | None,
    lever_arm_m: tuple[float, float, float] | None = None,
) -> Known:
    """Sum up options on the scale and the frame, before the work of hours begins.

    Raises
    ------
    SsacError
        Where they do not go together, or a file cannot be used.
    """
    given = {"--distance": distance_m, "--positions": positions, "--rtk": rtk}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise SsacError(
            f"{names[0]}: not with {names[1]}, as each sets the scale: give the better one alone"
        )
    if lever_arm_m is not None and rtk is None:
        raise SsacError("--lever-arm: is of RTK's antenna: give --rtk too, or leave it out")
    if positions is not None:
        from ssac.compare.frame import load_positions  # and with it all that compares paths

        load_positions(positions)
    if rtk is not None:
        from ssac.compare.frame import check_rtk

        check_rtk(rtk, lever_arm_m)
    return Known(distance_m, positions, rtk, lever_arm_m)
