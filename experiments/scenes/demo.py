"""`ssac demo`: simulate one flight, estimate offset and pose, and draw a figure and a report."""

import json
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.lab.provenance import plain
from experiments.lab.score import Truth, scored
from experiments.scenes.options import MAX_SEED
from experiments.scenes.simulate import drawable, record_with_progress, summary
from sim.recording import SimConfig
from ssac.cli.options import number
from ssac.cli.progress import compilation_told
from ssac.estimate import Estimate
from ssac.pipeline.api import sync

DEMO = drawable(SimConfig(angle_deg=90.0, t_d_s=0.05))  # 20 s, as in the paper
METHODS = ("ssac", "tangency")
FILES = {"cam1.h5", "cam2.h5", "rig.yaml", "rig_extrinsics.yaml", "truth.json", "truth.tum"}


def demo_command(
    out_dir: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Folder for the results.")
    ] = Path("out/demo"),
    seed: Annotated[int, number("Seed of the simulated flight.", 0, MAX_SEED)] = 0,
) -> None:
    """Simulate 20 s at 90 deg with an offset of 50 ms, recover it; a figure and a report."""
    from ssac.pipeline.plots import save_figures

    folder = out_dir / "recording"
    if is_of_a_demo(folder, seed):
        shutil.rmtree(folder, ignore_errors=True)
    recorded = record_with_progress(DEMO, seed, folder)
    typer.echo(summary(recorded, folder))
    with compilation_told():
        results = [
            sync(folder / "cam1.h5", folder / "cam2.h5", folder / "rig.yaml", method)
            for method in METHODS
        ]
    flown = recorded.flight.truth
    truth = Truth(flown.t_d_s, flown.R, flown.t)
    for result in results:
        typer.echo("\n" + comparison(result.estimate, truth))
    last = results[-1]
    written = [
        *save_figures(out_dir / "demo.png", last.answer, only="epipolar"),
        last.report(out_dir / "report.html", "ssac demo"),
    ]
    typer.echo("\nwritten to " + ", ".join(map(str, written)))


def is_of_a_demo(folder: Path, seed: int) -> bool:
    """Whether a folder holds the recording of an earlier demo, and nothing of the user's."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        made_with = truth["provenance"] | {"versions": None}
        is_same = made_with == {"config": plain(DEMO), "seed": seed, "versions": None}
        return is_same and FILES.issuperset(path.name for path in folder.iterdir())
    return False


def comparison(estimate: Estimate, truth: Truth) -> str:
    """Format an estimate beside the ground truth, with its errors."""
    if estimate.status != "ok" or estimate.R is None or estimate.t is None:
        return f"{estimate.method}: {estimate.status}: {estimate.reason}"
    errors = scored(estimate, truth)
    rows = [
        ("", "estimate", "truth", "error"),
        ("t_d", f"{1e3 * estimate.t_d_s:.3f} ms", f"{1e3 * truth.t_d_s:.3f} ms",
         f"{errors['t_d_error_ms']:.3f} ms"),
        ("R", *(f"{_vector(Rotation.from_matrix(R).as_rotvec(degrees=True))} deg"
                for R in (estimate.R, truth.R)), f"{errors['r_error_deg']:.3f} deg"),
        ("t", _vector(estimate.t), _vector(truth.t), f"{errors['t_error_deg']:.3f} deg"),
    ]  # fmt: skip
    lines = [f"{name:4}{a:>30}{b:>30}{c:>12}" for name, a, b, c in rows]
    head = f"{estimate.method}: {estimate.n_samples} samples, d_avg {estimate.d_avg_px:.3f} px"
    return "\n".join([head, *lines])


def _vector(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.3f}" for value in values)
