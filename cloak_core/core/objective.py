"""What a step minimises, and its gradient."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.batches import Batch, Company
from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.outcomes import as_anything, for_person
from cloak_core.core.detector.protocol import Detections, Detector, join_detections
from cloak_core.core.detector.scoring import is_detected
from cloak_core.core.ensemble import Ensemble
from cloak_core.core.losses import person_loss, total_variation
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings import TrainSettings
from cloak_core.core.technique import NO_TECHNIQUES, Techniques
from cloak_core.core.world import ALONE, World


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
    """What is minimised: the ensemble's disappearance loss plus weighted total variation and techniques' penalties."""

    def __init__(
        self,
        settings: TrainSettings,
        pattern: Pattern,
        detectors: Sequence[Detector],
        device: torch.device,
        techniques: Techniques = NO_TECHNIQUES,
    ) -> None:
        self.settings = settings.objective
        self.run = settings.run
        self.detectors = detectors
        self.techniques = techniques
        self.ensemble = Ensemble(settings.objective, len(detectors), settings.run.seed)
        self.edges = torch.as_tensor(pattern.edges, dtype=torch.int64, device=device)
        self.edge_lengths = torch.as_tensor(pattern.edge_lengths, dtype=torch.float32, device=device)

    def penalties(self, colors: Float[Tensor, "L 3"]) -> dict[str, tuple[float, Float[Tensor, ""]]]:
        """Compute what techniques add to the loss, by their names: a weight, and what it weighs."""
        return {technique.name: technique.penalty(colors) for technique in self.techniques.at("penalty")}

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

        Each detector's activations are gone before the next one starts. Under `torch.no_grad` there are none.
        """
        asked = self.ensemble.asked(step)
        answers: dict[int, list[Detections]] = {number: [] for number in asked}
        disappearance, reported = images.new_zeros(()), images.new_zeros(())
        gradients: list[Tensor] = []
        size = self.run.microbatch or max(len(images), 1)
        for first in range(0, len(images), size):
            part = images[first : first + size].detach().requires_grad_(torch.is_grad_enabled())
            near = None if bodies is None else bodies[first : first + size]
            among = None if company is None else company.part(slice(first, first + size))
            for number in asked:
                detections = self.detect(number, part, step, near, among)
                weighted = self.loss(detections, number) * self.ensemble.weight(number, len(asked))
                loss = weighted.sum() / len(images)
                if part.requires_grad:
                    loss.backward()
                disappearance += loss.detach()
                answers[number].append(join_detections([detections]))
                reported += is_detected(detections, THRESHOLD).sum() / (len(images) * len(asked))
            if part.grad is not None:
                gradients.append(part.grad)
        detections = {number: join_detections(parts) for number, parts in answers.items() if parts}
        gradient = torch.cat(gradients) if len(gradients) > 1 else next(iter(gradients), None)
        return LossAndGradient(disappearance, 1 - reported, gradient, detections)

    def detect(
        self,
        number: int,
        images: Float[Tensor, "B 3 H W"],
        step: int | None,
        bodies: Float[Tensor, "B 4"] | None = None,
        company: Company | None = None,
    ) -> Detections:
        """Ask detector `number` about images, in the context of techniques where `step` is not None.

        Its scores are of what is to be hidden: of persons, or (`hide` everything) of any class on the bodies.
        """
        with self.techniques.detector_context(number, step):
            detections = self.detectors[number](images)
        if company is not None:
            detections = for_person(detections, bodies, company.others, company.anywhere)
        if self.settings.hide == "person":
            return detections
        if bodies is None:
            raise ValueError("to hide everything on a body, its box must be known")
        return as_anything(detections, bodies)

    def loss(self, detections: Detections, number: int) -> Float[Tensor, " B"]:
        """Compute what detector `number` adds to each image's loss."""
        settings = self.settings
        # Success is said at both: the lower one is what has to be passed.
        point = min(self.detectors[number].operating_point, THRESHOLD)
        return person_loss(detections, settings.loss, point)


@dataclass(frozen=True)
class StepFigures:
    """What one step measured, before its update, over the whole batch."""

    loss: float
    disappearance: float
    tv: float
    penalties: dict[str, float]
    """What techniques' penalties come to, before their weights, by their names."""
    success: float
    """Share of the batch (over all detectors) in which nothing was found that is to be hidden."""

    def record(self) -> dict[str, float]:
        """Tell them as events and results have them: `nps` (non-printability) always, others where they are."""
        figures = asdict(self)
        penalties = figures.pop("penalties")
        return figures | {"nps": 0.0} | penalties


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
    part: float = 1.0,
    step: int = 0,
) -> Step:
    """Leave the gradient of one batch in `optimizer`. `part`: this process's fraction of the batch's images."""
    optimizer.clear()
    colors = optimizer.colors()
    images = batch.images(colors)
    # Of the detectors all figures are means over this process's images: times `part`, they add up to the whole batch's.
    # What depends on the colours alone is the same in every process: over their number, it adds up to itself.
    result = objective.forward_backward(images, step, batch.bodies, batch.company)
    variation = objective.total_variation(colors)
    weight = objective.settings.tv_weight
    penalties = objective.penalties(colors)
    restless = (weight * variation + sum(factor * value for factor, value in penalties.values())) / world.size
    gradient = torch.zeros_like(images) if result.gradient is None else result.gradient
    torch.autograd.backward([images, restless], [gradient if part == 1 else gradient.mul_(part), None])
    gradient = optimizer.gradient  # of the sum of both, with respect to the parameters
    shares = [part * result.disappearance, part * result.success]
    shares += [value / world.size for value in (variation, *(value for _, value in penalties.values()))]
    values = torch.stack(shares).detach()
    if world.size > 1:
        message = world.sum(torch.cat([gradient.view(-1), values]))
        gradient.copy_(message[: -len(values)].view_as(gradient))
        values = message[-len(values) :]
    finite = torch.isfinite(gradient).all() & torch.isfinite(values).all()
    # One transfer for everything the host wants to know.
    seen, success, variation, *measured, is_finite = torch.cat([values, finite[None].to(values.dtype)]).tolist()
    named = dict(zip(penalties, measured, strict=True))
    loss = seen + weight * variation + sum(penalties[name][0] * value for name, value in named.items())
    figures = StepFigures(loss, seen, variation, named, success)
    return Step(figures, bool(is_finite), images.detach(), result.detections)
