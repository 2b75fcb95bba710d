"""How far two answers to the same images are apart, also where their rows stand in another order."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from cloak_core.core.detector.protocol import Detections
from cloak_core.sources.backdrops.procedural import draw_scene

BATCH = 4
"""Images at a time, where several are asked about at once."""
SCORES, BOXES_PX = 1e-4, 0.05
"""The largest differences that count as none."""
FAINT = 0.01
"""Where rows do not correspond one to one, those below this score are left out: padding, and what was cut off."""

NAMED = 0.5
"""Of exclusive classes only one has a higher score: from here on its number must agree."""


@lru_cache(4)
def sample_images(size: tuple[int, int]) -> Float[Tensor, "B 3 H W"]:
    """Draw a batch of procedural scenes, always the same ones."""
    scenes = [draw_scene(np.random.default_rng([7, i]), *size) for i in range(BATCH)]
    return torch.from_numpy(np.stack(scenes)).permute(0, 3, 1, 2).float() / 255


class Apart(NamedTuple):
    """The largest differences; infinite where something is missing or not finite."""

    scores: float
    boxes_px: float
    """Of coordinates, clipped to the image, in its pixels."""

    @property
    def same(self) -> bool:
        return self.scores <= SCORES and self.boxes_px <= BOXES_PX

    def joined(self, other: Apart) -> Apart:
        """The larger of both differences."""
        return Apart(max(self.scores, other.scores), max(self.boxes_px, other.boxes_px))

    def __str__(self) -> str:
        return f"differ by {self.scores:.1e} in scores and {self.boxes_px:.1e} px in boxes"


def apart(some: Detections, others: Detections, size: tuple[int, int]) -> Apart:
    """Measure how far two answers to one image of (height, width) `size` are apart.

    Row by row where that agrees, else every clear row and the one most like it on the other side. Persons first, then
    other classes; infinite where one side alone tells of these.
    """
    persons = _rows_apart(*(_rows(detections.boxes, detections.scores, size) for detections in (some, others)))
    if some.other is None or others.other is None:
        return persons if some.other is others.other else Apart(math.inf, math.inf)
    return persons.joined(
        _rows_apart(
            *(_rows(detections.boxes, detections.other, size, detections.other_class) for detections in (some, others))
        )
    )


def _rows_apart(a: Float[Tensor, "N C"], b: Float[Tensor, "M C"]) -> Apart:
    if a.shape == b.shape:
        straight = largest_difference(a, b)
        if straight.same:
            return straight
    a, b = a[a[:, 4] > FAINT], b[b[:, 4] > FAINT]
    if not len(a) or not len(b):
        left = torch.cat([a, b])
        return Apart(float(left[:, 4].max()), math.inf) if len(left) else Apart(0.0, 0.0)
    return in_any_order(a, b)


def in_any_order(a: Float[Tensor, "N C"], b: Float[Tensor, "M C"]) -> Apart:
    """Compare each row of boxes and scores with the one most like it on the other side, both ways."""
    return _nearest(a, b).joined(_nearest(b, a))


def _rows(
    boxes: Float[Tensor, "1 N 4"],
    scores: Float[Tensor, "1 N"],
    size: tuple[int, int],
    number: Int[Tensor, "1 N"] | None = None,
) -> Float[Tensor, "N C"]:
    """Stack one image's boxes, score and, where there is one, the class's number where it is clear."""
    most = torch.tensor([size[1], size[0]] * 2, device=boxes.device)
    clipped = torch.minimum(boxes[0].detach().double().clamp(min=0), most)
    columns = [clipped, scores[0, :, None].detach().double()]
    if number is not None:
        # Which of two faint classes is ahead may hang on rounding; nothing is reported there.
        columns.append(torch.where(scores[0] > NAMED, number[0], 0)[:, None].double())
    return torch.cat(columns, dim=1).cpu()


def _nearest(rows: Float[Tensor, "N C"], others: Float[Tensor, "M C"]) -> Apart:
    """Compare each row with the most alike of the others."""
    limits = torch.tensor([BOXES_PX] * 4 + [SCORES] * (rows.shape[1] - 4), dtype=rows.dtype)
    index = [(((row - others).abs() / limits).amax(dim=1)).argmin() for row in rows]
    return largest_difference(rows, others[torch.stack(index)])


def largest_difference(a: Float[Tensor, "N C"], b: Float[Tensor, "N C"]) -> Apart:
    """Compare rows of boxes and scores one by one; infinite where a number is not finite."""
    differences = (a - b).abs()
    if not len(differences):
        return Apart(0.0, 0.0)
    if not bool(differences.isfinite().all()):
        return Apart(math.inf, math.inf)
    return Apart(float(differences[:, 4:].max()), float(differences[:, :4].max()))


AGREES = 0.1
"""The largest relative difference of a slope and a finite difference that counts as none."""
SURE = 20
"""Judge a gradient on the sum of the logarithms of this many best scores."""
STEPS = (0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0003, 0.0001)
"""Widths of the finite differences: lengths of the change of the image."""
LEAST_STEP, LEAST_CHANGE = 0.001, 0.1
"""Smaller steps are taken only where the sureness is expected to change by more than float32 rounds."""


def sureness(scores: Float[Tensor, "*shape"]) -> Float[Tensor, ""]:
    """Measure how surely something is found, by one number whose slope does not vanish where scores do."""
    flat = scores.flatten()
    return flat.clamp(min=1e-30).log().topk(min(SURE, len(flat))).values.sum()


def gradient_of(total: Callable[[Tensor], Tensor], images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
    """Compute the gradient of `total(images)`, one number; zero where no path leads to the pixels."""
    pixels = images.clone().requires_grad_()
    with torch.enable_grad():
        value = total(pixels)
        if not value.requires_grad:
            return torch.zeros_like(images)
        (gradient,) = torch.autograd.grad(value, pixels, allow_unused=True)
    return torch.zeros_like(images) if gradient is None else gradient


def gradient_error(total: Callable[[Tensor], Tensor], image: Float[Tensor, "1 3 H W"]) -> float | None:
    """Compare the slope of `total(image)` along its gradient with finite differences: the relative error.

    At the first of several step widths where the two agree well, else at the best, because networks are rough and
    float32 is coarse. None where there is no finite gradient, or none but zero.
    """
    gradient = gradient_of(total, image)
    length = float(gradient.norm())
    if not np.isfinite(length) or length == 0:
        return None
    best = float("inf")
    with torch.no_grad():
        for step in (s for s in STEPS if s >= LEAST_STEP or s * length >= LEAST_CHANGE):
            way = step * gradient / length
            slope = float(total(image + way) - total(image - way)) / (2 * step)
            best = min(best, abs(slope - length) / length)
            if best < AGREES / 4:
                break
    return best
