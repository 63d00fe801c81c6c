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

    bin_us: int = 100_000  # [us]; a pixel with an event in a bin is active in it
    parts: int = 10  # equal parts of a recording: a masked cluster is active in each
    min_active_share: float = 0.2  # of a part's bins, in which a cluster's pixels are active
    min_bins_per_part: int = 2  # in the mean; shorter recordings do not tell what stays
    min_masked_events: int = 50  # pixels with fewer are never masked
    min_over_background: float = 4.0  # least events of a cluster's pixel, in an ordinary pixel's
    min_cluster_px: int = 3  # smaller clusters are never masked
    max_ring_share: float = 0.1  # median events around a masked cluster over its own, beyond noise
    min_companions: int = 2  # near pixels of comparable counts; with fewer, a pixel is masked
    comparable_ratio: float = 8.0  # of a pixel's events to those of a companion, at most
    square_px: int = 16  # side of the squares whose events tell the background
    ball_px: float = 5.0  # radius of the paper's ball of neighbours, in px and ms
    ball_neighbours: int = 20  # that an event needs in this ball, the paper's number
    near_ball_px: float = 3.0  # radius for much noise: less of it is kept beside the object
    near_ball_neighbours: int = 12  # that an event needs in the smaller ball
    noisy_hz: float = 1.0  # background of a pixel above which the smaller ball is taken
    min_kept_share: float = 0.9  # that the full number of neighbours must leave, to be required
    least_neighbours: int = 5  # required however little noise there is
    window_s: float = 0.040  # in which noise leaves at most one event, whatever the config's window
    thin_ratio: float = 2.0  # an object of fewer events in a window, in units of N_min, is thin
    thin_n_min_share: float = 0.25  # of a thin object's median events: what its windows must hold
    least_n_min: int = 20  # least number that this share may give


@dataclass(frozen=True)
class LineRules:
    """When a thin line holds the object, and which events are the line's."""

    half_width_px: float = 2.0  # of the line; of pendulums in a room, 1.2 to 3 px served alike
    half_window_us: int = 20_000  # half of a time window
    look_every: int = 5  # one in so many windows is searched for a line and its course
    first_windows: int = 20  # searched first, over all the recording: if none has a line, none is
    min_events: int = 60  # least events of the object in a window
    min_half_events: int = 20  # least events in each half of a window
    reach_share: float = 0.9  # of the object's events, that lie within its reach of the centre
    from_reach: float = 1.5  # in reaches: distance from the centre where the search begins, plus
    from_px: float = 3.0  # so many px
    length_px: float = 60.0  # largest length of line that is looked at from there
    min_length_px: float = 15.0  # least length of it within the view
    border_px: float = 2.0  # of the view, which is left out
    n_directions: int = 240  # tried over the full circle
    min_far_events: int = 10  # least events at those distances, in any direction
    min_line_events: int = 12  # least events on a line, plus ...
    min_over_beside: float = 4.0  # ... so many times those of a strip as wide beside it
    half_strip_px: float = 1.5  # events nearer to the line's axis are on it
    beside_from_px: float = 3.0  # distance from the axis at which the strips beside it begin ...
    beside_to_px: float = 9.0  # ... and end
    parts: int = 5  # of a line's length, each of which must have ...
    min_part_share: float = 0.05  # ... this share of its events
    first_gate_px: float = 3.0  # distance, on either side, of events that a line is first fitted to
    gate_px: float = 2.0  # the same in the fits after the first
    min_fitted_events: int = 8  # least events that a line is fitted to
    min_clear_windows: int = 8  # least number of windows with a line
    min_clear_share: float = 0.3  # least share of the windows searched: a line at rest is not seen
    min_alike: float = 0.8  # least length of the mean of the line's unit directions
    smoothed_windows: int = 5  # length of the median filter of a line's angle and offset


@dataclass(frozen=True)
class PointRules:
    """How a track of points is sampled in place of events."""

    size_sigmas: float = 10.0  # assumed size of the object, in deviations of a point; or, if more,
    size_widths: float = 0.01  # in widths of the image
    window_intervals: float = 2.6  # least half of a local parabola's window, in intervals: 5 points
    max_gap_intervals: float = 2.5  # longest step that is no gap: one point may be missing
    least_sigma_px: float = 0.02  # assumed deviation of points without noise


@dataclass(frozen=True)
class FaintRules:
    """How an object is followed that makes too few events to be told by their neighbours."""

    # Least number of events in the radius filter's ball: noise and clouds have two, by chance ten;
    # a 6 px image at 60 px/s makes some 500 a second. More, if noise leaves over one in a window.
    n_neighbours: int = 10
    most_neighbours: int = 200  # largest number that noise may require
    ms_per_px: float = 8.0  # length of time that counts as a pixel in the ball
    rounds: int = 4  # of the radius filter, each on what the last one left
    bin_us: int = 20_000  # a slow object moves by less than its own size in a bin
    # Density [px^2/s^3], as of 5 m/s at 35 m: by four flights of the outdoor twin, seeds 71,000 on.
    acceleration: float = 200.0
    max_speed_variance: float = 1e4  # limit of the velocity's variance between sights [px^2/s^2]
    lost_px: float = 3.0  # deviation of the path above which no events are looked for
    significant: float = 6.0  # least excess of events, in background's deviations; 4 follows clouds
    corridor_sigmas: float = 2.5  # half width of the corridor, in deviations of the object's image
    counted: float = 4.0  # squared deviations within which events count: best object to background
    inside: float = 9.0  # squared deviations up to which an event may be the object's
    around: float = 20.0  # squared deviations beyond which an event tells the background
    half_px: float = 20.0  # half side of the square that tells the background
    window_bins: int = 12  # on each side, for whether the object is seen: half a second
    size_bins: int = 25  # on each side, for the image's size, which changes within seconds
    sure_bins: int = 5  # on each side: where they hold ...
    min_sure_events: int = 10  # ... so many sure events, the object is sure
    dead_end_bins: int = 25  # kept of a path that leads from a sure stretch to no other
    max_rounds: int = 12  # of smoothing the path and weighting the events anew
    one_place_px: float = 10.0  # largest half width of an image, and its largest move in a bin
    min_clump_events: int = 30  # least events of a sure clump: chance and clouds leave up to 20
    min_size_events: int = 40  # least number, less one for each bin, that tells the image's size
    min_bin_events: int = 4  # least events of a bin that tells the size
    least_variances_px2: tuple[float, float] = (1.0, 0.5)  # of the image, along x and y
    max_variance_px2: float = 64.0  # of the image, along either axis
    least_around_px2: float = 50.0  # area of the square beside the object, at least
    least_background: float = 1e-4  # events in a bin and a pixel, at least
    max_sigma_px: float = 1.0  # largest deviation of a track's point: half the least image's size


@dataclass(frozen=True)
class ObjectRules:
    """When several things move before a camera, and how each is followed."""

    bin_us: int = 20_000  # an object moves by a small part of its own size in a bin
    several_share: float = 0.04  # of bins with several; 24 recordings of one drone had 0.02 at most
    still_share: float = 0.35  # of the bins: a cell that is full in more shows a thing that stays
    look_every: int = 5  # one in so many bins is looked at first
    cell_widths: float = 1 / 43  # side of a cell, in widths of the image: 8 of 346 px
    full_cell_events: int = 3  # least events of a full cell, which joins its full neighbours
    least_blob_events: int = 20  # smaller clusters of cells are no blobs
    least_blob_share: float = 0.03  # least events of a thing, as a share of its bin's largest blob
    apart_sizes: float = 0.75  # least gap between things, in diagonals of the larger
    apart_cells: float = 2.0  # the same, in cells
    reach_px: float = 10.0  # largest distance of a path's next blob from where it leads, plus ...
    reach_share: float = 0.4  # ... this share of the predicted step
    max_growth: float = 1.5  # largest ratio of an image's sizes in successive bins
    margin_px: float = 4.0  # around a blob's box, within which a predicted place is inside it
    least_bins: int = 5  # least length of a piece of a path
    lasting_bins: int = 75  # of the longest piece, for which still cells count as another object
    own_way_px: float = 6.0  # least change of the gap between two objects, plus ...
    own_way_share: float = 0.2  # ... this share of the gap: parts of one object stay together
    velocity_bins: int = 4  # last bins of a path, which give its velocity
    mixed_bins: int = 20  # after which two things that met have parted, or one is gone


@dataclass(frozen=True)
class TrackRules:
    """The track of the object through one camera's events, and how sure its points are."""

    step_s: float = 0.01  # between points: a quarter of a window, so that no motion is lost
    mean_sizes: float = 0.04  # deviation of the events' mean as the object turns, in image sizes
    centre_sizes: float = 0.015  # the same of the centre of its area
    least_sigma_px: float = 0.05  # least deviation of a point


@dataclass(frozen=True)
class SilhouetteRules:
    """When events tell the object's silhouette, and where it is looked for."""

    min_size_px: float = 5.0  # least median rms radius: few pixels of a 17 px drone tell anything
    # Least share of rests at a pixel's old level, 0.99 of ideal sensors. Below, levels are evened.
    min_closed_share: float = 0.97
    quiet_ramps: float = 6.0  # time without events, in edge ramps, after which a pixel may rest
    min_back_share: float = 0.93  # of excursions that come back: 0.82 with half the events missing
    # Largest level of a pixel at rest, as a share of its peak; and the same where the object comes
    # again next. By flights of 10 s of base 7000 on davis346, with 5 Hz of background.
    back_shares: tuple[float, float] = (0.34, 0.67)
    open_s: float = 0.3  # at the end of a recording, in which a level need not have come back
    min_share: float = 0.5  # of a track's points that must have a silhouette
    # Median rms radius of an object whose pixels leave its box too late, or never; and least share,
    # of the pixels that seem to be covered at the start, that is within the object's reach there.
    large_px: float = 14.0
    min_covered_share: float = 0.9
    box_sizes: float = 3.0  # reach of the box from the track, in sizes of the image, plus ...
    box_px: float = 4.0  # ... so many px
    box_points: int = 20  # on each side; the largest image at these points sets the box
    gap_steps: float = 3.0  # in median steps: in longer gaps the object may have been anywhere
    full_percentile: float = 95.0  # of the events' levels, taken as the level of a covered pixel
    curvature: float = 1.0  # log contrast of a covered pixel: between 0, linear, and log 7
    ramp_px: float = 0.5  # motion of an edge in which it changes a pixel's level by one
    least_speed_px_s: float = 20.0  # of an edge, which limits the length of a ramp
    window_sizes: float = 2.2  # half side of an image's window, in nearly the largest of the sizes
    large_percentile: float = 98.0  # of the sizes: nearly the largest
    max_off_sizes: float = 1.0  # of the area's centre from the mean of the events, in image sizes


Shape = tuple[float, float, float]


@dataclass(frozen=True)
class BodyRules:
    """When one point of a rigid body is followed in several cameras' silhouettes."""

    depth_power: float = 4.0  # power of depth by which parts of an image count: 3 of a ball, 4 flat
    step_s: float = 0.05  # between the instants of attitudes, which are interpolated in between
    max_left: float = 0.15  # largest median residual of a rigid body, as a share of squared images
    least_instants: int = 60  # least number with known attitudes
    most_learnt: int = 100  # instants from which the shape is learnt, at most ...
    most_fitted: int = 60  # ... and those among them that its voxels are fitted to
    full_px: float = 8.0  # largest deviation of the shape in images: pixels of larger ones join
    reach_sizes: float = 2.1  # half extent of the voxels, in largest deviations of the shape ...
    thickness_sizes: float = 0.5  # ... and along the axis of least variance
    voxels_across: float = 20.0  # from the middle to the reach, in number
    covered_share: float = 0.2  # least covered share of an image, at a voxel, that covers the voxel
    # Least share of the images that must cover a voxel, in the first rounds.
    carved_shares: tuple[float, float, float, float, float] = (0.6, 0.65, 0.7, 0.8, 0.85)
    fit_steps: int = 6  # of the voxels' densities in a round ...
    last_fit_steps: int = 15  # ... and in the last round
    max_rounds: int = 10  # of learning the shape
    least_rounds: int = 2  # before the last round
    yaw_rounds: int = 6  # first rounds, in which other yaws are tried
    yaws_deg: tuple[float, float, float, float, float] = (30.0, -30.0, 60.0, -60.0, 90.0)
    ill: float = 1.3  # in medians of the residuals: above it yaws are tried, at first everywhere
    good: float = 0.06  # median residual of a good body, as a share of squared images
    good_share: float = 0.8  # of the instants whose residual is then below twice that
    fair: float = 0.1  # median residual that also serves, once a round leaves more than ...
    settled: float = 0.97  # ... this share of the one before
    least_depth: float = 0.02  # least density of a voxel; thinner ones are removed
    outlier: float = 2.5  # largest residual at an instant that is kept, in medians
    better: float = 0.98  # another attitude's residual, over the old one, at which it is taken
    max_gap_s: float = 0.35  # longest time between instants with known attitudes
    alignments: int = 2  # rounds of least squares that fit attitudes and moves to the images ...
    last_alignments: int = 4  # ... and those of the last fit of all attitudes
    learnt_steps: int = 2  # the shape is learnt at one in so many instants, or in twice as many
    seen_step_s: float = 0.02  # between the silhouettes of two views
    longest_s: float = 120.0  # longest recording of two views: images of more fill the memory
    centre_window_s: float = 0.03  # half windows of the centres of area
    point_window_s: float = 0.04  # half windows of the body's point
    smoothing_s: float = 0.1  # of second moments in time
    moments_step_s: float = 0.01  # between the times of second moments
    open_step_s: float = 0.05  # between times at which the moment two views leave open is chosen
    open_values: int = 41  # of that moment, that are tried
    open_rounds: int = 8  # at most, from each of these deviations of a body, as shares of its size
    open_starts: tuple[Shape, Shape, Shape] = ((0.1, 0.65, 0.75), (0.2, 0.5, 0.85), (0.3, 0.6, 0.7))
    open_settled: float = 1e-3  # change of the deviations below which the rounds end
    open_least: float = 0.05  # least deviation in any direction, as such a share: noise leaves less
    open_change: float = 0.3  # weight of the tensor's change between those steps


@dataclass(frozen=True)
class ViewRules:
    """How one camera's view of a path is summed up (`ssac.search.view`)."""

    max_width: float = 0.3  # deviation of a straight path across, over the object's rms size, ...
    max_slenderness: float = 1.0 / 8.0  # ... and over its deviation along
    max_return: float = 0.2  # mean distance from itself a lag later, over its extent, if it repeats
    even_share: float = 0.5  # least share of the time that it is seen, for even sample times
    # A path that fits itself a lag later, as seen by one more camera, is uniform: lags in shares of
    # the recording, and largest median distance in those of the path's extent. Helices and circles
    # have up to .05, most .01; flights of 3 s and more .075 and more, by 88 odd ones.
    uniform_lags: tuple[float, float, float] = (0.08, 0.16, 0.24)
    max_uniform: float = 0.05


@dataclass(frozen=True)
class BlindRules:
    """When silences among events are readouts of frames (`ssac.search.view.blind_spans`)."""

    shortest_us: int = 3_000  # shortest silence
    longest_us: int = 30_000  # a DAVIS is blind for 5 to 25 ms, some ten times a second
    beside_us: int = 5_000  # on each side of a silence, where the rate of events is counted
    least_expected: float = 20.0  # events that it would hold at that rate: by chance it has some
    least_silences: int = 10  # least number that makes a rhythm
    most_periods: int = 10  # from one silence to the next: in between, the object may hardly move
    same_length: float = 0.2  # share by which lengths differ at the most
    same_rhythm: float = 0.05  # share of a period by which silences may be off the beat
    most_others: float = 0.2  # largest share of the silences of that length that are off the beat
    most_lengths: float = 0.4  # largest share of silences of other lengths: an object's, in volleys
    most_share: float = 0.6  # longest silence, as a share of a period, of a camera that is of use
    most_inside: float = 0.02  # events within spans, as a share of what they would hold, at most
    least_cut: float = 0.5  # least share of the events that lie between spans of the rhythm


@dataclass(frozen=True)
class SearchRules:
    """Algorithms 1 and 2 (`ssac.search`): between ordinary flights and others (docs/refusal.md)."""

    min_pairs: int = 15  # of a fit: fewer leave too little freedom beside F's seven for a median
    min_pairs_of_pose: int = 30  # at the offset found: about four for each parameter of F
    min_in_front: float = 0.75  # share of the pairs that a pose puts in front of both cameras
    min_overlap: float = 0.5  # of a candidate, over the longest overlap in the interval
    coarsest_steps: int = 20  # first step [ms] for motion as of flights: d_avg is a V to 100 ms
    least_coarse_steps: int = 5  # least first step [ms], for livelier motion
    ordinary_swing_hz: float = 2.0  # of a path, up to which the first step is the coarsest
    kept_minima: int = 3  # local minima of the coarse curve that are searched further
    deep: float = 0.5  # share of the median cost: a minimum below it is refined, lest it be a rival
    max_rivals: int = 24  # largest number of these
    rival: float = 3.0  # offsets whose cost is below this many times the least may be the true one
    one_valley_s: float = 0.05  # offsets of low cost that are nearer than that are in one valley
    min_extent: float = 0.6  # rms distance of a track from its middle, over the object's rms size
    max_residual: float = 0.4  # mean epipolar distance over the rms size: else no one object
    min_second_best: float = 7.0  # least residual of the next best F, over the best one's
    min_swings_of_line: float = 1.75  # half of any path's 3.5: half as many unknowns as with F


@dataclass(frozen=True)
class AllOffsetsRules:
    """The search over all offsets, of which nothing is known (`ssac.search.all_offsets`)."""

    step_widths: float = 0.16  # step of the offset, in the time in which a path goes its own width
    least_step_s: float = 0.005  # least value of that step
    most_step_s: float = 0.5  # largest value of that step
    rate_scan_step: float = 2.0  # step of the offset where many rates are tried, in ordinary steps
    rate_steps: float = 4.0  # of the offset, by which a step of the rate moves the overlap's ends
    rate_freedom: float = 2e-3  # share by which a frame camera's rate may be off the stated one
    pairs: int = 150  # of a fit of F, at most
    rate_pairs: int = 64  # the same where many rates are tried
    least_pairs: int = 40  # at an offset that is tried
    least_share: float = 0.15  # of the pairs at an offset, over the most at any offset
    moved: float = 0.02  # least motion between samples that count, as a share of a path's extent
    iterations: int = 4  # of a fit of F
    rate_iterations: int = 1  # the same where many rates are tried
    fine_iterations: int = 6  # the same where an offset is refined
    max_guesses: int = 12  # minima refined, of each rate and of all
    apart_steps: float = 5.0  # least distance of different offsets, in steps
    worth: float = 0.85  # another rate is taken if its cost is below this share of the stated one's
    rival: float = 2.0  # offsets whose cost is below this many times the least may be the true one
    max_cost: float = 0.12  # of the best offset; above it, the views show no one path
    reach_s: float = 0.5  # on each side of the offset found, in which a method searches; if more,
    reach_steps: float = 4.0  # so many steps
    unique_swings: float = 2.0  # to and fro, which suffice where no other offset fits as well


@dataclass(frozen=True)
class MatchRules:
    """The one object that all cameras saw (`ssac.search.one_object`); times are half bins."""

    lag_step: int = 2  # this and the rest: by nine odd recordings of two objects, bases 1, 2 and 5
    long_pairs: int = 8  # the longest pairs of pieces at an offset, any two of which give an F
    max_pairs: int = 40  # the longest pairs, which bear an F out or not
    points: int = 12  # of each pair, that are compared
    starts: int = 16  # offsets that are looked into
    same_lag: int = 4  # offsets that differ by no more are one
    as_often: float = 0.6  # least common time of a match, over the longest at its offset
    as_near: float = 2.0  # largest distance from the epipolar lines, over the least at an offset
    least_pairs: int = 60  # half bins that the pieces of both views have in common, at least
    least_common: int = 8  # half bins of two pieces, at least, to tell if they are one object's
    near_px: float = 1.5  # largest distance of one object's pieces from epipolar lines, plus ...
    near_share: float = 0.2  # ... this share of their sizes
    firm_px: float = 1.0  # the same once they are matched, if it is less, plus ...
    firm_times: float = 8.0  # ... so many times their distance
    rounds: int = 3  # of taking pieces, and refining offset and F
    min_common_s: float = 1.5  # in which both views bear out one offset: less does by chance
    # Of the time in which both see anything; in those nine true ones have 0.56 on, false < 0.62.
    min_share: float = 0.5
    rival: float = 0.7  # least time of another offset that may be true, in that of the best one
    clearly: float = 3.0  # largest distance of such a rival, in that of the best one
    least_distance_px: float = 0.1  # least value that is taken for the best one's
    track_size_px: float = 5.0  # of an object of which a track shows only the path


@dataclass(frozen=True)
class FitRules:
    """The robust fits of every refinement (`ssac.fit`), by 126 flights (docs/uncertainty.md)."""

    # Components of the errors' correlation: white noise, and what fades in three times [s]. Stated
    # deviations have no more degrees of freedom than the recording has longest times.
    fading_s: tuple[float, float, float] = (0.05, 0.2, 0.8)
    # Least distance of the epipole from the positions' middle, in their rms spread, with which
    # exact intrinsics are questioned: less on 4 flights before cameras that face each other.
    least_from_epipole: float = 0.25
    least_curvature: float = 0.25  # of the loss in any direction, as a share of the mean
    least_mean_curvature: float = 0.05  # of the loss, whose curvature is 1 at zero
    least_common: float = 0.5  # least factor by which common errors lessen a variance
    least_fading_times: float = 7.0  # least length of a recording for that, in the longest time
    most_shift: float = 0.5  # of intrinsics, as a share of the focal length: beyond, a fit diverges
    as_good: float = 1.01  # loss, in the least, of a change of intrinsics that explains as much
    told_combinations: int = 2  # of the intrinsics, which two views of one path determine
    max_last_change: float = 0.5  # in the last round, in deviations: new events move the estimate


@dataclass(frozen=True)
class VerdictRules:
    """When a refined estimate is to be relied upon (`ssac.methods.verdict`)."""

    max_t_d_std_s: float = 0.025  # of an offset; the search's own steps are 20 ms
    max_pose_std_deg: float = 5.0  # of a direction of the pose; a less certain one is unobservable
    max_spread: float = 0.12  # robust deviation of the final distances, over the object's rms size
    max_tail: float = 1.8  # their mean over it, 0.8 of normal errors, if the mean is above ...
    small_px: float = 0.2  # ... so many px, plus ...
    small_share: float = 0.06  # ... this share of the object's rms size
    # From the rig's intrinsics to the best ones, in deviations: 3.7 at most of 33 pairs of phones.
    # Where it states 0, in those of a good calibration: 2.7 at most of 137 right ones.
    max_against: float = 4.0
    in_doubt: float = 2.0  # the same from which a rig that states no deviations is in doubt
    # The same from which such a rig is in slight doubt, and what it then counts as known to, by the
    # 210 recordings of `ssac by-hand`, base 300, numbers 3250 to 3849, whose rigs state none.
    in_slight_doubt: float = 1.25
    slight_focal: float = 0.01  # of the focal lengths, as a share
    slight_centre_px: float = 3.0  # of the principal point
    # Deviations of a rig in doubt, by 75 such of `ssac by-hand`, bases 200 and 300, and 40 of
    # `reasons`: of a careless calibration, or so many times those where more speaks against it.
    careless_focal: float = 0.03  # of the focal lengths, as a share
    careless_centre_px: float = 10.0  # of the principal point
    times_careless: tuple[float, float, float] = (1.0, 4.0, 10.0)
    # Of each of these. Some focal lengths half or double have 1.56 to 1.97; the last one is final.
    max_against_careless: tuple[float, float, float] = (1.4, 1.4, 2.5)


@dataclass(frozen=True)
class NetworkRules:
    """How many cameras are brought together from what their pairs tell."""

    max_closure_s: float = 0.25  # closing error of three clocks that agree: by chance it is seconds
    max_off_s: float = 0.02  # largest error of a pair's offset by sightings; others are left out
    max_turn_deg: float = 5.0  # the same of a pair's pose
    samples: int = 500  # of a path by which cameras are first placed
    least_angle_deg: float = 4.0  # between two rays, at least, to tell a depth
    max_off_depths: float = 0.03  # largest distance of a point from a ray, in depths
    least_inliers: int = 30  # times at which a camera sees the path where it should, at least
    least_inlier_share: float = 0.4  # the same, as a share of all common times
    seed_share: float = 0.5  # least share of a seed's common samples in front of both cameras
    most_seeds: int = 30  # first pairs that are tried, at most
    enough_seeds: int = 4  # after which the best serves, if one has placed all cameras
    max_off_widths: float = 0.015  # largest reprojection error of a point, in widths of the image
    trials: int = 400  # of RANSAC for a camera's pose
    first_jerk: float = 3.0  # of a first path, in extents / s^2.5
    first_sigma_widths: float = 0.004  # first deviation of a sighting, in widths of the image
    fast_sigmas: float = 3.0  # of a rate by pairs, in its prior's deviations: the prior is wrong
    misfit: float = 8.0  # least rms error of a camera that does not fit, in the others' median; ...
    least_misfit_widths: float = 0.004  # ... and in widths of the image
    knot_intervals: float = 4.0  # from knot to knot, in intervals of the slowest camera but one
    knot_steps_s: tuple[float, float] = (0.02, 0.4)  # least and largest
    max_gap_s: float = 1.0  # longest time without sightings of two cameras that still has knots
    max_knot_gap_s: float = 0.5  # longest step between knots; longer ones are gaps
    piece_s: float = 5.0  # between the knots of a clock
    most_pieces: int = 100  # of a clock, at most
    aspect_share: float = 0.2  # of the focal lengths' difference: focus changes both
    # Of a camera's intrinsics, in deviations; beyond, these are wider: 2.4 at most with right rigs,
    # 3.3 to 6 with a focal length 1 % off (outdoor, seeds 76000, -2, -3, -6, three cameras).
    most_pull: float = 3.0
    most_doubts: int = 8  # times that deviations are widened
    suspect_times: float = 100.0  # by which the intrinsics of cameras that pairs suspect are freed
    # By how much, for each suspect, that raises the logarithm of the likelihood, at least: log(100)
    # for each of two values that may then be anywhere, and some more. One 10 to 30 % off gives 84.
    least_gain: float = 12.0
    # Lag of events behind the object, its deviation common to all cameras, and each camera's own:
    # 0.2 px with noise, 0.1 px ideal, within 0.03 px in one kind (flights 900 to 903).
    behind_px: float = 0.15
    behind_std_px: float = 0.08
    behind_own_px: float = 0.035
    level_std_px: float = 0.03  # of silhouettes: 0.01 px in ideal flights 73000 and 74000
    level_own_px: float = 0.02  # each camera's beside
    least_sigma_share: float = 0.3  # of the cameras' median deviation: no camera's is less
    least_sigma_px: float = 0.01  # the same in px
    most_lags: int = 500  # of correlations, which are summed until they are below ...
    least_correlation: float = 0.05  # ... this
    block_s: float = 1.0  # in which an object turns: correlations that last longer are small
    first_rounds: int = 6  # of estimating deviations and smoothness anew, with affine clocks
    rounds: int = 12  # the same with all parameters
    steps: int = 6  # of least squares at given deviations and smoothness
    settled: float = 3e-4  # largest relative change of a settled solution's cost in a round
    gate: float = 6.0  # in the end, sightings further from their place, in deviations, are left out
    shape_step_s: float = 0.01  # between times of the object's second moments
    shape_smoothing_s: float = 0.1  # of these moments: the object's shape turns more slowly
    # Deviation of a centre of area, in those of the body's one point, which is known to 0.025 px;
    # the centre is some 0.15 px off (flights 73000 and 74000).
    centre_sigmas: float = 5.0
    reach_s: float = 0.1  # from a sighting, for which a camera sees the object; or, if more,
    reach_intervals: float = 2.5  # so many intervals of its sightings
    path_step_s: float = 0.01  # least time between samples of a path


@dataclass(frozen=True)
class HypothesesRules:
    """Offsets and poses in question, and the choice between them (`ssac.methods.hypotheses`)."""

    flat: float = 0.2  # largest median distance of a plane's path from a homography, in rms sizes
    homography_pairs: int = 80  # enough to tell whether the path lies in a plane
    start_step_s: float = 0.1  # between starts within a long valley
    # Valley in which means of events tell an offset: helices have .4 to 1 s, slow flights .14.
    longest_of_means_s: float = 0.3
    max_offsets: int = 12  # most offsets in question
    max_poses: int = 2  # most poses of an offset, where several offsets are in question
    probes_s: tuple[float, float, float, float] = (-0.2, -0.06, 0.06, 0.2)  # where F is open
    enough: int = 8  # distinct offsets that fit as well as the best, after which no more are tried
    trimmed: float = 0.9  # share of the distances, the least ones, whose mean counts
    clearly: float = 2.0  # a solution of up to so many times the least distance fits as well as it
    same_s: float = 0.010  # offsets that are nearer to each other are one
    same_deg: float = 3.0  # and so are poses


@dataclass(frozen=True)
class ClockRules:
    """Skews, pieces and jumps of camera 2's clock (`ssac.methods.clocks`)."""

    piece_s: float = 5.0  # length of a piece of a clock
    max_pieces: int = 40  # of a clock, at most
    max_end_s: float = 0.020  # error of a tried skew at the ends, at most: twice as much converges
    skew_sigmas: float = 3.0  # skews tried on either side, in deviations of the prior
    max_skews: int = 61  # tried, at most
    jump_sigmas: float = 6.0  # of a step that is a jump: 80 ordinary flights have 4.7 at most
    fewer_sigmas: float = 4.5  # the same where the fit's skew is far off, as a jump bends it
    far_sigmas: float = 3.0  # from such a skew, in deviations of its prior
    min_jump_s: float = 0.002  # least size of a jump: an object's bias makes smaller steps
    jump_step_s: float = 1.0  # between the instants tried first
    jump_margin_s: float = 2.0  # from both ends: a bias does not average out in less
    max_tried: int = 200  # instants tried first, at most
    jump_near_s: float = 2.0  # from the best of these, within which the jump is looked for closely
    # A jump too large for the views to match: by causes of `ssac study reasons`, base 62, where the
    # half that is found fits 10 times worse at other offsets, and unlike paths by 0.3 widths.
    large_jump_s: float = 1.0  # largest difference between the offsets on both sides
    large_step_s: float = 0.01  # between offsets that are tried
    large_rounds: int = 3  # of refining F, the instant and both offsets
    large_rival: float = 3.0  # in units of the least cost: below it, another offset may be true


@dataclass(frozen=True)
class JointRules:
    """The joint refinement of offset and pose (`ssac.methods.joint`)."""

    # Deviations of a view's hidden bias, in image sizes: anywhere, and per unit of x / z and y / z.
    # By 126 flights of one drone so that regions hold; the last of a known pose and little motion.
    bias_offset: float = 0.01
    bias_slope: float = 0.04
    known_bias_offset: float = 0.1
    max_shift_s: float = 0.1  # a refinement that moves the offset further has left the minimum
    max_rounds: int = 20  # of sampling at the refined offset
    last_hope: int = 2  # round after which a refinement far from any ordinary fit is given up
    last_shift_s: float = 1e-5  # largest last change: events that enter the windows move t_d as far
    last_stray_s: float = 3e-5  # the same of a clock's other parameters, rms: they are less certain


@dataclass(frozen=True)
class OutlineRules:
    """How the outline is found (`ssac.track.outline`); `ssac study tangency` tries other values."""

    rough_half_window_s: float = 0.010  # of events moved by the track's course, not the tangent's
    half_window_s: float = 0.020  # of events moved by the smoothed tangent: more pixels are crossed
    smoothing_s: float = 0.040  # on each side, of the local parabolas that smooth a tangent
    passes: int = 2  # of following the tangent's course; 0: the track's is taken
    rank: int = 2  # from the extreme event, whose rank is 0 and which may be noise
    deeper_rank: int = 8  # the other rank: the gap between both tells how dense the events are
    outward: float = 0.5  # of the gap between the ranks: how far beyond the first the outline is
    ahead_px: float = 0.05  # how far an edge is ahead of its events
    max_angle_rad: float = 0.9  # of a tangent from the track: a pencil says little near the epipole
    rough_margin_px: float = 3.0  # inside the rough outline, up to which events are kept
    margin_px: float = 1.0  # the same, inside the deeper rank, once the course is followed
    centred: bool = False  # whether means of uneven events are moved to the middle of their windows
    max_shift_px: float = 6.0  # from an event, moved with the track's velocity, to its tangent


@dataclass(frozen=True)
class TangencyRules:
    """The refinement by tangents (`ssac.methods.tangency`); `ssac study tangency` varies them."""

    outline: OutlineRules = OutlineRules()
    step_s: float = 0.020  # between samples, each with two tangents, whatever `n_samples` is
    cauchy: float = 0.5  # scale of the loss, in robust standard deviations of the residuals
    wider_cauchy: float = 1.2  # the same, as long as a round still moves the estimate far
    sharp_px: float = 0.05  # error of a tangent that is not blurred at all
    apart: bool = True  # each of the two tangents is a pair; False: their middle is
    hidden_px: float = 0.2  # of outlines, for a given pose: an error that no residual shows
    # Where it is free: how much too wide, or too narrow, both images are, in robust deviations of
    # the tangents: by 82 odd flights of seeds 1 to 9 (numbers k with k // 9 even), 3 to 60 s.
    hidden_width: float = 1.8
    # Deviations of errors of all outlines, in image sizes, as of the body's point below: by numbers
    # 4450 to 4723 of `ssac by-hand`, where R of images over 25 px left its interval in 11 %, now 4.
    outline_offset: float = 0.01
    outline_slope: float = 0.01
    least_size_px: float = 3.5  # rms, of both images together, for an outline
    area_reach_s: float = 0.5  # about this offset, in which that of the centres of area is searched
    # Difference of the start's and the tangents' offsets, in the start's deviations, above which it
    # adds to the deviation where the start is refused.
    max_sigmas: float = 3.0
    # On either side of an offset that positions leave open, where tangents must fit worse: a circle
    # has .9 to 1.5 times the misfit there, one of a freely turning body 3.6.
    probe_s: float = 0.1
    # Share of tangents seen, below which t_d's deviation grows by half of that difference: above,
    # tangents are right. By numbers 1062 to 1241 of `ssac by-hand`.
    few_seen: float = 0.4
    # The same with noise of so many Hz of each pixel, where it is also at least the start's: by 22
    # recordings of numbers 1355 to 3840, of which four were off by 4 to 8 deviations. It is 0.25 Hz
    # of a sensor at 500 lux, and 1 Hz of the same at 5 lux.
    few_seen_in_dark: float = 0.6
    dark_hz: float = 0.5
    # Factors of the deviations at these shares of the pairs that are seen, those of a body too: by
    # the tables, flights 6010 to 6039 of `ssac study coverage` and numbers 1962 to 2561 of
    # `ssac by-hand`.
    seen_shares: tuple[float, float] = (0.4, 0.8)
    seen_times: tuple[float, float] = (1.0, 0.88)
    # Factor of t_d's deviation where the object is too small for an outline: by 53 of numbers 1962
    # to 2561 of `ssac by-hand`, by which two of few tangents were off by 10 and 13 deviations.
    tiny_times: float = 1.3
    max_rounds: int = 8  # of finding the tangents and refining; four are usual
    steps: int = 3  # of Gauss-Newton in a round: the tangents move more than a fourth would
    last_turn: float = 1e-4  # [rad] of the pose, between rounds
    far: float = 300.0  # in such changes: outlines of an estimate that moves further are found anew
    joins_body: bool = True  # joins a rigid body that both views' silhouettes tell
    body_error: float = 0.6  # of the body's one point, in errors of tangents
    # Deviations of the point's errors that no residual shows, in image sizes: anywhere, and per
    # unit of x / z and y / z; and of how far one view's images are ahead of the other's. By the
    # tables' flights, so that 95 % intervals of t_d, R and t hold in 96 to 98 %.
    body_offset: float = 0.0035
    body_slope: float = 0.006
    body_lag_px: float = 0.01
    # Change of the estimate by the body, in deviations of the tangents: two of 71 flights of five
    # kinds of object (seeds 500100 to 500199) are above 3.5, too sure.
    max_apart: float = 4.0


@dataclass(frozen=True)
class AlblRules:
    """The solver of Albl et al. (`ssac.methods.albl`)."""

    first_step_s: float = 0.02  # of the secants, then doubled; Albl et al. use 1, 2, ... frames
    n_steps: int = 6  # lengths of secants that are tried
    min_inlier_share: float = 0.75  # of the pairs: 0.95 at the true offset, below 0.55 elsewhere
    inlier_px: float = 2.0  # Sampson distance
    # Between starts, which lie at odd multiples of its half. In twenty flights, one linearisation
    # within that half makes 95 % of the pairs or more inliers, elsewhere 72 % at most.
    start_step_s: float = 0.12
    start_trials: int = 20  # of RANSAC at each start
    trials: int = 300  # of RANSAC at each offset on the way from a start
    max_rounds: int = 20  # of steps from a start, at most
    last_rounds: int = 2  # of such steps, which need not gain inliers


@dataclass(frozen=True)
class SignalRules:
    """The signals that rates and frames are compared by (`ssac.methods.correlations`)."""

    rate_bin_s: float = 0.001  # in which event_rate counts events
    zncc_bin_s: float = 0.010  # the same of zncc_e; in the paper, errors are multiples of it
    frame_s: float = 0.020  # between frames of zncc_f at the paper's 50 Hz: unit of its offsets
    min_overlap: float = 0.5  # least share of the shorter signal, for comparable correlations


@dataclass(frozen=True)
class GroundRules:
    """When a network fits what is known of its frame (`ssac.network.ground`)."""

    # Largest rms error of cameras' stated places, over their spread; and the largest distance of
    # these from one line, over their spread along it, that might be such errors.
    max_off_share: float = 0.1
    least_explained: float = 0.9  # share of RTK's motion that a path of the same flight explains
    rtk_rate_std_ppm: float = 1000.0  # prior deviation of RTK's clock rate: that of phones


@dataclass(frozen=True)
class RetryRules:
    """What is tried where the usual gives nothing (`ssac.pipeline.retries`)."""

    # Skew that fits best without a prior, in deviations of prior and fit, above which the prior is
    # wrong. By fast clocks of `ssac by-hand`, base 300, numbers below 882.
    far_skew: float = 3.0
    fast_ppm: float = 1000.0  # prior deviation of the skew of a fast clock
    least_fast_ppm: float = 600.0  # of a skew, not a jump: one of 5 ms in 20 s looks like 470 ppm
    # Of clocks that count frames: one more or less of 30 a second, in 5 s, is 6700 ppm. By pairs of
    # phones of drone-tracking's data set 4.
    roughnesses_ppm: tuple[float, float] = (2000.0, 6000.0)
    any_rate: tuple[float, float] = (0.5, 2.0)  # of a track's clock by the other camera's
    fast_rates: tuple[float, float] = (0.9967, 1.0033)  # of events: up to 3000 ppm and a tenth
    longer_s: float = 0.04  # half a longer window, for few events or where outlines may tell more
    # Deviation of an offset, beside an open pose, above which longer windows or a fast clock are
    # tried, as they may tell both: by large objects of `ssac by-hand`, bases 100 and 200.
    vague_s: float = 0.003
    longest_s: float = 0.05  # half of the longest window
    # Factor of the deviations of `joint`, where the tangents that should refine it fit poorly: by
    # eight such of numbers 702 to 1421 of `ssac by-hand` and of `ssac study imperfect`.
    start_widened: float = 2.0
    few_neighbours: int = 3  # that an event then needs
    fewest: int = 8  # events that a window then holds at least
    quiet_hz: float = 1e-3  # background of a pixel below which nothing needs to be filtered
    # Two drones that cross again and again, or keep near each other; one drone often seems two.
    closer: ObjectRules = ObjectRules(
        several_share=0.005, cell_widths=1 / 86, apart_sizes=0.1, lasting_bins=25
    )
    # A faint object that turns at up to 700 px/s^2, where no clouds are about: of the faint
    # recordings of `ssac by-hand --base 2` and 3.
    followed: FaintRules = FaintRules(
        n_neighbours=5, rounds=2, acceleration=6000.0, max_speed_variance=1e7, min_clump_events=10
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


DEFAULT_RULES = Rules()
"""Those of every `Config` that is given no others."""


def check_rules(rules: object) -> None:
    """Raise SsacError, which names the rule, where one is not of its type or not finite."""
    if not isinstance(rules, Rules):
        raise SsacError(f"rules: expected a ssac.rules.Rules, got {rules!r}")
    _check_part("rules", Rules, rules)


def _check_part(name: str, kind: Any, value: Any) -> None:
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
