"""Which layout a model's outputs have, told from their shapes, names and values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import Tensor

from cloak_core.detectors.onnx_family.layouts import COCO_CLASSES, YOLO_STRIDES, Size, cells, strides_of

WIDEST_ROW = 7
"""Numbers of a box that is left after suppression, at most: image, class, score and corners."""
MOST_QUERIES = 1000
"""Most boxes with which transformers and end-to-end heads answer."""


def guess_layout(outputs: Mapping[str, Tensor], size: Size, class_count: int | None) -> str | None:
    """Guess the layout of one image's outputs; None where several fit or none.

    class_count: None where the file does not say.
    """
    shapes = [tuple(output.shape) for output in outputs.values()]
    if len(shapes) == 1:
        return _of_one(next(iter(outputs.values())), size, class_count)
    if len(shapes) == 2 and all(len(s) >= 3 for s in shapes) and any(s[-1] == 4 for s in shapes):
        return _of_two(outputs)
    if len(shapes) >= 4 and len({s[1:-1] for s in shapes}) == len(shapes) / 2 and len({s[-1] for s in shapes}) == 2:
        return "nanodet"
    # Others stand first among raw heads that are exported beside the decoded one (YOLOv5 does so).
    return _of_one(next(iter(outputs.values())), size, class_count) if len(shapes[0]) == 3 else None


def is_classifier(outputs: Mapping[str, Tensor], suppresses: str) -> bool:
    """Tell a network that says one thing of a whole image: a single row of many numbers, no place among them."""
    if len(outputs) != 1 or suppresses:
        return False
    shape = next(iter(outputs.values())).shape
    return len(shape) >= 2 and shape[0] == 1 and shape[1] > WIDEST_ROW and all(side == 1 for side in shape[2:])


def what_it_may_be(outputs: Mapping[str, Tensor], suppresses: str) -> str:
    """Describe outputs of no known layout in a clause; `suppresses` names a node that suppresses boxes, "" for none."""
    shapes = [tuple(output.shape) for output in outputs.values()]
    if suppresses or any(len(shape) < 3 for shape in shapes):
        node = f" (node {suppresses})" if suppresses else ""
        return f"boxes are suppressed in it{node}, which leaves nothing to train against: export it without"
    if len(shapes) == 3 and all(len(shape) == 5 or shape[1] % 3 == 0 for shape in shapes):
        return (
            "they look like a YOLO's raw heads, whose anchors the file does not say: yolov5-raw, yolov7-raw and "
            "yolov3-raw take the usual ones"
        )
    return ""


def _of_one(output: Tensor, size: Size, class_count: int | None) -> str | None:
    shape = tuple(output.shape)
    if len(shape) == 4 and shape[2] * 16 == size[0] and shape[3] * 16 == size[1]:
        return "fastestdet"
    if len(shape) != 3:
        return None
    if shape[2] == 6 and shape[1] <= MOST_QUERIES:
        return "end2end"
    if shape[1] < shape[2]:
        return "yolov8"
    if any(3 * cells(size, strides) == shape[1] for strides in YOLO_STRIDES):
        return "yolov5"
    if strides_of(shape[1], size) is None:
        return None
    return _of_rows(output, shape[2], class_count or COCO_CLASSES)


def _of_rows(output: Tensor, width: int, class_count: int) -> str | None:
    """Guess from outputs with a row for each cell of the usual grids."""
    if width in (5, 4 + class_count):  # five: a single class
        return "yolov8"
    if width == 5 + class_count:
        # YOLOX's own export leaves the logarithm of sizes, of which some are negative.
        return "yolox" if bool((output[..., 2:4] < 0).any()) else "yolov5"
    rest = width - class_count
    return "nanodet" if rest >= 16 and rest % 4 == 0 else None


def _of_two(outputs: Mapping[str, Tensor]) -> str:
    values: Sequence[Tensor] = list(outputs.values())
    scores = values[1] if values[0].shape[-1] == 4 else values[0]
    are_logits = bool(scores.min() < 0) or bool(scores.max() > 1)
    if scores.shape[1] > MOST_QUERIES or not are_logits:
        return "boxes-scores"
    # DETR has a class for "no object": 91 and 1 of COCO's own numbering; RT-DETR has none.
    return "rtdetr" if scores.shape[-1] == COCO_CLASSES else "detr"
