"""What the outputs of a network's file mean: a table of the layouts that exporters write, and which one a file has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.classes import COCO, COCO_IDS
from cloak_core.detectors.onnx_family.decoders import (
    YOLO_STRIDES,
    BoxesScores,
    Decode,
    NanoDet,
    Queries,
    RawYolo,
    Size,
    YoloRows,
    are_logits,
    boxes_labels,
    cells,
    detection_rows,
    end2end,
    fastestdet,
    mediapipe_pose,
    strides_of,
    tflite_ssd,
    yolox,
)
from cloak_core.detectors.pixels import IMAGENET, YOLO_GREY, PixelFormat

AS_THEY_ARE = PixelFormat()
NANODET = PixelFormat(bgr=True, range=255.0, mean=(103.53, 116.28, 123.675), std=(57.375, 57.12, 58.395))
OPEN_MODEL_ZOO = PixelFormat(bgr=True, range=255.0)
"""How its networks want pixels; they stretch images, too."""
SYMMETRIC = PixelFormat(mean=(0.5, 0.5, 0.5), std=(0.5, 0.5, 0.5))
"""Pixels in [-1, 1]."""


@dataclass(frozen=True)
class Layout:
    """How one kind of export is fed and read."""

    decode: Decode
    confidence: float
    """The score above which its family usually reports a box."""
    letterbox: bool = False
    """Whether its family keeps the aspect ratio of images."""
    pixels: PixelFormat = AS_THEY_ARE
    fill: float = YOLO_GREY
    """What letterboxed images lie on."""
    chosen: bool = False
    """Its rows are chosen boxes with the number of their class; how many classes there are is not told."""
    names: tuple[str, ...] | None = None
    """Names of such classes where nobody says."""

    def settled(self, outputs: Sequence[Tensor]) -> Decode:
        """Settle from outputs of a real image what exports of the layout differ in."""
        settle = getattr(self.decode, "settled", None)
        return self.decode if settle is None else settle(outputs)


COCO_ANCHORS = (
    ((10, 13), (16, 30), (33, 23)),
    ((30, 61), (62, 45), (59, 119)),
    ((116, 90), (156, 198), (373, 326)),
)
"""Of YOLOv3 (its paper, section 2.3) and, by default, YOLOv5; at 416 and 640 pixels."""
YOLOV7_ANCHORS = (
    ((12, 16), (19, 36), (40, 28)),
    ((36, 75), (76, 55), (72, 146)),
    ((142, 110), (192, 243), (459, 401)),
)
END_TO_END = "end2end"
LAYOUTS: dict[str, Layout] = {
    "yolov5": Layout(YoloRows(objectness=True), 0.25, letterbox=True),
    "yolov8": Layout(YoloRows(objectness=False), 0.25, letterbox=True),
    "yolox": Layout(yolox, 0.25, letterbox=True, pixels=PixelFormat(bgr=True, range=255.0)),
    END_TO_END: Layout(end2end, 0.25, letterbox=True, chosen=True, names=COCO),
    "detr": Layout(Queries(exclusive=True), 0.5, pixels=PixelFormat(mean=IMAGENET[0], std=IMAGENET[1])),
    "rtdetr": Layout(Queries(exclusive=False), 0.5),
    "nanodet": Layout(NanoDet(), 0.4, pixels=NANODET),
    "fastestdet": Layout(fastestdet, 0.65, pixels=PixelFormat(bgr=True)),
    "yolov3-raw": Layout(RawYolo(COCO_ANCHORS, exponential=True), 0.25, letterbox=True),
    "yolov5-raw": Layout(RawYolo(COCO_ANCHORS), 0.25, letterbox=True),
    "yolov7-raw": Layout(RawYolo(YOLOV7_ANCHORS), 0.25, letterbox=True),
    "boxes-scores": Layout(BoxesScores(), 0.5),
    "detection-rows": Layout(detection_rows, 0.5, pixels=OPEN_MODEL_ZOO, chosen=True),
    "boxes-labels": Layout(boxes_labels, 0.5, pixels=OPEN_MODEL_ZOO, chosen=True),
    "tflite-ssd": Layout(tflite_ssd, 0.5, pixels=SYMMETRIC, chosen=True, names=COCO_IDS[1:]),
    "mediapipe-pose": Layout(mediapipe_pose, 0.5, letterbox=True, pixels=SYMMETRIC, fill=0.0),
}
"""By the name that a spec may say."""
MOST_QUERIES = 1000
"""Most boxes with which transformers and end-to-end heads answer."""


def guess_layout(outputs: Sequence[Tensor], size: Size, class_count: int) -> str | None:
    """Guess the layout of one image's outputs from shapes and values; None where several fit or none.

    class_count: 0 where nobody says.
    """
    match shapes := [tuple(output.shape) for output in outputs]:
        case [(1, 1, _, 7)]:
            return "detection-rows"
        case [(1, n, 4), (1, m), (1, k), (1,)] if n == m == k:
            return "tflite-ssd"
        case [(1, n, 12), (1, m, 1)] | [(1, m, 1), (1, n, 12)] if n == m:
            return "mediapipe-pose"
        case [(n, 5), (m,)] | [(m,), (n, 5)] if n == m:
            return "boxes-labels"
        case [(_, _, *_, 4), (_, _, _, *_)] | [(_, _, _, *_), (_, _, *_, 4)]:
            scores = outputs[1] if outputs[0].shape[-1] == 4 else outputs[0]
            if scores.shape[1] > MOST_QUERIES or not are_logits(scores):
                return "boxes-scores"
            # DETR has a class for "no object": 91 and 1 of COCO's own numbering; RT-DETR has none.
            return "rtdetr" if scores.shape[-1] == len(COCO) else "detr"
        case [(_, _, height, width)]:
            return "fastestdet" if (16 * height, 16 * width) == tuple(size) else None
    if len(shapes) >= 4 and len({s[1:-1] for s in shapes}) == len(shapes) / 2 and len({s[-1] for s in shapes}) == 2:
        return "nanodet"
    # Others stand first among raw heads that are exported beside the decoded one (YOLOv5 does so).
    return _guess_of_rows(outputs[0], size, class_count) if len(shapes[0]) == 3 and len(shapes) != 2 else None


def _guess_of_rows(output: Float[Tensor, "B N C"], size: Size, class_count: int) -> str | None:
    _, count, width = output.shape
    if width == 6 and count <= MOST_QUERIES:
        return END_TO_END
    if count < width:
        return "yolov8"
    if any(3 * cells(size, strides) == count for strides in YOLO_STRIDES):
        return "yolov5"
    classes = class_count or len(COCO)
    if strides_of(count, size) is None:
        return None
    if width in (5, 4 + classes):  # five: a single class
        return "yolov8"
    if width == 5 + classes:
        # YOLOX's own export leaves the logarithm of sizes, of which some are negative.
        return "yolox" if bool((output[..., 2:4] < 0).any()) else "yolov5"
    rest = width - classes
    return "nanodet" if rest >= 16 and rest % 4 == 0 else None


def why_unknown(outputs: Sequence[Tensor], suppresses: str) -> str:
    """Say in a clause why outputs have no known layout, "" for no idea; `suppresses` names a node that suppresses."""
    shapes = [tuple(output.shape) for output in outputs]
    if suppresses or any(len(shape) < 3 for shape in shapes):
        node = f" (node {suppresses})" if suppresses else ""
        return f"boxes are suppressed in it{node}, which leaves nothing to train against: export it without"
    if len(shapes) == 3 and all(len(shape) == 5 or shape[1] % 3 == 0 for shape in shapes):
        return (
            "they look like a YOLO's raw heads, whose anchors the file does not say: yolov5-raw, yolov7-raw and "
            "yolov3-raw take the usual ones"
        )
    return ""
