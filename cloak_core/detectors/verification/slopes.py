"""Is a gradient one: finite, and as steep as a finite difference says?"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

AGREES = 0.1
"""The largest relative difference of a slope and a finite difference that counts as none."""
SURE = 20
"""A gradient is judged on the sum of so many of the best scores' logarithms."""
STEPS = (0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
"""Widths of the finite differences: lengths of the change of the image."""


def sureness(scores: Float[Tensor, "*shape"]) -> Float[Tensor, ""]:
    """Measure how surely something is found, by one number whose slope does not vanish where scores do."""
    flat = scores.flatten()
    return flat.clamp(min=1e-30).log().topk(min(SURE, len(flat))).values.sum()


def gradient_of(scores: Callable[[Tensor], Tensor], images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
    """Compute the gradient of the sureness of `scores(images)`; zero where no path leads to the pixels."""
    pixels = images.clone().requires_grad_()
    with torch.enable_grad():
        total = sureness(scores(pixels))
        if not total.requires_grad:
            return torch.zeros_like(images)
        (gradient,) = torch.autograd.grad(total, pixels, allow_unused=True)
    return torch.zeros_like(images) if gradient is None else gradient


def gradient_error(scores: Callable[[Tensor], Tensor], image: Float[Tensor, "1 3 H W"]) -> float | None:
    """Compare the slope along the gradient with finite differences: the relative error.

    At the first of several step widths where the two agree well, else at the best, because networks are rough and
    float32 is coarse. None where there is no finite gradient, or none but zero.
    """
    gradient = gradient_of(scores, image)
    length = float(gradient.norm())
    if not np.isfinite(length) or length == 0:
        return None
    best = float("inf")
    with torch.no_grad():
        for step in STEPS:
            way = step * gradient / length
            slope = float(sureness(scores(image + way)) - sureness(scores(image - way))) / (2 * step)
            best = min(best, abs(slope - length) / length)
            if best < AGREES / 4:
                break
    return best
