"""The options of `ssac simulate` that spoil a recording: of `sim.disturb.config.DisturbConfig`."""

from typing import Annotated

from sim.disturb.config import MAX_FOCAL_PERCENT
from ssac.console.options import number

LampOption = Annotated[
    int, number("A square of so many pixels a side flickers, as a lamp does.", 0, 100, "pixels")
]
HotClustersOption = Annotated[
    int, number("So many clusters of 3x3 pixels fire without cause.", 0, 1000)
]
NoiseOption = Annotated[
    float, number("Noise events of every pixel, beside those of --noise.", 0, 100, "hertz")
]
BranchesOption = Annotated[
    int, number("Events of branches that sway, in each camera.", 0, 100_000_000, metavar="EVENTS")
]
PeopleOption = Annotated[int, number("So many people walk through each view.", 0, 100)]
CloudsOption = Annotated[
    float, number("Clouds drift over the sky, by so many pixels a second.", 0, 100, "px/s")
]
SecondObjectOption = Annotated[
    float,
    number("Share of the events of another flight that are added.", 0, 1, metavar="SHARE"),
]
IntrinsicsErrorOption = Annotated[
    tuple[float, float],
    number(
        f"The rig is wrong by draws of these deviations: focal lengths, at most "
        f"{MAX_FOCAL_PERCENT:g} %, and centres.",
        0,
        100,
        metavar="PERCENT PX",
    ),
]
