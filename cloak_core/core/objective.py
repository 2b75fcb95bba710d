"""What a step minimises, and its gradient."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.batches import Batch, Company
from cloak_core.core.detector.outcomes import as_anything, only_hers
from cloak_core.core.detector.protocol import Detections, Detector, join_detections
from cloak_core.core.detector.scoring import is_detected
from cloak_core.core.ensemble import Ensemble
from cloak_core.core.logo import Logo
from cloak_core.core.losses import non_printability, person_loss, proposal_loss, total_variation
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.self_ensemble import SelfEnsemble
from cloak_core.core.settings import TrainSettings
from cloak_core.core.world import ALONE, World
from cloak_core.files.errors import InputError


@dataclass(frozen=True, eq=False)
class LossAndGradient:
    """What the detectors say of images, and the gradient of it."""

    disappearance: Float[Tensor, ""]
    """Mean over the images of the ensemble's loss."""
    success: Float[Tensor, ""]
    """Share of images in which nothing was found that is to be hidden, mean over the detectors that were asked."""
    gradient: Float[Tensor, "B 3 H W"] | None
    """Of `disappearance`, with respect to the images; None under `torch.no_grad`, and where there are no images."""
    detections: dict[int, Detections]
    """What each asked detector said, by its number; see `Objective.detect`."""


class Objective:
    """What is minimised: the ensemble's disappearance loss plus weighted total variation and printability."""

    def __init__(
        self,
        settings: TrainSettings,
        logo: Logo,
        detectors: Sequence[Detector],
        device: torch.device,
        palette: Float[np.ndarray, "P 3"] | None = None,
    ) -> None:
        self.settings, self.run, self.detectors = settings.objective, settings.run, detectors
        self.ensemble = Ensemble(settings.objective, len(detectors), settings.run.seed)
        self.surrogates = SelfEnsemble(settings.surrogates, settings.run.seed)
        self.ascent = settings.optimization.ascent if settings.optimization.sharpness else None
        self.edges = torch.as_tensor(logo.edges, dtype=torch.int64, device=device)
        self.edge_lengths = torch.as_tensor(logo.edge_lengths, dtype=torch.float32, device=device)
        self.palette = None if palette is None else torch.as_tensor(palette, dtype=torch.float32, device=device)
        self._without_proposals: set[int] = set()

    def printability(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, ""]:
        """Compute non-printability against the palette; 0 without one."""
        return colors.new_zeros(()) if self.palette is None else non_printability(colors, self.palette)

    def total_variation(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, ""]:
        """Compute the colours' total variation."""
        return total_variation(colors, self.edges, self.edge_lengths)

    def forward_backward(
        self,
        images: Float[Tensor, "B 3 H W"],
        step: int | None = None,
        bodies: Float[Tensor, "B 4"] | None = None,
        company: Company | None = None,
    ) -> LossAndGradient:
        """Show the images to the detectors of `step` (None: to all), `microbatch` at a time.

        bodies: the true box of each image's body, needed where everything on it is to be hidden, and with `company`:
        who else is in the images, and does not count.

        Each detector's activations are gone before the next one starts (but for the maximum, which needs all). Under
        `torch.no_grad` there are none.
        """
        groups = self.ensemble.asked(step)
        asked = [number for group in groups for number in group]
        said: dict[int, list[Detections]] = {number: [] for number in asked}
        disappearance, found = images.new_zeros(()), images.new_zeros(())
        gradients: list[Tensor] = []
        size = self.run.microbatch or max(len(images), 1)
        for first in range(0, len(images), size):
            part = images[first : first + size].detach().requires_grad_(torch.is_grad_enabled())
            near = None if bodies is None else bodies[first : first + size]
            among = None if company is None else company.part(first, first + size)
            for group in groups:
                detected = {number: self.detect(number, part, step, near, among) for number in group}
                losses = {number: self.loss(detections, number) for number, detections in detected.items()}
                loss = self.ensemble.combine(losses, len(asked)).sum() / len(images)
                if part.requires_grad:
                    loss.backward()
                disappearance += loss.detach()
                for number, detections in detected.items():
                    said[number].append(join_detections([detections]))
                    found += is_detected(detections, self.run.threshold).sum() / (len(images) * len(asked))
            if part.grad is not None:
                gradients.append(part.grad)
        detections = {number: join_detections(parts) for number, parts in said.items() if parts}
        gradient = torch.cat(gradients) if len(gradients) > 1 else next(iter(gradients), None)
        return LossAndGradient(disappearance, 1 - found, gradient, detections)

    def detect(
        self,
        number: int,
        images: Float[Tensor, "B 3 H W"],
        step: int | None,
        bodies: Float[Tensor, "B 4"] | None = None,
        company: Company | None = None,
    ) -> Detections:
        """Ask detector `number` about images, its network shaken where settings say so and `step` is not None.

        Its scores are of what is to be hidden: of persons, or (`hide` everything) of any class on the bodies.
        """
        with self.surrogates.shaken(number, step):
            detections = self.detectors[number](images)
        if company is not None:
            detections = only_hers(detections, bodies, company.others, company.anywhere)
        if self.settings.hide == "person":
            return detections
        if bodies is None:
            raise ValueError("to hide everything on a body, its box must be known")
        return as_anything(detections, bodies)

    def loss(self, detections: Detections, number: int) -> Float[Tensor, "B"]:
        """Compute what detector `number` adds to each image's loss."""
        settings = self.settings
        # Success is said at both: the lower one is what has to be passed.
        point = min(self.detectors[number].operating_point, self.run.threshold)
        loss = person_loss(detections, settings.loss, settings.reduce, point, settings.margin)
        if not settings.rpn_weight:
            return loss
        if detections.proposal_scores is not None:
            return loss + settings.rpn_weight * proposal_loss(detections, settings.reduce)
        self._without_proposals.add(number)
        if len(self._without_proposals) == len(self.detectors):
            raise InputError("--rpn-weight: none of the detectors gives scores of proposals (two-stage ones do)")
        return loss


@dataclass(frozen=True)
class StepFigures:
    """What one step measured, before its update, over the whole batch."""

    loss: float
    disappearance: float
    tv: float
    nps: float
    """Non-printability: how far the colours are from the palette's, in the mean; 0 without a palette."""
    success: float
    """Share of the batch (over all detectors) in which nothing was found that is to be hidden."""


@dataclass(frozen=True, eq=False)
class Step:
    """A gradient that is ready to be followed."""

    figures: StepFigures
    is_finite: bool
    """Loss and gradient are."""
    images: Float[Tensor, "B 3 H W"]
    """This process's share of the batch."""
    detections: dict[int, Detections]
    """Of these images, by the number of the detector, those that were asked."""


def gradient_step(
    objective: Objective,
    optimizer: ColorOptimizer,
    batch: Batch,
    world: World = ALONE,
    share: float = 1.0,
    step: int = 0,
) -> Step:
    """Leave the gradient of one batch in `optimizer`. `share`: this process's part of the batch's images.

    With a `sharpness` it is that of colours which are worse; the figures, too, unless both were asked for.
    """
    if objective.ascent is None:
        return _gradient(objective, optimizer, batch, world, share, step)
    if objective.ascent == "momentum":
        with optimizer.perturbed(optimizer.momentum):
            return _gradient(objective, optimizer, batch, world, share, step)
    here = _gradient(objective, optimizer, batch, world, share, step)
    with optimizer.perturbed(optimizer.gradient.clone()):
        worse = _gradient(objective, optimizer, batch, world, share, step)
    return replace(worse, figures=here.figures, is_finite=here.is_finite and worse.is_finite)


def _gradient(
    objective: Objective, optimizer: ColorOptimizer, batch: Batch, world: World, share: float, step: int
) -> Step:
    optimizer.clear()
    colors = optimizer.colors()
    images = batch.images(colors)
    found = objective.forward_backward(images, step, batch.bodies, batch.company)
    variation, unprintable = objective.total_variation(colors), objective.printability(colors)
    weight, print_weight = objective.settings.tv_weight, objective.settings.nps_weight
    restless = (weight * variation + print_weight * unprintable) / world.size
    gradient = torch.zeros_like(images) if found.gradient is None else found.gradient
    torch.autograd.backward([images, restless], [gradient if share == 1 else gradient.mul_(share), None])
    gradient = optimizer.gradient
    shares = [share * found.disappearance, variation / world.size, unprintable / world.size, share * found.success]
    values = torch.stack(shares).detach()
    if world.size > 1:
        message = world.sum(torch.cat([gradient.view(-1), values]))
        gradient.copy_(message[: -len(values)].view_as(gradient))
        values = message[-len(values) :]
    finite = torch.isfinite(gradient).all() & torch.isfinite(values).all()
    # One transfer for everything the host wants to know.
    seen, variation, unprintable, success, is_finite = torch.cat([values, finite[None].to(values.dtype)]).tolist()
    loss = seen + weight * variation + print_weight * unprintable
    figures = StepFigures(loss, seen, variation, unprintable, success)
    return Step(figures, bool(is_finite), images.detach(), found.detections)
