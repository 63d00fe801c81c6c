import numpy as np
import pytest

from sim.sensor.frames import FrameConfig, FrameExposer, Frames, frame_times_us

CODE = 1.0 / 255.0


def expose(config, video, times_s, background=None, start_s=0.0):
    still = np.zeros(video.shape[1:], np.float32) if background is None else background
    exposer, frames = exposer_in_memory(config, still, float(times_s[-1]), start_s)
    zero = np.zeros(1, np.int64)
    for time_s, image in zip(times_s, video, strict=True):
        exposer.feed(np.array([time_s]), zero, zero, np.ascontiguousarray(image[None]))
    exposer.finish()
    return frames


def exposer_in_memory(config, background, duration_s, start_s=0.0):
    """Return an exposer and the frames that it fills; no initial value may remain in these."""
    times_us = frame_times_us(config, duration_s, start_s)
    images = np.full((len(times_us), *background.shape), 77, np.uint8)
    exposer = FrameExposer(config, background, len(times_us), images.__setitem__, start_s)
    return exposer, Frames(times_us, images, config.exposure_s)


def uneven_times(n, end_s, seed=0):
    """Instants as adaptive sampling makes them, from 0 to the end."""
    steps = np.random.default_rng(seed).uniform(0.1, 3.0, n - 1)
    return np.concatenate([[0.0], np.cumsum(steps) / steps.sum() * end_s])


@pytest.mark.parametrize("n", [2, 30, 1000])
@pytest.mark.parametrize(
    ("exposure_s", "start_s"), [(0.001, 0.0), (0.013, 0.0), (0.013, 0.0123), (0.02, 0.0)]
)
def test_linear_light_is_integrated_exactly(n, exposure_s, start_s):
    """The mean of linear light over an exposure is the light at its middle, for any instants."""
    times_s = uneven_times(n, 0.5)
    start, slope = np.array([[0.1, 0.9, 0.5]]), np.array([[1.5, -1.6, 0.0]])
    video = (start + slope * times_s[:, None, None]).astype(np.float32)
    background = np.full((1, 3), 0.3, np.float32)
    frames = expose(FrameConfig(50.0, exposure_s), video, times_s, background, start_s)
    n_frames = 24 if start_s else 25
    assert frames.images.shape == (n_frames, 1, 3)
    middle_s = start_s + np.arange(n_frames) / 50.0 + exposure_s / 2
    np.testing.assert_array_equal(frames.times_us, np.rint(1e6 * middle_s))
    expected = start + slope * middle_s[:, None, None]
    # Images are rounded to half a code; float32 sums of up to 50 terms may tip that over.
    np.testing.assert_allclose(frames.images * CODE, expected, atol=0.5 * CODE + 1e-5)


@pytest.mark.parametrize(
    ("config", "duration_s", "n"),
    [
        *((FrameConfig(50.0, 0.005), duration_s, n) for duration_s, n in (
            (0.0049, 0), (0.005, 1), (0.0249, 1), (0.025, 2), (1.0, 50), (20.0, 1000)
        )),
        # Exposures without gaps between them, the last of which may end with the recording.
        *((FrameConfig(rate_hz, 1.0 / rate_hz), 2.0, int(2.0 * rate_hz + 1e-6))
          for rate_hz in (3.0, 7.0, 30.0, 60.0, 1000.0 / 3.0)),
        (FrameConfig(0.0), 2.0, 0),
    ],
)  # fmt: skip
def test_only_whole_exposures_become_frames(config, duration_s, n):
    frames = expose(config, np.full((2, 4, 5), 0.5, np.float32), np.array([0.0, duration_s]))
    assert frames.times_us.shape == (n,)
    assert frames.images.shape == (n, 4, 5)
    assert (frames.images == 128).all()


def test_crops_and_gaps_show_the_background():
    """Crops are as the renderer's: of several sizes, and none while the drone is out of view."""
    n, height, width = 160, 20, 25
    background = np.random.default_rng(3).random((height, width)).astype(np.float32)
    times_s = uneven_times(n, 0.4, seed=4)
    video = np.repeat(background[None], n, axis=0)
    for k in (*range(20, 60), *range(110, 150)):
        video[k, 4 + k % 7 : 12, 3 + k % 9 : 18] = 0.1
    whole = expose(FrameConfig(50.0, 0.012), video, times_s, background)
    exposer, cropped = exposer_in_memory(FrameConfig(50.0, 0.012), background, 0.4)
    near = [k for k in range(n) if (video[max(k - 1, 0) : k + 2] != background).any()]
    batches = np.split(near, [11, 12, 42, 70])
    boxes = [(0, 0, 25, 20), (3, 4, 18, 12), (2, 3, 20, 12), (3, 4, 18, 13), (3, 4, 19, 12)]
    for batch, (x0, y0, x1, y1) in zip(batches, boxes, strict=True):
        crops = np.ascontiguousarray(video[batch, y0:y1, x0:x1])
        exposer.feed(times_s[batch], np.full(len(batch), x0), np.full(len(batch), y0), crops)
    exposer.finish()
    # The float32 sums have other terms, so a value near half a code may round the other way.
    difference = np.abs(cropped.images.astype(int) - whole.images)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 1e-3
    first_us, last_us = 1e6 * times_s[61] + 6000, 1e6 * times_s[108] - 6000
    away = (whole.times_us > first_us) & (whole.times_us < last_us)
    assert away.any()
    assert (cropped.images[away] == np.rint(background * 255)).all()
