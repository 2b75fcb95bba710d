"""Baking by compiled loops against the torch operations that other devices use."""

import contextlib

import numpy as np
import pytest
import torch

from cloak_core.core.baking import bake, baked_view
from cloak_core.core.linear import SparseMap
from cloak_core.core.paint import compose, true_boxes
from cloak_core.core.view import BakedView, View
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


def made_view(coverage: torch.Tensor | None, **more: object) -> tuple[BakedView, torch.Tensor, torch.Tensor]:
    """A 4 x 6 view of three faces over a random photograph; the view, the photograph and the dense matrix."""
    generator = torch.Generator().manual_seed(0)
    photograph = torch.rand(3, 4, 6, generator=generator)
    pixel, face = torch.tensor([17, 3, 3, 8]), torch.tensor([2, 1, 0, 2])
    weight = torch.tensor([0.5, 0.25, 0.5, 1.5])
    dense = torch.zeros(24, 3).index_put_((pixel, face), weight)
    return baked_view(pixel, face, weight, 3, photograph, coverage, **more), photograph, dense


@pytest.mark.parametrize("plain", [False, True])
def test_a_view_of_plain_tensors_is_composited(plain: bool) -> None:
    """Of any size, with its colours' gradient, over a background where coverage leaves room for one."""
    coverage = torch.ones(4, 6)
    coverage[1, 2:4], coverage[0, 0] = 0.25, 0
    colors, background = torch.rand(3, 3, requires_grad=True), torch.rand(1, 3, 4, 6)
    with torch_alone() if plain else contextlib.nullcontext():
        view, photograph, dense = made_view(coverage)
        image = compose([view], colors, background)
        image.sum().backward()
    body = (dense @ colors).T.view(3, 4, 6) + torch.where(coverage > 0, photograph, 0)
    wanted = (body + (1 - coverage) * background[0]).clamp(0, 1)
    torch.testing.assert_close(image[0], wanted, rtol=0, atol=1e-6)
    inside = (wanted == body + (1 - coverage) * background[0]).view(3, -1).float()
    torch.testing.assert_close(colors.grad, (inside @ dense).T, rtol=0, atol=1e-6)


def test_nothing_is_seen_behind_a_view_that_is_whole() -> None:
    view, photograph, _ = made_view(None, box=(1.5, 0, 5, 4), provenance={"photograph": "a.jpg"})
    image = compose([view, view], torch.zeros(3, 3), torch.rand(2, 3, 4, 6))
    torch.testing.assert_close(image, photograph.expand(2, -1, -1, -1))
    assert view.is_whole
    assert view.box == (1.5, 0, 5, 4) and view.provenance["photograph"] == "a.jpg" and view.map.height == 3
    assert true_boxes([view]).tolist() == [[1.5, 0, 5, 4]]
    mask = torch.zeros(4, 6, dtype=torch.bool)
    mask[1:3, 2:5] = True
    assert made_view(None, mask=mask)[0].box == (2, 1, 5, 3) and made_view(None)[0].box == (0, 0, 6, 4)


def test_entries_out_of_range_are_refused() -> None:
    one = torch.tensor([1])
    with pytest.raises(ValueError, match=r"face: 1 .. 1 is not within 0 \.\. 0"):
        baked_view(one, one, torch.ones(1), 1, torch.zeros(3, 2, 2))
    with pytest.raises(ValueError, match=r"pixel: 1 .. 1 is not within 0 \.\. 0"):
        baked_view(one, one, torch.ones(1), 2, torch.zeros(3, 1, 1))
