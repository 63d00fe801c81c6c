"""The lattice of point samples that each pixel averages.

A regular grid of n x n samples per pixel sees an edge along the pixel rows in n steps only, and
each step of a slowly moving edge is a burst of spurious events. Turning the grid by atan(b / a)
makes it a rank-1 lattice: with the integer matrix A = [[a, -b], [b, a]] the samples of the image
are the points p [px] for which q = A p is an integer. Every pixel holds exactly a^2 + b^2 of them,
and with b = 1 no two of a pixel share a row or a column. To a rasteriser q is a plain grid.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.arrays import Float32Array, FloatArray, IntArray
from sim.errors import SimError

# A sample word is 0 where the sample sees the background, and COUNT + the luminance's code where it
# sees the object, so a sum of words holds both the sum of codes and the number of object samples.
FULL_CODE = 65535  # code of luminance 1
COUNT_BIT = 26  # lowest bit of the count: a sum of 31^2 + 1 codes needs 26 bits
MAX_A = 31
LANES = 16  # samples that the native renderer draws, or sums, at a time


@dataclass(frozen=True)
class Lattice:
    """Sample positions of a pixel: all p with A p integer, A = [[a, -b], [b, a]].

    `Lattice(8, 0)` is the regular 8 x 8 grid, `Lattice(8, 1)` a rank-1 lattice of 65 samples.
    """

    a: int
    b: int

    def __post_init__(self) -> None:
        if not (1 <= self.a <= MAX_A and 0 <= self.b <= 1):
            raise SimError(
                f"supersampling lattice: expected 1 <= a <= {MAX_A} and b = 0 or 1, "
                f"got a = {self.a}, b = {self.b}; (8, 1) gives 65 samples per pixel"
            )

    @property
    def samples_per_pixel(self) -> int:
        """Number of samples that each pixel averages, a^2 + b^2."""
        return self.a**2 + self.b**2

    @property
    def A(self) -> IntArray:  # noqa: N802
        """Matrix (2, 2) from pixel to lattice coordinates."""
        return np.array([[self.a, -self.b], [self.b, self.a]])

    @cached_property
    def pixel_samples(self) -> IntArray:
        """Samples (n, 2) of the pixel at the origin, column by column."""
        reach = np.arange(-self.a - self.b, self.a + self.b + 1)
        q = np.stack(np.meshgrid(reach, reach, indexing="ij"), axis=-1).reshape(-1, 2)
        # p = A^-1 q = A' q / n; a pixel is -1/2 <= p < 1/2, tested in integers.
        n, twice_n_p = self.samples_per_pixel, 2 * (q @ self.A)
        return q[np.all((twice_n_p >= -n) & (twice_n_p < n), axis=-1)]

    @cached_property
    def centre(self) -> FloatArray:
        """Mean lattice position (2,) of a pixel's samples, where the pixel's centre must lie."""
        mean: FloatArray = self.pixel_samples.mean(axis=0)
        return mean

    def tile_size(self, width_px: int, height_px: int) -> tuple[int, int]:
        """Lattice (width, height) of the smallest tile that holds a crop of whole pixels."""
        steps = np.abs(self.A) @ [width_px - 1, height_px - 1]
        width, height = steps + np.ptp(self.pixel_samples, axis=0) + 1
        return int(width), int(height)

    def tile_origin(self, corner_px: IntArray, height_px: int) -> IntArray:
        """Lattice coordinates (..., 2) of the first sample of tiles whose crops start there."""
        first = self.pixel_samples.min(axis=0) - np.array([self.b * (height_px - 1), 0])
        origin: IntArray = corner_px @ self.A.T + first
        return origin


def average_tiles(
    atlas: NDArray[np.uint32],
    lattice: Lattice,
    corners: IntArray,
    corner_px: IntArray,
    size_px: tuple[int, int],
    background: Float32Array,
) -> Float32Array:
    """Average the samples of each pixel of n crops (n, height, width), over the background.

    The crops, of `size_px`, width and height, start at `corner_px` (n, 2) of the image; their tiles
    start at `corners` (n, 2), column and row, of an atlas of sample words.
    """
    width, height = size_px
    luminance = np.empty((len(corners), height, width), np.float32)
    # Where samples of a tile's first pixel lie in the flat atlas, and those of the next pixels.
    flat, stride = atlas.ravel(), np.array([1, atlas.shape[1]])
    origin = lattice.tile_origin(np.zeros(2, np.int64), height)
    samples, (right, down) = (lattice.pixel_samples - origin) @ stride, lattice.A.T @ stride
    for image, corner, (x0, y0) in zip(luminance, corners, corner_px, strict=True):
        at = samples + corner @ stride
        _average_tile(flat, at, right, down, background[y0:, x0:], image)
    return luminance


@lru_cache(maxsize=64)
def runs_of_tile(
    lattice: Lattice, size_px: tuple[int, int]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Find the runs of samples, along the rows of a crop's tile, that belong to one pixel.

    Returns the run of each sample, row by row; the first sample of each run, then the number of
    samples; and each run's pixel, width * row + column, or width * height outside all pixels.
    """
    width, height = size_px
    v, u = np.indices(lattice.tile_size(width, height)[::-1])
    q = np.stack([u, v], axis=-1) + lattice.tile_origin(np.zeros(2, np.int64), height)
    # As in `pixel_samples`, rounded to the nearest pixel's centre.
    n = lattice.samples_per_pixel
    column, row = np.moveaxis((2 * (q @ lattice.A) + n) // (2 * n), -1, 0)
    is_inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    pixel_of = np.where(is_inside, width * row + column, width * height).astype(np.int32)
    is_first = np.ones(pixel_of.shape, np.bool_)
    is_first[:, 1:] = pixel_of[:, 1:] != pixel_of[:, :-1]
    start = np.flatnonzero(is_first)
    run_of = np.cumsum(is_first.ravel(), dtype=np.int32) - np.int32(1)
    return run_of, np.append(start, pixel_of.size).astype(np.int32), pixel_of.ravel()[start]


@njit(cache=True, nogil=True)
def _average_tile(words, samples, right, down, background, image):
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            total = np.int64(0)
            for sample in samples:
                total += np.int64(words[sample + right * i + down * j])
            image[j, i] = _mixed(total, samples.size, background[j, i])


@njit(cache=True, nogil=True)
def _mixed(total, n_samples, background):
    """Turn a pixel's sum of words into luminance, over the background."""
    n, scale = np.float32(n_samples), np.float32(1.0 / (FULL_CODE * n_samples))
    codes = total & ((np.int64(1) << COUNT_BIT) - 1)
    # Divided, not scaled: where there is no object this is the background, bit for bit.
    share = (n - np.float32(total >> COUNT_BIT)) / n
    return np.float32(codes) * scale + share * background


@njit(cache=True, nogil=True)
def sum_runs(keys, touched, width, height, run_of, run_start, run_pixel, sums):
    """Add each sample's word to its pixel's sum, and clear the keys that were drawn."""
    for v in range(height):
        low, high = touched[v, 0], touched[v, 1]
        if low > high:
            continue
        touched[v, 0], touched[v, 1] = width, -1
        low, high = low + v * width, high + v * width
        for run in range(np.uint64(run_of[low]), np.uint64(run_of[high] + 1)):
            start = np.int64(run_start[run])
            n = run_start[run + np.uint64(1)] - start
            total = np.int64(0)
            # The count is rounded up to whole LANES, which the processor does at a time.
            for lane in range((n + (LANES - 1)) & -LANES):
                word = keys[np.uint64(start + lane)] & 0xFFFFFFFF
                total += word if lane < n else np.int64(0)
            sums[np.uint64(run_pixel[run])] += total
        keys[low : high + 1] = 0


@njit(cache=True, nogil=True)
def average_block(sums, width, n_samples, background, image):
    """Turn sums of words into luminance, over the background, and clear the sums."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            image[j, i] = _mixed(sums[j * width + i], n_samples, background[j, i])
    sums[:] = 0
