"""Sums of grids: constants, periods, gradients, and training with them."""

import numpy as np
import pytest
import torch

from cloak_core.core.octaves import Octaves
from cloak_core.core.settings import make_settings
from cloak_core.files.errors import InputError


def points(count: int = 50, dimensions: int = 3) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (count, dimensions))


@pytest.mark.parametrize(("dimensions", "period"), [(3, None), (2, 0.5)])
def test_every_grid_adds_its_own_constant(dimensions, period):
    octaves = Octaves(points(dimensions=dimensions), 0.05, 4, period)
    assert torch.allclose(octaves(torch.ones(octaves.nodes, 3)), torch.full((50, 3), 3.0))


def test_a_grid_is_linear_between_its_nodes():
    places = points(dimensions=2)
    octaves = Octaves(places, 0.05, 2)
    # The nodes' own places are what the grid says where it is asked for the places themselves.
    nodes = torch.linalg.lstsq(
        octaves.weights.to_dense().double(), torch.from_numpy(np.c_[places, places[:, 0]])
    ).solution
    assert np.allclose(octaves(nodes.float())[:, :2].numpy(), places, atol=1e-4)


def test_what_a_period_apart_lies_is_the_same():
    places = points(dimensions=2)
    one, other = (Octaves(at, 0.04, 3, 0.5).weights.to_dense() for at in (places, places + np.array([0.5, -1.0])))
    assert torch.allclose(one, other, atol=1e-5)


def test_the_gradient_is_the_transpose():
    octaves = Octaves(points(20), 0.1, 3)
    values = torch.rand(octaves.nodes, 3, requires_grad=True)
    upstream = torch.rand(20, 3)
    octaves(values).backward(upstream)
    assert torch.allclose(values.grad, octaves.weights.to_dense().T @ upstream, atol=1e-6)


def test_octaves_need_a_sigmoid():
    with pytest.raises(InputError, match=r"--octaves.*--gamut sigmoid"):
        make_settings("best", octaves=3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "pattern", [{}, {"pattern": "tile", "tile_cm": 50}, {"pattern": "camouflage", "feature_cm": 30}]
)
def test_a_run_with_octaves_is_resumed_to_the_bit(tmp_path, pattern):
    from cloak_core.studies.trainings.training import train
    from tests.core.fakes import TinyDetector, box_bodies, front_logo, noise_backgrounds

    bodies = box_bodies()
    chosen = {"batch": 2, "size": 64, "translation": 5, "samples": 1, "octaves": 3, "gamut": "sigmoid", **pattern}

    def run(name: str, resume: bool = False, **more: object):
        settings = make_settings("best", **chosen, **more)
        given = (settings, bodies, front_logo(bodies), [TinyDetector()], noise_backgrounds())
        return train(*given, tmp_path / name, resume=resume)

    whole = run("whole", steps=6)
    run("parts", steps=6, max_seconds=1e-9)
    assert np.array_equal(run("parts", steps=6, resume=True).colors, whole.colors)
    assert np.abs(whole.colors - 0.5).max() > 1e-3
