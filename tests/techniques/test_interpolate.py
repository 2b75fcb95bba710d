"""A share of the first colours stays in what is written; training sees none of it."""

import numpy as np
import pytest
import torch

from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.settings import make_settings
from cloak_core.core.technique import Techniques
from cloak_core.files.errors import InputError
from cloak_core.techniques.inks import Inks
from cloak_core.techniques.interpolate import Interpolate


def moved(*techniques, gamut: str = "projection") -> tuple[ColorOptimizer, torch.Tensor]:
    """Make six colours, and move them by three steps; also what they began as."""
    first = torch.rand(6, 3, generator=torch.Generator().manual_seed(0)) * 0.6 + 0.2
    settings = make_settings("best", optimizer="sgd", gamut=gamut).optimization
    colors = ColorOptimizer(settings, first, Techniques(techniques))
    for step in range(3):
        colors.reach(step, 3)
        colors.clear()
        (colors.colors() ** 2).sum().backward()
        colors.update(0.1)
    return colors, first


@pytest.mark.parametrize("gamut", ["projection", "sigmoid"])
def test_what_is_written_lies_between_the_first_colours_and_those_found(gamut):
    colors, first = moved(Interpolate(0.25), gamut=gamut)
    alone, _ = moved(gamut=gamut)
    found = colors.colors().detach()
    assert torch.equal(found, alone.colors().detach())
    assert (found - first).abs().min() > 1e-3
    torch.testing.assert_close(colors.finished(), 0.25 * first + 0.75 * found)


def test_inks_stay_few():
    colors, _ = moved(Interpolate(0.5), Inks(2))
    assert len(np.unique(colors.finished().numpy(), axis=0)) <= 2


@pytest.mark.parametrize("initial", ["grey", "random", "clothing", "animal"])
def test_only_a_print_is_worth_a_share(initial):
    with pytest.raises(InputError, match=rf"--initial-share.*--initial {initial}.*--initial-share 0"):
        make_settings("photographs", initial=initial)
    assert make_settings("photographs", initial=initial, initial_share=0).optimization.initial_share == 0
    assert make_settings("photographs", initial=initial, init="run").optimization.initial_share > 0
