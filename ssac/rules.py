"""The numbers by which each stage decides between answers, or refuses one.

They were fitted to recordings with known truth, as the comments beside them say. A sweep varies
each of them by its dotted name, as in `ssac.rules.verdict.max_t_d_std_s`; a stage reads them from
the configuration that it is given, and has no copy of its own.
"""

from dataclasses import dataclass, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from ssac.errors import SsacError


@dataclass(frozen=True)
class NoiseRules:
    """What is noise: pixels that fire by themselves, and events that are alone."""

    bin_us: int = 100_000  # a pixel active in nearly all bins of every part is no object's
    parts: int = 10
    min_active_share: float = 0.2  # of the bins of every part
    min_bins_per_part: int = 2  # shorter recordings do not tell what stays
    min_masked_events: int = 50  # pixels with fewer are never masked
    min_over_background: float = 4.0  # times the events of an ordinary pixel
    min_cluster_px: int = 3  # fewer are alone
    max_ring_share: float = 0.1  # of a masked cluster's events, less the background, around it
    min_companions: int = 2  # around a pixel that is not alone
    comparable_ratio: float = 8.0  # between their counts, at most
    square_px: int = 16  # side of the squares whose events tell the background
    ball_px: float = 5.0  # the paper's, in px and ms
    ball_neighbours: int = 20
    near_ball_px: float = 3.0  # for much noise: keeps less of it beside the object
    near_ball_neighbours: int = 12
    noisy_hz: float = 1.0  # background of a pixel from which the small ball is taken
    min_kept_share: float = 0.9  # of an object's events, where more neighbours are asked for
    least_neighbours: int = 5  # however little noise there is
    window_s: float = 0.040  # in which noise leaves an event at most, whatever the config's window
    thin_ratio: float = 2.0  # of an object of fewer times N_min in a window a share is enough
    thin_n_min_share: float = 0.25
    least_n_min: int = 20


@dataclass(frozen=True)
class LineRules:
    """When a thin line holds the object, and which events are its."""

    half_width_px: float = 2.0  # of pendulums in a room 1.2 to 3 px served alike
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

    size_sigmas: float = 10.0  # the object's size, in deviations of a point, or if more
    size_widths: float = 0.01  # in widths of the image
    window_intervals: float = 2.6  # least half of a parabola's window, in intervals: five points
    max_gap_intervals: float = 2.5  # between two points that are no gap's ends: one may be missing
    least_sigma_px: float = 0.02  # of points without noise


@dataclass(frozen=True)
class FaintRules:
    """How an object is followed that makes too few events to be told by their neighbours."""

    # Of the radius filter: a 6 px image at 60 px/s makes some 500 events a second, noise and clouds
    # two in this ball, by chance ten; more, where noise leaves more than an event in a window.
    n_neighbours: int = 10
    most_neighbours: int = 200
    ms_per_px: float = 8.0
    rounds: int = 4
    bin_us: int = 20_000  # in which a slow object goes less than its own size
    # Density [px^2/s^3], as of 5 m/s at 35 m: by four flights of the outdoor twin, seeds 71,000 on.
    acceleration: float = 200.0
    max_speed_variance: float = 1e4  # between two sights [px^2/s^2]
    lost_px: float = 3.0  # deviation of the predicted place, from which nothing is looked for
    significant: float = 6.0  # deviations of the background's events; 4 follow clouds
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
    max_sigma_px: float = 1.0  # of a track's points: half the size of the least image


@dataclass(frozen=True)
class ObjectRules:
    """When several things move before a camera, and how each is followed."""

    bin_us: int = 20_000  # in which an object goes a small part of its own size
    several_share: float = 0.04  # of the bins: 24 recordings of one drone had 0.02 at most
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
    lasting_bins: int = 75  # of the longest piece beside still cells
    own_way_px: float = 6.0  # by which the gap of two things changes: plus a share of it
    own_way_share: float = 0.2
    velocity_bins: int = 4  # that tell a path's velocity
    mixed_bins: int = 20  # after which two things that met have parted, or one is gone


@dataclass(frozen=True)
class TrackRules:
    """The track of the object through one camera's events, and how sure its points are."""

    step_s: float = 0.01  # between points: half of a window's half, so that no motion is lost
    mean_sizes: float = 0.04  # deviation of the events' mean as the object turns, in image sizes
    centre_sizes: float = 0.015  # the same of the centre of its area
    least_sigma_px: float = 0.05


@dataclass(frozen=True)
class SilhouetteRules:
    """When events tell the object's silhouette, and where it is looked for."""

    min_size_px: float = 5.0  # median rms radius: of a drone of 17 px few pixels tell anything
    # Of pixels come to rest where they were: of ideal sensors 0.99. With less, levels are evened.
    min_closed_share: float = 0.97
    quiet_ramps: float = 6.0  # without an event, after which a pixel may have come to rest
    min_back_share: float = 0.93  # of what leaves comes back; with half of the events missing 0.82
    # Of a peak, that are left of it then, and where the object comes again. On davis346 and 5 Hz of
    # background, flights of 10 s of base 7000.
    back_shares: tuple[float, float] = (0.34, 0.67)
    open_s: float = 0.3  # at the end of a recording, in which a level may not have come back
    min_share: float = 0.5  # of a track's points have a silhouette
    # Median rms radius of an object whose pixels leave its box too late, or never; and share of the
    # pixels that seem to be covered at the start which must be in reach of it then.
    large_px: float = 14.0
    min_covered_share: float = 0.9
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


Shape = tuple[float, float, float]


@dataclass(frozen=True)
class BodyRules:
    """When one point of a rigid body is followed in several cameras' silhouettes."""

    depth_power: float = 4.0  # with which a part of an image counts: 3 of a ball, 4 of a flat thing
    step_s: float = 0.05  # between the instants of attitudes, which are interpolated in between
    max_left: float = 0.15  # share of the images, as squares, that a rigid body may leave
    least_instants: int = 60
    most_learnt: int = 100  # of those at which the shape is learnt; and of those it is fitted to
    most_fitted: int = 60
    full_px: float = 8.0  # largest deviation of the shape in images: of larger ones pixels join
    reach_sizes: float = 2.1  # of the voxels, in largest deviations of the shape
    thickness_sizes: float = 0.5
    voxels_across: float = 20.0  # from the middle to the reach
    covered_share: float = 0.2  # of an image at a voxel
    # Of the images, those that cover a voxel, in the first rounds.
    carved_shares: tuple[float, float, float, float, float] = (0.6, 0.65, 0.7, 0.8, 0.85)
    fit_steps: int = 6  # in a round, and in the last one
    last_fit_steps: int = 15
    max_rounds: int = 10
    least_rounds: int = 2  # before the last
    yaw_rounds: int = 6  # in which other yaws are tried
    yaws_deg: tuple[float, float, float, float, float] = (30.0, -30.0, 60.0, -60.0, 90.0)
    ill: float = 1.3  # of the median of what is left: there they are, and everywhere at first
    good: float = 0.06  # what is left in the median, of a body that is good
    good_share: float = 0.8  # of the instants, that are then within twice that
    fair: float = 0.1  # the same, once a round leaves more than this share of what was left
    settled: float = 0.97
    least_depth: float = 0.02  # of a voxel: those below are nothing
    outlier: float = 2.5  # of the median of what is left
    better: float = 0.98  # of what is left with another attitude
    max_gap_s: float = 0.35  # between instants of known attitudes
    alignments: int = 2
    last_alignments: int = 4
    learnt_steps: int = 2  # between instants at which the shape is learnt, or twice as many
    seen_step_s: float = 0.02  # of two views: between silhouettes
    longest_s: float = 120.0  # of two views: images of more fill the memory
    centre_window_s: float = 0.03  # half of the windows of centres of area
    point_window_s: float = 0.04  # the same of the body's point
    smoothing_s: float = 0.1  # of second moments, between whose times there is such a step
    moments_step_s: float = 0.01
    open_step_s: float = 0.05  # the second moment that two views leave open
    open_values: int = 41  # of it, that are tried
    open_rounds: int = 8  # from each of these deviations of a body, as shares of its size
    open_starts: tuple[Shape, Shape, Shape] = ((0.1, 0.65, 0.75), (0.2, 0.5, 0.85), (0.3, 0.6, 0.7))
    open_settled: float = 1e-3
    open_least: float = 0.05  # deviation in any direction, as such a share: noise leaves less
    open_change: float = 0.3  # weight of the tensor's change between those steps


@dataclass(frozen=True)
class ViewRules:
    """How one camera's view of a path is summed up (`ssac.search.view`)."""

    max_width: float = 0.3  # of a straight path, across, over the object's rms size
    max_slenderness: float = 1.0 / 8.0  # and over the deviation along it
    max_return: float = 0.2  # from itself a lag later, over its extent, of one that repeats itself
    even_share: float = 0.5  # of the time it is seen, for even sample times


@dataclass(frozen=True)
class BlindRules:
    """When silences among events are readouts of frames (`ssac.search.view.blind_spans`)."""

    shortest_us: int = 3_000
    longest_us: int = 30_000  # a DAVIS is blind for 5 to 25 ms, some ten times a second
    beside_us: int = 5_000  # on each side of a silence, where there must be many events
    least_expected: float = 20.0  # events that it would hold at their rate: by chance it has some
    least_silences: int = 10  # that make a rhythm
    most_periods: int = 10  # from one to the next: in between, the object may hardly move
    same_length: float = 0.2  # share by which lengths differ at the most
    same_rhythm: float = 0.05  # share of a period by which beats do
    most_others: float = 0.2  # share of the silences of that length that are off the beat
    most_lengths: float = 0.4  # share of silences of another length: an object's own, in volleys
    most_share: float = 0.6  # of a period, in which a camera that is of use is blind
    most_inside: float = 0.02  # events within spans, as a share of what they would hold
    least_cut: float = 0.5  # share of the events that lie between spans of the rhythm


@dataclass(frozen=True)
class SearchRules:
    """Algorithms 1 and 2 (`ssac.search`): between ordinary flights and others (docs/refusal.md)."""

    min_pairs: int = 15  # of a fit: fewer leave too little freedom beside F's seven for a median
    min_pairs_of_pose: int = 30  # at the offset found: about four for each parameter of F
    min_in_front: float = 0.75  # share of the pairs that a pose puts in front of both cameras
    min_overlap: float = 0.5  # of the longest overlap that any offset in the interval gives
    coarsest_steps: int = 20  # of 1 ms, of paths as lively as flights: d_avg is a V to 100 ms
    least_coarse_steps: int = 5
    ordinary_swing_hz: float = 2.0
    kept_minima: int = 3  # local minima of the coarse curve that are searched further
    deep: float = 0.5  # of the median cost: a minimum below it is looked at, lest it be a rival
    max_rivals: int = 24
    rival: float = 3.0  # offsets whose cost is below this many times the least may be the true one
    one_valley_s: float = 0.05  # offsets nearer than that belong together
    min_extent: float = 0.6  # rms distance of a track from its middle, over the object's rms size
    max_residual: float = 0.4  # mean epipolar distance over the rms size: else no one object
    min_second_best: float = 7.0  # times worse that another F must fit the pairs
    min_swings_of_line: float = 1.75  # as 3.5 of any path: half as many unknowns as with F


@dataclass(frozen=True)
class AllOffsetsRules:
    """The search over all offsets, of which nothing is known (`ssac.search.all_offsets`)."""

    step_widths: float = 0.16  # step of the offset, in times in which a path goes its own width
    least_step_s: float = 0.005
    most_step_s: float = 0.5
    rate_scan_step: float = 2.0  # of the offset, where many rates are tried, in ordinary steps
    rate_steps: float = 4.0  # by which a step of the rate moves the ends of the common time
    rate_freedom: float = 2e-3  # share by which a frame camera's rate may be from what is said
    pairs: int = 150  # of a fit of F
    rate_pairs: int = 64  # of one where many rates are tried
    least_pairs: int = 40  # that an offset leaves
    least_share: float = 0.15  # of the pairs that the longest common path has
    moved: float = 0.02  # of a path's extent, between samples that count
    iterations: int = 4  # of a fit
    rate_iterations: int = 1
    fine_iterations: int = 6
    max_guesses: int = 12
    apart_steps: float = 5.0  # between offsets that are two
    worth: float = 0.85  # of the cost at the rate that is said: less is worth another rate
    rival: float = 2.0  # offsets whose cost is below this many times the least may be the true one
    max_cost: float = 0.12  # of the best offset, above which the views show no one path
    reach_s: float = 0.5  # on each side of the offset found, in which a method searches; or
    reach_steps: float = 4.0
    unique_swings: float = 2.0  # to and fro, that are enough where no other offset fits as well


@dataclass(frozen=True)
class MatchRules:
    """The one object that all cameras saw (`ssac.search.one_object`); times are half bins."""

    lag_step: int = 2  # with what follows, by nine odd recordings of two objects, bases 1, 2 and 5
    long_pairs: int = 8  # the longest of an offset, of which any two give an F
    max_pairs: int = 40  # the longest, that bear it out
    points: int = 12  # of each
    starts: int = 16  # offsets that are looked into
    same_lag: int = 4  # between offsets that are one
    as_often: float = 0.6  # of the time that another object is seen
    as_near: float = 2.0  # times the least distance from the epipolar lines of one offset
    least_pairs: int = 60  # that pieces have in common
    least_common: int = 8  # of two pieces, that tells whether they are one object's
    near_px: float = 1.5  # between pieces of one object
    near_share: float = 0.2  # and of their sizes
    firm_px: float = 1.0  # the same once they are matched, at most
    firm_times: float = 8.0
    rounds: int = 3
    min_common_s: float = 1.5  # in which both views bear out one offset: less does by chance
    # Of the time both see anything; of those nine recordings true ones have 0.56 on, false < 0.62.
    min_share: float = 0.5
    rival: float = 0.7  # share of the best one's time of another offset that may be the true one
    clearly: float = 3.0  # times the best one's distance: such a rival is none
    least_distance_px: float = 0.1  # that counts as the best one's
    track_size_px: float = 5.0  # of an object of which a track shows the path alone


@dataclass(frozen=True)
class FitRules:
    """The robust fits of every refinement (`ssac.fit`), by 126 flights (docs/uncertainty.md)."""

    # Components of the errors' correlation: white noise, and what fades in three times [s]. For the
    # deviations that are stated there are no more degrees of freedom than longest ones.
    fading_s: tuple[float, float, float] = (0.05, 0.2, 0.8)
    least_curvature: float = 0.25  # of any direction, as a share of the mean
    least_mean_curvature: float = 0.05  # of the loss, whose curvature is 1 at zero
    least_common: float = 0.5  # factor by which common errors may lessen a variance
    least_fading_times: float = 7.0  # of the longest, in which it is told that they do
    most_shift: float = 0.5  # of intrinsics, as a share of the focal length: no fit leads further
    told_combinations: int = 2  # of the intrinsics, that two views of one path tell
    max_last_change: float = 0.5  # in deviations, by the last iteration: new events move it


@dataclass(frozen=True)
class VerdictRules:
    """When a refined estimate is to be relied upon (`ssac.methods.verdict`)."""

    max_t_d_std_s: float = 0.025  # of an offset; the search's own steps are 20 ms
    max_pose_std_deg: float = 5.0  # of a direction of the pose; a less certain one is unobservable
    max_spread: float = 0.12  # robust deviation of the last distances, over the object's rms size
    max_tail: float = 1.8  # their mean over it, 0.8 of normal errors, where it is above both sizes
    small_px: float = 0.2
    small_share: float = 0.06
    # From the rig's intrinsics to the best ones, in deviations: 3.7 at most of 33 pairs of phones.
    max_against: float = 4.0
    in_doubt: float = 2.0  # of those, where the rig states no deviations
    # What a rig that is in doubt is tried as, by 75 such of `ssac by-hand`, bases 200 and 300,
    # and 40 of `reasons`: as carelessly known, or that times as badly where more speaks against it.
    careless_focal: float = 0.03  # deviation, as a share
    careless_centre_px: float = 10.0
    times_careless: tuple[float, float, float] = (1.0, 4.0, 10.0)
    # Of some focal lengths half or double it is 1.56 to 1.97; after the last there is no other.
    max_against_careless: tuple[float, float, float] = (1.4, 1.4, 2.5)


@dataclass(frozen=True)
class NetworkRules:
    """How many cameras are brought together from what their pairs tell."""

    max_closure_s: float = 0.25  # of three clocks that agree: one by chance is off by seconds
    max_off_s: float = 0.02  # of a pair from the sightings; one further off is left out
    max_turn_deg: float = 5.0  # the same of its pose
    samples: int = 500  # of first poses
    least_angle_deg: float = 4.0  # between two rays, where they tell a depth
    max_off_depths: float = 0.03  # from a ray, of a point that its camera sees
    least_inliers: int = 30  # times at which a camera sees the path in place
    least_inlier_share: float = 0.4  # of all common ones
    seed_share: float = 0.5  # of a seed's common samples, to be in front of both cameras
    most_seeds: int = 30
    enough_seeds: int = 4  # of which the best is good enough where all cameras found their place
    max_off_widths: float = 0.015  # of a point from its place, in widths of the image
    trials: int = 400  # of a camera's pose
    first_jerk: float = 3.0  # of a first path, in extents / s^2.5
    first_sigma_widths: float = 0.004  # of a sighting, in widths of the image
    misfit: float = 8.0  # of a camera that does not fit, in the others' median
    least_misfit_widths: float = 0.004  # and in widths of the image
    knot_intervals: float = 4.0  # from knot to knot, in intervals of the slowest camera but one
    knot_steps_s: tuple[float, float] = (0.02, 0.4)  # least and largest
    max_gap_s: float = 1.0  # without sightings of two cameras, in which there are no knots
    max_knot_gap_s: float = 0.5  # between knots; there is a gap where it is longer
    piece_s: float = 5.0  # between the knots of a clock
    most_pieces: int = 100
    aspect_share: float = 0.2  # of the focal lengths' difference: focus changes both
    # Length by which events are behind, its deviation in all cameras alike, and each one's beside:
    # 0.2 px with noise, 0.1 px ideal, within 0.03 px in one kind (flights 900 to 903).
    behind_px: float = 0.15
    behind_std_px: float = 0.08
    behind_own_px: float = 0.035
    level_std_px: float = 0.03  # of silhouettes: 0.01 px in ideal flights 73000 and 74000
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
    shape_step_s: float = 0.01
    shape_smoothing_s: float = 0.1  # the object's shape turns more slowly
    # Deviations of a centre of area, in those of the body's one point, which is known to 0.025 px
    # and some 0.15 px off (flights 73000 and 74000).
    centre_sigmas: float = 5.0
    reach_s: float = 0.1  # from a sighting, for which a camera sees the object; or
    reach_intervals: float = 2.5
    path_step_s: float = 0.01  # between samples of a path, at least


@dataclass(frozen=True)
class HypothesesRules:
    """Offsets and poses in question, and the choice between them (`ssac.methods.hypotheses`)."""

    flat: float = 0.2  # median distance from a homography, over the rms size, of a path in a plane
    homography_pairs: int = 80  # enough to tell whether the path lies in a plane
    start_step_s: float = 0.1  # between starts within a long valley
    # Valley in which means of events tell an offset: helices have .4 to 1 s, slow flights .14.
    longest_of_means_s: float = 0.3
    max_offsets: int = 12  # in question
    max_poses: int = 2  # of an offset, where several are in question
    probes_s: tuple[float, float, float, float] = (-0.2, -0.06, 0.06, 0.2)  # where F is open
    enough: int = 8  # solutions as good as the best at offsets of their own
    trimmed: float = 0.9  # share of the distances, the least, that count
    clearly: float = 2.0  # a solution up to so many times the least distance is as good as the best
    same_s: float = 0.010  # offsets nearer to each other are one
    same_deg: float = 3.0  # and poses


@dataclass(frozen=True)
class ClockRules:
    """Skews, pieces and jumps of camera 2's clock (`ssac.methods.clocks`)."""

    piece_s: float = 5.0  # length of a piece of a clock
    max_pieces: int = 40
    max_end_s: float = 0.020  # by which a tried skew is off at the ends: twice as far converges
    skew_sigmas: float = 3.0  # deviations of the prior that are tried either way
    max_skews: int = 61
    jump_sigmas: float = 6.0  # of a step that is a jump: 80 ordinary flights have 4.7 at most
    fewer_sigmas: float = 4.5  # the same where the fit's skew is far, as a jump bends it
    far_sigmas: float = 3.0  # deviations of the skew's prior
    min_jump_s: float = 0.002  # an object's bias makes smaller ones of its own
    jump_step_s: float = 1.0  # between instants that are tried
    jump_margin_s: float = 2.0  # from both ends: a bias does not average out in less
    max_tried: int = 200
    jump_near_s: float = 2.0  # of the best of these, the jump is looked for closely
    # One beyond which the views do not match: by causes of `ssac study reasons`, base 62, where the
    # half that is found fits 10 times worse at other offsets, and unlike paths by 0.3 widths.
    large_jump_s: float = 1.0  # to the other offset
    large_step_s: float = 0.01  # between offsets that are tried
    large_rounds: int = 3  # of F, the instant and both offsets
    large_rival: float = 3.0  # times the least cost, below which another offset may be true


@dataclass(frozen=True)
class JointRules:
    """The joint refinement of offset and pose (`ssac.methods.joint`)."""

    # Deviations of a view's hidden bias, in image sizes: anywhere, and per unit of x / z and y / z,
    # by 126 flights of one drone so that regions hold; of a known pose and little motion the last.
    bias_offset: float = 0.01
    bias_slope: float = 0.04
    known_bias_offset: float = 0.1
    max_shift_s: float = 0.1  # a refinement that moves the offset further has left the minimum
    max_rounds: int = 20  # of sampling anew
    last_hope: int = 2  # round after which one that is far from any ordinary fit is given up
    last_shift_s: float = 1e-5  # events that enter the windows move the minimum about as far
    last_stray_s: float = 3e-5  # of a clock's other parameters, rms, which are less certain


@dataclass(frozen=True)
class OutlineRules:
    """How the outline is found (`ssac.track.outline`); `ssac study tangency` tries other values."""

    rough_half_window_s: float = 0.010  # of events moved by the track's course, not the tangent's
    half_window_s: float = 0.020  # of events moved by the smoothed tangent: more pixels are crossed
    smoothing_s: float = 0.040  # on each side, of the local parabolas that smooth a tangent
    passes: int = 2  # of following the tangent's course; 0: the track's is taken
    rank: int = 2  # from the extreme event, whose rank is 0 and which may be noise
    deeper_rank: int = 8
    outward: float = 0.5  # of the gap between the ranks: how far beyond the first the outline is
    ahead_px: float = 0.05  # how far an edge is ahead of its events
    max_angle_rad: float = 0.9  # of a tangent from the track: a pencil says little near the epipole
    rough_margin_px: float = 3.0  # inside the rough outline, up to which events are kept
    margin_px: float = 1.0  # the same, inside the deeper rank, once the course is followed
    centred: bool = False  # moves the track from its events' mean times: where these are uneven
    max_shift_px: float = 6.0  # to its tangent, of an event that the track's velocity moves


@dataclass(frozen=True)
class TangencyRules:
    """The refinement by tangents (`ssac.methods.tangency`); `ssac study tangency` varies them."""

    outline: OutlineRules = OutlineRules()
    step_s: float = 0.020  # between samples, each with two tangents, whatever `n_samples` is
    cauchy: float = 0.5  # where the loss turns, in robust standard deviations
    wider_cauchy: float = 1.2  # the same, as long as a round still moves the estimate far
    sharp_px: float = 0.05  # error of a tangent that is not blurred at all
    apart: bool = True  # each tangent is a pair; else the point midway between the two is
    hidden_px: float = 0.2  # outlines are off by it where the pose is given: no residual shows it
    # Where it is free: how much too wide, or too narrow, both images are, in robust deviations of
    # the tangents: by 82 odd flights of seeds 1 to 9 (numbers k with k // 9 even), 3 to 60 s.
    hidden_width: float = 1.8
    least_size_px: float = 3.5  # rms, of both images together, for an outline
    area_reach_s: float = 0.5  # about its offset, in which that of the centres of area is searched
    # From the start's offset to the tangents', in the start's deviations, beyond which nothing is
    # surer than their difference: where the start is refused, or so small a share of all tangents
    # is seen. By numbers 1062 to 1241 of `ssac by-hand`: above .4 the tangents are right.
    max_sigmas: float = 3.0
    few_seen: float = 0.4
    max_rounds: int = 8  # of finding the tangents and refining; four are usual
    steps: int = 3  # of Gauss-Newton in a round: the tangents move more than a fourth would
    last_turn: float = 1e-4  # [rad] of the pose, between rounds
    far: float = 300.0  # times those last changes: then the outline is looked for anew
    joins_body: bool = True  # of a rigid body that both views' silhouettes tell
    body_error: float = 0.6  # of its one point, in errors of tangents
    # Deviations of errors of its point that no residual shows, in image sizes: anywhere, and per
    # unit of x / z and y / z; and of how far one view's images are ahead of the other's. By the
    # tables' flights, so that 95 % intervals of t_d, R and t hold in 96 to 98 %.
    body_offset: float = 0.0035
    body_slope: float = 0.006
    body_lag_px: float = 0.01
    # In deviations of tangents: two of 71 flights of five kinds of object (seeds 500100 to 500199)
    # are above 3.5, too sure.
    max_apart: float = 4.0


@dataclass(frozen=True)
class AlblRules:
    """The solver of Albl et al. (`ssac.methods.albl`)."""

    first_step_s: float = 0.02  # of the secants, which is doubled; Albl et al. use 1, 2, ... frames
    n_steps: int = 6
    min_inlier_share: float = 0.75  # 0.95 at the true offset, below 0.55 elsewhere
    inlier_px: float = 2.0  # Sampson distance
    # Between starts, at odd multiples of half of it: of twenty flights one linearisation within
    # half of it makes inliers of 95 % of the pairs or more, elsewhere of 72 % at most.
    start_step_s: float = 0.12
    start_trials: int = 20  # of RANSAC at each
    trials: int = 300  # at each offset on the way from there
    max_rounds: int = 20
    last_rounds: int = 2


@dataclass(frozen=True)
class SignalRules:
    """The signals that rates and frames are compared by (`ssac.methods.correlations`)."""

    rate_bin_s: float = 0.001  # in which event_rate counts events
    zncc_bin_s: float = 0.010  # the same of zncc_e, whose errors in the paper are multiples of it
    frame_s: float = 0.020  # between frames of zncc_f at the paper's 50 Hz: unit of its offsets
    min_overlap: float = 0.5  # of the shorter signal; the correlation of less is not comparable


@dataclass(frozen=True)
class GroundRules:
    """When a network fits what is known of its frame (`ssac.network.ground`)."""

    max_off_share: float = 0.1  # of cameras from where they are said to stand, rms, of their spread
    least_explained: float = 0.9  # of the motion of RTK, by a path of the same flight
    rtk_rate_std_ppm: float = 1000.0  # of RTK's clock over a camera's: those of phones


@dataclass(frozen=True)
class RetryRules:
    """What is tried where the usual gives nothing (`ssac.pipeline.retries`)."""

    # Deviations, the prior's and the fit's, of the skew that fits best by itself, beyond which the
    # prior is wrong. On fast clocks of `ssac by-hand`, base 300, numbers below 882.
    far_skew: float = 3.0
    fast_ppm: float = 1000.0  # prior deviation of one that runs at a rate of its own
    least_fast_ppm: float = 600.0  # of a skew, not a jump: of 5 ms in 20 s it looks like 470 ppm
    # Of clocks that count frames: one of 30 a second more or less in 5 s is 6700 ppm. On pairs of
    # phones of drone-tracking's data set 4.
    roughnesses_ppm: tuple[float, float] = (2000.0, 6000.0)
    any_rate: tuple[float, float] = (0.5, 2.0)  # of a track, by the other camera's
    fast_rates: tuple[float, float] = (0.9967, 1.0033)  # of events: up to 3000 ppm and a tenth
    longer_s: float = 0.04  # half of a window, of few events, or where outlines may tell more
    # Deviation of an offset beside an open pose, from which on longer windows or a fast clock may
    # tell both: by large objects of `ssac by-hand`, bases 100 and 200.
    vague_s: float = 0.003
    longest_s: float = 0.05
    # Of the deviations of `joint`, where the tangents that should refine it fit poorly: by eight
    # such of numbers 702 to 1421 of `ssac by-hand` and of `ssac study imperfect`.
    start_widened: float = 2.0
    few_neighbours: int = 3  # of its events
    fewest: int = 8  # that a window holds at least
    quiet_hz: float = 1e-3  # background of a pixel below which nothing needs to be filtered
    # Two drones that cross again and again, or keep near each other; one drone often seems two.
    closer: ObjectRules = ObjectRules(
        several_share=0.005, cell_widths=1 / 86, apart_sizes=0.1, lasting_bins=25
    )
    # A faint object that turns at up to 700 px/s^2, where no clouds are about: of those of
    # `ssac by-hand --kind faint --base 2` and 3.
    followed: FaintRules = FaintRules(
        n_neighbours=5,
        rounds=2,
        acceleration=6000.0,
        max_speed_variance=1e7,
        min_clump_events=10,
    )
    # Share of a recording in which a faint object is followed, below which noise hides it: those
    # recordings with an answer had 0.43 or more, and those without 0.33 or less, but for one.
    min_followed_share: float = 0.4


@dataclass(frozen=True)
class Rules:
    """The rules of all stages; the defaults are what every committed result was made with."""

    noise: NoiseRules = NoiseRules()
    line: LineRules = LineRules()
    points: PointRules = PointRules()
    objects: ObjectRules = ObjectRules()
    faint: FaintRules = FaintRules()
    track: TrackRules = TrackRules()
    silhouette: SilhouetteRules = SilhouetteRules()
    body: BodyRules = BodyRules()
    network: NetworkRules = NetworkRules()
    view: ViewRules = ViewRules()
    blind: BlindRules = BlindRules()
    search: SearchRules = SearchRules()
    all_offsets: AllOffsetsRules = AllOffsetsRules()
    match: MatchRules = MatchRules()
    fit: FitRules = FitRules()
    ground: GroundRules = GroundRules()
    verdict: VerdictRules = VerdictRules()
    hypotheses: HypothesesRules = HypothesesRules()
    clock: ClockRules = ClockRules()
    joint: JointRules = JointRules()
    tangency: TangencyRules = TangencyRules()
    albl: AlblRules = AlblRules()
    signals: SignalRules = SignalRules()
    retry: RetryRules = RetryRules()


def check_rules(rules: object) -> None:
    """Raise SsacError, which names the rule, where one is not of its type or not finite."""
    if not isinstance(rules, Rules):
        raise SsacError(f"rules: expected a ssac.rules.Rules, got {rules!r}")
    _check_part("rules", Rules, rules)


def _check_part(name: str, kind: Any, value: Any) -> None:
    """Check one rule, or all of a group of rules."""
    if isinstance(kind, type) and is_dataclass(kind):
        if not isinstance(value, kind):
            raise SsacError(f"{name}: expected {kind.__name__}, got {value!r}")
        for one, inner in get_type_hints(kind).items():
            _check_part(f"{name}.{one}", inner, getattr(value, one))
    elif get_origin(kind) is tuple:
        kinds = get_args(kind)
        if not (isinstance(value, tuple) and len(value) == len(kinds)):
            raise SsacError(f"{name}: expected {len(kinds)} numbers in a tuple, got {value!r}")
        for place, (inner, item) in enumerate(zip(kinds, value, strict=True)):
            _check_part(f"{name}[{place}]", inner, item)
    else:
        types, word = _KINDS[kind]
        is_finite = kind is not float or (is_number(value) and np.isfinite(value))
        if not (isinstance(value, types) and is_number(value) == (kind is not bool) and is_finite):
            raise SsacError(f"{name}: expected {word}, got {value!r}")


_NUMBERS = int, np.integer, float, np.floating
_KINDS: dict[type, tuple[tuple[type, ...], str]] = {
    bool: ((bool, np.bool_), "True or False"),
    int: (_NUMBERS[:2], "a whole number"),
    float: (_NUMBERS, "a finite number"),
}


def is_number(value: object) -> bool:
    """Whether this is a number, of Python or NumPy, and no truth value."""
    return isinstance(value, _NUMBERS) and not isinstance(value, bool)
