"""How far an answer depends on the window: one's own recordings, without truth.

Each method runs with half-windows and least numbers of events around the defaults. Where the answer
moves by more than its stated deviation, it depends on the choice of the window.

    ssac study spread cam1.h5 cam2.h5 rig.yaml --out out
    ssac study spread bag/cam1/events bag/cam2/events rig.yaml --out out
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from scipy.spatial.transform import Rotation

from experiments.drawing.style import Figure, legend_outside, panels
from experiments.lab.cell import Measure, PlainCell, RunRow
from experiments.lab.score import angle_between_deg
from experiments.lab.study import How, Runs, Study
from experiments.lab.summary import answered, made_of
from ssac.config import N_MIN, Config
from ssac.files.ros_bags import bag_of
from ssac.pipeline.chain import Chain
from ssac.pipeline.registry import METHODS

SHOWN = ("ssac", "joint", "tangency")
HALF_WINDOWS_S = tuple(factor * Config().half_window_s for factor in (0.5, 0.75, 1.0, 1.5, 2.0))
N_MINS = tuple(round(factor * N_MIN) for factor in (0.5, 1.0, 2.0))

File = Annotated[Path, typer.Argument(show_default=False)]


@dataclass(frozen=True)
class SpreadCell(PlainCell):
    """A method with one window on the pair of recordings."""

    files: tuple[Path, ...]  # cameras 1 and 2, rig
    digests: tuple[str, ...]  # of these files
    half_window_s: float
    n_min: int
    method: str

    @property
    def inputs(self) -> tuple[Any, ...]:
        """What the row depends on beside the code."""
        kinds = [path.suffix for path in self.files]  # which choose the reader
        return *self.digests, *kinds, *self.columns.values(), METHODS[self.method].version


@dataclass(frozen=True)
class SpreadRow(RunRow):
    """An answer; NaN for what the method does not give."""

    t_d_ms: float = np.nan
    t_d_std_ms: float = np.nan
    r_x_deg: float = np.nan  # the rotation vector of R
    r_y_deg: float = np.nan
    r_z_deg: float = np.nan
    r_std_deg: float = np.nan
    t_x: float = np.nan  # the direction of t
    t_y: float = np.nan
    t_z: float = np.nan
    t_std_deg: float = np.nan


def cells(cam1: File, cam2: File, rig: File) -> list[SpreadCell]:
    """List every method with every window."""
    files = Path(cam1), Path(cam2), Path(rig)  # texts, as shards keep them
    digests = tuple(map(_digest, files))
    return [
        SpreadCell(files, digests, *window, method)
        for window in product(HALF_WINDOWS_S, N_MINS)
        for method in SHOWN
    ]


def _digest(path: Path) -> str:
    """Return a digest of a file, or of all files of a bag and the topic in it."""
    bag, topic = bag_of(path) or (path, "")
    found = hashlib.sha256(topic.encode())
    for part in sorted(filter(Path.is_file, bag.iterdir())) if bag.is_dir() else [bag]:
        found.update(part.read_bytes())
    return found.hexdigest()


def load(cells: Sequence[SpreadCell], _: object) -> Chain:
    """Read the recordings."""
    cam1, cam2, rig = cells[0].files
    return Chain((cam1, cam2), rig)


def row(cell: SpreadCell, chain: Chain) -> SpreadRow:
    """Run a method with a window."""
    config = replace(Config(), half_window_s=cell.half_window_s, n_min=cell.n_min)
    found = chain.under(config).estimate(cell.method)
    pose: tuple[float, ...] = ()
    if found.R is not None and found.t is not None:
        turn_deg = Rotation.from_matrix(found.R).as_rotvec(degrees=True)
        pose = (*turn_deg.tolist(), found.r_std_deg, *found.t.tolist(), found.t_std_deg)
    t_d_ms, std_ms = 1e3 * found.t_d_s, 1e3 * found.t_d_std_s
    return SpreadRow(str(found.status), found.reason, t_d_ms, std_ms, *pose)


def spread_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Sum up the windows of each method, for each quantity that it gives.

    `spread` is the root mean square distance from the mean over the windows, `most` the largest.
    """
    rows = []
    for method, group in runs.groupby("method", sort=False):
        ok = answered(group)
        counts = {"method": method, "windows": len(group), "answered": len(ok)}
        for quantity, (off, stated) in _deviations(ok).items():
            spread = float(np.sqrt(off.pow(2).mean()))
            median = ok["t_d_ms"].dropna().median() if quantity == "t_d_ms" else np.nan
            row = {**counts, "quantity": quantity, "median": median}
            row |= {"spread": spread, "most": off.abs().max(), "stated": stated}
            rows.append({**row, "spread_over_stated": spread / stated if stated > 0.0 else np.nan})
    return pd.DataFrame(rows)


def _deviations(ok: pd.DataFrame) -> "dict[str, tuple[pd.Series[float], float]]":
    """Return distances from the mean and the median stated deviation, of each given quantity."""
    off = {"t_d_ms": ok["t_d_ms"] - ok["t_d_ms"].mean()}
    posed = ok[ok["t_x"].notna()]
    if len(posed):
        turns = Rotation.from_rotvec(posed[["r_x_deg", "r_y_deg", "r_z_deg"]], degrees=True)
        off["R_deg"] = pd.Series(np.rad2deg((turns.mean().inv() * turns).magnitude()))
        t = posed[["t_x", "t_y", "t_z"]].to_numpy(np.float64)
        off["t_deg"] = pd.Series([angle_between_deg(one, t.mean(axis=0)) for one in t])
    stated = {"t_d_ms": "t_d_std_ms", "R_deg": "r_std_deg", "t_deg": "t_std_deg"}
    return {name: (far, ok[stated[name]].dropna().median()) for name, far in off.items()}


def spread_figure(runs: pd.DataFrame) -> Figure:
    """Draw t_d with its stated deviation against the half-window, a panel for each method."""
    by_method = runs.groupby("method", sort=False)
    figure, (panel_of,) = panels(
        "t_d and its stated deviation (bar)", 3.4, columns=by_method.ngroups, sharey=True
    )
    for axes, (method, group) in zip(panel_of, by_method, strict=True):
        for n_min, line in answered(group).groupby("n_min"):
            axes.errorbar(
                1e3 * line["half_window_s"], line["t_d_ms"], line["t_d_std_ms"].fillna(0.0),
                marker="o", ms=4, lw=1.2, elinewidth=0.9, label=f"at least {n_min:g} events",
            )  # fmt: skip
        axes.set_title(method, fontsize=10)
        axes.set_xlabel("half-window [ms]")
    panel_of[0].set_ylabel("$t_d$ [ms]")
    legend_outside(figure, 3)
    return figure


STUDIES = (
    Study(
        "spread",
        "The answer on one's own recordings, over windows (give CAM1 CAM2 RIG)",
        cells,
        Measure(load, row, SpreadRow),
        Runs("spread_runs.csv", ("half_window_s", "n_min", "method")),
        (
            made_of("spread.csv", spread_table, "spread_runs"),
            made_of("spread.png", spread_figure, "spread_runs"),
        ),
        how=How.GIVEN,
        shows="spread",
        is_committed=False,
    ),
)
