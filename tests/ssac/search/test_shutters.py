"""Readouts of rolling shutters: what they do to the views, and what is found of them."""

from dataclasses import replace

import numpy as np
import pytest

from ssac import joint, two_views
from ssac.camera import READOUT_STD_S, Camera, Rig, with_deviations
from ssac.config import Config
from ssac.search.two_views import shutters_of
from ssac.track.observation import tracked
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_scene
from tests.ssac.tracks import FPS, frame_track

T_D_S = 0.1
CONFIG = Config(interval_s=(-0.2, 0.4))
WIDE = 4.0  # deviations: a right answer is further off in 1 of 16,000
CAMERA = with_deviations(Camera(K, WIDTH, HEIGHT))
UNKNOWN = replace(CAMERA, readout_std_s=READOUT_STD_S)


def flight(seed, readouts_s):
    scene = make_scene(seed)
    return [
        tracked(frame_track(scene, k + 1, FPS[k], k * T_D_S, 1.0, readouts_s[k], 2 * seed + k))
        for k in (0, 1)
    ]


@pytest.mark.parametrize(
    ("seed", "readouts_s"), [(1, (0.020, 0.005)), (5, (0.007, 0.028)), (4, (0.0, 0.0))]
)
def test_readouts_are_found_beside_the_offset(seed, readouts_s):
    cameras = flight(seed, readouts_s)
    found = joint(*cameras, Rig(UNKNOWN, UNKNOWN), CONFIG)
    assert found.status == "ok"
    assert abs(found.t_d_s - T_D_S) < WIDE * found.t_d_std_s
    assert found.t_d_std_s < 2e-3  # of two readouts unknown by 15 ms, of which half would be left
    assert np.all(np.abs(found.readouts_s - readouts_s) < WIDE * found.readouts_std_s)
    assert np.all(found.readouts_std_s < 0.5 * READOUT_STD_S)  # so the tracks tell, not the prior
    assert np.all(found.readouts_s >= 0.0)
    if max(readouts_s) > 0.0:
        plain = joint(*cameras, Rig(CAMERA, CAMERA), CONFIG)
        assert abs(plain.t_d_s - T_D_S) > WIDE * plain.t_d_std_s
        assert np.isnan(plain.readouts_s).all()


def test_images_move_as_the_readout_says():
    # A lens whose rows are up to some 10 px from the ideal ones: the shutter reads the former.
    distorted = {"distortion_model": "radtan", "distortion_coeffs": (-0.3, 0.1, 0.001, -0.001)}
    lens = replace(UNKNOWN, **distorted)
    views = two_views(*flight(2, (0.01, 0.02)), Rig(lens, lens), CONFIG)
    shutters = shutters_of(views)
    readouts_s, step_s = np.array([0.012, 0.017]), 1e-4
    times_s = (np.linspace(3.0, 17.0, 80),) * 2

    def positions(readouts_s):
        seen = shutters.views(views, readouts_s)
        tracks = seen.motion1.sharp_at(times_s[0]), seen.motion2.sharp_at(times_s[1])
        return np.stack([track.positions_px for track in tracks])

    read_out = shutters.views(views, readouts_s)
    moves = shutters.moves(read_out, times_s)
    for k, motion in enumerate((read_out.motion1, read_out.motion2)):
        # A row is read out later by its share of the readout: that of the image as it is. Noise of
        # 0.3 px is smoothed, and points 30 ms apart on a curve are a pixel off its chords.
        rows = np.interp(times_s[k], motion.times_s, motion.rows)
        moved = -rows[:, None] * motion.sharp_at(times_s[k]).velocities_px_s
        off = np.linalg.norm(moves[k][k] - moved, axis=1) / np.linalg.norm(moved, axis=1)
        assert np.nanmedian(off) < 2e-3  # 0.01 of ideal rows
    for k, by_readout in enumerate(moves):
        step = step_s * np.eye(2)[k]
        numeric = (positions(readouts_s + step) - positions(readouts_s - step)) / (2.0 * step_s)
        errors = np.linalg.norm(np.stack(by_readout) - numeric, axis=2)
        # Windows are of whole points, which enter and leave: the curve through noise of 0.3 px has
        # velocities to some 10 px/s, of 200.
        assert np.nanmedian(errors) < 10.0
        assert np.nanmedian(np.linalg.norm(numeric[k], axis=1)) > 50.0
        assert np.all(by_readout[1 - k] == 0.0)


def test_a_readout_is_set_anew_and_lies_between_none_and_a_frame():
    views = two_views(*flight(2, (0.0, 0.0)), Rig(UNKNOWN, UNKNOWN), CONFIG)
    shutters, frames = shutters_of(views), views.motion1
    once = frames.read_out(0.02)
    np.testing.assert_allclose(once.times_s, frames.times_s + 0.02 * frames.rows, rtol=1e-15)
    again = frames.read_out(0.005).read_out(0.02)
    np.testing.assert_allclose(again.times_s, once.times_s, atol=1e-12)  # rounding
    np.testing.assert_allclose(once.read_out(0.0).times_s, frames.times_s, atol=1e-12)
    np.testing.assert_allclose(shutters.within(np.array([-0.01, 1.0])), [0.0, 1.0 / FPS[1]])
    read_out = shutters.views(views, np.array([0.02, 0.03]))
    np.testing.assert_allclose(shutters_of(read_out).longest_s, shutters.longest_s)  # of frames


def test_only_what_is_not_known_is_estimated():
    cameras = flight(2, (0.0, 0.0))
    known = replace(CAMERA, readout_s=0.012)
    assert shutters_of(two_views(*cameras, Rig(known, UNKNOWN), CONFIG)).cameras == (1,)
    views = two_views(*cameras, Rig(known, CAMERA), CONFIG)
    shutters = shutters_of(views)
    assert shutters.cameras == ()
    assert shutters.views(views, np.empty(0)) is views
