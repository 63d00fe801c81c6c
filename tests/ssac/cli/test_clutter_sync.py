"""`ssac sync` on recordings with lamps and noise in them, and on those with nothing else."""

import re

from ssac import sync
from ssac.cli.exits import NO_ESTIMATE
from ssac.files.event_files import load_events
from ssac.files.hdf5 import save_events_h5
from tests.recorded import DURATION_S
from tests.ssac.cluttered import lamp, merged, noise
from tests.ssac.command import run_sync
from tests.ssac.synthetic import HEIGHT, WIDTH

DURATION_US = round(1e6 * DURATION_S)
SIZE_PX = 12
PLACES = ((150, 100), (190, 140))  # where the object passes


def save_pair(folder, streams):
    paths = [folder / f"{name}.h5" for name in ("one", "other")]
    for path, events in zip(paths, streams, strict=True):
        save_events_h5(path, events, WIDTH, HEIGHT)
    return paths


def test_a_lamp_in_view_of_each_camera_changes_little(recorded, tmp_path):
    rig = recorded / "rig.yaml"
    clean = sync(*recorded.pair, rig, "joint").estimate
    streams = [
        merged(load_events(path).events, lamp(x, y, SIZE_PX, DURATION_US))
        for path, (x, y) in zip(recorded.pair, PLACES, strict=True)
    ]
    result = sync(*save_pair(tmp_path, streams), rig, "joint")
    assert result.estimate.status == "ok"
    # The object's events in the mask's 144 px of 90,000 are gone; 0.3 ms is the mark.
    assert abs(result.estimate.t_d_s - clean.t_d_s) < 3e-4
    assert [camera.clutter.masked_pixels for camera in result.answer.cleans] == [144, 144]
    assert "camera 1: 144 px that fire by themselves masked" in result.summary()


def test_lamps_without_an_object_are_refused_before_any_search(recorded, tmp_path):
    lamps = [lamp(x, y, SIZE_PX, DURATION_US) for x, y in PLACES]
    code, out, err = run_sync(*save_pair(tmp_path, lamps), "--rig", recorded / "rig.yaml")
    assert code == NO_ESTIMATE, err
    assert re.search(
        r"too_few_samples: camera 1: denoising left 0 of (\d+) events, of which \1 were of l", out
    )
    assert "or try --no-denoise" in out


def test_noise_without_an_object_is_refused_before_any_search(recorded, tmp_path):
    streams = [noise(WIDTH, HEIGHT, 5.0, 1_500_000, seed) for seed in (0, 1)]
    code, out, err = run_sync(*save_pair(tmp_path, streams), "--rig", recorded / "rig.yaml")
    assert code == NO_ESTIMATE, err
    assert re.search(r"camera 1: (no window of 40 ms holds 20|denoising left 0)", out)
    assert "search" not in err
