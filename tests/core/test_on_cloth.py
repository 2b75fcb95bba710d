"""A cloth on a logo: what its faces show of it, and training one."""

import numpy as np
import pytest
import torch
from PIL import Image

from cloak_core.core.places import Places
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.patterns.footprint import MOST_SQUARES, squares_under
from tests.core.fakes import box_bodies, front_logo
from tests.core.test_training import run


def test_a_face_shows_the_mean_of_the_squares_on_it():
    checkers = np.indices((2, 2)).sum(axis=0).reshape(-1, 1).astype(np.float32) % 2 * np.ones(3, np.float32)
    # On the corner of four, within one, beside it, a tile and a half away, and bare.
    at = torch.tensor([[0.5, 0.25, 0.75, -1.25, 0.75], [0.5, 0.25, 0.25, 1.75, 0.25]])
    places = Places.on_cloth(torch.tensor([0, 0, 0, 0, -1]), torch.cat([at, torch.full_like(at, 0.4)]), 1)
    shown = ClothPattern(front_logo(box_bodies()), Grid(1.0, 2, 2)).map(places).apply(torch.from_numpy(checkers))
    assert torch.allclose(shown[:, 0], torch.tensor([0.5, 0.0, 1.0, 0.0, 0.0]))


def test_loops_and_torch_find_the_same_squares_under_footprints():
    """Points, parts of a square, more squares than are visited one by one, far beyond the cloth, and bare places."""
    random = torch.Generator().manual_seed(0)
    at = 6 * torch.rand(2, 200, generator=random) - 3
    extent = 10 ** (4 * torch.rand(2, 200, generator=random) - 4) * (torch.arange(200) % 9 > 0)
    is_worn = torch.arange(200) % 7 > 0
    ours = squares_under(at, extent, is_worn, 0.05, 6, 4)
    with torch_alone():
        theirs = squares_under(at, extent, is_worn, 0.05, 6, 4)
    assert torch.equal(ours.crow, theirs.crow) and torch.equal(ours.column, theirs.column)
    torch.testing.assert_close(ours.weight, theirs.weight, rtol=0, atol=1e-6)
    torch.testing.assert_close(ours.apply(torch.ones(24, 1))[:, 0], is_worn.float(), rtol=0, atol=1e-5)
    assert (ours.weight >= 0).all() and int(ours.crow.diff().max()) == MOST_SQUARES**2


@pytest.mark.slow
@pytest.mark.parametrize("inks", [None, 2])
def test_a_trained_cloth_is_what_its_faces_show(tmp_path, inks):
    chosen = {"pattern": "tile", "tile_cm": 50, "feature_cm": 25, "colors_at_most": inks}
    result = run(tmp_path / "run", steps=3, batch=2, **chosen)
    printed = np.asarray(Image.open(tmp_path / "run" / "cloth.png")).reshape(-1, 3) / np.float32(255)
    cloth = ClothPattern(front_logo(box_bodies()), Grid.of(0.5, 0.25), bodies=box_bodies())
    shown = cloth.on_faces(printed, is_exact=inks is not None)
    assert np.allclose(result.colors, shown, atol=0.51 / 255)
    assert len(np.unique(result.colors, axis=0)) <= (inks or 16**2)
    assert np.abs(result.colors - 0.5).max() > 1e-4
