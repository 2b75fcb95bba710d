"""Faster, Mask and Keypoint R-CNN: person scores of every proposal, before threshold and non-maximum suppression."""

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.rpn import concat_box_prediction_layers
from torchvision.ops import batched_nms, clip_boxes_to_image, remove_small_boxes

from cloak_core.core.detector.outcomes import best_other
from cloak_core.core.detector.protocol import Detections, at_least_float32
from cloak_core.detectors.torchvision_family.base import TorchvisionDetector

MIN_SIDE = 1e-2
"""The model drops boxes with a smaller side, in pixels of its input."""


class TwoStageDetector(TorchvisionDetector):
    """A torchvision GeneralizedRCNN. Masks and keypoints are not computed."""

    partial_gradient = "the places of proposals are held fixed, as in the model's own training"

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        batch, placement = self.prepare(images)
        features = self.features(batch)
        proposals = self.propose(batch, features, *self.of_anchors(features))
        logits, deltas = self.of_proposals(batch, features, proposals)
        size, places, counts = batch.image_sizes[0], torch.cat(proposals), [len(part) for part in proposals]

        def padded(rows: Tensor) -> Tensor:
            return pad_sequence(rows.split(counts), batch_first=True)

        classes = logits.softmax(dim=-1)
        boxes, scores = self._boxes(deltas[:, self.person], places, classes[:, self.person], size)
        found = Detections(boxes=padded(placement.restore(boxes)), scores=padded(scores))
        other = best_other(classes[None], self.person, self.first_class)
        if other.scores is None:
            return found
        # A box for each class: what else a proposal may be has rows of its own.
        number = other.number[0]
        own = deltas.gather(1, number[:, None, None].expand(-1, 1, 4))[:, 0]
        boxes, scores = self._boxes(own, places, other.scores[0], size)
        more, count = padded(scores), found.scores.shape[1]
        return Detections(
            boxes=torch.cat([found.boxes, padded(placement.restore(boxes))], dim=1),
            scores=F.pad(found.scores, (0, count)),
            other=F.pad(more, (count, 0)),
            other_class=F.pad(padded(number), (count, 0)),
        )

    def _boxes(
        self,
        deltas: Float[Tensor, "n 4"],
        places: Float[Tensor, "n 4"],
        scores: Float[Tensor, " n"],
        size: tuple[int, int],
    ) -> tuple[Float[Tensor, "n 4"], Float[Tensor, " n"]]:
        """Compute boxes in the network's input, and their scores, 0 for boxes that the model drops."""
        boxes = clip_boxes_to_image(self.model.roi_heads.box_coder.decode_single(deltas, places), size)
        return boxes, scores * ((boxes[:, 2:] - boxes[:, :2]) >= MIN_SIDE).all(dim=-1)

    def features(self, batch: ImageList) -> dict[str, Float[Tensor, "B C _ _"]]:
        """Compute the feature maps by level."""
        found = self.model.backbone(batch.tensors)
        return {"0": found} if isinstance(found, Tensor) else found

    def of_anchors(
        self, features: dict[str, Float[Tensor, "B C _ _"]]
    ) -> tuple[list[Float[Tensor, "B _ _ _"]], list[Float[Tensor, "B _ _ _"]]]:
        """Run the first stage on every anchor, by level: logits of an object, and offsets of its box."""
        return self.model.rpn.head(list(features.values()))

    def of_proposals(
        self, batch: ImageList, features: dict[str, Float[Tensor, "B C _ _"]], proposals: list[Float[Tensor, "_ 4"]]
    ) -> tuple[Float[Tensor, "n K"], Float[Tensor, "n K 4"]]:
        """Run the second stage on proposals, those of all images in a row.

        Logits of the classes, the background first, and for each class the offsets of its box.
        """
        head = self.model.roi_heads
        pooled = head.box_roi_pool(features, proposals, batch.image_sizes)
        logits, deltas = head.box_predictor(head.box_head(pooled))
        return at_least_float32(logits), at_least_float32(deltas.unflatten(1, (-1, 4)))

    def propose(
        self,
        batch: ImageList,
        features: dict[str, Float[Tensor, "B C _ _"]],
        logits: list[Float[Tensor, "B _ _ _"]],
        deltas: list[Float[Tensor, "B _ _ _"]],
    ) -> list[Float[Tensor, "_ 4"]]:
        """Choose each image's proposals from `of_anchors`, best first; constants, as in the model."""
        rpn = self.model.rpn
        anchors = rpn.anchor_generator(batch, list(features.values()))
        counts = [level[0].numel() for level in logits]
        flat_logits, flat_deltas = concat_box_prediction_layers(logits, deltas)
        boxes = rpn.box_coder.decode(at_least_float32(flat_deltas.detach()), anchors).view(len(anchors), -1, 4)
        objectness = at_least_float32(flat_logits.detach()).view(len(anchors), -1).sigmoid()
        clipped = [clip_boxes_to_image(*one) for one in zip(boxes, batch.image_sizes, strict=True)]
        return [b[self._keep(b, scores, counts)] for b, scores in zip(clipped, objectness, strict=True)]

    @torch.no_grad()
    def _keep(self, boxes: Float[Tensor, "A 4"], scores: Float[Tensor, " A"], counts: list[int]) -> Int[Tensor, " n"]:
        """Choose the anchors that become proposals: the best per level, after suppression within levels."""
        rpn = self.model.rpn
        picked, levels, offset = [], [], 0
        for level, part in enumerate(scores.split(counts)):
            top = part.topk(min(rpn.pre_nms_top_n(), len(part))).indices
            picked.append(top + offset)
            levels.append(torch.full_like(top, level))
            offset += len(part)
        index, level_of = torch.cat(picked), torch.cat(levels)
        large = remove_small_boxes(boxes[index], rpn.min_size)
        large = large[scores[index[large]] >= rpn.score_thresh]
        index, level_of = index[large], level_of[large]
        kept = batched_nms(boxes[index], scores[index], level_of, rpn.nms_thresh)[: rpn.post_nms_top_n()]
        return index[kept]
