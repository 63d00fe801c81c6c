import numpy as np
import pandas as pd
import pytest

from experiments.drawing.beyond import METHODS, beyond_figure
from experiments.drawing.errors import flight_means, published_means
from experiments.paper.published import load_published
from experiments.paper.quantities import ERRORS
from ssac.errors import SsacError
from tests.experiments.reported import made_up_runs

ALL = (*METHODS, "ssac-known", "zncc_e")


def drawn_means(axes) -> list[np.ndarray]:
    return [np.transpose(container.lines[0].get_data()) for container in axes.containers]


def test_every_duration_and_error_has_the_paper_and_three_methods() -> None:
    runs = made_up_runs(ALL, 3)
    figure = beyond_figure(runs, load_published())
    assert len(figure.axes) == 6
    for number, axes in enumerate(figure.axes):
        error, duration_s = list(ERRORS)[number // 2], (10.0, 20.0)[number % 2]
        paper, *ours = drawn_means(axes)
        column = {"t_d_error_ms": "ssac_error_ms"}.get(error, error)
        expected = published_means(load_published()[duration_s], column)
        np.testing.assert_allclose(paper[:, 1].astype(float), expected.means)
        assert len(ours) == len(METHODS)
        for method, drawn in zip(METHODS, ours, strict=True):
            own = runs[(runs["method"] == method) & (runs["duration_s"] == duration_s)]
            np.testing.assert_allclose(drawn[:, 1].astype(float), flight_means(own, error).means)


def test_the_marks_are_lines() -> None:
    for number, axes in enumerate(beyond_figure(made_up_runs(ALL, 2), load_published()).axes):
        levels = [line.get_ydata() for line in axes.lines if line.get_linestyle() == "--"]
        assert [list(level) for level in levels] == [[list(ERRORS.values())[number // 2].mark] * 2]


def test_columns_of_neighbouring_angles_do_not_mix() -> None:
    axes = beyond_figure(made_up_runs(ALL, 2), load_published()).axes[0]
    x = np.stack([part[:, 0] for part in drawn_means(axes)])
    assert np.all(np.abs(x - [30.0, 60.0, 90.0, 120.0, 150.0]) < 15.0)
    assert np.all(np.diff(x, axis=0) > 0.0)  # the paper, then what was built on it


def test_a_method_without_runs_is_left_out() -> None:
    figure = beyond_figure(made_up_runs(("joint", "ssac"), 2), load_published())
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[:3] == ["the paper", "ssac", "joint"]
    assert "tangency" not in labels
    with pytest.raises(SsacError, match="expected runs of ssac, joint, tangency"):
        beyond_figure(made_up_runs(("zncc_e",), 1), load_published())


def test_a_duration_that_the_paper_lacks_is_drawn_alone() -> None:
    runs: pd.DataFrame = made_up_runs(("ssac",), 2).assign(duration_s=5.0)
    runs = runs.drop_duplicates(["angle_deg", "t_d_ms", "flight"])
    assert len(drawn_means(beyond_figure(runs, load_published()).axes[0])) == 1
