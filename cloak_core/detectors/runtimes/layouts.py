"""Outputs that only files of other runtimes have: SSD's detection layer, MediaPipe's anchors, suppressed rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.decoding import Decoded, cell_places, corners, in_pixels
from cloak_core.detectors.onnx_family.layouts import LAYOUTS, Layout, Size
from cloak_core.detectors.pixels import PixelFormat

OPEN_MODEL_ZOO = PixelFormat(bgr=True, range=255.0)
"""How its networks want pixels; they stretch images, too."""
SYMMETRIC = PixelFormat(mean=(0.5, 0.5, 0.5), std=(0.5, 0.5, 0.5))
"""Pixels in [-1, 1]."""
POSE_STRIDES = (8, 16, 32, 32, 32)
"""Of MediaPipe's pose detector, two anchors a cell each (its pose_detection_cpu.pbtxt)."""
POSE_WIDTH = 0.4
"""Of a person's width to her length: the network tells no width."""
LOGIT_LIMIT = 100.0
"""MediaPipe clips logits to this."""


@dataclass(frozen=True)
class SsdHead:
    """The inputs of OpenVINO's DetectionOutput: offsets [1, 4 N], class scores [1, N K], priors [1, 2, 4 N].

    Decoding as in SSD (Liu et al., arXiv:1512.02325, section 2.2): every box, before threshold and suppression.
    """

    classes: int
    """With the background."""
    background: int
    """Its index; -1: none."""
    center_size: bool
    """Offsets are of centre and log size, not of corners."""
    scaled: bool
    """Offsets are multiplied by the priors' variances."""

    def __call__(self, outputs: Sequence[Tensor], size: Size) -> Decoded:
        offsets, scores = outputs[0].view(len(outputs[0]), -1, 4), outputs[1].view(len(outputs[1]), -1, self.classes)
        priors, variances = outputs[2].view(len(outputs[2]), 2, -1, 4).unbind(1)
        offsets = offsets * variances if self.scaled else offsets
        if self.center_size:
            extent = priors[..., 2:] - priors[..., :2]
            centre = (priors[..., :2] + priors[..., 2:]) / 2 + offsets[..., :2] * extent
            boxes = corners(torch.cat([centre, offsets[..., 2:].exp() * extent], dim=-1))
        else:
            boxes = priors + offsets
        kept = [number for number in range(self.classes) if number != self.background]
        return Decoded(in_pixels(boxes, size), scores[..., kept])


def detection_rows(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode rows [1, 1, N, 7] after suppression: image (-1 ends them), class (from 1), score, corners as fractions."""
    rows = outputs[0].flatten(1, 2) if outputs[0].dim() == 4 else outputs[0]
    # Whatever stands behind the end is left over from another image.
    there = (rows[..., 0] >= 0).cummin(dim=1).values
    return Decoded(in_pixels(rows[..., 3:7], size), _one_hot(rows[..., 1] - 1, rows[..., 2] * there))


def boxes_labels(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode boxes [N, 5] after suppression (corners in pixels of the input, score) and their classes [N]."""
    boxes, labels = sorted((output.reshape(-1, output.shape[-1]) for output in outputs[:2]), key=lambda o: -o.shape[1])
    boxes = boxes.view(1, -1, 5)
    return Decoded(boxes[..., :4], _one_hot(labels.reshape(1, -1), boxes[..., 4]))


def tflite_ssd(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode TFLite_Detection_PostProcess: boxes [1, N, 4], classes, scores, count.

    Boxes are top, left, bottom, right, as fractions.
    """
    boxes, classes, scores, count = outputs[:4]
    there = torch.arange(scores.shape[1]) < count.reshape(-1, 1)
    return Decoded(in_pixels(boxes[..., [1, 0, 3, 2]], size), _one_hot(classes, scores * there))


def mediapipe_pose(outputs: Sequence[Tensor], size: Size) -> Decoded:
    """Decode MediaPipe's pose detector: regressors [1, N, 12] and logits [1, N, 1]; only persons.

    Its own box is a square on the face, so the person's is made of two key points: the middle of the hips, and the end
    of a radius around the whole body; the box around a rectangle of that axis.
    """
    raw, logits = sorted(outputs[:2], key=lambda output: -output.shape[-1])
    anchors = _pose_anchors(size).to(raw)
    hips, end = (raw[..., k : k + 2] + anchors for k in (4, 6))
    half = (end - hips).abs()
    half = half + POSE_WIDTH * half.flip(-1)
    boxes = torch.cat([hips - half, hips + half], dim=-1)
    return Decoded(boxes, logits.clamp(-LOGIT_LIMIT, LOGIT_LIMIT).sigmoid())


def _pose_anchors(size: Size) -> Float[Tensor, "N 2"]:
    """Compute the centres of MediaPipe's anchors, pixels: layers of one stride stand cell by cell."""
    found = []
    for stride in dict.fromkeys(POSE_STRIDES):
        middles = (cell_places(size[0] // stride, size[1] // stride).view(-1, 2) + 0.5) * stride
        found.append(middles.repeat_interleave(2 * POSE_STRIDES.count(stride), dim=0))
    return torch.cat(found)


def _one_hot(numbers: Float[Tensor, "B N"], scores: Float[Tensor, "B N"]) -> Float[Tensor, "B N K"]:
    """Put each row's score in the place of its class; at least 91 places, so that images agree on their number."""
    index = numbers.round().long().clamp(min=0)
    count = max(91, int(index.max()) + 1 if index.numel() else 0)
    return F.one_hot(index, count) * scores[..., None]


RUNTIME_LAYOUTS: dict[str, Layout] = LAYOUTS | {
    "detection-rows": Layout(detection_rows, 0.5, pixels=OPEN_MODEL_ZOO),
    "boxes-labels": Layout(boxes_labels, 0.5, pixels=OPEN_MODEL_ZOO),
    "tflite-ssd": Layout(tflite_ssd, 0.5, pixels=SYMMETRIC),
    "mediapipe-pose": Layout(mediapipe_pose, 0.5, letterbox=True, pixels=SYMMETRIC, fill=0.0),
}
"""By the name that a spec may say."""
AFTER_SUPPRESSION = ("detection-rows", "boxes-labels", "tflite-ssd")
"""Layouts that do not say how many classes there are."""


def runtime_layout(shapes: Sequence[tuple[int, ...]]) -> str | None:
    """Tell a layout that only these runtimes have from the outputs' shapes; None for none of them."""
    match shapes:
        case [(1, 1, _, 7)]:
            return "detection-rows"
        case [(1, n, 4), (1, m), (1, k), (1,)] if n == m == k:
            return "tflite-ssd"
        case [(1, n, 12), (1, m, 1)] | [(1, m, 1), (1, n, 12)] if n == m:
            return "mediapipe-pose"
        case [(n, 5), (m,)] | [(m,), (n, 5)] if n == m:
            return "boxes-labels"
    return None
