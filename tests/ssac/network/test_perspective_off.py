"""A large object whose silhouettes perspective shifts: poses are to be as if it did not."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ssac.network.solve import solve_network
from ssac.network.state import sightings
from ssac.points import PointTrack
from ssac.track.body import View, perspective_shifts
from tests.ssac.network.flights import CAMERA, Flight, make_flight

MOMENTS_M2 = np.array([[0.5, 0.1, 0.3], [0.1, 0.1, -0.05], [0.3, -0.05, 0.6]])
"""Of the object, in the first camera's frame: it does not turn, and is some 2.5 m wide."""


def shaped(flight: Flight) -> Flight:
    """The same flight, seen by the centres of silhouettes that tell their second moments."""
    seen = []
    for k, (one, (R, t)) in enumerate(zip(flight.seen, flight.poses, strict=True)):
        times_s = one.times_s - flight.delays_s[k]
        times_s = times_s - 1e-6 * flight.skews_ppm[k] * (times_s - 8.0)
        focal = np.diag(CAMERA.K)[:2]
        view = View(R, focal, flight.path(times_s) @ R.T + t, np.empty((0, 3)))
        J = view.by_point()
        images = J @ MOMENTS_M2 @ J.transpose(0, 2, 1)
        spreads = np.column_stack([images[:, 0, 0], images[:, 0, 1], images[:, 1, 1]])
        shifts = perspective_shifts(view, np.tile(MOMENTS_M2, (len(times_s), 1, 1)))
        track = PointTrack(one.times_s, one.points_px + shifts)
        seen.append(sightings(track, CAMERA, one.name, False, spreads))
    return replace(flight, seen=seen)


def turned_deg(flight: Flight) -> float:
    """By how much cameras are turned from their true poses, at most."""
    found = solve_network(flight.seen, flight.links(), 50.0, flight.distance_m)
    off = [camera.R @ R.T for camera, (R, _) in zip(found.cameras, flight.poses, strict=True)]
    return float(np.rad2deg(Rotation.from_matrix(off).magnitude().max()))


def test_what_perspective_does_turns_no_camera() -> None:
    flight = shaped(make_flight(4, noise_px=0.05))
    without = replace(flight, seen=[replace(one, spreads_px2=None) for one in flight.seen])
    # Of an object that does not turn, shifts of some 3 px of 900 are the same all the time: they
    # pass for turns of the cameras. Taken off by a path that they moved, they leave a tenth.
    assert turned_deg(without) > 0.1
    assert turned_deg(flight) < 0.2 * turned_deg(without)


def test_two_silhouettes_are_left_as_they_are() -> None:
    flight = shaped(make_flight(2, noise_px=0.05))
    found = solve_network(flight.seen, flight.links(), 50.0, flight.distance_m)
    for before, after in zip(flight.seen, found.built[0].cameras, strict=True):
        np.testing.assert_array_equal(before.points_px, after.points_px)
