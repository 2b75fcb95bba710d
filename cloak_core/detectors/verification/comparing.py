"""How far two answers to the same images are apart, also where their rows stand in another order."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.protocol import Detections

SCORES, BOXES_PX = 1e-4, 0.05
"""The largest differences that count as none."""
FAINT = 0.01
"""Where rows do not correspond one to one, those below this score are left out: padding, and what was cut off."""


class Apart(NamedTuple):
    """The largest differences; infinite where something is missing or not finite."""

    scores: float
    boxes_px: float
    """Of coordinates, clipped to the image, in its pixels."""

    @property
    def same(self) -> bool:
        return self.scores <= SCORES and self.boxes_px <= BOXES_PX


def apart(some: Detections, others: Detections, size: tuple[int, int]) -> Apart:
    """Of one image each, (height, width) `size`: row by row where that agrees, else every clear row and the one most
    like it on the other side."""
    a, b = _rows(some, size), _rows(others, size)
    if a.shape == b.shape:
        straight = _worst((a - b).abs())
        if straight.same:
            return straight
    a, b = a[a[:, 4] > FAINT], b[b[:, 4] > FAINT]
    if not len(a) or not len(b):
        left = torch.cat([a, b])
        return Apart(float(left[:, 4].max()), math.inf) if len(left) else Apart(0.0, 0.0)
    return Apart(*map(max, _nearest(a, b), _nearest(b, a)))


def _rows(found: Detections, size: tuple[int, int]) -> Float[Tensor, "N 5"]:
    """Boxes and score."""
    most = torch.tensor([size[1], size[0]] * 2, device=found.boxes.device)
    boxes = found.boxes[0].detach().double()
    clipped = torch.minimum(boxes.clamp(min=0), most)
    return torch.cat([clipped, found.scores[0, :, None].detach().double()], dim=1).cpu()


def _nearest(rows: Float[Tensor, "N 5"], others: Float[Tensor, "M 5"]) -> Apart:
    """Each of these against the most alike of the others."""
    limits = torch.tensor([BOXES_PX] * 4 + [SCORES], dtype=rows.dtype)
    index = [(((row - others).abs() / limits).amax(dim=1)).argmin() for row in rows]
    return _worst((rows - others[torch.stack(index)]).abs())


def _worst(differences: Float[Tensor, "N 5"]) -> Apart:
    if not len(differences):
        return Apart(0.0, 0.0)
    if not bool(differences.isfinite().all()):
        return Apart(math.inf, math.inf)
    return Apart(float(differences[:, 4].max()), float(differences[:, :4].max()))
