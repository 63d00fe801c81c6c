import numpy as np
import pytest
import trimesh

from sim.errors import SimError
from sim.twin.bench import printed, wall


def test_the_model_is_three_by_three_by_one_centimetres() -> None:
    (part,) = printed().parts
    extent_m = np.ptp(part.vertices_B_m, axis=0)
    np.testing.assert_allclose(extent_m, (0.03, 0.03, 0.01), rtol=1e-9)
    np.testing.assert_allclose(part.vertices_B_m.min(0) + part.vertices_B_m.max(0), 0.0, atol=1e-12)


def test_all_its_pieces_are_closed_and_face_outward() -> None:
    (part,) = printed().parts
    mesh = trimesh.Trimesh(part.vertices_B_m, part.faces, process=False)
    for piece in mesh.split(only_watertight=False):
        assert piece.is_watertight
        assert piece.volume > 0.0


def test_a_size_that_is_none_is_refused() -> None:
    with pytest.raises(SimError, match="size must be a positive number of metres, got -1"):
        printed(-1.0)


def test_a_wall_is_its_seeds_and_smoother_the_further_it_is_out_of_focus() -> None:
    sharp, again, soft, other = (
        wall(346, 260, np.random.default_rng(seed), defocus_px)
        for seed, defocus_px in ((1, 0.0), (1, 0.0), (1, 3.0), (2, 0.0))
    )
    np.testing.assert_array_equal(sharp, again)
    assert not np.array_equal(sharp, other)
    assert sharp.shape == (260, 346)
    assert 0.0 < sharp.min() <= sharp.max() < 1.0
    assert np.abs(np.diff(soft, axis=1)).max() < np.abs(np.diff(sharp, axis=1)).max() / 3.0


def test_a_blur_that_is_none_is_refused() -> None:
    with pytest.raises(SimError, match="defocus_px must be 0 or a positive number, got -1"):
        wall(8, 8, np.random.default_rng(0), -1.0)
