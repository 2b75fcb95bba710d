"""Faster, Mask and Keypoint R-CNN: person scores of every proposal, before threshold and non-maximum suppression."""

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.rpn import concat_box_prediction_layers
from torchvision.ops import batched_nms, clip_boxes_to_image, remove_small_boxes

from cloak_core.detectors.protocol import Detections, at_least_float32
from cloak_core.detectors.torchvision_family.base import TorchvisionDetector

MIN_SIDE = 1e-2
"""The model drops boxes with a smaller side, in pixels of its input."""


class TwoStageDetector(TorchvisionDetector):
    """A torchvision GeneralizedRCNN. Masks and keypoints are not computed."""

    partial_gradient = "the places of proposals are held fixed, as in the model's own training"

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        batch, placement = self.prepare(images)
        features = self.features(batch)
        proposals, objectness = self.propose(batch, features, *self.of_anchors(features))
        logits, deltas = self.of_proposals(batch, features, proposals)
        coder, size = self.model.roi_heads.box_coder, batch.image_sizes[0]
        boxes = clip_boxes_to_image(coder.decode_single(deltas[:, self.person], torch.cat(proposals)), size)
        scores = logits.softmax(dim=-1)[:, self.person]
        scores = scores * ((boxes[:, 2:] - boxes[:, :2]) >= MIN_SIDE).all(dim=-1)
        counts = [len(part) for part in proposals]
        return Detections(
            boxes=pad_sequence(placement.restore(boxes).split(counts), batch_first=True),
            scores=pad_sequence(scores.split(counts), batch_first=True),
            proposal_scores=pad_sequence(objectness, batch_first=True),
        )

    def features(self, batch: ImageList) -> dict[str, Float[Tensor, "B C _ _"]]:
        """Feature maps by level."""
        found = self.model.backbone(batch.tensors)
        return {"0": found} if isinstance(found, Tensor) else found

    def of_anchors(
        self, features: dict[str, Float[Tensor, "B C _ _"]]
    ) -> tuple[list[Float[Tensor, "B _ _ _"]], list[Float[Tensor, "B _ _ _"]]]:
        """What the first stage says of every anchor, by level: logits of an object, and where its box is from there."""
        return self.model.rpn.head(list(features.values()))

    def of_proposals(
        self, batch: ImageList, features: dict[str, Float[Tensor, "B C _ _"]], proposals: list[Float[Tensor, "_ 4"]]
    ) -> tuple[Float[Tensor, "n K"], Float[Tensor, "n K 4"]]:
        """What the second stage says of proposals, those of all images in a row: logits of the classes, the background
        first, and for each class where its box is from there."""
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
    ) -> tuple[list[Float[Tensor, "_ 4"]], list[Float[Tensor, "_"]]]:
        """Per image, from `of_anchors`, the proposals (constants, as in the model), best first, and their objectness
        (differentiable)."""
        rpn = self.model.rpn
        anchors = rpn.anchor_generator(batch, list(features.values()))
        counts = [level[0].numel() for level in logits]
        flat_logits, flat_deltas = concat_box_prediction_layers(logits, deltas)
        boxes = rpn.box_coder.decode(at_least_float32(flat_deltas.detach()), anchors).view(len(anchors), -1, 4)
        objectness = at_least_float32(flat_logits).view(len(anchors), -1).sigmoid()
        proposals, scores = [], []
        for image_boxes, image_scores, size in zip(boxes, objectness, batch.image_sizes, strict=True):
            clipped = clip_boxes_to_image(image_boxes, size)
            kept = self._keep(clipped, image_scores.detach(), counts)
            proposals.append(clipped[kept])
            scores.append(image_scores[kept])
        return proposals, scores

    @torch.no_grad()
    def _keep(self, boxes: Float[Tensor, "A 4"], scores: Float[Tensor, "A"], counts: list[int]) -> Int[Tensor, "n"]:
        """Indices of the anchors that become proposals: the best per level, after suppression within levels."""
        rpn = self.model.rpn
        picked, levels, offset = [], [], 0
        for level, part in enumerate(scores.split(counts)):
            top = part.topk(min(rpn.pre_nms_top_n(), len(part))).indices
            picked.append(top + offset)
            levels.append(torch.full_like(top, level))
            offset += len(part)
        index, level_of = torch.cat(picked), torch.cat(levels)
        for keep in (remove_small_boxes(boxes[index], rpn.min_size), None):
            if keep is None:
                keep = torch.where(scores[index] >= rpn.score_thresh)[0]
            index, level_of = index[keep], level_of[keep]
        kept = batched_nms(boxes[index], scores[index], level_of, rpn.nms_thresh)[: rpn.post_nms_top_n()]
        return index[kept]
