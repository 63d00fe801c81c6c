"""Figures of errors over the angle and in ablations: means, gaps, legends, styles, PNG files."""

import io
from itertools import product

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from PIL import Image

from experiments.drawing import errors, style
from experiments.drawing.errors import ablation_figure, beyond_figure, error_figure, flight_means
from experiments.lab.grid import GridConfig, named_config
from experiments.lab.results import DPI, Results, png_bytes
from experiments.paper.comparison import load_published
from experiments.paper.esim import ERRORS
from ssac.pipeline.plots import BLUE, YELLOW
from ssac.pipeline.registry import METHODS
from tests.experiments.reported import RESULTS, made_up_runs

PUBLISHED = load_published()
ANGLES_DEG = [30.0, 60.0, 90.0, 120.0, 150.0]


def runs_of(*durations_s: float) -> pd.DataFrame:
    """Runs of four methods, one of which is not registered here, none of which failed."""
    names = {"joint-known": "ssac-known", "joint": "theirs"}
    runs = made_up_runs(("ssac", "joint-known", "zncc_e", "joint"), 4).replace({"method": names})
    runs["status"] = "ok"
    return runs[runs["duration_s"].isin(durations_s)].reset_index(drop=True)


def drawn_means(axes) -> list[np.ndarray]:
    return [np.transpose(one.lines[0].get_data()).astype(float) for one in axes.containers]


def labels(figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def panels_of(figure) -> list[tuple]:
    of = product(ERRORS, (10.0, 20.0))
    return [(axes, *one) for axes, one in zip(figure.axes, of, strict=True)]


def papers(duration_s: float, method: str, error: str) -> list[float]:
    return errors.published_means(PUBLISHED, duration_s, method, error)["mean"].tolist()


def test_means_are_over_the_runs_that_did_not_fail_and_a_flight_counts_once() -> None:
    runs = runs_of(20.0).query("method == 'ssac'").reset_index(drop=True)
    gross = runs.copy()
    gross.loc[0, ["status", "t_d_error_ms"]] = ["search_bound", 1e6]
    means = flight_means(gross, "t_d_error_ms")
    assert means.index.tolist() == ANGLES_DEG
    at_30 = runs[runs["angle_deg"] == 30.0]
    assert means["mean"].iloc[0] == pytest.approx(at_30["t_d_error_ms"].iloc[1:].mean())
    of_one = runs[runs["t_d_ms"] == 50.0]
    thrice = pd.concat([of_one.assign(t_d_ms=t_d_ms) for t_d_ms in (5.0, 50.0, 500.0)])
    once, repeated = flight_means(of_one, "r_error_deg"), flight_means(thrice, "r_error_deg")
    np.testing.assert_allclose(repeated.iloc[:, :2], once.iloc[:, :2])
    deviation = at_30.loc[at_30["t_d_ms"] == 50.0, "r_error_deg"].std(ddof=1)
    assert once["standard_error"].iloc[0] == pytest.approx(deviation / np.sqrt(4))
    of_one_flight = flight_means(thrice[thrice["flight"] == 0], "r_error_deg")
    assert of_one_flight["standard_error"].isna().all()


def test_the_papers_means_are_pooled_over_offsets() -> None:
    means = errors.published_means(PUBLISHED, 10.0, "ssac", "t_d_error_ms")
    assert means.index.tolist() == ANGLES_DEG
    # 30 deg in the paper's table, whose deviations of ten flights are over ten, not nine.
    expected = (0.16 + 0.21 + 0.18) / 3, np.sqrt((0.21**2 + 0.16**2 + 0.17**2) / 3 / 9)
    assert tuple(means[["mean", "standard_error"]].iloc[0]) == pytest.approx(expected)
    for duration_s, method in ((10.0, "joint"), (5.0, "ssac")):
        assert errors.published_means(PUBLISHED, duration_s, method, "t_d_error_ms") is None


def test_every_mean_of_ours_and_of_the_paper_is_drawn_where_there_is_one() -> None:
    """Ours are drawn for each error that a method gives, the paper's for its two methods."""
    runs = runs_of(10.0, 20.0)
    for axes, error, duration_s in panels_of(error_figure(runs, PUBLISHED)):
        is_offset = error == "t_d_error_ms"
        of_methods = runs[runs["duration_s"] == duration_s].groupby("method")
        methods = ("ssac", "theirs", *(("ssac-known", "zncc_e") if is_offset else ()))
        expected = [
            flight_means(of_methods.get_group(one), error)["mean"].tolist() for one in methods
        ]
        known = ("ssac", "zncc_e") if is_offset else ("ssac",)
        expected += [papers(duration_s, method, error) for method in known]
        drawn = [tuple(part[:, 1]) for part in drawn_means(axes)]
        np.testing.assert_allclose(sorted(drawn), sorted(expected))
        if is_offset:
            assert f"{duration_s:g} s" in axes.get_title()


def test_every_run_is_a_point_even_below_the_axis() -> None:
    runs = runs_of(20.0)
    runs.loc[runs["method"] == "ssac", "t_d_error_ms"] = 0.0
    axes = error_figure(runs, PUBLISHED).axes[0]
    points = np.concatenate([one.get_ydata() for one in axes.lines if one.get_marker() == "."])
    assert len(points) == len(runs)
    assert points.min() >= axes.get_ylim()[0]


def test_the_legend_counts_failures_and_what_the_paper_lacks_is_drawn_alone() -> None:
    runs = runs_of(10.0, 20.0)
    runs.loc[runs.index[runs["method"] == "ssac"][:2], "status"] = "search_bound"
    failed = runs["method"] == "ssac-known"
    runs.loc[failed, ["status", "t_d_error_ms"]] = ["too_few_samples", np.nan]
    figure = error_figure(runs, PUBLISHED)
    assert labels(figure)[:2] == ["ssac (2 of 120 refused)", "ssac-known (120 of 120 refused)"]
    assert "zncc_e" in labels(figure)
    assert len(drawn_means(figure.axes[0])) == 5  # one that always fails is in the legend alone
    assert style.SURVIVORS[0] in labels(figure)
    faces = [line.get_markerfacecolor() for line in figure.axes[0].lines]
    assert faces.count("white") == 1  # both runs are of one angle
    assert [text.get_text() for text in figure.axes[0].texts] == ["10"]
    runs = runs_of(20.0).assign(duration_s=5.0)
    assert len(drawn_means(error_figure(runs, PUBLISHED).axes[0])) == 4
    assert len(drawn_means(beyond_figure(runs, PUBLISHED).axes[0])) == 1


def test_the_area_under_a_success_curve_counts_the_refused() -> None:
    runs = runs_of(20.0)
    own = runs["method"] == "ssac"
    runs.loc[own, "t_d_error_ms"] = 0.25
    runs.loc[runs["method"] == "zncc_e", "t_d_error_ms"] = 1.0  # not below the threshold
    runs.loc[runs.index[own][: own.sum() // 2], "status"] = "search_bound"
    axes = errors.success_figure(runs).axes[0]
    curves = dict(zip(axes.get_legend_handles_labels()[1], axes.lines, strict=True))
    x, shares = curves["ssac 37.5"].get_data()  # half of the runs, over 3/4 of the axis
    assert np.all(x[1:-1] == 0.25)
    assert (shares[0], shares[-1]) == (0.0, 50.0)
    assert set(curves["zncc_e 0.0"].get_ydata()) == {0.0}
    assert len(errors.success_figure(runs).axes[2].lines) == 2  # the methods that give a pose


def test_the_refinements_stand_beside_the_paper_and_the_marks() -> None:
    runs = made_up_runs((*errors.REFINED, "zncc_e"), 3)
    for axes, error, duration_s in panels_of(beyond_figure(runs, PUBLISHED)):
        paper, *ours = drawn_means(axes)
        np.testing.assert_allclose(paper[:, 1], papers(duration_s, "ssac", error))
        for method, drawn in zip(errors.REFINED, ours, strict=True):
            own = runs[(runs["method"] == method) & (runs["duration_s"] == duration_s)]
            np.testing.assert_allclose(drawn[:, 1], flight_means(own, error)["mean"])
        (level,) = (line for line in axes.lines if line.get_linestyle() == "--")
        assert list(level.get_ydata()) == [ERRORS[error].mark] * 2
    without = beyond_figure(made_up_runs(("joint", "ssac"), 2), PUBLISHED)
    assert labels(without)[:3] == ["the paper's ssac", "ssac", "joint"]
    assert "tangency" not in labels(without)


def test_a_picture_says_nothing_of_the_program_and_keeps_its_colours() -> None:
    figure = Figure(figsize=(style.WIDTH_IN, 2.0))
    figure.subplots().plot([0.0, 1.0], [0.0, 1.0], color="#D55E00", lw=20)
    with Image.open(io.BytesIO(png_bytes(figure))) as image:
        assert image.size == (style.WIDTH_IN * DPI, 2.0 * DPI)
        assert not {"Software", "Creation Time", "date"} & set(image.info)
        # The palette holds the drawn colour, as closely as its 96 colours allow.
        middle = image.convert("RGB").getpixel((image.width // 2, image.height // 2))
        assert middle == pytest.approx((0xD5, 0x5E, 0x00), abs=4)


def test_no_two_methods_look_alike_each_the_same_in_every_company_and_no_colour_is_two_things():
    """Only sibling methods share a colour; their markers differ."""
    looks = style.method_looks([*METHODS, *"abcd"])
    assert len(set(looks.values())) == len(looks)
    assert style.method_looks(["ssac"])["ssac"] == looks["ssac"]
    assert looks["ssac-known"].color == looks["ssac"].color
    assert looks["ssac-known"].style["fillstyle"] != looks["ssac"].style["fillstyle"]

    methods = {look.color for look in looks.values()}
    named = {"sim.angle_deg": ANGLES_DEG, "sim.spline.duration_s": (10.0, 20.0), "other": range(5)}
    values = [to_hex(style.value_color(name, value, 0.25 * place)).upper()
              for name, of in named.items() for place, value in enumerate(of)]  # fmt: skip
    colors = [*methods, *values, style.ACCENT, *style.FILLS, BLUE, YELLOW]
    assert len(set(colors)) == len(colors)


@pytest.mark.parametrize("reach", [(0.13, 0.35), (0.12, 0.8), (0.03, 0.9), (0.01, 1000.0)])
def test_three_numbers_at_least_are_on_a_logarithmic_axis(reach: tuple[float, float]) -> None:
    axes = Figure().subplots()
    axes.set(yscale="log", ylim=reach)
    style.label_log_axis(axes.yaxis)
    ticks = axes.get_yticks()
    assert np.count_nonzero((ticks >= reach[0]) & (ticks <= reach[1])) >= 3


def of_ablation(name: str) -> tuple[pd.DataFrame, GridConfig]:
    return Results(RESULTS).table(f"ablation_{name}_runs"), named_config(f"ablation_{name}")


def said(figure) -> tuple[str, list[str]]:
    return figure.legends[0].get_title().get_text(), labels(figure)


def test_a_line_holds_the_means_of_one_angle_and_method_and_the_default_is_marked() -> None:
    runs, grid = of_ablation("focal")
    figure = ablation_figure(runs, grid)
    assert figure.axes[0].get_ylabel() == "ssac"  # in the registry's order
    for axes, (method, error) in zip(figure.axes, product(grid.methods, ERRORS), strict=True):
        lines = drawn_means(axes)
        for angle_deg, line in zip((30, 90, 150), lines, strict=True):
            own = runs[(runs["method"] == method) & (runs["sim.angle_deg"] == angle_deg)]
            expected = flight_means(own, error, "sim.focal_px")
            np.testing.assert_allclose(line[:, 1], expected["mean"])
            # A line is moved aside as a whole, by a factor of its own.
            assert np.ptp(line[:, 0] / expected.index) == pytest.approx(0.0, abs=1e-9)
        assert len({line[0, 0] for line in lines}) == 3
        (default,) = (line for line in axes.lines if line.get_linestyle() == "--")
        assert default.get_xdata()[0] == 200.0
    title, names = said(figure)
    assert title == "Errors of one flight: focal length"
    # There are no bars and no hollow markers, so the legend explains none.
    assert names == ["30 deg", "90 deg", "150 deg", "default: 200 px"]
    # A method without a pose leaves its axes empty.
    runs.loc[runs["method"] == "ssac", "r_error_deg"] = np.nan
    axes = ablation_figure(runs, grid).axes
    assert [len(drawn_means(axes[k])) for k in (1, 4)] == [0, 3]


def test_offsets_are_pooled_and_lines_are_of_what_varies_or_else_of_methods() -> None:
    """An angle has its colour in every figure; of two more parameters one has the rows."""
    noise, brightness, objects = (
        ablation_figure(*of_ablation(name)) for name in ("davis346", "brightness", "object")
    )
    assert said(noise) == (
        "Mean errors of 2 flights: noise of a DAVIS346", ["10 s", "20 s", style.STANDARD_ERROR[0]],
    )  # fmt: skip
    assert labels(brightness)[0] == "90 deg"
    assert brightness.axes[0].lines[0].get_color() == style.value_color("sim.angle_deg", 90, 0.0)
    drones = ["quadrotor", "two-tone", "bird", "plane"]
    assert [axes.get_ylabel() for axes in objects.axes if axes.get_ylabel()] == drones
    assert labels(objects)[:3] == [*named_config("ablation_object").methods]
    assert said(objects)[0].startswith("Mean errors of 3 flights at all angles")


def test_refusals_have_axes_only_where_there_are_some_and_leave_a_gap() -> None:
    runs, grid = of_ablation("n_min")
    runs["status"] = "ok"
    assert len(ablation_figure(runs, grid).axes) == 9
    own = (runs["ssac.n_min"] == 1600) & (runs["method"] == "ssac")
    lost = own & (runs["sim.angle_deg"] == 90) & (runs["flight"] < 3)
    runs.loc[lost, "status"] = "too_few_samples"
    axes = (figure := ablation_figure(runs, grid)).axes
    assert len(axes) == 12
    assert axes[3].get_title() == "refused runs [%]"
    bars = [float(bar.get_segments()[-1][1, 1]) for bar in axes[3].collections]
    assert bars == pytest.approx([0.0, 30.0, 0.0])
    (hollow,) = (line for line in axes[0].lines if line.get_markerfacecolor() == "white")
    assert hollow.get_xdata()[0] == pytest.approx(1600.0)
    assert [text.get_text() for text in axes[0].texts] == ["7"]  # of 10
    assert style.SURVIVORS[0] in labels(figure)
    runs.loc[own, "status"] = "too_few_samples"
    figure = ablation_figure(runs, grid)
    assert style.SURVIVORS[0] not in labels(figure)  # no run is left to draw a hollow marker
    for line in drawn_means(figure.axes[0]):
        assert np.isnan(line[-1, 1])
        assert np.isfinite(line[:-1]).all()


def test_means_are_within_a_logarithmic_axis_whatever_their_bars_reach() -> None:
    """The bar of two errors, one of which is 0, reaches down to 0."""
    runs, grid = of_ablation("speed")
    runs.loc[runs["flight"] == 0, "t_d_error_ms"] = 0.0
    axes = ablation_figure(runs, grid).axes[0]
    assert axes.get_yscale() == "log"
    low, high = axes.get_ylim()
    means = np.concatenate(drawn_means(axes))[:, 1]
    assert 0.0 < low < np.nanmin(means) < np.nanmax(means) < high
