"""The losses by which networks learn from what they were."""

import math

import pytest
import torch

from cloak_core.detectors.decoding import AnchorBoxes
from cloak_core.studies.hardening.answers import Answer, Maps, Reading, Surer, answer_of, in_the_order_of

SURER = Surer(torch.tensor([True, False]), 0.9)
ON_MAPS = Reading(person=1)
KINDS = [Reading(softmax=True, person=1), Reading(softmax=False, person=1)]


def answer(reading: Reading, seed: int) -> Answer:
    """Two images, five places, three classes; a box for each class where one class at most is there."""
    generator = torch.Generator().manual_seed(seed)
    shapes = (2, 5, 3), (2, 5, 3 if reading.softmax else 1, 4), (2, 5)
    kinds, boxes, trust = (2 * torch.randn(shape, generator=generator) for shape in shapes)
    return Answer(kinds, boxes, None if reading.softmax else trust)


@pytest.mark.parametrize("reading", KINDS)
def test_equal_answers_are_no_distance_apart_and_others_are(reading: Reading) -> None:
    same, other = answer(reading, 0), answer(reading, 1)
    assert torch.equal(same.distance(same, reading), torch.zeros(2))
    assert float(other.distance(same, reading).min()) > 1
    turned = same.of(torch.tensor([1, 0]))
    assert torch.equal(turned.distance(turned, reading), torch.zeros(2))
    assert torch.equal(turned.boxes[0], same.boxes[1])


@pytest.mark.parametrize(
    ("reading", "part"),
    [(reading, part) for reading in KINDS for part in range(3) if answer(reading, 0)[part] is not None],
)
def test_every_part_of_the_answer_counts(reading: Reading, part: int) -> None:
    wanted = answer(reading, 0)
    changed = list(wanted)
    changed[part] = changed[part] * 0.5
    assert float(Answer(*changed).distance(wanted, reading).min()) > 0.1


@pytest.mark.parametrize("reading", KINDS)
def test_a_reported_person_is_to_be_surer_where_asked_and_nothing_else(reading: Reading) -> None:
    kinds = torch.full((2, 2, 3), -8.0)
    kinds[:, 0, 1] = 0.5 if not reading.softmax else -8 + math.log(2 * 1.7)  # probability about 0.63: reported
    kinds[:, 1, 0] = 8.0 if reading.softmax else -8.0  # nothing there
    kinds.requires_grad_()
    said = Answer(kinds, torch.zeros(2, 2, 1, 4))
    each = said.distance(Answer(kinds.detach(), said.boxes), reading, SURER)
    (gradient,) = torch.autograd.grad(each.sum(), kinds)
    assert float(gradient[0, 0, 1]) < -0.1
    assert float(gradient[0, 1].abs().max()) < 1e-5 and float(gradient[1].abs().max()) < 1e-5
    goal = kinds.detach().clone()
    goal[0, 0, 1] = math.log(9) + (goal[0, 0, [0, 2]].logsumexp(0) if reading.softmax else 0.0)  # probability 0.9
    met = said._replace(kinds=goal).distance(Answer(kinds.detach(), said.boxes), reading, SURER)
    assert float(met.abs().max()) < 1e-5


def test_boxes_in_pixels_are_compared_in_units_of_their_side_and_those_most_alike_with_each_other() -> None:
    boxes = torch.tensor([[0.0, 0, 20, 40], [50, 50, 80, 80], [5, 5, 25, 45]])[None]
    wanted = answer_of(torch.tensor([[[0.9], [0.6], [0.2]]]), boxes)
    reading, turned = Reading(corners=True), [2, 0, 1]
    far, twice = (
        answer_of(wanted.kinds.sigmoid(), boxes * scale + 6 * scale).distance(
            answer_of(wanted.kinds.sigmoid(), boxes * scale), reading
        )
        for scale in (1, 2)
    )
    torch.testing.assert_close(far, twice)
    other = Answer(wanted.kinds[:, turned], wanted.boxes[:, turned])
    assert float(other.distance(wanted, reading)) > 1
    assert float(other.distance(in_the_order_of(other, wanted), reading)) == 0


HEADS = (
    AnchorBoxes([(1.0, 2.0), (2.0, 3.0)], 3, in_cells=True, softmax=True),
    AnchorBoxes([(10.0, 20.0), (20.0, 30.0)], 3),
    AnchorBoxes([(10.0, 20.0), (20.0, 30.0)], 3, scale_xy=1.05, squared=True),
)


def maps(head: AnchorBoxes, seed: int) -> torch.Tensor:
    raw = torch.randn(2, head.channels, 4, 4, generator=torch.Generator().manual_seed(seed))
    return raw.sigmoid() if head.squared else raw


def test_equal_maps_are_no_distance_apart_and_others_are() -> None:
    for head in HEADS:
        same, other = maps(head, 0), maps(head, 1)
        near, far = (Maps([head], [raw]).distance(Maps([head], [same]), ON_MAPS) for raw in (same, other))
        assert near.shape == (2,)
        assert float(near.abs().max()) < 1e-3
        assert float(far.min()) > 1


def test_following_the_gradient_leads_to_the_teacher() -> None:
    for head in HEADS[:2]:
        wanted, own = maps(head, 0), maps(head, 1).requires_grad_()
        for _ in range(200):
            (gradient,) = torch.autograd.grad(Maps([head], [own]).distance(Maps([head], [wanted]), ON_MAPS).sum(), own)
            own = (own - 0.3 * gradient.clamp(-1, 1)).detach().requires_grad_()
        torch.testing.assert_close(
            head.split(own)[:, :, 4].sigmoid(), head.split(wanted)[:, :, 4].sigmoid(), atol=0.05, rtol=0
        )


def test_a_person_of_a_map_is_to_be_surer_where_asked_and_nothing_else() -> None:
    head = AnchorBoxes([(1.0, 1.0)], 1, in_cells=True, softmax=True)
    raw = torch.full((2, 6, 1, 2), -8.0)
    raw[:, 4, 0, 0] = 0.4  # probability 0.6: reported, from 0.5 up; the other place is empty
    raw = raw.requires_grad_()
    each = Maps([head], [raw]).distance(Maps([head], [raw]), Reading(person=0), SURER)
    (gradient,) = torch.autograd.grad(each.sum(), raw)
    assert float(gradient[0, 4, 0, 0]) < -0.1
    assert float(gradient[0, 4, 0, 1].abs()) < 1e-5
    assert float(gradient[1].abs().max()) < 1e-5
