"""Methods of other packages: how they are found, run and refused, and the docs' example."""

import json
import re
import sys
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import ssac.pipeline.registry
from experiments.lab.cell import CRASHED
from experiments.lab.code import ROOT
from experiments.lab.grid import Cell, load_config
from experiments.lab.schedule import refusal
from experiments.lab.scored import SCORED, scored_row
from sim.recording import SimConfig
from ssac import Chain, Config, Estimate, Observation, PluginError, SsacError, load_events
from ssac.files.hdf5 import save_events_h5
from ssac.pipeline.registry import METHODS, OURS, Input, Registry, choose_method
from ssac.track.observation import tracked
from tests.answers import assert_same
from tests.mutants import tomllib
from tests.ssac.command import read_json, run
from tests.ssac.methods import flights
from tests.ssac.synthetic import HEIGHT, WIDTH, make_events, make_scene
from tests.ssac.tracks import frame_track, frame_tracks

NAMES = [method.name for method in OURS]

GOOD = '''
from ssac import Estimate

def estimate(cam1, cam2, rig, config=None):
    """Always the same."""
    return Estimate("mine", t_d_s=0.25)
'''


@pytest.fixture(scope="module")
def chain():
    scene = make_scene(0, duration_s=3.0)
    seen = map(Observation, make_events(scene, 0, rate_hz=8000.0, size_m=0.4))
    return Chain([*seen], scene.rig)


def install(folder, package, entry, source=GOOD, version="1.2"):
    """Write a module, and the metadata that an installer writes, into a folder of sys.path."""
    (folder / f"{package}.py").write_text(source)
    info = folder / f"{package}-{version}.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n")
    (info / "entry_points.txt").write_text(f"[ssac.methods]\n{entry}\n")


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder of sys.path, whose modules are removed from sys.modules afterwards."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    before = set(sys.modules)
    yield folder
    for name in set(sys.modules) - before:
        if str(folder) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


OF_METHOD = f"""{GOOD}
from ssac import Input, Method
M = Method("%s", estimate, Input.%s, "sums up", **%r)
"""


def test_ours_come_first_then_others_by_name_and_no_name_is_taken_twice(site):
    others = [name for name in Registry() if name not in NAMES]  # of this environment
    entries = {"a": "zz", "b": "aa", "first": "mine", "second": "mine", "greedy": "ssac"}
    for package, name in entries.items():
        install(site, package, f"{name} = {package}:estimate")
    registry = Registry()
    assert list(registry) == [*NAMES, *sorted([*others, "aa", "mine", "zz"])]
    assert len(registry) == len(list(registry))
    assert "aa" in registry
    assert registry.get("ab") is None
    assert registry["joint"].name == "joint"
    with pytest.raises(SsacError, match=r"'ssac' is taken twice, by this suite and by greedy 1\.2"):
        registry["ssac"]
    with pytest.raises(SsacError, match=r"by first 1\.2 .* and by second 1\.2 \(entry point mine"):
        registry["mine"]


def test_a_function_is_a_method_of_tracks_and_a_method_object_says_the_rest(site, monkeypatch):
    install(site, "plain", "mine = plain:estimate")
    more, variant = {"needs_extrinsics": True, "version": "w3"}, {"known_variant": "no-such"}
    install(site, "halved", "half = halved:M", OF_METHOD % ("half", "TRACKS", variant))
    install(site, "whole", "other = whole:M", OF_METHOD % ("other", "RATES", more))
    monkeypatch.setattr(ssac.pipeline.registry, "METHODS", Registry())
    plain, whole = (choose_method(name) for name in ("mine", "other"))
    assert (plain.name, plain.input, plain.summary) == ("mine", Input.TRACKS, "Always the same.")
    assert (plain.needs_extrinsics, whole.needs_extrinsics) == (False, True)
    assert re.fullmatch(r"plain 1\.2 [0-9a-f]{16}", plain.version)
    assert (whole.input, whole.summary) == (Input.RATES, "sums up")
    assert re.fullmatch(r"whole 1\.2 [0-9a-f]{16} w3", whole.version)
    with pytest.raises(SsacError, match="half names 'no-such' as its variant"):
        choose_method("half", known_extrinsics=True)


NO_FUNCTION = "expected a function of"
YOURS = OF_METHOD % ("yours", "TRACKS", {}) + "f = M"


@pytest.mark.parametrize(
    ("name", "source", "message"),
    [
        ("mine", "import no_such_module", "ModuleNotFoundError"),
        ("mine", "1 / 0", "ZeroDivisionError: division by zero"),
        ("mine", "raise SystemExit(0)", "SystemExit: 0"),
        ("mine", "", "AttributeError"),
        ("mine", "f = 3", f"{NO_FUNCTION} .* got int"),
        ("mine", "def f(a, b): pass", NO_FUNCTION),
        ("my/ne", "def f(a, b, c, d): pass", "a method's name must match"),
        ("mine", YOURS, "the Method is named 'yours': give both one name"),
    ],
)
def test_a_broken_package_is_named_when_it_is_asked_for_only(name, source, message, site):
    install(site, "broken", f"{name} = broken:f", source)
    install(site, "sound", "sound = sound:estimate")
    registry = Registry()
    assert name in list(registry)
    assert [registry[one].name for one in ("ssac", "sound")] == ["ssac", "sound"]
    origin = re.escape(f"broken 1.2 (entry point {name} = broken:f)")
    for _ in range(2):  # not only the first time
        with pytest.raises(SsacError, match=f"{origin}: .*{message}"):
            registry[name]


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        ("0.25", "must return an Estimate, got float"),
        ("exit(0)", r"SystemExit: 0 \(.*careless\.py, line \d"),  # no success of the command's
        ('Estimate("mine")', 't_d_s = nan with status "ok"'),
        ('Estimate("mine", "it is dark")', "the status 'it is dark': give one word"),
        ('Estimate("mine", t_d_s=np.zeros(1))', r"t_d_s of shape \(1,\): give one number"),
        ('Estimate("mine", t_d_s=0.0, skew_ppm=9.0)', "skew_ppm without t_ref_s"),
        ('Estimate("mine", t_d_s=0.0, R=np.full((3, 3), np.nan))', "R = .*: give an array"),
        ('Estimate("mine", t_d_s=0.0, R=2.0 * np.eye(3))', "R = .*: give an array"),
        ('Estimate("mine", t_d_s=0.0, t=np.array([5.0, 0.0, 0.0]))', "t = .*: give an array"),
        ('Estimate("mine", t_d_s=None)', "t_d_s = None: give one number"),
        ('Estimate("mine", t_d_s=0.0, n_samples="a")', "n_samples = 'a': give one whole number"),
        ('Estimate("mine", None)', "status = None: give text"),
        ('Estimate("mine", "dark", reason=None)', "reason = None: give text"),
        ('Estimate("mine", t_d_s=0.0, R="no")', "R = 'no': give an array of numbers, or None"),
        ('Estimate("mine", t_d_s=0.0, costs=[[1.0]])', r"costs = \[\[1\.0\]\]: give an array"),
    ],
)
def test_what_would_spoil_a_table_is_an_error(returned, message, site, chain):
    source = "import numpy as np\n" + GOOD.replace('Estimate("mine", t_d_s=0.25)', returned)
    install(site, "careless", "mine = careless:estimate", source)
    # A PluginError counts as a crash; an SsacError would blame the data.
    with pytest.raises(PluginError, match=rf"careless 1\.2 \(entry .*{message}"):
        chain.estimate(Registry()["mine"])


def test_values_that_mean_the_same_as_those_of_an_estimate_become_those(site, chain, tmp_path):
    """Bug: they were kept, and table, JSON and page were bugs of ours."""
    a_pose = "R=np.eye(3).tolist(), t=[0, 0, 1], F=np.eye(3, dtype=int).tolist()"
    numbers = "np.float32(0.25), t_d_std_s=np.float32(0.015625), n_samples=np.int64(5), d_avg_px=1"
    curve = "alternatives_s=[1, 2], candidates_s=[0.0, 0.25], costs=(3, np.float32(2))"
    returned = f'Estimate("mine", t_d_s={numbers}, {a_pose}, {curve})'
    source = "import numpy as np\n" + GOOD.replace('Estimate("mine", t_d_s=0.25)', returned)
    install(site, "casual", "mine = casual:estimate", source)
    result = ssac.Result(chain.answer(Registry()["mine"]))
    assert_same(
        result.estimate,
        Estimate(
            "mine", t_d_s=0.25, t_d_std_s=0.015625, n_samples=5, d_avg_px=1.0,
            R=np.eye(3), t=np.array([0.0, 0.0, 1.0]), F=np.eye(3),
            alternatives_s=np.array([1.0, 2.0]), candidates_s=np.array([0.0, 0.25]),
            costs=np.array([3.0, 2.0]),
        ),
    )  # fmt: skip
    assert result.summary()
    json.dumps(result.to_dict())
    result.report(tmp_path / "page.html")


def test_a_crash_is_the_packages_and_a_row_of_a_table(site, chain, recorded, tmp_path, monkeypatch):
    helper = "import numpy as np\ndef helper(): return np.linalg.inv(np.zeros((2, 2)))\n"
    install(site, "fragile", "mine = fragile:estimate", helper + GOOD.replace("0.25", "helper()"))
    for module in ("ssac.pipeline.registry", "experiments.lab.scored"):
        monkeypatch.setattr(f"{module}.METHODS", Registry())
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    args = (*recorded.pair, "--rig", recorded / "rig.yaml", "--method", "mine")
    _, out, err = run("sync", *args, code=3)
    (file,) = tmp_path.glob("ssac-bug-*/traceback.txt")
    assert out == ""
    whose = "fragile 1.2 (entry point mine = fragile:estimate): LinAlgError: Singular matrix"
    assert err.splitlines()[-1] == (
        f"error: {whose} ({site / 'fragile.py'}, line 2): a bug of that package; please report it"
        f" with the traceback in {file}"
    )
    assert "Singular matrix" in file.read_text()
    cell = Cell(SimConfig(), 0, 0, 0.0, Config(), "mine", {"sim.t_d_s": 0.0})
    with pytest.raises(PluginError) as crash:
        scored_row(cell, chain)
    row = refusal(SCORED, crash.value, "mine")
    assert row["status"] == CRASHED
    assert f"PluginError: {whose}" in row["reason"]


CALLABLE = """
class Mine(list):  # which cannot be hashed
    def __call__(self, cam1, cam2, rig, config): return estimate(cam1, cam2, rig)

mine = Mine()
"""


def test_any_callable_runs(site, chain):
    install(site, "called", "mine = called:mine", GOOD + CALLABLE)
    assert chain.estimate(Registry()["mine"]).t_d_s == 0.25


LOOKING = """
from ssac import Estimate, Input, Method, two_views, usable_events

SEEN = []

def estimate(cam1, cam2, rig, config):
    SEEN.append((cam1, cam2, rig, config, usable_events(cam1, cam2, rig, config),
                 two_views(cam1, cam2, rig, config)))
    return Estimate(__name__, t_d_s=0.05)

def of(kind, **says): return Method(__name__, estimate, kind, "looks", **says)

TRACKS, RATES, FRAMES = (of(kind) for kind in Input)
KNOWN = of(Input.TRACKS, needs_extrinsics=True)
"""


def test_a_method_gets_what_is_clean_and_more_only_if_it_asks(site, recorded, monkeypatch):
    names = ("tracks", "frames", "known")
    for name in names:
        install(site, name, f"{name} = {name}:{name.upper()}", LOOKING)
    monkeypatch.setattr(ssac.pipeline.registry, "METHODS", Registry())
    chain = Chain(recorded.pair, str(recorded / "rig_extrinsics.yaml"))
    for name in names:
        chain.estimate(name)
        ((*cameras, rig_shown, config, events, views),) = import_module(name).SEEN
        is_known = name == "known"
        assert (rig_shown.T_2_1 is not None) == (views.rig.T_2_1 is not None) == is_known
        if name == "frames":
            assert [len(one.frames) for one in cameras] == [400, 400]
            assert [len(one.frame_times_s) for one in cameras] == [400, 400]
            continue
        assert cameras == [chain.clean(0), chain.clean(1)]
        assert all(one is seen.events for one, seen in zip(events, cameras, strict=True))
        assert views.motion1.times_us is chain.views().motion1.times_us
        assert config.interval_s == (-1.0, 1.0)
        assert (cameras[0].frames, cameras[0].frame_times_s) == (None, None)


def test_the_version_follows_every_source_file(site):
    def version_after(change):
        change()
        for name in [name for name in sys.modules if name.startswith("parts")]:
            del sys.modules[name]
        return Registry()["mine"].version

    package = site / "parts"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "method.py").write_text(GOOD)
    install(site, "other", "mine = parts.method:estimate")
    first = version_after(lambda: None)
    assert version_after(lambda: (package / "notes.txt").write_text("no code")) == first
    edited = version_after(lambda: (package / "helper.py").write_text("x = 1"))
    again = version_after(lambda: (package / "helper.py").write_text("x = 2"))
    moved = version_after(lambda: (package / "helper.py").rename(package / "helped.py"))
    assert len({first, edited, again, moved}) == 4


# --- The example of docs/methods.md ---


def code_blocks(language):
    text = (ROOT / "docs" / "methods.md").read_text()
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


PYPROJECT, GRID = code_blocks("toml")
MODULE, METHOD_OBJECT = code_blocks("python")


@pytest.fixture
def example(site, monkeypatch):
    """Install the example; return the registry that has it."""
    pyproject = tomllib.loads(PYPROJECT)
    (entry,) = pyproject["project"]["entry-points"]["ssac.methods"].items()
    (name,) = pyproject["tool"]["setuptools"]["py-modules"]
    install(site, name, " = ".join(entry), MODULE, pyproject["project"]["version"])
    registry = Registry()
    monkeypatch.setattr(ssac.pipeline.registry, "METHODS", registry)
    return registry


def test_the_example_finds_the_offset_of_equal_views(example, recorded, tmp_path):
    """Both cameras see the same, so that the image speeds are equal at the true offset."""
    events = load_events(recorded / "cam1.h5").events
    events["t"] += 250_000
    few = np.delete(events, slice(None, None, 100))  # equal events would be refused as a copy
    save_events_h5(tmp_path / "later.h5", few, WIDTH, HEIGHT)
    out = tmp_path / "out.json"
    args = (recorded / "cam1.h5", tmp_path / "later.h5", "--rig", recorded / "rig.yaml")
    _, said, _ = run("sync", *args, "--method", "track_speed", "--json", out)
    assert "track_speed: Correlation of the object's image speeds, offset only." in said
    found = read_json(out)
    assert found["method"] == "track_speed"
    assert found["t_d_s"] == pytest.approx(0.25, abs=1e-9)  # a whole number of its steps


def test_the_example_takes_tracks_and_all_offsets_of_a_straight_path_for_an_interval(example):
    """Bug: it asked for what the motion of events alone has."""
    scene = make_scene(0, duration_s=8.0)
    one, other = (frame_track(scene, 1, 50.0, offset_s) for offset_s in (0.0, 0.25))
    few = ssac.PointTrack(np.delete(other.times_s, 20), np.delete(other.points_px, 20, axis=0))
    chain = Chain([tracked(one), tracked(few)], scene.rig)
    found = chain.estimate(example["track_speed"])
    assert (found.status, found.t_d_s) == ("ok", pytest.approx(0.25, abs=1e-9))  # whole steps
    # Bug: a method that gave its config to two_views was refused where all offsets were searched.
    scene = replace(flights.scene_of(flights.straight), duration_s=10.0)
    chain = Chain([*map(tracked, frame_tracks(scene, 0.3))], scene.unknown_rig)
    for method in (example["track_speed"], METHODS["joint"]):
        expected = chain.answer(method)
        for asked in (Config(search="all"), Config(rates=(0.9, 1.1))):
            found = chain.under(asked).answer(method)
            assert_same(found.estimate, expected.estimate)
            assert found.config.interval_s == expected.config.interval_s
    assert (expected.estimate.has_offset, expected.start) == (True, None)


def test_the_grid_of_the_example_is_read_and_it_may_be_an_object(example, site, monkeypatch):
    install(site, "track_speed", "track_speed = track_speed:METHOD", MODULE + METHOD_OBJECT, "1.0")
    summary = "correlation of the object's image speeds, offset only"
    assert example["track_speed"].summary == summary
    monkeypatch.setattr("experiments.lab.grid.METHODS", example)
    (site / "angles.toml").write_text(GRID)
    grid = tomllib.loads(GRID)
    methods = [cell.method for cell in load_config(site / "angles.toml").cells()]
    each = grid["flights"] * len(grid["grid"]["sim"]["angle_deg"])
    assert [methods.count(name) for name in grid["methods"]] == [each, each]
    assert len(methods) == 2 * each
