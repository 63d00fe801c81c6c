"""A synthetic flight before many frame cameras, and the links that their pairs would give."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from ssac import Camera, Clock, Config, PointTrack
from ssac.network.graph import Link, Pair
from ssac.network.solve import NetworkAnswer, solve_network
from ssac.network.state import Sightings, sightings
from ssac.rules import Rules
from ssac.search.object_track import ShapedTrack
from tests.ssac.synthetic import EXACT_PX, project

RULES, PLAIN = Rules(), Config(skew_prior_ppm=50.0)
DURATION_S, FPS, NOISE_PX = 16.0, 20.0, 0.4
K = np.array([[900.0, 0.0, 480.0], [0.0, 900.0, 300.0], [0.0, 0.0, 1.0]])
CAMERA = Camera(K, 960, 600, intrinsics_std_px=EXACT_PX)


@dataclass(frozen=True)
class Flight:
    """Sightings of a flight by the cameras round it, and the ground truth."""

    seen: list[Sightings]
    clocks: list[Clock]  # from the first camera's time to each camera's
    poses: list[tuple[np.ndarray, np.ndarray]]  # x_k = R X + t, X in the first camera's frame
    path: BSpline  # in the first camera's frame and on its clock [m]

    def image_px(self, k: int, times_s: np.ndarray) -> np.ndarray:
        """Return the object's images in camera k at the first clock's times, without noise."""
        R, t = self.poses[k]
        return project(self.path(times_s) @ R.T + t, CAMERA.K)

    def link(self, a: int, b: int, off_s: float = 0.0, rng=None) -> Link:
        """Return a pair's link, its offset wrong by `off_s`; with `rng`, R by half a degree."""
        (R_a, t_a), (R_b, t_b) = self.poses[a], self.poses[b]
        R = R_b @ R_a.T
        t = t_b - R @ t_a
        if rng is not None:
            R = Rotation.from_rotvec(rng.normal(0.0, 0.01, 3)).as_matrix() @ R
        delay_a_s, delay_b_s = self.clocks[a].t_d_s, self.clocks[b].t_d_s
        clock = Clock(delay_b_s - delay_a_s + off_s, 0.0, 8.0 + delay_a_s)
        return Link(clock, True, 0.003, R, t / np.linalg.norm(t))

    def links(self, seed: int = 0) -> dict[Pair, Link]:
        """Return the links of all pairs, with offsets good to some 5 ms."""
        rng = np.random.default_rng(seed)
        pairs = combinations(range(len(self.seen)), 2)
        return {(a, b): self.link(a, b, rng.normal(0.0, 0.005), rng) for a, b in pairs}

    def shown_s(self, k: int, time_s: float) -> float:
        """Return by how much camera k's clock shows more than the first's."""
        return float(self.clocks[k].cam2_from_cam1(time_s) - time_s)

    @property
    def distance_m(self) -> float:
        """Distance between the first two cameras."""
        return float(np.linalg.norm(self.poses[1][1]))

    def solved(
        self, links: dict[Pair, Link] | None = None, config: Config = PLAIN
    ) -> NetworkAnswer:
        """Solve the network with the links of all pairs, or with other links."""
        links = self.links() if links is None else links
        return solve_network(self.seen, links, config, self.distance_m)


def seen_by(track, name, has_frames=False, camera=CAMERA, spreads_px2=None) -> Sightings:
    shaped = ShapedTrack(track, spreads_px2)
    return sightings(shaped, camera, name, has_frames, RULES.points)


def make_flight(
    n_cameras: int = 4, seed: int = 0, noise_px: float = NOISE_PX, side_deg: float = 60.0
) -> Flight:
    """Make a flight, seen up to `side_deg` from both sides; the seed changes only the noise."""
    rng = np.random.default_rng(5)
    knots_s = 0.8 * np.arange(-5.0, DURATION_S / 0.8 + 6.0)
    spread = rng.uniform(-1.0, 1.0, (len(knots_s) - 6, 3)) * [7.0, 5.0, 7.0]
    angles, t = np.deg2rad(np.linspace(-side_deg, side_deg, n_cameras)), np.array([0.0, 0.0, 20.0])
    R_1, *_ = from_world = Rotation.from_euler("y", angles).as_matrix()
    poses = [(R @ R_1.T, t - R @ R_1.T @ t) for R in from_world]
    path = BSpline(knots_s, spread @ R_1.T + t, 5)
    delays_s = np.concatenate([[0.0], rng.uniform(-30.0, 30.0, n_cameras - 1)])
    skews_ppm = np.concatenate([[0.0], rng.normal(0.0, 30.0, n_cameras - 1)])
    clocks = [Clock(*of_one, 8.0) for of_one in zip(delays_s, skews_ppm, strict=True)]
    noise = np.random.default_rng([seed, 7])
    seen = []
    for k, (R, t) in enumerate(poses):
        times_s = np.arange(0.3, DURATION_S - 0.3, 1.0 / FPS) + 0.013 * k
        pixels = project(path(times_s) @ R.T + t, CAMERA.K)
        pixels += noise.normal(0.0, noise_px, pixels.shape)
        inside = np.all((pixels > 0.0) & (pixels < [959.0, 599.0]), axis=1)
        track = PointTrack(clocks[k].cam2_from_cam1(times_s)[inside], pixels[inside])
        seen.append(seen_by(track, f"cam{k + 1}"))
    return Flight(seen, clocks, poses, path)
