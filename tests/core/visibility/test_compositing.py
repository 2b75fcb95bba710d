"""Dressed views before backgrounds: against a plain rendering in numpy, and the gradient against differences."""

import dataclasses

import numpy as np
import pytest
import torch
from bodies_made import sphere

from cloak_core.core.cameras import Camera
from cloak_core.core.paint import blank, compose, lay_backdrop, pixels_of, true_boxes
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.sources.bodies.view_cache import ViewCache

CAMERA = Camera(distance=4.0, width=40, height=30)
LOGO = np.arange(20, 90)


@pytest.fixture(scope="module")
def views() -> list:
    cache = ViewCache(sphere(), RenderSettings(samples=4))
    cameras = [dataclasses.replace(CAMERA, azimuth=float(a)) for a in (60, 20, 100)]
    return [cache.bake(0, camera, LOGO, outfit=i % 2) for i, camera in enumerate(cameras)]


def scene(seed: int = 0, low: float = 0.0, high: float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    colors = torch.rand(len(LOGO), 3, generator=generator) * (high - low) + low
    return colors, torch.rand(3, 3, 30, 40, generator=generator)


def plain(view, colors, background, shift=(0, 0)) -> np.ndarray:
    """One pixel after the other."""
    image = background.numpy().copy()
    row = view.map.row.numpy()
    body = view.base_color.T.numpy().astype(np.float64).copy()
    np.add.at(body, row, view.map.weight.numpy()[:, None] * colors.detach().numpy()[view.map.column.numpy()])
    for pixel, value, coverage in zip(view.pixels.tolist(), body, view.coverage.tolist(), strict=True):
        y, x = pixel // 40 + shift[1], pixel % 40 + shift[0]
        if 0 <= x < 40 and 0 <= y < 30:
            image[:, y, x] = np.clip(value + (1 - coverage) * background.numpy()[:, y, x], 0, 1)
    return image


@pytest.mark.parametrize("shifts", [None, [(0, 0), (3, -2), (-7, 5)], [(50, 50), (-50, 0), (0, -200)]])
@pytest.mark.parametrize("count", [1, 3])
def test_images_equal_a_plain_rendering(views, shifts, count: int) -> None:
    colors, backgrounds = scene()
    moved = None if shifts is None else torch.tensor(shifts)[:count]
    images = compose(views[:count], colors, backgrounds[:count], moved)
    for i in range(count):
        expected = plain(views[i], colors, backgrounds[i], shifts[i] if shifts else (0, 0))
        np.testing.assert_allclose(images[i].numpy(), expected, atol=2e-6)


@pytest.mark.parametrize("count", [1, 3])
def test_gradient_equals_differences(views, count: int) -> None:
    """Sums stay within (0, 1) here, so that the image is linear and differences are exact up to rounding."""
    colors, backgrounds = scene(1, 0.3, 0.5)
    shifts = torch.tensor([[2, 1], [0, -9], [-3, 4]])[:count]
    upstream = torch.rand(count, 3, 30, 40, generator=torch.Generator().manual_seed(2))
    render = lambda c: compose(views[:count], c, backgrounds[:count] * 0.5, shifts)
    colors.requires_grad_()
    render(colors).backward(upstream)
    direction = torch.randn(colors.shape, generator=torch.Generator().manual_seed(3)) * 0.05
    difference = (render(colors.detach() + direction) - render(colors.detach() - direction)) * upstream
    np.testing.assert_allclose(
        float((colors.grad * direction).sum()), float(difference.double().sum() / 2), rtol=1e-4, atol=1e-5
    )
    assert float(difference.abs().sum()) > 0.4


def test_clamped_sums_pass_no_gradient_and_bounds_do(views) -> None:
    colors, backgrounds = scene()
    for value, expected in ((50.0, 0), (-50.0, 0)):
        extreme = torch.full_like(colors, value).requires_grad_()
        images = compose(views[:1], extreme, backgrounds[:1])
        assert images.min() >= 0 and images.max() <= 1
        images.sum().backward()
        solid = views[0].coverage[: views[0].map.height] == 1
        row = torch.repeat_interleave(views[0].map.crow.diff())
        touching = torch.unique(views[0].map.column[solid[row]])
        assert (extreme.grad[touching].abs().sum(1) == expected).float().mean() > 0.9


def test_black_colours_at_the_bound_still_learn() -> None:
    from cloak_core.core.visibility.settings import Light

    cache = ViewCache(sphere(), RenderSettings(light=Light(ambient=1.0, diffuse=0.0, specular=0.0), samples=1))
    view = cache.bake(0, CAMERA, np.arange(sphere().face_count))
    for value in (0.0, 1.0):
        colors = torch.full((view.map.width, 3), value, requires_grad=True)
        compose([view], colors, torch.zeros(1, 3, 30, 40)).sum().backward()
        assert (colors.grad[torch.unique(view.map.column)] > 0).all()


def test_true_boxes_move_and_are_clipped(views) -> None:
    x0, y0, x1, y1 = views[0].box
    boxes = true_boxes(views[:1] * 3, torch.tensor([[0, 0], [5, -3], [100, 0]])).tolist()
    assert boxes[0] == [x0, y0, x1, y1]
    assert boxes[1] == [x0 + 5, max(y0 - 3, 0), min(x1 + 5, 40), y1 - 3]
    assert boxes[2][0] == boxes[2][2] == 40


def test_mismatched_inputs_are_refused(views) -> None:
    colors, backgrounds = scene()
    with pytest.raises(ValueError, match="number or size"):
        compose(views, colors, backgrounds[:2])
    with pytest.raises(ValueError, match="another logo"):
        compose(views, colors[:-1], backgrounds)
    with pytest.raises(ValueError, match="2 images"):
        compose(views, colors.expand(2, -1, -1), backgrounds)


def test_every_byte_of_a_backdrop_becomes_the_number_torch_makes_of_it() -> None:
    every = torch.arange(256, dtype=torch.uint8).repeat(3).view(3, 16, 16)
    as_photographs_lie = every.flip(1).permute(1, 2, 0).contiguous().permute(2, 0, 1)
    rows = blank(3, 16, 16).fill_(7)
    lay_backdrop(rows, [every, as_photographs_lie, None], (16, 16))
    images = pixels_of(rows, (3, 3, 16, 16))
    assert torch.equal(images[:2], torch.stack([every, as_photographs_lie]).float() / 255)
    assert (images[2] == 0).all() and (rows[-1] == 7).all()
