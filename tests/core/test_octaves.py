"""Sums of grids: constants, periods, gradients, and training with them."""

import numpy as np
import pytest
import torch

from cloak_core.core.octaves import octave_sums


def points(count: int = 50, dimensions: int = 3) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (count, dimensions))


@pytest.mark.parametrize(("dimensions", "period"), [(3, None), (2, 0.5)])
def test_every_grid_adds_its_own_constant(dimensions, period):
    octaves = octave_sums(points(dimensions=dimensions), 0.05, 4, period)
    assert torch.allclose(octaves(torch.ones(octaves.width, 3)), torch.full((50, 3), 3.0))


def test_a_grid_is_linear_between_its_nodes():
    places = points(dimensions=2)
    octaves = octave_sums(places, 0.05, 2)
    # The nodes' own places are what the grid says where it is asked for the places themselves.
    nodes = torch.linalg.lstsq(
        octaves.matrix.to_dense().double(), torch.from_numpy(np.c_[places, places[:, 0]])
    ).solution
    assert np.allclose(octaves(nodes.float())[:, :2].numpy(), places, atol=1e-4)


def test_each_grid_is_twice_as_wide_as_the_last():
    octaves = octave_sums(np.arange(17.0)[:, None], 1.0, 4)
    assert octaves.width == 9 + 1 + 5 + 1 + 3 + 1, "nodes 2, 4 and 8 apart, and the one after the last place"


def test_the_gradient_is_the_transpose():
    octaves = octave_sums(points(20), 0.1, 3)
    values = torch.rand(octaves.width, 3, requires_grad=True)
    upstream = torch.rand(20, 3)
    octaves(values).backward(upstream)
    assert torch.allclose(values.grad, octaves.matrix.to_dense().T @ upstream, atol=1e-6)
