"""What a step minimises, and its gradient."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.attack.batches import Batch
from cloak_core.attack.losses import disappearance, total_variation
from cloak_core.attack.optimizing import ColorOptimizer
from cloak_core.attack.settings import TrainSettings
from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.detectors.scoring import is_detected
from cloak_core.scene.logo import Logo


class Objective:
    """What is minimised: the detectors' mean disappearance loss plus weighted total variation."""

    def __init__(
        self, settings: TrainSettings, logo: Logo, detectors: Sequence[Detector], device: torch.device
    ) -> None:
        self.settings, self.detectors = settings, detectors
        self.edges = torch.as_tensor(logo.edges, dtype=torch.int64, device=device)
        self.edge_lengths = torch.as_tensor(logo.edge_lengths, dtype=torch.float32, device=device)

    def __call__(
        self, images: Float[Tensor, "B 3 H W"], colors: Float[Tensor, "L 3"]
    ) -> tuple[Float[Tensor, "4"], list[Detections]]:
        """(loss, disappearance, total variation, success), and what each detector said."""
        settings = self.settings
        detections = [detector(images) for detector in self.detectors]
        seen = torch.stack([disappearance(d, settings.loss, settings.reduce) for d in detections]).mean()
        variation = total_variation(colors, self.edges, self.edge_lengths)
        found = torch.stack([is_detected(d, settings.threshold).to(seen.dtype).mean() for d in detections]).mean()
        return torch.stack([seen + settings.tv_weight * variation, seen, variation, 1 - found]), detections


@dataclass(frozen=True)
class StepFigures:
    """What one step measured, before its update."""

    loss: float
    disappearance: float
    tv: float
    success: float
    """Share of the batch (over all detectors) in which no person was found."""


def gradient_step(
    objective: Objective, optimizer: ColorOptimizer, batch: Batch
) -> tuple[StepFigures, bool, Float[Tensor, "B 3 H W"], list[Detections]]:
    """Leave the gradient of one batch in `optimizer`: figures, whether all is finite, the images, the detections."""
    optimizer.clear()
    colors = optimizer.colors()
    images = batch.images(colors)
    values, detections = objective(images, colors)
    values[0].backward()
    # One transfer for everything the host wants to know.
    finite = torch.isfinite(values).all() & torch.isfinite(optimizer.gradient).all()
    *figures, is_finite = torch.cat([values.detach(), finite[None].to(values.dtype)]).tolist()
    return StepFigures(*figures), bool(is_finite), images, detections
