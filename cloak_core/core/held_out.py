"""Early stopping: part of the training material is set aside, and tells when more steps no longer help.

A share of the poses and of the backgrounds is never trained on. Every `held_out_every` steps the colours are measured
on one fixed set of images of them, drawn as training draws; the best colours so far are kept. What was set aside chose
the colours, so it counts as seen: test material is never touched, and a run's figures on it are no test.
"""

from __future__ import annotations

import dataclasses
import math

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.batches import Batcher
from cloak_core.core.objective import Objective
from cloak_core.core.settings import TrainSettings
from cloak_core.core.settings.components import RunSettings
from cloak_core.core.world import World

IMAGES = 64
"""Fewest images of a measurement."""
_STATE = "held_out."


def held_out_settings(settings: TrainSettings) -> TrainSettings:
    """Make settings whose `steps` batches are the images of one measurement."""
    steps = math.ceil(IMAGES / settings.run.batch)
    return settings.changed(epochs=None, steps=steps, seed=settings.run.seed ^ 1, held_out=0.0, patience=0)


@dataclasses.dataclass(frozen=True, eq=False)
class Best:
    """The colours that did best on what is held out."""

    step: int
    disappearance: float
    success: float
    colors: Float[Tensor, "L 3"]


class HeldOut:
    """Measures colours on a fixed set of images and remembers the best."""

    def __init__(self, settings: RunSettings, batcher: Batcher, objective: Objective, world: World) -> None:
        self.settings = settings
        self.batcher = batcher
        self.objective = objective
        self.world = world
        self.best: Best | None = None

    def is_due(self, step: int, steps: int) -> bool:
        """Tell whether the colours after `step` of `steps` updates are to be measured."""
        return step == steps or step % self.settings.held_out_every == 0

    def consider(self, step: int, colors: Float[Tensor, "L 3"]) -> dict[str, float]:
        """Measure the colours after `step` updates; returns what to tell: disappearance, success, best_step."""
        seen, success = self._measure(colors)
        # Not "<=": of equals the earlier stays, so that a loss at its floor ends the run, too.
        if self.best is None or seen < self.best.disappearance:
            self.best = Best(step, seen, success, colors.detach().clone())
        return {"disappearance": seen, "success": success, "best_step": self.best.step}

    def is_over(self, step: int) -> bool:
        """Tell whether `patience` measurements in a row, up to `step`, brought nothing better."""
        if not self.settings.patience or self.best is None:
            return False
        since = step // self.settings.held_out_every - self.best.step // self.settings.held_out_every
        return since >= self.settings.patience

    def state(self) -> dict[str, Tensor]:
        """Give the state for a checkpoint."""
        if self.best is None:
            return {}
        figures = torch.tensor([self.best.step, self.best.disappearance, self.best.success], dtype=torch.float64)
        return {_STATE + "colors": self.best.colors, _STATE + "figures": figures}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state()`. ValueError where the tensors belong to another run."""
        colors, figures = tensors.get(_STATE + "colors"), tensors.get(_STATE + "figures")
        if colors is None or figures is None:
            return
        if colors.shape != (self.batcher.worn.color_count, 3) or figures.shape != (3,):
            raise ValueError("the best colours are of another shape")
        step, seen, success = figures.tolist()
        self.best = Best(int(step), seen, success, colors.to(self.batcher.device))

    @torch.no_grad()
    def _measure(self, colors: Float[Tensor, "L 3"]) -> tuple[float, float]:
        """Average disappearance loss and success over all images, in all processes together."""
        sampler = self.batcher.sampler
        total = torch.zeros(2, dtype=torch.float64, device=self.batcher.device)
        for step in range(sampler.steps):
            batch = self.batcher.batch(step, self.world.rank, self.world.size)
            if len(batch):
                result = self.objective.forward_backward(batch.images(colors), bodies=batch.bodies)
                total += len(batch) * torch.stack([result.disappearance, result.success]).double()
        seen, success = (self.world.sum(total) / sampler.images).tolist()
        return seen, success
