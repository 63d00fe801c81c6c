"""A comparison in; the paper's Fig. 7, the path beside the truth, out."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from ssac.compare.comparison import Comparison, InTime
from ssac.files.whole_file import whole_file
from ssac.plot.style import BLUE, RED, YELLOW

Array = NDArray[np.float64]

_GAP_STEPS, _USUAL_PERCENT = 4.0, 95.0  # a step that is so many times the usual one is a gap

_ZOOM = 0.88
_HEIGHT_IN, _WIDTH_IN, _WIDTH_OF_SHAPE_IN, _DPI = 6.5, 12.0, 6.0, 130


def save_figure(file: Path, comparison: Comparison) -> None:
    """Draw both paths in space and, where there are times, x, y and z with their differences."""
    in_time = comparison.in_time
    width_in = _WIDTH_OF_SHAPE_IN if in_time is None else _WIDTH_IN
    page = Figure(figsize=(width_in, _HEIGHT_IN), layout="constrained")
    if in_time is None:
        _draw_shape(page, comparison)
    else:
        left, right = page.subfigures(1, 2)
        _draw_shape(left, comparison)
        _draw_over_time(right, in_time)
    with whole_file(file) as temporary:
        page.savefig(temporary, format=file.suffix[1:].lower(), dpi=_DPI)


def _draw_shape(canvas: Figure | SubFigure, comparison: Comparison) -> None:
    axes = canvas.add_subplot(projection="3d")
    axes.plot(*_broken(comparison.truth_m).T, color=BLUE, lw=1.2, label="truth")
    axes.plot(*_broken(comparison.estimate_m).T, color=YELLOW, lw=1.2, label="estimate")
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    # Smaller than the canvas, which does not count the labels of axes in space as its own.
    axes.set_box_aspect(np.maximum(np.ptp(comparison.truth_m, axis=0), 1e-9), zoom=_ZOOM)
    axes.legend(loc="upper right", fontsize="small")
    if comparison.in_time is None:
        axes.set_title(f"RMSE {comparison.as_shape.rmse_m:.3f} m (ICP)", fontsize="medium")
    else:
        axes.set_title(
            f"RMSE {comparison.in_time.rmse_m:.3f} m at equal times, "
            f"{comparison.as_shape.rmse_m:.3f} m by ICP",
            fontsize="medium",
        )


def _broken(points: Array) -> Array:
    """Points (n, 3) with NaN where one is so far from the last that there is a gap between."""
    steps_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
    usual_m = float(np.percentile(steps_m, _USUAL_PERCENT)) if len(steps_m) else 0.0
    return np.insert(points, np.flatnonzero(steps_m > _GAP_STEPS * usual_m) + 1, np.nan, axis=0)


def _draw_over_time(canvas: Figure | SubFigure, found: InTime) -> None:
    rows = canvas.subplots(6, 1, sharex=True, gridspec_kw={"height_ratios": [2, 1] * 3})
    times_s = found.times_s - found.times_s[0]
    gaps = np.flatnonzero(np.diff(times_s) > 1.5 * np.median(np.diff(times_s))) + 1

    def broken(values: Array) -> Array:  # a line does not cross a gap
        return np.asarray(np.insert(values, gaps, np.nan))

    for k, name in enumerate("xyz"):
        path, difference = rows[2 * k], rows[2 * k + 1]
        path.plot(broken(times_s), broken(found.truth_m[:, k]), color=BLUE, lw=1.2)
        path.plot(broken(times_s), broken(found.estimate_m[:, k]), color=YELLOW, lw=1.0)
        path.set_ylabel(f"{name} [m]")
        off_cm = 100.0 * (found.estimate_m[:, k] - found.truth_m[:, k])
        difference.plot(broken(times_s), broken(off_cm), color=RED, lw=0.8)
        difference.axhline(0.0, color="grey", lw=0.5)
        difference.set_ylabel("off [cm]", fontsize="small")
    rows[-1].set_xlabel("time of the truth since the first common sample [s]")
