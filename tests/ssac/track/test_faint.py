"""`ssac track --faint`: a track through noise, and one line where no object is seen."""

import numpy as np
import yaml

from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import load_track
from tests.ssac.command import run
from tests.ssac.track.test_follow import GAP_S, HEIGHT, WIDTH, noise, path_px, recorded

RIG = {
    "cam0": {
        "camera_model": "pinhole",
        "intrinsics": [200.0, 200.0, 60.0, 45.0],
        "distortion_model": "none",
        "distortion_coeffs": [],
        "resolution": [WIDTH, HEIGHT],
    }
}
POINTS = ("--half-window", "0.05", "--n-min", "8")


def track(folder, events, *options):
    save_events_h5(folder / "cam.h5", events, WIDTH, HEIGHT)
    (folder / "rig.yaml").write_text(yaml.safe_dump(RIG))
    out = folder / "cam.csv"
    code, _, err = run(
        "track", folder / "cam.h5", "--rig", folder / "rig.yaml", "--out", out, *options
    )
    return code, err, out


def test_a_faint_object_has_a_track_where_it_is_weak(tmp_path):
    events, _, _ = recorded(120.0)
    code, err, out = track(tmp_path, events, "--faint", *POINTS)
    assert code == 0, err
    found = load_track(out)
    weak = (found.times_s > GAP_S[0]) & (found.times_s < GAP_S[1])
    assert np.count_nonzero(weak) > 0.9 * 100 * (GAP_S[1] - GAP_S[0])  # a point each 10 ms
    errors_px = np.linalg.norm(found.points_px - path_px(found.times_s), axis=1)
    # 12 events of an image of 2 px leave 0.6 px, of each coordinate; five deviations.
    assert np.max(errors_px[weak]) < 3.0


def test_noise_alone_is_refused(tmp_path):
    code, err, out = track(tmp_path, noise(np.random.default_rng(3)), "--faint", *POINTS)
    assert code == 2
    assert err.count("\n") == 1
    assert "no object is seen" in err
    assert not out.exists()


def test_it_cannot_be_told_from_noise_that_is_kept(tmp_path):
    events, _, _ = recorded(120.0)
    code, err, _ = track(tmp_path, events, "--faint", "--no-denoise")
    assert code == 2
    assert "leave one out" in err
