"""The colours and how a gradient moves them: optimiser, learning rate, and staying inside [0, 1].

SGD and Adam are written out. Making one of torch's imports its compiler (torch._dynamo), which takes about as long as
torch itself: with torch 2.15 on two CPU cores, 1.4 to 3.0 s for SGD and 2.0 to 2.7 s for Adam in a fresh process, where
importing torch takes 1.9 to 4.0 s. To measure it again:

    python -c "import time, torch; p = torch.zeros(9, requires_grad=True); t = time.perf_counter(); \\
        torch.optim.Adam([p]); print(time.perf_counter() - t)"
"""

import math
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.coloring import Coloring
from cloak_core.core.settings.components import OptimizerSettings

_STATE = "optimizer."
ADAM_BETAS = (0.9, 0.999)
ADAM_EPSILON = 1e-8
"""torch's own defaults."""
STEP_EPOCHS = 10.0
"""Epochs between the drops of the schedule step."""
COSINE_END = 0.01
"""Share of the learning rate that the cosine schedule ends at."""


def learning_rate(settings: OptimizerSettings, step: int, steps: int, epoch: float) -> float:
    """Find the learning rate of update `step` (from 0) of `steps`, `epoch` epochs into the run."""
    if settings.schedule == "step":
        return settings.lr * 0.1 ** math.floor(epoch / STEP_EPOCHS)
    if settings.schedule == "cosine":
        cosine = 0.5 + 0.5 * math.cos(math.pi * step / steps)
        return settings.lr * (COSINE_END + (1 - COSINE_END) * cosine)
    return settings.lr


class ColorOptimizer:
    """Colours [L, 3] under an optimiser. `colors()` is differentiable; `update` follows its gradient.

    Its steps are those of torch's SGD and Adam to the bit (on the CPU).
    """

    def __init__(
        self, settings: OptimizerSettings, initial: Float[Tensor, "C 3"], coloring: Coloring | None = None
    ) -> None:
        """Begin with parameters that make the colours `initial`, or near them; coloring: None makes free colours."""
        self.settings = settings
        self.coloring = coloring or Coloring(settings)
        self._parameter = self.coloring.begin(initial).requires_grad_()
        if settings.optimizer == "adam":
            self._move = _adam
            self._names = {"exp_avg", "exp_avg_sq"}
        elif settings.optimizer == "mi":
            self._move = partial(_mi, momentum=settings.momentum)
            self._names = {"momentum_buffer"}
        else:
            self._move = partial(_sgd, momentum=settings.momentum)
            self._names = {"momentum_buffer"} if settings.momentum else set()
        self._state: dict[str, Tensor] = {}
        self._project()

    def on_step(self, step: int, steps: int) -> None:
        """Hear that `step` of `steps` begins. Until then the run is at its beginning."""
        self.coloring.on_step(step, steps, self._parameter)

    def colors(self) -> Float[Tensor, "C 3"]:
        """Give the colours, in [0, 1], as part of the graph."""
        return self.coloring(self._parameter)

    @torch.no_grad()
    def finished(self) -> Float[Tensor, "C 3"]:
        """Give the colours if the run ended here."""
        return self.coloring(self._parameter, is_final=True).detach()

    @torch.no_grad()
    def _project(self) -> None:
        if self.coloring.is_direct:
            self._parameter.copy_(self.coloring.project(self._parameter))

    @property
    def gradient(self) -> Float[Tensor, "P 3"]:
        """What the last backward pass left, with respect to the free parameters."""
        return self._parameter.grad

    def clear(self) -> None:
        self._parameter.grad = None

    @torch.no_grad()
    def update(self, lr: float) -> None:
        """Take one step against the gradient; projected colours are cut back to [0, 1]."""
        self._move(self._parameter, self._parameter.grad, self._state, lr)
        if not self.coloring.is_sigmoid:
            self._parameter.clamp_(0, 1)
        self._project()

    def state(self) -> dict[str, Tensor]:
        """Give everything that later updates depend on, for a checkpoint."""
        own = {_STATE + name: value for name, value in self._state.items()}
        return {"parameter": self._parameter.detach(), **own, **self.coloring.state()}

    @torch.no_grad()
    def load(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state()`. KeyError or ValueError where the tensors belong to another run."""
        shape = self._parameter.shape
        if tensors["parameter"].shape != shape:
            raise ValueError(f"{len(tensors['parameter'])} colours instead of {len(self._parameter)}")
        own = {name.removeprefix(_STATE): value for name, value in tensors.items() if name.startswith(_STATE)}
        steps = own.pop("step", None)
        if any(value.shape != shape for value in own.values()) or set(own) not in (set(), self._names):
            raise ValueError("the optimiser's state is that of other colours or of another optimiser")
        if (steps is None) == ("exp_avg" in own) or (steps is not None and (steps.numel() != 1 or steps < 1)):
            raise ValueError("the optimiser's state does not say after how many steps")
        self._parameter.copy_(tensors["parameter"])
        self._state = {name: value.to(self._parameter, copy=True) for name, value in own.items()}
        if steps is not None:
            self._state["step"] = steps.to("cpu", torch.float32, copy=True)
        self.coloring.load(tensors)


def _sgd(parameter: Tensor, gradient: Tensor, state: dict[str, Tensor], lr: float, momentum: float) -> None:
    if momentum:
        if "momentum_buffer" in state:
            state["momentum_buffer"].mul_(momentum).add_(gradient)
        else:
            state["momentum_buffer"] = gradient.clone()
        gradient = state["momentum_buffer"]
    parameter.add_(gradient, alpha=-lr)


def _mi(parameter: Tensor, gradient: Tensor, state: dict[str, Tensor], lr: float, momentum: float) -> None:
    """Move every colour by `lr`, to the side on which a momentum of normalised gradients lies (MI-FGSM)."""
    gradient = gradient / gradient.abs().mean().clamp_min(torch.finfo(gradient.dtype).tiny)
    kept = state.setdefault("momentum_buffer", torch.zeros_like(parameter))
    kept.mul_(momentum).add_(gradient)
    parameter.add_(kept.sign(), alpha=-lr)


def _adam(parameter: Tensor, gradient: Tensor, state: dict[str, Tensor], lr: float) -> None:
    if not state:
        state["step"] = torch.zeros(())
        state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(parameter), torch.zeros_like(parameter)
    state["step"] += 1
    step = state["step"].item()
    state["exp_avg"].lerp_(gradient, 1 - ADAM_BETAS[0])
    state["exp_avg_sq"].mul_(ADAM_BETAS[1]).addcmul_(gradient, gradient, value=1 - ADAM_BETAS[1])
    root = state["exp_avg_sq"].sqrt().div_((1 - ADAM_BETAS[1] ** step) ** 0.5).add_(ADAM_EPSILON)
    parameter.addcdiv_(state["exp_avg"], root, value=-lr / (1 - ADAM_BETAS[0] ** step))
