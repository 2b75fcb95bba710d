"""RetinaNet, FCOS, SSD and SSDlite: person scores of the best anchors, before threshold and suppression."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor
from torchvision.models.detection import FCOS
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.ssd import SSD
from torchvision.ops import clip_boxes_to_image

from cloak_core.detectors.protocol import Detections, at_least_float32
from cloak_core.detectors.torchvision_family.base import TorchvisionDetector

CANDIDATES = 1000
"""Anchors kept per feature level, the ones with the best person score."""


class DenseDetector(TorchvisionDetector):
    """A torchvision RetinaNet, FCOS or SSD."""

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        batch, placement = self.prepare(images)
        outputs, levels = self.raw(batch)
        anchors = self.model.anchor_generator(batch, levels)[0]
        scores = self._scores(outputs)
        counts = _anchors_per_level(levels, len(anchors))
        kept = torch.cat([_best(part) + start for part, start in _levels(scores, counts)], dim=1)
        rows = kept.reshape(-1)
        deltas = outputs["bbox_regression"].gather(1, kept[..., None].expand(-1, -1, 4)).reshape(-1, 4)
        boxes = self._decode(deltas, anchors[rows])
        boxes = placement.restore(clip_boxes_to_image(boxes, batch.image_sizes[0]))
        return Detections(boxes=boxes.view(*kept.shape, 4), scores=scores.gather(1, kept))

    def raw(self, batch: ImageList) -> tuple[dict[str, Float[Tensor, "B A _"]], list[Tensor]]:
        """What the heads say before any activation, at least float32, of every anchor; and the feature maps."""
        features = self.model.backbone(batch.tensors)
        levels = [features] if isinstance(features, Tensor) else list(features.values())
        return {key: at_least_float32(value) for key, value in self.model.head(levels).items()}, levels

    def _scores(self, outputs: dict[str, Tensor]) -> Float[Tensor, "B A"]:
        logits = outputs["cls_logits"]
        if isinstance(self.model, SSD):
            return logits.softmax(dim=-1)[..., self.person]
        person = logits[..., self.person]
        if isinstance(self.model, FCOS):
            # The model's sqrt(p * q), written so that its gradient stays finite where p * q underflows.
            return (0.5 * (F.logsigmoid(person) + F.logsigmoid(outputs["bbox_ctrness"][..., 0]))).exp()
        return person.sigmoid()

    def _decode(self, deltas: Float[Tensor, "n 4"], anchors: Float[Tensor, "n 4"]) -> Float[Tensor, "n 4"]:
        coder = self.model.box_coder
        return coder.decode(deltas, anchors) if isinstance(self.model, FCOS) else coder.decode_single(deltas, anchors)


def _anchors_per_level(levels: list[Tensor], anchors: int) -> list[int] | None:
    """How many anchors each feature level has; None where levels differ in anchors per cell (SSD)."""
    cells = [level.shape[2] * level.shape[3] for level in levels]
    per_cell, rest = divmod(anchors, sum(cells))
    return None if rest else [count * per_cell for count in cells]


def _levels(scores: Float[Tensor, "B A"], counts: list[int] | None):
    """The scores of each level and the index of its first anchor."""
    start = 0
    for part in scores.split(counts or [scores.shape[1]], dim=1):
        yield part, start
        start += part.shape[1]


def _best(scores: Float[Tensor, "B n"]) -> Tensor:
    return scores.detach().topk(min(CANDIDATES, scores.shape[1]), dim=1).indices
