"""The object's positions in two views, paired by a clock, and how rolling shutters shift them.

The sign convention of the whole package: t_cam2 = t_cam1 + t_d, so that p2(t + t_d) pairs with
p1(t), as in the paper's Eq. 3, and t_d is positive when camera 2's clock shows more.
Deviation: the paper's Eq. 1 has the opposite sign, which contradicts its Eq. 3.
"""

from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ssac.arrays import Array, Mask
from ssac.camera import MAX_READOUT_S, Rig, distort_points
from ssac.clock import Clock
from ssac.config import MIN_SWINGS, Config
from ssac.estimate import Estimate
from ssac.geometry.pose import rays_of
from ssac.rules import Rules
from ssac.search.view import Alone, seen_by_both, swing_hz
from ssac.track.clean import Clean
from ssac.track.motion import Motion, PointMotion, SharpTrack, motion_of


@dataclass(frozen=True)
class Pairs:
    """The object's positions in both views, paired for M offsets at N times."""

    t_d_s: Array  # (M,) [s] the offsets
    times_s: Array  # (M, N) [s], camera 1's clock
    p1_px: Array  # (M, N, 2) p1(t), undistorted
    p2_px: Array  # (M, N, 2) p2(t + t_d), undistorted
    valid: Mask  # (M, N) both samples pass the rules of the paper's Sec. IV-A

    def valid_positions(self, m: int) -> tuple[Array, Array]:
        """p1 and p2 (n, 2) [px] of the valid pairs of offset m."""
        return self.p1_px[m, self.valid[m]], self.p2_px[m, self.valid[m]]


@dataclass(frozen=True)
class PairsAt:
    """The valid pairs at one offset."""

    t_d_s: float  # the offset
    times_s: Array  # (n,) camera 1's clock
    p1_px: Array  # (n, 2)
    p2_px: Array  # (n, 2)

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def points_px(self) -> tuple[Array, Array]:
        """p1 and p2, each (n, 2)."""
        return self.p1_px, self.p2_px

    def between(self, first_s: float, last_s: float) -> "PairsAt":
        """Give the pairs from one time [s] of camera 1's clock up to another."""
        inside = (self.times_s >= first_s) & (self.times_s < last_s)
        points_px = self.p1_px[inside], self.p2_px[inside]
        return PairsAt(self.t_d_s, self.times_s[inside], *points_px)

    def rays(self, rig: Rig) -> tuple[Array, Array]:
        """Directions (n, 3), z = 1, of p1 and p2, each in its camera's frame."""
        return rays_of(rig.cam1.K, self.p1_px), rays_of(rig.cam2.K, self.p2_px)


@dataclass(frozen=True, eq=False)
class TwoViews:
    """One object's motions in two cameras, with the rig and the config that a method is given.

    Only `on_clock_2` converts times of camera 1's clock to camera 2's.
    """

    motion1: Motion  # of the object in camera 1, on camera 1's clock
    motion2: Motion  # of the object in camera 2, on camera 2's clock
    rig: Rig  # both cameras; with extrinsics only where a method may use them
    config: Config  # resolved: see `Config.resolved`
    pose_is_known: bool = False  # the rig's extrinsics hold: only the offset is in question
    noise_hz: float = 0.0  # of an ordinary pixel, of the noisier camera
    clock: Clock = field(default_factory=Clock)  # of camera 2, without the offset that is tried
    alone: Alone = field(default=None, repr=False)  # type: ignore[assignment] # kept while it holds
    cleans: tuple[Clean, Clean] | None = field(default=None, repr=False)  # that the motions are of
    refined: dict[Hashable, Estimate] = field(init=False, repr=False)  # kept, by their starts

    def under(self, clock: Clock) -> "TwoViews":
        """Return the same views with the skew and the strays of a clock, but not its offset."""
        if clock.is_delay and self.clock.is_delay:
            return self
        return replace(self, clock=replace(clock, t_d_s=0.0))

    def on_clock_2(self, times_s: Array, t_d_s: Array | float) -> Array:
        """Return what camera 2's clock shows [s] at times of camera 1's, at the offset `t_d_s`."""
        shown_s = np.asarray(times_s + t_d_s)
        return shown_s if self.clock.is_delay else shown_s + self.clock.added_s(times_s)

    def __post_init__(self) -> None:
        object.__setattr__(self, "refined", {})
        longest_s = float(np.ptp(self.config.offsets_s))
        alone = Alone(self.motions, longest_s, self.rules.view, self.rules.blind)
        if self.alone != alone:
            object.__setattr__(self, "alone", alone)

    def by(self, **rules: Any) -> "TwoViews":
        """Return the same views with the rules of the named stages replaced."""
        return replace(self, config=replace(self.config, rules=replace(self.rules, **rules)))

    @property
    def motions(self) -> tuple[Motion, Motion]:
        """Both motions."""
        return self.motion1, self.motion2

    @property
    def rules(self) -> Rules:
        """The config's rules, by which each stage decides."""
        return self.config.rules

    @property
    def object_px(self) -> float:
        """Root sum of squares of both views' rms object sizes [px]; NaN if a view has none."""
        one, other = (np.nan if view is None else view.size_px for view in self.alone.views)
        return float(np.hypot(one, other))

    def overlap_s(self, t_d_s: Array) -> tuple[Array, Array]:
        """Start and end (M,) [s] of what both recordings cover at offsets (M,), if start < end."""
        (start1, end1), (start2, end2) = self.motion1.span_s, self.motion2.span_s
        return np.maximum(start1, start2 - t_d_s), np.minimum(end1, end2 - t_d_s)

    def common_s(self, t_d_s: float) -> tuple[float, float]:
        """Start and end [s] of what both recordings cover at an offset."""
        (start,), (end,) = self.overlap_s(np.array([t_d_s]))
        return float(start), float(end)

    def sample_times(self, t_d_s: Array, n_samples: int | None = None) -> Array:
        """Spread N times (M, N) [s], camera 1's clock, evenly over the overlap at offsets (M,).

        Deviation: where both cameras see the object in less than half of the overlap, the times are
        spread evenly over that part. The paper's samples would nearly all be invalid.
        """
        n = n_samples or self.config.n_samples
        start, end = self.overlap_s(t_d_s)
        times_s = start[:, None] + (end - start)[:, None] * ((np.arange(n) + 0.5) / n)
        seen, even_share = self.alone.seen, self.rules.view.even_share
        if seen is not None:
            for m, offset_s in enumerate(t_d_s):
                seen_s = seen_by_both(*seen, float(offset_s), n, even_share)
                times_s[m] = times_s[m] if seen_s is None else seen_s
        return np.asarray(times_s)

    def pairs(self, t_d_s: Array, n_samples: int | None = None) -> Pairs:
        """Pair p1(t_i) with p2(t_i + t_d) at N times for each of the offsets (M,) [s]."""
        times_s = self.sample_times(t_d_s, n_samples)
        track1 = self.motion1.at(times_s)
        track2 = self.motion2.at(self.on_clock_2(times_s, t_d_s[:, None]))
        valid = track1.valid & track2.valid
        return Pairs(t_d_s, times_s, track1.positions_px, track2.positions_px, valid)

    def pairs_at(self, t_d_s: float, n_samples: int | None = None) -> PairsAt:
        """Give the valid pairs at one offset [s]."""
        pairs = self.pairs(np.array([t_d_s]), n_samples)
        return PairsAt(t_d_s, pairs.times_s[0, pairs.valid[0]], *pairs.valid_positions(0))

    def sharp_at(self, times_s: Array, t_d_s: float) -> tuple[SharpTrack, SharpTrack]:
        """Both views' sharp positions at those of times (n,) [s], camera 1's, that both have."""
        one = self.motion1.sharp_at(times_s)
        other = self.motion2.sharp_at(self.on_clock_2(times_s, t_d_s))
        return one.of(one.valid & other.valid), other.of(one.valid & other.valid)

    def swings(self, pairs: PairsAt) -> float:
        """How many times the object goes to and fro while both see it: the lesser of two counts."""
        if len(pairs) < 2:
            return 0.0
        steps_s = np.diff(pairs.times_s)  # of long recordings longer than a gap
        duration_s = float(np.sum(np.minimum(steps_s, max(0.5, 2.0 * float(np.median(steps_s))))))
        some_s = pairs.times_s[:: -(-len(pairs) // 100)]  # enough for the rms speed
        velocities_1 = self.motion1.velocities_at(some_s)
        velocities_2 = self.motion2.velocities_at(self.on_clock_2(some_s, pairs.t_d_s))
        swings_1 = duration_s * swing_hz(pairs.p1_px, velocities_1)
        return min(swings_1, duration_s * swing_hz(pairs.p2_px, velocities_2))

    def lasting_share(self, t_d_s: float, n_samples: int | None = None) -> float:
        """Share, up to 1, of an object's bias that remains: its attitude changes at each swing."""
        n_swings = self.swings(self.pairs_at(t_d_s, n_samples))
        return float(min(1.0, (MIN_SWINGS / max(n_swings, 1e-12)) ** 2))


def views_of(one: Clean, other: Clean, rig: Rig, config: Config) -> TwoViews:
    """Prepare the views of two cameras' denoised recordings for sampling: the paper's Sec. IV-A."""
    motions = motion_of(one, config.windows), motion_of(other, config.windows)
    noise_hz = max(one.background_hz, other.background_hz)
    return TwoViews(*motions, rig, config, noise_hz=noise_hz, cleans=(one, other))


@dataclass(frozen=True, eq=False)
class Shutters:
    """The cameras, k of the two, whose readout is to be estimated.

    A row is exposed later than the frame's time by the readout times the row's share of the height.
    A readout that is longer by d thus puts the object at a time t where it was d times that share
    before: its image moves by that much against its velocity.
    """

    cameras: tuple[int, ...]  # of 0 and 1
    expected_s: Array  # (k,) means of the readouts' prior
    deviations_s: Array  # (k,) standard deviations of that prior
    longest_s: Array  # (k,) frame intervals, MAX_READOUT_S at most

    def views(self, views: TwoViews, readouts_s: Array) -> TwoViews:
        """Return both views with the points at the times that readouts (k,) [s] give them."""
        motions = [*views.motions]
        for k, readout_s in zip(self.cameras, readouts_s.tolist(), strict=True):
            motion = motions[k]
            if isinstance(motion, PointMotion):
                motions[k] = motion.read_out(readout_s)
        return replace(views, motion1=motions[0], motion2=motions[1]) if self.cameras else views

    def readouts_s(self, estimate: Estimate) -> Array:
        """Give the readouts (k,) [s] of an estimate, or those expected where it has none."""
        found_s = estimate.readouts_s[list(self.cameras)]
        return np.where(np.isnan(found_s), self.expected_s, found_s)

    def moves(self, views: TwoViews, times_s: tuple[Array, Array]) -> list[tuple[Array, Array]]:
        """Return the derivatives (n, 2) [px/s] of both images' positions by each of k readouts.

        The views have their readouts set, and are sampled at times (n,) of each camera's clock.
        """
        found = []
        for k in self.cameras:
            camera = (views.rig.cam1, views.rig.cam2)[k]
            track = views.motions[k].sharp_at(times_s[k])
            rows = distort_points(camera, track.positions_px)[:, 1] / max(camera.height - 1, 1)
            motion = views.motions[k]  # noise of short windows' velocities passes for information
            wide = replace(motion, half_window_s=3.0 * motion.half_window_s)
            moved = -rows[:, None] * wide.sharp_at(times_s[k]).velocities_px_s
            nothing = np.zeros_like(moved)
            found.append((moved, nothing) if k == 0 else (nothing, moved))
        return found

    def within(self, readouts_s: Array) -> Array:
        """Clip readouts (k,) [s] to the range from 0 to `longest_s`."""
        return np.asarray(np.clip(readouts_s, 0.0, self.longest_s))


def shutters_of(views: TwoViews) -> Shutters:
    """Select the cameras whose readouts are to be estimated: with tracks, and not exactly known."""
    found, cameras = [], (views.rig.cam1, views.rig.cam2)
    for k, motion in enumerate(views.motions):
        if cameras[k].readout_std_s > 0.0 and isinstance(motion, PointMotion):
            expected_s = cameras[k].readout_s or 0.0
            longest_s = min(motion.interval_s, MAX_READOUT_S)
            found.append((k, expected_s, cameras[k].readout_std_s, longest_s))
    numbers = np.array(found, np.float64).reshape(-1, 4).T
    return Shutters(tuple(k for k, *_ in found), *numbers[1:])


def as_found(views: TwoViews, estimate: Estimate) -> TwoViews:
    """Return both views with the readouts, skew and strays of an estimate, paired at any offset."""
    shutters = shutters_of(views)
    return shutters.views(views, shutters.readouts_s(estimate)).under(estimate.clock)
