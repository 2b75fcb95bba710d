"""How far what one network says of anchors, cells or proposals is from what another says: detection's usual loss terms
(classes by cross-entropy, boxes by a smooth absolute difference where something is), with the other's answers for
targets in the place of labels. So no box has to be assigned to a place, and every class is kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from cloak_core.studies.hardening.distillation import BOX_WEIGHT, FOUND_WEIGHT


class Answer(NamedTuple):
    """What a network says of B images at A places, before any activation."""

    kinds: Float[Tensor, "B A K"]
    """Logits of the classes."""
    boxes: Float[Tensor, "B A C 4"]
    """In the network's own units; one for all classes (C = 1) or one for each."""
    trust: Float[Tensor, "B A"] | None = None
    """A logit whose probability every class's is multiplied by (FCOS' centre-ness)."""

    def of(self, rows: Int[Tensor, " b"]) -> Answer:
        """The answers of these images."""
        return Answer(*(None if part is None else part[rows] for part in self))


class Reading(NamedTuple):
    """How an answer is to be read."""

    softmax: bool
    """One class at most, the first being the background; False: each class by itself."""
    person: int | None = None
    """Its class; None where nobody is to be surer."""
    found_at: float = 0.5
    """A person is reported where the class's probability, times that of `trust`, is above it."""


def answer_distance(
    said: Answer, wanted: Answer, reading: Reading, surer: Bool[Tensor, " B"] | None = None, sure: float = 0.0
) -> Float[Tensor, " B"]:
    """0 where both are equal and nothing is to be surer.

    surer: images in which a place that is reported as a person is to give the class a probability of at least `sure`.
    """
    said, wanted = (Answer(*(None if part is None else part.float() for part in one)) for one in (said, wanted))
    if surer is not None and sure and reading.person is not None:
        wanted = _surer(wanted, reading, surer, sure)
    goal = _probabilities(wanted.kinds, reading)
    found = 1 - goal[..., 0] if reading.softmax else goal.amax(-1)
    if reading.softmax:
        classes = (1 + FOUND_WEIGHT * found) * (goal * (wanted.kinds.log_softmax(-1) - said.kinds.log_softmax(-1))).sum(
            -1
        )
    else:
        classes = ((1 + FOUND_WEIGHT * goal) * _divergence(said.kinds, wanted.kinds)).sum(-1)
    each_box = F.smooth_l1_loss(said.boxes, wanted.boxes, reduction="none", beta=0.1).sum(-1)
    boxes = ((found[..., None] if each_box.shape[-1] == 1 else goal) * each_box).sum(-1)
    total = classes + BOX_WEIGHT * boxes
    if said.trust is not None:
        total = total + found * _divergence(said.trust, wanted.trust)
    return total.sum(1)


def _probabilities(kinds: Float[Tensor, "B A K"], reading: Reading) -> Float[Tensor, "B A K"]:
    return kinds.softmax(-1) if reading.softmax else kinds.sigmoid()


def _surer(wanted: Answer, reading: Reading, surer: Bool[Tensor, " B"], sure: float) -> Answer:
    """The answer with the persons in it that are reported raised to the probability `sure`."""
    kinds, trust, person = wanted.kinds.clone(), wanted.trust, reading.person
    score = _probabilities(kinds, reading)[..., person]
    if trust is not None:
        score = score * trust.sigmoid()
    reported, least = (score > reading.found_at) & surer[:, None], math.log(sure / (1 - sure))
    own = kinds[..., person].clone()
    kinds[..., person] = -math.inf
    needed = least + kinds.logsumexp(-1) if reading.softmax else torch.full_like(own, least)
    kinds[..., person] = torch.where(reported, torch.maximum(own, needed), own)
    if trust is not None:
        trust = torch.where(reported, trust.clamp(min=least), trust)
    return Answer(kinds, wanted.boxes, trust)


def _divergence(said: Float[Tensor, "*shape"], wanted: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Kullback-Leibler divergence of two coins, from their logits; exactly 0 where these are equal."""
    goal = wanted.sigmoid()
    entropy = F.binary_cross_entropy_with_logits(wanted, goal, reduction="none")
    return F.binary_cross_entropy_with_logits(said, goal, reduction="none") - entropy


# --- what a detector of any kind says of every box, as an answer that another can learn

LEAST, MOST = 1e-9, 1 - 1e-6
"""Scores are kept between these: the logit of what float32 rounds to 0 or 1 is infinite."""
SMALLEST_BOX = 8.0
"""Pixels of the images; smaller boxes may be off by as much as one of this side."""


def answer_of(scores: Float[Tensor, "B N K"], boxes: Float[Tensor, "B N 4"]) -> Answer:
    """Make an answer of scores in [0, 1] of K classes and boxes xyxy in pixels."""
    return Answer(scores.float().clamp(LEAST, MOST).logit(), boxes.float().unsqueeze(2))


@torch.no_grad()
def in_the_order_of(student: Answer, teacher: Answer) -> Answer:
    """Order the teacher's boxes of each image as the student's that they are most like, one to one.

    By the least sum of differences of corners and scores (the matching of DETR, arXiv:2005.12872).
    """
    rows = []
    for image in range(len(student.kinds)):
        a, b = (one.boxes[image, :, 0] for one in (student, teacher))
        side = (b[:, 2:] - b[:, :2]).abs().mean(-1).clamp(min=SMALLEST_BOX)
        cost = torch.cdist(a, b, p=1) / side
        cost += torch.cdist(*(one.kinds[image].sigmoid() for one in (student, teacher)), p=1)
        rows.append(torch.from_numpy(linear_sum_assignment(cost.cpu().numpy())[1]))
    index = torch.stack(rows).to(teacher.kinds.device)
    image = torch.arange(len(index), device=index.device)[:, None]
    return Answer(teacher.kinds[image, index], teacher.boxes[image, index])


def score_distance(
    student: Answer,
    teacher: Answer,
    person: int,
    found_at: float,
    surer: Bool[Tensor, " B"] | None = None,
    sure: float = 0.0,
) -> Float[Tensor, " B"]:
    """Compare two answers: each class by itself, corners in units of the box's mean side.

    person: its class; found_at: the score at which it is reported; surer and sure: see `answer_distance`.
    """
    corners = teacher.boxes
    side = ((corners[..., 2:] - corners[..., :2]).abs().mean(-1, keepdim=True)).clamp(min=SMALLEST_BOX)
    own, goal = (answer._replace(boxes=answer.boxes / side) for answer in (student, teacher))
    return answer_distance(own, goal, Reading(softmax=False, person=person, found_at=found_at), surer, sure)
