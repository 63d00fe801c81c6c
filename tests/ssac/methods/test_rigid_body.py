"""One point of a body of balls in two views, and what it makes of an estimate by tangents."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac import two_views
from ssac.camera import Camera, Rig
from ssac.config import Config
from ssac.estimate import Estimate
from ssac.geometry.epipolar import fundamental_from_pose, sampson_distance
from ssac.geometry.pose import moved_pose, pose_step
from ssac.methods import rigid_body
from ssac.methods import tangency as by_tangents
from ssac.points import PointTrack
from ssac.rules import PointRules
from ssac.search.object_track import ShapedTrack
from ssac.search.two_views import TwoViews
from ssac.track.motion import point_motion
from ssac.track.silhouette import Images
from tests.ssac import box, synthetic
from tests.ssac.balls import BODY_M, attitudes, drawn_at
from tests.ssac.synthetic import CAMERA, FOCAL_PX, K, make_scene

T_D_S, WIDTH = 0.05, 51
SCENE = make_scene(1, duration_s=5.0)
TIMES_S = np.arange(0.5, 4.5, 0.025)
T = SCENE.t / np.linalg.norm(SCENE.t)


@cache
def shaped() -> list[ShapedTrack]:
    """What silhouettes would tell in both views; the second is sampled at other times."""
    found = []
    for k, (R, t) in enumerate(((np.eye(3), np.zeros(3)), (SCENE.R, SCENE.t))):
        times_s = TIMES_S + 0.01 * k
        # Near the point that both cameras look at, so that all of it is in view.
        points = 0.5 * (SCENE.path(times_s) + np.array([0.0, 0.0, 5.0])) @ R.T + t
        turns = Rotation.from_matrix(R) * attitudes(times_s, 40.0)
        shares, corners, off, spreads = drawn_at(BODY_M, turns, points, FOCAL_PX, WIDTH)
        centres = FOCAL_PX * points[:, :2] / points[:, 2:] + off + K[:2, 2]
        track = PointTrack(times_s + T_D_S * k, centres, np.ones(len(times_s)))
        images = Images(shares, np.rint(corners + K[:2, 2]).astype(np.int64))
        found.append(ShapedTrack(track, spreads, images))
    return found


def views(cam1: Camera = CAMERA, cam2: Camera = CAMERA) -> TwoViews:
    motions = [point_motion(one.track, CAMERA, PointRules()) for one in shaped()]
    return TwoViews(*motions, Rig(cam1, cam2), Config())


def off_the_truth() -> Estimate:
    """An estimate half a millisecond, 0.3 deg and 0.2 deg off."""
    R, t = moved_pose(SCENE.R, T, np.array([0.003, -0.004, 0.002, 0.003, 0.002]))
    return Estimate("tangency", t_d_s=T_D_S + 0.0005, R=R, t=t)


def followed(found: Estimate, order: tuple[int, int] = (0, 1)):
    shapes = [rigid_body._shape_of(shaped()[k], views(), k + 1) for k in order]
    return rigid_body._followed(found, views(), tuple(shapes))


@cache
def body():
    return followed(off_the_truth())


def distances_px(motions) -> np.ndarray:
    """Of pairs from their true epipolar lines."""
    times_s = np.arange(0.8, 4.2, 0.02)
    one, two = motions[0].sharp_at(times_s), motions[1].sharp_at(times_s + T_D_S)
    known = one.valid & two.valid
    assert known.mean() > 0.8
    points = one.positions_px[known], two.positions_px[known]
    return sampson_distance(fundamental_from_pose(K, K, SCENE.R, T), *points)


def test_its_pairs_are_those_of_one_point():
    by_body = distances_px(body())
    by_area = distances_px([rigid_body._shape_of(s, views(), 1).centres for s in shaped()])
    # Voxels are 0.9 px wide; what is left of the shape is some 0.03 px, of the area 0.1.
    assert np.sqrt(np.mean(by_body**2)) < 0.5 * np.sqrt(np.mean(by_area**2))
    assert np.sqrt(np.mean(by_body**2)) < 0.08


def test_exchanged_cameras_show_the_same_point():
    found = off_the_truth()
    swapped = replace(found, t_d_s=-found.t_d_s, R=found.R.T, t=-found.R.T @ found.t)
    two, one = followed(swapped, (1, 0))
    for before, after in zip(body(), (one, two), strict=True):
        both = np.intersect1d(before.times_s, after.times_s)
        places = [of.points_px[np.isin(of.times_s, both)] for of in (before, after)]
        assert len(both) > 100
        # Instants are even times of the other clock: voxels and attitudes are found anew.
        assert np.sqrt(np.mean((places[0] - places[1]) ** 2)) < 0.1


@pytest.mark.parametrize("shift_us", [5_000, 123_457])
def test_a_delay_of_camera_2_changes_nothing_but_the_offset(monkeypatch, shift_us):
    later = [shaped()[0], shaped()[1].delayed(shift_us)]
    before = body()
    monkeypatch.setattr("tests.ssac.methods.test_rigid_body.shaped", lambda: later)
    found = off_the_truth()
    after = followed(replace(found, t_d_s=found.t_d_s + 1e-6 * shift_us))
    for one, other in zip(before, after, strict=True):
        # Not to the last bit, as places are the points of tracks that are told on another clock:
        # by the rounding errors of times, and no comparison that falls out otherwise.
        np.testing.assert_allclose(one.points_px, other.points_px, rtol=0.0, atol=1e-9)


def test_it_says_why_there_is_no_body(monkeypatch):
    found = off_the_truth()
    assert rigid_body.body_points(found, views()) == ""  # of tracks nothing could be tried
    bent = replace(CAMERA, distortion_model="radtan", distortion_coeffs=(0.1, 0.0, 0.0, 0.0))
    assert "distorts" in rigid_body._shape_of(shaped()[1], views(cam2=bent), 2)
    unclosed = ShapedTrack(shaped()[0].track, None)
    assert "does not close in camera 1" in rigid_body._shape_of(unclosed, views(), 1)
    rng = np.random.default_rng(0)
    torn = [
        replace(one, images=one.images.of(rng.permutation(len(one.track.times_s))))
        for one in shaped()
    ]
    monkeypatch.setattr("tests.ssac.methods.test_rigid_body.shaped", lambda: torn)
    assert "no one rigid body" in followed(found)


def test_a_step_of_the_pose_is_undone():
    R, t = off_the_truth().R, off_the_truth().t
    step = pose_step(SCENE.R, T, R, t)
    moved = moved_pose(SCENE.R, T, step)
    # A step of t is along its tangent: the third order of 0.004 rad is left.
    assert moved[0] == pytest.approx(R, abs=1e-12)
    assert moved[1] == pytest.approx(t, abs=1e-7)


BOX = synthetic.make_scene(0, duration_s=6.0)
BOX_VIEWS = two_views(*box.observations(*box.box_events(BOX, 0)), BOX.unknown_rig, box.CLEAN)


@cache
def tangents_alone() -> Estimate:
    found = by_tangents.refine_tangents(box.off_the_truth(BOX), BOX_VIEWS)
    assert found.status == "ok"
    return found


def with_point(monkeypatch, late_s: float, joins: bool = True) -> Estimate:
    """Join the tangents of the box with its true origin, seen too late in view 2."""
    times_s = np.arange(0.0, 6.0, 0.02)
    tracks = synthetic.track_pair(BOX, times_s)
    shown_s = times_s, times_s + box.T_D_S + late_s
    points = tuple(
        point_motion(PointTrack(at, track, np.ones(len(at))), CAMERA, PointRules(), 0.04)
        for at, track in zip(shown_s, tracks, strict=True)
    )
    monkeypatch.setattr(by_tangents, "body_points", lambda *_: points)
    rules = replace(BOX_VIEWS.rules.tangency, joins_body=joins)
    return by_tangents.with_body(tangents_alone(), BOX_VIEWS.by(tangency=rules))


def test_one_point_of_the_body_makes_the_tangents_surer(monkeypatch):
    alone, joined = tangents_alone(), with_point(monkeypatch, 0.0)
    assert joined.without_body == ""
    assert joined.t_d_std_s < alone.t_d_std_s
    assert np.all(np.array(box.errors(joined, BOX)) <= box.errors(alone, BOX))
    assert joined.n_samples > alone.n_samples


def test_a_body_that_contradicts_the_tangents_leaves_them_as_they_are(monkeypatch):
    found, alone = with_point(monkeypatch, 0.004), tangents_alone()
    assert "contradicts" in found.without_body
    assert (found.t_d_s, found.d_avg_px) == (alone.t_d_s, alone.d_avg_px)
    assert found.R is alone.R
    assert found.t is alone.t
    # Of a matrix less a smaller one no variance is negative; of rounding there is some.
    added = found.covariance - alone.covariance
    assert np.linalg.eigvalsh(added)[0] > -1e-9 * np.trace(added)
    assert found.t_d_std_s > 3.0 * alone.t_d_std_s
    assert with_point(monkeypatch, 0.0, joins=False) is tangents_alone()
