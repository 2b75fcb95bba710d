"""MI-FGSM, a baseline: sign steps along a momentum of normalised gradients (Dong et al., CVPR 2018)."""

from __future__ import annotations

from cloak_core.core.technique import Setup, Technique
from cloak_core.files.lazy import Lazy

torch = Lazy("torch")


class MomentumIterative(Technique):
    """Moves every colour by the learning rate, to the side on which the momentum lies."""

    group = "optimization"
    choice = ("optimizer", "mi")
    memory = frozenset({"momentum_buffer"})

    def __init__(self, momentum: float) -> None:
        self.momentum = momentum

    @classmethod
    def build(cls, setup: Setup) -> MomentumIterative | None:
        settings = setup.settings.optimization
        return cls(settings.momentum) if settings.optimizer == cls.choice[1] else None

    def move(self, parameter: torch.Tensor, gradient: torch.Tensor, state: dict[str, torch.Tensor], lr: float) -> None:
        gradient = gradient / gradient.abs().mean().clamp_min(torch.finfo(gradient.dtype).tiny)
        kept = state.setdefault("momentum_buffer", torch.zeros_like(parameter))
        kept.mul_(self.momentum).add_(gradient)
        parameter.add_(kept.sign(), alpha=-lr)


TECHNIQUE = MomentumIterative
