"""`ssac simulate` as its users run it."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from experiments.cli import app, main
from sim.errors import SimError
from ssac.errors import SsacError
from ssac.files.event_files import load_events, load_frames
from ssac.files.rigs import load_rig
from tests.left_over import ended_process, made_by

FAST = ["--duration", "2", "--max-step", "2", "--lattice", "2", "0"]


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["simulate", *map(str, arguments)])


def hashes(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}


@pytest.mark.render
def test_the_folder_holds_what_the_design_says(tmp_path: Path) -> None:
    out = tmp_path / "new" / "recording"
    result = run(out, *FAST, "--t-d", 0.05, "--angle", 60, "--text", "--figures")
    assert result.exit_code == 0, result.output
    assert "| median image speed [px/s] | 198 |" in result.stdout
    names = {path.name for path in out.iterdir()}
    assert names == {
        "cam1.h5", "cam2.h5", "cam1.txt", "cam2.txt", "rig.yaml", "rig_extrinsics.yaml",
        "truth.json",
    }  # fmt: skip
    truth = json.loads((out / "truth.json").read_text())
    assert truth["t_d_s"] == 0.05
    rig = load_rig(out / "rig_extrinsics.yaml")
    assert rig.T_2_1 is not None
    np.testing.assert_allclose(rig.T_2_1[:3, :3], truth["R"], atol=1e-15)  # as written: repr
    assert load_rig(out / "rig.yaml").T_2_1 is None
    for name in ("cam1", "cam2"):
        binary, text = load_events(out / f"{name}.h5"), load_events(out / f"{name}.txt")
        np.testing.assert_array_equal(binary.events, text.events)
        assert (binary.width, binary.height) == (text.width, text.height) == (346, 260)
    frames = load_frames(out / "cam2.h5")
    assert frames is not None
    assert frames[0][0] == 50_000 + 2_500  # middle of the first exposure, on camera 2's clock


@pytest.mark.render
def test_the_same_arguments_give_the_same_bytes(tmp_path: Path) -> None:
    arguments = [*FAST, "--seed", 2**32 - 1, "--noise", "davis346"]
    left = made_by(tmp_path / "b", ended_process())  # by a run that was killed
    left.mkdir()
    for name in ("a", "b"):
        assert run(tmp_path / name, *arguments).exit_code == 0
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}
    assert hashes(tmp_path / "a") == hashes(tmp_path / "b")


@pytest.mark.render
def test_a_bird_close_to_the_cameras(tmp_path: Path) -> None:
    near = ["--drone", "bird", "--distance", 1.5, "--spread", 0.15]
    result = run(tmp_path / "near", *FAST, *near)
    assert result.exit_code == 0, result.output
    truth = json.loads((tmp_path / "near" / "truth.json").read_text())
    assert np.abs(truth["drone_position_W_m"]).max() < 0.2 * 3.6
    counts = [len(load_events(tmp_path / "near" / f"cam{i}.h5").events) for i in (1, 2)]
    assert min(counts) > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--angle", 180], "--angle: expected 1 to 179 degrees, got 180"),
        (["--noise", "loud"], "expected one of ideal, davis346, got 'loud'"),
        (["--duration", 0], "--duration: expected 1 to 3600 seconds, got 0"),
        (["--duration", "nan"], "--duration: expected 1 to 3600 seconds, got nan"),
        (["--resolution", 346, 0], "--resolution: expected 16 to 8192 pixels, got 0"),
        (["--drone-size", 0], "--drone-size: expected 0.01 to 100 metres, got 0"),
        (["--exposure", 5], "--exposure: expected 1e-05 to 1 seconds, got 5"),
        (["--t-d", "inf"], "--t-d: expected -86400 to 86400 seconds, got inf"),
        (["--skew-ppm", 1e6], "--skew-ppm: expected -100000 to 100000 ppm, got 1000000"),
        (["--clock-jump", 30, 0.02], "expected a time within the flight, 0 to 20 s, got 30"),
        (["--clock-jump", 10, -0.02], "expected a size above 0 s, got -0.02"),
        (["--drone", "missing.stl"], "missing.stl does not exist"),
        (["--drone", "hawk"], "expected a mesh file, or one of quadrotor, two-tone, bird, plane"),
        (["--drone", "bird", "--rotor-hz", 9], "rotors spin on the built-in quadrotors only"),
        (["--spread", 0], "--spread: expected 0.01 to 100, got 0"),
        (["--distance", 1.5], "reaches into the camera"),
        (["--trajectory", "missing.csv"], "cannot read the trajectory missing.csv"),
        (["--background", "missing.png"], "missing.png"),
        (["--seed", -1], "--seed: expected 0 to 4294967295, got -1"),
        (["--seed", 2**32], "--seed: expected 0 to 4294967295, got 4294967296"),
        (["--threshold-on", 0], "--threshold-on: expected 0.01 to 5, got 0"),
        (["--threshold-off", -0.2], "--threshold-off: expected 0.01 to 5, got -0.2"),
        (["--gl", "vulkan"], "expected auto, osmesa or egl"),
        (["--lattice", 0, 0], "supersampling lattice"),
    ],
)
def test_bad_input_is_one_error_and_leaves_nothing(
    tmp_path: Path, arguments: list[object], message: str
) -> None:
    result = run(tmp_path / "out", *arguments)
    assert isinstance(result.exception, (SimError, SsacError))
    assert message in str(result.exception)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_empty_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    result = run(tmp_path)
    assert isinstance(result.exception, SimError)
    assert "is not empty" in str(result.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_the_command_line_turns_errors_into_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        "sys.argv", ["ssac", "simulate", str(tmp_path / "out"), "--distance", "1.5"]
    )
    with pytest.raises(SystemExit) as exit_info:
        main()
    assert exit_info.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert "reaches into the camera" in captured.err
    assert captured.err.count("\n") == 1
