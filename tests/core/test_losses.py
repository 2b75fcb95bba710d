import contextlib
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cloak_core.core.detector.protocol import Detections
from cloak_core.core.losses import person_loss, total_variation
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.files.errors import InputError


def disappearance(*arguments, **options):
    return person_loss(*arguments, **options).mean()


def detections(scores, objectness=None, is_person=None):
    scores = torch.as_tensor(scores)
    return Detections(torch.zeros(*scores.shape, 4), scores, objectness, is_person)


def test_objectness_counts_person_boxes_alone():
    objectness = torch.tensor([[0.9, 0.4], [0.8, 0.7]])
    is_person = torch.tensor([[False, True], [False, False]])
    found = detections([[0.5, 0.5], [0.5, 0.5]], objectness, is_person)
    assert disappearance(found, "objectness").item() == pytest.approx(0.2)
    with pytest.raises(InputError, match="objectness"):
        disappearance(detections([[0.5]]), "objectness")


@pytest.mark.parametrize("kind", ["score", "log"])
def test_no_boxes_and_empty_boxes_count_nothing(kind):
    assert disappearance(detections(torch.zeros(2, 0)), kind).item() == 0
    assert disappearance(detections(torch.zeros(2, 500)), kind).item() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("kind", ["score", "log", "margin"])
@pytest.mark.parametrize("logit", [-6.0, -1.0, 1.0, 6.0])
def test_a_score_on_either_side_of_the_threshold_has_a_gradient(kind, logit):
    logits = torch.full((1, 3), logit, requires_grad=True)
    disappearance(detections(torch.sigmoid(logits)), kind).backward()
    assert logits.grad.abs().sum() > 1e-3


def slope(kind, score, **more):
    """Of the loss, with respect to the logit of the only box."""
    logits = torch.logit(torch.tensor([[score]])).requires_grad_()
    disappearance(detections(torch.sigmoid(logits)), kind, **more).backward()
    return logits.grad.item()


@pytest.mark.parametrize("point", [0.05, 0.25, 0.6, 0.9])
def test_the_margin_pulls_down_to_the_operating_point_and_beyond(point):
    at, below = (slope("margin", p, operating_point=point) for p in (point, point / (1 + point)))
    odds = point / (1 - point) * math.exp(-1)
    assert slope("margin", odds / (1 + odds), operating_point=point) == pytest.approx(0.5, abs=1e-4)
    assert 0.7 < at < 0.75  # sigmoid(1), whatever the point is
    assert slope("margin", 0.999, operating_point=point) > 0.95
    assert 0 < below < at
    # The score's own slope there is p (1 - p), a quarter at most.
    assert at > 2 * slope("score", point)


def test_total_variation_by_hand():
    # Edge 0.5 m: |0.2| + |0.4| + |0.6| = 1.2; edge 2 m: 3 x 0.1; three faces: (0.6 + 0.6) / 3.
    colors = torch.tensor([[0.0, 0.0, 0.0], [0.2, 0.4, 0.6], [0.3, 0.5, 0.5]], dtype=torch.float64)
    edges, lengths = torch.tensor([[0, 1], [1, 2]]), torch.tensor([0.5, 2.0], dtype=torch.float64)
    assert total_variation(colors, edges, lengths).item() == pytest.approx(0.4)
    assert total_variation(colors[:1], edges[:0], lengths[:0]).item() == 0


@settings(max_examples=20)
@given(st.integers(2, 12), st.integers(0, 2**31))
def test_total_variation_gradient_is_right(count, seed):
    generator = torch.Generator().manual_seed(seed)
    colors = torch.rand(count, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    edges = torch.randint(count, (2 * count, 2), generator=generator)
    edges = edges[edges[:, 0] != edges[:, 1]]
    lengths = torch.rand(len(edges), generator=generator, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda c: total_variation(c, edges, lengths), colors, eps=1e-7, atol=1e-5)


def test_the_loop_and_torch_agree_about_total_variation():
    generator = torch.Generator().manual_seed(3)
    edges, lengths = torch.randint(500, (2000, 2), generator=generator), torch.rand(2000, generator=generator)
    start = (torch.rand(500, 3, generator=generator) * 8).round() / 8  # with some neighbours alike
    found = []
    for way in (contextlib.nullcontext(), torch_alone()):
        colors = start.clone().requires_grad_()
        with way:
            value = total_variation(colors, edges, lengths)
            (3 * value).backward()
        found.append((value.item(), colors.grad))
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-6)
    assert torch.allclose(found[0][1], found[1][1], atol=1e-6) and found[0][1].abs().max() > 1e-3
