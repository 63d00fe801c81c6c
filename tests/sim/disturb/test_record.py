"""A spoilt recording on disk is whole or not there, as any other."""

from pathlib import Path

import pytest
import yaml

import sim.disturb
from sim.disturb import DisturbConfig, record_disturbed
from sim.errors import SimError
from sim.recording import SimConfig
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.lattice import Lattice
from sim.scene.trajectory import SplineConfig
from sim.sensor.frames import FrameConfig

QUICK = SimConfig(
    spline=SplineConfig(1.0),
    sampling=SamplingConfig(max_step_px=2.0),
    render=RenderConfig(lattice=Lattice(2, 0), check=False),
    frames=FrameConfig(rate_hz=0.0),
)
WRONG_RIG = DisturbConfig(intrinsics_error=(1.0, 3.0))


def test_a_recording_never_stands_there_with_the_true_rig_in_place_of_the_wrong_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It did, until the rig files were written over, or for good if that failed."""
    record_disturbed(QUICK, WRONG_RIG, 0, tmp_path / "whole", {})
    for name in ("rig.yaml", "rig_extrinsics.yaml"):
        chain = yaml.safe_load((tmp_path / "whole" / name).read_text())
        assert chain["cam0"]["intrinsics"] != [200.0, 200.0, 173.0, 130.0]
        assert chain["cam0"]["intrinsics_std"] == [2.0, 2.0, 3.0, 3.0]

    def fail(*_: object) -> None:
        raise SimError("no")

    monkeypatch.setattr(sim.disturb, "wrong_intrinsics", fail)
    with pytest.raises(SimError, match="no"):
        record_disturbed(QUICK, WRONG_RIG, 0, tmp_path / "out", {})
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]
