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
TIMES_S = np.arange(0.0, DURATION_S, 0.2)


@pytest.fixture(scope="module")
def solved():
    flight = make_flight(4)
    return flight, solve_network(flight.seen, flight.links(), 50.0, 1.0, RULES)


def on_ground(points_m) -> np.ndarray:
    """Points of the first camera's frame, in a frame of the ground."""
    return points_m @ TURN.T + SHIFT_M


def centres_m(flight) -> np.ndarray:
    """Where the cameras stand, in a frame of the ground."""
    return on_ground(np.array([-R.T @ t for R, t in flight.poses]))


def off_m(flight, answer) -> float:
    path = answer.paths[0].path
    true = on_ground(flight.path(path.times_s))
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
    write_path(tmp_path / "rtk.csv", Path(TIMES_S + 77.7, on_ground(flight.path(TIMES_S))))
    ground = ground_of_rtk(answer, tmp_path / "rtk.csv", GROUND)
    assert off_m(flight, in_frame(answer, ground)) < 0.05
    assert "77.7" in ground.said


def test_the_lever_arm_of_rtk_is_taken_away(solved, tmp_path):
    flight, answer = solved
    rtk, arm_m = tmp_path / "rtk.tum", (0.3, -0.2, 0.5)
    # It turns so that the alignment cannot take the arm.
    yaw, tilt = 3.0 * np.sin(0.7 * TIMES_S), 0.3 * np.cos(TIMES_S)
    turns = Rotation.from_euler("zxy", np.column_stack([yaw, tilt, 0.5 * tilt]))
    antenna_m = on_ground(flight.path(TIMES_S)) + turns.apply(arm_m)
    write_path(rtk, Path(TIMES_S + 5.0, antenna_m, quaternions=turns.as_quat()))
    ground = ground_of_rtk(answer, rtk, GROUND, arm_m)
    assert off_m(flight, in_frame(answer, ground)) < 0.05  # as without an arm
    assert off_m(flight, in_frame(answer, ground_of_rtk(answer, rtk, GROUND))) > 0.1
    write_path(tmp_path / "rtk.csv", Path(TIMES_S + 5.0, antenna_m))
    with pytest.raises(SsacError, match="lever arm turns with the body"):
        ground_of_rtk(answer, tmp_path / "rtk.csv", GROUND, arm_m)


CONTRADICT, SWAPPED = "contradict these positions, by", [1, 0, 3, 2]
POSITIONS = [
    (lambda centres: centres[SWAPPED] * [1.0, 3.0, 1.0], GROUND, CONTRADICT),
    (lambda centres: centres, GroundRules(max_off_share=0.0), CONTRADICT),
    (lambda centres: centres[:2], GROUND, "at least 3 cameras"),
]


def test_what_does_not_fit_by_the_rules_is_refused(solved, tmp_path):
    flight, answer = solved
    for change, rules, message in POSITIONS:
        write_positions(tmp_path / "positions.csv", change(centres_m(flight)))
        with pytest.raises(SsacError, match=message):
            ground_of_positions(answer, tmp_path / "positions.csv", rules)
    other = np.random.default_rng(0).normal(size=(len(TIMES_S), 3))
    strict = GroundRules(least_explained=1.1)
    for path_m, rules, message in (
        (other, GROUND, "flight"),
        (flight.path(TIMES_S), strict, "explains 100 % of its motion only"),
    ):
        write_path(tmp_path / "rtk.csv", Path(TIMES_S, path_m))
        with pytest.raises(SsacError, match=message):
            ground_of_rtk(answer, tmp_path / "rtk.csv", rules)
