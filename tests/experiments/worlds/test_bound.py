"""Cramer-Rao bounds: of a true track against least squares, and of whole recordings."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from experiments.lab.cache import Cache
from experiments.studies.efficiency import BoundCell, bound_row, load_flown
from experiments.worlds.bound import (
    SAMPLES,
    Bound,
    TrueMotion,
    cramer_rao_bound,
    fisher_information,
    known_pose_bound,
    load_truth,
    mean_samples,
    method_bound,
    sharp_samples,
    tangent_samples,
)
from sim.recording import SimConfig
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import random_spline
from ssac.camera import Camera, Rig
from ssac.config import Config
from ssac.fit.least_squares import Parameters, Problem, WeighedPairs, moved, solve
from ssac.geometry.epipolar import (
    fundamental_from_pose,
    robust_deviation,
    sampson_distance,
)
from ssac.methods.tangency import TangencyConfig
from ssac.pipeline.api import two_views
from ssac.rules import FitRules
from ssac.search.two_views import TwoViews
from ssac.track.observation import Observation
from tests.experiments.reported import record_flight
from tests.recorded import kalibr_with_pose
from tests.ssac.synthetic import (
    HEIGHT,
    WIDTH,
    K,
    Scene,
    angle_deg,
    make_events,
    make_scene,
    rotation_angle_deg,
    track_pair,
)

Array = NDArray[np.float64]

NOISE_PX = 0.3
TRIALS = 300
WITHIN = 3.0 / np.sqrt(2.0 * TRIALS)  # three deviations of a root mean square of as many errors
STEP_S = 1e-4  # of differences: they err by its square
LEAST_SQUARES = 1e6  # Cauchy's loss turns nowhere


@dataclass(frozen=True)
class Flight:
    """The true track of a scene, as far as both cameras see it."""

    p1: Array
    p2: Array
    v1: Array
    v2: Array
    R: Array
    t: Array
    rig: Rig

    def information(self, noise_px: float | Array = NOISE_PX) -> Array:
        return fisher_information(self.p1, self.p2, self.v2, self.R, self.t, self.rig, noise_px)


def fly(scene: Scene, n: int = 400) -> Flight:
    times_s = scene.duration_s * (np.arange(n) + 0.5) / n
    p1, p2 = track_pair(scene, times_s)
    before, after = (track_pair(scene, times_s + step) for step in (-STEP_S, STEP_S))
    v1, v2 = ((b - a) / (2.0 * STEP_S) for a, b in zip(before, after, strict=True))
    seen = np.all((p1 >= 0) & (p1 < [WIDTH, HEIGHT]) & (p2 >= 0) & (p2 < [WIDTH, HEIGHT]), axis=1)
    t = scene.t / np.linalg.norm(scene.t)
    return Flight(p1[seen], p2[seen], v1[seen], v2[seen], scene.R, t, scene.unknown_rig)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return fly(make_scene(seed=3))


def errors_with_noise(flight: Flight, noises_px: Array, pose_is_known: bool = False) -> Array:
    """Errors (TRIALS, 3) of t_d [s] and of the angles [rad] of R and t, by least squares."""
    rng = np.random.default_rng(0)
    truth = Parameters(0.0, flight.R, flight.t)
    n = len(flight.p1)
    errors = []
    for _ in range(TRIALS):
        noise = noises_px[:, None] * rng.standard_normal((2, n, 2))
        pairs = WeighedPairs(
            np.arange(n, dtype=np.float64),
            flight.p1 + noise[0],
            flight.p2 + noise[1],
            flight.v2,
            1.0 / noises_px,
            0.0,
        )
        problem = Problem(pairs, flight.rig, FitRules(), pose_is_known, turn=LEAST_SQUARES)
        found = solve(problem, truth).parameters
        angles_deg = rotation_angle_deg(found.R, flight.R), angle_deg(found.t, flight.t)
        errors.append([found.t_d_s, *np.deg2rad(angles_deg)])
    return np.array(errors)


@pytest.mark.parametrize(("low", "high"), [(1.0, 1.0), (0.3, 3.0)])  # alike, unlike by its weights
@pytest.mark.parametrize("pose_is_known", [False, True])
def test_least_squares_reach_the_bound(
    flight: Flight, low: float, high: float, pose_is_known: bool
) -> None:
    noises_px = NOISE_PX * np.random.default_rng(1).uniform(low, high, len(flight.p1))
    bound_of = known_pose_bound if pose_is_known else cramer_rao_bound
    bound = bound_of(flight.information(noises_px))
    errors = errors_with_noise(flight, noises_px, pose_is_known)
    found = np.sqrt(np.mean(errors**2, axis=0))[: 1 if pose_is_known else 3]
    assert found == pytest.approx([bound.t_d_s, bound.R_rad, bound.t_rad][: len(found)], rel=WITHIN)
    if pose_is_known:
        assert bound == Bound(bound.t_d_s, 0.0, 0.0)


def test_the_information_is_that_of_numeric_derivatives(flight: Flight) -> None:
    def distances(step: Array) -> Array:
        at = moved(Parameters(0.0, flight.R, flight.t), step)
        F = fundamental_from_pose(K, K, at.R, at.t)
        return sampson_distance(F, flight.p1, flight.p2 + at.t_d_s * flight.v2)

    small = 1e-6
    J = np.column_stack(
        [(distances(small * k) - distances(-small * k)) / (2.0 * small) for k in np.eye(6)]
    )
    # Differences over 2e-6 of distances that are computed to 1e-12 px or so, of 1e2 px/rad.
    np.testing.assert_allclose(flight.information(1.0), J.T @ J, rtol=1e-5, atol=1e-5 * len(J))


def test_the_order_of_the_cameras_does_not_count(flight: Flight) -> None:
    bound = cramer_rao_bound(flight.information())
    swapped = Flight(
        flight.p2, flight.p1, flight.v2, flight.v1, flight.R.T, -flight.R.T @ flight.t, flight.rig
    )
    other = cramer_rao_bound(swapped.information())
    # The velocities are differences. t is another vector: its error now has a part of R's.
    assert other.t_d_s == pytest.approx(bound.t_d_s, rel=1e-5)
    assert other.R_rad == pytest.approx(bound.R_rad, rel=1e-5)


def test_the_bound_follows_noise_samples_and_speed(flight: Flight) -> None:
    bound = cramer_rao_bound(flight.information())
    noisier = cramer_rao_bound(flight.information(2.0 * NOISE_PX))
    assert noisier.t_d_s == pytest.approx(2.0 * bound.t_d_s)
    assert noisier.t_rad == pytest.approx(2.0 * bound.t_rad)
    fourfold = cramer_rao_bound(4.0 * flight.information())  # every pair four times
    assert fourfold.R_rad == pytest.approx(0.5 * bound.R_rad)
    faster = Flight(**{**vars(flight), "v2": 2.0 * flight.v2})
    assert cramer_rao_bound(faster.information()).t_d_s == pytest.approx(0.5 * bound.t_d_s)
    assert cramer_rao_bound(faster.information()).R_rad == pytest.approx(bound.R_rad)


def test_to_know_the_pose_can_only_help(flight: Flight) -> None:
    information = flight.information()
    known, unknown = known_pose_bound(information), cramer_rao_bound(information)
    assert known.t_d_s < unknown.t_d_s
    # DESIGN's 1 / (I_dd - I_dp I_pp^-1 I_pd).
    schur = information[0, 1:] @ np.linalg.solve(information[1:, 1:], information[1:, 0])
    assert unknown.t_d_s == pytest.approx((information[0, 0] - schur) ** -0.5)


def test_a_circle_does_not_tell_the_offset() -> None:
    """Turned about its axis, a uniform circle is itself a moment later."""
    centre, turn = np.array([0.0, 0.0, 5.0]), np.array([1.0, 0.0, 0.0])
    scene = make_scene(seed=0)

    def path(times_s: Array) -> Array:
        angle = 2.0 * times_s[:, None]
        return centre + turn * np.cos(angle) + np.array([0.0, 0.6, 0.8]) * np.sin(angle)

    circle = Scene(scene.R, scene.t, path, 20.0)  # type: ignore[arg-type]
    bound, usual = (cramer_rao_bound(fly(one).information()) for one in (circle, scene))
    # Infinite but for the velocities, which are differences with a relative error of 1e-8.
    assert bound.t_d_s > 1e3 * usual.t_d_s


def test_what_the_motion_does_not_tell_has_no_bound(flight: Flight) -> None:
    few = Flight(
        flight.p1[:5], flight.p2[:5], flight.v1, flight.v2[:5], flight.R, flight.t, flight.rig
    )
    assert cramer_rao_bound(few.information()).t_d_s == np.inf
    assert np.isfinite(known_pose_bound(few.information()).t_d_s)
    still = Flight(**{**vars(flight), "v2": 0.0 * flight.v2})
    assert known_pose_bound(still.information()).t_d_s == np.inf


METHODS = list(SAMPLES)
TIMES_S = np.linspace(0.5, 9.5, 181)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(seed=0, duration_s=10.0)


@pytest.fixture(scope="module")
def truth(scene: Scene) -> TrueMotion:
    T_2_1 = np.eye(4)
    T_2_1[:3, :3], T_2_1[:3, 3] = scene.R, scene.t
    times_s = np.linspace(0.0, 10.0, 2001)
    return TrueMotion(times_s, scene.path(times_s), np.stack([np.eye(4), T_2_1]))


@pytest.fixture(scope="module")
def observations(scene: Scene) -> tuple[Observation, Observation]:
    first, second = make_events(scene, 0, size_m=0.4)
    return Observation(first), Observation(second)


def views_of(
    observations: tuple[Observation, Observation], scene: Scene, t_d_s: float = 0.0
) -> TwoViews:
    cam1, cam2 = observations
    return two_views(cam1, cam2.delayed(t_d_s), scene.rig, Config(denoise=False))


def test_the_true_track_is_where_the_cameras_see_the_drone(scene: Scene, truth: TrueMotion) -> None:
    for camera, expected in enumerate(track_pair(scene, TIMES_S)):
        p_px, v_px_s = truth.seen(camera, K, TIMES_S)
        # A spline through 200 positions a second of a path with 2.5 knots a second.
        np.testing.assert_allclose(p_px, expected, atol=1e-5)
        step_s = 1e-4
        after, before = (truth.seen(camera, K, TIMES_S + step)[0] for step in (step_s, -step_s))
        # Differences over 0.2 ms: a third derivative of 1e4 px/s^3 makes 1e-4 px/s.
        np.testing.assert_allclose(v_px_s, (after - before) / (2.0 * step_s), atol=1e-2)


def test_a_rigid_move_of_the_world_changes_nothing(truth: TrueMotion) -> None:
    T = np.array([[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 7.0], [0, 0, 0, 1]])
    moved = TrueMotion(
        truth.times_s, truth.positions_W_m @ T[:3, :3].T + T[:3, 3], truth.T_C_W @ np.linalg.inv(T)
    )
    for camera in (0, 1):
        for before, after in zip(
            truth.seen(camera, K, TIMES_S), moved.seen(camera, K, TIMES_S), strict=True
        ):
            np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-9)


def test_the_noise_measured_is_that_of_the_positions(scene: Scene) -> None:
    rng = np.random.default_rng(0)
    p1, p2 = track_pair(scene, np.linspace(0.0, 10.0, 20_000))
    F = fundamental_from_pose(K, K, scene.R, scene.t)
    noise = 0.3 * rng.standard_normal((2, *p1.shape))
    distances = sampson_distance(F, p1 + noise[0], p2 + noise[1])
    assert robust_deviation(distances) == pytest.approx(0.3, rel=0.03)  # three times 1.17 / sqrt(n)
    distances[::20] = 50.0  # which shift the median to the 0.526 quantile
    assert robust_deviation(distances) == pytest.approx(0.3, rel=0.1)


def test_the_bound_is_that_of_the_true_track_at_the_valid_times(
    scene: Scene, truth: TrueMotion, observations: tuple[Observation, Observation]
) -> None:
    views = views_of(observations, scene)
    found = {one: method_bound(one, views, truth) for one in ("ssac", "ssac-known")}
    times_s = views.pairs_at(0.0).times_s
    p1, p2 = track_pair(scene, times_s)
    _, v2 = truth.seen(1, K, times_s)
    t = scene.t / np.linalg.norm(scene.t)
    sigma_px = found["ssac"].sigma_px
    information = fisher_information(p1, p2, v2, scene.R, t, scene.rig, sigma_px)
    assert found["ssac"].n_samples == len(times_s)
    assert found["ssac"].bound.t_d_s == pytest.approx(cramer_rao_bound(information).t_d_s)
    assert found["ssac"].bound.R_rad == pytest.approx(cramer_rao_bound(information).R_rad)
    known = known_pose_bound(information)
    assert found["ssac-known"].bound.t_d_s == pytest.approx(known.t_d_s)
    # Means of 1000 events on a cloud with a deviation of about 5 px.
    assert sigma_px == pytest.approx(5.0 / np.sqrt(1000.0), rel=0.5)


def test_each_method_has_its_own_samples(
    scene: Scene, truth: TrueMotion, observations: tuple[Observation, Observation]
) -> None:
    views = views_of(observations, scene)
    found = {method: method_bound(method, views, truth) for method in METHODS}
    for method in ("ssac", "joint", "tangency"):
        assert found[method].sigma_px == found[f"{method}-known"].sigma_px
        assert 0.0 < found[f"{method}-known"].bound.t_d_s < found[method].bound.t_d_s
        assert np.isfinite(found[method].bound.t_rad)
    assert len({found[method].sigma_px for method in METHODS}) == 3
    # Two tangents at each of tangency's own sample times, but where the object is out of view.
    share = found["tangency"].n_samples / (2.0 * 10.0 / TangencyConfig().step_s)
    assert 0.7 < share < 1.0


def test_the_offset_moves_timestamps_and_nothing_else(
    scene: Scene, truth: TrueMotion, observations: tuple[Observation, Observation]
) -> None:
    t_d_s = 0.5
    views = [(views_of(observations, scene, shift), truth, shift) for shift in (0.0, t_d_s)]
    for method in METHODS[::2]:
        at_zero, delayed = (method_bound(method, *of) for of in views)
        assert delayed.n_samples == at_zero.n_samples
        # Sums of times in seconds round differently, so a few events change their window.
        assert delayed.sigma_px == pytest.approx(at_zero.sigma_px, rel=1e-2)
        assert delayed.bound.t_d_s == pytest.approx(at_zero.bound.t_d_s, rel=1e-2)


def test_samples_are_of_both_views_at_one_instant(
    scene: Scene, observations: tuple[Observation, Observation]
) -> None:
    views = views_of(observations, scene)
    for sampler in (mean_samples, sharp_samples, tangent_samples):
        samples = sampler(views, 0.0)
        assert len(samples.times_s) == len(samples.p1_px) == len(samples.p2_px) > 300
        for p_px, expected in zip(
            (samples.p1_px, samples.p2_px), track_pair(scene, samples.times_s), strict=True
        ):
            # The cloud is 0.4 m wide, 16 px at 5 m, and some flights come nearer.
            assert np.median(np.linalg.norm(p_px - expected, axis=1)) < 16.0


def test_a_recording_has_all_that_the_bounds_need(
    tmp_path: Path,
    observations: tuple[Observation, Observation],
    truth: TrueMotion,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = tmp_path / "recording"
    scene = record_flight(folder)
    (folder / "rig_extrinsics.yaml").write_text(kalibr_with_pose(scene.R, scene.t))
    read = load_truth(folder)
    np.testing.assert_allclose(read.positions_W_m, truth.positions_W_m)
    np.testing.assert_allclose(read.T_C_W, truth.T_C_W)
    monkeypatch.setattr(Cache, "recording_folder", lambda *_: folder)
    cell = BoundCell(SimConfig(), 0, 0, Config(), "ssac")
    row = bound_row(cell, load_flown([cell], Cache(tmp_path)))
    views = two_views(*observations, scene.rig, Config(denoise=True))
    expected = method_bound("ssac", views, read)
    assert (row.sigma_px, row.n_samples) == (expected.sigma_px, expected.n_samples)
    assert row.t_d_bound_ms == 1e3 * expected.bound.t_d_s
    assert row.r_bound_deg == np.rad2deg(expected.bound.R_rad)
    known = bound_row(replace(cell, method="ssac-known"), load_flown([cell], Cache(tmp_path)))
    assert known.t_d_bound_ms < row.t_d_bound_ms
    assert np.isnan(known.r_bound_deg)


def test_the_bound_of_a_usual_flight_is_of_the_known_size() -> None:
    """The project's design has 0.157 ms, 0.27 deg and 0.14 deg: 0.3 px, 90 deg, 20 s, N = 400."""
    config = SimConfig()
    rig = two_view_rig(config.angle_deg)
    R, t, _ = rig.extrinsics()
    camera = Camera(K, WIDTH, HEIGHT)
    grid_s, times_s = np.linspace(0.0, 20.0, 4001), 20.0 * (np.arange(400) + 0.5) / 400
    bounds = []
    for seed in range(5):
        flight = random_spline(config.spline, np.random.default_rng(seed))
        T_C_W = np.stack([one.T_C_W for one in rig.cameras])
        motion = TrueMotion(grid_s, flight.position(grid_s), T_C_W)
        p1, _ = motion.seen(0, K, times_s)
        p2, v2 = motion.seen(1, K, times_s)
        seen = np.all((p1 > 0) & (p1 < [346, 260]) & (p2 > 0) & (p2 < [346, 260]), axis=1)
        found = cramer_rao_bound(
            fisher_information(p1[seen], p2[seen], v2[seen], R, t, Rig(camera, camera), 0.3)
        )
        bounds.append([1e3 * found.t_d_s, *np.rad2deg([found.R_rad, found.t_rad])])
    ratios = np.mean(bounds, axis=0) / [0.157, 0.27, 0.14]
    # Those are of one flight of another simulator. How wide a flight is counts most for the pose.
    assert 0.6 < ratios[0] < 1.6
    assert np.all((ratios[1:] > 0.33) & (ratios[1:] < 1.6)), ratios
