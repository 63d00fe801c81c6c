"""Cramer-Rao bounds: of a true track, compared with least squares, and of whole recordings."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.lab.cache import Cache
from experiments.lab.recorded import FlightTruth, Pair, load_pair, load_truth
from experiments.studies import efficiency
from experiments.studies.efficiency import SAMPLES, BoundCell, BoundRow, bound_row
from sim.recording import SimConfig
from ssac.arrays import Array
from ssac.config import Config
from ssac.fit.least_squares import Parameters, Problem, WeighedPairs, solve
from ssac.geometry.epipolar import fundamental_from_pose, robust_deviation, sampson_distance
from ssac.pipeline.api import two_views
from ssac.rules import FitRules, TangencyRules
from ssac.search.two_views import TwoViews
from tests.ssac import synthetic
from tests.ssac.synthetic import K, Scene, make_scene, track_pair

TRIALS = 300
WITHIN = 3.0 / np.sqrt(2.0 * TRIALS)  # three standard errors of an RMS of so many errors
STEP_S = 1e-4  # of differences, whose error grows with its square
LEAST_SQUARES = 1e6  # Cauchy's loss is quadratic up to there


def rate_of(place: Callable[[Array], Array], times_s: Array) -> Array:
    return (place(times_s + STEP_S) - place(times_s - STEP_S)) / (2.0 * STEP_S)


def fly(scene: Scene, n: int = 400) -> dict[str, Any]:
    """Return what `fisher_information` asks for, of a true track at n times, also out of view."""
    times_s = scene.duration_s * (np.arange(n) + 0.5) / n
    p1, p2 = track_pair(scene, times_s)
    v2 = rate_of(lambda at_s: track_pair(scene, at_s)[1], times_s)
    of_scene = {"R": scene.R, "t": scene.t / np.linalg.norm(scene.t), "rig": scene.unknown_rig}
    return {"p1_px": p1, "p2_px": p2, "v2_px_s": v2, "noise_px": 0.3} | of_scene


def information(flight: dict[str, Any], **changes: Any) -> Array:
    return efficiency.fisher_information(**flight | changes)


def bound_of(flight: dict[str, Any], **changes: Any) -> tuple[float, float, float]:
    return efficiency.cramer_rao_bound(information(flight, **changes))


FLOWN = make_scene(seed=3)
FLIGHT = fly(FLOWN)


@pytest.mark.parametrize(("low", "high"), [(1.0, 1.0), (0.3, 3.0)])  # equal, or known by weights
@pytest.mark.parametrize("pose_is_known", [False, True])
def test_least_squares_reach_the_bound(low, high, pose_is_known) -> None:
    noises_px = 0.3 * np.random.default_rng(1).uniform(low, high, len(FLIGHT["p1_px"]))
    least = efficiency.cramer_rao_bound(information(FLIGHT, noise_px=noises_px), pose_is_known)
    rng, errors = np.random.default_rng(0), []
    R, t, true_px = FLIGHT["R"], FLIGHT["t"], np.array([FLIGHT["p1_px"], FLIGHT["p2_px"]])
    times, weights = np.arange(len(noises_px), dtype=np.float64), 1.0 / noises_px
    for _ in range(TRIALS):
        p1, p2 = true_px + noises_px[:, None] * rng.standard_normal(true_px.shape)
        pairs = WeighedPairs(times, p1, p2, FLIGHT["v2_px_s"], weights, 0.0)
        problem = Problem(pairs, FLIGHT["rig"], FitRules(), pose_is_known, turn=LEAST_SQUARES)
        made = solve(problem, Parameters(0.0, R, t)).parameters
        angles_deg = synthetic.rotation_angle_deg(made.R, R), synthetic.angle_deg(made.t, t)
        errors.append([made.t_d_s, *np.deg2rad(angles_deg)])  # [s, rad, rad]
    found = np.sqrt(np.mean(np.square(errors), axis=0))[: 1 if pose_is_known else 3]
    assert found == pytest.approx(least[: len(found)], rel=WITHIN)
    assert np.isnan(least[1:]).all() == pose_is_known


def test_the_bound_follows_the_speed_and_not_the_order_of_cameras() -> None:
    usual, faster = bound_of(FLIGHT), bound_of(FLIGHT, v2_px_s=2.0 * FLIGHT["v2_px_s"])
    assert faster[:2] == pytest.approx((0.5 * usual[0], usual[1]))
    R, t = FLOWN.R, FLOWN.t
    swapped = bound_of(fly(Scene(R.T, -R.T @ t, lambda at_s: FLOWN.path(at_s) @ R.T + t, 20.0)))
    # 1e-5 as velocities are differences. t is another vector, whose error includes some of R's.
    assert swapped[:2] == pytest.approx(usual[:2], rel=1e-5)


def test_what_the_motion_does_not_tell_has_no_bound() -> None:
    few = {name: FLIGHT[name][:5] for name in ("p1_px", "p2_px", "v2_px_s")}
    assert bound_of(FLIGHT, **few)[0] == np.inf
    assert np.isfinite(efficiency.cramer_rao_bound(information(FLIGHT, **few), True)[0])
    still = information(FLIGHT, v2_px_s=0.0 * FLIGHT["v2_px_s"])
    assert efficiency.cramer_rao_bound(still, True)[0] == np.inf

    def circle(times_s: Array) -> Array:
        """Uniform motion on a circle: a delay is the same as a rotation about the axis."""
        angle = 2.0 * times_s
        return np.column_stack([np.cos(angle), 0.6 * np.sin(angle), 0.8 * np.sin(angle) + 5.0])

    # It would be infinite if velocities were exact: as differences, they err by 1e-8.
    assert bound_of(fly(Scene(FLOWN.R, FLOWN.t, circle, 20.0)))[0] > 1e3 * bound_of(FLIGHT)[0]


TIMES_S = np.linspace(0.5, 9.5, 181)
SCENE = make_scene(seed=0, duration_s=10.0)  # `flight_folder`'s, in camera 1's frame


@pytest.fixture(scope="module")
def pair(flight_folder: Path) -> Pair:
    return load_pair(flight_folder)


@pytest.fixture(scope="module")
def truth(flight_folder: Path) -> FlightTruth:
    return load_truth(flight_folder)


def views_of(pair: Pair, t_d_s: float = 0.0, denoise: bool = False) -> TwoViews:
    return two_views(pair.cam1, pair.cam2.delayed(t_d_s), SCENE.rig, Config(denoise=denoise))


def method_bound(method: str, views: TwoViews, truth: FlightTruth, t_d_s: float = 0.0) -> BoundRow:
    return bound_row(BoundCell(SimConfig(), 0, 0, Config(), method), (views, truth), t_d_s)


def test_the_true_track_is_where_the_cameras_see_the_drone(truth: FlightTruth) -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    T = np.block([[turn, np.array([[3.0], [-2.0], [7.0]])], [np.zeros((1, 3)), np.ones((1, 1))]])
    positions_m = truth.positions_m @ turn.T + T[:3, 3]
    moved_world = replace(truth, positions_m=positions_m, T_C_W=truth.T_C_W @ np.linalg.inv(T))
    for camera, expected in enumerate(track_pair(SCENE, TIMES_S)):
        p_px, v_px_s = efficiency.seen(truth, camera, K, TIMES_S)
        # The error of a spline through 200 positions/s of a path with 2.5 knots/s.
        np.testing.assert_allclose(p_px, expected, atol=1e-5)
        rates = rate_of(lambda at_s, of=camera: efficiency.seen(truth, of, K, at_s)[0], TIMES_S)
        # Differences over 0.2 ms err by 1e-4 px/s, where the third derivative is 1e4 px/s^3.
        np.testing.assert_allclose(v_px_s, rates, atol=1e-2)
        moved = efficiency.seen(moved_world, camera, K, TIMES_S)
        np.testing.assert_allclose(moved, (p_px, v_px_s), rtol=1e-9, atol=1e-9)


def test_the_noise_measured_is_that_of_the_positions() -> None:
    p1, p2 = track_pair(SCENE, np.linspace(0.0, 10.0, 20_000))
    F = fundamental_from_pose(K, K, SCENE.R, SCENE.t)
    noise = 0.3 * np.random.default_rng(0).standard_normal((2, *p1.shape))
    distances = sampson_distance(F, p1 + noise[0], p2 + noise[1])
    assert robust_deviation(distances) == pytest.approx(0.3, rel=0.03)  # three times 1.17 / sqrt(n)
    distances[::20] = 50.0  # the median of all is now the 0.526 quantile of the others
    assert robust_deviation(distances) == pytest.approx(0.3, rel=0.1)


def test_the_bound_is_that_of_the_true_track_at_the_valid_times(truth, pair) -> None:
    views = views_of(pair)
    found, of_known = (method_bound(one, views, truth) for one in ("ssac", "ssac-known"))
    times_s = views.pairs_at(0.0).times_s
    p1, p2 = track_pair(SCENE, times_s)
    _, v2 = efficiency.seen(truth, 1, K, times_s)
    t = SCENE.t / np.linalg.norm(SCENE.t)
    information = efficiency.fisher_information(p1, p2, v2, SCENE.R, t, SCENE.rig, found.sigma_px)
    assert found.n_samples == len(times_s)
    for row, is_known in ((found, False), (of_known, True)):
        bound_s, *pose_rad = efficiency.cramer_rao_bound(information, is_known)
        bounds = 1e3 * bound_s, *np.rad2deg(pose_rad)
        found_bounds = row.t_d_bound_ms, row.r_bound_deg, row.t_bound_deg
        assert found_bounds == pytest.approx(bounds, nan_ok=True)
    # The mean of 1000 events of a cloud with a standard deviation of about 5 px.
    assert found.sigma_px == pytest.approx(5.0 / np.sqrt(1000.0), rel=0.5)


def test_each_method_has_its_own_samples_and_an_offset_moves_timestamps_alone(truth, pair) -> None:
    views, t_d_s = views_of(pair), 0.5
    late = views_of(pair, t_d_s)
    found = {method: method_bound(method, views, truth) for method in SAMPLES}
    for method in ("ssac", "joint", "tangency"):
        assert found[method].sigma_px == found[f"{method}-known"].sigma_px
        assert 0.0 < found[f"{method}-known"].t_d_bound_ms < found[method].t_d_bound_ms
        assert np.isfinite(found[method].t_bound_deg)
        delayed = method_bound(method, late, truth, t_d_s)
        assert delayed.n_samples == found[method].n_samples
        # Sums of times in seconds round differently, so a few events change their window.
        assert delayed.sigma_px == pytest.approx(found[method].sigma_px, rel=1e-2)
        assert delayed.t_d_bound_ms == pytest.approx(found[method].t_d_bound_ms, rel=1e-2)
    assert len({one.sigma_px for one in found.values()}) == 3
    # tangency has two tangents at each of its sample times, unless the object is out of view.
    assert 0.7 < found["tangency"].n_samples / (2.0 * 10.0 / TangencyRules().step_s) < 1.0


def test_samples_are_of_both_views_at_one_instant(pair) -> None:
    for sampler in set(SAMPLES.values()):
        samples = sampler(views_of(pair), 0.0)
        assert len(samples.times_s) == len(samples.p1_px) == len(samples.p2_px) > 300
        found_px = samples.p1_px, samples.p2_px
        off_px = np.linalg.norm(np.subtract(found_px, track_pair(SCENE, samples.times_s)), axis=2)
        # The cloud is 0.4 m wide, which is 16 px at 5 m and more on nearer parts of the flight.
        assert (np.median(off_px, axis=1) < 16.0).all()


def test_a_recording_has_all_that_the_bounds_need(flight_folder, pair, truth, monkeypatch) -> None:
    monkeypatch.setattr(Cache, "recording_folder", lambda *_: flight_folder)
    cell = BoundCell(SimConfig(), 0, 0, Config(), "ssac")
    row = bound_row(cell, efficiency.load_flown([cell], Cache()))
    assert row == method_bound("ssac", views_of(pair, denoise=True), truth)
