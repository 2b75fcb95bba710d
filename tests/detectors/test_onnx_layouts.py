"""Every layout of outputs, on arrays whose boxes are known; and which one an export has."""

import math

import pytest
import torch
from torch import Tensor

from cloak_core.detectors.onnx_family.decoders import cells
from cloak_core.detectors.onnx_family.layouts import LAYOUTS, guess_layout

SIZE = (64, 96)
BOX = [8.0, 16.0, 40.0, 48.0]
"""The one box, xyxy pixels; it shows the second of two classes with probability 0.72."""
CENTRE = [24.0, 32.0, 32.0, 32.0]
FRACTIONS = [CENTRE[0] / 96, CENTRE[1] / 64, CENTRE[2] / 96, CENTRE[3] / 64]
COUNT = cells(SIZE, (8, 16, 32))


def logit(p: float) -> float:
    return math.log(p / (1 - p))


def rows(count: int, width: int, row: list[float], at: int = 3) -> Tensor:
    values = torch.zeros(1, count, width)
    values[0, at] = torch.tensor(row)
    return values


def nanodet_rows(probability: float, rest: float) -> Tensor:
    """The cell in column 2, row 3 of stride 8 has its middle at (20, 28): distances of 1.5, 1.5, 2.5, 2.5 cells."""
    values = torch.full((1, COUNT, 2 + 32), -30.0)
    values[..., :2] = rest
    at = 3 * 12 + 2
    values[0, at, 1] = probability
    for side, distance in enumerate((1.5, 1.5, 2.5, 2.5)):
        low = int(distance)
        values[0, at, 2 + 8 * side + low : 2 + 8 * side + low + 2] = 0.0  # half of each
    return values


def fastestdet_grid() -> Tensor:
    """The cell in column 1, row 2 of a 4 x 6 grid, its centre moved half a cell right and none down."""
    grid = torch.zeros(1, 7, 4, 6)
    grid[0, :, 2, 1] = torch.tensor([0.72, math.atanh(0.5), 0.0, logit(1 / 3), logit(0.5), 0.1, 0.72])
    return grid


OUTPUTS = {
    "yolov5": [rows(3 * COUNT, 7, [*CENTRE, 0.9, 0.1, 0.8])],
    "yolov8": [rows(COUNT, 6, [*CENTRE, 0.1, 0.72]).transpose(1, 2)],
    "yolox": [rows(COUNT, 7, [0.0, 0.0, math.log(4), math.log(4), 0.9, 0.1, 0.8], at=4 * 12 + 3)],
    "end2end": [rows(300, 6, [*BOX, 0.72, 1.0])],
    "detr": [
        rows(100, 4, FRACTIONS),
        rows(100, 3, [0.0, logit(0.72) + math.log(2), 0.0]) + torch.tensor([0.0, 0, 9e-9]),
    ],
    "rtdetr": [rows(100, 80, [-20.0, logit(0.72)] + [-20.0] * 78) - rows(100, 80, [0.0] * 80), rows(100, 4, FRACTIONS)],
    "nanodet": [nanodet_rows(0.72, 0.0)],
    "fastestdet": [fastestdet_grid()],
    "boxes-scores": [rows(2000, 4, BOX), rows(2000, 2, [0.1, 0.72])],
}


def best(name: str, outputs: list[Tensor]) -> tuple[list[float], float]:
    decoded = LAYOUTS[name].settled(outputs)(outputs, SIZE)
    assert decoded.boxes.shape[:2] == decoded.scores.shape[:2]
    at = int(decoded.scores[0, :, 1].argmax())
    return decoded.boxes[0, at].tolist(), float(decoded.scores[0, at, 1])


@pytest.mark.parametrize("name", OUTPUTS)
def test_boxes_and_probabilities(name: str) -> None:
    """YOLOX's box is that of column 3, row 4 of stride 8, four cells wide; FastestDet's is as large."""
    box, score = best(name, OUTPUTS[name])
    assert box == pytest.approx(BOX, abs=1e-3)
    assert score == pytest.approx(0.72, abs=1e-4)


@pytest.mark.parametrize("five", [False, True])
@pytest.mark.parametrize(
    ("name", "centre", "extent"),
    [
        ("yolov5-raw", (2 * 0.6 - 0.5 + 4, 2 * 0.5 - 0.5 + 1), (62 * 1.2**2, 45 * 1.0)),
        ("yolov7-raw", (2 * 0.6 - 0.5 + 4, 2 * 0.5 - 0.5 + 1), (76 * 1.2**2, 55 * 1.0)),
        ("yolov3-raw", (0.6 + 4, 0.5 + 1), (62 * 1.5, 45 * 1.0)),  # exp(logit(0.6)) is 0.6 / 0.4
    ],
)
def test_raw_yolo_heads(name: str, centre: tuple, extent: tuple, five: bool) -> None:
    """The second anchor of column 4, row 1 of stride 16, heads coarsest first."""
    heads = [torch.full((1, 3, 64 // s, 96 // s, 7), -20.0) for s in (32, 16, 8)]
    heads[1][0, 1, 1, 4] = torch.tensor([logit(0.6), 0.0, logit(0.6), 0.0, logit(0.9), -20.0, logit(0.8)])
    if not five:
        heads = [head.permute(0, 1, 4, 2, 3).flatten(1, 2) for head in heads]
    box, score = best(name, heads)
    x, y = (16 * value for value in centre)
    w, h = (value / 2 for value in extent)
    assert box == pytest.approx([x - w, y - h, x + w, y + h], abs=1e-3)
    assert score == pytest.approx(0.72, abs=1e-4)


@pytest.mark.parametrize("logits", [False, True])
def test_nanodet_with_and_without_a_sigmoid(logits: bool) -> None:
    outputs = [nanodet_rows(logit(0.72) if logits else 0.72, -9.0 if logits else 0.0)]
    assert best("nanodet", outputs)[1] == pytest.approx(0.72, abs=1e-4)


def test_nanodet_in_an_output_for_each_stride() -> None:
    whole = nanodet_rows(0.72, 0.0)
    counts = [cells(SIZE, (stride,)) for stride in (8, 16, 32)]
    parts = [part for rows in whole.split(counts, dim=1) for part in (rows[..., :2], rows[..., 2:])]
    box, score = best("nanodet", [*parts[::-1]])  # in any order
    assert box == pytest.approx(BOX, abs=1e-3) and score == pytest.approx(0.72, abs=1e-4)


@pytest.mark.parametrize("corners", [True, False])
@pytest.mark.parametrize("fractions", [True, False])
@pytest.mark.parametrize("scores", ["probabilities", "exclusive", "logits"])
def test_boxes_and_scores_apart(corners: bool, fractions: bool, scores: str) -> None:
    scale = torch.tensor([96.0, 64, 96, 64]) if fractions else torch.ones(4)
    boxes = torch.tensor([[[1.0, 1, 6, 5], BOX if corners else CENTRE]]).repeat(1, 20, 1) / scale
    boxes[0, 0] = torch.tensor([50.0, 50, 60, 60] if corners else [50.0, 50, 10, 10]) / scale
    shown = {
        "probabilities": [0.3, 0.72],
        "exclusive": [0.18, 0.1, 0.72],
        "logits": [math.log(p) for p in (0.18, 0.1, 0.72)],
    }
    other = {
        "probabilities": [0.1, 0.1],
        "exclusive": [0.9, 0.05, 0.05],
        "logits": [math.log(p) for p in (0.9, 0.05, 0.05)],
    }
    values = torch.tensor([[other[scores], shown[scores]]]).repeat(1, 20, 1)
    box, score = best("boxes-scores", [values, boxes])
    assert box == pytest.approx(BOX, abs=1e-3) and score == pytest.approx(0.72, abs=1e-4)


@pytest.mark.parametrize("name", OUTPUTS)
def test_the_layout_is_told_from_shapes_and_values(name: str) -> None:
    outputs = OUTPUTS[name]
    if name == "yolox":
        outputs = [outputs[0] - rows(COUNT, 7, [0.0, 0, 1, 1, 0, 0, 0], at=0)]  # some sizes below one cell
    assert guess_layout(outputs, SIZE, 80 if name == "rtdetr" else 2) == name
