"""The YOLOv2 loss: its targets must be what the reader decodes."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cloak_core.detectors.darknet.heads import Region
from tools.pretrain.region_loss import encode, region_loss

ANCHORS = [(0.9, 2.3), (1.8, 4.6), (3.4, 7.0)]
GRID = (8, 8)


def _raw_from(targets):
    """A raw map that says exactly what the targets ask for."""
    raw = torch.zeros(*targets.assigned.shape[:2], 6, *GRID)
    raw[:, :, :2] = torch.logit(targets.boxes[:, :, :2].clamp(1e-3, 1 - 1e-3))
    raw[:, :, 2:4] = targets.boxes[:, :, 2:]
    raw[:, :, 4] = torch.where(targets.assigned, 12.0, -12.0)
    return raw.flatten(1, 2)


box = st.tuples(st.floats(0.05, 0.95), st.floats(0.05, 0.95), st.floats(0.03, 0.9), st.floats(0.03, 0.9))


@settings(max_examples=60)
@given(box)
def test_targets_round_trip_through_the_readers_decode(values):
    x, y, w, h = values
    boxes = torch.tensor([[[x - w / 2, y - h / 2, x + w / 2, y + h / 2]]])
    head = Region(ANCHORS, 1, True)
    targets = encode(boxes, torch.ones(1, 1, dtype=torch.bool), head.anchors, GRID)
    assert int(targets.assigned.sum()) == 1
    decoded = head.decode(_raw_from(targets), (256, 256))
    best = decoded.objectness[0].argmax()
    assert decoded.objectness[0, best] > 0.99 and (decoded.objectness[0] > 0.5).sum() == 1
    torch.testing.assert_close(decoded.boxes[0, best], boxes[0, 0], atol=3e-4, rtol=0)
    assert torch.all(decoded.classes == 1), "with one class, the score is the objectness"


def test_perfect_answers_cost_next_to_nothing_and_wrong_ones_a_lot():
    head = Region(ANCHORS, 1, True)
    boxes = torch.tensor([[[0.1, 0.1, 0.3, 0.7], [0.6, 0.2, 0.9, 0.95]], [[0.4, 0.4, 0.5, 0.7], [0, 0, 0, 0]]])
    present = torch.tensor([[True, True], [True, False]])
    nobody = torch.zeros_like(present)
    targets = encode(boxes, present, head.anchors, GRID)
    assert int(targets.assigned.sum()) == 3
    raw = _raw_from(targets)
    right = region_loss(raw, head, boxes, present, nobody)
    assert right.objectness < 0.01
    missed = region_loss(raw, head, boxes, nobody, nobody)
    assert missed.objectness > 5, "claims where nobody stands"
    blind = raw.clone().unflatten(1, (3, 6))
    blind[:, :, 4] = -12
    assert region_loss(blind.flatten(1, 2), head, boxes, present, nobody).objectness > 10, "three people missed"
