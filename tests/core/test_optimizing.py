import itertools
import subprocess
import sys

import pytest
import torch

from cloak_core.core.optimizer import ColorOptimizer, learning_rate
from cloak_core.core.settings import make_settings


def test_schedules():
    paper = make_settings("paper").optimization
    rates = [learning_rate(paper, 0, 1, epoch) for epoch in (0.0, 9.99, 10.0, 19.9, 20.0)]
    assert rates == pytest.approx([0.1, 0.1, 0.01, 0.01, 0.001])
    constant = make_settings("best", schedule="constant", lr=0.5).optimization
    assert learning_rate(constant, 99, 100, 50.0) == 0.5
    cosine = make_settings("best", schedule="cosine", lr=1.0).optimization
    rates = [learning_rate(cosine, step, 100, 0.0) for step in (0, 50, 100)]
    assert rates == pytest.approx([1.0, 0.505, 0.01])


@pytest.mark.parametrize(
    ("optimizer", "gamut"), list(itertools.product(["sgd", "adam", "momentum"], ["projection", "sigmoid"]))
)
def test_colours_stay_in_gamut_and_state_restores_exactly(optimizer, gamut):
    changes = {"optimizer": "sgd", "momentum": 0.9} if optimizer == "momentum" else {"optimizer": optimizer}
    settings = make_settings("best", gamut=gamut, **changes).optimization
    pushes = torch.randn(8, 4, 3, generator=torch.Generator().manual_seed(0))

    def steps(target, wanted):
        for push in wanted:
            colors = _pushed(target, push, 0.7)
            assert colors.min() >= 0 and colors.max() <= 1

    whole = ColorOptimizer(settings, torch.full((4, 3), 0.5))
    steps(whole, pushes)
    first = ColorOptimizer(settings, torch.full((4, 3), 0.5))
    steps(first, pushes[:3])
    second = ColorOptimizer(settings, torch.full((4, 3), 0.5))
    second.load({name: tensor.clone() for name, tensor in first.state().items()})
    steps(second, pushes[3:])
    assert torch.equal(whole.colors(), second.colors())


@pytest.mark.parametrize("kind", ["sgd", "momentum", "adam"])
def test_updates_are_those_of_torch_to_the_bit(kind):
    changes = {"optimizer": "sgd", "momentum": 0.9} if kind == "momentum" else {"optimizer": kind}
    ours = ColorOptimizer(make_settings("best", **changes).optimization, torch.full((50, 3), 0.5))
    theirs = torch.full((50, 3), 0.5).requires_grad_()
    if kind == "adam":
        reference = torch.optim.Adam([theirs])
    else:
        reference = torch.optim.SGD([theirs], momentum=changes.get("momentum", 0.0))
    generator = torch.Generator().manual_seed(1)
    for step in range(40):
        push, lr = torch.randn(50, 3, generator=generator) * 10 ** (step % 5 - 2), 0.05 / (1 + step)
        for colors in (ours.colors(), theirs):
            colors.grad = push.clone()
        ours.update(lr)
        reference.param_groups[0]["lr"] = lr
        reference.step()
        theirs.data.clamp_(0, 1)
        assert torch.equal(ours.colors(), theirs), step


@pytest.mark.slow
def test_training_does_not_load_torchs_compiler():
    """It takes longer than all else that a run loads."""
    code = "import sys; from cloak_core.core.optimizer import ColorOptimizer; from cloak_core.core import train;"
    code += "from cloak_core.core.settings import make_settings; import torch;"
    code += "settings = make_settings('best').optimization;"
    code += "ColorOptimizer(settings, torch.zeros(4, 3)); sys.exit('torch._dynamo' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    "change",
    [{"optimizer.exp_avg": torch.zeros(3, 3)}, {"optimizer.exp_avg": None}, {"optimizer.step": None},
     {"optimizer.step": torch.tensor(0.0)}, {"optimizer.step": torch.ones(2)}, {"optimizer.other": torch.zeros(4, 3)}],
)  # fmt: skip
def test_a_state_that_does_not_fit_is_refused(change):
    optimizer = ColorOptimizer(make_settings("best").optimization, torch.full((4, 3), 0.5))
    optimizer.colors().grad = torch.ones(4, 3)
    optimizer.update(0.1)
    state = {name: value for name, value in (optimizer.state() | change).items() if value is not None}
    with pytest.raises(ValueError, match="the optimiser's state"):
        optimizer.load(state)


def _pushed(optimizer: ColorOptimizer, gradient: torch.Tensor, lr: float = 0.1) -> torch.Tensor:
    optimizer.clear()
    (optimizer.colors() * gradient).sum().backward()
    optimizer.update(lr)
    return optimizer.colors().detach().clone()


def test_mi_steps_go_along_the_signs_of_normalised_gradients_with_momentum():
    settings = make_settings("best", optimizer="mi", momentum=0.5).optimization
    optimizer, other = (ColorOptimizer(settings, torch.full((2, 3), 0.5)) for _ in range(2))
    large, small = torch.tensor([[1000.0] * 3, [-1000.0] * 3]), torch.tensor([[-1e-3] * 3, [1e-3] * 3])
    torch.testing.assert_close(_pushed(optimizer, large), 0.5 - 0.1 * large.sign())
    # The second gradient is as long as the first, whatever its size, and outweighs half of it.
    torch.testing.assert_close(_pushed(optimizer, small), torch.full((2, 3), 0.5))
    other.load(optimizer.state())
    assert torch.equal(_pushed(other, large), _pushed(optimizer, large))
