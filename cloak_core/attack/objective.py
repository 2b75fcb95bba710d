"""What a step minimises, and its gradient."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.attack.batches import Batch
from cloak_core.attack.losses import disappearance, non_printability, total_variation
from cloak_core.attack.optimizing import ColorOptimizer
from cloak_core.attack.settings import TrainSettings
from cloak_core.attack.world import ALONE, World
from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.detectors.scoring import is_detected
from cloak_core.scene.logo import Logo


class Objective:
    """What is minimised: the detectors' mean disappearance loss plus weighted total variation and printability."""

    def __init__(
        self,
        settings: TrainSettings,
        logo: Logo,
        detectors: Sequence[Detector],
        device: torch.device,
        palette: Float[np.ndarray, "P 3"] | None = None,
    ) -> None:
        self.settings, self.detectors = settings, detectors
        self.edges = torch.as_tensor(logo.edges, dtype=torch.int64, device=device)
        self.edge_lengths = torch.as_tensor(logo.edge_lengths, dtype=torch.float32, device=device)
        self.palette = None if palette is None else torch.as_tensor(palette, dtype=torch.float32, device=device)

    def printability(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, ""]:
        """Non-printability against the palette; 0 without one."""
        return colors.new_zeros(()) if self.palette is None else non_printability(colors, self.palette)

    def __call__(
        self, images: Float[Tensor, "B 3 H W"], colors: Float[Tensor, "L 3"]
    ) -> tuple[Tensor, Tensor, Tensor, list[Detections]]:
        """Disappearance loss, total variation, success (share of images without a person), what each detector said."""
        settings = self.settings
        detections = [detector(images) for detector in self.detectors]
        seen = torch.stack([disappearance(d, settings.loss, settings.reduce) for d in detections]).mean()
        found = torch.stack([is_detected(d, settings.threshold).to(seen.dtype).mean() for d in detections]).mean()
        return seen, total_variation(colors, self.edges, self.edge_lengths), 1 - found, detections


@dataclass(frozen=True)
class StepFigures:
    """What one step measured, before its update, over the whole batch."""

    loss: float
    disappearance: float
    tv: float
    nps: float
    """Non-printability: how far the colours are from the palette's, in the mean; 0 without a palette."""
    success: float
    """Share of the batch (over all detectors) in which no person was found."""


@dataclass(frozen=True, eq=False)
class Step:
    """A gradient that is ready to be followed."""

    figures: StepFigures
    is_finite: bool
    """Loss and gradient are."""
    images: Float[Tensor, "B 3 H W"]
    """This process's share of the batch."""
    detections: list[Detections]
    """Of these images, by detector."""


def gradient_step(
    objective: Objective, optimizer: ColorOptimizer, batch: Batch, world: World = ALONE, share: float = 1.0
) -> Step:
    """Leave the gradient of one batch in `optimizer`. `share`: this process's part of the batch's images."""
    optimizer.clear()
    colors = optimizer.colors()
    images = batch.images(colors)
    seen, variation, success, detections = objective(images, colors)
    unprintable = objective.printability(colors)
    weight, print_weight = objective.settings.tv_weight, objective.settings.nps_weight
    (share * seen + (weight * variation + print_weight * unprintable) / world.size).backward()
    gradient = optimizer.gradient
    values = torch.stack([share * seen, variation / world.size, unprintable / world.size, share * success]).detach()
    if world.size > 1:
        message = world.sum(torch.cat([gradient.view(-1), values]))
        gradient.copy_(message[: -len(values)].view_as(gradient))
        values = message[-len(values) :]
    finite = torch.isfinite(gradient).all() & torch.isfinite(values).all()
    # One transfer for everything the host wants to know.
    seen, variation, unprintable, success, is_finite = torch.cat([values, finite[None].to(values.dtype)]).tolist()
    loss = seen + weight * variation + print_weight * unprintable
    figures = StepFigures(loss, seen, variation, unprintable, success)
    return Step(figures, bool(is_finite), images.detach(), detections)
