"""Laws of the network: truth, order, wrong cameras, groups, deviations, and links of pairs."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssac import Estimate, PointTrack, Status
from ssac.network import build
from ssac.network.adjustment import border_offsets, known
from ssac.network.align import Similarity
from ssac.network.graph import agreeing, factor_of, shared_by
from ssac.network.ground import Ground, in_frame
from ssac.network.solve import NetworkAnswer, answer_of, path_at, rounded_by
from ssac.network.state import with_strays
from ssac.rules import BodyRules
from ssac.track.moments import View, image_by_place, perspective_shifts
from tests.ssac.network.flights import CAMERA, PLAIN, Flight, make_flight, seen_by
from tests.ssac.synthetic import rotation_angle_deg as turn_deg

MOMENTS_M2 = np.array([[0.5, 0.1, 0.3], [0.1, 0.1, -0.05], [0.3, -0.05, 0.6]])
"""Second moments of an object some 2.5 m wide that does not turn, in the first camera's frame."""


@cache
def solved(n_cameras: int = 4) -> tuple[Flight, NetworkAnswer]:
    flight = make_flight(n_cameras)
    return flight, flight.solved()


def seen_as(flight: Flight, change, has_frames: bool = False) -> Flight:
    """Add what `change` gives at the first clock's times [s]: shifts [px], options of `seen_by`."""
    seen = []
    for k, one in enumerate(flight.seen):
        points_px, more = change(k, flight.clocks[k].cam1_from_cam2(one.times_s))
        track = PointTrack(one.times_s, one.points_px + points_px)
        seen.append(seen_by(track, one.name, has_frames, **more))
    return replace(flight, seen=seen)


def test_clocks_poses_and_the_path_are_found_with_where_it_holds_and_how_well() -> None:
    flight, answer = solved()
    assert (answer.status, answer.reason) == (Status.OK, "")
    for k, camera in enumerate(answer.cameras[1:], 1):
        # 0.4 px at some 200 px/s over 300 sightings is 0.1 ms; the path's errors make it more.
        assert abs(camera.t_d_s - flight.shown_s(k, camera.t_ref_s)) < 1.5e-3
        assert turn_deg(camera.R, flight.poses[k][0]) < 0.15  # 2 px; noise leaves less
        assert np.linalg.norm(camera.t - flight.poses[k][1]) < 0.1  # of 20 m
        assert camera.rms_px == pytest.approx(0.4, rel=0.15)
    path, spans_s = answer.paths[0].path, answer.paths[0].spans_s
    off_m = np.abs(path.positions_m - flight.path(path.times_s))
    # 0.4 px at 20 m with f = 900 px are 9 mm; a common error of the poses comes on top.
    assert np.sqrt(np.mean(np.sum(off_m**2, axis=1))) < 0.03
    times_s, (starts_s, ends_s) = path.times_s[:, None], spans_s.T
    assert np.any((times_s >= starts_s) & (times_s <= ends_s), axis=1).all()
    # Errors of neighbours are correlated, so that the share of one flight varies: 0.95 +- 0.1.
    assert np.mean(off_m < 2.0 * path.deviations_m) > 0.75
    assert np.median(off_m / path.deviations_m) > 0.15  # nor are deviations far too wide


def test_a_path_keeps_its_size_though_nearly_parallel_rays_hardly_tell_it() -> None:
    """Bug: its smoothness pulled the size to 0, by 18 %."""
    sizes = []
    for flight in (make_flight(2, seed, side_deg=5.0) for seed in range(4)):
        path = flight.solved().paths[0].path
        found, true = (np.ptp(m, axis=0) for m in (path.positions_m, flight.path(path.times_s)))
        sizes.append(np.mean(found / true))
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.1)  # noise leaves some 6 % in each


def test_the_order_of_the_cameras_does_not_matter() -> None:
    flight, answer = solved()
    order, links = [2, 0, 3, 1], {}
    for (a, b), link in flight.links().items():
        i, j = order.index(a), order.index(b)
        back = replace(link, clock=link.clock.inverse(), R=link.R.T, t=-link.R.T @ link.t)
        links[min(i, j), max(i, j)] = link if i < j else back
    other = replace(flight, seen=[flight.seen[k] for k in order]).solved(links)
    by_name = {camera.name: camera for camera in other.cameras}
    for camera in answer.cameras[1:]:
        # The same minimum from another start, with priors of skew against another camera's clock.
        assert turn_deg(by_name[camera.name].R @ by_name["cam1"].R.T, camera.R) < 0.02


def test_a_camera_with_wrong_frame_numbers_is_reported_and_spoils_nothing() -> None:
    flight, answer = solved()
    wrong = flight.seen[3]
    half = len(wrong) // 2  # its halves are swapped: no clock makes that right
    track = PointTrack(wrong.times_s, np.roll(wrong.points_px, -half, axis=0))
    links = flight.links()
    for k in range(3):  # the links of its pairs are arbitrary
        links[k, 3] = flight.link(k, 3, 1.7 * (k + 1))
    found = replace(flight, seen=[*flight.seen[:3], seen_by(track, "wrong")]).solved(links)
    assert [camera.status == Status.OK for camera in found.cameras] == [True, True, True, False]
    assert "fits nowhere" in found.cameras[3].reason
    assert found.reason == f"wrong: {found.cameras[3].reason}"
    for mine, whole in zip(found.cameras[:3], answer.cameras[:3], strict=True):
        assert turn_deg(mine.R, whole.R) < 0.2  # noise of three cameras, not of four


def test_a_wrong_pair_is_named_and_groups_that_no_pair_connects_are_two_solutions() -> None:
    flight, _ = solved()
    found = flight.solved(flight.links() | {(1, 2): flight.link(1, 2, 3.0)})
    assert found.status == Status.OK
    assert found.wrong_pairs == {(1, 2): pytest.approx(3.0, abs=0.05)}  # the link has no skew
    guess = replace(flight.link(1, 2, 3.0), is_reliable=False)
    found = flight.solved(flight.links() | {(1, 2): guess})
    assert set(found.closures_s) == {(0, 1, 3), (0, 2, 3)}  # no closure rests on a guess
    assert not found.wrong_pairs  # nor did that pair claim anything
    links = {pair: link for pair, link in flight.links().items() if pair in ((0, 1), (2, 3))}
    found = flight.solved(links)
    assert [camera.group for camera in found.cameras] == [1, 1, 2, 2]
    assert len(found.paths) == 2
    assert "no pair that fits connects cam1 cam2 with cam3 cam4" in found.reason
    tied = flight.solved(links | {(1, 2): flight.link(1, 2, 3.0)})  # by a wrong pair
    for mine, alone in zip(tied.cameras, found.cameras, strict=True):
        assert (mine.group, mine.t_d_s) == (alone.group, alone.t_d_s)
    wrong = {(1, 2): flight.link(1, 2, 3.0), (2, 3): replace(links[2, 3], R=None, t=None)}
    assert "fits nowhere in the network" in flight.solved(links | wrong).cameras[3].reason
    del links[2, 3]
    found = flight.solved(links)
    assert found.left_out == ["cam3", "cam4"]
    assert "no pair" in found.cameras[3].reason


def test_cameras_whose_rays_are_nowhere_apart_have_no_path(monkeypatch) -> None:
    flight, _ = solved(3)
    monkeypatch.setattr(build, "triangulate", lambda *of: np.full((len(of[2]), 3), np.nan))
    found = flight.solved()
    assert not found.built
    assert all("no pair of the group gave a pose" in one.reason for one in found.cameras)


def test_a_clock_says_what_its_state_does_also_where_it_strays_and_is_fast() -> None:
    flight = seen_as(make_flight(3), lambda k, times_s: (0.0, {}), has_frames=True)
    for said in ({"clock": "affine"}, {"skew_prior_ppm": 0.0}):  # Bug: neither was heeded
        found = flight.solved(config=replace(PLAIN, **said))
        assert not any(len(camera.strays_s) for camera in found.cameras)
        is_alike = abs(found.cameras[1].skew_ppm) < 1e-6  # but for rounding
        assert is_alike == ("skew_prior_ppm" in said)
    built = flight.solved().built[0]
    strays_s = np.linspace(-0.01, 0.02, len(built.network.states[1].strays_s)) ** 2
    assert len(strays_s) > 2
    state = replace(built.network.states[1], rate=0.2, strays_s=strays_s)
    states = [built.network.states[0], state, built.network.states[2]]
    clock = answer_of(replace(built, network=replace(built.network, states=states)), 1, 1).clock
    own_s = built.network.cameras[1].times_s[50:-50:10]
    shown_s = clock.cam2_from_cam1(state.network_from_own(own_s))
    np.testing.assert_allclose(shown_s, own_s, rtol=0.0, atol=1e-9)


def test_a_rate_that_pairs_found_is_kept_however_far_from_its_prior() -> None:
    flight, skew_ppm = solved()[0], 2500.0  # the prior's deviation is 50 ppm
    seen = list(flight.seen)
    clocks = [*flight.clocks[:3], replace(flight.clocks[3], skew_ppm=skew_ppm)]
    shown_s = clocks[3].cam2_from_cam1(flight.clocks[3].cam1_from_cam2(seen[3].times_s))
    seen[3] = seen_by(PointTrack(shown_s, seen[3].points_px), "fast")
    links = flight.links()
    for k in range(3):
        told = replace(links[k, 3].clock, skew_ppm=skew_ppm)
        links[k, 3] = replace(links[k, 3], clock=told)
    camera = replace(flight, seen=seen, clocks=clocks).solved(links).cameras[3]
    assert camera.skew_ppm == pytest.approx(skew_ppm, abs=4.0 * camera.skew_std_ppm)
    assert camera.skew_std_ppm < 50.0


def test_rounded_times_widen_each_offset_but_that_of_the_first_camera_as_they_do_of_pairs() -> None:
    _, answer = solved()
    quanta_s = np.array([0.01, 0.0, 0.001, 0.01])
    before, after = (
        np.array([camera.t_d_std_s for camera in one.cameras])
        for one in (answer, rounded_by(answer, quanta_s))
    )
    assert after[0] == before[0] == 0.0
    expected_s2 = (quanta_s[1:] ** 2 + quanta_s[0] ** 2) / 12.0
    np.testing.assert_allclose(after[1:] ** 2 - before[1:] ** 2, expected_s2)


def test_deviations_hold_over_many_flights() -> None:
    scores, far_scores = [], []
    to_far = Similarity(1.0, np.eye(3), np.array([300.0, -400.0, 100.0]))
    far = Ground(to_far, "", np.zeros(3), np.zeros((7, 7)))  # an exact frame
    for seed in range(6):
        flight = make_flight(3, seed)
        found = flight.solved(flight.links(seed))
        afar = in_frame(found, far).cameras
        for k in (1, 2):
            camera = found.cameras[k]
            off_s = camera.t_d_s - flight.shown_s(k, camera.t_ref_s)
            scores.append(off_s / camera.t_d_std_s)
            if k == 2:  # camera 2's distance is given
                scores += list((camera.t - flight.poses[k][1]) / camera.t_std)
            R, t = flight.poses[k]  # at 500 m errors of R swing the origin round the camera
            far_scores += list((afar[k].t - t + R @ to_far.t) / afar[k].t_std)
    # 30 scores, about half of them independent: 1 +- 0.18; far off 36, of three angles each.
    for each in (scores, far_scores):
        assert 0.55 < np.sqrt(np.mean(np.square(each))) < 1.5


def test_errors_that_last_make_every_deviation_as_much_wider() -> None:
    built = solved()[1].built[0]
    lasting = replace(built, network=replace(built.network, lasting=9.0 * built.network.lasting))
    times_s = np.linspace(2.0, 14.0, 5)
    one, other = (path_at(each, times_s).deviations_m for each in (built, lasting))
    np.testing.assert_allclose(other, 3.0 * one, rtol=1e-12)  # rounding
    one, other = (answer_of(each, 2, 1) for each in (built, lasting))
    for name in ("t_d_std_s", "skew_std_ppm", "r_std_deg", "t_std"):
        np.testing.assert_allclose(getattr(other, name), 3.0 * getattr(one, name), rtol=1e-12)
        assert np.all(np.isfinite(getattr(one, name)))


@pytest.mark.parametrize("speed_m_s", [0.0, 0.3])
def test_a_path_that_leaves_clocks_open_is_no_crash_and_no_answer(speed_m_s) -> None:
    flight, way = make_flight(2), speed_m_s * np.array([1.0, 0.3, 0.6])
    middle = flight.path(np.linspace(1.0, 15.0, 200)).mean(axis=0)
    straight = replace(flight, path=lambda times_s: middle + np.outer(times_s - 8.0, way))

    def moved(k: int, times_s: np.ndarray) -> tuple[np.ndarray, dict]:
        return straight.image_px(k, times_s) - flight.seen[k].points_px, {}

    answer = seen_as(flight, moved, has_frames=True).solved()
    # Rounding decides whether a normal matrix without noise is singular, or nearly so.
    assert answer.status == Status.NO_MATCH or answer.cameras[1].t_d_std_s > 0.1


@pytest.mark.parametrize("is_told", [True, False])
def test_readouts_are_counted_once_told_by_the_rig_or_found(is_told: bool) -> None:
    flight, readouts_s = make_flight(3, noise_px=0.05), (0.0, 0.03, 0.015)

    def read_out(k: int, times_s: np.ndarray) -> tuple[np.ndarray, dict]:
        pixels = before = flight.seen[k].points_px
        for _ in range(4):  # a row is read out when its share of the readout has passed
            pixels = flight.image_px(k, times_s + readouts_s[k] * pixels[:, 1] / 599.0)
        camera = replace(CAMERA, readout_s=readouts_s[k] if is_told else None)
        return pixels - before, {"camera": camera}

    found = seen_as(flight, read_out, has_frames=True).solved()
    for k, camera in enumerate(found.cameras):
        # With little noise, the prior of 10 ms hardly moves the estimate.
        assert camera.readout_s == pytest.approx(readouts_s[k], abs=5e-4)
        assert abs(camera.t_d_s - flight.shown_s(k, camera.t_ref_s)) < 5e-4
        assert (camera.readout_std_s == 0.0) == is_told


@pytest.mark.parametrize("has_frames", [False, True])
def test_the_length_by_which_events_are_behind_is_found_and_frames_are_not(has_frames) -> None:
    """The flight is seen 0.2 px behind its motion in the image."""
    flight = make_flight(3, noise_px=0.05)

    def moved(k: int, times_s: np.ndarray) -> tuple[np.ndarray, dict]:
        way = flight.image_px(k, times_s + 1e-3) - flight.image_px(k, times_s - 1e-3)
        return -0.2 * way / np.linalg.norm(way, axis=1)[:, None], {}

    found = seen_as(flight, moved, has_frames).solved()
    lengths_px = [state.behind_px for state in found.built[0].network.states]
    # 0.05 px of noise on 300 points a camera leave 0.003 px; unknown clocks make it more.
    assert lengths_px == [0.0 if has_frames else pytest.approx(0.2, abs=0.03)] * 3
    for k, camera in enumerate(found.cameras[1:], 1):
        off_s = camera.t_d_s - flight.shown_s(k, camera.t_ref_s)
        assert has_frames or abs(off_s) < 4.0 * camera.t_d_std_s


def shaped(n_cameras: int) -> Flight:
    """A flight seen by the centres of silhouettes whose second moments are known."""
    flight = make_flight(n_cameras, noise_px=0.05)

    def shifted(k: int, times_s: np.ndarray) -> tuple[np.ndarray, dict]:
        R, t = flight.poses[k]
        points = flight.path(times_s) @ R.T + t
        view = View(R, np.diag(CAMERA.K)[:2], points, np.empty((0, 3)))
        J = image_by_place(view.R, view.focal_px, view.points)
        moments = np.tile(MOMENTS_M2, (len(times_s), 1, 1))
        images = J @ moments @ J.transpose(0, 2, 1)
        spreads = np.column_stack([images[:, 0, 0], images[:, 0, 1], images[:, 1, 1]])
        shifts = perspective_shifts(view, moments, BodyRules.depth_power)
        return shifts, {"spreads_px2": spreads}

    return seen_as(flight, shifted)


def test_what_perspective_does_to_silhouettes_turns_no_camera_and_two_tell_none() -> None:
    flight = shaped(4)
    without = replace(flight, seen=[replace(one, spreads_px2=None) for one in flight.seen])
    turned = [
        max(turn_deg(c.R, R) for c, (R, _) in zip(one.solved().cameras, flight.poses, strict=True))
        for one in (without, flight)
    ]
    # As the object does not turn, shifts of some 3 px, with f = 900 px, stay the same: they look
    # like turns of the cameras. Corrected along a path that they have moved, they leave a tenth.
    assert turned[0] > 0.1
    assert turned[1] < 0.2 * turned[0]
    flight = shaped(2)
    for before, after in zip(flight.seen, flight.solved().built[0].network.cameras, strict=True):
        np.testing.assert_array_equal(before.points_px, after.points_px)


DEVIATIONS = np.array([1e-6, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-6])
"""Deviations far below those that sightings give: 1 us, 0.6 mdeg and 1 ppm."""


def true_pair(flight, a, b, turn_rad=0.0):
    """Return the link of a pair without errors, but for a turn of `turn_rad`."""
    link = flight.link(a, b)
    R = Rotation.from_rotvec([0.0, turn_rad, 0.0]).as_matrix() @ link.R
    skew_ppm = flight.clocks[b].skew_ppm - flight.clocks[a].skew_ppm
    clock = replace(link.clock, skew_ppm=skew_ppm)
    return replace(link, clock=clock, R=R, factor=np.diag(DEVIATIONS))


@pytest.fixture(scope="module")
def sure():
    """A flight, and its answer with links without errors between all pairs."""
    flight = make_flight(3)
    return flight, flight.solved({pair: true_pair(flight, *pair) for pair in flight.links()})


def test_sure_pairs_carry_clocks_and_poses(sure) -> None:
    flight, found = sure
    for k, camera in enumerate(found.cameras[1:], 1):
        # The links are true, with tiny deviations: errors of a few deviations are left.
        assert abs(camera.t_d_s - flight.shown_s(k, camera.t_ref_s)) < 1e-5
        assert turn_deg(camera.R, flight.poses[k][0]) < 0.006
        assert camera.t_d_std_s < 1e-5


def test_pairs_count_by_errors_that_last_and_by_the_views_that_they_share(sure) -> None:
    network = replace(sure[1].built[0].network, lasting=8.0)
    offsets, (rows, residuals) = border_offsets(network), known(network)
    for k, ((a, b), pair) in enumerate(network.constraints.items()):
        # Errors last for 8 sightings, and each camera is in two of the three pairs.
        own = slice(7 * k - 22, 7 * k - 15)  # before the last row, which holds the scale
        by_a, by_b, off = pair.rows(network.states[a], network.states[b])
        np.testing.assert_array_equal(rows[own, offsets[a] : offsets[a + 1]], 2.0 * by_a)
        np.testing.assert_array_equal(rows[own, offsets[b] : offsets[b + 1]], 2.0 * by_b)
        np.testing.assert_array_equal(residuals[own], 2.0 * off)


def test_a_pair_tells_the_same_on_clocks_that_count_from_1970(sure) -> None:
    network, since_s = sure[1].built[0].network, 1.7e9
    for (a, b), pair in network.constraints.items():
        states = network.states[a], network.states[b]
        later = [replace(state, middle_s=state.middle_s + since_s) for state in states]
        clock = replace(pair.clock, t_ref_s=pair.clock.t_ref_s + since_s)
        told, then = pair.rows(*states), replace(pair, clock=clock).rows(*later)
        for by, by_then in zip(told[:2], then[:2], strict=True):
            # The last digits of such times, 0.2 us, are 1e-4 s of a rate's lever.
            np.testing.assert_allclose(by_then, by, rtol=1e-3, atol=1e-3 * np.abs(by).max())


def test_a_pair_tells_nothing_of_a_clock_that_strays(sure) -> None:
    network = sure[1].built[0].network
    states = list(network.states)
    states[1] = with_strays(states[1], network.cameras[1], 4.0, 10)
    places = list(range(len(states)))
    links = {pair: true_pair(sure[0], *pair) for pair in network.constraints}
    assert list(agreeing(links, places, states, network.rules)) == [(0, 2)]


def test_focal_lengths_count_as_the_rig_states_and_err_nearly_alike(sure) -> None:
    network = replace(sure[1].built[0].network, constraints={})
    priors = [replace(prior, focal=(0.01, 0.02)) for prior in network.priors]
    rows, _ = known(replace(network, priors=priors, repeats=1.0))
    at = border_offsets(network)[1] + np.arange(9, 11)
    covariance = np.linalg.inv(rows[:, at].T @ rows[:, at])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.01, 0.02])
    assert covariance[0, 1] == pytest.approx(0.98 * 0.01 * 0.02)


@pytest.mark.parametrize(("turn_rad", "sign"), [(0.2, 1.0), (0.0, -1.0)])
def test_a_pair_that_the_sightings_contradict_is_left_out(turn_rad, sign) -> None:
    flight = make_flight(3)
    links, without = flight.links(), flight.solved()
    pair = true_pair(flight, 1, 2, turn_rad)
    links[1, 2] = replace(pair, t=sign * pair.t)
    found = flight.solved(links)
    assert not found.built[0].network.constraints
    for mine, other in zip(found.cameras, without.cameras, strict=True):
        assert pytest.approx(other.R) == mine.R


def test_an_estimate_without_its_covariance_tells_nothing_more() -> None:
    whole = Estimate(
        "tangency", t_d_s=1.0, R=np.eye(3), t=np.array([1.0, 0.0, 0.0]), t_ref_s=2.0,
        skew_ppm=3.0, skew_std_ppm=4.0, covariance=np.diag(DEVIATIONS[:6] ** 2),
    )  # fmt: skip
    assert np.diag(factor_of(whole)) == pytest.approx([*DEVIATIONS[:6], 4e-6])
    assert factor_of(replace(whole, skew_std_ppm=0.0)) is not None  # clocks that run alike
    for missing in ({"covariance": None}, {"skew_std_ppm": np.nan}, {"status": "poor_fit"}):
        assert factor_of(replace(whole, **missing)) is None


def test_pairs_that_share_views_tell_less_than_pairs_that_share_none():
    flight = make_flight()
    pairs = {(a, b): true_pair(flight, a, b) for a, b in combinations(range(4), 2)}
    # Each camera's outline is in three of the six pairs.
    assert shared_by(pairs) == dict.fromkeys(pairs, 3.0)
    assert shared_by({(0, 1): pairs[0, 1], (2, 3): pairs[2, 3]}) == {(0, 1): 1.0, (2, 3): 1.0}
    assert shared_by({(0, 1): pairs[0, 1], (1, 2): pairs[1, 2]}) == {(0, 1): 1.5, (1, 2): 1.5}
    assert shared_by({}) == {}
