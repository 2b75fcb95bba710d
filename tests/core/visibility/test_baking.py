"""Baking by compiled loops against the torch operations that other devices use."""

import numpy as np
import pytest
import torch

from cloak_core.core.baking import bake
from cloak_core.core.linear import SparseMap
from cloak_core.core.view import View
from cloak_core.core.visibility.compiled import torch_alone

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
@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (1.0, 0.6, 0.3)])
@pytest.mark.parametrize("seed", range(3))
def test_loops_equal_operations(seed: int, light: tuple, textured: bool, logo_share: float) -> None:
    random = np.random.default_rng(100 + seed)
    logo = torch.from_numpy(random.permutation(FACES)[: int(FACES * logo_share)])
    colors = torch.from_numpy(random.uniform(0, 1, (FACES, 3)).astype(np.float32))
    texture = torch.from_numpy(random.integers(0, 256, (7, 11, 3)).astype(np.uint8)) if textured else None
    ours = bake(random_view(seed), logo, colors, light, texture)
    with torch_alone():
        theirs = bake(random_view(seed), logo, colors, light, texture)
    for name in ("pixels", "coverage"):
        assert torch.equal(getattr(ours, name), getattr(theirs, name)), name
    for name in ("crow", "column", "weight"):
        assert torch.equal(getattr(ours.map, name), getattr(theirs.map, name)), name
    assert (ours.front_count, ours.box, ours.map.width) == (theirs.front_count, theirs.box, theirs.map.width)
    assert ours.map.height < ours.front_count < len(ours.pixels) or logo_share == 1
    torch.testing.assert_close(ours.base_color, theirs.base_color, rtol=0, atol=1e-6)


def test_an_empty_view_and_its_box() -> None:
    empty = bake(random_view(0, 0), torch.tensor([3]), torch.rand(FACES, 3), (1.0, 1.0, 1.0))
    assert (len(empty.pixels), empty.map.height, empty.front_count, empty.box) == (0, 0, 0, (0, 0, 0, 0))


@pytest.mark.parametrize("seed", range(6))
def test_a_box_holds_the_pixels_half_covered(seed: int) -> None:
    view = random_view(seed, 1 + 3 * seed)
    places = [
        divmod(p, view.width) for p, c in zip(view.pixels.tolist(), view.coverage.tolist(), strict=True) if c >= 0.5
    ]
    rows, columns = zip(*places, strict=True) if places else ((), ())
    expected = (min(columns), min(rows), max(columns) + 1, max(rows) + 1) if places else (0, 0, 0, 0)
    assert view.box == expected
