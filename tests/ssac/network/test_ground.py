"""Scale and frame from positions of cameras and from RTK: they are found, and contradictions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac.errors import SsacError
from ssac.network.ground import ground_of_positions, ground_of_rtk, in_frame
from ssac.network.solve import solve_network
from ssac.network.tum import Path, write_path
from ssac.rules import GroundRules
from tests.ssac.network.flights import DURATION_S, RULES, make_flight

TURN = Rotation.from_rotvec([0.4, -1.0, 0.2]).as_matrix()
SHIFT_M = np.array([100.0, -50.0, 7.0])
GROUND = GroundRules()


@pytest.fixture(scope="module")
def solved():
    flight = make_flight(4)
    return flight, solve_network(flight.seen, flight.links(), 50.0, 1.0, RULES)


def centres_m(flight) -> np.ndarray:
    """Where the cameras stand, in a frame of the ground."""
    return np.array([-R.T @ t for R, t in flight.poses]) @ TURN.T + SHIFT_M


def off_m(flight, answer) -> float:
    path = answer.paths[0].path
    true = flight.path(path.times_s) @ TURN.T + SHIFT_M
    return float(np.sqrt(np.mean(np.sum((path.positions_m - true) ** 2, axis=1))))


def write_positions(file, positions) -> None:
    rows = [f"{k + 1},{x},{y},{z}" for k, (x, y, z) in enumerate(positions)]
    file.write_text("\n".join(["camera,x_m,y_m,z_m", *rows]) + "\n")


def test_positions_give_metres_and_the_frame(solved, tmp_path):
    flight, answer = solved
    write_positions(tmp_path / "positions.csv", centres_m(flight))
    found = in_frame(answer, ground_of_positions(answer, tmp_path / "positions.csv", GROUND))
    assert off_m(flight, found) < 0.05  # 9 mm of pixel noise, and what leaves the cameras off
    for camera, true in zip(found.cameras, centres_m(flight), strict=True):
        assert -camera.R.T @ camera.t == pytest.approx(true, abs=0.1)  # of 20 m, likewise
    # Deviations are lengths: they grow with the scale, and no turn changes their sum of squares.
    before = answer.paths[0].path.deviations_m
    after = found.paths[0].path.deviations_m
    scale = np.sqrt(np.sum(after**2) / np.sum(before**2))
    assert scale == pytest.approx(flight.distance_m, rel=0.01)  # the unit that it was in


def test_rtk_gives_them_too_whatever_its_clock_shows(solved, tmp_path):
    flight, answer = solved
    times_s = np.arange(0.0, DURATION_S, 0.2)
    truth = Path(times_s + 77.7, flight.path(times_s) @ TURN.T + SHIFT_M)
    write_path(tmp_path / "rtk.csv", truth)
    ground = ground_of_rtk(answer, tmp_path / "rtk.csv", GROUND)
    assert off_m(flight, in_frame(answer, ground)) < 0.05
    assert "77.7" in ground.said


def test_the_lever_arm_of_rtk_is_taken_away(solved, tmp_path):
    flight, answer = solved
    times_s, arm_m = np.arange(0.0, DURATION_S, 0.2), (0.3, -0.2, 0.5)
    yaw_rad = 3.0 * np.sin(0.7 * times_s)  # so that the alignment cannot take it
    turns = Rotation.from_euler("z", yaw_rad)
    body_m = flight.path(times_s) @ TURN.T + SHIFT_M
    antenna = Path(times_s + 5.0, body_m + turns.apply(arm_m), quaternions=turns.as_quat())
    write_path(tmp_path / "rtk.tum", antenna)
    ground = ground_of_rtk(answer, tmp_path / "rtk.tum", GROUND, arm_m)
    assert off_m(flight, in_frame(answer, ground)) < 0.05  # as without an arm
    assert (
        off_m(flight, in_frame(answer, ground_of_rtk(answer, tmp_path / "rtk.tum", GROUND))) > 0.1
    )
    write_path(tmp_path / "rtk.csv", Path(antenna.times_s, antenna.positions_m))
    with pytest.raises(SsacError, match="lever arm turns with the body"):
        ground_of_rtk(answer, tmp_path / "rtk.csv", GROUND, arm_m)


def test_rtk_in_degrees_or_without_times_is_one_line(solved, tmp_path):
    _, answer = solved
    (tmp_path / "rtk.csv").write_text("t_s,lat,lon,alt_m\n0,47.1,8.2,400\n")
    with pytest.raises(SsacError, match="latitude and longitude"):
        ground_of_rtk(answer, tmp_path / "rtk.csv", GROUND)
    (tmp_path / "rtk.csv").write_text("x_m,y_m,z_m\n1,2,3\n2,2,4\n")
    with pytest.raises(SsacError, match="needs times"):
        ground_of_rtk(answer, tmp_path / "rtk.csv", GROUND)


def test_positions_that_contradict_the_poses_are_one_line(solved, tmp_path):
    flight, answer = solved
    write_positions(tmp_path / "positions.csv", centres_m(flight)[[1, 0, 3, 2]] * [1.0, 3.0, 1.0])
    with pytest.raises(SsacError, match="contradict these positions, by"):
        ground_of_positions(answer, tmp_path / "positions.csv", GROUND)


def test_rtk_of_another_flight_is_refused(solved, tmp_path):
    _, answer = solved
    times_s = np.arange(0.0, DURATION_S, 0.2)
    other = np.random.default_rng(0).normal(size=(len(times_s), 3))
    write_path(tmp_path / "rtk.csv", Path(times_s, other))
    with pytest.raises(SsacError, match="flight"):
        ground_of_rtk(answer, tmp_path / "rtk.csv", GROUND)


def test_two_positions_are_too_few(solved, tmp_path):
    flight, answer = solved
    write_positions(tmp_path / "positions.csv", centres_m(flight)[:2])
    with pytest.raises(SsacError, match="at least 3 cameras"):
        ground_of_positions(answer, tmp_path / "positions.csv", GROUND)


def test_the_rules_of_the_frame_are_those_that_are_given(solved, tmp_path):
    flight, answer = solved
    write_positions(tmp_path / "positions.csv", centres_m(flight))
    with pytest.raises(SsacError, match="contradict these positions, by"):
        ground_of_positions(answer, tmp_path / "positions.csv", GroundRules(max_off_share=0.0))
    times_s = np.arange(0.0, DURATION_S, 0.2)
    write_path(tmp_path / "rtk.csv", Path(times_s, flight.path(times_s)))
    with pytest.raises(SsacError, match="explains 100 % of its motion only"):
        ground_of_rtk(answer, tmp_path / "rtk.csv", GroundRules(least_explained=1.1))
