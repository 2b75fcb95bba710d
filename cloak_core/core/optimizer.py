"""The colours and how a gradient moves them: optimiser, learning rate, and staying inside [0, 1].

SGD and Adam are written out. Making one of torch's imports its compiler (torch._dynamo), which takes about as long as
torch itself: with torch 2.15 on two CPU cores, 1.4 to 3.0 s for SGD and 2.0 to 2.7 s for Adam in a fresh process, where
importing torch takes 1.9 to 4.0 s. To measure it again:

    python -c "import time, torch; p = torch.zeros(9, requires_grad=True); t = time.perf_counter(); \\
        torch.optim.Adam([p]); print(time.perf_counter() - t)"
"""

import contextlib
import math
from collections.abc import Iterator
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.near import Near
from cloak_core.core.octaves import Octaves
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings.components import OptimizerSettings

_STATE = "optimizer."
ADAM_BETAS = (0.9, 0.999)
ADAM_EPSILON = 1e-8
"""torch's own defaults."""
COSINE_END = 0.01
"""Share of the learning rate that the cosine schedule ends at."""


def learning_rate(settings: OptimizerSettings, step: int, steps: int, epoch: float) -> float:
    """Find the learning rate of update `step` (from 0) of `steps`, `epoch` epochs into the run."""
    if settings.schedule == "step":
        return settings.lr * 0.1 ** math.floor(epoch / settings.lr_epochs)
    if settings.schedule == "cosine":
        cosine = 0.5 + 0.5 * math.cos(math.pi * step / steps)
        return settings.lr * (COSINE_END + (1 - COSINE_END) * cosine)
    return settings.lr


class ColorOptimizer:
    """Colours [L, 3] under an optimiser. `colors()` is differentiable; `update` follows its gradient.

    Its steps are those of torch's SGD and Adam to the bit (on the CPU).
    """

    def __init__(
        self,
        settings: OptimizerSettings,
        initial: Float[Tensor, "N 3"],
        pattern: Pattern | None = None,
        near: Near | None = None,
        octaves: Octaves | None = None,
    ) -> None:
        """Begin with N values, `initial`. `pattern` makes colours of them; without one they are the colours.

        `near`: the garment that the colours stay close to. `octaves`: coarse grids whose sum moves the values, too.
        """
        self._sigmoid, self._pattern, self.settings = settings.gamut == "sigmoid", pattern, settings
        self.near, self._octaves = near, octaves
        # 0.02 from the ends, where a sigmoid still moves.
        start = torch.logit(initial.clamp(0.02, 0.98)) if self._sigmoid else initial.clone()
        if octaves is not None:
            start = torch.cat([start.new_zeros(octaves.nodes, 3), start])
        self._parameter = start.requires_grad_()
        moves = {"sgd": partial(_sgd, momentum=settings.momentum), "mi": partial(_mi, momentum=settings.momentum)}
        self._move = moves.get(settings.optimizer, _adam)
        self._names = {"exp_avg", "exp_avg_sq"} if settings.optimizer == "adam" else set()
        self._names |= {"momentum_buffer"} if settings.momentum or settings.optimizer == "mi" else set()
        self._state: dict[str, Tensor] = {}
        self._project()

    @torch.no_grad()
    def reach(self, step: int, steps: int) -> None:
        """Say that `step` of `steps` begins: a pattern hangs on it. Until it is said, the run is at its beginning."""
        if self._pattern is not None and self._pattern.reach(step, steps):
            values = self._pattern.with_inks(self._values())
            inks = slice(-self._pattern.learnt, None)
            self._parameter[inks] = torch.logit(values[inks].clamp(0.02, 0.98)) if self._sigmoid else values[inks]

    def colors(self) -> Float[Tensor, "L 3"]:
        """Give the colours, in [0, 1], as part of the graph."""
        return self._kept_near(self._values() if self._pattern is None else self._pattern(self._values()))

    @torch.no_grad()
    def finished(self) -> Float[Tensor, "L 3"]:
        """Give the colours if the run ended here: with an ink for each patch, where it is to end so."""
        return self._kept_near(
            self._values() if self._pattern is None else self._pattern.finished(self._values())
        ).detach()

    def _kept_near(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, "L 3"]:
        """Keep the colours close to the garment; parameters that are colours are kept so themselves."""
        if self.near is None or self._direct:
            return colors
        # Straight through, as for inks: what is cut off may still come back.
        return self.near.project(colors) + (colors - colors.detach())

    @property
    def _direct(self) -> bool:
        return self._pattern is None and not self._sigmoid

    @torch.no_grad()
    def _project(self) -> None:
        if self.near is not None and self._direct:
            self._parameter.copy_(self.near.project(self._parameter))

    def _values(self) -> Float[Tensor, "N 3"]:
        if self._octaves is None:
            return torch.sigmoid(self._parameter) if self._sigmoid else self._parameter
        coarse, own = self._parameter.split([self._octaves.nodes, len(self._parameter) - self._octaves.nodes])
        summed = self._octaves(coarse)
        # Inks that are learnt come after the faces, and lie on no grid.
        return torch.sigmoid(own + torch.cat([summed, own.new_zeros(len(own) - len(summed), 3)]))

    @property
    def gradient(self) -> Float[Tensor, "P 3"]:
        """What the last backward pass left, with respect to the free parameters."""
        return self._parameter.grad

    @property
    def momentum(self) -> Float[Tensor, "P 3"] | None:
        """Where the gradient has pointed lately, as the optimiser remembers it; None before its first step."""
        return self._state.get("exp_avg", self._state.get("momentum_buffer"))

    @contextlib.contextmanager
    def perturbed(self, direction: Float[Tensor, "P 3"] | None) -> Iterator[None]:
        """Move the free parameters by `sharpness` (root mean square) along `direction` inside the block (SAM)."""
        if direction is None or not self.settings.sharpness:
            yield
            return
        kept = self._parameter.detach().clone()
        with torch.no_grad():
            size = direction.square().mean().sqrt().clamp_min(torch.finfo(direction.dtype).tiny)
            self._parameter.addcdiv_(self.settings.sharpness * direction, size)
            if not self._sigmoid:
                self._parameter.clamp_(0, 1)
        try:
            yield
        finally:
            with torch.no_grad():
                self._parameter.copy_(kept)

    def clear(self) -> None:
        self._parameter.grad = None

    @torch.no_grad()
    def update(self, lr: float) -> None:
        """Take one step against the gradient; projected colours are cut back to [0, 1]."""
        self._move(self._parameter, self._parameter.grad, self._state, lr)
        if not self._sigmoid:
            self._parameter.clamp_(0, 1)
        self._project()

    def state(self) -> dict[str, Tensor]:
        """Give everything that later updates depend on, for a checkpoint."""
        own = {_STATE + name: value for name, value in self._state.items()}
        return {"parameter": self._parameter.detach(), **own}

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


def _sgd(parameter: Tensor, gradient: Tensor, state: dict[str, Tensor], lr: float, momentum: float) -> None:
    if momentum:
        if "momentum_buffer" in state:
            state["momentum_buffer"].mul_(momentum).add_(gradient)
        else:
            state["momentum_buffer"] = gradient.clone()
        gradient = state["momentum_buffer"]
    parameter.add_(gradient, alpha=-lr)


def _mi(parameter: Tensor, gradient: Tensor, state: dict[str, Tensor], lr: float, momentum: float) -> None:
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
