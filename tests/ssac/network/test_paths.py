"""Paths: written and read, aligned, compared, and put into metres by positions on the ground."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from ssac import Clock, SsacError
from ssac.network.align import Similarity, best_shift, interpolated, similarity
from ssac.network.comparison import compare
from ssac.network.ground import Ground, ground_of_positions, ground_of_rtk, in_frame
from ssac.network.solve import solve_network
from ssac.network.tum import Path, read_path, write_path
from ssac.pipeline.many import NetworkResult, write_many
from ssac.rules import FitRules, GroundRules
from tests.ssac.command import read_json, run
from tests.ssac.network.flights import DURATION_S, PLAIN, RULES, make_flight


@pytest.mark.parametrize("name", ["path.tum", "path.csv"])
@pytest.mark.parametrize("in_metres", [True, False])
@pytest.mark.parametrize("with_deviations", [True, False])
def test_a_path_survives_writing(tmp_path, name, with_deviations, in_metres):
    file, rng = tmp_path / name, np.random.default_rng(0)
    positions = np.cumsum(rng.normal(size=(50, 3)), axis=0) + 30.0
    deviations = rng.uniform(0.01, 0.1, (50, 3)) if with_deviations else None
    path = Path(1.7e9 + np.arange(50) * 0.2, positions, deviations)  # as of a receiver's Unix time
    write_path(file, path, in_metres)
    if name.endswith("csv"):  # it claims metres only where they are
        assert ("_m" in file.read_text()) == in_metres
    again = read_path(file)
    np.testing.assert_allclose(again.times_s, path.times_s, rtol=0.0, atol=3e-7)  # 7 digits, 1970
    np.testing.assert_allclose(again.positions_m, path.positions_m, rtol=1e-8)  # 9 digits
    assert (again.deviations_m is not None) == (with_deviations and name.endswith("csv"))
    if again.deviations_m is not None:
        np.testing.assert_allclose(again.deviations_m, path.deviations_m, rtol=1e-8)
    if name.endswith("tum"):
        assert again.quaternions is None
        rows = [line.split(" ") for line in file.read_text().splitlines()]
        assert {(len(row), *row[4:]) for row in rows} == {(8, "0", "0", "0", "1")}
        turned = np.tile([0.0, 0.6, 0.0, 0.8], (50, 1))
        write_path(file, replace(path, quaternions=turned))
        np.testing.assert_array_equal(read_path(file).quaternions, turned)


@pytest.mark.parametrize(
    "text",
    [
        "# t x y z\n0 1 2 3 0 0 0 1\n0.5 2 2 4 0 0 0 1\n",
        "0 1 2 3\n0.5 2 2 4\n",
        "t_s,x_m,y_m,z_m\n0,1,2,3\n0.5,2,2,4\n",
        "\ufefffix, z, y, t, x\r\n1, 3, 2, 0, 1\r\n\r\n1, 4, 2, 0.5, 2\r\n",
        "Timestamp,x,y,z\n0,1,2,3\n0.5,2,2,4\n",
        "time,t_s,x,y,z\n9,0,1,2,3\n9,0.5,2,2,4\n",
        "1 2 3\n2 2 4\n",  # which is read where no times are needed
    ],
)
def test_forms_that_are_read(tmp_path, text):
    has_times = not text.startswith("1 2 3")
    (tmp_path / "path").write_text(text, encoding="utf-8")
    path = read_path(tmp_path / "path", needs_times=has_times)
    assert path.has_times == has_times
    if has_times:
        np.testing.assert_array_equal(path.times_s, [0.0, 0.5])
    np.testing.assert_array_equal(path.positions_m, [[1.0, 2.0, 3.0], [2.0, 2.0, 4.0]])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1 2 3\n2 2 4\n", "needs times"),
        ("x_m,y_m,z_m\n2,2,4\n", "needs times"),
        ("", "no points"),
        ("t_s,x_m,y_m,z_m\n", "no points"),
        ("0 1 2 3\n1 2 nan 4\n", "point 1 has a value that is no finite number"),
        ("0 1 2 3\n0 2 2 4\n", "time order, but point 1"),
        ("12 1 2 3\n0 2 2 4\n", "time order, but point 1"),  # not as a sensor's counter
        ("0 1 2 3\n1 2 two 4\n", "must be 4 numbers, but point 1 is '1 2 two 4'"),
        ("0 1 2 3\n1 2 4\n", "must be 4 numbers, but point 1 is '1 2 4'"),
        ("0 1 2 3 4\n1 2 4 4 5\n", "got 5 numbers"),
        ("t_s,lat,lon,alt_m\n0,47.1,8.2,400\n", "latitude and longitude"),
        ("0 47.1 8.2 400\n1 47.1001 8.2001 420\n", "as of degrees"),
        ("t_s,east,north,up\n0,1,2,3\n", "must name the columns"),
        ("stamp_ns,x,y,z,fix\n0,1,2,3,4\n", "times in a column t_s, got .* stamp_ns, fix: name"),
        ("0 1 2 3\n200000 1 2 4\n", "give seconds"),
        ("0 1 2 3 0 0 0 1\n1 1 2 4 0 0 0 0\n", "quaternion is zero"),
        (b"\x89PNG\xff\xfe\x00", "not a text file"),
        ("0,1,2," + 200_000 * "3", "not a text file of a path .*field larger"),
    ],
)
def test_what_is_no_path_is_refused_in_one_line(tmp_path, text, reason):
    (tmp_path / "path").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(SsacError, match=reason) as raised:
        read_path(tmp_path / "path")
    assert str(raised.value).startswith(str(tmp_path / "path"))
    assert "\n" not in str(raised.value)


# --- Aligned ---

RNG = np.random.default_rng(3)
POINTS = RNG.normal(size=(40, 3)) * (5.0, 2.0, 1.0)
TRUE = Similarity(2.5, Rotation.from_rotvec([0.4, -2.0, 1.0]).as_matrix(), np.array([3.0, -7.0, 1]))


def test_a_similarity_is_that_of_the_points():
    for points in (POINTS, POINTS * (1.0, 1.0, 0.0)):  # also in a plane
        found = similarity(points, TRUE.apply(points))
        assert found.scale == pytest.approx(TRUE.scale, rel=1e-9)  # rounding
        np.testing.assert_allclose(found.R, TRUE.R, atol=1e-9)
        np.testing.assert_allclose(found.t, TRUE.t, atol=1e-8)
    mirrored = similarity(POINTS, POINTS * (1.0, 1.0, -1.0))
    assert np.linalg.det(mirrored.R) == pytest.approx(1.0)  # turned, not mirrored
    assert similarity(POINTS, TRUE.apply(POINTS), with_scale=False).scale == 1.0
    target = TRUE.apply(POINTS) + RNG.normal(0.0, 0.3, POINTS.shape)
    found = similarity(POINTS, target)
    for _ in range(50):  # none near by has a smaller sum of squares
        turn = Rotation.from_rotvec(RNG.normal(0.0, 0.01, 3)).as_matrix()
        scale, shift = found.scale * RNG.normal(1.0, 0.01), RNG.normal(0.0, 0.01, 3)
        near = Similarity(scale, turn @ found.R, found.t + shift)
        costs = [np.sum((fit.apply(POINTS) - target) ** 2) for fit in (near, found)]
        assert costs[0] > costs[1]


@pytest.mark.parametrize("points", [POINTS * (1.0, 0.0, 0.0), POINTS * 0.0, POINTS[:2]])
def test_a_line_or_a_point_does_not_tell_a_turn(points):
    for pair in ((points, POINTS[: len(points)]), (POINTS[: len(points)], points)):
        with pytest.raises(SsacError, match="lie on a line"):
            similarity(*pair)


FRAME = Similarity(21.0, Rotation.from_rotvec([0.3, 1.9, -0.6]).as_matrix(), np.array([9.0, -4, 2]))


def flight(duration_s, seed, hovers=()):
    """Return a flight [m] as a function of time [s]: random points every 4 s, but for hovers."""
    rng = np.random.default_rng(seed)
    knots_s = np.arange(-8.0, duration_s + 8.1, 4.0)
    points = np.cumsum(rng.normal(0.0, 4.0, (len(knots_s), 3)) * (1.0, 1.0, 0.3), axis=0)
    for start_s, end_s in hovers:
        still = (knots_s >= start_s) & (knots_s <= end_s)
        points[still] = points[still][0] + rng.normal(0.0, 0.05, (still.sum(), 3))
    return CubicSpline(knots_s, points)


def both(duration_s, seed, clock, span_s, hovers=(), rate_hz=30.0, noise_m=0.02, truth_m=0.02):
    """Return an estimate over `span_s` in its own frame, and the truth of the whole flight."""
    rng = np.random.default_rng(seed + 1000)
    position = flight(duration_s, seed, hovers)
    times_s = np.arange(*span_s, 1.0 / rate_hz)
    noisy = position(times_s) + rng.normal(0.0, noise_m, (len(times_s), 3))
    seen = (noisy - FRAME.t) @ FRAME.R / FRAME.scale
    truth_s = np.arange(0.0, duration_s, 0.2)
    shown_s = clock.cam2_from_cam1(truth_s)
    noisy = position(truth_s) + rng.normal(0.0, truth_m, (len(truth_s), 3))
    return Path(times_s, seen), Path(shown_s, noisy)


def check(found, clock, tolerance_s=0.004):
    """The tolerance: 2 cm of noise at some 2 m/s are 10 ms a sample, for some hundred samples."""
    got, frame = found
    at_s = np.array([got.t_ref_s])
    assert got.cam2_from_cam1(at_s) == pytest.approx(clock.cam2_from_cam1(at_s), abs=tolerance_s)
    assert frame.scale == pytest.approx(FRAME.scale, rel=0.01)  # noise of 2 cm in some 10 m
    off = Rotation.from_matrix(frame.R.T @ FRAME.R).magnitude()
    assert np.degrees(off) < 0.5  # noise, as for the scale


@pytest.mark.parametrize("lone_s", [-10.0, 20.0])
def test_a_path_covers_its_own_points_though_a_gap_is_beside_the_first_or_last(lone_s):
    times_s = np.sort(np.append(np.arange(10.0), lone_s))
    points = np.random.default_rng(0).normal(size=(11, 3))
    np.testing.assert_allclose(interpolated(Path(times_s, points)).at(times_s), points)
    assert np.isnan(interpolated(Path(times_s, points)).at(np.array([lone_s / 2 + 4.0]))).all()


@pytest.mark.parametrize("shift_s", [0.0, -301.37, 1.7e9])
def test_any_shift_is_found(shift_s):
    check(best_shift(*both(120.0, 0, Clock(shift_s), (20.0, 100.0))), Clock(shift_s))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("hovers", "span_s"),
    [
        ([(0.0, 120.0)], (90.0, 190.0)),  # shifted, the estimate moves where the truth hovers
        ([(40.0, 100.0), (130.0, 300.0)], (30.0, 200.0)),  # both hover most of the time
        ([(0.0, 60.0), (90.0, 150.0), (180.0, 300.0)], (0.0, 300.0)),
    ],
)
def test_a_hover_is_no_trap(seed, hovers, span_s):
    clock = Clock(57.3, 12.0, 0.0)
    # The object moves in as little as a fifth of the samples.
    check(best_shift(*both(300.0, seed, clock, span_s, hovers)), clock, 0.01)


def test_the_rate_is_found_with_its_prior_and_without_one_is_not_tried():
    clock = Clock(-3.0, 400.0, 150.0)
    estimate, truth = both(300.0, 5, clock, (0.0, 300.0))
    got = best_shift(estimate, truth, rate_std_ppm=1000.0)
    check(got, clock)
    # 10 ms a sample, 1500 samples whose times have a deviation of 87 s: 3 ppm; three deviations.
    assert got[0].skew_ppm == pytest.approx(400.0, abs=10.0)
    assert best_shift(estimate, truth, rate_std_ppm=0.0)[0].skew_ppm == 0.0


def test_gross_errors_and_gaps_change_nothing_and_a_known_scale_is_kept():
    clock = Clock(11.0)
    estimate, truth = both(120.0, 2, clock, (10.0, 110.0))
    rng = np.random.default_rng(9)
    positions = estimate.positions_m.copy()
    positions[rng.choice(len(positions), 50, replace=False)] += rng.normal(0.0, 50.0, (50, 3))
    kept = (estimate.times_s < 40.0) | (estimate.times_s > 60.0)
    spoilt = Path(estimate.times_s[kept], positions[kept])
    few = rng.random(len(truth)) > 0.1
    check(best_shift(spoilt, Path(truth.times_s[few], truth.positions_m[few])), clock, 0.01)
    metric = replace(estimate, positions_m=FRAME.scale * estimate.positions_m)
    got, frame = best_shift(metric, truth, with_scale=False)
    assert frame.scale == 1.0
    check((got, replace(frame, scale=FRAME.scale)), clock)


def test_shifts_beyond_the_bound_are_not_taken_and_paths_at_rest_have_none():
    clock, times_s = Clock(40.0), np.arange(0.0, 60.0, 0.2)
    estimate, truth = both(120.0, 1, clock, (20.0, 100.0))
    check(best_shift(estimate, truth, 60.0), clock)
    assert abs(best_shift(estimate, truth, 20.0)[0].t_d_s) < 20.5  # a step beyond, 0.5 s at most
    with pytest.raises(SsacError, match="no shift within 39 s"):
        best_shift(estimate, truth, 39.0)  # from where the refinement reaches 40 s
    rest = Path(times_s, np.zeros((len(times_s), 3)))
    moving = Path(times_s, flight(60.0, 0)(times_s))
    for pair in ((rest, moving), (moving, rest)):
        with pytest.raises(SsacError, match="no shift at which"):
            best_shift(*pair)
    with pytest.raises(SsacError, match="no shift within 5 s"):
        best_shift(moving, Path(times_s + 100.0, moving.positions_m), 5.0)


# --- Compared ---

CLOCK = Clock(31.4, 20.0, 50.0)
NOISE_M = 0.03


def pair(noise_m=NOISE_M):
    return both(100.0, 7, CLOCK, (10.0, 90.0), rate_hz=20.0, noise_m=noise_m, truth_m=0.0)


def test_the_error_is_that_of_the_noise_and_shapes_are_compared_without_times():
    estimate, truth = pair()
    found = compare(estimate, truth)
    in_time, as_shape = found.in_time, found.as_shape
    # Every fourth sample coincides with one of the truth; 400 samples of three coordinates give the
    # error to 3 %, and the similarity takes 9 of 1200 degrees of freedom. Three deviations.
    assert in_time.rmse_m == pytest.approx(np.sqrt(3.0) * NOISE_M, rel=0.09)
    assert in_time.coverage == 1.0
    assert len(in_time.distances_m) in (399, 400)  # the last may lie beyond the end
    assert in_time.explained == pytest.approx(1.0, abs=1e-4)  # 5 cm in 10 m
    assert in_time.similarity.scale == pytest.approx(FRAME.scale, rel=0.002)  # 3 cm in some 10 m
    timeless = compare(replace(estimate, times_s=np.full(len(estimate), np.nan)), truth)
    assert timeless.in_time is None
    for shape in (as_shape, timeless.as_shape):
        # The nearest point leaves out the error along the path: two of three coordinates remain.
        assert shape.rmse_m == pytest.approx(np.sqrt(2.0) * NOISE_M, rel=0.06)
        turn = Rotation.from_matrix(shape.similarity.R.T @ FRAME.R)
        assert np.degrees(turn.magnitude()) < 0.3


def test_where_the_truth_has_no_samples_the_estimate_is_not_off_nor_the_other_way_round():
    estimate, truth = pair()
    kept = (np.abs(truth.times_s - 81.4) > 3.0) & (truth.times_s < 111.4)  # 50 s and 80 s of it
    holed = Path(truth.times_s[kept], truth.positions_m[kept])
    as_shape = compare(estimate, holed).as_shape
    whole = estimate.times_s[(np.abs(estimate.times_s - 50.0) > 3.0) & (estimate.times_s < 80.0)]
    # A step of the truth, 0.2 s or 4 samples, on both sides of the gap and at the end.
    assert len(as_shape.distances_m) == pytest.approx(len(whole), abs=4 * 3)
    assert as_shape.rmse_m == pytest.approx(np.sqrt(2.0) * NOISE_M, rel=0.06)  # as without holes
    kept = (estimate.times_s < 30.0) | (estimate.times_s > 50.0)
    found = compare(Path(estimate.times_s[kept], estimate.positions_m[kept]), truth)
    assert found.in_time.coverage == pytest.approx(0.75, abs=0.01)  # 60 of 80 s


def test_a_wrong_clock_shows_in_time_not_as_a_shape_and_a_wrong_scale_costs_where_it_is_held():
    estimate, truth = pair(0.0)
    late_s = 0.1 * np.sin(estimate.times_s)  # no shift nor rate explains it
    found = compare(replace(estimate, times_s=estimate.times_s + late_s), truth)
    assert found.in_time.rmse_m > 0.05  # 0.07 s rms at over 1 m/s
    assert found.as_shape.rmse_m < 0.02  # what interpolation between 20 and 5 Hz leaves
    metric = replace(estimate, positions_m=1.05 * FRAME.scale * estimate.positions_m)
    assert compare(metric, truth).in_time.rmse_m < 0.02
    held = compare(metric, truth, with_scale=False)
    assert held.in_time.similarity.scale == held.as_shape.similarity.scale == 1.0
    spread_m = np.sqrt(np.sum(np.var(truth.positions_m, axis=0)))
    assert held.in_time.rmse_m == pytest.approx(0.05 * spread_m, rel=0.2)  # of 80 of the 100 s


def test_the_command_prints_and_writes_what_it_found(tmp_path):
    args = tmp_path / "path.tum", tmp_path / "truth.csv"
    for file, path in zip(args, pair(), strict=True):
        write_path(file, path)
    outputs = "--json", tmp_path / "out.json", "--plot", tmp_path / "out.png"
    _, out, _ = run("compare", *args, *outputs)
    assert "at equal times RMSE 0.05" in out
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")
    told = read_json(tmp_path / "out.json")
    assert told["in_time"]["n_samples"] in (399, 400)
    clock = Clock(*(told["in_time"][key] for key in ("shift_s", "rate_ppm", "t_ref_s")))
    # 5 cm a sample at some 2 m/s are 25 ms, for 400 samples.
    np.testing.assert_allclose(clock.cam2_from_cam1(50.0), CLOCK.cam2_from_cam1(50.0), atol=0.005)
    assert told["as_shape"]["n_samples"]


@pytest.mark.parametrize(
    ("args", "reason"),
    [
        (("path.tum", "none.csv"), "no such file"),
        (("path.tum", "rest.csv"), "the truth stands still"),
        (("rest.csv", "truth.csv"), "the estimate stands still"),
        (("path.tum", "point.csv"), "the truth has 1 points, and at least 3"),
        (("point.csv", "truth.csv"), "the estimate has 1 points, and at least 3"),
        (("path.tum", "short.csv"), "the truth has 19 points with times, and a shift needs at lea"),
        (("path.tum", "truth.csv", "--json", "a.png", "--plot", "a.png"), "for two outputs"),
        (("path.tum", "truth.csv", "--scale", "big"), "expected unknown or known"),
        (("path.tum", "truth.csv", "--json", "truth.csv"), "would be lost"),
        (("path.tum", "truth.csv", "--plot", "out.jpeg"), "ending in .png"),
        (("path.tum", "truth.csv", "--lever-arm", "0", "0", "1"), "no attitude"),
    ],
)
def test_bad_input_is_one_line(tmp_path, args, reason, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rest, point = (Path(np.arange(float(n)), np.ones((n, 3))) for n in (99, 1))
    estimate, truth = pair()
    short = Path(truth.times_s[100:119], truth.positions_m[100:119])
    names = ("path.tum", "truth.csv", "rest.csv", "point.csv", "short.csv")
    for name, path in zip(names, (estimate, truth, rest, point, short), strict=True):
        write_path(tmp_path / name, path)
    _, out, err = run("compare", *args, code=2)
    assert (out, err.count("\n")) == ("", 1)
    assert reason in err


# --- Metres and the frame of the ground ---

TO_GROUND = Similarity(
    1.0, Rotation.from_rotvec([0.4, -1.0, 0.2]).as_matrix(), np.array([100.0, -50.0, 7.0])
)
GROUND, FIT = GroundRules(), FitRules()
TIMES_S = np.arange(0.0, DURATION_S, 0.2)


@pytest.fixture(scope="module")
def solved():
    flight = make_flight(4)
    return flight, solve_network(flight.seen, flight.links(), PLAIN, 1.0)


def centres_m(flight) -> np.ndarray:
    """Where the cameras stand, in a frame of the ground."""
    return TO_GROUND.apply(np.array([-R.T @ t for R, t in flight.poses]))


def off_m(flight, answer) -> float:
    path = answer.paths[0].path
    true = TO_GROUND.apply(flight.path(path.times_s))
    return float(np.sqrt(np.mean(np.sum((path.positions_m - true) ** 2, axis=1))))


def by_positions(folder, answer, positions, rules=GROUND) -> Ground:
    rows = [f"{k + 1},{x},{y},{z}" for k, (x, y, z) in enumerate(positions)]
    (folder / "positions.csv").write_text("\n".join(["camera,x_m,y_m,z_m", *rows]) + "\n")
    return ground_of_positions(answer, folder / "positions.csv", rules)


def by_rtk(folder, answer, path, rules=GROUND, arm_m=None, name="rtk.tum") -> Ground:
    write_path(folder / name, path)
    return ground_of_rtk(answer, folder / name, rules, FIT, arm_m)


def result_of(answer, ground=None) -> NetworkResult:
    names = tuple(camera.name for camera in answer.cameras)
    return NetworkResult(names, "", answer, {}, ground is not None, ground, {})


def test_positions_give_metres_and_the_frame(solved, tmp_path):
    flight, answer = solved
    ground = by_positions(tmp_path, answer, centres_m(flight))
    found = in_frame(answer, ground)
    assert off_m(flight, found) < 0.05  # 9 mm of pixel noise, and errors of the cameras
    for camera, true in zip(found.cameras, centres_m(flight), strict=True):
        assert -camera.R.T @ camera.t == pytest.approx(true, abs=0.1)  # of 20 m, likewise
    # The path's own deviations are lengths: they grow with the scale, and no turn changes their sum
    # of squares; those of the frame add to them.
    before, path = answer.paths[0].path, found.paths[0].path
    added = np.trace(ground.added(path.positions_m), axis1=1, axis2=2)
    own = np.sum(path.deviations_m**2, axis=1) - added
    scale = np.sqrt(np.sum(own) / np.sum(before.deviations_m**2))
    assert scale == pytest.approx(flight.distance_m, rel=0.01)  # the answer's unit


def test_deviations_hold_in_a_known_frame(solved, tmp_path):
    # Errors of stated places and of RTK, here far larger than the network's own, turn and move all.
    (flight, answer), rng = solved, np.random.default_rng(0)
    path_m = TO_GROUND.apply(flight.path(TIMES_S))
    found = list[np.ndarray]()
    for _ in range(40):
        stated_m = centres_m(flight) + rng.normal(scale=0.2, size=(4, 3))
        white_m = rng.normal(scale=0.15, size=path_m.shape)
        drift_m = lfilter([1.0], [1.0, -0.7], white_m, axis=0)  # which fades within 0.6 s
        by_path = by_rtk(tmp_path, answer, Path(TIMES_S, path_m + drift_m))
        grounds = by_positions(tmp_path, answer, stated_m), by_path
        found += [np.stack([scores(flight, in_frame(answer, one)) for one in grounds])]
    # Chance: 40 draws of about four independent errors leave 1 +- 0.06; Student's law, less.
    rms = np.sqrt(np.mean(np.square(found), axis=0))
    assert np.all((rms > 0.75) & (rms < 1.2))


def scores(flight, answer) -> np.ndarray:
    """Errors of each camera's centre, t and R, and of the path, in their deviations."""
    path, found = answer.paths[0].path, list[float]()
    for camera, true_m, (R, _) in zip(answer.cameras, centres_m(flight), flight.poses, strict=True):
        off_m, R_true = camera.centre - true_m, R @ TO_GROUND.R.T
        off_t = (camera.t + R_true @ true_m) / camera.t_std
        turn = Rotation.from_matrix(camera.R @ R_true.T).magnitude()
        found += [
            np.sqrt(off_m @ np.linalg.solve(camera.centre_covariance, off_m) / 3.0),
            np.sqrt(np.mean(off_t**2)),
            np.rad2deg(turn) / camera.r_std_deg,
        ]
    off = (path.positions_m - TO_GROUND.apply(flight.path(path.times_s))) / path.deviations_m
    return np.array([*found, np.sqrt(np.mean(off**2))])


def test_rtk_gives_them_too_without_its_lever_arm_whatever_its_clock_shows(solved, tmp_path):
    flight, answer = solved
    arm_m = (0.3, -0.2, 0.5)
    # The body turns, so that the alignment cannot absorb the arm.
    yaw, tilt = 3.0 * np.sin(0.7 * TIMES_S), 0.3 * np.cos(TIMES_S)
    turns = Rotation.from_euler("zxy", np.column_stack([yaw, tilt, 0.5 * tilt]))
    antenna_m = TO_GROUND.apply(flight.path(TIMES_S)) + turns.apply(arm_m)
    rtk = Path(TIMES_S + 77.7, antenna_m, quaternions=turns.as_quat())
    ground = by_rtk(tmp_path, answer, rtk, arm_m=arm_m)
    shown_s = float(ground.said.partition("its clock shows ")[2].split()[0])
    assert shown_s == pytest.approx(77.7, abs=0.01)  # 5 cm at some 5 m/s
    assert off_m(flight, in_frame(answer, ground)) < 0.05  # as with positions
    assert off_m(flight, in_frame(answer, by_rtk(tmp_path, answer, rtk))) > 0.1
    with pytest.raises(SsacError, match="lever arm turns with the body"):
        by_rtk(tmp_path, answer, replace(rtk, quaternions=None), arm_m=arm_m, name="rtk.csv")


def test_a_group_that_no_pair_connects_with_the_known_frame_is_not_in_metres(tmp_path):
    flight, log = make_flight(5), []
    alone = {pair: flight.links()[pair] for pair in ((0, 1), (0, 2), (1, 2), (3, 4))}
    answer = solve_network(flight.seen, alone, PLAIN, 1.0)
    ground = by_positions(tmp_path, answer, centres_m(flight)[:3])
    result = result_of(in_frame(answer, ground), ground)
    metres, unknown = "in metres", "in distances of the first two cameras placed"
    paths = [value for name, value in result.rows() if name.startswith("path ")]
    assert [value.partition("), ")[2] for value in paths] == [metres, unknown]
    stand = [value for _, value in result.rows() if value.startswith("at (")]
    # All of group 1, whose first camera is not at its frame's origin, and the last of group 2.
    assert [") m, turned" in value for value in stand] == [True, True, True, False]
    assert [group["scale_is_known"] for group in result.to_dict()["groups"]] == [True, False]
    write_many(result, tmp_path / "path.csv", None, log.append)
    assert [f" {metres}," in line for line in log] == [True, False]
    assert f" {unknown}," in log[1]
    heads = [(tmp_path / name).read_text()[:10] for name in ("path.csv", "path-2.csv")]
    assert heads == ["t_s,x_m,y_", "t_s,x,y,z,"]


def test_a_camera_has_no_place_in_its_own_frame_whatever_rounding_leaves(solved):
    _, answer = solved
    for left in (0.0, -1.2e-17):
        first = replace(answer.cameras[0], t=np.full(3, left))
        said = result_of(replace(answer, cameras=[first, *answer.cameras[1:]])).summary()
        assert said.count("turned by ") == len(answer.cameras) - 1


def test_where_rays_are_too_close_together_that_is_why_there_is_no_pose_and_no_path(tmp_path):
    network = replace(RULES.network, least_angle_deg=80.0)  # rays are 60 and 120 deg apart
    answer = make_flight(3).solved(config=replace(PLAIN, rules=replace(RULES, network=network)))
    reasons, log = {camera.reason for camera in answer.cameras}, list[str]()
    assert [one.rpartition(", on rays ")[2] for one in reasons] == ["at least 80 deg apart"]
    write_many(result_of(answer), tmp_path / "path.csv", None, log.append)
    assert log == [f"not written: {tmp_path / 'path.csv'}, since {reasons.pop()}"]


def test_what_does_not_fit_by_the_rules_is_refused(solved, tmp_path):
    flight, answer = solved
    centres, exact = centres_m(flight), GroundRules(max_off_share=1e-9)
    other = np.random.default_rng(0).normal(size=(len(TIMES_S), 3))
    beside_a_line = np.array([[-20.0, 0.0, 0.0], [0.0, 1.2, 0.0], [15.0, 0.0, 0.0]])
    strict, flown = GroundRules(least_explained=1.1), Path(TIMES_S, flight.path(TIMES_S))
    for by, given, rules, message in (
        (by_positions, centres[[1, 0, 3, 2]] * [1.0, 3.0, 1.0], GROUND, "contradict these posit"),
        (by_positions, centres, exact, "contradict these positions, by"),
        (by_positions, centres[:2], GROUND, "at least 3 cameras"),
        # Errors of centimetres turn a frame about such a line, and the path in it, by any angle.
        (by_positions, beside_a_line, GROUND, "nearly on a line, 0.5. m off it rms over 14 m"),
        (by_positions, np.outer(np.arange(4.0), [1.0, 2.0, 0.0]), exact, "nearly on a line, "),
        (by_rtk, replace(flown, positions_m=other), GROUND, "flight"),
        (by_rtk, replace(flown, positions_m=0.0 * other), GROUND, "rtk.tum.*truth stands still"),
        (by_rtk, flown, strict, "explains 100 % of its motion only"),
    ):
        with pytest.raises(SsacError, match=message):
            by(tmp_path, answer, given, rules)
