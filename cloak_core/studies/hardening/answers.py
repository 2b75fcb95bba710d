"""How far what one network says is from what another says: the loss by which one learns from the other.

Networks answer in three ways: by a row for each place (`Answer`), by raw maps of anchor boxes (`Maps`), and in two
stages (`Stages`). Each selects images (`of`) and measures its distance from another (`distance`).

Distillation in the place of labels: the student is to say of a cloaked image what the teacher, the detector before it
was hardened, said of the same image without the cloak (Goldblum et al., "Adversarially robust distillation", AAAI
2020). The terms are detection's usual ones (classes and objectness by cross-entropy, boxes by distance where something
is), with the teacher's answers for targets. So no box has to be assigned to a place, and every class is kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from cloak_core.detectors.decoding import AnchorBoxes

BOX_WEIGHT = 2.0
"""Of places and sizes beside objectness and classes."""
FOUND_WEIGHT = 4.0
"""A place where the teacher saw something counts so much more than an empty one: there are a hundred times fewer."""
LEAST, MOST = 1e-9, 1 - 1e-6
"""Scores of boxes are kept between these: the logit of what float32 rounds to 0 or 1 is infinite."""
SMALLEST_BOX = 8.0
"""Pixels of the images; smaller boxes may be off by as much as one of this side."""


class Reading(NamedTuple):
    """How an answer is to be read."""

    softmax: bool = False
    """One class at most, the first being the background; False: each class by itself."""
    person: int | None = None
    """Its class; None where nobody is to be surer."""
    found_at: float = 0.5
    """A person is reported where the class's probability, times that of `trust`, is above it."""
    corners: bool = False
    """Boxes are corners in pixels, and compared in units of the wanted box's mean side."""


class Surer(NamedTuple):
    """Where the student is to be surer than the teacher: of what the teacher reports as a person."""

    images: Bool[Tensor, " B"]
    """In which of the images."""
    least: float
    """The least probability of these persons, below 1."""


class Answer(NamedTuple):
    """What a network says of B images at A places (anchors, cells, proposals or boxes), before any activation."""

    kinds: Float[Tensor, "B A K"]
    """Logits of the classes."""
    boxes: Float[Tensor, "B A C 4"]
    """In the network's own units; one for all classes (C = 1) or one for each."""
    trust: Float[Tensor, "B A"] | None = None
    """A logit whose probability every class's is multiplied by (FCOS' centre-ness)."""

    def of(self, rows: Int[Tensor, " b"]) -> Answer:
        """Select the answers of these images."""
        return Answer(*(None if part is None else part[rows] for part in self))

    def distance(self, wanted: Answer, reading: Reading, surer: Surer | None = None) -> Float[Tensor, " B"]:
        """Compare with the answer wanted; 0 where both are equal and nothing is to be surer."""
        answer, wanted = (Answer(*(None if part is None else part.float() for part in one)) for one in (self, wanted))
        if reading.corners:
            side = (wanted.boxes[..., 2:] - wanted.boxes[..., :2]).abs().mean(-1, keepdim=True).clamp(min=SMALLEST_BOX)
            answer, wanted = (one._replace(boxes=one.boxes / side) for one in (answer, wanted))
        if surer is not None and reading.person is not None:
            wanted = _raised(wanted, reading, surer)
        goal = _probabilities(wanted.kinds, reading)
        if reading.softmax:
            presence = 1 - goal[..., 0]
            apart = (goal * (wanted.kinds.log_softmax(-1) - answer.kinds.log_softmax(-1))).sum(-1)
            classes = (1 + FOUND_WEIGHT * presence) * apart
        else:
            presence = goal.amax(-1)
            classes = ((1 + FOUND_WEIGHT * goal) * _divergence(answer.kinds, wanted.kinds)).sum(-1)
        each_box = F.smooth_l1_loss(answer.boxes, wanted.boxes, reduction="none", beta=0.1).sum(-1)
        boxes = ((presence[..., None] if each_box.shape[-1] == 1 else goal) * each_box).sum(-1)
        total = classes + BOX_WEIGHT * boxes
        if answer.trust is not None:
            total = total + presence * _divergence(answer.trust, wanted.trust)
        return total.sum(1)


def _probabilities(kinds: Float[Tensor, "B A K"], reading: Reading) -> Float[Tensor, "B A K"]:
    return kinds.softmax(-1) if reading.softmax else kinds.sigmoid()


def _raised(wanted: Answer, reading: Reading, surer: Surer) -> Answer:
    """Raise the persons that an answer reports to the probability `surer.least`."""
    kinds, trust, person = wanted.kinds.clone(), wanted.trust, reading.person
    score = _probabilities(kinds, reading)[..., person]
    if trust is not None:
        score = score * trust.sigmoid()
    reported = (score > reading.found_at) & surer.images[:, None]
    least = math.log(surer.least / (1 - surer.least))
    own = kinds[..., person].clone()
    kinds[..., person] = -math.inf
    needed = least + kinds.logsumexp(-1) if reading.softmax else torch.full_like(own, least)
    kinds[..., person] = torch.where(reported, torch.maximum(own, needed), own)
    if trust is not None:
        trust = torch.where(reported, trust.clamp(min=least), trust)
    return Answer(kinds, wanted.boxes, trust)


def _divergence(answer: Float[Tensor, "*shape"], wanted: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Kullback-Leibler divergence of two coins, from their logits; exactly 0 where these are equal."""
    goal = wanted.sigmoid()
    return _cross_entropy(answer, goal) - _cross_entropy(wanted, goal)


def _cross_entropy(logits: Tensor, target: Tensor) -> Tensor:
    return F.binary_cross_entropy_with_logits(logits, target, reduction="none")


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


class Maps(NamedTuple):
    """Raw maps of anchor boxes, compared by the terms of YOLO's own loss (Redmon et al., 2016 to 2018)."""

    heads: Sequence[AnchorBoxes]
    raw: Sequence[Float[Tensor, "B _ _ _"]]
    """An entry for each head."""

    def of(self, rows: Int[Tensor, " b"]) -> Maps:
        """Select the answers of these images."""
        return Maps(self.heads, [raw[rows] for raw in self.raw])

    def distance(self, wanted: Maps, reading: Reading, surer: Surer | None = None) -> Float[Tensor, " B"]:
        """Compare with the maps wanted; a student that is to be surer raises its objectness."""
        total = torch.zeros(len(self.raw[0]), device=self.raw[0].device)
        for head, ours, theirs in zip(self.heads, self.raw, wanted.raw, strict=True):
            student, goal = head.split(ours.float()), head.split(theirs.detach().float())
            objectness = head.logistic(goal[:, :, 4])
            classes, kinds = _classes(head, student, goal)
            target = objectness
            if surer is not None:
                reported = objectness * classes[:, :, reading.person] > reading.found_at
                reported &= surer.images.view(-1, 1, 1, 1)
                target = torch.where(reported, objectness.clamp(min=surer.least), objectness)
            seen = (1 + FOUND_WEIGHT * target) * _coins(_logits(head, student[:, :, 4]), target)
            places = (head.logistic(student[:, :, :2]) - head.logistic(goal[:, :, :2])).square().sum(2)
            sizes = F.smooth_l1_loss(student[:, :, 2:4], goal[:, :, 2:4], reduction="none", beta=0.1).sum(2)
            each = seen + objectness * kinds + BOX_WEIGHT * objectness * (places + sizes)
            total = total + each.flatten(1).sum(1)
        return total


def _classes(
    head: AnchorBoxes, student: Float[Tensor, "B A C h w"], goal: Float[Tensor, "B A C h w"]
) -> tuple[Float[Tensor, "B A K h w"], Float[Tensor, "B A h w"]]:
    """Compute the wanted classes' probabilities, and their Kullback-Leibler divergence from those said."""
    student, goal = student[:, :, 5:], goal[:, :, 5:]
    if head.softmax:
        classes = goal.softmax(2)
        return classes, (classes * (goal.log_softmax(2) - student.log_softmax(2))).sum(2)
    classes = head.logistic(goal)
    return classes, _coins(_logits(head, student), classes).sum(2)


def _logits(head: AnchorBoxes, raw: Tensor) -> Tensor:
    return torch.logit(raw.clamp(1 - MOST, MOST)) if head.squared else raw


def _coins(logits: Tensor, target: Tensor) -> Tensor:
    """Kullback-Leibler divergence of coins, from logits, whose probabilities are to be `target`."""
    p = target.clamp(1 - MOST, MOST)
    return _cross_entropy(logits, target) + (p * p.log() + (1 - p) * (1 - p).log())


class Stages(NamedTuple):
    """What a two-stage network says of B images."""

    anchors: Answer
    proposals: list[Float[Tensor, "_ 4"]]
    """The teacher's best of each image, best first."""
    judged: Answer
    """The second stage's answers, one for each proposal, image by image."""

    def of(self, rows: Int[Tensor, " b"]) -> Stages:
        """Select what is said of these images."""
        parts = [part.split([len(boxes) for boxes in self.proposals]) for part in self.judged[:2]]
        chosen = rows.tolist()
        judged = Answer(*(torch.cat([part[k] for k in chosen]) for part in parts))
        return Stages(self.anchors.of(rows), [self.proposals[k] for k in chosen], judged)

    def distance(self, wanted: Stages, reading: Reading, surer: Surer | None = None) -> Float[Tensor, " B"]:
        """Compare with the answer wanted for the same proposals; `reading` belongs to the second stage."""
        device = self.anchors.kinds.device
        counts = torch.tensor([len(boxes) for boxes in wanted.proposals], device=device)
        image = torch.repeat_interleave(torch.arange(len(counts), device=device), counts)
        if surer is not None:
            surer = surer._replace(images=surer.images[image])
        each = self.judged.distance(wanted.judged, reading, surer)
        return self.anchors.distance(wanted.anchors, Reading()).index_add(0, image, each)
