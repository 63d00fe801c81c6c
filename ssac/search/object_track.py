"""The track of the object through the events of one camera."""

from dataclasses import dataclass, replace

import numpy as np

from ssac.arrays import Array, Events
from ssac.camera import distort_points
from ssac.config import Config
from ssac.errors import SsacError
from ssac.points import PointTrack
from ssac.rules import ObjectRules, TrackRules
from ssac.search.view import seen_of
from ssac.track.clean import Clean
from ssac.track.motion import SharpTrack, motion_of
from ssac.track.objects import objects_of, seem_several
from ssac.track.silhouette import Images, silhouettes


@dataclass(frozen=True, eq=False)
class ShapedTrack:
    """A track with the shape of the object's image at each point."""

    track: PointTrack
    spreads_px2: Array | None
    """(n, 3) second moments xx, xy, yy of the silhouettes whose centres are the points. NaN where a
    point is the mean of its events instead; None if all points are."""
    images: Images | None = None  # at each point; None where there are no silhouettes

    def delayed(self, shift_us: int) -> "ShapedTrack":
        """Return the track as if the camera's clock had shown `shift_us` [us] more."""
        times_s = self.track.times_s + 1e-6 * shift_us
        return replace(self, track=replace(self.track, times_s=times_s))


def shaped_track_of(clean: Clean, config: Config) -> ShapedTrack | None:
    """Return `shaped_track_of_events` for two views, cached; None where the noise was not kept."""
    rules = config.rules
    seen = replace(rules, track=replace(rules.track, step_s=rules.body.seen_step_s))
    config = replace(config, rules=seen)
    key = "shaped", config.windows, seen.track, seen.silhouette
    if key not in clean.kept:
        events = clean.all_events()
        if events is None:
            return None
        clean.kept[key] = shaped_track_of_events(clean, events, config)
    found: ShapedTrack = clean.kept[key]
    return found


def track_of_events(clean: Clean, config: Config) -> PointTrack:
    """Follow the object through the events of one camera, in time windows as the config says.

    There is a point wherever a window holds enough events, few of them on the border. Points are in
    the distorted image. SsacError if no window shows an object.
    """
    return _followed(clean, config)[0]


def things_seen(clean: Clean, rules: ObjectRules) -> int:
    """Count the objects that a camera sees at a time; 1 if its events are not denoised."""
    if not clean.denoised or not seem_several(clean.events, clean.camera, rules):
        return 1
    found = objects_of(clean.events, clean.camera, rules)
    return found.n_seen if found.are_several else 1


def shaped_track_of_events(clean: Clean, recorded: Events, config: Config) -> ShapedTrack:
    """Follow the object's centre of area where its silhouette is known, else its events' mean."""
    (track, sharp), rules = _followed(clean, config), config.rules
    seen, given = (recorded, clean.events, clean.camera), (sharp.times_s, sharp.positions_px)
    found = silhouettes(*seen, *given, sharp.sizes_px, rules.silhouette)
    if found is None:
        return ShapedTrack(track, None)
    known = np.isfinite(found.centres_px)
    points = np.where(known, found.centres_px, track.points_px)
    shares = np.where(known[:, 0], rules.track.centre_sizes, rules.track.mean_sizes)
    track = replace(track, points_px=points, sigmas_px=_sigmas_px(sharp, shares, rules.track))
    return ShapedTrack(track, found.spreads_px2, found.images)


def _followed(clean: Clean, config: Config) -> tuple[PointTrack, SharpTrack]:
    """Return the track of the points that lie in the image, and the samples they come from."""
    motion, camera = motion_of(clean, config.windows), clean.camera
    seen = seen_of(motion, config.rules.track.step_s)
    times_s = seen.spread(int(np.count_nonzero(seen.valid)))
    sharp = motion.sharp_at(times_s)
    points = np.full((len(times_s), 2), np.nan)
    points[sharp.valid] = distort_points(camera, sharp.positions_px[sharp.valid])
    size = np.array([camera.width, camera.height])
    good = sharp.valid & np.all((points >= -0.5) & (points <= size - 0.5), axis=1)
    if not good.any():
        raise SsacError(
            f"no window of {2e3 * config.half_window_s:g} ms shows an object: {len(clean.events)} "
            "events are left after denoising; record closer to it, or give a smaller --n-min"
        )
    kept = sharp.of(good)
    sigmas = _sigmas_px(kept, config.rules.track.mean_sizes, config.rules.track)
    return PointTrack(kept.times_s, points[good], sigmas), kept


def _sigmas_px(sharp: SharpTrack, shares: Array | float, rules: TrackRules) -> Array:
    return np.asarray(np.maximum(shares * sharp.sizes_px, rules.least_sigma_px))
