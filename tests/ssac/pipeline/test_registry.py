"""Laws of all our methods, how they are listed, and the choice of one."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from ssac.camera import Rig
from ssac.cli.command_line import COMMANDS, command_line, run
from ssac.cli.sync import complete_method
from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.files.rigs import load_rig
from ssac.methods.method import all_summaries, our_methods
from ssac.pipeline.chain import Chain
from ssac.pipeline.opened import Recording
from ssac.pipeline.registry import DEFAULT, METHODS, OURS, Input, choose_method
from ssac.track.observation import Observation
from tests.recorded import T_D_S
from tests.ssac.synthetic import angle_deg, make_events, make_scene, rotation_angle_deg

NAMES = [method.name for method in OURS]


@pytest.fixture(scope="module")
def data(recorded):
    rig = load_rig(recorded / "rig_extrinsics.yaml")
    cameras = (Recording(recorded / f"cam{k}.h5", rig.cam1, f"camera {k}") for k in (1, 2))
    return *(camera.read("images") for camera in cameras), rig


def chain_of(data, config=None) -> Chain:
    cam1, cam2, rig = data
    return Chain((cam1, cam2), rig, config)


def test_what_a_method_lacks_is_said(data):
    cam1, cam2, rig = data
    unposed, blind = Rig(rig.cam1, rig.cam2), Observation(cam2.events)
    lacks = {one.name: (cam1, cam2, unposed) for one in OURS if one.needs_extrinsics}
    for name, given in (lacks | {"zncc_f": (cam1, blind, rig)}).items():
        chain, said = chain_of(given), f"the rig: {name} needs the extrinsics"
        if name == "zncc_f":
            said = "camera 2: zncc_f compares intensity frames, and there are none"
        assert said in chain.lacks(METHODS[name])
        with pytest.raises(SsacError, match=said):
            chain.estimate(name)


def test_a_name_and_known_extrinsics_choose_a_method():
    assert choose_method().name == DEFAULT
    assert choose_method(known_extrinsics=True).name == "tangency-known"
    assert choose_method("ssac", known_extrinsics=True).name == "ssac-known"
    assert choose_method("ssac-known").name == "ssac-known"
    for method in OURS:
        assert not method.known_variant or METHODS[method.known_variant].needs_extrinsics
    with pytest.raises(SsacError, match="zncc_e makes no use of known extrinsics"):
        choose_method("zncc_e", known_extrinsics=True)
    with pytest.raises(SsacError, match=r"unknown method 'scac': use one of .*ssac-known"):
        choose_method("scac")


@pytest.mark.parametrize("delay_s", [-0.3, 0.005])
@pytest.mark.parametrize("name", [name for name in NAMES if METHODS[name].follows_clock])
def test_a_delay_of_camera_2_moves_the_offset_and_nothing_else(name, delay_s, data):
    cam1, cam2, rig = data
    config = Config(interval_s=(-0.4, 0.5))
    delayed = replace(config, interval_s=(-0.4 + delay_s, 0.5 + delay_s))
    expected = chain_of(data, config).estimate(name).delayed(delay_s)
    estimate = chain_of((cam1, cam2.delayed(delay_s), rig), delayed).estimate(name)
    assert (estimate.status, estimate.n_samples) == ("ok", expected.n_samples)
    for field in ("t_d_s", "t_d_std_s", "R", "t", "covariance", "candidates_s", "costs"):
        found, wanted = getattr(estimate, field), getattr(expected, field)
        assert (found is None) == (wanted is None)
        if wanted is not None:
            # Rounding of times in seconds; events may not enter or leave the windows by it.
            np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-10)


# --- No method knows where in the search interval the offset is ---

DURATION_S = 8.0
SHIFTS_S = (-0.3, 0.3137)  # the last one by no whole step of any search


@pytest.fixture(scope="module")
def answer():
    """Answer by name and shift of the interval, for a flight whose light flickers.

    So event rates and frames tell the offset too.
    """
    scene, rng = make_scene(0, duration_s=DURATION_S), np.random.default_rng(5)
    frames = np.cumsum(rng.integers(-9, 10, round(DURATION_S / 0.02))) % 256
    frames = frames.astype(np.uint8)[:, None, None]
    kept = rng.uniform(0.2, 1.0, round(DURATION_S / 0.05) + 1)
    cameras = []
    streams = make_events(scene, 0, T_D_S, size_m=0.4)
    for events, offset_s in zip(streams, (0.0, T_D_S), strict=True):
        share = kept[((1e-6 * events["t"] - offset_s) / 0.05).astype(int)]
        times_s = 0.02 * (np.arange(len(frames)) + 0.5) + offset_s
        cameras.append(Observation(events[rng.random(len(events)) < share], frames, times_s))
    chain = Chain(cameras, scene.rig)

    def answered(name, shift_s):
        interval_s = (T_D_S - 1.0 + shift_s, T_D_S + 1.0 + shift_s)
        return chain.under(Config(interval_s, denoise=False)).estimate(name)

    return answered


@pytest.mark.parametrize("shift_s", SHIFTS_S)
@pytest.mark.parametrize("name", NAMES)
def test_every_method_answers_alike_wherever_the_interval_lies(name, shift_s, answer):
    centred, moved = answer(name, 0.0), answer(name, shift_s)
    assert (centred.status, moved.status) == (Status.OK, Status.OK)
    # Counts of events jump at the candidates, which are others: 10 us are the search's resolution.
    # Samples begin where the search ended, so their windows hold other events; where a free skew
    # makes t_d uncertain (0.6 ms with a known pose here) that moves it by a part of its deviation.
    part_s = 0.1 * centred.t_d_std_s if np.isfinite(centred.t_d_std_s) else 0.0
    assert moved.t_d_s == pytest.approx(centred.t_d_s, abs=max(0.03e-3, part_s))
    if centred.R is not None:
        assert rotation_angle_deg(moved.R, centred.R) < 0.02
        assert angle_deg(moved.t, centred.t) < 0.02
    # The intervals hold the greatest correlation of all, so that also the correlations' answers are
    # the same; a greater one outside of one of them would be a right answer to another question.
    assert moved.t_d_s == pytest.approx(T_D_S, abs=0.011)  # half a frame, at most


# --- Lists of methods, which import none ---

HEAVY = {"numba", "scipy", "cv2", "pandas", "matplotlib", "h5py", "pyrender", "trimesh"}


def test_ours_are_declared_in_their_files_which_is_all_that_a_method_takes(tmp_path, monkeypatch):
    """In the order of the paper's method, what refines it, and what it is compared with."""
    names = ["ssac", "ssac-known", "joint", "joint-known", "tangency", "tangency-known"]
    assert [method.name for method in OURS] == [*names, "albl", "zncc_e", "zncc_f", "event_rate"]
    assert list(all_summaries())[: len(OURS)] == [method.name for method in OURS]
    (tmp_path / "mine.py").write_text(
        '@method("mine-too", "the \'second\'", input=Input.RATES)\n'
        '@method(\n    "mine",\n    "the first",\n    place=3,\n)\n'
        "@cached\ndef found(views: TwoViews) -> Estimate:\n    1 / 0\n"
    )
    monkeypatch.setattr("ssac.methods.method.__file__", str(tmp_path / "method.py"))
    first, second = our_methods.__wrapped__()
    told = first.name, first.summary, first.runs
    assert told == ("mine", "the first", "ssac.methods.mine:found")
    told = second.name, second.summary, second.input
    assert told == ("mine-too", "the 'second'", Input.RATES)


def test_help_lists_every_method_with_its_summary_and_a_shell_completes_its_name(capsys):
    assert run(command_line(COMMANDS, ""), ["sync", "--help"], "ssac") == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name, summary in all_summaries().items():
        assert f"{name} {summary}" in shown
    assert [name for name, _ in complete_method("zncc")] == ["zncc_e", "zncc_f"]


@pytest.mark.parametrize("module", ["ssac.cli", "experiments"])
@pytest.mark.parametrize("args", [("--version",), ("sync", "--help"), ("sync",)])
def test_nothing_heavy_is_imported_for_help_or_for_bad_usage(module, args):
    code = f"""
import runpy, sys
sys.argv = ["ssac", *{args!r}]
try:
    runpy.run_module({module!r}, run_name="__main__", alter_sys=True)
except SystemExit:
    pass
print(*{{name.partition(".")[0] for name in sys.modules}})
"""
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "typer" in shown.stdout.split("\n")[-2].split()
    assert not HEAVY & set(shown.stdout.split("\n")[-2].split())
