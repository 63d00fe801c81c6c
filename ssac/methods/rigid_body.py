"""One point of a rigid body, followed in two views so that its images correspond.

Beyond the paper. Tangents of outlines may miss thin parts in one view and not in the other. A rigid
body of voxels does not: both views' silhouettes together determine its shape and attitudes
(`ssac.track.body`), and its whole image determines its place in each view. This needs a rough place
of the body, which is triangulated with an offset and a pose. By how much the body's rendered images
must then be moved in each view shows where the images contradict this offset and pose.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ssac.arrays import Array, Mask
from ssac.clock import Clock
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.geometry.pose import depths, rays_of
from ssac.points import PointTrack
from ssac.search.object_track import ShapedTrack, shaped_track_of
from ssac.search.two_views import TwoViews
from ssac.track.body import Look, body_moves
from ssac.track.moments import View, moments_of_two, spreads_near
from ssac.track.motion import PointMotion, point_motion
from ssac.track.silhouette import Images


@dataclass(frozen=True, eq=False)
class _Shape:
    """The object's silhouettes in one view and their moments, at n times of that view's clock."""

    K: Array  # (3, 3)
    times_s: Array  # (n,)
    centres: PointMotion  # centres of area
    spreads_px2: Array  # (n, 3) second moments xx, xy, yy
    images: Images


def body_points(found: Estimate, views: TwoViews) -> tuple[PointMotion, PointMotion] | str:
    """Follow one point of the body in both views, near where an offset and a pose put it.

    Without a body, a sentence says why; it is empty where nothing could be tried.
    """
    if views.cleans is None or found.R is None or found.t is None:
        return ""
    start_s, end_s = views.common_s(found.t_d_s)
    if end_s - start_s > views.rules.body.longest_s:
        return f"it is over {views.rules.body.longest_s:.0f} s long, for which they are enough"
    if is_large(views):
        return "its images are so large that the outlines tell more"
    shapes = _shapes_of(views)
    return shapes if isinstance(shapes, str) else _followed(found, views, shapes)


def is_large(views: TwoViews) -> bool:
    """Whether an image is so large that its events' mean is far off, and tangents beat a body."""
    sizes_px = [view.size_px for view in views.alone.views if view is not None]
    return max(sizes_px, default=0.0) >= views.rules.silhouette.large_px


def by_areas(views: TwoViews, t_d_s: float) -> TwoViews | None:
    """Return the views with the silhouettes' centres as positions; None without silhouettes.

    Offsets are to be searched within `area_reach_s` of t_d [s], unless this is NaN.
    """
    shapes = _shapes_of(views)
    if isinstance(shapes, str):
        return None
    reach_s, config = views.rules.tangency.area_reach_s, views.config
    if np.isfinite(t_d_s):
        config = replace(config, interval_s=(t_d_s - reach_s, t_d_s + reach_s))
    one, other = (shape.centres for shape in shapes)
    return TwoViews(one, other, views.rig, config, clock=views.clock)


def _shapes_of(views: TwoViews) -> tuple[_Shape, _Shape] | str:
    if views.cleans is None:
        return ""
    if any(clean.on_line is not None for clean in views.cleans):
        return "a line holds the object, which belongs to its silhouette"
    shapes = []
    for k, clean in enumerate(views.cleans, start=1):
        try:
            shaped = shaped_track_of(clean, views.config)
        except SsacError:  # no window shows an object
            return ""
        shape = "" if shaped is None else _shape_of(shaped, views, k)
        if isinstance(shape, str):
            return shape
        shapes.append(shape)
    return shapes[0], shapes[1]


def _shape_of(shaped: ShapedTrack, views: TwoViews, k: int) -> _Shape | str:
    """Take the silhouettes of camera k; or say why there are none of use."""
    camera = views.rig.cam1 if k == 1 else views.rig.cam2
    if any(camera.distortion_coeffs):
        return f"camera {k}'s lens distorts its image"
    if shaped.spreads_px2 is None or shaped.images is None:
        return f"the outline does not close in camera {k}: noise, or too small an object"
    known = np.isfinite(shaped.spreads_px2[:, 0])
    times_s, centres = shaped.track.times_s[known], shaped.track.points_px[known]
    rules = views.rules.body
    track = PointTrack(times_s, centres, np.ones(len(times_s)))
    seen_at_once = replace(camera, readout_s=None)  # rows are of frames, and these are events
    motion = point_motion(track, seen_at_once, views.rules.points, rules.centre_window_s)
    return _Shape(camera.K, times_s, motion, shaped.spreads_px2[known], shaped.images.of(known))


def _followed(
    found: Estimate, views: TwoViews, shapes: tuple[_Shape, _Shape]
) -> tuple[PointMotion, PointMotion] | str:
    rules, (clock, R, t) = views.rules.body, _rounded(found)
    poses = (np.eye(3), np.zeros(3)), (R, t)

    def points(times_s: Array) -> Array:
        """Triangulate the object (n, 3), in camera 1's frame, at times (n,) of camera 1's clock."""
        rays1, rays2 = (
            rays_of(shape.K, np.round(shape.centres.at(own_s).positions_px, 4))
            for shape, own_s in zip(shapes, (times_s, clock.cam2_from_cam1(times_s)), strict=True)
        )
        depths1, depths2 = depths(R, t, rays1, rays2)
        middle = 0.5 * (rays1 * depths1[:, None] + (rays2 * depths2[:, None] - t) @ R)
        is_there = (depths1 > 0.0) & (depths2 > 0.0)
        return np.where(is_there[:, None], middle, np.nan)

    own_s = np.round(shapes[0].times_s, 6), np.round(clock.cam1_from_cam2(shapes[1].times_s), 6)
    start_s, end_s = max(one[0] for one in own_s), min(one[-1] for one in own_s)
    even_s = np.arange(start_s, end_s, rules.moments_step_s)
    looks, even = [], []
    for shape, (R_k, t_k), times_s in zip(shapes, poses, own_s, strict=True):
        focal = np.diag(shape.K)[:2]
        spreads = spreads_near(shape.spreads_px2, times_s, even_s, 1.5 * rules.moments_step_s)
        seen, there = (_in_front(points(at) @ R_k.T + t_k) for at in (even_s, times_s))
        even.append(View(R_k, focal, seen[0], np.where(seen[1][:, None], spreads, np.nan)))
        corners = shape.images.corners_px - shape.K[:2, 2]
        corners = np.where(there[1][:, None], corners, np.nan)
        looks.append(Look(times_s, R_k, focal, there[0], shape.images.shares, corners))
    steps = round(rules.open_step_s / rules.moments_step_s)
    smoothing = rules.smoothing_s / rules.moments_step_s
    moments = moments_of_two(even, smoothing, steps, rules)
    moves = body_moves(looks, even_s, moments, rules)
    if moves is None:
        return "no one rigid body is seen in both silhouettes: parts of it turn, or they are few"
    motions = []
    for k, (shape, look, move) in enumerate(zip(shapes, looks, moves, strict=True)):
        places = look.focal_px * look.points[:, :2] / look.points[:, 2:] + shape.K[:2, 2] + move
        known = np.isfinite(places[:, 0])
        if np.count_nonzero(known) < views.rules.search.min_pairs:
            return "no one rigid body is seen in both silhouettes for long"
        track = PointTrack(shape.times_s[known], places[known], np.ones(int(known.sum())))
        camera = replace((views.rig.cam1, views.rig.cam2)[k], readout_s=None)
        motions.append(point_motion(track, camera, views.rules.points, rules.point_window_s))
    return motions[0], motions[1]


def _rounded(found: Estimate) -> tuple[Clock, Array, Array]:
    """Return the clock, R and t of an estimate, rounded by less than images resolve."""
    # Else rounding errors would decide comparisons, and differently with a delayed clock.
    assert found.R is not None
    assert found.t is not None
    clock = found.clock
    clock = replace(
        clock,
        t_d_s=round(clock.t_d_s, 6),
        skew_ppm=round(clock.skew_ppm, 3),
        strays_s=np.round(clock.strays_s, 6),
    )
    turn = Rotation.from_matrix(found.R).as_rotvec()
    return clock, Rotation.from_rotvec(np.round(turn, 5)).as_matrix(), np.round(found.t, 5)


def _in_front(points: Array) -> tuple[Array, Mask]:
    """Return points (n, 3), (0, 0, 1) where unknown or behind, and the mask of the others."""
    known = np.isfinite(points[:, 2]) & (points[:, 2] > 0.0)
    return np.where(known[:, None], points, np.array([0.0, 0.0, 1.0])), known
