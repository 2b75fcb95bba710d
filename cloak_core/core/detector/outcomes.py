"""What a detector reports on a body: the person, something else in her place, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cloak_core.core.detector import IOU
from cloak_core.core.detector.protocol import Detections
from cloak_core.core.detector.scoring import box_iou

WITHIN = 0.5
"""A box is on the true person where at least this share of its own area lies within them."""


NEAR = 0.3
"""The overlap from which training to hide everything minds other classes: just below `IOU` is above it next door."""


class BestOther(NamedTuple):
    """The likeliest class beside the person, of each box; both None where a detector knows only persons."""

    scores: Float[Tensor, "B N"] | None
    number: Int[Tensor, "B N"] | None
    """Index among the detector's classes."""


class OnBody(NamedTuple):
    """The best scores on one true body for each of B images, 0 where no box lies on it; differentiable."""

    person: Float[Tensor, " B"]
    """Of person boxes that fit the body or lie within it."""
    other: Float[Tensor, " B"] | None
    """Of any other class whose box is on the body; None where the detector tells of no other class."""
    other_class: Int[Tensor, " B"] | None
    """Which class that is: index among `class_names`; meaningless where `other` is 0."""
    on: Bool[Tensor, "B N"] | None = None
    """Which boxes are on the body, for other classes."""


def best_other(classes: Float[Tensor, "B N K"], person: int, first: int = 0) -> BestOther:
    """Find each box's likeliest class beside the person.

    classes: probabilities; person: its index; first: where classes begin that are something (1 behind a background).
    The gradient reaches the likeliest class alone.
    """
    best: BestOther = BestOther(None, None)
    for start, end in ((first, person), (max(person + 1, first), classes.shape[-1])):
        if end <= start:
            continue
        scores, number = classes[..., start:end].max(dim=-1)
        number = number + start
        if best.scores is None:
            best = BestOther(scores, number)
        else:
            further = scores > best.scores
            best = BestOther(torch.where(further, scores, best.scores), torch.where(further, number, best.number))
    return best


def found_as_person(
    boxes: Float[Tensor, "B N 4"],
    bodies: Float[Tensor, "B 4"],
    iou: float | Float[Tensor, "B 1"] = IOU,
    within: float | Float[Tensor, "B 1"] = WITHIN,
    masks: Bool[Tensor, "B H W"] | None = None,
) -> Bool[Tensor, "B N"]:
    """Tell which boxes are on the true body: they fit it, or lie within it.

    boxes, bodies: xyxy, pixels. A box fits where it overlaps the body's box with at least `iou`. It lies within where
    at least the share `within` of its own area does: of the body's box, or of `masks` (True on the person).
    """
    fits = box_iou(boxes, bodies[:, None].to(boxes)) >= iou
    inside = share_within(boxes, bodies) if masks is None else share_within_mask(boxes, masks)
    return fits | (inside >= within)


def share_within(boxes: Float[Tensor, "B N 4"], bodies: Float[Tensor, "B 4"]) -> Float[Tensor, "B N"]:
    """Compute the share of each box's own area that lies in the body's box; 0 for empty boxes."""
    bodies = bodies[:, None].to(boxes)
    low, high = torch.maximum(boxes[..., :2], bodies[..., :2]), torch.minimum(boxes[..., 2:], bodies[..., 2:])
    own = (boxes[..., 2:] - boxes[..., :2]).clamp(min=0).prod(dim=-1)
    return (high - low).clamp(min=0).prod(dim=-1) / own.clamp(min=torch.finfo(own.dtype).tiny)


@torch.no_grad()
def share_within_mask(boxes: Float[Tensor, "B N 4"], masks: Bool[Tensor, "B H W"]) -> Float[Tensor, "B N"]:
    """Compute the share of each box's own area that the mask covers, by a summed-area table; corners on whole pixels.

    What reaches beyond the mask's image is not covered.
    """
    height, width = masks.shape[1:]
    table = torch.zeros(len(masks), height + 1, width + 1, dtype=torch.float64, device=masks.device)
    table[:, 1:, 1:] = masks.double().cumsum(1).cumsum(2)
    at = boxes.double().round()
    x1, y1, x2, y2 = (at[..., i].clamp(0, limit).long() for i, limit in enumerate((width, height, width, height)))
    rows = torch.arange(len(masks), device=masks.device)[:, None]
    covered = table[rows, y2, x2] - table[rows, y1, x2] - table[rows, y2, x1] + table[rows, y1, x1]
    own = (at[..., 2:] - at[..., :2]).clamp(min=0).prod(dim=-1)
    return torch.where(own > 0, covered.clamp(min=0) / own.clamp(min=1), 0.0).to(boxes.dtype)


def on_body(
    detections: Detections,
    bodies: Float[Tensor, "B 4"],
    iou: float | Float[Tensor, "B 1"] = IOU,
    within: float | Float[Tensor, "B 1"] = WITHIN,
    masks: Bool[Tensor, "B H W"] | None = None,
) -> OnBody:
    """Find the best person score and the best other class on each image's true body.

    A person counts where `found_as_person` says so by `iou` and `within`. Another class counts whatever its size: where
    its box overlaps the body's with at least `IOU`, or lies by `WITHIN` of its own area on the body (on `masks`, where
    there are any). At threshold t the outcome is "person" where `person` > t, else "renamed" where `other` > t, else
    "gone".
    """
    is_person = found_as_person(detections.boxes, bodies, iou, within)
    person, _ = _best(torch.where(is_person, detections.scores, 0.0))
    if detections.other is None:
        return OnBody(person, None, None)
    on = found_as_person(detections.boxes, bodies, masks=masks)
    return OnBody(person, *_best_class(detections, on), on)


def classes_above(best: OnBody, detections: Detections, threshold: float) -> list[Int[Tensor, " _"]] | None:
    """List the other classes that are reported on each of B bodies above `threshold`; None where none is told of."""
    if best.on is None:
        return None
    reported = best.on & (detections.other > threshold)
    return [numbers[row].unique() for numbers, row in zip(detections.other_class, reported, strict=True)]


def without_classes(best: OnBody, detections: Detections, own: Sequence[Int[Tensor, " _"]] | None) -> OnBody:
    """Leave out, for each body, classes that were reported on it before: a bag that she carries is no new name."""
    if best.on is None or own is None:
        return best
    known = [torch.isin(numbers, before) for numbers, before in zip(detections.other_class, own, strict=True)]
    on = best.on & ~torch.stack(known)
    return OnBody(best.person, *_best_class(detections, on), on)


def _best_class(detections: Detections, on: Bool[Tensor, "B N"]) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
    """Find the best other class among these boxes: its score, and its number."""
    other, row = _best(torch.where(on, detections.other, 0.0))
    numbers = detections.other_class
    number = numbers.gather(1, row[:, None])[:, 0] if numbers.shape[1] else numbers.new_zeros(len(numbers))
    return other, number


def as_anything(detections: Detections, bodies: Float[Tensor, "B 4"]) -> Detections:
    """Turn every class on the body into a person, for what is to hide from all of them.

    Scores become the larger of the person's and the best other class's, where the box is on the body
    (`found_as_person`); such boxes count as persons in `is_person`, too. A detector that tells of no other class is
    left as it is.
    """
    if detections.other is None:
        return detections
    on = found_as_person(detections.boxes.detach(), bodies, NEAR)
    scores = torch.maximum(detections.scores, torch.where(on, detections.other, 0.0))
    is_person = None if detections.is_person is None else detections.is_person | on
    return detections._replace(scores=scores, is_person=is_person)


def class_name(names: Sequence[str] | None, number: int) -> str:
    """Name a class by its index; "class 17" where nobody said its name."""
    return names[number] if names is not None and 0 <= number < len(names) else f"class {number}"


def _best(values: Float[Tensor, "B N"]) -> tuple[Float[Tensor, " B"], Int[Tensor, " B"]]:
    """Find the largest of each row and its place; 0 where rows are empty, with the graph kept."""
    if not values.shape[1]:
        return values.sum(dim=1), torch.zeros(len(values), dtype=torch.int64, device=values.device)
    return tuple(values.max(dim=1))


OWN_IOU = 0.4
"""A person box that overlaps hers by this IoU is hers; so is one of which half the area lies on her mask, or in her box
where there is no mask."""
THEIRS = 0.5
"""A box that overlaps another known person's by so much, and more than hers, is that person's."""


def for_person(
    detections: Detections,
    bodies: Float[Tensor, "B 4"],
    others: Float[Tensor, "B K 4"],
    anywhere: Bool[Tensor, " B"] | None = None,
    masks: Bool[Tensor, "B H W"] | None = None,
) -> Detections:
    """Keep the scores of boxes that are one person's in each image; those of all others become 0, differentiably.

    bodies: the person's true box, xyxy, pixels; others: those of the other people, zeros where there are fewer;
    anywhere: images in which every box counts; masks: True on the person. Without masks the box of somebody half hidden
    behind her, of whom nobody told, lies within hers and is taken for her own.
    """
    boxes = detections.boxes
    theirs = torch.zeros(boxes.shape[:2], dtype=torch.bool, device=boxes.device)
    if others.shape[1]:
        best = box_iou(boxes[:, :, None], others[:, None].to(boxes)).max(dim=2).values
        theirs = (best >= THEIRS) & (best > box_iou(boxes, bodies[:, None].to(boxes)))
    hers = found_as_person(boxes, bodies, OWN_IOU, masks=masks) & ~theirs
    if anywhere is not None:
        hers, theirs = hers | anywhere[:, None], theirs & ~anywhere[:, None]
    other = None if detections.other is None else torch.where(theirs, 0.0, detections.other)
    return detections._replace(scores=torch.where(hers, detections.scores, 0.0), other=other)
