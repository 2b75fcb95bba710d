"""Baking against sums over dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from cloak_core.core.linear import SparseMap
from cloak_core.core.paint import bake
from cloak_core.core.view import View
from cloak_core.core.visibility.texture import look_up

HEIGHT, WIDTH, FACES = 20, 30, 40


def random_view(seed: int, covered: int = 250) -> View:
    """Pixels of 1 to 4 entries, half of them at an edge; texture coordinates beyond the picture, too."""
    random = np.random.default_rng(seed)
    counts = random.integers(1, 5, covered)
    entries = int(counts.sum())
    numbers = lambda *size: torch.from_numpy(random.uniform(0, 1, size).astype(np.float32))
    coverage = numbers(covered) + 0.01
    return View(
        HEIGHT,
        WIDTH,
        torch.from_numpy(np.sort(random.choice(HEIGHT * WIDTH, covered, replace=False))),
        coverage.where(coverage < 0.5, 1.0).where(torch.arange(covered) % 3 > 0, coverage.clamp(max=1)),
        numbers(covered) * 0.1,
        SparseMap(
            torch.from_numpy(np.concatenate([[0], counts.cumsum()])),
            torch.from_numpy(random.integers(0, FACES, entries)),
            numbers(entries),
            FACES,
        ),
        numbers(2, entries) * 4 - 2,
    )


@pytest.mark.parametrize("logo_share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("textured", [False, True])
@pytest.mark.parametrize("on_cloth", [False, True])
def test_the_logo_and_the_rest_add_up_to_the_view(on_cloth: bool, textured: bool, logo_share: float) -> None:
    random = np.random.default_rng(100)
    view = random_view(3)
    if on_cloth:
        view = replace(view, cloth=torch.from_numpy(random.uniform(0, 1, (4, len(view.map))).astype(np.float32)))
    logo = torch.from_numpy(random.permutation(FACES)[: int(FACES * logo_share)])
    colors = torch.from_numpy(random.uniform(0, 1, (FACES, 3)).astype(np.float32))
    texture = torch.from_numpy(random.integers(0, 256, (7, 11, 3)).astype(np.uint8)) if textured else None
    light = torch.tensor([1.0, 0.6, 0.3])
    baked = bake(view, logo, colors, tuple(light.tolist()), texture)

    worn = torch.isin(view.map.column, logo)
    shown = look_up(texture, view.uv) if textured else colors[view.map.column]
    body = torch.zeros(250, 3).index_add_(0, view.map.row, torch.where(worn, 0, view.map.weight)[:, None] * shown)
    expected = torch.zeros(HEIGHT * WIDTH, 3)
    expected[view.pixels] = (body + view.specular[:, None]) * light
    torch.testing.assert_close(baked.base_color.T, expected[baked.pixels], rtol=0, atol=1e-6)
    matrix = torch.zeros(HEIGHT * WIDTH, FACES).index_put_(
        (view.pixels[view.map.row][worn], view.map.column[worn]), view.map.weight[worn], accumulate=True
    )
    rows = baked.pixels[: baked.map.height]
    worn_map = baked.map @ baked.places.shares
    torch.testing.assert_close(worn_map.matrix.to_dense(), matrix[rows][:, logo], rtol=0, atol=1e-6)
    if on_cloth:
        assert torch.equal(torch.cat([baked.places.at, baked.places.extent]), view.cloth[:, worn])

    assert sorted(baked.pixels.tolist()) == view.pixels.tolist() and baked.map.height == int((matrix.sum(1) > 0).sum())
    edge, inner = baked.coverage[baked.map.height : baked.front_count], baked.coverage[baked.front_count :]
    assert (edge < 1).all() and (inner == 1).all() and ((len(edge) and len(inner)) or logo_share == 1)


def test_an_empty_view_and_its_box() -> None:
    empty = bake(random_view(0, 0), torch.tensor([3]), torch.rand(FACES, 3), (1.0, 1.0, 1.0))
    assert (len(empty.pixels), empty.map.height, empty.front_count, empty.box) == (0, 0, 0, (0, 0, 0, 0))


@pytest.mark.parametrize("seed", range(3))
def test_a_box_holds_the_pixels_half_covered(seed: int) -> None:
    view = random_view(seed, 1 + 9 * seed)
    image = torch.zeros(HEIGHT, WIDTH)
    image.view(-1)[view.pixels] = view.coverage
    rows, columns = ((image >= 0.5).any(axis).nonzero().view(-1).tolist() for axis in (1, 0))
    assert view.box == ((columns[0], rows[0], columns[-1] + 1, rows[-1] + 1) if rows else (0, 0, 0, 0))
