"""When a person counts as detected."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cloak_core.core.detector.protocol import Detections
from cloak_core.core.detector.scoring import (
    box_iou,
    is_detected,
    max_person_score,
    person_boxes,
)


def found(scores: list[list[float]], boxes: list | None = None, **more) -> Detections:
    scores = torch.tensor(scores)
    boxes = torch.zeros(*scores.shape, 4) if boxes is None else torch.tensor(boxes)
    return Detections(boxes, scores, **more)


def test_max_scores_and_threshold() -> None:
    detections = found([[0.2, 0.61], [0.6, 0.1]])
    assert max_person_score(detections).tolist() == pytest.approx([0.61, 0.6])
    assert is_detected(detections).tolist() == [True, False]  # above, not at, the threshold
    assert is_detected(detections, 0.5).tolist() == [True, True]


def test_no_boxes_at_all_keep_the_graph() -> None:
    scores = torch.zeros(3, 0, requires_grad=True)
    detections = Detections(torch.zeros(3, 0, 4), scores)
    best = max_person_score(detections)
    assert best.tolist() == [0.0, 0.0, 0.0]
    best.sum().backward()
    assert [len(boxes) for boxes in person_boxes(detections)] == [0, 0, 0]


@given(st.lists(st.floats(-50, 50, width=32), min_size=8, max_size=8))
def test_iou_equals_counting(values: list[float]) -> None:
    a, b = (torch.tensor(values[i : i + 4]).round() for i in (0, 4))
    pixels = torch.stack(torch.meshgrid(torch.arange(-50, 50), torch.arange(-50, 50), indexing="xy"), -1) + 0.5

    def inside(box: torch.Tensor) -> torch.Tensor:
        return ((pixels > box[:2]) & (pixels < box[2:])).all(dim=-1)

    both, either = (inside(a) & inside(b)).sum().item(), (inside(a) | inside(b)).sum().item()
    assert box_iou(a, b).item() == pytest.approx(both / either if either else 0.0, abs=1e-6)


def suppressed_one_by_one(rows: torch.Tensor, nms: float) -> torch.Tensor:
    """The best box, then the best of those that overlap no kept one, and so on: what suppression means."""
    rows, kept = rows[rows[:, 4].argsort(descending=True, stable=True)], []
    while len(rows):
        kept.append(rows[0])
        rows = rows[1:][box_iou(rows[1:, :4], kept[-1][:4]) <= nms]
    return torch.stack(kept)


@pytest.mark.parametrize("nms", [0.25, 0.45, 0.5])
@pytest.mark.parametrize("seed", range(5))
def test_suppression_is_the_plain_loop(seed: int, nms: float) -> None:
    """On random boxes: many overlap by exactly 1/4 or 1/2, scores tie, some are empty or have swapped corners."""
    rng = torch.Generator().manual_seed(seed)
    corner = torch.randint(0, 9, (120, 2), generator=rng)
    boxes = torch.cat([corner, corner + torch.randint(-2, 9, (120, 2), generator=rng)], 1).float()
    scores = torch.randint(1, 12, (120,), generator=rng) / 16
    kept = person_boxes(Detections(boxes[None], scores[None]), threshold=0.1, nms=nms)[0]
    rows = torch.cat([boxes, scores[:, None]], 1)
    assert torch.equal(kept, suppressed_one_by_one(rows[scores > 0.1], nms))
