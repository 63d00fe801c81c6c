import numpy as np
import pytest

from sim.render.lattice import COUNT_BIT, FULL_CODE, MAX_A, Lattice, average_tiles

LATTICES = [*(Lattice(a, 0) for a in (1, 2, 5, 8)), *(Lattice(a, 1) for a in (1, 6, 7, 16, MAX_A))]
OBJECT = np.uint32(1 << COUNT_BIT)


def samples(lattice, x_px, y_px):
    """Lattice coordinates (n, 2) of a pixel's samples."""
    return lattice.pixel_samples + lattice.A @ [x_px, y_px]


@pytest.mark.parametrize("lattice", LATTICES, ids=str)
def test_every_sample_belongs_to_the_pixel_around_it_and_no_two_share_a_row(lattice):
    block = [samples(lattice, x, y) for x in range(-3, 4) for y in range(-3, 4)]
    assert {len(pixel) for pixel in block} == {lattice.a**2 + lattice.b**2}
    owned = np.concatenate(block)
    assert len(np.unique(owned, axis=0)) == len(owned)
    # No sample in the middle of the block is left out.
    reach = np.arange(-4 * lattice.a, 4 * lattice.a + 1)
    everywhere = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2)
    middle = everywhere[np.abs(np.linalg.solve(lattice.A, everywhere.T)).max(axis=0) < 2.0]
    assert {tuple(q) for q in middle} <= {tuple(q) for q in owned}
    # The vertex shader puts a place p [px] at q = A p + centre. Both tolerances are round-off.
    positions_px = np.linalg.solve(lattice.A, (samples(lattice, 0, 0) - lattice.centre).T)
    np.testing.assert_allclose(positions_px.mean(axis=1), 0.0, atol=1e-12)
    for coordinate in positions_px if lattice.b else ():  # spaced evenly, 1 / (a^2 + 1) px apart
        np.testing.assert_allclose(np.diff(np.sort(coordinate)), 1 / len(coordinate), atol=1e-12)


@pytest.mark.parametrize("lattice", LATTICES, ids=str)
def test_the_average_equals_a_brute_force_sum(lattice):
    rng = np.random.default_rng(1)
    width, height = 7, 4
    tile = np.array(lattice.tile_size(width, height))
    corners = np.array([[0, 0], [3 + tile[0], 5], [2, 9 + tile[1]]])
    codes = rng.integers(0, FULL_CODE + 1, (corners.max(axis=0) + tile + 3)[::-1])
    atlas = np.where(rng.random(codes.shape) < 0.6, OBJECT + codes, 0).astype(np.uint32)
    background = rng.random((30, 40)).astype(np.float32)
    corner_px = np.array([[0, 26], [11, 3], [33, 0]])
    tiles = corners, corner_px, (width, height), background
    full = average_tiles(np.full_like(atlas, OBJECT + FULL_CODE), lattice, *tiles)
    np.testing.assert_allclose(full, 1.0, rtol=3e-7)  # float32; the finest lattice's fits a word
    got = average_tiles(atlas, lattice, *tiles)
    origins = lattice.tile_origin(corner_px, height)
    for k, j, i in np.ndindex(3, height, width):
        x, y = corner_px[k] + (i, j)
        u, v = (samples(lattice, x, y) - origins[k] + corners[k]).T
        words = atlas[v, u].astype(np.int64)
        light = np.where(words > 0, (words & (OBJECT - 1)) / FULL_CODE, background[y, x])
        assert got[k, j, i] == pytest.approx(light.mean(), abs=3e-7)  # float32
