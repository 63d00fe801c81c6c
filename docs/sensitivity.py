"""Recordings with exact intrinsics in; what wrong ones do to `tangency`, as a table, out.

    python docs/sensitivity.py FOLDER...      # of `ssac simulate`, without lens distortion

Each row is one error of the intrinsics; the numbers are the median and the largest change of the
estimate, over the recordings, from the one with exact intrinsics.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from ssac.camera import Camera, Rig, with_deviations  # noqa: E402
from ssac.estimate import Estimate  # noqa: E402
from ssac.methods.algorithms import algorithm_2, with_pose  # noqa: E402
from ssac.methods.joint import joint_from  # noqa: E402
from ssac.methods.tangency import tangency_from  # noqa: E402
from ssac.search.two_views import TwoViews, two_views  # noqa: E402
from ssac.tool.load import load_pair  # noqa: E402
from ssac.tool.registry import METHODS  # noqa: E402

NONE = (0.0, 0.0, 0.0, 0.0)
LONG = (0.01, 0.01, 0.0, 0.0)  # shares of fu and fv, px of pu and pv
ERRORS = {
    "focal lengths of both cameras 1 % long": (LONG, LONG),
    "focal lengths of one camera 1 % long": (LONG, NONE),
    "fu of one camera 1 % long": ((0.01, 0.0, 0.0, 0.0), NONE),
    "fv of one camera 1 % long": ((0.0, 0.01, 0.0, 0.0), NONE),
    "centres of both 1 px right": ((0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 1.0, 0.0)),
    "centres of both 1 px down": ((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)),
    "centre of one 1 px right": ((0.0, 0.0, 1.0, 0.0), NONE),
    "centre of one 1 px down": ((0.0, 0.0, 0.0, 1.0), NONE),
}


def main(folders: list[str]) -> None:
    """Print the table."""
    changes = np.array([changes_in(Path(folder)) for folder in folders])
    print("| error of the intrinsics | t_d ms | R deg | t deg |\n|---|---|---|---|")
    for name, some in zip(ERRORS, np.moveaxis(changes, 1, 0), strict=True):
        pairs = zip(np.nanmedian(some, axis=0), np.nanmax(some, axis=0), strict=True)
        print(f"| {name} | {' | '.join(f'{mid:.2f}, {top:.2f}' for mid, top in pairs)} |")


def changes_in(folder: Path) -> list[tuple[float, float, float]]:
    """Give the changes of t_d [ms], R and t [deg] by each of ERRORS in one recording."""
    paths = folder / "cam1.h5", folder / "cam2.h5", folder / "rig.yaml"
    cam1, cam2, rig = load_pair(paths, METHODS["tangency"])
    exact_ones = [with_deviations(camera, 0.0, 0.0) for camera in (rig.cam1, rig.cam2)]
    views = two_views(cam1, cam2, Rig(*exact_ones))
    start = algorithm_2(views)
    exact = fit(views, start, (NONE, NONE))
    return [change(fit(views, start, errors), exact) for errors in ERRORS.values()]


def fit(views: TwoViews, start: Estimate, errors: tuple[tuple[float, ...], ...]) -> Estimate:
    """Estimate with intrinsics that are off, and are taken to be exact."""
    cameras = (views.rig.cam1, views.rig.cam2)
    off = [wrong(camera, error) for camera, error in zip(cameras, errors, strict=True)]
    there = replace(views, rig=Rig(*off))  # without a lens, the tracks are the same
    if start.F is not None:
        start = with_pose(start, start.F, there.rig, *there.pairs_at(start.t_d_s).points_px)
    return tangency_from(joint_from(start, there), there)


def wrong(camera: Camera, error: tuple[float, ...]) -> Camera:
    """Give the camera with fu and fv longer by shares, pu and pv by pixels."""
    fu, fv, pu, pv = error
    K: NDArray[np.float64] = camera.K.copy()
    K[0] = (K[0, 0] * (1.0 + fu), 0.0, K[0, 2] + pu)
    K[1] = (0.0, K[1, 1] * (1.0 + fv), K[1, 2] + pv)
    return replace(camera, K=K)


def change(one: Estimate, other: Estimate) -> tuple[float, float, float]:
    """Differences of t_d [ms], R and t [deg]; NaN where either was refused."""
    if one.R is None or other.R is None or one.t is None or other.t is None:
        return np.nan, np.nan, np.nan
    cosines = [(np.trace(one.R.T @ other.R) - 1.0) / 2.0, one.t @ other.t]
    R_deg, t_deg = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    return 1e3 * abs(one.t_d_s - other.t_d_s), float(R_deg), float(t_deg)


if __name__ == "__main__":
    main(sys.argv[1:])
