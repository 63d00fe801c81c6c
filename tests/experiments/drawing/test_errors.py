"""Errors against the angle: means of the runs and the paper's; looks of methods, bytes of a PNG."""

import io

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from PIL import Image

from experiments.drawing.errors import (
    REFINED,
    beyond_figure,
    error_figure,
    flight_means,
    published_means,
)
from experiments.drawing.style import WIDTH_IN, method_looks
from experiments.lab.files import DPI, png_bytes
from experiments.paper.comparison import load_published
from experiments.paper.quantities import ERRORS
from ssac.errors import SsacError
from ssac.pipeline.registry import METHODS
from tests.experiments.reported import made_up_runs

ANGLES_DEG, T_DS_MS = (30.0, 60.0, 90.0, 120.0, 150.0), (5.0, 50.0, 500.0)
POSES = ("ssac", "theirs")


def runs_of(*durations_s: float) -> pd.DataFrame:
    """Runs of four methods, one of which is not registered here, none of which failed."""
    names = {"joint-known": "ssac-known", "joint": "theirs"}
    runs = made_up_runs(("ssac", "joint-known", "zncc_e", "joint"), 4).replace({"method": names})
    runs["status"] = "ok"
    return runs[runs["duration_s"].isin(durations_s)].reset_index(drop=True)


def drawn_means(axes) -> list[np.ndarray]:
    return [np.transpose(container.lines[0].get_data()) for container in axes.containers]


def labels(figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_runs_that_failed_do_not_enter_the_means() -> None:
    runs = runs_of(20.0)
    runs = runs[runs["method"] == "ssac"].reset_index(drop=True)
    gross = runs.copy()
    gross.loc[0, ["status", "t_d_error_ms"]] = ["search_bound", 1e6]
    means = flight_means(gross, "t_d_error_ms")
    at_30 = runs[runs["angle_deg"] == 30.0]["t_d_error_ms"]
    assert means.angles_deg == ANGLES_DEG
    assert means.means[0] == pytest.approx(at_30.iloc[1:].mean())


def test_offsets_of_one_flight_are_no_further_flights() -> None:
    runs = runs_of(20.0)
    runs = runs[(runs["method"] == "ssac") & (runs["t_d_ms"] == 50.0)]
    thrice = pd.concat([runs.assign(t_d_ms=t_d_ms) for t_d_ms in T_DS_MS])
    once, repeated = flight_means(runs, "r_error_deg"), flight_means(thrice, "r_error_deg")
    assert repeated.means == pytest.approx(once.means)
    assert repeated.standard_errors == pytest.approx(once.standard_errors)
    at_30 = runs[runs["angle_deg"] == 30.0]["r_error_deg"]
    assert once.standard_errors[0] == pytest.approx(at_30.std(ddof=0) / np.sqrt(4))


def test_the_papers_means_are_pooled_over_offsets() -> None:
    means = published_means(load_published()[10.0], "ssac_error_ms")
    assert means.angles_deg == ANGLES_DEG
    assert means.means[0] == pytest.approx((0.16 + 0.21 + 0.18) / 3)  # 30 deg in the paper's table
    variance = (0.21**2 + 0.16**2 + 0.17**2) / 3
    assert means.standard_errors[0] == pytest.approx(np.sqrt(variance / 10))


def test_every_mean_of_ours_and_of_the_paper_is_drawn_where_there_is_one() -> None:
    """Of the errors that a method gives; of the paper's, of its two methods."""
    runs, published = runs_of(10.0, 20.0), load_published()
    figure = error_figure(runs, published)
    assert len(figure.axes) == 6
    for number, axes in enumerate(figure.axes):
        error, duration_s = list(ERRORS)[number // 2], (10.0, 20.0)[number % 2]
        of_duration = runs[runs["duration_s"] == duration_s]
        methods = POSES if number >= 2 else ("ssac", "ssac-known", "zncc_e", "theirs")
        expected = [
            flight_means(of_duration[of_duration["method"] == method], error).means
            for method in methods
        ]
        papers = ("ssac_error_ms", "zncc_e_error_ms") if number < 2 else (error,)
        expected += [published_means(published[duration_s], name).means for name in papers]
        drawn = [tuple(part[:, 1].astype(float)) for part in drawn_means(axes)]
        np.testing.assert_allclose(sorted(drawn), sorted(expected))
        if number < 2:
            assert f"{duration_s:g} s" in axes.get_title()


def test_every_run_is_a_point_even_below_the_axis() -> None:
    runs = runs_of(20.0)
    runs.loc[runs["method"] == "ssac", "t_d_error_ms"] = 0.0
    axes = error_figure(runs, load_published()).axes[0]
    points = [line.get_ydata() for line in axes.lines if line.get_marker() == "."]
    assert sum(map(len, points)) == len(runs)
    assert np.min(np.concatenate(points)) >= axes.get_ylim()[0]


@pytest.mark.parametrize("figure", [error_figure, beyond_figure])
def test_columns_of_neighbouring_angles_do_not_mix(figure) -> None:
    axes = figure(made_up_runs((*REFINED, "ssac-known", "zncc_e"), 2), load_published()).axes[0]
    x = np.stack([part[:, 0] for part in drawn_means(axes)])
    assert np.all(np.abs(x - ANGLES_DEG) < 15.0)
    if figure is beyond_figure:
        assert np.all(np.diff(x, axis=0) > 0.0)  # the paper, then what was built on it


def test_the_legend_counts_failures() -> None:
    runs = runs_of(10.0, 20.0)
    runs.loc[runs.index[runs["method"] == "ssac"][:2], "status"] = "search_bound"
    failed = runs["method"] == "ssac-known"
    runs.loc[failed, "status"] = "too_few_samples"
    runs.loc[failed, "t_d_error_ms"] = np.nan
    figure = error_figure(runs, load_published())
    assert {"ssac (2 of 120 failed)", "ssac-known (120 of 120 failed)", "zncc_e"} <= set(
        labels(figure)
    )
    assert len(drawn_means(figure.axes[0])) == 5  # one that always fails is only in the legend


def test_a_duration_that_the_paper_lacks_is_drawn_alone() -> None:
    runs = runs_of(20.0).assign(duration_s=5.0)
    assert len(drawn_means(error_figure(runs, load_published()).axes[0])) == 4
    assert len(drawn_means(beyond_figure(runs, load_published()).axes[0])) == 1


def test_the_refinements_stand_beside_the_paper_and_the_marks() -> None:
    runs, published = made_up_runs((*REFINED, "zncc_e"), 3), load_published()
    figure = beyond_figure(runs, published)
    assert len(figure.axes) == 6
    for number, axes in enumerate(figure.axes):
        error, duration_s = list(ERRORS)[number // 2], (10.0, 20.0)[number % 2]
        paper, *ours = drawn_means(axes)
        column = {"t_d_error_ms": "ssac_error_ms"}.get(error, error)
        expected = published_means(published[duration_s], column)
        np.testing.assert_allclose(paper[:, 1].astype(float), expected.means)
        for method, drawn in zip(REFINED, ours, strict=True):
            own = runs[(runs["method"] == method) & (runs["duration_s"] == duration_s)]
            np.testing.assert_allclose(drawn[:, 1].astype(float), flight_means(own, error).means)
        levels = [line.get_ydata() for line in axes.lines if line.get_linestyle() == "--"]
        assert [list(level) for level in levels] == [[ERRORS[error].mark] * 2]


def test_a_refinement_without_runs_is_left_out() -> None:
    figure = beyond_figure(made_up_runs(("joint", "ssac"), 2), load_published())
    assert labels(figure)[:3] == ["the paper", "ssac", "joint"]
    assert "tangency" not in labels(figure)
    with pytest.raises(SsacError, match="expected runs of ssac, joint, tangency"):
        beyond_figure(made_up_runs(("zncc_e",), 1), load_published())


def line_figure() -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 2.0))
    figure.subplots().plot([0.0, 1.0], [0.0, 1.0], color="#D55E00", lw=20)
    return figure


def test_a_picture_is_the_same_bytes_every_time() -> None:
    assert png_bytes(line_figure()) == png_bytes(line_figure())


def test_a_picture_says_nothing_of_time_and_program() -> None:
    with Image.open(io.BytesIO(png_bytes(line_figure()))) as image:
        assert image.size == (WIDTH_IN * DPI, 2.0 * DPI)
        assert not {"Software", "Creation Time", "date"} & set(image.info)
        # The palette holds what was drawn, within what its 96 colours allow.
        middle = image.convert("RGB").getpixel((image.width // 2, image.height // 2))
        assert middle == pytest.approx((0xD5, 0x5E, 0x00), abs=4)


def test_no_two_methods_look_alike() -> None:
    looks = method_looks([*METHODS, "theirs", "others"])
    assert len(set(looks.values())) == len(looks)


def test_a_method_looks_the_same_in_every_company() -> None:
    assert method_looks(["ssac"])["ssac"] == method_looks([*METHODS])["ssac"]
    known, unknown = method_looks(["ssac-known", "ssac"]).values()
    assert known.color == unknown.color
    assert known.face != unknown.face
