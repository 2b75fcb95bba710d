"""torchvision's detection models: scores of every proposal or of the best anchors, before threshold and suppression."""

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence
from torchvision.models.detection import FCOS
from torchvision.models.detection.image_list import ImageList
from torchvision.models.detection.rpn import concat_box_prediction_layers
from torchvision.models.detection.ssd import SSD
from torchvision.ops import batched_nms, clip_boxes_to_image, remove_small_boxes

from cloak_core.core.detector.outcomes import best_other
from cloak_core.core.detector.protocol import Detections, Detector, at_least_float32
from cloak_core.detectors.pixels import Placement

CANDIDATES = 1000
"""Anchors kept per feature level, the ones with the best person score."""
MIN_SIDE = 1e-2
"""The model drops boxes with a smaller side, in pixels of its input."""


class TorchvisionDetector(Detector):
    """A torchvision model that scores class `person`; `channels_last` is the layout of its images and weights."""

    first_class = 1
    """Where classes begin that are something; before it stands the background, if any."""

    def __init__(self, model: nn.Module, person: int, name: str, spec: str, channels_last: bool = True) -> None:
        super().__init__(name, spec)
        self.person = person
        self.memory_format = torch.channels_last if channels_last else torch.contiguous_format
        self.model = model.to(memory_format=self.memory_format)

    def prepare(self, images: Float[Tensor, "B 3 H W"]) -> tuple[ImageList, Placement]:
        """Resize and normalise by the model's own transform; say where the images lie in its input."""
        batch, _ = self.model.transform(list(images))
        batch.tensors = batch.tensors.contiguous(memory_format=self.memory_format)
        height, width = batch.image_sizes[0]
        return batch, Placement(scale_x=width / images.shape[3], scale_y=height / images.shape[2])


def _with_others(
    persons: Detections, boxes: Float[Tensor, "B m 4"], scores: Float[Tensor, "B m"], number: Int[Tensor, "B m"]
) -> Detections:
    """Add rows of other classes, which have boxes of their own: each row is of a person or of another class alone."""
    count = persons.scores.shape[1]
    return Detections(
        boxes=torch.cat([persons.boxes, boxes], dim=1),
        scores=F.pad(persons.scores, (0, scores.shape[1])),
        other=F.pad(scores, (count, 0)),
        other_class=F.pad(number, (count, 0)),
    )


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
        found = Detections(self._boxes(outputs, anchors, kept, batch, placement), scores.gather(1, kept))
        if other.scores is None:
            return found
        # Among the best persons there may be none of the anchors that show something else.
        scores = self._scores(other.scores, outputs)
        kept = _best_per_level(scores, counts)
        boxes = self._boxes(outputs, anchors, kept, batch, placement)
        return _with_others(found, boxes, scores.gather(1, kept), other.number.gather(1, kept))

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
        return _with_others(found, padded(placement.restore(boxes)), padded(scores), padded(number))

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
