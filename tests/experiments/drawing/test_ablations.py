"""An ablation's means, drawn: a line for each angle, its default, failed runs, gaps."""

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest

from experiments.drawing.ablations import ablation_figure, default_value
from experiments.drawing.style import STANDARD_ERROR, value_color
from experiments.lab.grid import GridConfig, named_config
from sim.recording import SimConfig
from ssac.config import N_MIN, Config
from ssac.errors import SsacError

ERRORS = ("t_d_error_ms", "r_error_deg", "t_error_deg")


def make_means(grid: GridConfig) -> pd.DataFrame:
    """Random means of a grid, in the columns of an ablation's CSV."""
    rng = np.random.default_rng(0)
    rows = []
    for point in product(*grid.axes):
        parameters = {name: str(value) if isinstance(value, list) else value
                      for part in point for name, value in part.items()}  # fmt: skip
        for method in grid.methods:
            row = {**parameters, "method": method, "n_runs": 10, "failed": 0}
            for error in ERRORS:
                row[f"{error}_mean"], row[f"{error}_std"] = rng.uniform(0.1, 0.4, 2)
            rows.append(row)
    return pd.DataFrame(rows)


def drawn(axes) -> list[np.ndarray]:
    return [np.transpose(container.lines[0].get_data()) for container in axes.containers]


def test_a_line_holds_the_means_of_one_angle_and_method_and_the_default_is_marked() -> None:
    grid = named_config("ablation_window")
    means = make_means(grid)
    axes = ablation_figure(means, grid).axes
    assert axes[0].get_ylabel() == "ssac"  # in the registry's order
    for row, method in enumerate(("ssac", "joint")):
        for column, error in enumerate(ERRORS):
            lines = drawn(axes[len(ERRORS) * row + column])
            for angle_deg, line in zip((30, 90, 150), lines, strict=True):
                chosen = (means["method"] == method) & (means["sim.angle_deg"] == angle_deg)
                expected = means[chosen]
                np.testing.assert_allclose(line[:, 0], 1e3 * expected["ssac.half_window_s"])
                np.testing.assert_allclose(line[:, 1], expected[f"{error}_mean"])
    for one in axes:  # in the axis' unit
        dashed = [line for line in one.lines if line.get_linestyle() == "--"]
        assert [line.get_xdata()[0] for line in dashed] == [1e3 * Config().half_window_s]
    # A method without a pose leaves its axes empty.
    poses = [f"r_error_deg_{part}" for part in ("mean", "std")]
    means.loc[means["method"] == "ssac", poses] = np.nan
    axes = ablation_figure(means, grid).axes
    assert [len(drawn(axes[k])) for k in (1, 4)] == [0, 3]


def test_a_default_that_a_logarithm_lacks_is_written() -> None:
    grid = named_config("ablation_noise")
    figure = ablation_figure(make_means(grid), grid)
    dashed = [line for axes in figure.axes for line in axes.lines if line.get_linestyle() == "--"]
    assert not dashed
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words[-2:] == ["default: 0, not on this axis", STANDARD_ERROR[0]]
    assert default_value("ssac.n_min") == N_MIN
    assert default_value("sim.spline.sampling_hz") == SimConfig().spline.sampling_hz
    assert default_value("sim.drone_size_m") == 0.65  # None in SimConfig: the quadrotor's own


def test_failures_have_axes_only_where_there_are_some_and_leave_a_gap() -> None:
    grid = named_config("ablation_n_min")
    means = make_means(grid)
    lost = (means["ssac.n_min"] == 1600) & (means["method"] == "ssac")
    means.loc[lost & (means["sim.angle_deg"] == 90), "failed"] = 3
    axes = ablation_figure(means, grid).axes
    assert len(axes) == 12
    assert axes[3].get_title() == "failed runs [%]"
    shares = [line.get_ydata() for line in axes[3].lines if line.get_linestyle() == "-"]
    assert [float(share[-1]) for share in shares] == [0.0, 30.0, 0.0]
    hollow = [line for line in axes[0].lines if line.get_markerfacecolor() == "white"]
    assert [float(line.get_xdata()[0]) for line in hollow] == [1600.0]
    assert [text.get_text() for text in axes[0].texts] == ["7"]  # of 10
    means.loc[lost, [f"{error}_{part}" for error in ERRORS for part in ("mean", "std")]] = np.nan
    for line in drawn(ablation_figure(means, grid).axes[0]):
        assert np.isnan(line[-1, 1])
        assert np.isfinite(line[:-1]).all()


def test_standard_errors_stay_above_zero_on_a_logarithmic_axis() -> None:
    """The deviation of n errors, none negative, is at most sqrt(n - 1) times their mean."""
    grid = named_config("ablation_samples")
    means = make_means(grid)
    means["t_d_error_ms_std"] = 3.0 * means["t_d_error_ms_mean"]  # 9 runs at 0, one far off
    means.loc[0, ["t_d_error_ms_mean", "t_d_error_ms_std"]] = 100.0, 300.0
    axes = ablation_figure(means, grid).axes[0]
    assert axes.get_yscale() == "log"
    ends = [bars.get_segments() for container in axes.containers for bars in container.lines[2]]
    assert np.min(np.concatenate(ends)[:, :, 1]) > 0.0


def test_what_cannot_be_drawn_is_named() -> None:
    grid = named_config("ablation_window")
    means = make_means(grid)
    with pytest.raises(SsacError, match=r"ablation_window: its TOML has no table \[figure\]"):
        ablation_figure(means, replace(grid, figure=None))
    with pytest.raises(SsacError, match=r"lack the columns ssac\.half_window_s, failed"):
        ablation_figure(means.drop(columns=["ssac.half_window_s", "failed"]), grid)


def test_an_angle_and_a_duration_have_one_colour_in_every_company() -> None:
    for name, value in (("sim.angle_deg", 90.0), ("sim.spline.duration_s", 20.0)):
        assert value_color(name, value, 0.0) == value_color(name, value, 1.0)
    assert value_color("sim.t_d_s", 90.0, 0.0) != value_color("sim.t_d_s", 90.0, 1.0)
