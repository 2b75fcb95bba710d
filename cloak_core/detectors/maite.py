"""MAITE's object-detection protocol, both ways: their models as our detectors, our measure as their metric.

The protocol is structural, so nothing of MAITE is imported: a model takes images [C, H, W] and returns targets with
`boxes` [n, 4] (xyxy), `labels` [n] and `scores` [n]; a metric has `reset`, `update` and `compute`; both have a record
`metadata`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.outcomes import found_as_person
from cloak_core.detectors.classes import person_index
from cloak_core.detectors.specs import PERSON
from cloak_core.files.errors import InputError


class MaiteModel(nn.Module):
    """A model of MAITE's protocol as a module of ours: (boxes [B, N, 4], person scores [B, N]).

    A black box unless it says `differentiable = True` of itself, and hands tensors with gradients back. InputError: its
    metadata name no class "person" in index2label.
    """

    def __init__(self, model: object) -> None:
        super().__init__()
        self.model = model
        self.differentiable = bool(getattr(model, "differentiable", False))
        who, names = f"MAITE model {model.metadata['id']}", model.metadata.get("index2label")
        if not isinstance(names, Mapping) or not names:
            raise InputError(f"{who}: its metadata have no index2label, which would name the person")
        ordered = tuple(str(names.get(k, "")) for k in range(max(map(int, names)) + 1))
        self.label = person_index(ordered, PERSON, len(ordered), who)

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> tuple[Tensor, Tensor]:
        with torch.set_grad_enabled(self.differentiable and torch.is_grad_enabled()):
            targets = self.model(list(images if self.differentiable else images.detach()))
        persons = [_persons(target, self.label, images) for target in targets]
        boxes = nn.utils.rnn.pad_sequence([boxes for boxes, _ in persons], batch_first=True)
        scores = nn.utils.rnn.pad_sequence([scores for _, scores in persons], batch_first=True)
        return boxes.reshape(len(images), -1, 4), scores


class SuccessMetric:
    """Attack success as a metric of MAITE's: the share of true persons whom no predicted person box is on.

    A box is on a person as everywhere here (`outcomes.found_as_person`): an overlap (IoU) of 0.5, or half of its own
    area within. person: the label of persons, in predictions and truth; threshold: the score above which one counts.
    """

    def __init__(self, person: int = 0, threshold: float = THRESHOLD) -> None:
        self.metadata = {"id": f"cloak-success-{threshold:g}"}
        """What MAITE asks a metric to say of itself: its id."""
        self.person, self.threshold = person, threshold
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._hidden, self._persons, self._images = 0, 0, 0

    def update(self, preds: Sequence[object], targets: Sequence[object], metadata: object = None) -> None:
        """Count a batch: predictions and truths, an image each; metadata of the images are not used."""
        for predicted, true in zip(preds, targets, strict=True):
            here = torch.zeros(1)
            boxes, scores = _persons(predicted, self.person, here)
            people, _ = _persons(true, self.person, here)
            boxes = boxes[scores > self.threshold]
            on = found_as_person(boxes.expand(len(people), -1, 4), people)
            self._hidden += int((~on.any(dim=1)).sum())
            self._persons += len(people)
            self._images += 1

    def compute(self) -> dict[str, float]:
        """Return "success" in [0, 1] (nan where there was nobody), "persons" and "images"."""
        success = self._hidden / self._persons if self._persons else float("nan")
        return {"success": success, "persons": float(self._persons), "images": float(self._images)}


def _persons(target: object, label: int, like: Tensor) -> tuple[Float[Tensor, "n 4"], Float[Tensor, " n"]]:
    """Select a target's boxes and scores of one class; scores [n, classes] are that class's column, of every box."""
    parts = (target.boxes, target.labels, target.scores)
    boxes, labels, scores = (torch.as_tensor(part).to(like.device, torch.float32) for part in parts)
    if scores.dim() == 2:
        return boxes.reshape(-1, 4), scores[:, label]
    chosen = labels.reshape(-1) == label
    return boxes.reshape(-1, 4)[chosen], scores.reshape(-1)[chosen]
