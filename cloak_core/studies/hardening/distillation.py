"""How far a Darknet network is from what another said: the loss by which one learns from the other.

Distillation in the place of labels: the student is to say of a cloaked image what the teacher, the detector before it
was hardened, said of the same image without the cloak (Goldblum et al., "Adversarially robust distillation", AAAI
2020). The terms are those of YOLO's own loss (Redmon et al., 2016 to 2018: objectness and classes by cross-entropy,
places and sizes by distance where something is), with the teacher's probabilities for targets.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from cloak_core.detectors.darknet.heads import Head, Region, Yolo

BOX_WEIGHT = 2.0
"""Of places and sizes beside objectness and classes."""
FOUND_WEIGHT = 4.0
"""A place where the teacher saw something counts so much more than an empty one: there are a hundred times fewer."""
_NEAR_ONE = 1 - 1e-6


def distance(
    heads: Sequence[Head],
    said: Sequence[Float[Tensor, "B _ _ _"]],
    wanted: Sequence[Float[Tensor, "B _ _ _"]],
    person: int,
    surer: Bool[Tensor, " B"] | None = None,
    sure: float = 0.0,
    found_at: float = 0.5,
) -> Float[Tensor, " B"]:
    """The student's raw maps against the teacher's, an entry for each head; 0 where they are equal and nothing is
    to be `surer`.

    surer: images in which a place that the teacher reports as a person (its score above `found_at`) is to get an
    objectness of at least `sure`.
    """
    total = torch.zeros(len(said[0]), device=said[0].device)
    for head, ours, theirs in zip(heads, said, wanted, strict=True):
        total = total + _head_distance(head, ours.float(), theirs.detach().float(), person, surer, sure, found_at)
    return total


def _head_distance(
    head: Head,
    ours: Float[Tensor, "B C h w"],
    theirs: Float[Tensor, "B C h w"],
    person: int,
    surer: Bool[Tensor, " B"] | None,
    sure: float,
    found_at: float,
) -> Float[Tensor, " B"]:
    mine, goal = head.split(ours), head.split(theirs)
    objectness = probability(head, goal[:, :, 4])
    classes = _class_probabilities(head, goal[:, :, 5:])
    target = objectness
    if surer is not None and sure:
        reported = (objectness * classes[:, :, person] > found_at) & surer.view(-1, 1, 1, 1)
        target = torch.where(reported, objectness.clamp(min=sure), objectness)
    logits = _logits(head, mine[:, :, 4])
    seen = (1 + FOUND_WEIGHT * target) * (_cross_entropy(logits, target) - _entropy(target))
    kinds = objectness * _class_distance(head, mine[:, :, 5:], goal[:, :, 5:], classes)
    places = (probability(head, mine[:, :, :2]) - probability(head, goal[:, :, :2])).square().sum(2)
    sizes = F.smooth_l1_loss(mine[:, :, 2:4], goal[:, :, 2:4], reduction="none", beta=0.1).sum(2)
    return (seen + kinds + BOX_WEIGHT * objectness * (places + sizes)).flatten(1).sum(1)


def probability(head: Head, raw: Tensor) -> Tensor:
    """Objectness or place of a raw map; where the network's last layer is logistic they are in it already."""
    return raw if isinstance(head, Yolo) and head.new_coords else raw.sigmoid()


def _logits(head: Head, raw: Tensor) -> Tensor:
    return torch.logit(raw.clamp(1 - _NEAR_ONE, _NEAR_ONE)) if isinstance(head, Yolo) and head.new_coords else raw


def _class_probabilities(head: Head, raw: Float[Tensor, "B A K h w"]) -> Float[Tensor, "B A K h w"]:
    if isinstance(head, Region) and head.softmax:
        return raw.softmax(2)
    return raw.sigmoid() if isinstance(head, Region) else probability(head, raw)


def _class_distance(
    head: Head, mine: Float[Tensor, "B A K h w"], goal: Float[Tensor, "B A K h w"], classes: Float[Tensor, "B A K h w"]
) -> Float[Tensor, "B A h w"]:
    """Kullback-Leibler divergence of the classes, one of them (softmax) or each by itself."""
    if isinstance(head, Region) and head.softmax:
        return (classes * (goal.log_softmax(2) - mine.log_softmax(2))).sum(2)
    logits = mine if isinstance(head, Region) else _logits(head, mine)
    return (_cross_entropy(logits, classes) - _entropy(classes)).sum(2)


def _cross_entropy(logits: Tensor, target: Tensor) -> Tensor:
    return F.binary_cross_entropy_with_logits(logits, target, reduction="none")


def _entropy(p: Tensor) -> Tensor:
    p = p.clamp(1 - _NEAR_ONE, _NEAR_ONE)
    return -(p * p.log() + (1 - p) * (1 - p).log())
