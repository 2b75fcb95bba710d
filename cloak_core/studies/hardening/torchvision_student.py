"""torchvision's detectors as students, by the terms of their own losses (classes, boxes, centre-ness; of both stages
where there are two) at every anchor and proposal.

Their losses in training mode would want labels, draw anchors and proposals at random and let batch norm move; the same
terms between what two networks say want none of that, and are 0 before anything was learned.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torchvision.models.detection import FCOS
from torchvision.models.detection.rpn import concat_box_prediction_layers
from torchvision.models.detection.ssd import SSD

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.detectors.torchvision_family.base import TorchvisionDetector
from cloak_core.detectors.torchvision_family.dense import DenseDetector
from cloak_core.detectors.torchvision_family.loading import write_torchvision
from cloak_core.detectors.torchvision_family.two_stage import TwoStageDetector
from cloak_core.studies.hardening.answers import Answer, Reading, answer_distance
from cloak_core.studies.hardening.student import Student

PROPOSALS = 128
"""Of an image: the teacher's best, of which the second stage of both is asked."""
_OBJECTS = Reading(softmax=False)
"""How the first stage's answers are read."""


class TorchvisionStudent(Student):
    """Any torchvision model; how it learns is its kind's."""

    files = (".pth",)
    detector: TorchvisionDetector
    teacher: TorchvisionDetector

    @property
    def network(self) -> nn.Module:
        return self.detector.model

    def save(self, stem: Path, seen: int) -> str:
        name = self.request.parts[0]
        write_torchvision(stem.with_suffix(".pth"), name, self.detector.model)
        return f"torchvision:{name}:{stem}.pth{self.options}"


class DenseStudent(TorchvisionStudent):
    """RetinaNet, FCOS, SSD and SSDlite."""

    detector: DenseDetector
    teacher: DenseDetector

    def answer(self, detector: DenseDetector, images: Float[Tensor, "B 3 H W"]) -> Answer:
        with self.autocast(images):
            outputs, _ = detector.raw(detector.prepare(images)[0])
        trust = outputs["bbox_ctrness"][..., 0] if "bbox_ctrness" in outputs else None
        return Answer(outputs["cls_logits"], outputs["bbox_regression"].unsqueeze(2), trust)

    def compare(
        self, said: Answer, wanted: Answer, surer: Bool[Tensor, " B"] | None, sure: float
    ) -> Float[Tensor, " B"]:
        point = self.detector.operating_point
        # FCOS' score is the root of the product.
        found_at = point**2 if isinstance(self.detector.model, FCOS) else point
        reading = Reading(isinstance(self.detector.model, SSD), self.detector.person, found_at)
        return answer_distance(said, wanted, reading, surer, sure)


class Stages(NamedTuple):
    """What the teacher says of B images."""

    anchors: Answer
    proposals: list[Float[Tensor, "_ 4"]]
    """Its best of each image, best first."""
    judged: list[Answer]
    """Of each image, what the second stage says of each of these, one in the place of an image."""


class TwoStageStudent(TorchvisionStudent):
    """Faster, Mask and Keypoint R-CNN; masks and keypoints do not learn."""

    detector: TwoStageDetector
    teacher: TwoStageDetector

    @torch.no_grad()
    def wanted(self, images: Float[Tensor, "P 3 H W"], rows: Int[Tensor, " B"]) -> Stages:
        teacher = self.teacher
        with self.autocast(images):
            batch, _ = teacher.prepare(images)
            features = teacher.features(batch)
            raw = teacher.of_anchors(features)
            proposals = [best[:PROPOSALS] for best in teacher.propose(batch, features, *raw)]
            judged = _judged(*teacher.of_proposals(batch, features, proposals))
        parts = [
            Answer(*part) for part in zip(*(p.split([len(b) for b in proposals]) for p in judged[:2]), strict=True)
        ]
        chosen = rows.tolist()
        return Stages(_anchors(*raw).of(rows), [proposals[k] for k in chosen], [parts[k] for k in chosen])

    def distance(
        self,
        images: Float[Tensor, "B 3 H W"],
        wanted: Stages,
        surer: Bool[Tensor, " B"] | None = None,
        sure: float = 0.0,
    ) -> Float[Tensor, " B"]:
        own = self.detector
        with self.autocast(images):
            batch, _ = own.prepare(images)
            features = own.features(batch)
            anchors = _anchors(*own.of_anchors(features))
            judged = _judged(*own.of_proposals(batch, features, wanted.proposals))
        image = torch.repeat_interleave(
            torch.arange(len(images), device=images.device),
            torch.tensor([len(boxes) for boxes in wanted.proposals], device=images.device),
        )
        goal = Answer(*(torch.cat(parts) for parts in zip(*(one[:2] for one in wanted.judged), strict=True)))
        reading = Reading(softmax=True, person=own.person, found_at=own.operating_point)
        each = answer_distance(judged, goal, reading, None if surer is None else surer[image], sure)
        return answer_distance(anchors, wanted.anchors, _OBJECTS).index_add(0, image, each)


def _anchors(logits: list[Tensor], deltas: list[Tensor]) -> Answer:
    count = len(logits[0])
    objects, boxes = concat_box_prediction_layers(logits, deltas)
    return Answer(at_least_float32(objects).view(count, -1, 1), at_least_float32(boxes).view(count, -1, 1, 4))


def _judged(logits: Float[Tensor, "n K"], deltas: Float[Tensor, "n K 4"]) -> Answer:
    return Answer(logits.unsqueeze(1), deltas.unsqueeze(1))
