"""Colours in a basis of low frequencies."""

import numpy as np
import torch

from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.settings import make_settings
from cloak_core.core.smooth import neighbour_means, smoothed
from cloak_core.patterns.faces import FacePattern
from tests.core.fakes import box_bodies, front_logo

LOGO = front_logo(box_bodies())
PATTERN = FacePattern(LOGO, box_bodies())
MEANS = neighbour_means(LOGO.edges, len(LOGO))


def test_rounds_are_a_product_with_a_symmetric_matrix_whose_rows_sum_to_one():
    matrix = smoothed(torch.eye(len(LOGO)), MEANS, 1)
    torch.testing.assert_close(matrix, matrix.T)
    torch.testing.assert_close(matrix.sum(1), torch.ones(len(LOGO)))
    neighbours = np.zeros((len(LOGO), len(LOGO)), bool)
    neighbours[LOGO.edges[:, 0], LOGO.edges[:, 1]] = True
    assert np.array_equal((matrix > 0).numpy() & ~np.eye(len(LOGO), dtype=bool), neighbours | neighbours.T)
    values = torch.rand(len(LOGO), 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(smoothed(values, MEANS, 3), matrix @ matrix @ matrix @ values)


def test_its_gradient_is_that_of_the_product():
    values = torch.rand(len(LOGO), 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    upstream = torch.randn(len(LOGO), 3, generator=torch.Generator().manual_seed(1))
    (ours,) = torch.autograd.grad(smoothed(values, MEANS, 2), values, upstream)
    matrix = smoothed(torch.eye(len(LOGO)), MEANS, 2)
    torch.testing.assert_close(ours, matrix.T @ upstream)


def test_optimised_colours_are_smooth_and_in_bounds():
    spread = {}
    for rounds in (0, 10):
        settings = make_settings("best", smooth=rounds).optimization
        optimizer = ColorOptimizer(settings, torch.full((len(LOGO), 3), 0.5), pattern=PATTERN)
        generator = torch.Generator().manual_seed(0)
        for _ in range(20):
            optimizer.clear()
            (optimizer.colors() * torch.randn(len(LOGO), 3, generator=generator)).sum().backward()
            optimizer.update(0.2)
        colors = optimizer.colors().detach()
        assert colors.min() >= 0 and colors.max() <= 1
        spread[rounds] = float(colors.std(0).mean())
    assert spread[10] < spread[0] / 2
