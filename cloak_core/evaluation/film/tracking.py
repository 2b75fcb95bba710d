"""A plain tracker of boxes by their overlap: would a camera with the simplest of trackers ever follow the person?

Boxes continue the track whose last box they overlap most (greedily, best pairs first), as in Bochinski, Eiselein and
Sikora, "High-speed tracking-by-detection without using image information", AVSS 2017; confirming and losing a track
are SORT's rules (Bewley et al., ICIP 2016). There is no motion model and no appearance model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float

from cloak_core.detectors.scoring import box_iou
from cloak_core.evaluation.film.settings import Rule


@dataclass(eq=False)
class Track:
    """One track: the frames in which it has a box, and which box."""

    number: int = 0
    """From 1 in the order of confirmation; 0 while it is not confirmed."""
    boxes: dict[int, int] = field(default_factory=dict)
    """Frame -> index among that frame's boxes."""
    last: np.ndarray | None = None
    missed: int = 0


def track(frames: Sequence[Float[np.ndarray, "_ 5"]], rule: Rule) -> list[Track]:
    """Find the confirmed tracks through frames of boxes (x1, y1, x2, y2, score), in the order of confirmation.

    A track's boxes include those before it was confirmed.
    """
    live: list[Track] = []
    confirmed: list[Track] = []
    for index, boxes in enumerate(frames):
        matched = _match(live, boxes, rule.iou)
        for position, one in enumerate(live):
            one.missed = 0 if position in matched else one.missed + 1
            if position in matched:
                one.boxes[index], one.last = matched[position], boxes[matched[position]]
        fresh = [Track(boxes={index: b}, last=box) for b, box in enumerate(boxes) if b not in matched.values()]
        live = [one for one in [*live, *fresh] if one.missed <= (rule.misses if one.number else 0)]
        for one in live:
            if not one.number and len(one.boxes) >= rule.hits:
                confirmed.append(one)
                one.number = len(confirmed)
    return confirmed


def _match(live: Sequence[Track], boxes: Float[np.ndarray, "n 5"], least: float) -> dict[int, int]:
    """Match tracks (by position) to boxes (by index), the largest overlaps first."""
    if not live or not len(boxes):
        return {}
    last, found_boxes = (torch.from_numpy(rows[:, :4]) for rows in (np.stack([one.last for one in live]), boxes))
    overlap = box_iou(last[:, None], found_boxes).numpy()
    found: dict[int, int] = {}
    for flat in np.argsort(-overlap, axis=None, kind="stable"):
        position, box = divmod(int(flat), len(boxes))
        if overlap[position, box] < least:
            break
        if position not in found and box not in found.values():
            found[position] = box
    return found
