"""What a detector of any kind says of every box, as an answer that another can learn."""

from __future__ import annotations

from jaxtyping import Bool, Float
from torch import Tensor

from cloak_core.studies.hardening.answers import Answer, Reading, answer_distance

LEAST, MOST = 1e-9, 1 - 1e-6
"""Scores are kept between these: the logit of what float32 rounds to 0 or 1 is infinite."""
SMALLEST_BOX = 8.0
"""Pixels of the images; smaller boxes may be off by as much as one of this side."""


def answer_of(scores: Float[Tensor, "B N K"], boxes: Float[Tensor, "B N 4"]) -> Answer:
    """Make an answer of scores in [0, 1] of K classes and boxes xyxy in pixels."""
    return Answer(scores.float().clamp(LEAST, MOST).logit(), boxes.float().unsqueeze(2))


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
