"""`ssac simulate` with what spoils recordings: the same flight, and more."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from experiments.cli import app
from sim.errors import SimError
from ssac.errors import SsacError
from ssac.files.event_files import load_events, load_frames
from ssac.files.rigs import load_rig

FAST = ["--duration", "2", "--max-step", "2", "--lattice", "2", "0", "--t-d", "0.05",
        "--skew-ppm", "1000"]  # fmt: skip


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["simulate", *map(str, arguments)])


def events_of(folder: Path, camera: int) -> np.ndarray:
    events = load_events(folder / f"cam{camera}.h5").events
    return np.sort(events, order=("t", "y", "x", "p"))


@pytest.mark.render
def test_clutter_is_added_to_the_same_flight_on_the_cameras_clock(tmp_path: Path) -> None:
    assert run(tmp_path / "plain", *FAST).exit_code == 0
    lamp = run(tmp_path / "lamp", *FAST, "--lamp", 6)
    assert lamp.exit_code == 0, lamp.output
    for camera, latest_s in ((1, 2.0), (2, 2.051)):
        plain, spoilt = (events_of(tmp_path / name, camera) for name in ("plain", "lamp"))
        frames = [load_frames(tmp_path / name / f"cam{camera}.h5") for name in ("plain", "lamp")]
        assert np.array_equal(frames[0][1], frames[1][1])
        common, n_each = np.unique(np.concatenate([plain, spoilt]), return_counts=True)
        more = common[n_each % 2 == 1]  # those of the flight are in both
        assert len(more) == pytest.approx(36 * 400 * 2.0, rel=2e-3)  # a few on the same instant
        assert np.ptp(more["x"]) == 5
        # Camera 2's clock is 50 ms late, and runs 1 ms a second fast about the middle.
        assert more["t"][-1] == pytest.approx(1e6 * latest_s, abs=2500)  # of a last step's time
    truth = json.loads((tmp_path / "lamp" / "truth.json").read_text())
    assert truth["provenance"]["disturbances"]["lamp_px"] == 6
    assert (
        "disturbances"
        not in json.loads((tmp_path / "plain" / "truth.json").read_text())["provenance"]
    )
    rigs = [(tmp_path / name / "rig.yaml").read_text() for name in ("plain", "lamp")]
    assert rigs[0] == rigs[1]


@pytest.mark.render
def test_a_second_flight_is_seen_by_both_and_the_rig_is_wrong_as_stated(tmp_path: Path) -> None:
    options = ["--second-object", 1, "--intrinsics-error", 1, 3]
    for name in ("a", "b"):
        assert run(tmp_path / name, *FAST, "--frame-rate", 0, *options).exit_code == 0
    for path in sorted((tmp_path / "a").iterdir()):
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
    truth = json.loads((tmp_path / "a" / "truth.json").read_text())
    assert [path.name for path in sorted((tmp_path / "a").iterdir())] == [
        "cam1.h5", "cam2.h5", "rig.yaml", "rig_extrinsics.yaml", "truth.json",
    ]  # fmt: skip
    rig, known = (load_rig(tmp_path / "a" / name) for name in ("rig.yaml", "rig_extrinsics.yaml"))
    np.testing.assert_allclose(known.T_2_1[:3, :3], truth["R"], atol=1e-15)
    for name, camera in (("cam1", rig.cam1), ("cam2", rig.cam2)):
        assert camera.intrinsics_std_px == pytest.approx((2.0, 2.0, 3.0, 3.0))
        off = camera.K - np.array(truth["provenance"]["true_K"][name])
        assert np.all(off[[0, 1, 0, 1], [0, 1, 2, 2]] != 0.0)
    for camera in (1, 2):
        seen = truth["cameras"][f"cam{camera}"]["n_events"]
        assert seen == len(events_of(tmp_path / "a", camera))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--lamp", 101], "--lamp: expected 0 to 100 pixels, got 101"),
        (["--noise-hz", -1], "--noise-hz: expected 0 to 100 hertz, got -1"),
        (["--second-object", 2], "--second-object: expected 0 to 1, got 2"),
        (["--second-object", 1, "--trajectory", "flight.csv"], "leave out one of them"),
        (["--intrinsics-error", 11, 0], "intrinsics_error needs 0 to 10 %"),
        (["--lamp", 20, "--resolution", 16, 16, "--focal", 10, "--duration", 1,
          "--frame-rate", 0], "a lamp of 20 x 20 px does not fit into a view of 16 x 16 px"),
    ],
)  # fmt: skip
def test_bad_input_is_one_error_and_leaves_nothing(
    tmp_path: Path, arguments: list[object], message: str
) -> None:
    result = run(tmp_path / "out", *arguments)
    assert isinstance(result.exception, (SimError, SsacError))
    assert message in str(result.exception)
    assert list(tmp_path.iterdir()) == []
