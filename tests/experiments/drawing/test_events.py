"""The paper's Fig. 3 to 5 and the animation, drawn from a synthetic recording."""

import io

import numpy as np
import pytest
from PIL import Image, ImageColor

from experiments.drawing import events as drawing
from experiments.drawing.events import STRETCH_S, load_recording, preprocessing_figure
from ssac.errors import SsacError
from ssac.pipeline.chain import Chain
from ssac.track.observation import Observation
from tests.recorded import T_D_S
from tests.ssac.cluttered import merged, noise
from tests.ssac.synthetic import HEIGHT, WIDTH


@pytest.fixture(scope="module")
def aligned(recorded):
    """The synthetic recording without its time offset."""
    return load_recording(recorded.folder, -T_D_S)


def test_fig_5_shows_d_avg_which_is_least_at_the_true_offset(aligned) -> None:
    """The axes show 1 s and 3 ms each way. Up to 2 ms, as the mean of events is no fixed point."""
    shown = zip(drawing.d_avg_figure(aligned).axes, (1.0, 3.0), (5e-3, 2.0), strict=True)
    for axes, reach, near in shown:
        assert axes.get_xlim() == (-reach, reach)
        curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
        least = [line for line in axes.lines if line.get_marker() == "o"]
        assert len(curves) == 2
        for curve, point in zip(curves, least, strict=True):
            x, d_px = curve.get_data()
            assert (x[0], x[-1]) == pytest.approx((-reach, reach))
            assert np.isfinite(d_px).all()
            ((at, least_px),) = zip(*point.get_data(), strict=True)
            assert least_px == d_px.min()
            assert abs(at) <= near
            assert reach == 3.0 or min(d_px[0], d_px[-1]) > 1.5 * least_px


def test_fig_4_shows_the_distance_before_and_after(recorded) -> None:
    figure = drawing.epipolar_figure(load_recording(recorded.folder))
    before, after = (
        float(axes.get_title().split("= ")[1].removesuffix(" px")) for axes in figure.axes[::2]
    )
    assert after < 0.2 * before


def test_the_animation_moves_the_offset_and_the_gap_closes(recorded, monkeypatch) -> None:
    monkeypatch.setattr(drawing, "PICTURES", (1, 2, 1))  # all take 10 s
    picture = drawing.alignment_animation(load_recording(recorded.folder, 0.3))
    moving, gap = Image.open(io.BytesIO(picture)), ImageColor.getrgb(drawing.GAP)
    gaps = []
    for number in range(moving.n_frames):
        moving.seek(number)
        views = np.asarray(moving.convert("RGB"), dtype=float)[: moving.height // 2]
        gaps.append(np.count_nonzero(np.abs(views - gap).max(axis=-1) < 40))
    shown, before, *_, after = gaps  # the first picture is shown where nothing moves
    assert shown == after < 0.2 * before
    assert len(gaps) == 1 + 4


def test_fig_3_shows_noise_going_and_the_object_staying(aligned) -> None:
    rate_hz = 2e4  # of the whole sensor
    added = noise(WIDTH, HEIGHT, rate_hz / (WIDTH * HEIGHT), 8_000_000)
    cameras = Observation(merged(aligned.recorded(0).events, added)), aligned.recorded(1)
    clean, noisy = map(preprocessing_figure, (aligned, Chain(cameras, aligned.rig)))
    raw, kept, raw_noisy, kept_noisy = (
        int(axes.get_title().split("\n")[1].split(",")[0].replace(" ", ""))
        for axes in (*clean.axes[:2], *noisy.axes[:2])
    )
    expected = rate_hz * (STRETCH_S[1] - STRETCH_S[0])
    # The tolerance is five standard deviations of a Poisson distribution.
    assert raw_noisy - raw == pytest.approx(expected, abs=5 * np.sqrt(expected))
    # The noise that is left lies among the object's events, a few per cent of their number.
    assert kept <= kept_noisy < 1.05 * kept
    for axes in noisy.axes[:2]:  # the same share of both is drawn
        assert len(axes.collections[0].get_offsets()) <= 2 * 15000


def test_fig_3_leaves_out_positions_that_are_not_valid(aligned) -> None:
    events = aligned.recorded(0).events
    middle_us = 1e6 * np.mean(STRETCH_S)
    away = np.abs(events["t"] - middle_us) < 200_000  # the object stands still for 0.4 s
    gap = Chain((Observation(events[~away]), aligned.recorded(1)), aligned.rig)
    times_s, x, _ = preprocessing_figure(gap).axes[2].lines[0].get_data_3d()
    inside = np.abs(times_s - 1e-6 * middle_us) < 0.17  # less the half-window of 20 ms and a margin
    assert np.isnan(x[inside]).all()
    assert np.isfinite(x[~inside]).mean() > 0.8


def test_fig_4_of_a_flight_without_an_estimate_says_why(aligned) -> None:
    # Ten events are fewer than any window needs, however thin the object.
    few = [Observation(aligned.recorded(k).events[:10]) for k in range(2)]
    with pytest.raises(SsacError, match=r"no epipolar lines: (too_few_samples|no_common_time)"):
        drawing.epipolar_figure(Chain(few, aligned.rig))
