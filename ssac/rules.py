"""The numbers by which each stage decides between answers, or refuses one.

They were fitted to recordings with known truth, as the comments beside them say. A sweep varies
each of them by its dotted name, as in `ssac.rules.verdict.max_t_d_std_s`; a stage reads them from
the configuration that it is given, and has no copy of its own.
"""

import math
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from ssac.errors import SsacError


@dataclass(frozen=True)
class NoiseRules:
    """What is noise: pixels that fire by themselves, and events that are alone."""

    # A pixel that is active in nearly all short bins of every part of a recording never pauses, as
    # no object does: one that hovers for long still leaves, or comes, or is gone, in some part.
    bin_us: int = 100_000
    parts: int = 10
    min_active_share: float = 0.2  # of the bins of every part
    min_bins_per_part: int = 2  # shorter recordings do not tell what stays
    min_masked_events: int = 50  # pixels with fewer are never masked
    min_over_background: float = 4.0  # times the events of an ordinary pixel
    min_cluster_px: int = 3  # fewer are alone
    # Around a cluster that is masked there is little: of its events per pixel, less the background.
    max_ring_share: float = 0.1
    # A pixel alone has fewer companions around it than this, of counts less so many times apart.
    min_companions: int = 2
    comparable_ratio: float = 8.0
    square_px: int = 16  # side of the squares whose events tell the background

    # The paper's ball [px, ms] and the neighbours that an event needs in it; and a smaller one for
    # much noise, as a large one keeps what lies beside the object by chance.
    ball_px: float = 5.0
    ball_neighbours: int = 20
    near_ball_px: float = 3.0
    near_ball_neighbours: int = 12
    noisy_hz: float = 1.0  # background of a pixel from which the small ball is taken
    # Share of an object's events that have more neighbours, where these are asked for.
    min_kept_share: float = 0.9
    least_neighbours: int = 5  # however little noise there is
    window_s: float = 0.040  # in which noise leaves an event at most, whatever the config's window
    # An object of fewer events in a window than so many times the paper's N_min is thin: a share of
    # them is then enough, though not less than the least.
    thin_ratio: float = 2.0
    thin_n_min_share: float = 0.25
    least_n_min: int = 20


@dataclass(frozen=True)
class LineRules:
    """When a thin line holds the object, and which events are its."""

    # On each side of the line's middle, whose events are its own. On pendulums in a room 1.2 to
    # 3 px served alike; a line's image is hardly a pixel wide, but its place is found to one.
    half_width_px: float = 2.0
    half_window_us: int = 20_000
    look_every: int = 5  # windows, of which one tells whether there is a line, and its course
    first_windows: int = 20  # of those, over all the recording: where none has a line there is none
    min_events: int = 60  # of the object in a window
    min_half_events: int = 20  # in each half of it
    reach_share: float = 0.9  # of the object's events, which are within its reach
    from_reach: float = 1.5  # times the reach, from which a line is looked for
    from_px: float = 3.0  # and more
    length_px: float = 60.0  # up to which it is followed from there
    min_length_px: float = 15.0  # within the view
    border_px: float = 2.0
    n_directions: int = 240
    min_far_events: int = 10  # there at all
    min_line_events: int = 12  # and so many times more than as wide a strip beside it has
    min_over_beside: float = 4.0
    half_strip_px: float = 1.5
    beside_from_px: float = 3.0
    beside_to_px: float = 9.0
    parts: int = 5  # of its length, each of which has such a share of the events
    min_part_share: float = 0.05
    first_gate_px: float = 3.0  # on each side, of the events that a line is fitted to
    gate_px: float = 2.0  # the same in the fits after the first
    min_fitted_events: int = 8
    min_clear_windows: int = 8  # with a line
    min_clear_share: float = 0.3  # of the windows, as nothing is seen of a line that rests
    min_alike: float = 0.8  # length of the mean of its directions
    smoothed_windows: int = 5


@dataclass(frozen=True)
class PointRules:
    """How a track of points is sampled in place of events."""

    # What stands for the object's size, whichever is more: so many deviations of a point, or so
    # many of the image's widths.
    size_sigmas: float = 10.0
    size_widths: float = 0.01
    window_intervals: float = 2.6  # least half of a parabola's window, in intervals: five points
    max_gap_intervals: float = 2.5  # between two points that are no gap's ends: one may be missing
    least_sigma_px: float = 0.02  # of points without noise


@dataclass(frozen=True)
class FaintRules:
    """How an object is followed that makes too few events to be told by their neighbours."""

    # Of the radius filter: an image of 6 px that moves by 60 px/s has some 500 events a second, and
    # none has the paper's 20 neighbours within 5 ms. Noise and the edges of clouds have two in this
    # longer ball, and by chance ten; but such clumps have too few among themselves, and melt when
    # they are filtered again, while the object's events keep each other.
    n_neighbours: int = 10
    ms_per_px: float = 8.0
    rounds: int = 4
    bin_us: int = 20_000  # in which a slow object goes less than its own size
    # Density of the image's acceleration [px^2/s^3]: 20 px/s in two seconds, as of a drone that
    # flies 5 m/s at 35 m. Of 200 and 600, chosen on four flights of the outdoor twin from seed
    # 71,000 on.
    acceleration: float = 200.0
    max_speed_variance: float = 1e4  # between two sights [px^2/s^2]
    lost_px: float = 3.0  # deviation of the predicted place, from which nothing is looked for
    # Deviations of the background's number of events, above which the object is seen. With 4, a
    # path followed the edges of clouds for up to a tenth of the time.
    significant: float = 6.0
    corridor_sigmas: float = 2.5  # half its width, in deviations of the object's image
    counted: float = 4.0  # squared deviations: the best part of the object over least background
    inside: float = 9.0  # squared deviations up to which an event may be the object's
    around: float = 20.0  # from which one tells how much there is beside the object
    half_px: float = 20.0  # of the square that tells the background
    window_bins: int = 12  # on each side: half a second in which the object is seen, or is not
    size_bins: int = 25  # on each side: the image's size changes within seconds
    sure_bins: int = 5  # on each side, and events in them, where the object is sure
    min_sure_events: int = 10
    dead_end_bins: int = 25  # kept of a path on from where the object is sure, and to no such place
    max_rounds: int = 12
    one_place_px: float = 10.0  # half of what an image may be wide, and may move in a bin
    min_clump_events: int = 30  # chance and clouds leave clumps of up to 20
    min_size_events: int = 40
    min_bin_events: int = 4
    least_variances_px2: tuple[float, float] = (1.0, 0.5)
    max_variance_px2: float = 64.0
    least_around_px2: float = 50.0
    least_background: float = 1e-4  # events in a bin and a pixel


@dataclass(frozen=True)
class ObjectRules:
    """When several things move before a camera, and how each is followed."""

    bin_us: int = 20_000  # in which an object goes a small part of its own size
    # Share of the bins with more than one thing, above which there are several. Of 24 recordings of
    # one drone, 10 s each, none had more than 0.02 of them.
    several_share: float = 0.04
    still_share: float = 0.35  # of the bins in which a cell is full that stays in its place
    look_every: int = 5  # bins, of which one is looked at first
    cell_widths: float = 1 / 43  # of the image: 8 of 346 px
    full_cell_events: int = 3  # that hold a cell together with its neighbours
    least_blob_events: int = 20
    least_blob_share: float = 0.03  # of the events of the largest blob of its bin
    apart_sizes: float = 0.75  # least gap between things, in diagonals of the larger
    apart_cells: float = 2.0
    reach_px: float = 10.0  # of a blob from where a path leads: plus a share of its last step
    reach_share: float = 0.4
    max_growth: float = 1.5  # of an image's size from bin to bin
    margin_px: float = 4.0  # around a blob
    least_bins: int = 5  # of a piece
    lasting_bins: int = 75  # of the longest piece; of a near drone's parts it had 50 at most
    own_way_px: float = 6.0  # by which the gap of two things changes: plus a share of it
    own_way_share: float = 0.2
    velocity_bins: int = 4  # that tell a path's velocity
    mixed_bins: int = 20  # after which two things that met have parted, or one is gone
    # Which piece of a path goes on with which: over a gap, and by what is ordinary there.
    max_link_bins: int = 30
    link_velocity_bins: int = 6
    link_px: float = 8.0  # by which a path turns aside in a gap: plus so much for each bin of it
    link_px_per_bin: float = 2.5
    brighter_ratio: float = 2.5
    larger_ratio: float = 1.6
    max_link_cost: float = 2.5


@dataclass(frozen=True)
class SilhouetteRules:
    """When events tell the object's silhouette, and where it is looked for."""

    # Least root mean square radius of an image, in the median: of one below, as of a drone of
    # 17 px, most pixels are neither bare nor covered.
    min_size_px: float = 5.0
    # Of the pixels, those that come to rest where they had been: a sensor's noise and thresholds
    # that differ open it, as do events that were left out. Ideal sensors have over 0.99 of them.
    min_closed_share: float = 0.8
    # Of a track's points, those that have a silhouette: the mean of the events is of another point
    # of the object, so that one of the two is to be followed nearly all the time.
    min_share: float = 0.5
    box_sizes: float = 3.0  # reach of the box from the track, in sizes of the image, and beside
    box_px: float = 4.0
    box_points: int = 20  # on each side, of which the largest image sets the box
    gap_steps: float = 3.0  # beyond which the object may have been anywhere
    full_percentile: float = 95.0  # of the events' levels: nearly as dark as the object gets
    curvature: float = 1.0  # between a share that is as the level and one of contrast 7
    ramp_px: float = 0.5  # by which an edge changes a level
    least_speed_px_s: float = 20.0
    window_sizes: float = 2.2  # of an image by itself, in sizes nearly the largest
    large_percentile: float = 98.0
    max_off_sizes: float = 1.0  # of the centre from the mean of the events


@dataclass(frozen=True)
class BodyRules:
    """When one point of a rigid body is followed in several cameras' silhouettes."""

    # How the area of a part of the image goes with its depth, as a power, and one more for its
    # place: 3 for a ball and its like, 4 for a flat thing, as most drones are.
    depth_power: float = 4.0
    step_s: float = 0.1  # between the instants of attitudes, which are interpolated in between
    max_left: float = 0.15  # share of the images, as squares, that a rigid body may leave
    least_instants: int = 30
    most_instants: int = 100  # of those that tell the shape
    reach_sizes: float = 2.1  # of the voxels, in largest deviations of the shape
    thickness_sizes: float = 0.5
    voxels_across: float = 30.0  # from the middle to the reach
    covered_share: float = 0.2  # of an image at a voxel
    carved_shares: tuple[float, float, float] = (0.7, 0.7, 0.85)  # of the images that cover a voxel
    fit_steps: tuple[int, int, int, int] = (6, 6, 6, 15)  # in these rounds, and in a last one
    least_depth: float = 0.02  # of a voxel: those below are nothing
    outlier: float = 2.5  # of the median of what is left
    better: float = 0.95  # of what is left with another attitude
    max_gap_s: float = 0.35  # between instants of known attitudes
    alignments: int = 2


@dataclass(frozen=True)
class VerdictRules:
    """When a refined estimate is to be relied upon (`ssac.methods.verdict`)."""

    max_t_d_std_s: float = 0.025  # of an offset; the search's own steps are 20 ms
    max_pose_std_deg: float = 5.0  # of a direction of the pose; a less certain one is unobservable
    # Largest robust deviation of the last step's distances, over the object's rms size.
    max_spread: float = 0.12
    # Largest mean of those distances over their robust deviation, 0.8 for normal errors, where the
    # mean is above small_px and small_share times the object's rms size.
    max_tail: float = 1.8
    small_px: float = 0.2
    small_share: float = 0.06
    # From the rig's intrinsics to those that fit best, in their stated deviations.
    max_against: float = 3.5


@dataclass(frozen=True)
class NetworkRules:
    """How many cameras are brought together from what their pairs tell."""

    # Three clocks that go round to within this agree: readouts and wandering clocks stay below it,
    # and an offset found by chance is off by seconds.
    max_closure_s: float = 0.25
    max_off_s: float = 0.02  # of a pair from the sightings; one further off is left out
    max_turn_deg: float = 5.0  # the same of its pose

    # First poses.
    samples: int = 500
    least_angle_deg: float = 4.0  # between two rays, where they tell a depth
    max_off_depths: float = 0.03  # from a ray, of a point that its camera sees
    # Sample times, and the share of all common ones, at which a camera must see the path in place.
    least_inliers: int = 30
    least_inlier_share: float = 0.4
    seed_share: float = 0.5  # of a seed's common samples, to be in front of both cameras
    most_seeds: int = 30
    enough_seeds: int = 4  # of which the best is good enough where all cameras found their place
    max_off_widths: float = 0.015  # of a point from its place, in widths of the image
    trials: int = 400  # of a camera's pose
    first_jerk: float = 3.0  # of a first path, in extents / s^2.5
    first_sigma_widths: float = 0.004  # of a sighting, in widths of the image
    # A camera does not fit whose deviation is more than so many times the others' median, and than
    # so many widths of the image.
    misfit: float = 8.0
    least_misfit_widths: float = 0.004

    # The path, and clocks that may wander.
    knot_intervals: float = 4.0  # from knot to knot, in intervals of the slowest camera but one
    knot_steps_s: tuple[float, float] = (0.02, 0.4)  # least and largest
    max_gap_s: float = 1.0  # without sightings of two cameras, in which there are no knots
    max_knot_gap_s: float = 0.5  # between knots; there is a gap where it is longer
    piece_s: float = 5.0  # between the knots of a clock
    most_pieces: int = 100

    # Priors, and what errors are taken for.
    aspect_share: float = 0.2  # of the focal lengths' difference: focus changes both
    # Length by which events are behind, its deviation in all cameras alike, and that of each
    # beside: it is 0.2 px in noisy recordings of small drones, 0.1 px in ideal ones, and within
    # 0.03 px the same in cameras of one kind (trial flights 900 to 903 of outdoor and network).
    behind_px: float = 0.15
    behind_std_px: float = 0.08
    behind_own_px: float = 0.035
    # The same of silhouettes, which are told from both sides of an edge and are not behind: 0.01 px
    # (ideal flights 73000 and 74000).
    level_std_px: float = 0.03
    level_own_px: float = 0.02
    least_sigma_share: float = 0.3  # of the cameras' median deviation: no camera's is less
    least_sigma_px: float = 0.01
    most_lags: int = 500  # of correlations that are summed up until they vanish
    least_correlation: float = 0.05
    block_s: float = 1.0  # in which an object turns: what lasts longer than that is little
    first_rounds: int = 6  # of new deviations and a new smoothness, with affine clocks
    rounds: int = 12  # the same, of all there is
    steps: int = 6  # at given deviations and smoothness
    settled: float = 3e-4  # share by which the cost of a settled solution changes in a round
    gate: float = 6.0  # deviations from its place at which a sighting is left out, at last

    # The object's shape, which turns more slowly than this is smoothed.
    shape_step_s: float = 0.01
    shape_smoothing_s: float = 0.1
    # Deviations of a centre of area, in those of the body's one point, where that is followed: it
    # is another point, some 0.15 px off, and the body's is known to 0.025 px (flights 73000 and
    # 74000).
    centre_sigmas: float = 5.0

    # A camera sees the object at a time where it did so within this, or so many of its intervals.
    reach_s: float = 0.1
    reach_intervals: float = 2.5
    path_step_s: float = 0.01  # between samples of a path, at least


@dataclass(frozen=True)
class Rules:
    """The rules of all stages; the defaults are what every committed result was made with."""

    noise: NoiseRules = NoiseRules()
    line: LineRules = LineRules()
    points: PointRules = PointRules()
    objects: ObjectRules = ObjectRules()
    faint: FaintRules = FaintRules()
    silhouette: SilhouetteRules = SilhouetteRules()
    body: BodyRules = BodyRules()
    network: NetworkRules = NetworkRules()
    verdict: VerdictRules = VerdictRules()


def check_rules(rules: object) -> None:
    """Refuse rules that are none, or of which one is not of its type or not finite.

    Raises
    ------
    SsacError
        It names the rule, as in `rules.verdict.max_t_d_std_s`.
    """
    if not isinstance(rules, Rules):
        raise SsacError(f"rules: expected a ssac.rules.Rules, got {rules!r}")
    _check_part("rules", Rules, rules)


def _check_part(name: str, kind: Any, value: Any) -> None:
    """Check one rule, or all of a group of rules."""
    if isinstance(kind, type) and is_dataclass(kind):
        if not isinstance(value, kind):
            raise SsacError(f"{name}: expected {kind.__name__}, got {value!r}")
        hints = get_type_hints(kind)
        for one in fields(kind):
            _check_part(f"{name}.{one.name}", hints[one.name], getattr(value, one.name))
    elif get_origin(kind) is tuple:
        kinds = get_args(kind)
        if not (isinstance(value, tuple) and len(value) == len(kinds)):
            raise SsacError(f"{name}: expected {len(kinds)} numbers in a tuple, got {value!r}")
        for place, (inner, item) in enumerate(zip(kinds, value, strict=True)):
            _check_part(f"{name}[{place}]", inner, item)
    elif not _is_of(kind, value):
        word = {bool: "True or False", int: "a whole number", float: "a finite number"}[kind]
        raise SsacError(f"{name}: expected {word}, got {value!r}")


def _is_of(kind: type, value: object) -> bool:
    if kind is bool:
        return isinstance(value, (bool, np.bool_))
    if isinstance(value, (bool, np.bool_)):
        return False
    if kind is int:
        return isinstance(value, (int, np.integer))
    return isinstance(value, (int, float, np.integer, np.floating)) and math.isfinite(value)
