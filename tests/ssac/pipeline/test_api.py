"""`ssac.sync`: all kinds of input give the same answer, and a wrong argument one clear error."""

import ast
import copy
import pickle
from dataclasses import fields, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import yaml

import ssac
from ssac import Chain, Config, Estimate, PointTrack, SsacError
from ssac.camera import Camera, Cameras, Rig, same_camera
from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import save_track
from ssac.methods.method import our_methods
from ssac.pipeline.opened import Known, cameras_of, check_distance, opened, opened_rig
from ssac.pipeline.report import report_rows
from ssac.track.observation import Observation, tracked
from tests.answers import assert_same
from tests.ssac.synthetic import HEIGHT, WIDTH, K, make_events, make_scene
from tests.ssac.tracks import frame_track, rig_document

SCENE = make_scene(0, duration_s=5.0)
EVENTS = make_events(SCENE, 0, 0.05, 6_000.0, 0.4)
CAMERA = Camera(K.copy(), WIDTH, HEIGHT)
RIG = Rig(CAMERA, CAMERA)
OTHER_ORDER = np.dtype([("p", "u1"), ("y", "<i4"), ("t", "<i8"), ("x", "<i4")])
METAVISION = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
DTYPES = (OTHER_ORDER, METAVISION, EVENTS[0].dtype.newbyteorder(">"))
WITHOUT_SIZE = partial(ssac.EventFile, width=None, height=None)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("api")
    for k, events in enumerate(EVENTS, start=1):
        save_events_h5(folder / f"cam{k}.h5", events, WIDTH, HEIGHT)
    save_track(folder / "cam1.csv", frame_track(SCENE, 1, 30.0))
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig_document()))
    return folder


@pytest.fixture(scope="module")
def result(files):
    return ssac.sync(files / "cam1.h5", files / "cam2.h5", files / "rig.yaml")


# --- Kinds of input ---


def test_every_kind_of_camera_is_opened_as_the_same(files):
    paths = [files / f"cam{k}.h5" for k in (1, 2)]
    kinds = [paths, [*map(str, paths)], EVENTS, [*map(ssac.load_events, paths)]]
    kinds += [[kind(one) for one in EVENTS] for kind in (Observation, WITHOUT_SIZE)]
    kinds += [[one[[*kind.names]].astype(kind) for one in EVENTS] for kind in DTYPES]
    for cameras in kinds:
        sources = opened(cameras, Cameras((CAMERA, CAMERA)))
        for given in (sources, Chain(cameras, RIG).sources, Chain(sources, RIG).sources):
            for source, events in zip(given, EVENTS, strict=True):
                assert not source.has_track
                np.testing.assert_array_equal(source.read().events, events, strict=True)


def test_every_kind_of_track_is_opened_as_the_same(files):
    expected = ssac.load_track(files / "cam1.csv")
    for track in (files / "cam1.csv", expected, tracked(expected)):
        seen = [track, EVENTS[1]]
        for source, _ in (opened(seen, Cameras((CAMERA, CAMERA))), Chain(seen, RIG).sources):
            assert source.has_track
            found = source.read().track
            np.testing.assert_array_equal(found.times_s, expected.times_s)
            np.testing.assert_array_equal(found.points_px, expected.points_px)


def test_every_kind_of_rig_is_opened_as_the_same(files):
    path, cameras = files / "rig.yaml", (CAMERA, CAMERA)
    for given in (str(path), RIG, ssac.load_rig(path), cameras, [*cameras], Cameras(cameras)):
        numbered = (opened_rig(given, 2, numbers) for numbers in ((1, 2), [1, 2]))
        for rig in (opened_rig(given, 2), *numbered, Chain(EVENTS, given).rig):
            assert all(same_camera(camera, CAMERA) for camera in rig.cameras)
            assert rig.pair(0, 1).T_2_1 is None


def test_a_list_of_cameras_and_a_methods_own_function_give_the_same(files, result):
    for found in (ssac.sync([*EVENTS], RIG), ssac.sync([*EVENTS], rig=RIG)):
        assert_same(found.estimate, result.estimate)
    assert_same(ssac.tangency(*EVENTS, RIG), result.estimate)


def test_a_field_counts_more_than_that_of_a_config():
    fields = {"interval_s": (-0.3, 0.4), "denoise": False, "seed": 3}
    mixed = ssac.sync(*EVENTS, RIG, "joint", Config(trials=500, seed=9), **fields)
    expected = ssac.sync(*EVENTS, RIG, "joint", trials=500, **fields)
    assert_same(mixed.estimate, expected.estimate)
    assert mixed.answer.config.interval_s == (-0.3, 0.4)
    assert np.array_equal(CAMERA.K, K)  # arguments are not changed


def test_an_interval_that_is_said_is_searched_though_it_is_the_default_one():
    far = EVENTS[1].copy()
    far["t"] += 1_000_000_000
    said = ssac.sync(EVENTS[0], far, RIG, "ssac", interval_s=np.array([-1.0, 1.0]))
    assert (said.status, said.answer.start) == ("no_common_time", None)
    assert ssac.sync(EVENTS[0], far, RIG, "ssac").answer.start is not None


# --- The result ---


def test_a_result_has_what_the_estimate_has(result):
    for name in Estimate.__dataclass_fields__:
        assert getattr(result, name) is getattr(result.estimate, name)
    assert result.clock.t_d_s == result.t_d_s
    assert result.has_offset
    assert {"t_d_s", "R", "note", "summary", "plot", "estimate", "clock_std_s"} <= set(dir(result))
    with pytest.raises(AttributeError, match="t_d_ms"):
        result.t_d_ms  # noqa: B018


def test_a_result_shows_itself_and_can_be_pickled_and_copied(result):
    assert repr(result).startswith("<ssac.Result tangency ok, t_d 49.")
    assert len(repr(result)) < 80
    unsure = replace(result.estimate, t_d_std_s=np.nan)
    plain = replace(result, answer=replace(result.answer, estimate=unsure))
    assert repr(plain) == repr(result).partition(", 1 sigma")[0] + ">"
    refused = ssac.sync(*EVENTS, RIG, "joint", interval_s=(-1.0, -0.5))
    assert repr(refused) == f"<ssac.Result joint {refused.status}>"
    assert refused.status != "ok"
    method = replace(result.answer.method, needs_extrinsics=True)
    strange = replace(result, answer=replace(result.answer, rig_name="<a & b>", method=method))
    html = strange._repr_html_()
    assert "&lt;a &amp; b&gt;" in html
    assert "<a" not in html
    assert html.count("<tr>") == len(report_rows(strange.answer))
    for again in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result), copy.copy(result)):
        assert_same(again.estimate, result.estimate)
        assert again.summary() == result.summary()


# --- Wrong arguments ---

ONE, OTHER = EVENTS
A_CAMERA = "expected a file, a structured array of events with the fields t, x, y and p, a ssac.Obs"
BAD_K = [3.0, None, np.eye(2), [[1, 2], [3]], {"fx": 200}, np.zeros((3, 3)), -K]
POSES = [np.eye(3), "nonsense", np.full((4, 4), np.nan), 2.0 * np.eye(4)]
UNEQUAL = [((9, 2),), ((10, 3),), ((10, 2), (9,))]  # shapes of points and deviations
WRONG = [
    ((1, OTHER, RIG), rf"^camera 1: {A_CAMERA}.* got int 1$"),
    ((ONE, None, RIG), rf"^camera 2: {A_CAMERA}.* got NoneType None$"),
    ((np.zeros((5, 4)), OTHER, RIG), r"^camera 1: .*without t, x, y, p: build it"),
    ((Observation(ONE[::-1], name="left.h5"), OTHER, RIG), r"^left\.h5: events must be sorted"),
    (([(1, 2, 3, 4)], OTHER, RIG), r"^sync: a list of cameras .* call sync\(\[a, b, c\], rig, me"),
    (([(1, 2, 3, 4), (2, 3, 4, 5)], RIG), "^camera 1: .* got tuple"),
    (([], RIG), "^sync: expected two cameras or more, got a list of 0$"),
    (([ONE, OTHER], RIG, "joint"), "beside it stands their rig"),
    ((ONE, OTHER), "^rig: expected a rig file, a ssac.Rig or the ssac.Camera of each"),
    ((ONE, OTHER, CAMERA), "^rig: expected .* got Camera"),
    ((ONE, OTHER, [K, K]), "^rig: expected .* got list"),
    ((ONE, OTHER, [CAMERA]), "^rig: it has 1 cameras, and there are 2 recordings"),
    ((ONE, OTHER, Rig(replace(CAMERA, height=260.5), CAMERA)), "got 346 x 260.5"),
    ((ONE, OTHER, Rig(CAMERA, None)), "^camera 2: expected a ssac.Camera, got None"),
    ((ONE, ONE, RIG), "^one recording: given for both cameras: give each camera's"),
    (
        (ONE, Observation(ONE).delayed(0.02), RIG),
        "^camera 1 and camera 2 hold the same points: one is a copy of the other",
    ),
    ((Observation(None), OTHER, RIG), "^camera 1: events must be a 1-D array"),
    ((np.array(ONE[0]), OTHER, RIG), "^camera 1: events must be a 1-D array"),
    ((ONE[:0], OTHER, RIG), "^camera 1: there are no events"),
    ((Observation([1, 2]), OTHER, RIG), "got list: build it with ssac.events"),
    (
        (Observation(ONE, frames=np.zeros((3, 2, 2))), OTHER, RIG, "zncc_f"),
        r"^camera 1: frames must be an array \(m, height, width\), and frame_times_s one of \(m,\)",
    ),
    ((ssac.EventFile(ONE, 640, 480), OTHER, RIG), "at 346 x 260 px, but camera 1 .* at 640 x 480"),
    ((ssac.EventFile(None, None, None), OTHER, RIG), "^camera 1: events must"),
    ((PointTrack([0.0, 1.0], [[1, 2], [3, 4]]), OTHER, RIG), "numpy.asarray"),
    ((PointTrack(None, None), OTHER, RIG), "^camera 1: a track must have"),
    ((ONE, OTHER, RIG, 3), "^unknown method 3: use one of ssac, ssac-known"),
    ((ONE, OTHER, RIG, ["joint"]), r"^unknown method \['joint'\]: use one of"),
    *(((ONE, OTHER, [CAMERA, Camera(bad, WIDTH, HEIGHT)]), "^camera 2: .*got") for bad in BAD_K),
    *(((ONE, OTHER, Rig(CAMERA, CAMERA, bad)), "^the rig, .*: expected a") for bad in POSES),
]
for focal in (0.008, 8.0, 1e6):
    rig = Rig(CAMERA, Camera(np.diag([focal, focal, 1.0]), WIDTH, HEIGHT))
    WRONG.append(((ONE, OTHER, rig), "give them in pixels of this resolution"))
for bad in UNEQUAL:  # Bug: NumPy raised an error of broadcasting
    track = PointTrack(0.1 * np.arange(10), *map(np.ones, bad))
    WRONG.append(((track, OTHER, RIG), "^camera 1: a track of 10 times must have points"))

OPTIONS = [
    ("n_sample", 3, "^n_sample: is no argument of sync and no field of .*: did you mean n_samples"),
    ("known_extrinsic", True, "did you mean known_extrinsics"),
    ("search_all", True, "^search_all: is no argument of sync .*: did you mean search"),
    ("zzz", 1, "^zzz: is no argument of sync and no field of ssac.Config$"),
    ("config", {"n_samples": 3}, "^config: expected a ssac.Config, got dict"),
    ("method", ssac.joint, "^unknown method <function joint"),
    ("interval_s", (1, -1), r"^interval_s must be two finite numbers in ascending order, got"),
    ("rates", (-1, 1), "^rates must be positive"),
    ("trials", 2.5, "^trials must be a whole number of 1 to 10000000, got 2.5"),
    ("final_trials", 10**30, "^final_trials must be a whole number"),
    ("n_min", 0, "^n_min must be a whole number of 1"),
    ("seed", -1, "^seed must be a whole number of 0"),
    ("half_window_s", 0.0, "^half_window_s must be positive and finite, got 0"),
    ("min_swings", -1, "^min_swings must be 0 or more, and finite, got -1"),
    ("roughness_ppm", 0.0, "^roughness_ppm must be above 0 and up to 100000, got 0"),
    ("border_px", -3, "^border_px must be a whole number of 0 to .*, got -3"),
    ("max_border_fraction", 1.5, "^max_border_fraction must be 0 to 1, got 1.5"),
    ("cameras", (1, 3), r"^cameras: \(1, 3\) are of a rig file, and none was given"),
    ("focal_std", "a", "^focal_std: expected a deviation of 0 or more, got 'a'"),
    ("focal_std", True, "^focal_std: expected a deviation of 0 or more, got True"),
    ("centre_std_px", -1.0, "^centre_std_px: expected a deviation of 0 or more, got -1.0"),
    ("estimate_readout", True, "^--estimate-readout: expected a track of a frame camera, got ev"),
    ("reading", 3, "^reading: expected a ssac.Reading, got 3"),
    ("known", Known(positions="at.csv"), "^known: positions and RTK are for more than two cameras"),
    ("log", 3, "^log: expected a function of a line of text, such as print, got 3"),
    *(
        (one.name, "1", rf"^{one.name}\b.* (must be|expected) .*, got '1'")
        for one in fields(Config)
    ),
]


WRONG += [((ONE, OTHER, RIG), message, {name: value}) for name, value, message in OPTIONS]


@pytest.mark.parametrize(("args", "message", "options"), [(*one, {})[:3] for one in WRONG])
def test_a_wrong_argument_or_option_is_one_clear_error(args, message, options):
    with pytest.raises(SsacError, match=message):
        ssac.sync(*args, **options)


def test_a_wrong_camera_or_chain_is_one_clear_error_on_every_path():
    rig, seen = Rig(replace(CAMERA, width=None), CAMERA), (Observation(ONE), Observation(OTHER))
    for call in (ssac.joint, ssac.two_views, ssac.usable_events):
        with pytest.raises(SsacError, match=r"^camera 1: the resolution must be"):
            call(ONE, OTHER, rig)
    for args in ((seen, rig), (None, RIG), (seen[:1], RIG), ((ONE, 3), RIG), (seen, None)):
        with pytest.raises(SsacError, match=r"resolution|expected"):
            Chain(*args)
    for pair in ((0, 5), (1, 0), (1, 1)):
        with pytest.raises(SsacError, match="there are 2, numbered from 0 on"):
            Chain(seen, RIG).answer("joint", *pair)
    rig = Cameras((CAMERA,) * 3, (SCENE.rig.T_2_1,))  # of camera 2; camera 3 has none
    with pytest.raises(SsacError, match="or none at all, got 1: give None"):
        cameras_of(rig)
    assert cameras_of(replace(rig, steps=(*rig.steps, None))).pair(0, 2).T_2_1 is None


def test_wrong_numbers_of_cameras_and_what_is_known_are_one_clear_error(files):
    for numbers in (3, (1,), "ab", ("a", "b"), (1.5, 2), (0, 1), (1, 1), (1, 3)):
        with pytest.raises(SsacError, match=r"^cameras: expected the numbers|for both|no cam2"):
            ssac.sync(ONE, OTHER, files / "rig.yaml", cameras=numbers)
    for known in ({"distance_m": "a"}, {"distance_m": -1}, {"distance_m": 1, "rtk": Path("a")}):
        with pytest.raises(SsacError, match=r"distance_m"):
            Known(**known)


def test_a_stated_distance_must_be_that_of_a_pose_in_metres_that_is_taken_as_known():
    T_2_1 = np.eye(4)
    T_2_1[:3, 3] = (3.0, 0.0, 4.0)
    rig = Rig(CAMERA, CAMERA, T_2_1)
    for distance_m in (4.89, 5.11, 5000.0):
        said = f"are 5 m apart in the rig, .* and {distance_m:g} m were stated"
        with pytest.raises(SsacError, match=said):
            ssac.sync(*EVENTS, rig, known_extrinsics=True, known=Known(distance_m))
    unknown = replace(rig, in_metres=False)
    for distance_m, other in ((4.91, rig), (5.09, rig), (9.0, unknown), (9.0, RIG)):
        check_distance(distance_m, cameras_of(other))
    assert ssac.sync(*EVENTS, rig, "event_rate", known=Known(9.0)).answer.distance_m == 9.0


def test_the_public_names_are_these_and_each_is_what_it_says():
    listed = (
        "Answer Camera Cameras Chain Clock ClockJump Config EVENT_DTYPE Estimate EventFile Input"
        " Known Method NetworkResult ObjectMotion Observation Pairs PairsAt PluginError PointTrack"
        " Reading Result Rig Signal SsacError Status TwoViews"
        " albl event_rate joint joint_known ssac_known tangency tangency_known zncc_e zncc_f"
        " binned checked correlation_estimate counted lags_of load_events load_rig load_track sync"
        " two_views usable_events zncc"
    )
    names = {*listed.split()}
    assert set(ssac.__all__) == names <= set(dir(ssac))
    assert {getattr(getattr(ssac, name), "__name__", name) for name in names} == names
    found = {}
    exec("import ssac\nfrom ssac import *", found)
    assert found["ssac"] is ssac  # the paper's method has the same name
    assert callable(ssac.ssac)
    assert ssac.__version__ == version("ssac-suite")
    with pytest.raises(AttributeError, match="has no attribute 'jiont'"):
        ssac.jiont  # noqa: B018


def test_functions_of_methods_have_their_types():
    tree = ast.parse(Path(str(ssac.__file__)).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    typed = {ast.unparse(node.target) for node in block.body if isinstance(node, ast.AnnAssign)}
    assert typed == {"__version__", *(one.name.replace("-", "_") for one in our_methods())}
