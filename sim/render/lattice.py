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
FULL_CODE = 65535  # of luminance 1
COUNT_BIT = 21
GL_MAX_A = 16  # codes down a pixel's column must add up to less than 2^COUNT_BIT
WORD_COUNT_BIT = 26  # as COUNT_BIT in the native renderer's words: of 257 codes it needs 25 bits
LANES = 16  # samples that the native renderer draws, or sums, at a time
MAX_A = 31  # codes of a pixel must add up to less than the native renderer's 2^26


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
    def pixel_columns(self) -> IntArray:
        """Samples of the pixel at the origin, by lattice columns, (n_columns, 3).

        A row is a column, its first lattice row, and one past its last.
        """
        reach = np.arange(-self.a - self.b, self.a + self.b + 1)
        q = np.stack(np.meshgrid(reach, reach, indexing="ij"), axis=-1)
        n = self.samples_per_pixel
        # p = A^-1 q = A' q / n; a pixel is -1/2 <= p < 1/2, tested in integers.
        twice_n_p = 2 * (q @ self.A)
        inside = np.all((twice_n_p >= -n) & (twice_n_p < n), axis=-1)
        used = np.flatnonzero(inside.any(axis=1))
        first = inside[used].argmax(axis=1)
        return np.stack(
            [reach[used], reach[first], reach[first] + inside[used].sum(axis=1)], axis=-1
        )

    @cached_property
    def centre(self) -> FloatArray:
        """Mean lattice position (2,) of a pixel's samples: where its own centre must lie."""
        columns = self.pixel_columns
        counts = columns[:, 2] - columns[:, 1]
        mean_u = float((columns[:, 0] * counts).sum()) / self.samples_per_pixel
        middle_v = (columns[:, 1] + columns[:, 2] - 1) / 2
        return np.array([mean_u, float((middle_v * counts).sum()) / self.samples_per_pixel])

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


def average_pixels(
    atlas: NDArray[np.uint32],
    lattice: Lattice,
    corners: IntArray,
    x0_px: IntArray,
    y0_px: IntArray,
    size_px: tuple[int, int],
    background: Float32Array,
) -> Float32Array:
    """Average the samples of every pixel of every tile of an atlas, over the background.

    Parameters
    ----------
    atlas
        Sample words, shape (atlas height, atlas width).
    corners
        Atlas column and row at which each tile starts, shape (n, 2).
    x0_px, y0_px
        Image column and row at which each tile's crop starts, shape (n,) [px].
    size_px
        Width and height of the crops [px].

    Returns
    -------
    Float32Array
        Luminance of the crops, shape (n, height, width).
    """
    width, height = size_px
    tile_width, tile_height = lattice.tile_size(width, height)
    columns = lattice.pixel_columns
    u0, v0 = lattice.tile_origin(np.array(0), np.array(0), height)
    luminance = np.empty((len(corners), height, width), np.float32)
    # Positions below are indices into the flattened sums of one tile.
    first, last = (columns[:, row] * tile_width + columns[:, 0] for row in (1, 2))
    origin = -int(v0) * tile_width - int(u0)
    steps = (lattice.b * tile_width + lattice.a, lattice.a * tile_width - lattice.b)
    sums = np.empty((tile_height + 1) * tile_width, np.uint32)
    for k, (column, row) in enumerate(corners):
        _sum_down(atlas[row : row + tile_height, column : column + tile_width], sums)
        behind = background[y0_px[k] :, x0_px[k] :]
        about = (first, last, origin, *steps, lattice.samples_per_pixel)
        _average_tile(sums, *about, behind, luminance[k])
    return luminance


@lru_cache(maxsize=64)
def runs_of_tile(
    lattice: Lattice, size_px: tuple[int, int]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Say which runs of samples along the rows of a crop's tile belong to one pixel.

    Returns the run of each sample, row by row; the first sample of each run, and one past the last
    run's; and the pixel of each run, numbered as by `pixels_of_tile`.
    """
    pixel_of = pixels_of_tile(lattice, size_px)
    is_first = np.ones(pixel_of.shape, np.bool_)
    is_first[:, 1:] = pixel_of[:, 1:] != pixel_of[:, :-1]
    start = np.flatnonzero(is_first)
    run_of = np.cumsum(is_first.ravel(), dtype=np.int32) - np.int32(1)
    return run_of, np.append(start, pixel_of.size).astype(np.int32), pixel_of.ravel()[start]


def pixels_of_tile(lattice: Lattice, size_px: tuple[int, int]) -> NDArray[np.int32]:
    """Say which pixel of a crop each sample of its tile (tile height, tile width) belongs to.

    A pixel's number is width times row plus column; width times height is that of no pixel.
    """
    width, height = size_px
    tile_width, tile_height = lattice.tile_size(width, height)
    pixel_of = np.full((tile_height, tile_width), width * height, np.int32)
    u0, v0 = lattice.tile_origin(np.array(0), np.array(0), height)
    columns = lattice.pixel_columns - np.array([u0, v0, v0])
    _number_samples(columns, lattice.a, lattice.b, width, height, pixel_of)
    return pixel_of


@njit(cache=True, nogil=True)
def _number_samples(columns, a, b, width, height, pixel_of):  # type: ignore[no-untyped-def]
    """Write each pixel's number at its samples, given those of the first pixel of the tile."""
    for j in range(height):
        for i in range(width):
            for c in range(columns.shape[0]):
                u = columns[c, 0] + a * i - b * j
                for v in range(columns[c, 1] + b * i + a * j, columns[c, 2] + b * i + a * j):
                    pixel_of[v, u] = width * j + i


@njit(cache=True, nogil=True)
def _sum_down(tile, sums):  # type: ignore[no-untyped-def]
    """Fill `sums` (height + 1, width) with the running sums of words down each column."""
    # They wrap around, but the difference of two of them, over the few rows of a pixel, is exact.
    height, width = tile.shape
    sums[:width] = 0
    for v in range(height):
        above = sums[v * width : (v + 1) * width]
        below = sums[(v + 1) * width : (v + 2) * width]
        samples = tile[v]
        for u in range(width):
            below[u] = above[u] + samples[u]


@njit(cache=True, nogil=True)
def _average_tile(  # type: ignore[no-untyped-def]
    sums, first, last, origin, step_x, step_y, n_samples, background, luminance
):
    height, width = luminance.shape
    code_mask = np.uint32((1 << COUNT_BIT) - 1)
    code_scale = np.float32(1.0 / (FULL_CODE * n_samples))
    n = np.float32(n_samples)
    for j in range(height):
        for i in range(width):
            at = origin + i * step_x + j * step_y
            codes = np.uint32(0)
            seen = np.uint32(0)
            for c in range(first.size):
                run = np.uint32(sums[np.uint64(at + last[c])] - sums[np.uint64(at + first[c])])
                codes += run & code_mask
                seen += run >> np.uint32(COUNT_BIT)
            # Divided, not scaled: where there is no object this is the background, bit for bit.
            share = (n - np.float32(seen)) / n
            luminance[j, i] = np.float32(codes) * code_scale + share * background[j, i]


@njit(cache=True, nogil=True)
def sum_runs(  # type: ignore[no-untyped-def]
    keys, touched, width, height, run_of, run_start, run_pixel, sums
):
    """Add each sample's word to its pixel's sum, and empty the keys that were drawn."""
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
            # So many that the processor does LANES at a time, and none is left over.
            for lane in range((n + (LANES - 1)) & -LANES):
                word = keys[np.uint64(here + lane)] & 0xFFFFFFFF
                total += word if lane < n else np.int64(0)
            sums[np.uint64(run_pixel[run])] += total
            run += np.uint64(1)
            here = stop
        for at in range(np.uint64(v * width + low), np.uint64(end)):
            keys[at] = 0


@njit(cache=True, nogil=True)
def average_block(sums, width, n_samples, background, image):  # type: ignore[no-untyped-def]
    """Turn sums of words into luminance, over the background."""
    scale = np.float32(1.0 / (FULL_CODE * n_samples))
    n = np.float32(n_samples)
    code_mask = (np.int64(1) << WORD_COUNT_BIT) - 1
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            total = sums[j * width + i]
            # Divided, not scaled: where there is no object this is the background, bit for bit.
            share = (n - np.float32(total >> WORD_COUNT_BIT)) / n
            image[j, i] = np.float32(total & code_mask) * scale + share * background[j, i]
    sums[:] = 0
