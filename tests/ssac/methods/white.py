"""Tracks with white noise in place of events, on clocks of their own: no events, no simulator."""

from dataclasses import replace

import numpy as np

from ssac.clock import Clock
from ssac.config import Config
from ssac.estimate import Estimate
from ssac.search.two_views import TwoViews
from ssac.track.motion import SharpTrack, Track
from tests.ssac.synthetic import track_pair

T_D_S = 0.05
SIZE_PX = 10.0  # of each image
DELAYED = Clock(T_D_S)


class WhiteMotion:
    """Stands for an ObjectMotion: the true track plus the same noise for sample i at any time."""

    def __init__(self, scene, view, clock, noise):
        self.scene, self.view, self.clock, self.noise = scene, view, clock, noise
        self.jump = (np.inf, 0.0)  # camera 1's time of it, and its size [s]
        self.span_s = tuple(clock.cam2_from_cam1(np.array([0.0, scene.duration_s])).tolist())

    def _true(self, times_s):
        seen_s, (at_s, size_s) = self.clock.cam1_from_cam2(times_s), self.jump
        seen_s = np.where(seen_s >= at_s + size_s, seen_s - size_s, seen_s)
        return track_pair(self.scene, seen_s)[self.view]

    def at(self, times_s):
        counts, valid = np.full(times_s.shape, 1000), np.ones(times_s.shape, dtype=bool)
        return Track(times_s, self._true(times_s) + self.noise(times_s.shape), counts, valid)

    def velocities_at(self, times_s):
        return (self._true(times_s + 1e-4) - self._true(times_s - 1e-4)) / 2e-4

    def sharp_at(self, times_s):
        track, velocities = self.at(times_s), self.velocities_at(times_s)
        sizes_px = np.full(times_s.shape, SIZE_PX)
        return SharpTrack(
            times_s, track.positions_px, track.counts, track.valid, velocities, sizes_px
        )


def white_views(
    scene, sigma_px, seed=0, shown=DELAYED, known=False, bias_px=0.0, jump=None, **options
):
    """Both views of a flight; camera 2 shows a clock, and its points are off by a bias downward."""

    def noise_of(view):
        def noise(shape):
            drawn = np.random.default_rng((seed, view)).normal(0.0, sigma_px, (*shape, 2))
            return drawn + np.array([0.0, bias_px * view])

        return noise

    motions = [WhiteMotion(scene, k, (Clock(), shown)[k], noise_of(k)) for k in (0, 1)]
    motions[1].jump = jump or motions[1].jump
    return TwoViews(*motions, scene.rig, Config(denoise=False, **options), known)


def truth_of(scene, **fields):
    """The true offset and pose as an estimate."""
    true = Estimate("joint", t_d_s=T_D_S, R=scene.R, t=scene.t / np.linalg.norm(scene.t))
    return replace(true, **fields)
