"""Frames beside the events of a file: read, refused, and summed up a few at a time."""

import h5py
import numpy as np
import pytest

from ssac.errors import SsacError
from ssac.events import events_from_arrays
from ssac.files import hdf5
from ssac.files.hdf5 import load_frames, save_events_h5

WIDTH, HEIGHT = 346, 260
EVENTS = events_from_arrays(t=[0, 50_000], x=[1, 345], y=[2, 259], p=[True, False])


def _write_frames(path, times_us, images):
    save_events_h5(path, EVENTS, WIDTH, HEIGHT)
    with h5py.File(path, "a") as file:
        file["frames/t"], file["frames/images"] = times_us, images


def test_frames(tmp_path):
    path = tmp_path / "cam1.h5"
    save_events_h5(path, EVENTS, WIDTH, HEIGHT)
    assert load_frames(path) is None
    assert load_frames(tmp_path / "cam1.txt") is None
    images = np.random.default_rng(0).integers(0, 256, (3, HEIGHT, WIDTH)).astype(np.uint8)
    _write_frames(path, [0, 20_000, 40_000], images)
    frames = load_frames(path)
    assert frames is not None
    assert frames[0].dtype == np.int64
    np.testing.assert_array_equal(frames[0], [0, 20_000, 40_000])
    np.testing.assert_array_equal(frames[1], images)


@pytest.mark.parametrize(
    ("times_us", "images", "message"),
    [
        ([0, 1], np.zeros((3, 4, 5), np.uint8), r"got \(3, 4, 5\) uint8 and \(2,\) times"),
        ([0, 1], np.zeros((2, 4, 5)), "as .* uint8"),
        ([1, 1], np.zeros((2, 4, 5), np.uint8), "increasing whole microseconds"),
        ([0.0, 0.1], np.zeros((2, 4, 5), np.uint8), "increasing whole microseconds"),
    ],
)
def test_unusable_frames_are_refused(tmp_path, times_us, images, message):
    _write_frames(tmp_path / "cam1.h5", times_us, images)
    with pytest.raises(SsacError, match=message):
        load_frames(tmp_path / "cam1.h5")


def test_frames_may_be_summed_up_a_few_at_a_time(tmp_path, monkeypatch):
    images = np.random.default_rng(0).integers(0, 256, (23, HEIGHT, WIDTH)).astype(np.uint8)
    path = tmp_path / "cam1.h5"
    save_events_h5(path, EVENTS, WIDTH, HEIGHT)
    with h5py.File(path, "a") as file:
        file["frames/t"] = 20_000 * np.arange(23)
        file.create_dataset("frames/images", data=images, chunks=(4, HEIGHT, WIDTH))
    monkeypatch.setattr(hdf5, "BYTES_PER_BLOCK", 9 * HEIGHT * WIDTH)
    sizes = []

    def largest(some):
        sizes.append(len(some))
        return some.max(axis=(1, 2))

    times_us, summaries = load_frames(path, largest)
    np.testing.assert_array_equal(times_us, 20_000 * np.arange(23))
    np.testing.assert_array_equal(summaries, images.max(axis=(1, 2)))
    assert sizes == [8, 8, 7]  # whole chunks
