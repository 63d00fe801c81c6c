import numpy as np
import pytest

from sim.render.lattice import COUNT_BIT, FULL_CODE, MAX_A, Lattice, average_tiles

LATTICES = [*(Lattice(a, 0) for a in (1, 2, 5, 8)), *(Lattice(a, 1) for a in (1, 6, 7, 16, MAX_A))]
IDS = [f"{lattice.a},{lattice.b}" for lattice in LATTICES]
OBJECT = np.uint32(1 << COUNT_BIT)


def samples(lattice, x_px, y_px):
    """Lattice coordinates (n, 2) of a pixel's samples."""
    return lattice.pixel_samples + lattice.A @ [x_px, y_px]


def positions_px(lattice, q):
    """Image positions of samples, by the formula of the vertex shader: q = A p + centre."""
    return np.linalg.solve(lattice.A, (q - lattice.centre).T).T


@pytest.mark.parametrize("lattice", LATTICES, ids=IDS)
def test_every_sample_belongs_to_one_pixel_where_no_two_share_a_row_if_it_is_turned(lattice):
    block = [samples(lattice, x, y) for x in range(-3, 4) for y in range(-3, 4)]
    assert {len(pixel) for pixel in block} == {lattice.a**2 + lattice.b**2}
    owned = np.concatenate(block)
    assert len(np.unique(owned, axis=0)) == len(owned)
    # No sample in the middle of the block is left out.
    reach = np.arange(-4 * lattice.a, 4 * lattice.a + 1)
    everywhere = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2)
    middle = everywhere[np.abs(np.linalg.solve(lattice.A, everywhere.T)).max(axis=0) < 2.0]
    assert {tuple(q) for q in middle} <= {tuple(q) for q in owned}
    for coordinate in positions_px(lattice, samples(lattice, 0, 0)).T if lattice.b else ():
        # Spaced evenly, 1 / (a^2 + 1) px apart; the tolerance is round-off.
        np.testing.assert_allclose(np.diff(np.sort(coordinate)), 1 / len(coordinate), atol=1e-12)


@pytest.mark.parametrize("lattice", LATTICES, ids=IDS)
def test_the_average_of_a_ramp_is_its_value_at_the_pixel_centre(lattice):
    size_px, corner = (6, 5), np.zeros((1, 2), np.int64)
    (origin,) = lattice.tile_origin(*corner.T, size_px[1])
    q = np.stack(np.meshgrid(*map(np.arange, lattice.tile_size(*size_px))), axis=-1) + origin
    x, y = positions_px(lattice, q.reshape(-1, 2)).T.reshape(2, *q.shape[:2])
    ramp = np.clip(0.3 + 0.05 * x + 0.04 * y, 0.0, 1.0)
    atlas = OBJECT + np.rint(ramp * FULL_CODE).astype(np.uint32)
    given = corner, corner, size_px, np.zeros(size_px[::-1], np.float32)
    (got,) = average_tiles(atlas, lattice, *given)
    x, y = np.meshgrid(np.arange(6), np.arange(5))
    (full,) = average_tiles(np.full_like(atlas, OBJECT + FULL_CODE), lattice, *given)
    np.testing.assert_allclose(full, 1.0, rtol=3e-7)  # float32; the finest lattice's fits a word
    # A sample's code is rounded by half a step; float32 adds 1e-7.
    np.testing.assert_allclose(got, 0.3 + 0.05 * x + 0.04 * y, atol=0.5 / FULL_CODE + 2e-7)


@pytest.mark.parametrize("lattice", LATTICES, ids=IDS)
def test_the_average_equals_a_brute_force_sum(lattice):
    rng = np.random.default_rng(1)
    width, height = 7, 4
    tile = np.array(lattice.tile_size(width, height))
    corners = np.array([[0, 0], [3 + tile[0], 5], [2, 9 + tile[1]]])
    atlas_size = corners.max(axis=0) + tile + 3
    codes = rng.integers(0, FULL_CODE + 1, atlas_size[::-1])
    atlas = np.where(rng.random(codes.shape) < 0.6, OBJECT + codes, 0).astype(np.uint32)
    background = rng.random((30, 40)).astype(np.float32)
    corner_px = np.array([[0, 26], [11, 3], [33, 0]])
    got = average_tiles(atlas, lattice, corners, corner_px, (width, height), background)
    origins = lattice.tile_origin(*corner_px.T, height)
    for k, j, i in np.ndindex(3, height, width):
        x, y = corner_px[k] + (i, j)
        u, v = (samples(lattice, x, y) - origins[k] + corners[k]).T
        words = atlas[v, u].astype(np.int64)
        light = np.where(words > 0, (words & (OBJECT - 1)) / FULL_CODE, background[y, x])
        assert got[k, j, i] == pytest.approx(light.mean(), abs=3e-7)  # float32
