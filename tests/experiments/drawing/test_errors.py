from itertools import product

import numpy as np
import pandas as pd
import pytest

from experiments.drawing.errors import error_figure, flight_means, published_means
from experiments.paper.published import load_published

ANGLES_DEG, T_DS_MS, FLIGHTS = (30.0, 90.0), (5.0, 50.0, 500.0), range(4)
POSES = ("ssac", "theirs")


def make_runs(durations_s: tuple[float, ...] = (10.0, 20.0)) -> pd.DataFrame:
    """Runs of four methods, one of which is not registered here."""
    rng = np.random.default_rng(0)
    rows = []
    for duration_s, angle_deg, t_d_ms, flight in product(durations_s, ANGLES_DEG, T_DS_MS, FLIGHTS):
        for method in ("ssac", "ssac-known", "zncc_e", "theirs"):
            pose = rng.uniform(0.1, 0.5, 2) if method in POSES else (np.nan, np.nan)
            error_ms = rng.uniform(0.1, 0.4) * (100.0 if method == "zncc_e" else 1.0)
            rows.append(
                {
                    "duration_s": duration_s, "angle_deg": angle_deg, "t_d_ms": t_d_ms,
                    "flight": flight, "method": method, "status": "ok", "t_d_error_ms": error_ms,
                    "r_error_deg": pose[0], "t_error_deg": pose[1],
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def drawn_means(axes) -> list[np.ndarray]:
    return [np.transpose(container.lines[0].get_data()) for container in axes.containers]


def test_runs_that_failed_do_not_enter_the_means() -> None:
    runs = make_runs((20.0,))
    runs = runs[runs["method"] == "ssac"].reset_index(drop=True)
    gross = runs.copy()
    gross.loc[0, ["status", "t_d_error_ms"]] = ["search_bound", 1e6]
    means = flight_means(gross, "t_d_error_ms")
    at_30 = runs[runs["angle_deg"] == 30.0]["t_d_error_ms"]
    assert means.angles_deg == ANGLES_DEG
    assert means.means[0] == pytest.approx(at_30.iloc[1:].mean())


def test_offsets_of_one_flight_are_no_further_flights() -> None:
    runs = make_runs((20.0,))
    runs = runs[(runs["method"] == "ssac") & (runs["t_d_ms"] == 50.0)]
    thrice = pd.concat([runs.assign(t_d_ms=t_d_ms) for t_d_ms in T_DS_MS])
    once, repeated = flight_means(runs, "r_error_deg"), flight_means(thrice, "r_error_deg")
    assert repeated.means == pytest.approx(once.means)
    assert repeated.standard_errors == pytest.approx(once.standard_errors)
    at_30 = runs[runs["angle_deg"] == 30.0]["r_error_deg"]
    assert once.standard_errors[0] == pytest.approx(at_30.std(ddof=0) / np.sqrt(len(FLIGHTS)))


def test_the_papers_means_are_pooled_over_offsets() -> None:
    means = published_means(load_published()[10.0], "ssac_error_ms")
    assert means.angles_deg == (30.0, 60.0, 90.0, 120.0, 150.0)
    assert means.means[0] == pytest.approx((0.16 + 0.21 + 0.18) / 3)  # 30 deg in the paper's table
    variance = (0.21**2 + 0.16**2 + 0.17**2) / 3
    assert means.standard_errors[0] == pytest.approx(np.sqrt(variance / 10))


def test_every_duration_has_its_axes_and_every_mean_its_marker() -> None:
    runs = make_runs()
    figure = error_figure(runs, load_published())
    assert len(figure.axes) == 6
    for column, duration_s in enumerate((10.0, 20.0)):
        axes = figure.axes[column]
        assert f"{duration_s:g} s" in axes.get_title()
        # Four methods of ours, and the paper has two of them.
        drawn = drawn_means(axes)
        assert len(drawn) == 6
        ours = runs[(runs["duration_s"] == duration_s) & (runs["method"] == "ssac")]
        expected = ours.groupby("angle_deg")["t_d_error_ms"].mean()
        assert any(
            len(part) == len(expected) and np.allclose(part[:, 1], expected) for part in drawn
        )
        assert any(
            np.allclose(
                part[:, 1], published_means(load_published()[duration_s], "ssac_error_ms").means
            )
            for part in drawn
            if len(part) == 5
        )


def test_only_methods_that_give_a_pose_have_its_errors() -> None:
    figure = error_figure(make_runs(), load_published())
    for axes in figure.axes[2:]:
        assert len(drawn_means(axes)) == len(POSES) + 1  # and the paper's


def test_every_run_is_a_point_even_below_the_axis() -> None:
    runs = make_runs((20.0,))
    runs.loc[runs["method"] == "ssac", "t_d_error_ms"] = 0.0
    axes = error_figure(runs, load_published()).axes[0]
    points = [line.get_ydata() for line in axes.lines if line.get_marker() == "."]
    assert sum(map(len, points)) == len(runs)
    assert np.min(np.concatenate(points)) >= axes.get_ylim()[0]


def test_columns_of_neighbouring_angles_do_not_mix() -> None:
    axes = error_figure(make_runs(), load_published()).axes[0]
    for x in np.concatenate([part[:, 0] for part in drawn_means(axes)]):
        nearest = min((30.0, 60.0, 90.0, 120.0, 150.0), key=lambda angle: abs(angle - x))
        assert abs(x - nearest) < 15.0


def test_the_legend_counts_failures() -> None:
    runs = make_runs()
    runs.loc[[0, 4], "status"] = "search_bound"  # of ssac
    (legend,) = error_figure(runs, load_published()).legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert "ssac (2 of 48 failed)" in labels
    assert "zncc_e" in labels


def test_a_duration_that_the_paper_lacks_is_drawn_alone() -> None:
    figure = error_figure(make_runs((5.0,)), load_published())
    assert len(drawn_means(figure.axes[0])) == 4


def test_a_method_that_always_fails_is_only_in_the_legend() -> None:
    runs = make_runs((20.0,))
    failed = runs["method"] == "ssac-known"
    runs.loc[failed, "status"] = "too_few_samples"
    runs.loc[failed, "t_d_error_ms"] = np.nan
    figure = error_figure(runs, load_published())
    assert len(drawn_means(figure.axes[0])) == 5
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "ssac-known (24 of 24 failed)" in labels
