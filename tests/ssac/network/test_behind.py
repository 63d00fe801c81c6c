"""Events come behind the motion that makes them: by a length, which clocks must not take up."""

from dataclasses import replace

import numpy as np
import pytest

from ssac.network.adjustment import (
    BEHIND_OWN_PX,
    BEHIND_STD_PX,
    LEVEL_OWN_PX,
    LEVEL_STD_PX,
    border_offsets,
    known,
)
from ssac.network.solve import solve_network
from ssac.network.state import BEHIND, sightings
from ssac.points import PointTrack
from tests.ssac.network.flights import CAMERA, Flight, make_flight

BEHIND_PX = 0.2


def behind(flight: Flight, has_frames: bool) -> Flight:
    """The same flight, seen behind its motion in the image."""
    seen = []
    for k, (one, (R, t)) in enumerate(zip(flight.seen, flight.poses, strict=True)):
        times_s = one.times_s - flight.delays_s[k]
        times_s = times_s - 1e-6 * flight.skews_ppm[k] * (times_s - 8.0)
        ends = [(flight.path(times_s + step_s) @ R.T + t) @ CAMERA.K.T for step_s in (-1e-3, 1e-3)]
        moved = ends[1][:, :2] / ends[1][:, 2:] - ends[0][:, :2] / ends[0][:, 2:]
        points_px = one.points_px - BEHIND_PX * moved / np.linalg.norm(moved, axis=1)[:, None]
        seen.append(sightings(PointTrack(one.times_s, points_px), CAMERA, one.name, has_frames))
    return replace(flight, seen=seen)


def test_the_length_by_which_events_are_behind_is_found() -> None:
    plain = make_flight(3, noise_px=0.05)
    flight = behind(plain, has_frames=False)
    found = solve_network(flight.seen, flight.links(), 50.0, flight.distance_m)
    states = found.built[0].network.states
    # 0.05 px of noise on 300 points a camera leave 0.003 px, and what clocks leave of it more.
    assert [state.behind_px for state in states] == pytest.approx([BEHIND_PX] * 3, abs=0.03)
    for k, camera in enumerate(found.cameras[1:], 1):
        assert abs(camera.t_d_s - flight.shown_s(k, camera.t_ref_s)) < 4.0 * camera.t_d_std_s


@pytest.mark.parametrize(
    ("are_silhouettes", "common_px", "own_px"),
    [(False, BEHIND_STD_PX, BEHIND_OWN_PX), (True, LEVEL_STD_PX, LEVEL_OWN_PX)],
)
def test_before_the_sightings_no_camera_is_told_from_another(
    are_silhouettes, common_px, own_px
) -> None:
    flight = make_flight(3)
    built = solve_network(flight.seen, flight.links(), 50.0, flight.distance_m).built[0]
    offsets = border_offsets(built.network)
    cameras = built.cameras
    if are_silhouettes:
        cameras = [replace(one, spreads_px2=np.ones((len(one), 3))) for one in cameras]
    rows, _ = known(built.network, cameras, built.priors, offsets)
    places = offsets[:-1] + BEHIND
    covariance = np.linalg.inv((rows.T @ rows)[np.ix_(places, places)]) * built.network.repeats
    alike = np.full((3, 3), common_px**2) + own_px**2 * np.eye(3)
    np.testing.assert_allclose(covariance, alike, rtol=1e-9)  # rounding


def test_frames_are_not_behind() -> None:
    flight = behind(make_flight(3), has_frames=True)
    found = solve_network(flight.seen, flight.links(), 50.0, flight.distance_m)
    assert all(state.behind_px == 0.0 for state in found.built[0].network.states)
