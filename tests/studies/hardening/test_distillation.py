"""The loss by which a network learns from what it was."""

import torch

from cloak_core.detectors.darknet.heads import Region, Yolo
from cloak_core.studies.hardening.distillation import distance

HEADS = (
    Region([(1.0, 2.0), (2.0, 3.0)], 3, softmax=True),
    Yolo([(10.0, 20.0), (20.0, 30.0)], 3, 1.0, new_coords=False),
    Yolo([(10.0, 20.0), (20.0, 30.0)], 3, 1.05, new_coords=True),
)


def maps(head: Region | Yolo, seed: int) -> torch.Tensor:
    raw = torch.randn(2, head.channels, 4, 4, generator=torch.Generator().manual_seed(seed))
    return raw.sigmoid() if getattr(head, "new_coords", False) else raw


def test_equal_answers_are_no_distance_apart_and_others_are() -> None:
    for head in HEADS:
        same, other = maps(head, 0), maps(head, 1)
        near, far = (distance([head], [raw], [same], person=1) for raw in (same, other))
        assert near.shape == (2,)
        assert float(near.abs().max()) < 1e-3
        assert float(far.min()) > 1


def test_following_the_gradient_leads_to_the_teacher() -> None:
    for head in HEADS[:2]:
        wanted, own = maps(head, 0), maps(head, 1).requires_grad_()
        for _ in range(200):
            (gradient,) = torch.autograd.grad(distance([head], [own], [wanted], person=1).sum(), own)
            own = (own - 0.3 * gradient.clamp(-1, 1)).detach().requires_grad_()
        torch.testing.assert_close(
            head.split(own)[:, :, 4].sigmoid(), head.split(wanted)[:, :, 4].sigmoid(), atol=0.05, rtol=0
        )


def test_a_reported_person_is_to_be_surer_where_asked_and_nothing_else() -> None:
    head = Region([(1.0, 1.0)], 1, softmax=True)
    raw = torch.full((2, 6, 1, 2), -8.0)
    raw[:, 4, 0, 0] = 0.4  # probability 0.6: reported, from 0.5 up; the other place is empty
    raw = raw.requires_grad_()
    surer = torch.tensor([True, False])
    each = distance([head], [raw], [raw], person=0, surer=surer, sure=0.9)
    (gradient,) = torch.autograd.grad(each.sum(), raw)
    assert float(gradient[0, 4, 0, 0]) < -0.1
    assert float(gradient[0, 4, 0, 1].abs()) < 1e-5
    assert float(gradient[1].abs().max()) < 1e-5
