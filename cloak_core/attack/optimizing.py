"""The colours and how a gradient moves them: optimiser, learning rate, and staying inside [0, 1]."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.attack.settings import TrainSettings

_STATE = "optimizer."
COSINE_END = 0.01
"""Share of the learning rate that the cosine schedule ends at."""


def learning_rate(settings: TrainSettings, step: int, steps: int, epoch: float) -> float:
    """The learning rate of update `step` (from 0) of `steps`, `epoch` epochs into the run."""
    if settings.schedule == "step":
        return settings.lr * 0.1 ** math.floor(epoch / settings.lr_epochs)
    if settings.schedule == "cosine":
        cosine = 0.5 + 0.5 * math.cos(math.pi * step / steps)
        return settings.lr * (COSINE_END + (1 - COSINE_END) * cosine)
    return settings.lr


class ColorOptimizer:
    """Colours [L, 3] under an optimiser. `colors()` is differentiable; `update` follows its gradient."""

    def __init__(self, settings: TrainSettings, initial: Float[Tensor, "L 3"]) -> None:
        self._sigmoid = settings.gamut == "sigmoid"
        # 0.02 from the ends, where a sigmoid still moves.
        start = torch.logit(initial.clamp(0.02, 0.98)) if self._sigmoid else initial.clone()
        self._parameter = start.requires_grad_()
        if settings.optimizer == "adam":
            self._optimizer: torch.optim.Optimizer = torch.optim.Adam([self._parameter], lr=settings.lr)
        else:
            self._optimizer = torch.optim.SGD([self._parameter], lr=settings.lr, momentum=settings.momentum)

    def colors(self) -> Float[Tensor, "L 3"]:
        """The colours, in [0, 1], as part of the graph."""
        return torch.sigmoid(self._parameter) if self._sigmoid else self._parameter

    @property
    def gradient(self) -> Float[Tensor, "L 3"]:
        """What the last backward pass left, with respect to the free parameters."""
        return self._parameter.grad

    def clear(self) -> None:
        self._parameter.grad = None

    def update(self, lr: float) -> None:
        """One step against the gradient; projected colours are cut back to [0, 1]."""
        for group in self._optimizer.param_groups:
            group["lr"] = lr
        self._optimizer.step()
        if not self._sigmoid:
            with torch.no_grad():
                self._parameter.clamp_(0, 1)

    def state(self) -> dict[str, Tensor]:
        """Everything that later updates depend on, for a checkpoint."""
        own = self._optimizer.state.get(self._parameter, {})
        tensors = {_STATE + name: value for name, value in own.items() if isinstance(value, Tensor)}
        return {"parameter": self._parameter.detach(), **tensors}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state()`. KeyError or ValueError where the tensors belong to another run."""
        if tensors["parameter"].shape != self._parameter.shape:
            raise ValueError(f"{len(tensors['parameter'])} colours instead of {len(self._parameter)}")
        with torch.no_grad():
            self._parameter.copy_(tensors["parameter"])
        own = {name.removeprefix(_STATE): value for name, value in tensors.items() if name.startswith(_STATE)}
        if own:
            record = self._optimizer.state_dict()
            record["state"] = {0: own}
            self._optimizer.load_state_dict(record)


def initial_colors(settings: TrainSettings, clothing: Float[Tensor, "L 3"]) -> Float[Tensor, "L 3"]:
    """First colours of the logo: grey, seeded random ones, or the faces' own `clothing`."""
    if settings.initial == "clothing":
        return clothing.clone()
    if settings.initial == "random":
        generator = torch.Generator().manual_seed(settings.seed)
        return torch.rand(clothing.shape, generator=generator).to(clothing)
    return torch.full_like(clothing, 0.5)
