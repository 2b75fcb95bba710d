"""torchvision's detectors as students, by the terms of their own losses (classes, boxes, centre-ness; of both stages
where there are two) at every anchor and proposal.

Their losses in training mode would want labels, draw anchors and proposals at random and let batch norm move; the same
terms between what two networks say want none of that, and are 0 before anything was learned.
"""

from __future__ import annotations

from pathlib import Path

from jaxtyping import Float
from torch import Tensor, nn
from torchvision.models.detection import FCOS
from torchvision.models.detection.rpn import concat_box_prediction_layers
from torchvision.models.detection.ssd import SSD

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.detectors.torchvision_family import (
    DenseDetector,
    TorchvisionDetector,
    TwoStageDetector,
    write_torchvision,
)
from cloak_core.studies.hardening.answers import Answer, Stages, Surer
from cloak_core.studies.hardening.student import Student

PROPOSALS = 128
"""Of an image: the teacher's best, of which the second stage of both is asked."""


class TorchvisionStudent(Student):
    """RetinaNet, FCOS, SSD and SSDlite; Faster, Mask and Keypoint R-CNN, whose masks and keypoints do not learn."""

    files = (".pth",)

    def __init__(self, detector: TorchvisionDetector, teacher: TorchvisionDetector, spec: str) -> None:
        super().__init__(detector, teacher, spec)
        exclusive = isinstance(detector, TwoStageDetector) or isinstance(detector.model, SSD)
        # FCOS' score is the root of the product.
        root = isinstance(detector.model, FCOS)
        found_at = detector.operating_point**2 if root else detector.operating_point
        self.reading = self.reading._replace(softmax=exclusive, found_at=found_at)

    @property
    def network(self) -> nn.Module:
        return self.detector.model

    def save(self, stem: Path, seen: int) -> str:
        name = self.request.parts[0]
        write_torchvision(stem.with_suffix(".pth"), name, self.detector.model)
        return f"torchvision:{name}:{stem}.pth{self.options}"

    def answer(
        self,
        detector: DenseDetector | TwoStageDetector,
        images: Float[Tensor, "B 3 H W"],
        proposals: list[Float[Tensor, "_ 4"]] | None = None,
    ) -> Answer | Stages:
        """Ask the network; the second of two stages about these proposals, else about the network's own best."""
        with self.autocast(images):
            batch, _ = detector.prepare(images)
            if isinstance(detector, DenseDetector):
                outputs, _ = detector.raw(batch)
                trust = outputs["bbox_ctrness"][..., 0] if "bbox_ctrness" in outputs else None
                return Answer(outputs["cls_logits"], outputs["bbox_regression"].unsqueeze(2), trust)
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
        self, images: Float[Tensor, "B 3 H W"], wanted: Answer | Stages, surer: Surer | None = None
    ) -> Float[Tensor, " B"]:
        answer = self.answer(self.detector, images, getattr(wanted, "proposals", None))
        return answer.distance(wanted, self.reading, surer)
