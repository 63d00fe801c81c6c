"""`ssac sync --estimate-readout`: what it says, and what it leaves alone."""

import numpy as np
import pytest
import yaml

from ssac import sync
from tests.ssac.command import run
from tests.ssac.tracks import rig_document, save_pair

READOUT_S = 0.02


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Camera 1's readout is stated, camera 2's is not: none, in truth."""
    return save_pair(tmp_path_factory.mktemp("tracks"), t_d_s=0.2, readout_s=READOUT_S)


def synced(folder, rig="rig.yaml", **more):
    return sync(folder / "cam1.csv", folder / "cam2.csv", folder / rig, search="interval", **more)


def test_the_readout_that_is_not_stated_is_told(pair):
    result = synced(pair.folder, estimate_readout=True)
    report = result.to_dict()
    assert report["readout_s"][0] == READOUT_S  # exact, as the rig says
    assert report["readout_std_s"][0] == 0.0
    assert 0.0 <= report["readout_s"][1] < 4.0 * report["readout_std_s"][1]
    assert "readout        camera 2 " in result.summary()
    assert report["note"] == ""


def test_without_the_option_a_shutter_is_taken_for_global_and_that_is_said(pair):
    result = synced(pair.folder)
    report = result.to_dict()
    assert report["readout_s"] == [READOUT_S, None]
    assert "--estimate-readout" in report["note"]


def test_nothing_moves_where_all_is_stated(pair):
    document = rig_document(readout_s=0.0)
    document["cam0"]["readout_s"] = READOUT_S
    (pair.folder / "stated.yaml").write_text(yaml.safe_dump(document))
    one, other, unstated = (
        synced(pair.folder, rig, estimate_readout=asked).estimate
        for rig, asked in (("stated.yaml", True), ("stated.yaml", False), ("rig.yaml", False))
    )
    for same in (other, unstated):
        assert (one.t_d_s, one.t_d_std_s) == (same.t_d_s, same.t_d_std_s)
        np.testing.assert_array_equal(one.R, same.R)


def test_a_method_that_cannot_says_so(pair):
    code, _, err = run("sync", *pair.args, "--estimate-readout", "--method", "ssac")
    assert (code, err.count("\n")) == (2, 1), err
    assert "takes shutters as the rig says: use joint" in err


def test_events_have_no_readout(recorded):
    args = (*recorded.pair, "--rig", recorded / "rig.yaml", "--estimate-readout")
    code, _, err = run("sync", *args)
    assert (code, err.count("\n")) == (2, 1), err
    assert "expected a track of a frame camera, got events only" in err
