"""Compiled loops against the torch operations that other devices use: the same images and gradients."""

import contextlib

import numpy as np
import pytest
import torch
from bodies_made import sphere

from cloak_core.core.cameras import Camera
from cloak_core.core.paint import Canvas, blank, pixels_of
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.sources.bodies.view_cache import ViewCache

HEIGHT, WIDTH = 44, 60
LOGO = np.arange(20, 90)


def views_of(seed: int, count: int, samples: int | None, light: Light) -> list:
    """Of a sphere from anywhere, so near now and then that it leaves the image."""
    random = np.random.default_rng(seed)
    cache = ViewCache(sphere(), RenderSettings(light=light, samples=samples))
    camera = lambda: Camera(
        distance=random.uniform(1.8, 6), azimuth=random.uniform(0, 360), elevation=random.uniform(-60, 60),
        pivot=tuple(random.uniform(-0.5, 0.5, 3)), width=WIDTH, height=HEIGHT,
    )  # fmt: skip
    return [cache.bake(0, camera(), LOGO, outfit=i % 2) for i in range(count)]


def painted(views, colors, shifts, upstream, loops: bool) -> tuple[torch.Tensor, torch.Tensor]:
    """Images and the colours' gradient. The background is the same for both."""
    shape = (len(views), 3, HEIGHT, WIDTH)
    rows = blank(len(views), HEIGHT, WIDTH)
    pixels_of(rows, shape).copy_(torch.rand(shape, generator=torch.Generator().manual_seed(1)))
    own = colors.clone().requires_grad_()
    with contextlib.nullcontext() if loops else torch_alone():
        images = Canvas.of(views, rows, shifts).paint(own)
        images.backward(upstream)
    return images.detach(), own.grad


@pytest.mark.parametrize("each", [False, True], ids=["colours for all", "for each"])
@pytest.mark.parametrize("light", [Light(), Light(color=(1.0, 0.7, 0.4))], ids=["white", "tinted"])
@pytest.mark.parametrize("seed", range(4))
def test_loops_equal_operations(seed: int, light: Light, each: bool) -> None:
    """Random views, shifts, colours beyond [0, 1]; gradients planar or channels-last."""
    views = views_of(seed, 3, (1, 4, None)[seed % 3], light)
    generator = torch.Generator().manual_seed(seed)
    random = lambda *shape: torch.rand(*shape, generator=generator)
    shifts = torch.randint(-25, 26, (3, 2), generator=generator) if seed % 2 else None
    colors = random(*((3,) if each else ()), len(LOGO), 3) * 1.6 - 0.3
    layout = torch.channels_last if seed < 2 else torch.contiguous_format
    upstream = (random(3, 3, HEIGHT, WIDTH) - 0.5).contiguous(memory_format=layout)
    (ours, gradient), (theirs, expected) = (painted(views, colors, shifts, upstream, loops) for loops in (True, False))
    torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-6)
    torch.testing.assert_close(gradient, expected, rtol=1e-6, atol=1e-6 * float(expected.abs().max()))
    clamped = (theirs == 0) | (theirs == 1)
    assert clamped.any() and float(expected.abs().max()) > 0.1, "clamped pixels and a gradient to speak of"


@pytest.mark.parametrize("loops", [True, False])
def test_what_is_not_a_number_is_shown_and_passes_no_gradient(loops: bool) -> None:
    views = views_of(1, 1, 1, Light())
    upstream = torch.ones(1, 3, HEIGHT, WIDTH)
    colors = torch.full((len(LOGO), 3), torch.nan)
    images, gradient = painted(views, colors, None, upstream, loops)
    assert images.isnan().any() and (gradient == 0).all()


@pytest.mark.parametrize("loops", [True, False])
def test_painting_again_is_refused_to_those_who_still_need_the_images(loops: bool) -> None:
    """The memory is drawn into again: autograd knows, and does not give a wrong gradient."""
    views = views_of(2, 1, 1, Light())
    rows = blank(1, HEIGHT, WIDTH)
    rows.zero_()
    with contextlib.nullcontext() if loops else torch_alone():
        canvas = Canvas.of(views, rows)
    colors = torch.full((len(LOGO), 3), 0.5, requires_grad=True)
    loss = canvas.paint(colors).square().sum()
    canvas.paint(colors)
    with pytest.raises(RuntimeError, match="modified"):
        loss.backward()
