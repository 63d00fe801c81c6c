"""The figures: what is drawn is what was estimated."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import ssac
from ssac.estimate import Estimate
from ssac.geometry.epipolar import epipolar_distance
from ssac.pipeline.plots import (
    BLUE,
    RED,
    YELLOW,
    ZOOM_S,
    Material,
    draw_epipolar,
    draw_search,
    plane_angles,
)
from tests.ssac.synthetic import track_pair


@pytest.fixture(scope="module")
def result(recorded):
    return ssac.sync(recorded / "cam1.h5", recorded / "cam2.h5", recorded / "rig.yaml")


@pytest.fixture(scope="module")
def material(result):
    one, other = result.answer.cleans
    return Material(result.estimate, (one.events, other.events), result.answer.views)


def of(result, estimate):
    """The same recordings with another estimate."""
    return replace(result, answer=replace(result.answer, estimate=estimate))


def test_a_folder_gets_one_picture_per_figure_and_a_page_all_of_them(result, tmp_path, monkeypatch):
    monkeypatch.setattr("ssac.pipeline.plots._DPI", 40)  # drawn in a third of the time
    written = result.plotted(tmp_path / "new" / "figures")
    assert [path.name for path in written] == ["d_avg.png", "epipolar.png"]
    figures = [cv2.imread(str(path)) for path in written]
    assert min(map(np.std, figures)) > 10.0  # not blank
    assert isinstance(result.plot(tmp_path / "page.png"), Figure)
    height, width, _ = cv2.imread(str(tmp_path / "page.png")).shape
    assert (height, width) == (sum(len(figure) for figure in figures), figures[0].shape[1])


def test_an_estimate_without_a_pose_has_its_curve_only_and_one_of_nothing_no_picture(
    result, tmp_path
):
    refused = of(result, Estimate("albl", "too_few_samples", "few"))
    assert refused.plotted(tmp_path / "page.png") == []
    assert refused.plot() is None
    assert not list(tmp_path.iterdir())
    curve = {"candidates_s": np.linspace(-1, 1, 9), "costs": -np.cos(np.linspace(-1, 1, 9))}
    written = of(result, Estimate("zncc_e", t_d_s=0.0, **curve)).plotted(tmp_path)
    assert [path.name for path in written] == ["d_avg.png"]


@pytest.mark.parametrize(("t_d_s", "n_rows"), [(-1.7, 2), (0.0, 1)])
def test_odd_offsets_can_be_drawn(t_d_s, n_rows, result):
    """At 0 there is no "before"; at -1.7 s the recordings overlap in part only."""
    page = of(result, replace(result.estimate, t_d_s=t_d_s)).plot()
    search, epipolar = page.subfigs
    assert [len(part.axes) for part in (search, epipolar)] == [2, 2 * n_rows]
    assert all(axes.collections for axes in epipolar.axes)


def test_what_is_drawn_is_the_search_and_the_distance(material):
    search, epipolar = Figure(), Figure()
    draw_search(search, material)
    whole, zoom = search.axes
    assert np.array_equal(
        whole.lines[0].get_data(), (material.estimate.candidates_s, material.estimate.costs)
    )
    near_ms, d_avg_px = zoom.lines[0].get_data()
    np.testing.assert_allclose(near_ms[[0, -1]], [-1e3 * ZOOM_S, 1e3 * ZOOM_S])
    # The estimate is of tangents, the curve of means: on these random pixels 1 ms apart or so.
    assert abs(near_ms[np.argmin(d_avg_px)]) < 2.0
    draw_epipolar(epipolar, material)
    assert len(epipolar.axes) == 4
    drawn_px = []
    for left, right in (epipolar.axes[:2], epipolar.axes[2:]):
        segment = np.transpose(left.lines[1].get_data())
        p1, p2 = (np.ravel(axes.lines[-1].get_data()) for axes in (left, right))
        drawn_px.append(np.linalg.norm(segment[1] - segment[0]))
        assert drawn_px[-1] == pytest.approx(epipolar_distance(material.estimate.F, p1, p2))
        assert f"{drawn_px[-1]:.2f} px" in left.get_title()
    assert drawn_px[1] < drawn_px[0]


def test_one_point_has_one_plane_angle_in_both_views(recorded, material):
    scene = recorded.scene
    truth = replace(material.estimate, R=scene.R, t=scene.t / np.linalg.norm(scene.t))
    p1, p2 = track_pair(scene, np.linspace(0.5, 7.5, 50))
    exact = replace(material, estimate=truth)
    angles_1, angles_2 = plane_angles(exact, 0, p1), plane_angles(exact, 1, p2)
    np.testing.assert_allclose(angles_1, angles_2, atol=1e-9)
    assert np.ptp(angles_1) > 5.0


def test_colours_stay_apart_in_grey():
    grey = sorted(np.dot(to_rgb(color), [0.299, 0.587, 0.114]) for color in (BLUE, RED, YELLOW))
    assert np.min(np.diff([*grey, 1.0])) > 0.15
