"""The options of `ssac simulate` that spoil a recording: of `sim.disturb.DisturbConfig`."""

from typing import Annotated

from sim.disturb import MAX_FOCAL_PERCENT
from ssac.console.options import number

LampOption = Annotated[
    int, number("Side of a flickering square, such as a lamp; 0 for none.", 0, 100, "pixels")
]
HotClustersOption = Annotated[int, number("Number of 3x3 clusters of hot pixels.", 0, 1000)]
NoiseOption = Annotated[
    float, number("Rate of noise events per pixel, added to --noise.", 0, 100, "hertz")
]
BranchesOption = Annotated[
    int,
    number(
        "Number of events from swaying branches, in each camera.", 0, 100_000_000, metavar="EVENTS"
    ),
]
PeopleOption = Annotated[int, number("Number of people who walk through each view.", 0, 100)]
CloudsOption = Annotated[float, number("Speed of drifting clouds; 0 for none.", 0, 100, "px/s")]
SecondObjectOption = Annotated[
    float,
    number("Add this share of the events of a second drone.", 0, 1, metavar="SHARE"),
]
IntrinsicsErrorOption = Annotated[
    tuple[float, float],
    number(
        f"Standard deviations of errors drawn for the rig file: focal lengths, at most "
        f"{MAX_FOCAL_PERCENT:g} %, and centres.",
        0,
        100,
        metavar="PERCENT PX",
    ),
]
