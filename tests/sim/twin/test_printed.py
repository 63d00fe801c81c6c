import numpy as np
import pytest
import trimesh

import sim.twin.bench
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


def test_a_wall_is_its_seeds_and_smoother_the_further_it_is_out_of_focus(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    soft, again, other = (wall(346, 260, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(soft, again)
    assert not np.array_equal(soft, other)
    monkeypatch.setattr(sim.twin.bench, "DEFOCUS_PX", 0.3)  # next to no neighbour has a share
    sharp = wall(346, 260, np.random.default_rng(1))
    assert sharp.shape == (260, 346)
    assert 0.0 < sharp.min() <= sharp.max() < 1.0
    assert np.abs(np.diff(soft, axis=1)).max() < np.abs(np.diff(sharp, axis=1)).max() / 3.0
