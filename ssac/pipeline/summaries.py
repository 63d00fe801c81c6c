"""The names of all methods with a line on each, for help and completion: nothing is imported."""

from importlib.metadata import entry_points

ENTRY_POINTS = "ssac.methods"
"""The group of entry points by which other packages register methods."""

DEFAULT = "tangency"
"""The most accurate method for unknown extrinsics; its `known_variant` is that for known ones."""

OF_TRACKS = "joint"
"""The most accurate method where a camera gave a track of points."""

SUMMARIES = {
    "ssac": "the paper's Algorithm 2",
    "ssac-known": "the paper's Algorithm 1",
    "joint": "ssac, then offset and pose refined together",
    "joint-known": "ssac-known, then the offset refined",
    "tangency": "joint, then refined by the outline's tangents",
    "tangency-known": "joint-known, then the offset refined by tangents",
    "albl": "eigenvalue solver of Albl et al. (2017)",
    "zncc_e": "correlation of event rates, offset only",
    "zncc_f": "correlation of frame brightness, offset only",
    "event_rate": "event rates, Censi and Scaramuzza (2014)",
}
"""Our methods; the registry takes their summaries from here."""


def all_summaries() -> dict[str, str]:
    """List our methods, then those of other packages, by name, with the package of each."""
    others = {
        entry.name: f"of the package {entry.dist.name}" if entry.dist else "of another package"
        for entry in entry_points(group=ENTRY_POINTS)
    }
    return SUMMARIES | {name: others[name] for name in sorted(others.keys() - SUMMARIES.keys())}
