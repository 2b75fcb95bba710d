"""Whose a box is, where an image shows a person among others: boxes of other people do not count as hers."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cloak_core.detectors.outcomes import found_as_person
from cloak_core.detectors.protocol import Detections
from cloak_core.detectors.scoring import box_iou

HERS = 0.4
"""A person box of this overlap with hers is hers; so is one that lies by half of its own area within her box."""
THEIRS = 0.5
"""A box that overlaps another known person's by so much, and more than hers, is that person's."""


def only_hers(
    detections: Detections,
    bodies: Float[Tensor, "B 4"],
    others: Float[Tensor, "B K 4"],
    anywhere: Bool[Tensor, " B"] | None = None,
) -> Detections:
    """Keep the scores of boxes that are one person's in each image; those of all others become 0, differentiably.

    bodies: the person's true box, xyxy, pixels; others: those of the other people, zeros where there are fewer;
    anywhere: images in which every box counts.
    """
    theirs = of_others(detections.boxes, bodies, others)
    hers = found_as_person(detections.boxes, bodies, HERS) & ~theirs
    if anywhere is not None:
        hers, theirs = hers | anywhere[:, None], theirs & ~anywhere[:, None]
    other = None if detections.other is None else torch.where(theirs, 0.0, detections.other)
    return detections._replace(scores=torch.where(hers, detections.scores, 0.0), other=other)


def of_others(
    boxes: Float[Tensor, "B N 4"], bodies: Float[Tensor, "B 4"], others: Float[Tensor, "B K 4"]
) -> Bool[Tensor, "B N"]:
    """Tell which boxes fit another known person, and better than the one that is meant."""
    if not others.shape[1]:
        return torch.zeros(boxes.shape[:2], dtype=torch.bool, device=boxes.device)
    best = box_iou(boxes[:, :, None], others[:, None].to(boxes)).max(dim=2).values
    return (best >= THEIRS) & (best > box_iou(boxes, bodies[:, None].to(boxes)))
