"""torchvision's detectors as students, by the terms of their own losses (classes, boxes, centre-ness; of both stages
where there are two) at every anchor and proposal.

Their losses in training mode would want labels, draw anchors and proposals at random and let batch norm move; the same
terms between what two networks say want none of that, and are 0 before anything was learned.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torchvision.models.detection import FCOS
from torchvision.models.detection.rpn import concat_box_prediction_layers
from torchvision.models.detection.ssd import SSD

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.detectors.torchvision_family import DenseDetector, TwoStageDetector, write_torchvision
from cloak_core.studies.hardening.answers import Answer, Reading, Surer, answer_distance
from cloak_core.studies.hardening.student import Student

PROPOSALS = 128
"""Of an image: the teacher's best, of which the second stage of both is asked."""


class TorchvisionStudent(Student):
    """Any torchvision model; how it learns is its kind's."""

    files = (".pth",)

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

    def answer(self, detector: DenseDetector, images: Float[Tensor, "B 3 H W"]) -> Answer:
        with self.autocast(images):
            outputs, _ = detector.raw(detector.prepare(images)[0])
        trust = outputs["bbox_ctrness"][..., 0] if "bbox_ctrness" in outputs else None
        return Answer(outputs["cls_logits"], outputs["bbox_regression"].unsqueeze(2), trust)

    def compare(self, answer: Answer, wanted: Answer, surer: Surer | None) -> Float[Tensor, " B"]:
        own, point = self.detector, self.detector.operating_point
        # FCOS' score is the root of the product.
        found_at = point**2 if isinstance(own.model, FCOS) else point
        return answer_distance(answer, wanted, Reading(isinstance(own.model, SSD), own.person, found_at), surer)


class Stages(NamedTuple):
    """What a network says of B images."""

    anchors: Answer
    proposals: list[Float[Tensor, "_ 4"]]
    """The teacher's best of each image, best first."""
    judged: Answer
    """What the second stage says of all of these, one image's after the other's, one in the place of an image."""

    def of(self, rows: Int[Tensor, " b"]) -> Stages:
        """Select what is said of these images."""
        parts = [part.split([len(boxes) for boxes in self.proposals]) for part in self.judged[:2]]
        chosen = rows.tolist()
        judged = Answer(*(torch.cat([part[k] for k in chosen]) for part in parts))
        return Stages(self.anchors.of(rows), [self.proposals[k] for k in chosen], judged)


class TwoStageStudent(TorchvisionStudent):
    """Faster, Mask and Keypoint R-CNN; masks and keypoints do not learn."""

    detector: TwoStageDetector

    def answer(
        self,
        detector: TwoStageDetector,
        images: Float[Tensor, "B 3 H W"],
        proposals: list[Float[Tensor, "_ 4"]] | None = None,
    ) -> Stages:
        """Ask both stages; the second about these proposals, where none are given about the network's own best."""
        with self.autocast(images):
            batch, _ = detector.prepare(images)
            features = detector.features(batch)
            logits, deltas = detector.of_anchors(features)
            if proposals is None:
                proposals = [best[:PROPOSALS] for best in detector.propose(batch, features, logits, deltas)]
            kinds, boxes = detector.of_proposals(batch, features, proposals)
        objects, corners = map(at_least_float32, concat_box_prediction_layers(logits, deltas))
        count = len(images)
        anchors = Answer(objects.view(count, -1, 1), corners.view(count, -1, 1, 4))
        return Stages(anchors, proposals, Answer(kinds.unsqueeze(1), boxes.unsqueeze(1)))

    def distance(
        self, images: Float[Tensor, "B 3 H W"], wanted: Stages, surer: Surer | None = None
    ) -> Float[Tensor, " B"]:
        return self.compare(self.answer(self.detector, images, wanted.proposals), wanted, surer)

    def compare(self, answer: Stages, wanted: Stages, surer: Surer | None) -> Float[Tensor, " B"]:
        own, device = self.detector, answer.anchors.kinds.device
        counts = torch.tensor([len(boxes) for boxes in wanted.proposals], device=device)
        image = torch.repeat_interleave(torch.arange(len(counts), device=device), counts)
        if surer is not None:
            surer = surer._replace(images=surer.images[image])
        reading = Reading(softmax=True, person=own.person, found_at=own.operating_point)
        each = answer_distance(answer.judged, wanted.judged, reading, surer)
        return answer_distance(answer.anchors, wanted.anchors, Reading(softmax=False)).index_add(0, image, each)
