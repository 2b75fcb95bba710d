"""Sharpness-aware minimisation: how far up the slope, whose gradient is followed, and a run that is resumed."""

import numpy as np
import pytest
import torch

from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.settings import make_settings
from cloak_core.techniques.sam import Sam
from tests.core.fakes import techniques_of


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 1e30])
def test_the_way_goes_up_the_slope_and_is_as_long_as_asked_whatever_the_gradients_size(scale):
    gradient = torch.randn(50, 3, generator=torch.Generator().manual_seed(0))
    way = Sam(0.1).aside(gradient * scale)
    assert way.square().mean().sqrt().item() == pytest.approx(0.1, rel=1e-5)
    torch.testing.assert_close(way / way.norm(), gradient / gradient.norm())


def test_where_nothing_slopes_it_stays():
    assert torch.equal(Sam(0.1).aside(torch.zeros(4, 3)), torch.zeros(4, 3))


@pytest.mark.parametrize("gamut", ["projection", "sigmoid"])
def test_the_colours_come_back_and_the_gradient_beside_them_is_followed(gamut):
    settings = make_settings("best", sam=0.3, gamut=gamut, optimizer="sgd", lr=0.1, momentum=0.0)
    optimizer = ColorOptimizer(settings.optimization, torch.full((2, 3), 0.9), techniques_of(settings))
    before = optimizer.state()["parameter"].clone()
    (5 * optimizer.colors()).sum().backward()
    with optimizer.aside():
        # Up the slope of all six alike; what leaves [0, 1] is cut off.
        there = before + 0.3 if gamut == "sigmoid" else torch.ones(2, 3)
        torch.testing.assert_close(optimizer.state()["parameter"], there)
        optimizer.clear()
        (-optimizer.colors()).sum().backward()
        followed = optimizer.gradient.clone()
    assert torch.equal(optimizer.state()["parameter"], before)
    optimizer.update(0.1)
    expected = before - 0.1 * followed
    torch.testing.assert_close(
        optimizer.state()["parameter"], expected.clamp(0, 1) if gamut == "projection" else expected
    )


def test_a_run_tells_of_its_own_colours_and_is_resumed_to_the_bit(tmp_path):
    from cloak_core.studies.trainings.training import train
    from tests.core.fakes import TinyDetector, box_bodies, front_logo, noise_backgrounds

    bodies = box_bodies()

    def run(name: str, resume: bool = False, **more: object):
        settings = make_settings("best", batch=2, size=64, translation=5, samples=1, **more)
        given = (settings, bodies, front_logo(bodies), [TinyDetector()], noise_backgrounds())
        return train(*given, tmp_path / name, resume=resume)

    whole = run("whole", steps=4, sam=0.2)
    run("parts", steps=4, sam=0.2, max_seconds=1e-9)
    assert np.array_equal(run("parts", steps=4, sam=0.2, resume=True).colors, whole.colors)
    assert not np.array_equal(run("plain", steps=4).colors, whole.colors)
    # Of the first step, whose colours are the same: the figures are of these, not of those beside them.
    first, plain = (run(name, steps=1, sam=sam) for name, sam in (("first", 0.2), ("first_plain", 0.0)))
    assert first.figures == plain.figures
