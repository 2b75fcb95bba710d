"""Random weights under which a network still looks at its images, for trying out families without their weights.

As they are drawn, the signal loses some of itself in every layer, until scores no longer depend on the image to seven
digits; and with it the gradient. So each batch norm is set to what noise images bring to it, layer by layer (compare
arXiv:1511.06422).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

SEED = 0
SIDE, SCALES = 128, (2, 4, 8, 16, 32, 64, 128)
"""Of the noise images, in pixels: their sides, and how many patches across there are at each scale."""


def settle_batch_norm(model: nn.Module) -> None:
    """Set batch norm from noise images, in place, the same on every machine.

    Worked out in float64, for threads change sums in float32.
    """
    generator = torch.Generator().manual_seed(SEED)
    hooks = [m.register_forward_pre_hook(_settle) for m in model.modules() if isinstance(m, nn.BatchNorm2d)]
    with torch.no_grad():
        model.double()(_noise(generator))
    for hook in hooks:
        hook.remove()
    model.float()


def _settle(norm: nn.BatchNorm2d, given: tuple[Float[Tensor, "B C h w"]]) -> None:
    (x,) = given
    norm.running_mean.copy_(x.mean(dim=(0, 2, 3)))
    # One for all channels: one that noise hardly reaches would be blown up by whatever does reach it in a photograph.
    norm.running_var.fill_(x.var(dim=(0, 2, 3), correction=0).mean())


def _noise(generator: torch.Generator) -> Float[Tensor, "B 3 h w"]:
    patches = [torch.rand(2, 3, n, n, dtype=torch.float64, generator=generator) - 0.5 for n in SCALES]
    return (0.5 + sum(F.interpolate(p, size=SIDE, mode="bilinear") for p in patches)).clamp(0, 1)
