"""The command `ssac compare`: how far an estimated path is from a reference."""

import json
from pathlib import Path
from typing import Annotated

import typer

from ssac.cli.options import JSON_FILE, LEVER_ARM, argument, named, number
from ssac.errors import SsacError

SCALES = ("unknown", "known")


def compare_command(
    estimate: Annotated[Path, argument("ESTIMATE", "Estimated path.")],
    truth: Annotated[Path, argument("TRUTH", "Reference path, such as RTK.")],
    scale: Annotated[str, named("|".join(SCALES), "known: the estimate is in metres.")] = SCALES[0],
    max_shift: Annotated[
        float | None,
        number(
            "Largest shift of the truth's clock to try, either way.",
            0,
            1e10,
            "seconds",
            default_words="all that leave enough common time",
        ),
    ] = None,
    rate_std: Annotated[
        float,
        number(
            "Prior standard deviation of the clocks' relative rate; 0: same rate.", 0, 10_000, "ppm"
        ),
    ] = 50.0,
    lever_arm: Annotated[tuple[float, float, float] | None, LEVER_ARM.info] = None,
    plot: Annotated[Path | None, named("FILE", "Figure to write (.png, .pdf, .svg).")] = None,
    json_file: Annotated[Path | None, JSON_FILE.info] = None,
) -> None:
    """Say how far a path is from the truth, at equal times and as a shape.

    Paths are TUM (t x y z qx qy qz qw), csv (t_s,x_m,y_m,z_m) or rows of x y z. Frame, scale, time
    shift and clock rate are found.
    """
    from ssac.files.whole_file import FIGURE_SUFFIXES, check_targets, write_whole
    from ssac.network.comparison import compare
    from ssac.network.tum import read_path
    from ssac.pipeline.report import text_of

    if scale not in SCALES:
        raise SsacError(f"--scale: expected {' or '.join(SCALES)}, got {scale!r}")
    check_targets((plot, json_file), (estimate, truth))
    if plot is not None and plot.suffix.lower() not in FIGURE_SUFFIXES:
        raise SsacError(f"{plot}: a figure is a file ending in {', '.join(FIGURE_SUFFIXES)}")
    paths = read_path(estimate, needs_times=False), read_path(truth, needs_times=False)
    found = compare(*paths, scale == "unknown", max_shift, rate_std, lever_arm)
    if json_file is not None:
        text = json.dumps(found.figures(), indent=1, allow_nan=False)
        write_whole(json_file, f"{text}\n")
    if plot is not None:
        from ssac.pipeline.plots import draw_comparison, save

        save(draw_comparison(found), plot, 130)
    rows = [("at equal times", "no: there are no times in both")]
    if found.in_time is not None:
        clock, off = found.in_time.clock, _in_words(found.in_time.figures())
        shift = f"truth = estimate {clock.t_d_s:+.4f} s, {clock.skew_ppm:+.1f} ppm"
        covered = f"{100.0 * found.in_time.coverage:.1f} % of the truth's covered"
        explained = f"{100.0 * found.in_time.explained:.2f} % of its motion explained"
        rows = [
            ("clock", f"{shift}; holds at {clock.t_ref_s:.3f} s of the estimate's"),
            ("at equal times", f"{off}, {covered}, {explained}"),
        ]
    typer.echo(text_of([*rows, ("as shapes, ICP", _in_words(found.as_shape.figures()))]))


def _in_words(figures: dict[str, float | int]) -> str:
    return (
        "RMSE {rmse_m:.4f} m, median {median_m:.4f} m, max {max_m:.4f} m, scale {scale:.6g}, "
        "{n_samples} samples"
    ).format(**figures)
