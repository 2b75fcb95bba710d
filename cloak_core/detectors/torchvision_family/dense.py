"""RetinaNet, FCOS, SSD and SSDlite: person scores of the best anchors, before threshold and suppression."""

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor
from torchvision.models.detection import FCOS
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.ssd import SSD
from torchvision.ops import clip_boxes_to_image

from cloak_core.core.detector.outcomes import best_other
from cloak_core.core.detector.protocol import Detections, at_least_float32
from cloak_core.detectors.pixels import Placement
from cloak_core.detectors.torchvision_family.base import TorchvisionDetector

CANDIDATES = 1000
"""Anchors kept per feature level, the ones with the best person score."""


class DenseDetector(TorchvisionDetector):
    """A torchvision RetinaNet, FCOS or SSD."""

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        batch, placement = self.prepare(images)
        outputs, levels = self.raw(batch)
        anchors = self.model.anchor_generator(batch, levels)[0]
        classes = self._classes(outputs)
        scores = self._scores(classes[..., self.person], outputs)
        other = best_other(classes, self.person, self.first_class)
        cells = [level.shape[2] * level.shape[3] for level in levels]
        per_cell, rest = divmod(len(anchors), sum(cells))
        # SSD's levels differ in anchors per cell: all of its anchors are one level here.
        counts = [len(anchors)] if rest else [count * per_cell for count in cells]
        kept = _best_per_level(scores, counts)
        count, found = kept.shape[1], scores.gather(1, kept)
        if other.scores is None:
            return Detections(self._boxes(outputs, anchors, kept, batch, placement), found)
        # Rows of their own: among the best persons there may be none of the anchors that show something else.
        scores = self._scores(other.scores, outputs)
        kept = torch.cat([kept, _best_per_level(scores, counts)], dim=1)
        more = scores.gather(1, kept[:, count:])
        return Detections(
            boxes=self._boxes(outputs, anchors, kept, batch, placement),
            scores=F.pad(found, (0, more.shape[1])),
            other=F.pad(more, (count, 0)),
            other_class=other.number.gather(1, kept),
        )

    def _boxes(
        self,
        outputs: dict[str, Tensor],
        anchors: Float[Tensor, "A 4"],
        kept: Int[Tensor, "B n"],
        batch: ImageList,
        placement: Placement,
    ) -> Float[Tensor, "B n 4"]:
        """Compute boxes of these anchors, in pixels of the images."""
        deltas = outputs["bbox_regression"].gather(1, kept[..., None].expand(-1, -1, 4)).reshape(-1, 4)
        boxes = self._decode(deltas, anchors[kept.reshape(-1)])
        boxes = placement.restore(clip_boxes_to_image(boxes, batch.image_sizes[0]))
        return boxes.view(*kept.shape, 4)

    def raw(self, batch: ImageList) -> tuple[dict[str, Float[Tensor, "B A _"]], list[Tensor]]:
        """Run the heads: every anchor's values before any activation, at least float32, and the feature maps."""
        features = self.model.backbone(batch.tensors)
        levels = [features] if isinstance(features, Tensor) else list(features.values())
        return {key: at_least_float32(value) for key, value in self.model.head(levels).items()}, levels

    def _classes(self, outputs: dict[str, Tensor]) -> Float[Tensor, "B A K"]:
        """Rank an anchor's classes: by probabilities where they exclude each other, else by logits."""
        logits = outputs["cls_logits"]
        return logits.softmax(dim=-1) if isinstance(self.model, SSD) else logits

    def _scores(self, ranks: Float[Tensor, "B A"], outputs: dict[str, Tensor]) -> Float[Tensor, "B A"]:
        """Turn one class's numbers of `_classes` into its scores, as the model thresholds them."""
        if isinstance(self.model, SSD):
            return ranks
        if isinstance(self.model, FCOS):
            # The model's sqrt(p * q), written so that its gradient stays finite where p * q underflows.
            return (0.5 * (F.logsigmoid(ranks) + F.logsigmoid(outputs["bbox_ctrness"][..., 0]))).exp()
        return ranks.sigmoid()

    def _decode(self, deltas: Float[Tensor, "n 4"], anchors: Float[Tensor, "n 4"]) -> Float[Tensor, "n 4"]:
        coder = self.model.box_coder
        return coder.decode(deltas, anchors) if isinstance(self.model, FCOS) else coder.decode_single(deltas, anchors)


def _best_per_level(scores: Float[Tensor, "B A"], counts: list[int]) -> Int[Tensor, "B n"]:
    """Choose the anchors with the best scores of each feature level; counts: its anchors."""
    best = []
    first = 0
    for level in scores.detach().split(counts, dim=1):
        best.append(level.topk(min(CANDIDATES, level.shape[1]), dim=1).indices + first)
        first += level.shape[1]
    return torch.cat(best, dim=1)
