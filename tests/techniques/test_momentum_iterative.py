"""MI-FGSM's steps."""

import torch

from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.settings import make_settings
from tests.core.fakes import techniques_of
from tests.core.test_optimizing import _pushed


def optimizer_of(**changes: float) -> ColorOptimizer:
    settings = make_settings("best", optimizer="mi", **changes)
    return ColorOptimizer(settings.optimization, torch.full((2, 3), 0.5), techniques_of(settings))


def test_steps_go_along_the_signs_of_normalised_gradients_with_momentum():
    optimizer = optimizer_of(momentum=0.5)
    large, small = torch.tensor([[1000.0] * 3, [-1000.0] * 3]), torch.tensor([[-1e-3] * 3, [1e-3] * 3])
    torch.testing.assert_close(_pushed(optimizer, large), 0.5 - 0.1 * large.sign())
    # The second gradient is as long as the first, whatever its size, and outweighs half of it.
    torch.testing.assert_close(_pushed(optimizer, small), torch.full((2, 3), 0.5))
    other = optimizer_of(momentum=0.5)
    other.load(optimizer.state())
    assert torch.equal(_pushed(other, large), _pushed(optimizer, large))
