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
    def pixel_columns(self) -> IntArray:
        """The pixel's samples by lattice columns, (n, 3): column, first row, row after the last."""
        u, v = self.pixel_samples.T
        column, start, count = np.unique(u, return_index=True, return_counts=True)
        return np.stack([column, v[start], v[start] + count], axis=-1)

    @cached_property
    def centre(self) -> FloatArray:
        """Mean lattice position (2,) of a pixel's samples, where the pixel's centre must lie."""
        mean: FloatArray = self.pixel_samples.mean(axis=0)
        return mean

    def tile_size(self, width_px: int, height_px: int) -> tuple[int, int]:
        """Lattice (width, height) of the smallest tile that holds a crop of whole pixels."""
        columns = self.pixel_columns
        pixel_width = int(columns[-1, 0] - columns[0, 0]) + 1
        pixel_height = int(columns[:, 2].max() - columns[:, 1].min())
        return (
            self.a * (width_px - 1) + self.b * (height_px - 1) + pixel_width,
            self.b * (width_px - 1) + self.a * (height_px - 1) + pixel_height,
        )

    def tile_origin(self, x0_px: IntArray, y0_px: IntArray, height_px: int) -> IntArray:
        """Lattice coordinates (n, 2) of the first sample of tiles whose crops start at (x0, y0)."""
        columns = self.pixel_columns
        u0 = self.a * x0_px - self.b * (y0_px + height_px - 1) + columns[0, 0]
        v0 = self.b * x0_px + self.a * y0_px + columns[:, 1].min()
        return np.stack([u0, v0], axis=-1)


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
    columns, n_samples = _columns_in_tile(lattice, height), lattice.samples_per_pixel
    for image, (column, row), (x0, y0) in zip(luminance, corners, corner_px, strict=True):
        tile, behind = atlas[row:, column:], background[y0:, x0:]
        _average_tile(tile, columns, lattice.a, lattice.b, n_samples, behind, image)
    return luminance


def _columns_in_tile(lattice: Lattice, height_px: int) -> IntArray:
    """Return `pixel_columns` of the first pixel of a tile, counted from the tile's corner."""
    u0, v0 = lattice.tile_origin(np.array(0), np.array(0), height_px)
    columns: IntArray = lattice.pixel_columns - np.array([u0, v0, v0])
    return columns


@lru_cache(maxsize=64)
def runs_of_tile(
    lattice: Lattice, size_px: tuple[int, int]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Find the runs of samples, along the rows of a crop's tile, that belong to one pixel.

    Returns the run of each sample, row by row; the first sample of each run, then the number of
    samples; and each run's pixel, width * row + column, or width * height outside all pixels.
    """
    width, height = size_px
    pixel_of = np.full(lattice.tile_size(width, height)[::-1], width * height, np.int32)
    columns = _columns_in_tile(lattice, height)
    _number_samples(columns, lattice.a, lattice.b, width, height, pixel_of)
    is_first = np.ones(pixel_of.shape, np.bool_)
    is_first[:, 1:] = pixel_of[:, 1:] != pixel_of[:, :-1]
    start = np.flatnonzero(is_first)
    run_of = np.cumsum(is_first.ravel(), dtype=np.int32) - np.int32(1)
    return run_of, np.append(start, pixel_of.size).astype(np.int32), pixel_of.ravel()[start]


@njit(cache=True, nogil=True)
def _number_samples(columns, a, b, width, height, pixel_of):
    """Write each pixel's number at its samples, given those of the first pixel of the tile."""
    for j in range(height):
        for i in range(width):
            for c in range(columns.shape[0]):
                u = columns[c, 0] + a * i - b * j
                for v in range(columns[c, 1] + b * i + a * j, columns[c, 2] + b * i + a * j):
                    pixel_of[v, u] = width * j + i


@njit(cache=True, nogil=True)
def _average_tile(tile, columns, a, b, n_samples, background, luminance):
    for j in range(luminance.shape[0]):
        for i in range(luminance.shape[1]):
            total = np.int64(0)
            for c in range(columns.shape[0]):
                u = columns[c, 0] + a * i - b * j
                for v in range(columns[c, 1] + b * i + a * j, columns[c, 2] + b * i + a * j):
                    total += np.int64(tile[v, u])
            luminance[j, i] = _mixed(total, n_samples, background[j, i])


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
        here, end = v * width + low, v * width + high + 1
        run = np.uint64(run_of[np.uint64(here)])
        while here < end:
            stop = min(np.int64(run_start[run + np.uint64(1)]), end)
            n = stop - here
            total = np.int64(0)
            # The count is rounded up to whole LANES, which the processor does at a time.
            for lane in range((n + (LANES - 1)) & -LANES):
                word = keys[np.uint64(here + lane)] & 0xFFFFFFFF
                total += word if lane < n else np.int64(0)
            sums[np.uint64(run_pixel[run])] += total
            run += np.uint64(1)
            here = stop
        for at in range(np.uint64(v * width + low), np.uint64(end)):
            keys[at] = 0


@njit(cache=True, nogil=True)
def average_block(sums, width, n_samples, background, image):
    """Turn sums of words into luminance, over the background, and clear the sums."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            image[j, i] = _mixed(sums[j * width + i], n_samples, background[j, i])
    sums[:] = 0
