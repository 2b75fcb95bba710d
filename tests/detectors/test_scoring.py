"""When a person counts as detected."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cloak_core.core.detector.outcomes import (
    as_anything,
    best_other,
    class_name,
    classes_above,
    found_as_person,
    on_body,
    share_within,
    share_within_mask,
    without_classes,
)
from cloak_core.core.detector.protocol import Detections, join_detections
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


BODY = torch.tensor([[10.0, 20.0, 30.0, 80.0]])
SMALL, OUTSIDE, HALF_OUT = [12.0, 30.0, 18.0, 50.0], [40.0, 20.0, 60.0, 80.0], [27.0, 30.0, 34.0, 50.0]
NEAR, BARELY = [12.0, 22.0, 31.0, 80.0], [25.0, 60.0, 35.0, 70.0]


def test_the_best_other_class_leaves_person_and_background_out() -> None:
    classes = torch.tensor([[[0.9, 0.2, 0.3, 0.1]]])
    for person, first, score, number in (
        (0, 0, 0.3, 2),
        (2, 0, 0.9, 0),
        (2, 1, 0.2, 1),
        (3, 1, 0.3, 2),
        (1, 1, 0.3, 2),
    ):
        found = best_other(classes, person, first)
        assert (found.scores.item(), found.number.item()) == (pytest.approx(score), number)
    assert best_other(classes[..., :1], 0) == best_other(classes[..., :2], 1, 1) == (None, None)


def test_a_person_box_counts_where_it_fits_the_body_or_lies_within_it() -> None:
    boxes = torch.tensor([[SMALL, OUTSIDE, HALF_OUT, NEAR, BARELY, [15.0, 30.0, 15.0, 40.0]]])
    assert found_as_person(boxes, BODY).tolist() == [[True, False, False, True, True, False]]
    assert share_within(boxes, BODY)[0].tolist() == pytest.approx([1, 0, 3 / 7, 1102 / 1102 * 18 / 19, 0.5, 0])


def test_with_a_mask_the_share_within_is_of_the_masks_pixels() -> None:
    mask = torch.zeros(1, 100, 100, dtype=torch.bool)
    mask[:, 20:80, 10:30] = True
    mask[:, 30:50, 12:18] = False  # a hole where the small box lies
    boxes = torch.tensor([[SMALL, NEAR, [-10.0, 20.0, 30.0, 80.0], [90.0, 90.0, 120.0, 120.0]]])
    slow = [
        float(mask[0, max(int(y1), 0) : int(y2), max(int(x1), 0) : int(x2)].sum()) / ((x2 - x1) * (y2 - y1))
        for x1, y1, x2, y2 in boxes[0].tolist()
    ]
    assert share_within_mask(boxes, mask)[0].tolist() == pytest.approx(slow)
    assert found_as_person(boxes[:, :1], BODY, masks=mask).tolist() == [[False]]


def test_outcomes_of_images() -> None:
    """Found; renamed, by a box as small as a tie's, too; what stands beside her does not count."""
    boxes = torch.tensor([[SMALL, NEAR], [NEAR, SMALL], [OUTSIDE, SMALL]])
    scores = torch.tensor([[0.7, 0.1], [0.1, 0.2], [0.9, 0.0]], requires_grad=True)
    other = torch.tensor([[0.0, 0.2], [0.8, 0.9], [0.7, 0.6]], requires_grad=True)
    found = Detections(boxes, scores, other=other, other_class=torch.tensor([[1, 2], [3, 4], [5, 6]]))
    answer = on_body(found, BODY.expand(3, 4))
    assert answer.person.tolist() == pytest.approx([0.7, 0.2, 0.0])
    assert answer.other.tolist() == pytest.approx([0.2, 0.9, 0.6])
    assert answer.other_class.tolist() == [2, 4, 6]
    (gradient,) = torch.autograd.grad(answer.other.sum(), other)
    assert gradient[:2].tolist() == [[0, 1], [0, 1]]
    assert class_name(("a", "b"), 1) == "b" and class_name(("a", "b"), 7) == class_name(None, 7) == "class 7"


def test_what_stood_on_her_in_her_own_clothes_is_no_new_name() -> None:
    """A handbag in both pictures; bananas in the cloak alone."""
    mask = torch.zeros(1, 100, 100, dtype=torch.bool)
    mask[:, 20:80, 10:30] = True
    boxes, scores = torch.tensor([[SMALL, [16.0, 40.0, 28.0, 52.0], OUTSIDE]]), torch.zeros(1, 3)
    own = Detections(boxes, scores, other=torch.tensor([[0.7, 0.2, 0.9]]), other_class=torch.tensor([[26, 46, 46]]))
    before = classes_above(on_body(own, BODY, masks=mask), own, 0.5)
    assert [classes.tolist() for classes in before] == [[26]]
    cloaked = own._replace(other=torch.tensor([[0.8, 0.6, 0.95]]))
    best = on_body(cloaked, BODY, masks=mask)
    assert (best.other.item(), best.other_class.item()) == (pytest.approx(0.8), 26)
    new = without_classes(best, cloaked, before)
    assert (new.other.item(), new.other_class.item()) == (pytest.approx(0.6), 46)
    assert without_classes(best, cloaked, None) is best
    mask[:, 30:60] = False
    assert on_body(cloaked, BODY, masks=mask).other.item() == 0, "before the hole in her mask stands nobody's banana"


def test_as_anything_other_classes_on_the_body_are_persons() -> None:
    boxes = torch.tensor([[SMALL, NEAR, OUTSIDE, BARELY]])
    scores, other = torch.tensor([[0.1, 0.8, 0.2, 0.0]]), torch.tensor([[0.7, 0.3, 0.9, 0.4]])
    is_person = torch.tensor([[False, True, False, False]])
    found = Detections(boxes, scores, scores, is_person, other=other, other_class=torch.ones(1, 4).long())
    all_of_it = as_anything(found, BODY)
    assert all_of_it.scores.tolist()[0] == pytest.approx([0.7, 0.8, 0.2, 0.4])
    assert all_of_it.is_person.tolist() == [[True, True, False, True]]
    loose = torch.tensor([[[10.0, 20.0, 30.0, 200.0]]])  # overlaps by a third: counts while training alone
    one = Detections(loose, torch.zeros(1, 1), other=torch.ones(1, 1), other_class=torch.ones(1, 1).long())
    assert as_anything(one, BODY).scores.item() == 1 and on_body(one, BODY).other.item() == 0
    plain = Detections(boxes, scores)
    assert as_anything(plain, BODY) is plain


def test_nothing_told_and_no_boxes() -> None:
    assert on_body(Detections(torch.zeros(1, 1, 4), torch.zeros(1, 1)), BODY).other is None
    none = Detections(
        torch.zeros(1, 0, 4), torch.zeros(1, 0), other=torch.zeros(1, 0), other_class=torch.zeros(1, 0).long()
    )
    answer = on_body(none, BODY)
    assert answer.person.item() == answer.other.item() == answer.other_class.item() == 0
    two = torch.ones(1, 2)
    joined = join_detections([none, Detections(torch.ones(1, 2, 4), two, other=two, other_class=two.long())])
    assert joined.other.tolist() == [[0, 0], [1, 1]] and joined.other_class.dtype == torch.int64
